# ruff: noqa: E501 -- YAML and messages as they are
"""Files of plants: what is read from them, and one line that names key, value and mend for whatever is wrong."""

import copy
import random
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from valve_sim.files.plant_entries import PlantFileError
from valve_sim.files.plant_files import load_plant, plant_from

AXIS = """
plant: equations
states: {x: {unit: m, start: 0}, v: {unit: m/s, start: free}}
inputs: {force: {unit: N, between: straight}}
parameters:
  mass: {value: 95100, unit: g, tolerance: 500}
  viscous: {value: 200, unit: N*s/m, free: true, range: [0, 2000]}
derivatives: {x: v, v: (force - viscous*v)/mass}
outputs: {position: {value: x, unit: mm, noise: 1e-3}, power: {value: force*v, unit: W}}
effects:
  coulomb_friction: {add: {v: -level*sign(v)/mass}, parameters: {level: {unit: N, neutral: 0, scale: 10, range: [0, 200]}}, confused_with: [offset]}
  offset: {add: {v: load/mass}, parameters: {load: {unit: N, neutral: 0, scale: 10}}}
  overflow: {add: {x: '-rate*max(0, x - level)'}, parameters: {rate: {unit: 1/s, neutral: 0, scale: 1, range: [0, 10]}, level: {unit: m, range: [0, 0.1]}}}
"""


READ: dict[str, Any] = yaml.safe_load(AXIS.replace("1e-3", "1.0e-3"))


def content() -> dict[str, Any]:
    return copy.deepcopy(READ)


def test_a_plant_is_read_in_si(tmp_path: Path) -> None:
    path = tmp_path / "axis.yaml"
    path.write_text(AXIS)
    found = load_plant(path)
    assert found.parameters["mass"].value == pytest.approx(95.1)
    assert found.parameters["mass"].tolerance == pytest.approx(0.5)
    assert found.outputs["position"].noise == pytest.approx(1e-6)
    assert found.states["v"].start is None
    assert not found.inputs["force"].held
    assert found.effects["overflow"].parameters["level"].neutral is None
    with_friction = found.equations(["coulomb_friction"])
    assert "coulomb_friction.level" in with_friction.parameters


def test_an_output_may_be_used_in_equations_but_not_in_a_loop() -> None:
    found = content()
    found["outputs"]["drag"] = {"value": "viscous*v", "unit": "N"}
    found["derivatives"]["v"] = "(force - drag)/mass"
    assert (
        plant_from(found, "p").equations().derivatives["v"] == plant_from(content(), "p").equations().derivatives["v"]
    )
    found["outputs"]["drag"]["value"] = "twice/2"
    found["outputs"]["twice"] = {"value": "2*drag", "unit": "N"}
    with pytest.raises(PlantFileError, match=r"outputs\.\w+\.value: goes round in a loop: \w+ -> \w+ -> \w+"):
        plant_from(found, "p")


@pytest.mark.parametrize(("kind", "rotary"), [("coil", False), ("axis", False), ("axis", True)])
def test_templates_are_plants_of_which_a_file_sets_values(kind: str, *, rotary: bool) -> None:
    found = plant_from({"plant": kind, **({"rotary": True} if rotary else {})}, "p")
    assert len(found.effects) >= 5
    first = next(name for name, own in found.parameters.items() if own.free)
    changed = plant_from({"plant": kind, **({"rotary": True} if rotary else {}), "parameters": {first: 7}}, "p")
    assert changed.parameters[first].value == 7.0
    for effect in found.effects:
        found.equations([effect])


def test_scales_of_effects_follow_from_the_sizes_of_signals() -> None:
    found = plant_from({"plant": "axis", "effects": ["coulomb_friction", "stiffness", "quadratic_drag"]}, "p")
    sized = found.sized({"force": 10.0, "x": 0.5, "v": 2.0}).effects
    assert sized["coulomb_friction"].parameters["level"].scale == pytest.approx(2.0)
    assert sized["stiffness"].parameters["rate"].scale == pytest.approx(4.0)
    assert sized["quadratic_drag"].parameters["coefficient"].scale == pytest.approx(0.5)
    with pytest.raises(
        PlantFileError, match=r"effects\.stiffness\.parameters\.rate\.scale: uses x, which no column shows"
    ):
        found.sized({"force": 10.0, "v": 2.0})


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"plant": "ekvations"}, "plant: found 'ekvations', expected one of equations, coil, axis, valve"),
    ({"plant": None}, "plant: is missing"),
    ({"stats": {}}, "stats: unknown key; did you mean states?"),
    ({True: 1}, "YAML reads on, off, yes and no so"),
    ({"derivatives": {"x": "v"}}, "derivatives.v: is missing"),
    ({"derivatives": {"x": "v", "v": "(force - viscous*v)/mas"}}, "derivatives.v: uses mas, which is no state, input or parameter; did you mean mass"),
    ({"derivatives": {"x": "v", "v": "force - viscous*v"}}, "derivatives.v: is in kg·m/s², expected m/s²"),
    ({"derivatives": {"x": "v", "v": "(force - v)/mass"}}, "derivatives.v: v in m/s is added to force in kg·m/s²"),
    ({"derivatives": {"x": "v", "v": "force^2"}}, "derivatives.v: found '^'"),
    ({"derivatives": {"x": "v", "v": False}}, "derivatives.v: found False: YAML reads on, off, yes and no so"),
    ({"derivatives": {"x": "v", "v": "v", "w": "1"}}, "derivatives.w: is of no state"),
    ({"states": {"x": {"unit": "m", "start": "fre"}, "v": {"unit": "m/s"}}}, "states.x.start: found 'fre', expected a number or free"),
    ({"states": {"x": {"unit": "metre"}, "v": {"unit": "m/s"}}}, "states.x.unit: found 'metre'"),
    ({"states": {"t": {"unit": "m"}}}, "states.t: t is the name of the time"),
    ({"states": {"x": {"unit": "m"}, "v": {"unit": "m/s"}, "mass": {"unit": "m"}}}, "parameters.mass: is a name in states, too"),
    ({"inputs": {"force": {"unit": "N", "between": "linear"}}}, "inputs.force.between: found 'linear', expected held or straight"),
    ({"parameters": {"mass": {"value": "1e-6", "unit": "kg"}, "viscous": {"value": 1, "unit": "N*s/m"}}}, "parameters.mass.value: found the text '1e-6', expected a number: take the quotes away"),
    ({"parameters": {"mass": {"value": True, "unit": "kg"}}}, "parameters.mass.value: found True, expected a number (YAML reads"),
    ({"parameters": {"mass": {"unit": "kg"}}}, "parameters.mass.value: is missing"),
    ({"parameters": {"mass": {"value": 1, "unit": "kg", "range": [2, 3]}}}, "parameters.mass.value: found 1, expected within range: [2, 3]"),
    ({"parameters": {"mass": {"value": 1, "unit": "kg", "range": [3, 2]}}}, "parameters.mass.range: found [3, 2], expected the lower end first"),
    ({"parameters": {"mass": {"value": 1, "unit": "kg", "tolerance": -1}}}, "parameters.mass.tolerance: found -1"),
    ({"parameters": {"mass": {"value": 1, "unit": "kg", "tolerance": 1, "free": True}}}, "parameters.mass.tolerance: stands beside free: true"),
    ({"outputs": {}}, "outputs: is missing"),
    ({"outputs": {"position": {"value": "x", "unit": "s"}}}, "outputs.position.value: is in m, expected s"),
    ({"outputs": {"position": {"value": "x", "unit": "m", "noise": 0}}}, "outputs.position.noise: found 0, expected a standard deviation above 0"),
    ({"outputs": {"position": "x"}}, "outputs.position: found 'x', expected {value: x, unit: ...}"),
    ({"effects": {"drag": {"add": {"q": "1"}, "parameters": {"c": {"neutral": 0, "scale": 1}}}}}, "effects.drag.add.q: is no state and no output"),
    ({"effects": {"drag": {"add": {"v": "c*v"}, "parameters": {"c": {"unit": "1/s", "scale": 1}}}}}, "effects.drag.parameters: none has neutral:"),
    ({"effects": {"drag": {"add": {"v": "c*v"}, "parameters": {"c": {"unit": "1/s", "neutral": 0}}}}}, "effects.drag.parameters.c: has neither scale: nor a range:"),
    ({"effects": {"drag": {"add": {"v": "c*v"}, "parameters": {"c": {"unit": "1/s", "neutral": 0, "scale": 1}}, "confused_with": ["d"]}}}, "effects.drag.confused_with: found 'd'"),
    ({"effects": {"drag": {"add": {"v": "c*v"}, "parameters": {"c": {"unit": "1/s", "neutral": 0, "scale": "0.1*force"}}}}}, "effects.drag.parameters.c.scale: is in kg·m/s², expected 1/s"),
    ({"effects": {"drag": {"add": {"v": "c*v"}, "parameters": {"c": {"unit": "1/s", "neutral": 0, "scale": "fource/mass/v"}}}}}, "effects.drag.parameters.c.scale: uses fource, which is no state, input or parameter; did you mean force"),
    ({"window": 0}, "window: found 0, expected a duration in s above 0"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "words"), WRONG, ids=[words[:40] for _, words in WRONG])
def test_a_wrong_file_is_refused_in_one_line(change: dict[str, Any], words: str) -> None:
    found = {**content(), **change}
    if found["plant"] is None:
        del found["plant"]
    with pytest.raises(PlantFileError) as caught:
        plant_from(found, "my.yaml")
    assert str(caught.value).startswith("my.yaml: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("derivatives: {x: v, v: -k*sqrt(max(0, v))+force}", "derivatives.v: found '-k*sqrt(max(0'"),
        ("outputs: {position: {value: max(0, x), unit: m}}", "outputs.position.value: found 'max(0'"),
        ("effects: {e: {add: {v: where(v > 0, f, -f)/mass}, parameters: {f: {unit: N, neutral: 0, scale: 1}}}}", "effects.e.add.v: found 'where(v > 0'"),
    ],
)  # fmt: skip
def test_an_expression_that_yaml_has_split_at_a_comma_needs_quotes(text: str, words: str) -> None:
    with pytest.raises(PlantFileError) as caught:
        plant_from({**content(), **yaml.safe_load(text)}, "my.yaml")
    assert (
        str(caught.value)
        == f"my.yaml: {words}, which a comma has cut off; in {{ }} an expression with commas needs quotes"
    )


def test_a_parameter_without_a_use_is_refused() -> None:
    found = content()
    found["parameters"]["stray"] = {"value": 1}
    with pytest.raises(PlantFileError, match=r"parameters\.stray: is used by no equation"):
        plant_from(found, "p")


# -- 500 wrong files ---------------------------------------------------------------------------------------------------

JUNK: list[Any] = [
    None, True, False, -1, 0, 1e400, float("nan"), "", "on", "1e-6", "x y", "a" * 5000, "((((", "import os", [], [1], {},
    {"a": 1}, [[1, 2]], "N*s/m", "free", "\n", "−1", "x.y", "x[0]", "lambda: 0", 10**40, {"value": None}, {1: 2},
]  # fmt: skip
"""What people and accidents write in the place of something."""


def places(node: Any, way: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The way to every value of a file."""
    if isinstance(node, dict):
        for key, value in node.items():
            yield (*way, key)
            yield from places(value, (*way, key))
    elif isinstance(node, list):
        for index, value in enumerate(node):
            yield (*way, index)
            yield from places(value, (*way, index))


def damaged(seed: int) -> tuple[Any, tuple[Any, ...]]:
    """A file with one thing wrong, perhaps: and where."""
    chance = random.Random(seed)
    found = content()
    way = chance.choice(list(places(found)))
    parent = found
    for key in way[:-1]:
        parent = parent[key]
    how = chance.randrange(4)
    if how == 0:
        del parent[way[-1]]
    elif how == 1 and isinstance(parent, dict):
        parent[str(way[-1]) + chance.choice("xq_ -")] = parent.pop(way[-1])
    elif how == 2 and isinstance(parent[way[-1]], str):
        text = parent[way[-1]]
        at = chance.randrange(len(text) + 1)
        parent[way[-1]] = text[:at] + chance.choice("+*/()^=,.;@#'\"&?2x ") + text[at + chance.randrange(2) :]
    else:
        parent[way[-1]] = copy.deepcopy(chance.choice(JUNK))
    return found, way


def test_a_thousand_damaged_files_are_read_or_refused_in_one_line() -> None:
    refused = 0
    for seed in range(1000):
        found, way = damaged(seed)
        try:
            plant_from(found, "my.yaml")
        except PlantFileError as error:
            refused += 1
            message = str(error)
            assert message.startswith("my.yaml: "), (seed, message)
            assert "\n" not in message, (seed, message)
            assert len(message) < 500, (seed, message)
            # The key is named, or, of a name that is gone, one that uses it.
            assert any(str(key)[:40] in message for key in way) or "expected" in message, (seed, way, message)
    assert refused >= 500


@pytest.mark.parametrize(
    "text", ["", "[1, 2]", "plant: [", "a: 1\na: 2", "\x00", "plant: equations\n\tstates: {}", "&a [*a]"]
)
def test_what_is_no_yaml_of_a_plant_is_refused_in_one_line(tmp_path: Path, text: str) -> None:
    path = tmp_path / "my.yaml"
    path.write_text(text)
    with pytest.raises(PlantFileError) as caught:
        load_plant(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
