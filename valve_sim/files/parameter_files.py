"""ROS 2 parameter files in and out: the same file means the same valve to the node and to the command line.

    /**:
      ros__parameters:
        valve: {pilot_mass: 0.109, ..., attraction_polynomial: [...]}
        effects:
          coulomb_friction: {force: 0.3}
        tolerances: {spring_rate: 12.8, effects: {coulomb_friction: {force: 0.05}}}
        gas: {inlet_pressure: 35.0e+6, outlet_volume: 10.0e-6, ...}

Read are all the forms that ROS 2 itself reads: `/**`, wildcards, node names with and without slash, namespaces nested
or joined, flat dotted keys (`valve.pilot_mass: 0.109`), and what `ros2 param dump` writes. Beyond these, an integer
may stand for a double (also among doubles in a list) and 1e-3 is a number.
The nodes leave their files to ROS 2, which refuses a list of both, and say so.

Four rules make a file complete:

* A valve parameter that is not given has the value of the shipped default, config/valve.yaml.
* An effect's parameter that is not given has its off-value, or its prior scale if it has none. An effect is on when
  one of its parameters differs from its off-value; so a dump, which lists every effect, switches on only what was on.
* A tolerance that is not given, or 0, means that the value is exact. Those of the shipped default are its own.
* Without `gas`, or with a `gas.inlet_pressure` of 0, as a dump has it, no gas flows.
"""

from __future__ import annotations

import difflib
import functools
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import yaml

from valve_sim.files.entries import short
from valve_sim.files.parameter_sections import (
    DEFAULT_FILE,
    FORM,
    ROOT_KEYS,
    Dumper,
    default_values,
    is_a_name,
    read_sections,
)
from valve_sim.files.resources import config_path
from valve_sim.files.whole_files import write_whole
from valve_sim.model import CATALOGUE, Effect, Parameter, ParameterError, Valve, ValveParameters
from valve_sim.model.gas import GAS, GasParameters
from valve_sim.model.parameters import closest
from valve_sim.model.tolerances import COVARIANCE_NAME

ANY_VALVE: Final = "/valve"
"""The name of a valve that nobody has named."""
SOFTEST: Final = 10.0
"""N/m; a softer spring of a solenoid valve would add a hundredth of a newton over a millimetre."""
OF_ONE_PLUNGER: Final = (
    "moving_mass", "stroke", "main_damping", "spring_rate", "spring_preload", "attraction_polynomial",
    "reference_voltage", "coil_resistance", "coil_time_constant",
)  # fmt: skip
"""What a valve with one plunger has nothing of in common with the shipped one."""


def load_valve(path: Path | str, node: str | None = None) -> Valve:
    """The valve that a parameter file describes.

    Keys beside `valve` and `effects` belong to nodes and are ignored.

    Args:
        path: a ROS 2 parameter file.
        node: full name of the node whose parameters are meant; needed only where a file describes several valves.

    Raises:
        ParameterError: the file cannot be read, or anything in it about the valve is unknown, of the wrong type or
            out of range; one line that names file, key, what was found and what is expected.
    """
    candidates = [section for section in read_sections(path) if node is None or section.applies_to(node)]
    sections = [section for section in candidates if section.is_about_valve]
    if not sections:
        for section in candidates:
            valve_from_flat(section.values, str(path))  # perhaps a name is only in the wrong place
        meant = "" if node is None else f" of {node}"
        raise ParameterError(f"{path}: holds no parameters{meant} of a valve; {FORM}")
    named = sorted({section.node for section in sections if "*" not in section.node})
    if len(named) > 1:
        raise ParameterError(f"{path}: describes several valves, {', '.join(named)}; expected one, or a node's name")
    merged = {name: value for section in sections for name, value in section.values.items()}
    _check_plausible(merged, str(path))
    return valve_from_flat(merged, str(path))


def load_recorded_valve(path: Path | str, recorded: str | None) -> Valve:
    """The valve that a parameter file describes for a recording: what the node of the recorded valve's name would take.

    Args:
        path: a ROS 2 parameter file.
        recorded: the valve's name in the recording; None or `/valve`, which is everybody's: the only one described.

    Raises:
        ParameterError: as `load_valve`, or it describes another valve only.
    """
    name = "/" + (recorded or ANY_VALVE).strip("/")
    sections = [section for section in read_sections(path) if section.is_about_valve]
    if any(section.applies_to(name) for section in sections):
        return load_valve(path, name)
    named = sorted({section.node for section in sections})
    if named and name != ANY_VALVE:
        raise ParameterError(f"{path}: describes {', '.join(named)}, expected {name}, which was recorded, or /**")
    return load_valve(path)


def _check_plausible(values: Mapping[str, object], source: str) -> None:
    """Refuse what passes every range and means something else: a spring in N/mm, a valve that has little of its own."""
    rate = values.get("valve.spring_rate")
    if isinstance(rate, int | float) and not isinstance(rate, bool) and 0.0 < rate < SOFTEST:
        raise ParameterError(
            f"{source}: valve.spring_rate: found {rate:g} N/m, expected 0 or at least {SOFTEST:g} N/m; "
            f"{rate:g} N/mm are {1e3 * rate:g} N/m"
        )
    missing = [name for name in OF_ONE_PLUNGER if f"valve.{name}" not in values]
    if values.get("valve.pilot_gap") == 0 and missing:
        raise ParameterError(
            f"{source}: valve.pilot_gap: found 0, a valve with one plunger, without valve.{', valve.'.join(missing)}; "
            "expected them, for the defaults are those of a valve with two (docs/how_to/single_plunger.md)"
        )


def valve_from_flat(values: Mapping[str, object], source: str, base: Valve | None = None) -> Valve:
    """A checked valve from flat dotted names.

    Args:
        values: such as {"valve.pilot_mass": 0.109, "effects.stiction.force": 0.3}; other nodes' names are ignored.
        source: the file or node they come from, for messages.
        base: has the values that are not given, tolerances apart; default: the shipped config/valve.yaml.

    Raises:
        ParameterError: as `load_valve`.
    """
    mapping = (base or default_valve()).to_mapping()
    declared: dict[str, object] = dict(mapping["valve"])
    effects: dict[str, dict[str, object]] = {name: dict(found) for name, found in mapping.get("effects", {}).items()}
    tolerances: dict[str, Any] = {}
    gas: dict[str, object] = dict(mapping.get("gas", {}))
    for name, value in values.items():
        root, _, rest = name.partition(".")
        if is_a_name(name, value):
            continue
        if name in (COVARIANCE_NAME, f"valve.{COVARIANCE_NAME}"):
            raise ParameterError(f"{source}: {name}: found {short(value)}, expected it as tolerances.{COVARIANCE_NAME}")
        if root == "valve":
            _check_name(rest, ValveParameters._fields, name, value, source)
            declared[rest] = value
        elif root == "effects":
            effect, _, parameter = rest.partition(".")
            _check_effect_name(effect, parameter, name, value, source)
            effects.setdefault(effect, {})[parameter] = value
        elif root == "gas":
            _check_name(rest, GasParameters._fields, name, value, source)
            gas[rest] = value
        elif root == "tolerances":
            add_tolerance(tolerances, name, value, source)
        else:
            _check_misplaced(name, value, source)
    on = {name: checked for name, found in effects.items() if (checked := complete_effect(name, found, source))}
    flows = gas if gas.get("inlet_pressure") != 0 else {}
    return Valve.from_mapping({"valve": declared, "effects": on, "tolerances": tolerances, "gas": flows}, source)


def complete_effect(name: str, found: Mapping[str, object], source: str) -> dict[str, float] | None:
    """All parameters of an effect of which some are given; None when they leave it off.

    Args:
        name: of an effect in the catalogue.
        found: its parameters by name, as given.
        source: the file or node they come from, for messages.

    Raises:
        ParameterError: not a number, or out of range.
    """
    effect = CATALOGUE[name]
    given = effect.unpacked(found, f"{source}: effects.{name}")
    values = {
        parameter.name: check_with_off(parameter, given[parameter.name], f"{source}: effects.{name}.{parameter.name}")
        if parameter.name in given
        else off_value(parameter)
        for parameter in effect.parameters
    }
    return values if is_on(effect, values) else None


def is_on(effect: Effect, values: Mapping[str, float]) -> bool:
    """Whether any of the effect's parameters differs from its off-value."""
    return any(
        parameter.off is not None and values[parameter.name] != off_value(parameter) for parameter in effect.parameters
    )


def off_value(parameter: Parameter) -> float:
    """The value of an effect's parameter that is not given: its off-value, or its prior scale if it has none."""
    return parameter.neutral if parameter.not_declared is None else parameter.not_declared


def check_with_off(parameter: Parameter, value: object, where: str) -> float:
    """Check a value like `Parameter.check`, and accept the off-value too, which may be infinite.

    Raises:
        ParameterError: not a number, or neither the off-value nor in range.
    """
    if isinstance(value, float) and value in (parameter.off, parameter.not_declared):
        return value
    return parameter.check(value, where)


@functools.cache
def default_valve() -> Valve:
    """The valve of config/valve.yaml.

    Raises:
        ValveError: the installation lacks the file.
    """
    return valve_from_flat(default_values(), str(config_path(DEFAULT_FILE)), Valve())


def save_valve(path: Path | str, valve: Valve, provenance: str) -> None:
    """Write a parameter file, whole or not at all.

    Args:
        path: the file, replaced if it exists.
        valve: the valve to write.
        provenance: where the values are from; becomes a comment at the top.

    Raises:
        ParameterError: the file cannot be written.
    """
    comment = "".join(f"# {line}".rstrip() + "\n" for line in provenance.splitlines())
    document = {"/**": {"ros__parameters": _plain(valve.to_mapping())}}
    text = comment + yaml.dump(document, Dumper=Dumper, sort_keys=False, allow_unicode=True, width=120)
    write_whole(Path(path), text, ParameterError)


def _plain(value: Any) -> Any:
    """The value as mappings, lists and floats, without types of NumPy."""
    if isinstance(value, Mapping):
        return {name: _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value if isinstance(value, str) else float(value)


# --- tolerances ---------------------------------------------------------------------------------------------------


def add_tolerance(tolerances: dict[str, Any], key: str, value: object, source: str) -> None:
    """Put a flat name's tolerance where `Tolerances.from_mapping` looks for it.

    Args:
        tolerances: the group; changed. key: such as "tolerances.stroke". value, source: as found, and where.

    Raises:
        ParameterError: the name is that of a group, not of a value.
    """
    name = key.partition(".")[2]
    if not name:
        raise ParameterError(f"{source}: {key}: found {short(value)}, expected names of declared values below it")
    group, dot, rest = name.partition(".")
    if group in ("gas", "sensor"):
        if not dot:
            raise ParameterError(f"{source}: {key}: found {short(value)}, expected tolerances.{group}.<name>")
        tolerances.setdefault(group, {})[rest] = value
        return
    if group != "effects":
        tolerances[name] = value
        return
    effect, dot, parameter = rest.partition(".")
    if not dot:
        raise ParameterError(f"{source}: {key}: found {short(value)}, expected tolerances.effects.<effect>.<parameter>")
    tolerances.setdefault("effects", {}).setdefault(effect, {})[parameter] = value


# --- names --------------------------------------------------------------------------------------------------------


def _check_name(given: str, known: Sequence[str], key: str, value: object, source: str) -> None:
    if given not in known:
        mend = f"; did you mean {closest(given, known)}?" if given else ""
        names = ", ".join(known)
        raise ParameterError(
            f"{source}: {key}: found {short(value)} under an unknown name{mend} Expected one of {names}"
        )


def _check_effect_name(effect: str, parameter: str, key: str, value: object, source: str) -> None:
    _check_name(effect, list(CATALOGUE), key, value, source)
    names = CATALOGUE[effect].given_names
    if not parameter:
        raise ParameterError(f"{source}: {key}: found {short(value)}, expected {{{', '.join(names)}}}")
    if parameter not in CATALOGUE[effect].retired:
        _check_name(parameter, names, key, value, source)


def _check_misplaced(name: str, value: object, source: str) -> None:
    """Accept names of other nodes, but none that look like a misplaced or misspelt name of the valve."""
    root = name.partition(".")[0]
    if root in ValveParameters._fields:
        raise ParameterError(
            f"{source}: {name}: found {short(value)} beside valve:, expected it below, as valve.{name}"
        )
    if root in GAS:
        raise ParameterError(f"{source}: {name}: found {short(value)} beside gas:, expected it below, as gas.{name}")
    if root in CATALOGUE:
        raise ParameterError(f"{source}: {name}: found {short(value)} beside effects:, expected it as effects.{name}")
    for known in ROOT_KEYS:
        if "." in name and _are_alike(root, known):
            raise ParameterError(f"{source}: {name}: found {short(value)} below {root}:, expected {known}:")


def _are_alike(name: str, known: str) -> bool:
    return difflib.SequenceMatcher(None, name.lower(), known).ratio() >= 0.75
