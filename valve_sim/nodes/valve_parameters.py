"""The table of valve_node's parameters: its settings, and the valve. Needs no ROS.

Entries `valve.*` and `gas.*` come from the model's declared parameters, `effects.*` from its catalogue, and
`tolerances.*`, of which 0 means exact, from both.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from valve_sim.files.parameter_files import complete_effect, default_valve, off_value, valve_from_flat
from valve_sim.model import CATALOGUE, DECLARED, Effect, Parameter, Valve, ValveParameters
from valve_sim.model.gas import FLUIDS, GAS, GasParameters
from valve_sim.model.tolerances import COVARIANCE_FORM, COVARIANCE_NAME, SENSOR, TOLERATED, Tolerances, tolerance_rule
from valve_sim.nodes.parameters import VALVE_KEYS, NodeParameter, NodeSettings, Table, Value, check_given, option


@dataclass(frozen=True)
class ValveSettings(NodeSettings):
    """The node's own parameters, beside its valve."""

    program = "valve_node"
    has_valve = True

    publish_rate: float = option(
        1000.0,
        "samples a second of the clock on ~/joint_states, ~/coil and ~/coil_current", "Hz", 0.1, 1e4, read_only=False,
    )  # fmt: skip
    time_scale: float = option(
        1.0, "model seconds a second of the clock; below 1 is slow motion", "–", 1e-6, 1e3, read_only=False
    )
    command_timeout: float = option(
        0.0, "time without a command after which the coil is de-energised; 0: never", "s", 0, 1e6, read_only=False
    )
    max_voltage: float = option(
        30.0, "commands beyond it, either sign, are ignored and counted", "V", 0, 1e4, read_only=False
    )
    frame_id: str = option("", "header.frame_id of the joint states", read_only=False)
    plant: str = option("", "plant file of a machine of your own, in place of the valve; empty: the valve")

    @classmethod
    def table(cls) -> dict[str, NodeParameter]:
        """Every parameter of valve_node by name; the defaults are the shipped valve."""
        return {**cls.rows(), **valve_table(default_valve())}

    @classmethod
    def values(cls, given: Mapping[str, object], sources: Mapping[str, str]) -> dict[str, Value]:
        """The values at the start; arguments and errors: see `check_with_valve`."""
        return check_with_valve(given, cls.table(), sources, cls.program)


def valve_table(default: Valve, *, read_only: bool = False) -> dict[str, NodeParameter]:
    """The parameters that describe a valve, by name.

    Args:
        default: the valve whose values are the defaults. read_only: whether they are read once.
    """
    entries = [
        *_declared_entries(default.parameters),
        *_gas_entries(default.gas),
        *_effect_entries(default.effects),
        *_tolerance_entries(default.tolerances),
    ]
    return {entry.name: entry._replace(read_only=read_only) for entry in entries}


def check_with_valve(
    given: Mapping[str, object], entries: Table, sources: Mapping[str, str], program: str
) -> dict[str, Value]:
    """The values at the start of a node whose table has a valve, replaced by what was given.

    Args:
        given: flat names and values; those of ROS itself are passed over.
        entries: the table.
        sources: name to the file where it was given; the command line where missing.
        program: the node's, for messages.

    Raises:
        ParameterError: unknown name, wrong type, out of range, or a valve that cannot be.
    """
    others: dict[str, object] = {}
    for name, value in given.items():
        if _is_retired(name):
            _, effect, parameter = name.split(".")
            complete_effect(effect, {parameter: value}, sources.get(name, "command line"))
        else:
            others[name] = value
    values = check_given(others, entries, sources, program, _defaults(entries, given))
    files = [sources[name] for name in given if name in sources and name.startswith(VALVE_KEYS)]
    of_tolerances = [sources[name] for name in given if name in sources and name.startswith("tolerances.")]
    valve_of(values, (of_tolerances or files or ["command line"])[-1])
    return values


def valve_of(values: Mapping[str, object], source: str) -> Valve:
    """The valve that the node's values describe.

    Raises:
        ParameterError: they are no valve, such as a gap beyond the stroke.
    """
    of_valve = {name: value for name, value in values.items() if name.startswith(VALVE_KEYS)}
    return valve_from_flat(of_valve, source, Valve())


def unit_of(name: str) -> str:
    """The unit of a parameter, SI, empty where it has none.

    Args:
        name: as a node has it, valve.spring_rate or effects.stiction.force, or without the first word.
    """
    for root in ("tolerances.", "effects.", "valve."):
        name = name.removeprefix(root)
    group, _, own = name.rpartition(".")
    effect = CATALOGUE.get(group)
    rules = GAS if group == "gas" else DECLARED
    known = rules if effect is None else {rule.name: rule for rule in effect.parameters}
    unit = known[own].unit if own in known else ""
    return "" if unit == "–" else unit


def without_orphans(changes: Mapping[str, Any], values: Mapping[str, Value]) -> dict[str, Any]:
    """Changes, and 0 for the tolerances of each effect that they switch off and do not give a tolerance themselves.

    Args:
        changes: what is about to be set. values: what is set, of the whole table.

    Raises:
        ParameterError: an effect that is changed cannot be read.
    """
    after, orphans = {**values, **changes}, dict[str, Any]()
    for effect in {name.split(".")[1] for name in changes if name.startswith("effects.")} & CATALOGUE.keys():
        found = {name: after[f"effects.{effect}.{name}"] for name in CATALOGUE[effect].given_names}
        if complete_effect(effect, found, "") is None:
            orphans |= {name: 0.0 for name in values if name.startswith(f"tolerances.effects.{effect}.")}
    return {**orphans, **changes}


def _defaults(entries: Table, given: Collection[str]) -> dict[str, Value]:
    """The default value of every parameter.

    The shipped tolerances are of the shipped valve: where anything of a valve is given, all others are exact, as in a
    parameter file.
    """
    values = {name: entry.default for name, entry in entries.items()}
    if not any(name.startswith(VALVE_KEYS) for name in given):
        return values
    return values | {entry.name: entry.default for entry in _tolerance_entries(Tolerances())}


def _is_retired(name: str) -> bool:
    """Whether an effect had this parameter in an earlier release."""
    root, _, rest = name.partition(".")
    effect, _, parameter = rest.partition(".")
    return root == "effects" and effect in CATALOGUE and parameter in CATALOGUE[effect].retired


def _of(name: str, default: float, rule: Parameter, words: str = "") -> NodeParameter:
    return NodeParameter(name, default, rule.description + words, rule.unit, rule)


def _declared_entries(parameters: ValveParameters) -> list[NodeParameter]:
    entries = []
    for name, value in parameters._asdict().items():
        if name == "attraction_polynomial":
            words = "attraction at u = 1: a0 + a1 x + a2 x² + a3 x³"
            entries.append(NodeParameter(f"valve.{name}", list(value), words, "N, N/m, N/m², N/m³"))
        else:
            entries.append(_of(f"valve.{name}", float(value), DECLARED[name]))
    return entries


def _gas_entries(gas: GasParameters | None) -> list[NodeParameter]:
    """Of the group `gas`: without it, what must be declared is 0."""
    known = GasParameters._field_defaults if gas is None else gas._asdict()
    entries = [_of(f"gas.{name}", known.get(name, 0.0), rule) for name, rule in GAS.items()]
    return [*entries, NodeParameter("gas.fluid", str(known["fluid"]), f"name of the gas: {', '.join(FLUIDS)}")]


def _effect_entries(on: Mapping[str, Mapping[str, float]]) -> list[NodeParameter]:
    entries = []
    for effect in CATALOGUE.values():
        whole, given = effect.given_as_list, on.get(effect.name)
        for rule in effect.parameters:
            if rule.name not in effect.given_names:
                continue
            off = "shapes the effect, does not switch it" if rule.off is None else f"off: {off_value(rule):g}"
            default = on.get(effect.name, {}).get(rule.name, off_value(rule))
            entries.append(_of(f"effects.{effect.name}.{rule.name}", default, rule, f" ({effect.summary}; {off})"))
        if whole is not None:
            items = effect.packed(effect.neutral_values() if given is None else given)[whole.name]
            words = f"{whole.description} ({effect.summary}; off: all 0)"
            entries.append(NodeParameter(f"effects.{effect.name}.{whole.name}", items, words, whole.unit))
    return entries


def _tolerance_entries(known: Tolerances) -> Iterator[NodeParameter]:
    for name in TOLERATED:
        yield _tolerance(name, DECLARED[name], known.declared)
    covariance = [number for row in known.attraction_covariance or ((0.0,) * 4,) * 4 for number in row]
    yield NodeParameter(f"tolerances.{COVARIANCE_NAME}", covariance, COVARIANCE_FORM)
    for effect in _with_tolerances():
        for rule in effect.parameters:
            yield _tolerance(f"effects.{effect.name}.{rule.name}", rule, known.effects.get(effect.name, {}), rule.name)
    for name, rule in GAS.items():
        yield _tolerance(f"gas.{name}", rule, known.gas, name)
    for name, rule in SENSOR.items():
        yield _of(f"tolerances.sensor.{name}", getattr(known.sensor, name), rule)


def _with_tolerances() -> Iterator[Effect]:
    return (effect for effect in CATALOGUE.values() if effect.named)


def _tolerance(name: str, rule: Parameter, known: Mapping[str, float], key: str = "") -> NodeParameter:
    return _of(f"tolerances.{name}", known.get(key or name, 0.0), tolerance_rule(rule))
