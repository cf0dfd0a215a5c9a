"""The tables of parameters of identification_node and monitor_node, and what holds between them.

Needs no ROS. All are read once, at the start.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Final, NamedTuple

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.identify import check_free
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.plants.valve import DAMPINGS
from valve_sim.model import Parameter, ParameterError
from valve_sim.nodes.parameters import NodeParameter, Value, Words, check_given, settings_of, table_of
from valve_sim.nodes.valve_parameters import VALVE_KEYS, check_with_valve, valve_table
from valve_sim.nodes.valve_parameters import Settings as ValveNodeSettings

MODES: Final = ("identify", "diagnose")
_MICRO: Final = 1e-6
_USUAL: Final = MonitorSettings()


class IdentificationSettings(NamedTuple):
    """Of identification_node; the table says what each means."""

    bag: str = ""
    map: str = ""
    valve_name: str = ""
    params: str = ""
    free: tuple[str, ...] = DAMPINGS
    rate: float = 1.0
    loop: bool = False
    apply_to: str = ""
    apply_always: bool = False
    output: str = "."
    linger: bool = False
    mode: str = MODES[0]
    budget: float = 120.0


IDENTIFICATION: Final = table_of(
    IdentificationSettings,
    Words("bag", "the recording: a rosbag2 folder, an .mcap file, or with `map` a table"),
    Words("map", "file that says which topic or column of the recording is what; empty: those of this package"),
    Words("valve_name", "which valve of the recording, such as /tank_1/valve; needed only where it holds several"),
    Words("params", "parameter file of the declared valve; empty: the shipped one"),
    Words(
        "free",
        "parameters to refit (mode identify), such as pilot_damping or coulomb_friction.force; of a valve with one "
        "plunger the default is main_damping alone",
    ),
    Parameter("rate", "–", "replay: 1 as recorded, 2 twice as fast, 0 as fast as possible", 0.0, math.inf),
    Words("loop", "whether the replay begins anew at its end"),
    Words("apply_to", "running valve node that is given the result, if nothing speaks against it; empty: none"),
    Words("apply_always", "whether apply_to is given a result that something speaks against, too"),
    Words(
        "output",
        "folder of identified.yaml (diagnose: corrected.yaml, record_next.yaml) and before.yaml, as apply_to was",
    ),
    Words("linger", "whether the node stays when all is done, for ~/undo and late subscribers"),
    Words("mode", "identify: refit `free`; diagnose: find the effect that the declared valve lacks", MODES),
    Parameter(
        "budget", "s", "work that a diagnosis may do, 4000 simulated strokes a second; it says what was left untried",
        1.0, math.inf,
    ),
)  # fmt: skip


def identification_settings(given: Mapping[str, object], sources: Mapping[str, str]) -> IdentificationSettings:
    """The settings to start with; arguments and errors as of `check_given`."""
    for name in given:
        if name.startswith(VALVE_KEYS):
            where = f"{sources.get(name, 'command line')}: {name}"
            raise ParameterError(f"{where}: belongs to a valve; give the file's name as the parameter params instead")
    if isinstance(names := given.get("free"), str):
        given = {**given, "free": names.split(",")}
    settings = settings_of(IdentificationSettings, check_given(given, IDENTIFICATION, sources, "identification_node"))
    settings = settings._replace(free=tuple(dict.fromkeys(settings.free)))
    check_free(settings.free)
    if not settings.bag:
        raise ParameterError("bag: not given; expected a rosbag2 folder or an .mcap file (-p bag:=FILE)")
    return settings


class MonitorNodeSettings(NamedTuple):
    """Of monitor_node, beside the valve that it declares; the table says what each means."""

    valve_node: str = "valve"
    measured: str = "measured/joint_states"
    map: str = ""
    frame_id: str = ""
    state: str = ""
    calibration: str = ""
    commissioning_strokes: int = _USUAL.commissioning_strokes
    diagnosis_strokes: int = _USUAL.diagnosis_strokes
    strokes_between_false_alarms: float = _USUAL.strokes_between_false_alarms
    stroke_timeout: float = _USUAL.stroke_timeout
    settle: float = _USUAL.settle
    patience: float = _USUAL.patience
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


MONITOR: Final = table_of(
    MonitorNodeSettings,
    Words("valve_node", "node whose topics are heard, relative to this node's namespace"),
    Words(
        "measured",
        "topic of the measured positions below it, or of the coil (measured/coil): the current alone; joint_states and "
        "coil: a simulated valve's",
    ),
    Words("map", "file that says which topics, fields and units those of the valve are; empty: those of this package"),
    Words("frame_id", "header.frame_id of the predicted joint states"),
    Words("state", "file that keeps what commissioning found, for the next start; empty: none"),
    Words(
        "calibration",
        "calibration.json of `valve-sim commission`: it is said when that has expired, and what the declared valve has "
        "otherwise is appended to its journal; empty: none",
    ),
    Parameter("commissioning_strokes", "–", "number of first strokes, taken as the baseline", 8, 1000),
    Parameter("diagnosis_strokes", "–", "number of last strokes kept to trace a cause", 6, 200),
    Parameter("strokes_between_false_alarms", "–", "mean number of strokes of a healthy valve between alarms", 10, 1e9),
    Parameter("stroke_timeout", "s", "a stroke that has not ended by then is", 0.1, 1e6),
    Parameter("settle", "s", "of rest, after which a stroke has ended", 5e-3, 100.0),
    Parameter("patience", "s", "a valve that is later than the model by more is said to be stuck", 1e-3, 1e3),
    Parameter("noise_um", "µm", "standard deviation of the position sensor; 0: estimated", 0.0, 1e4),
    Parameter("max_rate", "Hz", "messages a second, at most, on predicted/joint_states and residual", 0.1, 1e5),
)
"""Of the node alone; `monitor_table` has the valve beside them."""
MONITORS_FORMER_NAMES: Final = {"valve": "valve_node"}
"""ROS 2 loses a `valve` given before a file with `valve: {...}`, and cannot dump it beside `valve.pilot_mass`."""


def monitor_table() -> dict[str, NodeParameter]:
    """Every parameter of monitor_node by name."""
    return {**MONITOR, **valve_table(default_valve(), read_only=True)}


def monitor_values(given: Mapping[str, object], sources: Mapping[str, str]) -> dict[str, Value]:
    """The values to start with; arguments and errors as of `check_with_valve`.

    One parameter file may serve valve_node and its monitor: the settings of the former are passed over.
    """
    own = {name: value for name, value in given.items() if name in MONITOR or name not in ValveNodeSettings._fields}
    places = {MONITORS_FORMER_NAMES.get(name, name): place for name, place in sources.items()}
    return check_with_valve(own, monitor_table(), places, "monitor_node")
