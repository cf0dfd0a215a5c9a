"""The one table of valve_node's parameters: names, defaults, units, ranges; declarations and checks follow from it.

Entries `valve.*` come from the model's declared parameters, `effects.*` from its catalogue, `tolerances.*` from both.
Needs no ROS.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from typing import Final, NamedTuple

from valve_sim.files.parameter_files import check_with_off, complete_effect, off_value, valve_from_flat
from valve_sim.files.parameter_sections import Section
from valve_sim.model import CATALOGUE, DECLARED, Parameter, ParameterError, Tolerances, Valve, ValveParameters
from valve_sim.model.gas import FLUIDS, GAS, GasParameters
from valve_sim.model.parameters import closest
from valve_sim.model.tolerances import COVARIANCE_FORM, COVARIANCE_NAME, SENSOR, TOLERATED, tolerance_rule

Value = float | str | list[float]

VALVE_KEYS: Final = ("valve.", "effects.", "tolerances.", "gas.")
"""Prefixes of the parameters that describe a valve, not a node."""

_POLYNOMIAL: Final = "valve.attraction_polynomial"
_TOLERANCES: Final = "tolerances."
_SENSOR: Final = f"{_TOLERANCES}sensor."
_EXACT_COVARIANCE: Final = 16 * (0.0,)
_SETTINGS: Final = (
    (
        Parameter(
            "publish_rate", "Hz", "samples a second of the clock on ~/joint_states, ~/coil and ~/coil_current", 0.1, 1e4
        ),
        1000.0,
    ),
    (
        Parameter("time_scale", "–", "model seconds a second of the clock; below 1 is slow motion", 1e-6, 1e3),
        1.0,
    ),
    (
        Parameter("command_timeout", "s", "without a command for so long, the coil is de-energised; 0: never", 0, 1e6),
        0.0,
    ),
    (
        Parameter("max_voltage", "V", "commands beyond it, either sign, are ignored and counted", 0, 1e4),
        30.0,
    ),
)
_FRAME_ID: Final = "frame_id"
ROS_OWN: Final = ("use_sim_time", "start_type_description_service")
ROS_OWN_PREFIX: Final = "qos_overrides."


class NodeParameter(NamedTuple):
    """One parameter of the node.

    Attributes:
        name: flat, dotted.
        default: gives the type too: float, list of floats, or text.
        description: unit first.
        rule: range and unit; None for text and lists.
    """

    name: str
    default: Value
    description: str
    rule: Parameter | None = None

    @property
    def range(self) -> tuple[float, float] | None:
        """Smallest and largest value that may be declared to ROS; None for none."""
        if self.rule is None or (math.isinf(self.rule.lower) and math.isinf(self.rule.upper)):
            return None
        upper = math.inf if self.rule.off == math.inf else self.rule.upper
        return min(self.rule.lower, off_value(self.rule)), upper

    def check(self, value: object, source: str) -> Value:
        """The value in its own type; an integer may stand for a double.

        Raises:
            ParameterError: wrong type, or out of range.
        """
        where = f"{source}: {self.name}"
        if self.rule is not None:
            return check_with_off(self.rule, value, where)
        if isinstance(self.default, str):
            if not isinstance(value, str):
                raise ParameterError(f"{where}: found {value!r}, expected text")
            return value
        if isinstance(value, str) or not isinstance(value, Sequence):
            raise ParameterError(f"{where}: found {value!r}, expected a list of numbers")
        return [_number(item, f"{where}[{index}]") for index, item in enumerate(value)]


class Settings(NamedTuple):
    """The node's own parameters; units as in the table."""

    publish_rate: float
    time_scale: float
    command_timeout: float
    max_voltage: float
    frame_id: str


def table(default: Valve) -> dict[str, NodeParameter]:
    """Every parameter of the node by name.

    Args:
        default: the valve whose values are the defaults.
    """
    entries = [NodeParameter(rule.name, value, _describe(rule), rule) for rule, value in _SETTINGS]
    entries.append(NodeParameter(_FRAME_ID, "", "header.frame_id of the joint states"))
    entries += _declared_entries(default.parameters)
    entries += _gas_entries(default.gas)
    entries += _effect_entries(default.effects)
    entries += _tolerance_entries(default.tolerances)
    return {entry.name: entry for entry in entries}


def check_overrides(
    overrides: Mapping[str, object], entries: Mapping[str, NodeParameter], sources: Mapping[str, str]
) -> dict[str, Value]:
    """The values at the start: those of `defaults`, replaced by what was given.

    Args:
        overrides: given names and values; those of ROS itself are passed over.
        entries: the table.
        sources: name to the file where it was given; the command line where missing.

    Raises:
        ParameterError: unknown name, wrong type, out of range, or a valve that cannot be.
    """
    values = defaults(entries, overrides)
    for name, value in overrides.items():
        source = sources.get(name, "command line")
        if name in entries:
            values[name] = entries[name].check(value, source)
        elif _is_retired(name):
            complete_effect(name.split(".")[1], {name.split(".")[2]: value}, source)
        elif name not in ROS_OWN and not name.startswith(ROS_OWN_PREFIX):
            refuse_tolerance(name, value, source)
            raise unknown_name(f"{source}: {name}", value, "valve_node", list(entries))
    files = [sources[name] for name in overrides if name in sources and name.startswith(VALVE_KEYS)]
    valve_of(values, files[-1] if files else "command line")
    return values


def defaults(entries: Mapping[str, NodeParameter], given: Collection[str]) -> dict[str, Value]:
    """The default value of every parameter.

    The shipped tolerances are of the shipped valve: where anything of a valve is given, the others are exact, as in a
    parameter file. The sensor is no part of the valve.

    Args:
        entries: the table. given: names.
    """
    keeps_tolerances = not any(name.startswith(VALVE_KEYS) for name in given)

    def is_kept(name: str) -> bool:
        return keeps_tolerances or not name.startswith(_TOLERANCES) or name.startswith(_SENSOR)

    return {name: entry.default if is_kept(name) else _exact(entry.default) for name, entry in entries.items()}


def unknown_name(where: str, value: object, program: str, known: Sequence[str]) -> ParameterError:
    """The error for a parameter that a node does not have.

    Args:
        where: file and name. value: given. program: the node's. known: the names that it has.
    """
    name = where.rpartition(": ")[2]
    return ParameterError(
        f"{where}: found {value!r} under an unknown name; expected a parameter of {program}, "
        f"did you mean {closest(name, known)}?"
    )


def refuse_tolerance(name: str, value: object, source: str) -> None:
    """Refuse a tolerance that is not in the table with the message that a parameter file gets.

    Raises:
        ParameterError: the name is that of a tolerance, and unknown.
    """
    if name.startswith(_TOLERANCES):
        valve_from_flat({name: value}, source, Valve())


def left_without_effect(changes: Mapping[str, object], values: Mapping[str, object]) -> list[str]:
    """The tolerances of effects that a change switches off, but for those that it sets itself.

    Args:
        changes: what is about to be set. values: what is set, of the whole table.
    """
    after = {**values, **changes}
    touched = {name.split(".")[1] for name in changes if name.startswith("effects.")} & CATALOGUE.keys()
    left = []
    for effect in touched:
        names = CATALOGUE[effect].given_names
        found = {name: after[f"effects.{effect}.{name}"] for name in names}
        keys = [f"{_TOLERANCES}effects.{effect}.{name}" for name in names]
        if complete_effect(effect, found, "") is None:
            left += [key for key in keys if values.get(key) and key not in changes]
    return left


def _is_retired(name: str) -> bool:
    """Whether an effect had this parameter in an earlier release."""
    root, _, rest = name.partition(".")
    effect, _, parameter = rest.partition(".")
    return root == "effects" and effect in CATALOGUE and parameter in CATALOGUE[effect].retired


def sources_of(sections: Sequence[tuple[str, Section]], node: str) -> dict[str, str]:
    """Flat name to the file that gave it to this node; a later file wins, as in ROS.

    Args:
        sections: (file, section) in the order of the command line.
        node: full name.
    """
    return {name: path for path, section in sections if section.applies_to(node) for name in section.values}


def files_for_others(sections: Sequence[tuple[str, Section]], node: str) -> dict[str, list[str]]:
    """Files without a section for this node, and the node names that they have."""
    names: dict[str, list[str]] = {}
    for path, section in sections:
        names.setdefault(path, []).append(section.node)
    used = {path for path, section in sections if section.applies_to(node)}
    return {path: found for path, found in names.items() if path not in used}


def valve_of(values: Mapping[str, object], source: str) -> Valve:
    """The valve that the node's values describe.

    Raises:
        ParameterError: they are no valve, such as a gap beyond the stroke.
    """
    of_valve = {name: value for name, value in values.items() if name.startswith(VALVE_KEYS)}
    return valve_from_flat(of_valve, source, Valve())


def settings_of(values: Mapping[str, Value]) -> Settings:
    """The node's own settings among its values."""
    numbers = {rule.name: values[rule.name] for rule, _ in _SETTINGS}
    return Settings(frame_id=str(values[_FRAME_ID]), **numbers)  # type: ignore[arg-type]


def changed_words(before: Mapping[str, Value], after: Mapping[str, Value]) -> str:
    """The parameters that have another value, each with the old one and the new; empty where none has."""
    return ", ".join(f"{name} {before[name]} → {value}" for name, value in after.items() if value != before[name])


def as_declared(name: str, value: object, entries: Mapping[str, NodeParameter]) -> object:
    """An integer where the table has a double, and integers in its list, become doubles; all else is returned as is."""
    if name not in entries:
        return value
    default = entries[name].default
    if isinstance(default, float) and type(value) is int:
        return float(value)
    if isinstance(default, list) and _is_list_of_numbers(value):
        return [float(item) for item in value]  # type: ignore[attr-defined]
    return value


def _is_list_of_numbers(value: object) -> bool:
    return (
        not isinstance(value, str)
        and isinstance(value, Collection)
        and all(type(item) in (int, float) for item in value)
    )


def _declared_entries(parameters: ValveParameters) -> list[NodeParameter]:
    entries = []
    for name, value in parameters._asdict().items():
        if name == "attraction_polynomial":
            words = "[N, N/m, N/m², N/m³] attraction at u = 1: a0 + a1 x + a2 x² + a3 x³"
            entries.append(NodeParameter(_POLYNOMIAL, list(value), words))
        else:
            entries.append(NodeParameter(f"valve.{name}", float(value), _describe(DECLARED[name]), DECLARED[name]))
    return entries


def _gas_entries(gas: GasParameters | None) -> list[NodeParameter]:
    """Of the group `gas`: without it, what must be declared is 0."""
    known = GasParameters._field_defaults if gas is None else gas._asdict()
    entries = [NodeParameter(f"gas.{name}", known.get(name, 0.0), _describe(rule), rule) for name, rule in GAS.items()]
    return [*entries, NodeParameter("gas.fluid", str(known["fluid"]), f"name of the gas: {', '.join(FLUIDS)}")]


def _effect_entries(on: Mapping[str, Mapping[str, float]]) -> list[NodeParameter]:
    entries = []
    for effect in CATALOGUE.values():
        whole, given = effect.given_as_list, on.get(effect.name)
        for rule in effect.parameters:
            if rule.name not in effect.given_names:
                continue
            off = "shapes the effect, does not switch it" if rule.off is None else f"off: {off_value(rule):g}"
            description = f"{_describe(rule)} ({effect.summary}; {off})"
            default = on.get(effect.name, {}).get(rule.name, off_value(rule))
            entries.append(NodeParameter(f"effects.{effect.name}.{rule.name}", default, description, rule))
        if whole is not None:
            items = effect.packed(effect.neutral_values() if given is None else given)[whole.name]
            words = f"[{whole.unit}] {whole.description} ({effect.summary}; off: all 0)"
            entries.append(NodeParameter(f"effects.{effect.name}.{whole.name}", items, words))
    return entries


def _tolerance_entries(tolerances: Tolerances) -> list[NodeParameter]:
    rules = {name: (tolerance_rule(DECLARED[name]), tolerances.declared.get(name, 0.0)) for name in TOLERATED}
    for effect in CATALOGUE.values():
        known = tolerances.effects.get(effect.name, {})
        for parameter in effect.parameters if effect.named else ():
            rules[f"effects.{effect.name}.{parameter.name}"] = tolerance_rule(parameter), known.get(parameter.name, 0.0)
    rules |= {f"gas.{name}": (tolerance_rule(rule), tolerances.gas.get(name, 0.0)) for name, rule in GAS.items()}
    rules |= {f"sensor.{name}": (rule, getattr(tolerances.sensor, name)) for name, rule in SENSOR.items()}
    entries = [
        NodeParameter(f"{_TOLERANCES}{name}", value, _describe(rule), rule) for name, (rule, value) in rules.items()
    ]
    matrix = tolerances.to_mapping().get(COVARIANCE_NAME, list(_EXACT_COVARIANCE))
    entries.append(NodeParameter(f"{_TOLERANCES}{COVARIANCE_NAME}", matrix, f"{COVARIANCE_FORM}; zeros: exact"))
    return entries


def _exact(value: Value) -> Value:
    return len(value) * [0.0] if isinstance(value, list) else 0.0


def _describe(rule: Parameter) -> str:
    return f"[{rule.unit}] {rule.description}"


def _number(value: object, where: str) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ParameterError(f"{where}: found {value!r}, expected a number")
    return float(value)
