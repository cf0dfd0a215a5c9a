"""A plant of a user's own, in a file: states, inputs, parameters, equations, outputs, effects, read and checked once.

    plant: equations
    states: {x: {unit: m, start: 0}, v: {unit: m/s, start: 0}}
    inputs: {force: {unit: N, between: straight}}
    parameters:
      mass: {value: 95.1, unit: kg, tolerance: 0.5}
      viscous: {value: 200, unit: N*s/m, free: true, range: [0, 2000]}
    derivatives: {x: v, v: (force - viscous*v)/mass}
    outputs: {position: {value: x, unit: m, noise: 1e-6}}
    effects:
      offset: {add: {v: load/mass}, parameters: {load: {unit: N, neutral: 0, scale: 10}}}

After reading, all numbers are in SI units. `coil` and `axis` are equations, too: files of the
package, in which a user's file sets values (`plant_templates`).
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from importlib import resources
from pathlib import Path
from typing import Any, Final

import yaml

from valve_sim.files.entries import Entries, alternatives, is_number, short
from valve_sim.files.plant_entries import PlantEntries, PlantFileError, a_second
from valve_sim.files.plant_modes import SECTIONS as MODE_SECTIONS
from valve_sim.files.plant_modes import Automaton, HeldEntry, ModesReader, held_numbers, mode_names
from valve_sim.files.yaml_files import read_yaml
from valve_sim.model.core.own.equations import Equations
from valve_sim.model.core.own.grammar import Expr, evaluate, names_in, walk
from valve_sim.model.core.own.units import Dimension, Unit, parse_unit

KINDS: Final = ("equations", "coil", "axis", "valve")
SECTIONS: Final = (
    "plant", "states", "inputs", "parameters", "derivatives", "outputs", "effects", "window", *MODE_SECTIONS
)  # fmt: skip
TEMPLATE_SECTIONS: Final = ("plant", "rotary", "parameters", "outputs", "effects", "window", "inputs", "states")
MOST_EFFECTS: Final = 40
LARGEST: Final = 5000
"""Operations of an output with all that it uses."""
DEEPEST: Final = 6
"""Keys within each other that a file of a plant has."""
LONGEST_FILE: Final = 200_000
"""Bytes."""


@dataclass(frozen=True)
class StateEntry:
    """A state: its unit and where it starts, SI; None: that is estimated for each recording."""

    unit: Unit
    start: float | None


@dataclass(frozen=True)
class InputEntry:
    """An input: its unit; whether it is held between samples; s by which it acts later than its column shows."""

    unit: Unit
    held: bool
    delay: float = 0.0


@dataclass(frozen=True)
class ParameterEntry:
    """A number of the machine, SI: declared value, standard deviation of it (0: exact), whether it is refitted.

    `varies` is the standard deviation by which it differs from recording to recording, 0: not at all.
    """

    unit: Unit
    value: float
    tolerance: float
    free: bool
    lower: float
    upper: float
    varies: float = 0.0
    title: str = ""


@dataclass(frozen=True)
class OutputEntry:
    """What a sensor shows: equation; standard deviation of its noise, SI, if that is known; s by which it is late."""

    unit: Unit
    value: Expr
    noise: float | None
    delay: float = 0.0


@dataclass(frozen=True)
class EffectParameter:
    """A number of an effect, SI: the value at which it changes nothing (None: it shapes the effect), and its scale.

    `scale_of` is the scale as an expression of the sizes of what was recorded, until `PlantFile.sized` evaluates it.
    """

    unit: Unit
    neutral: float | None
    scale: float
    lower: float
    upper: float
    title: str = ""
    scale_of: Expr | None = None


@dataclass(frozen=True)
class EffectEntry:
    """An effect: what it adds to derivatives and outputs, by name; which parameter delays which input or output."""

    add: Mapping[str, Expr]
    parameters: Mapping[str, EffectParameter]
    confused_with: tuple[str, ...] = ()
    title: str = ""
    delay: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class PlantFile:
    """A plant as its file declares it.

    Attributes:
        window: s, after which the states start again and are estimated again; infinite: never.
        automaton: its modes, and what makes them change.
    """

    path: str
    kind: str
    states: Mapping[str, StateEntry]
    inputs: Mapping[str, InputEntry]
    parameters: Mapping[str, ParameterEntry]
    derivatives: Mapping[str, Expr]
    outputs: Mapping[str, OutputEntry]
    effects: Mapping[str, EffectEntry] = field(default_factory=dict)
    window: float = math.inf
    automaton: Automaton = field(default_factory=Automaton)
    text: Mapping[str, Any] = field(default_factory=dict, compare=False)

    def equations(self, effects: Sequence[str] = ()) -> Equations:
        """The equations with some effects on."""
        derivatives, outputs = dict(self.derivatives), {name: own.value for name, own in self.outputs.items()}
        names = list(self.parameters)
        for effect in effects:
            entry = self.effects[effect]
            own = {name: f"{effect}.{name}" for name in entry.parameters}
            names += own.values()
            for target, added in entry.add.items():
                place = derivatives if target in derivatives else outputs
                place[target] = Expr("+", (place[target], renamed(added, own)))
        modes = self.automaton
        held = {name: number.start for name, number in modes.held.items()}
        return Equations(
            derivatives, outputs, tuple(self.inputs), tuple(names), held, modes.regions, modes.transitions
        )  # fmt: skip

    def sized(self, sizes: Mapping[str, float]) -> PlantFile:
        """This plant with scales of effects as these sizes of its signals make them.

        Args:
            sizes: of states, inputs and outputs, and of the time, SI, by name.

        Raises:
            PlantFileError: a scale is of a signal without a size.
        """
        known = {**{name: abs(own.value) for name, own in self.parameters.items()}, **sizes}
        effects = {
            name: replace(
                own,
                parameters={
                    key: self._sized(f"{name}.parameters.{key}", one, known) for key, one in own.parameters.items()
                },
            )
            for name, own in self.effects.items()
        }
        return replace(self, effects=effects)

    def _sized(self, key: str, parameter: EffectParameter, known: Mapping[str, float]) -> EffectParameter:
        if parameter.scale_of is None:
            return parameter
        unseen = next((name for name in names_in(parameter.scale_of) if name not in known), None)
        if unseen is not None:
            raise PlantFileError(
                f"{self.path}: effects.{key}.scale: uses {unseen}, which no column shows; give a number"
            )
        scale = evaluate(parameter.scale_of, known)
        # Of what stands at 0 in all recordings nothing follows: one unit is kept.
        if not isinstance(scale, float) or not 0.0 < scale < math.inf:
            scale = parameter.scale
        return replace(parameter, scale=scale, scale_of=None)


def inlined(expression: Expr, equations: Mapping[str, Expr]) -> Expr:
    """An expression in which names of outputs are replaced by their equations."""
    if expression.op == "name":
        return equations.get(expression.value, expression)
    return Expr(expression.op, tuple(inlined(own, equations) for own in expression.args), expression.value)


def renamed(expression: Expr, names: Mapping[str, str]) -> Expr:
    """An expression with some of its names replaced."""
    if expression.op == "name":
        return Expr("name", (), names.get(expression.value, expression.value))
    return Expr(expression.op, tuple(renamed(own, names) for own in expression.args), expression.value)


def is_own_plant(path: Path | str) -> bool:
    """Whether a file is of a plant that is no valve.

    Raises:
        PlantFileError: it is no file of a plant.
    """
    return _kind(_content(path), str(path)) != "valve"


def load_plant(path: Path | str) -> PlantFile:
    """Read and check a plant of equations.

    Raises:
        PlantFileError: it cannot be used; one line with the file, the key, what was found and the mend.
    """
    return plant_from(_content(path), str(path))


def _content(path: Path | str) -> object:
    try:
        if Path(path).stat().st_size > LONGEST_FILE:
            raise PlantFileError(f"{path}: is longer than {LONGEST_FILE} bytes, expected a plant of a few equations")
    except OSError as error:
        raise PlantFileError(f"{path}: cannot be read ({error.strerror}); give a file of a plant") from error
    return read_yaml(path, "expected a plant: plant: equations, states:, inputs: and so on", PlantFileError)


def _kind(found: object, path: str) -> str:
    if not isinstance(found, Mapping):
        raise PlantFileError(f"{path}: found {short(found)}, expected keys plant:, states:, inputs: and so on")
    kind = found.get("plant", "valve" if "/**" in found else None)
    if kind is None:
        raise PlantFileError(f"{path}: plant: is missing; add plant: equations (or coil, axis, valve)")
    if kind not in KINDS:
        raise PlantFileError(f"{path}: plant: found {short(kind)}, expected one of {', '.join(KINDS)}")
    return str(kind)


def plant_from(found: object, path: str) -> PlantFile:
    """Check what a file holds; errors as `load_plant`."""
    kind = _kind(found, path)
    assert isinstance(found, Mapping)
    _refuse_split(found, path, ())
    if kind == "valve":
        raise PlantFileError(f"{path}: plant: found 'valve', expected equations, coil or axis; give --params {path}")
    if kind != "equations":
        found = _from_template(found, kind, path)
    return _Reader(found, path, kind).whole()


def _refuse_split(found: Mapping[Any, Any], path: str, way: tuple[str, ...]) -> None:
    """Refuse an expression that YAML has split at a comma: a bracket stays open, and what follows has no value."""
    for key, own in found.items():
        place = (*way, str(key))
        if isinstance(own, Mapping) and len(place) < DEEPEST:
            _refuse_split(own, path, place)
        elif isinstance(own, str) and own.count("(") > own.count(")") and None in found.values():
            words = f"found {short(own)}, which a comma has cut off; in {{ }} an expression with commas needs quotes"
            raise Entries(path, PlantFileError).fail(".".join(place), words)


def _from_template(found: Mapping[Any, Any], kind: str, path: str) -> Mapping[Any, Any]:
    """The equations of a template, with what a user's file sets in them."""
    Entries(path, PlantFileError).check_keys("", found, TEMPLATE_SECTIONS)
    rotary = found.get("rotary", False)
    if not isinstance(rotary, bool):
        raise PlantFileError(f"{path}: rotary: found {short(rotary)}, expected true or false")
    if kind == "coil" and "rotary" in found:
        raise PlantFileError(f"{path}: rotary: is of an axis; take it out")
    name = f"{'rotary_' if rotary else ''}{kind}.yaml"
    text = (resources.files("valve_sim.files") / "plant_templates" / name).read_text(encoding="utf-8")
    template: dict[str, Any] = yaml.safe_load(text)
    _set_values(template, found, path)
    return template


def _set_values(template: dict[str, Any], found: Mapping[Any, Any], path: str) -> None:
    for section in ("states", "inputs", "outputs", "parameters"):
        entries = found.get(section, {})
        if not isinstance(entries, Mapping):
            raise PlantFileError(f"{path}: {section}: found {short(entries)}, expected names of the {found['plant']}")
        for name, own in entries.items():
            known = template.get(section, {})
            if name not in known:
                raise PlantFileError(f"{path}: {section}.{name}: unknown; {alternatives(name, known)}")
            entry = {"value": own} if section == "parameters" and not isinstance(own, Mapping) else own
            if not isinstance(entry, Mapping):
                raise PlantFileError(f"{path}: {section}.{name}: found {short(entry)}, expected keys such as unit:")
            if entry.get("tolerance") and "free" not in entry:
                # Who says how well a value is known wants no value that is free.
                known[name] = {key: value for key, value in known[name].items() if key != "free"}
            known[name] = {**known[name], **entry}
    _choose_effects(template, found, path)
    if "window" in found:
        template["window"] = found["window"]


def _choose_effects(template: dict[str, Any], found: Mapping[Any, Any], path: str) -> None:
    """Of a template's effects those that a user's file lists; or all of them, and the user's own."""
    chosen = found.get("effects", list(template["effects"]))
    if isinstance(chosen, Mapping):
        template["effects"] = {**template["effects"], **chosen}
    elif isinstance(chosen, list):
        for name in chosen:
            if name not in template["effects"]:
                raise PlantFileError(f"{path}: effects: found {short(name)}; {alternatives(name, template['effects'])}")
        template["effects"] = {name: template["effects"][name] for name in chosen}
        for own in template["effects"].values():
            own["confused_with"] = [other for other in own.get("confused_with", []) if other in chosen]
    else:
        raise PlantFileError(f"{path}: effects: found {short(chosen)}, expected a list of names, or names and effects")


class _Reader(PlantEntries):
    """Checks the content of one file."""

    def __init__(self, found: Mapping[Any, Any], path: str, kind: str) -> None:
        super().__init__(found, path)
        self._kind = kind

    def whole(self) -> PlantFile:
        path, found = self.where, self.found
        self.check_keys("", found, SECTIONS)
        states = {name: self._state(name, own) for name, own in self.section("states").items()}
        inputs = {name: self._input(name, own) for name, own in self.section("inputs").items()}
        parameters = {name: self._parameter(name, own) for name, own in self.section("parameters").items()}
        held = held_numbers(self)
        self.modes = mode_names(self)
        regions = {region: None for region, _ in self.modes.values()}
        self._once({"states": states, "inputs": inputs, "parameters": parameters, "held": held, "regions": regions})
        dimensions: dict[str, Dimension] = {"t": (0, 0, 1, 0, 0), "time": (0, 0, 1, 0, 0)}
        dimensions |= dict.fromkeys(regions, parse_unit("").dimension)
        groups: tuple[Mapping[str, StateEntry | InputEntry | ParameterEntry | HeldEntry], ...]
        groups = states, inputs, parameters, held
        for group in groups:
            dimensions.update({name: own.unit.dimension for name, own in group.items()})
        section = self.section("outputs")
        shown = {name: self._output_unit(name, own) for name, own in section.items() if name not in dimensions}
        everything = {**dimensions, **{name: unit.dimension for name, unit in shown.items()}}
        outputs = self._resolved({name: self._output(name, own, everything) for name, own in section.items()}, shown)
        equations = {name: own.value for name, own in outputs.items() if name in shown}
        derivatives = {name: inlined(own, equations) for name, own in self._derivatives(states, everything).items()}
        units = {name: own.unit for name, own in states.items()} | {name: own.unit for name, own in held.items()}
        automaton = ModesReader(self, units, states, everything).whole(held).mapped(lambda own: inlined(own, equations))
        if not outputs:
            raise self.fail("outputs", "is missing; say what is measured: outputs: {position: {value: x, unit: m}}")
        clash = next((name for name in outputs if name in derivatives and outputs[name].value.value != name), None)
        if clash:
            raise self.fail(f"outputs.{clash}", "has the name of a state that it does not show; choose another name")
        if self._kind == "equations":  # of a template a user leaves effects out, and what they alone use
            self._used([*derivatives.values(), *automaton.expressions()], outputs, parameters, inputs)
        effects = self._effects(derivatives, outputs, everything)
        effects = {
            name: replace(own, add={key: inlined(added, equations) for key, added in own.add.items()})
            for name, own in effects.items()
        }
        window = self.si("window", found["window"]) if "window" in found else math.inf
        if window <= 0.0:
            raise self.fail("window", f"found {window:g}, expected a duration in s above 0")
        return PlantFile(
            path, self._kind, states, inputs, parameters, derivatives, outputs, effects, window, automaton, dict(found)
        )  # fmt: skip

    def _once(self, groups: Mapping[str, Mapping[str, object]]) -> None:
        seen: dict[str, str] = {}
        for key, group in groups.items():
            for name in group:
                if name in seen:
                    raise self.fail(f"{key}.{name}", f"is a name in {seen[name]}, too; choose another")
                seen[name] = key

    def _from_zero(
        self, key: str, entry: Mapping[str, Any], unit: Unit | None = None, what: str = "a standard deviation"
    ) -> float:
        """A number of an entry that is not negative, in SI; 0 where it is not given."""
        given = entry.get(key.rpartition(".")[2], 0.0)
        found = self.si(key, given, unit)
        if found < 0.0:
            raise self.fail(key, f"found {given}, expected {what} from 0 on")
        return found

    def _title(self, key: str, entry: Mapping[str, Any]) -> str:
        title = entry.get("title", "")
        if not isinstance(title, str) or "\n" in title or len(title) > 80:
            raise self.fail(f"{key}.title", f"found {short(title)}, expected a few words")
        return title

    def _range(self, key: str, entry: Mapping[str, Any], unit: Unit) -> tuple[float, float]:
        found = entry.get("range", [-math.inf, math.inf])
        if not isinstance(found, list) or len(found) != 2:
            raise self.fail(f"{key}.range", f"found {short(found)}, expected two numbers: [0, 100]")
        if "range" in entry:
            for end in found:
                if not (isinstance(end, float) and math.isinf(end)):
                    self.si(f"{key}.range", end)
        lower, upper = (float(end) * unit.factor for end in found)
        if not lower < upper:
            raise self.fail(f"{key}.range", f"found {short(found)}, expected the lower end first, and another above it")
        return lower, upper

    def _state(self, name: str, found: object) -> StateEntry:
        key = f"states.{name}"
        entry = self.entry(key, found, ("unit", "start"))
        unit = self.plant_unit(key, entry)
        start = entry.get("start", 0.0)
        if isinstance(start, str) and start != "free":
            raise self.fail(f"{key}.start", f"found {short(start)}, expected a number or free")
        return StateEntry(unit, None if start == "free" else self.si(f"{key}.start", start, unit))

    def _input(self, name: str, found: object) -> InputEntry:
        key = f"inputs.{name}"
        entry = self.entry(key, found, ("unit", "between", "delay"))
        between = entry.get("between", "straight")
        if between not in ("held", "straight"):
            raise self.fail(f"{key}.between", f"found {short(between)}, expected held or straight")
        delay = self._from_zero(f"{key}.delay", entry, what="seconds")
        return InputEntry(self.plant_unit(key, entry), between == "held", delay)

    def _parameter(self, name: str, found: object) -> ParameterEntry:
        key = f"parameters.{name}"
        entry = self.entry(key, found, ("value", "unit", "tolerance", "free", "range", "varies", "title"))
        unit = self.plant_unit(key, entry)
        if "value" not in entry:
            raise self.fail(f"{key}.value", "is missing; give the declared value, or where a fit starts")
        value = self.si(f"{key}.value", entry["value"], unit)
        tolerance, varies = (self._from_zero(f"{key}.{name}", entry, unit) for name in ("tolerance", "varies"))
        free = entry.get("free", False)
        if not isinstance(free, bool):
            raise self.fail(f"{key}.free", f"found {short(free)}, expected true or false")
        if free and tolerance:
            raise self.fail(f"{key}.tolerance", "stands beside free: true, which knows none; take one of them out")
        lower, upper = self._range(key, entry, unit)
        if not lower <= value <= upper:
            raise self.fail(f"{key}.value", f"found {entry['value']}, expected within range: {entry['range']}")
        return ParameterEntry(unit, value, tolerance, free, lower, upper, varies, self._title(key, entry))

    def _derivatives(self, states: Mapping[str, StateEntry], dimensions: Mapping[str, Dimension]) -> dict[str, Expr]:
        found = self.section("derivatives")
        for name in found:
            if name not in states:
                raise self.fail(f"derivatives.{name}", f"is of no state; {alternatives(name, states)}")
        derivatives: dict[str, Expr] = {}
        for name, state in states.items():
            key = f"derivatives.{name}"
            if name not in found:
                raise self.fail(key, f"is missing; say how the state {name} changes")
            derivatives[name] = self.expression(key, found[name], dimensions)
            own = self.dimension(key, derivatives[name], dimensions)
            self.fits(key, own, a_second(state.unit), f"the unit of {name} a second")
        return derivatives

    def _output_unit(self, name: str, found: object) -> Unit:
        return self.plant_unit(f"outputs.{name}", found) if isinstance(found, Mapping) else parse_unit("")

    def _resolved(self, outputs: Mapping[str, OutputEntry], shown: Mapping[str, Unit]) -> dict[str, OutputEntry]:
        """Outputs whose equations use no other outputs."""
        done: dict[str, OutputEntry] = {}

        def resolve(name: str, way: tuple[str, ...]) -> Expr:
            if name in way:
                loop = " -> ".join((*way[way.index(name) :], name))
                raise self.fail(f"outputs.{name}.value", f"goes round in a loop: {loop}; use states in its place")
            if name not in done:
                own = outputs[name]
                used = [one for one in names_in(own.value) if one in shown]
                equations = {one: resolve(one, (*way, name)) for one in used}
                done[name] = replace(own, value=inlined(own.value, equations))
                if sum(1 for _ in walk(done[name].value)) > LARGEST:
                    raise self.fail(f"outputs.{name}.value", f"has more than {LARGEST} operations; shorten it")
            return done[name].value

        for name in outputs:
            resolve(name, ())
        return {name: done[name] for name in outputs}

    def _output(self, name: str, found: object, dimensions: Mapping[str, Dimension]) -> OutputEntry:
        key = f"outputs.{name}"
        if isinstance(found, str):
            raise self.fail(key, f"found {short(found)}, expected {{value: {found}, unit: ...}}")
        entry = self.entry(key, found, ("value", "unit", "noise", "delay"))
        unit = self.plant_unit(key, entry)
        if "value" not in entry:
            raise self.fail(f"{key}.value", "is missing; say what the sensor shows")
        value = self.expression(f"{key}.value", entry["value"], dimensions)
        self.fits(f"{key}.value", self.dimension(f"{key}.value", value, dimensions), unit.dimension, "its unit")
        noise = self.si(f"{key}.noise", entry["noise"], unit) if "noise" in entry else None
        if noise is not None and noise <= 0.0:
            raise self.fail(
                f"{key}.noise",
                f"found {entry['noise']}, expected a standard deviation above 0; leave it out where it is not known",
            )
        return OutputEntry(unit, value, noise, self._from_zero(f"{key}.delay", entry, what="seconds"))

    def _used(
        self, equations: Sequence[Expr], outputs: Mapping[str, OutputEntry],
        parameters: Mapping[str, object], inputs: Mapping[str, object],
    ) -> None:  # fmt: skip
        """Every parameter and input has a use, in the equations or in an effect."""
        used = {name for own in equations for name in names_in(own)}
        used |= {name for own in outputs.values() for name in names_in(own.value)}
        effects = self.found.get("effects", {})
        text = repr(effects)
        for key, group in (("parameters", parameters), ("inputs", inputs)):
            for name in group:
                if name not in used and not re.search(rf"\b{name}\b", text):
                    raise self.fail(f"{key}.{name}", "is used by no equation; use it or take it out")

    def _effects(
        self, derivatives: Mapping[str, Expr], outputs: Mapping[str, OutputEntry], dimensions: Mapping[str, Dimension]
    ) -> dict[str, EffectEntry]:
        found = self.section("effects")
        if len(found) > MOST_EFFECTS:
            raise self.fail("effects", f"found {len(found)}, expected at most {MOST_EFFECTS}")
        effects = {}
        for name, own in found.items():
            key = f"effects.{name}"
            entry = self.entry(key, own, ("add", "delay", "parameters", "confused_with", "title"))
            parameters = self._effect_parameters(key, entry.get("parameters"), dimensions)
            known = {**dimensions, **{one: parameter.unit.dimension for one, parameter in parameters.items()}}
            delay = self._delays(key, entry["delay"], parameters, outputs) if "delay" in entry else {}
            add = (
                {} if delay and "add" not in entry else self._add(key, entry.get("add"), (derivatives, outputs, known))
            )
            used = {*delay.values(), *(one for expression in add.values() for one in names_in(expression))}
            for one in parameters:
                if one not in used:
                    raise self.fail(f"{key}.parameters.{one}", "is used by nothing that the effect adds; take it out")
            effects[name] = EffectEntry(add, parameters, self._alike(key, entry, found), self._title(key, entry), delay)
        return effects

    def _delays(
        self, key: str, found: object, parameters: Mapping[str, EffectParameter], outputs: Mapping[str, OutputEntry]
    ) -> dict[str, str]:
        """Which parameter of an effect delays which input or output."""
        key = f"{key}.delay"
        known = [*self.section("inputs"), *outputs]
        entries = self.filled(key, found, "an input or output and a parameter: {force: lag}")
        for target, name in entries.items():
            if target not in known:
                raise self.fail(f"{key}.{target}", f"is no input and no output; {alternatives(target, known)}")
            if name not in parameters:
                raise self.fail(f"{key}.{target}", f"found {short(name)}; {alternatives(name, parameters)}")
            own = parameters[name]
            self.fits(f"{key}.{target}", own.unit.dimension, (0, 0, 1, 0, 0), f"a time, as {name} has to be")
            if own.neutral != 0.0 or not (own.lower == 0.0 and own.upper < math.inf):
                raise self.fail(
                    f"{key}.{target}", f"{name} needs neutral: 0 and a range from 0 on, such as range: [0, 0.1]"
                )
        return {str(target): str(name) for target, name in entries.items()}

    def _alike(self, key: str, entry: Mapping[str, Any], effects: Mapping[str, Any]) -> tuple[str, ...]:
        alike = entry.get("confused_with", [])
        if isinstance(alike, str):
            alike = [alike]
        if not isinstance(alike, list):
            raise self.fail(f"{key}.confused_with", f"found {short(alike)}, expected a list of effects: [offset]")
        for other in alike:
            if other not in effects:
                raise self.fail(f"{key}.confused_with", f"found {short(other)}; {alternatives(other, effects)}")
        return tuple(alike)

    def _effect_parameters(
        self, key: str, found: object, dimensions: Mapping[str, Dimension]
    ) -> dict[str, EffectParameter]:
        key = f"{key}.parameters"
        parameters = {}
        for name, own in self.filled(key, found, "at least one: {level: {unit: N, neutral: 0, scale: 10}}").items():
            where = f"{key}.{name}"
            self.check_name(where, name)
            if name in dimensions:
                raise self.fail(where, "is the name of a state, input or parameter, too; choose another")
            entry = self.entry(where, own, ("unit", "neutral", "scale", "range", "title"))
            parameters[name] = self._effect_parameter(where, entry, dimensions)
        if all(parameter.neutral is None for parameter in parameters.values()):
            raise self.fail(key, "none has neutral:, the value at which the effect changes nothing; add it to one")
        return parameters

    def _effect_parameter(
        self, key: str, entry: Mapping[str, Any], dimensions: Mapping[str, Dimension]
    ) -> EffectParameter:
        unit = self.plant_unit(key, entry)
        lower, upper = self._range(key, entry, unit)
        neutral = self.si(f"{key}.neutral", entry["neutral"], unit) if "neutral" in entry else None
        if neutral is not None and not lower <= neutral <= upper:
            raise self.fail(f"{key}.neutral", f"found {entry['neutral']}, expected within range: {entry['range']}")
        scale_of = None
        if isinstance(entry.get("scale"), str) and not is_number(entry["scale"]):
            scale, scale_of = unit.factor, self.expression(f"{key}.scale", entry["scale"], dimensions)
            found = self.dimension(f"{key}.scale", scale_of, dimensions)
            self.fits(f"{key}.scale", found, unit.dimension, "the unit of what it is the scale of")
        elif "scale" in entry:
            scale = self.si(f"{key}.scale", entry["scale"], unit)
            if scale <= 0.0:
                raise self.fail(f"{key}.scale", f"found {entry['scale']}, expected a size above 0")
        elif math.isfinite(upper - lower):
            scale = math.sqrt(lower * upper) if neutral is None and lower > 0.0 else 0.5 * (upper - lower)
        else:
            raise self.fail(
                key,
                "has neither scale: nor a range: with two ends; give the size that it may well have: scale: 10",
            )
        return EffectParameter(unit, neutral, scale, lower, upper, self._title(key, entry), scale_of)

    def _add(
        self, key: str, found: object,
        known: tuple[Mapping[str, Expr], Mapping[str, OutputEntry], Mapping[str, Dimension]],
    ) -> dict[str, Expr]:  # fmt: skip
        derivatives, outputs, dimensions = known
        key = f"{key}.add"
        add = {}
        expected = "what it adds to derivatives or outputs: {v: -level*sign(v)/mass}"
        for target, own in self.filled(key, found, expected).items():
            where = f"{key}.{target}"
            if target not in derivatives and target not in outputs:
                raise self.fail(where, f"is no state and no output; {alternatives(target, [*derivatives, *outputs])}")
            expression = self.expression(where, own, dimensions)
            dimension = self.dimension(where, expression, dimensions)
            if target in derivatives:
                unit = self.plant_unit(f"states.{target}", self.found["states"][target])
                self.fits(where, dimension, a_second(unit), f"the unit of {target} a second")
            else:
                self.fits(where, dimension, outputs[target].unit.dimension, f"the unit of {target}")
            add[str(target)] = expression
        return add
