"""The one table of monitor_node's parameters: its own settings, and the valve that it declares. Needs no ROS."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.model import Parameter, ParameterError, Valve
from valve_sim.nodes.parameters import (
    VALVE_KEYS,
    NodeParameter,
    Value,
    defaults,
    refuse_tolerance,
    table,
    unknown_name,
    valve_of,
)
from valve_sim.nodes.parameters import Settings as ValveNodeSettings

_MICRO: Final = 1e-6
_DEFAULTS: Final = MonitorSettings()
_OF_VALVE_NODE: Final = ValveNodeSettings._fields
"""One parameter file may serve valve_node and its monitor."""
FORMER_NAMES: Final = {"valve": "valve_node"}
"""ROS 2 loses a `valve` given before a file with `valve: {...}`, and cannot dump it beside `valve.pilot_mass`."""

_TEXTS: Final = {
    "valve_node": ("valve", "node whose topics are heard, relative to this node's namespace"),
    "measured": (
        "measured/joint_states",
        "topic of the measured positions below it, or of the coil (measured/coil): the current alone; joint_states and "
        "coil: a simulated valve's",
    ),
    "map": ("", "file that says which topics, fields and units those of the valve are; empty: those of this package"),
    "frame_id": ("", "header.frame_id of the predicted joint states"),
    "state": ("", "file that keeps what commissioning found, for the next start; empty: none"),
}
_COUNTS: Final = {
    "commissioning_strokes": Parameter(
        "commissioning_strokes", "–", "number of first strokes, taken as the baseline", 8, 1000
    ),
    "diagnosis_strokes": Parameter("diagnosis_strokes", "–", "number of last strokes kept to trace a cause", 6, 200),
}
_NUMBERS: Final = {
    "strokes_between_false_alarms": Parameter(
        "strokes_between_false_alarms", "–", "mean number of strokes of a healthy valve between alarms", 10, 1e9
    ),
    "stroke_timeout": Parameter("stroke_timeout", "s", "a stroke that has not ended by then is", 0.1, 1e6),
    "settle": Parameter("settle", "s", "of rest, after which a stroke has ended", 5e-3, 100.0),
    "patience": Parameter(
        "patience", "s", "a valve that is later than the model by more is said to be stuck", 1e-3, 1e3
    ),
    "noise_um": Parameter("noise_um", "µm", "standard deviation of the position sensor; 0: estimated", 0.0, 1e4),
    "max_rate": Parameter(
        "max_rate", "Hz", "messages a second, at most, on predicted/joint_states and residual", 0.1, 1e5
    ),
}


class Settings(NamedTuple):
    """The parameters that are the node's own; units as in the table."""

    valve_node: str = _TEXTS["valve_node"][0]
    measured: str = _TEXTS["measured"][0]
    map: str = _TEXTS["map"][0]
    frame_id: str = _TEXTS["frame_id"][0]
    state: str = _TEXTS["state"][0]
    commissioning_strokes: int = _DEFAULTS.commissioning_strokes
    diagnosis_strokes: int = _DEFAULTS.diagnosis_strokes
    strokes_between_false_alarms: float = _DEFAULTS.strokes_between_false_alarms
    stroke_timeout: float = _DEFAULTS.stroke_timeout
    settle: float = _DEFAULTS.settle
    patience: float = _DEFAULTS.patience
    noise_um: float = 0.0
    max_rate: float = 1000.0

    @property
    def monitor(self) -> MonitorSettings:
        """The settings of the monitor, in SI."""
        return MonitorSettings(
            self.commissioning_strokes,
            self.strokes_between_false_alarms,
            self.diagnosis_strokes,
            self.stroke_timeout,
            self.settle,
            self.noise_um * _MICRO,
            self.patience,
        )


class Given(NamedTuple):
    """The values at the start: settings, declared valve, and every parameter by its flat name."""

    settings: Settings
    valve: Valve
    values: dict[str, Value | int]


def descriptions() -> dict[str, str]:
    """Flat name to what the parameter means, unit first."""
    own = {name: words for name, (_, words) in _TEXTS.items()}
    own.update({name: f"[{rule.unit}] {rule.description}" for name, rule in {**_COUNTS, **_NUMBERS}.items()})
    return {**own, **{entry.name: entry.description for entry in _valve_entries().values()}}


def check_given(given: Mapping[str, object], sources: Mapping[str, str], source: str) -> Given:
    """The values at the start: defaults, replaced by what was given.

    Args:
        given: flat names and values; those of ROS itself left out.
        sources: name to the file where it was given; the command line where missing.
        source: of the valve as a whole, for messages.

    Raises:
        ParameterError: unknown name, wrong type, out of range, or a valve that cannot be; one line.
    """
    entries = _valve_entries()
    valve_values = defaults(entries, given)
    own: dict[str, object] = {}
    places = {FORMER_NAMES.get(name, name): place for name, place in sources.items()}
    for name, value in given.items():
        where = places.get(name, "command line")
        if name in entries:
            valve_values[name] = entries[name].check(value, where)
        elif name in Settings._fields:
            own[name] = _checked(name, value, f"{where}: {name}")
        elif name not in _OF_VALVE_NODE:
            refuse_tolerance(name, value, where)
            known = [*Settings._fields, *entries]
            raise unknown_name(f"{where}: {name}", value, "monitor_node", known)
    settings = Settings(**own)  # type: ignore[arg-type]
    return Given(settings, valve_of(valve_values, source), {**settings._asdict(), **valve_values})


def _valve_entries() -> dict[str, NodeParameter]:
    return {name: entry for name, entry in table(default_valve()).items() if name.startswith(VALVE_KEYS)}


def _checked(name: str, value: object, where: str) -> object:
    if name in _TEXTS:
        if not isinstance(value, str):
            raise ParameterError(f"{where}: found {value!r}, expected text")
        return value
    if name in _COUNTS:
        if isinstance(value, bool) or not isinstance(value, int):
            raise ParameterError(f"{where}: found {value!r}, expected a whole number")
        return int(_COUNTS[name].check(value, where))
    return _NUMBERS[name].check(value, where)
