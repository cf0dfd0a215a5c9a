"""The file of a machine with what was found: refitted values, and what is missing among its equations."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from valve_sim.files.plant_files import PlantFile, renamed
from valve_sim.files.whole_files import write_whole
from valve_sim.identification.diagnosis.run import Diagnosis
from valve_sim.identification.fit.declared_values import declared_values
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.plants.own import OwnPlant
from valve_sim.model.core.own.grammar import Expr, names_in
from valve_sim.model.core.own.units import text_of


def corrected_plant(diagnosis: Diagnosis) -> dict[str, Any]:
    """The plant's file with the values that a diagnosis found, and what it names among the equations."""
    plant = diagnosis.plant
    assert isinstance(plant, OwnPlant)
    result = diagnosis.after.fit
    names = tuple(name for name in diagnosis.verdict.effects if name in plant.file.effects)
    return changed_plant(plant.file, result, names if diagnosis.verdict.is_corrected else ())


def changed_plant(  # noqa: PLR0912 -- one for each part of a file
    file: PlantFile, result: Fit, effects: Sequence[str] = ()
) -> dict[str, Any]:
    """The content of a plant's file with the values of a fit, and some of its effects among the equations.

    A value with a tolerance has its standard error for the new one.
    """
    values = result.values
    errors = {row.name: row.stderr for row in declared_values(result)}
    found: dict[str, Any] = {key: value for key, value in file.text.items() if key != "plant"}
    found = {"plant": "equations", **yaml.safe_load(yaml.safe_dump(found, sort_keys=False))}
    found.setdefault("parameters", {})
    for name, entry in file.parameters.items():
        if name in values and math.isfinite(values[name]):
            value = min(max(values[name], entry.lower), entry.upper)
            found["parameters"][name]["value"] = float(f"{value / entry.unit.factor:.9g}")
            if name in errors and 0.0 < errors[name] < math.inf:
                found["parameters"][name]["tolerance"] = float(f"{errors[name] / entry.unit.factor:.3g}")
    derivatives = dict(file.derivatives)
    outputs = {name: own.value for name, own in file.outputs.items()}
    for effect in effects:
        chosen = file.effects[effect]
        own = {name: f"{effect}_{name}" for name in chosen.parameters}
        for target, name in chosen.delay.items():
            entry = found["inputs" if target in file.inputs else "outputs"][target]
            entry["delay"] = float(f"{entry.get('delay', 0.0) + values[f'{effect}.{name}']:.9g}")
        used = {name for added in chosen.add.values() for name in names_in(added)}
        for name, parameter in chosen.parameters.items():
            if name not in used:
                continue
            value = values[f"{effect}.{name}"]
            ends = [end / parameter.unit.factor for end in (parameter.lower, parameter.upper)]
            declared: dict[str, Any] = {"value": float(f"{value / parameter.unit.factor:.9g}")}
            source = file.text["effects"][effect]["parameters"][name]
            if "unit" in source:
                declared["unit"] = source["unit"]
            if all(map(math.isfinite, ends)):
                declared["range"] = ends
            found["parameters"][own[name]] = declared
        for target, added in chosen.add.items():
            place = derivatives if target in derivatives else outputs
            place[target] = Expr("+", (place[target], renamed(added, own)))
        del found["effects"][effect]
        for other in found["effects"].values():
            if "confused_with" in other:
                alike = other["confused_with"]
                other["confused_with"] = [
                    one for one in ([alike] if isinstance(alike, str) else alike) if one != effect
                ]
    if effects:
        found["derivatives"] = {name: text_of(own) for name, own in derivatives.items()}
        for name, expression in outputs.items():
            found["outputs"][name]["value"] = text_of(expression)
        if not found["effects"]:
            del found["effects"]
    return found


def save_plant(path: Path, content: Mapping[str, Any], provenance: str) -> None:
    """Write a plant's file with comments on where it is from."""
    comments = "".join(f"# {line}\n" for line in provenance.splitlines())
    text = yaml.safe_dump(dict(content), sort_keys=False, allow_unicode=True, width=120, default_flow_style=None)
    write_whole(path, comments + text)
