"""The file of a machine with what a fit says of it: refitted values, and effects among its equations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from valve_sim.files.plant_files import PlantFile, renamed
from valve_sim.files.whole_files import write_whole
from valve_sim.model.core.own.grammar import Expr, names_in
from valve_sim.model.core.own.units import text_of


def changed_plant(
    file: PlantFile, values: Mapping[str, float], errors: Mapping[str, float], effects: Sequence[str] = ()
) -> dict[str, Any]:
    """The content of a plant's file with the values of a fit, and some of its effects among the equations.

    A value with a tolerance has its standard error, among `errors`, for the new one.
    """
    copied = yaml.safe_load(
        yaml.safe_dump({key: file.text[key] for key in file.text if key != "plant"}, sort_keys=False)
    )
    content: dict[str, Any] = {"plant": "equations", **copied}
    parameters = content.setdefault("parameters", {})
    for name, entry in file.parameters.items():
        if name in values and math.isfinite(values[name]):
            value = min(max(values[name], entry.lower), entry.upper)
            parameters[name]["value"] = float(f"{value / entry.unit.factor:.9g}")
            if entry.tolerance and 0.0 < errors.get(name, 0.0) < math.inf:
                parameters[name]["tolerance"] = float(f"{errors[name] / entry.unit.factor:.3g}")
    expressions = {
        "derivatives": dict(file.derivatives),
        "outputs": {name: o.value for name, o in file.outputs.items()},
    }
    for effect in effects:
        _take_in(content, file, effect, values, expressions)
    if effects:
        content["derivatives"] = {name: text_of(rate) for name, rate in expressions["derivatives"].items()}
        for name, expression in expressions["outputs"].items():
            content["outputs"][name]["value"] = text_of(expression)
        if not content["effects"]:
            del content["effects"]
    return content


def _take_in(
    content: dict[str, Any],
    file: PlantFile,
    effect: str,
    values: Mapping[str, float],
    expressions: Mapping[str, dict[str, Expr]],
) -> None:
    """Move an effect from the effects of a content to its equations; its parameters bear the effect's name, too."""
    entry = file.effects[effect]
    names = {name: f"{effect}_{name}" for name in entry.parameters}
    for target, name in entry.delay.items():
        delayed = content["inputs" if target in file.inputs else "outputs"][target]
        delayed["delay"] = float(f"{delayed.get('delay', 0.0) + values[f'{effect}.{name}']:.9g}")
    used = {name for added in entry.add.values() for name in names_in(added)}
    for name in [name for name in entry.parameters if name in used]:
        parameter = entry.parameters[name]
        factor, source = parameter.unit.factor, file.text["effects"][effect]["parameters"][name]
        declared = {"value": float(f"{values[f'{effect}.{name}'] / factor:.9g}")}
        unit = {"unit": source["unit"]} if "unit" in source else {}
        ends = [end / factor for end in (parameter.lower, parameter.upper)]
        content["parameters"][names[name]] = {
            **declared,
            **unit,
            **({"range": ends} if all(map(math.isfinite, ends)) else {}),
        }
    for target, added in entry.add.items():
        place = expressions["derivatives" if target in expressions["derivatives"] else "outputs"]
        place[target] = Expr("+", (place[target], renamed(added, names)))
    del content["effects"][effect]
    for other in content["effects"].values():
        if "confused_with" in other:
            alike = other["confused_with"]
            other["confused_with"] = [one for one in ([alike] if isinstance(alike, str) else alike) if one != effect]


def save_plant(path: Path, content: Mapping[str, Any], provenance: str) -> None:
    """Write a plant's file with comments on where it is from."""
    comments = "".join(f"# {line}\n" for line in provenance.splitlines())
    text = yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    write_whole(path, comments + text)
