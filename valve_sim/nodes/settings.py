"""The parameters of identification_node and monitor_node, and what holds between them.

Needs no ROS. All are read once, at the start.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Final

from valve_sim.files.entries import short
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.identify import check_free
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.plants.valve_model import DAMPINGS
from valve_sim.model import ParameterError
from valve_sim.nodes.parameters import VALVE_KEYS, NodeParameter, NodeSettings, Value, option
from valve_sim.nodes.valve_parameters import check_with_valve, valve_table

MODES: Final = ("identify", "diagnose")
_MICRO: Final = 1e-6
_USUAL: Final = MonitorSettings()


@dataclass(frozen=True)
class IdentificationSettings(NodeSettings):
    """Of identification_node."""

    program = "identification_node"

    bag: str = option("", "the recording: a rosbag2 folder, an .mcap file, or with `map` a table")
    map: str = option("", "map of the recording's topics or columns; empty: those of this package")
    valve_name: str = option("", "valve of the recording, such as /tank_1/valve; needed only if it contains several")
    params: str = option("", "parameter file of the declared valve; empty: the shipped one")
    free: tuple[str, ...] = option(
        DAMPINGS,
        "parameters to refit (mode identify), such as pilot_damping or coulomb_friction.force; of a valve with one "
        "plunger the default is main_damping alone",
    )
    rate: float = option(1.0, "replay: 1 as recorded, 2 twice as fast, 0 as fast as possible", "–", 0.0)
    loop: bool = option(False, "whether the replay starts again at its end")
    apply_to: str = option("", "running valve node that receives the result if all checks pass; empty: none")
    apply_always: bool = option(False, "whether apply_to receives the result even if a check fails")
    output: str = option(
        ".",
        "folder of identified.yaml (diagnose: corrected.yaml, record_next.yaml) and before.yaml, as apply_to was",
    )
    linger: bool = option(False, "whether the node stays when all is done, for late subscribers")
    mode: str = option(
        MODES[0], "identify: refit `free`; diagnose: find the effect that the declared valve lacks", choices=MODES
    )
    budget: float = option(120.0, "work that a diagnosis may do: 4000 simulated strokes for each second", "s", 1.0)

    @classmethod
    def passes_over(cls, name: str, given: Mapping[str, object]) -> bool:
        """See `NodeSettings`; a valve beside it is refused, unless it is declared by `params`."""
        return super().passes_over(name, given) and ("params" in given or not name.startswith(VALVE_KEYS))

    @classmethod
    def read(cls, given: Mapping[str, object], sources: Mapping[str, str]) -> IdentificationSettings:
        """The settings at the start; names of `free` may stand in one text, with commas."""
        for name in given:
            if name.startswith(VALVE_KEYS):
                where = f"{sources.get(name, 'command line')}: {name}"
                raise ParameterError(
                    f"{where}: belongs to a valve; give the file's name as the parameter params instead"
                )
        if isinstance(names := given.get("free"), str):
            given = {**given, "free": names.split(",")}
        return super().read(given, sources)

    def completed(self) -> IdentificationSettings:
        """These settings, with each name of `free` once."""
        check_free(self.free)
        if not self.bag:
            raise ParameterError("bag: not given; expected a rosbag2 folder or an .mcap file (-p bag:=FILE)")
        return replace(self, free=tuple(dict.fromkeys(self.free)))


@dataclass(frozen=True)
class MonitorNodeSettings(NodeSettings):
    """Of monitor_node, beside the valve that it declares."""

    program = "monitor_node"
    has_valve = True

    valve_node: str = option("valve", "node to whose topics the monitor subscribes, relative to this node's namespace")
    measured: str = option(
        "measured/joint_states",
        "topic of the measured positions below it, or of the coil (measured/coil): the current alone; joint_states and "
        "coil: a simulated valve's",
    )
    frame_id: str = option("", "header.frame_id of the predicted joint states")
    state: str = option("", "file that keeps what commissioning found, for the next start; empty: none")
    commissioning_strokes: int = option(
        _USUAL.commissioning_strokes, "number of first strokes, taken as the baseline", "–", 8, 1000
    )
    diagnosis_strokes: int = option(
        _USUAL.diagnosis_strokes, "number of last strokes kept to trace a cause", "–", 6, 200
    )
    strokes_between_false_alarms: float = option(
        _USUAL.strokes_between_false_alarms, "mean number of strokes of a healthy valve between alarms", "–", 10, 1e9
    )
    stroke_timeout: float = option(_USUAL.stroke_timeout, "time after which a stroke counts as ended", "s", 0.1, 1e6)
    settle: float = option(_USUAL.settle, "time at rest after which a stroke has ended", "s", 5e-3, 100.0)
    patience: float = option(
        _USUAL.patience, "delay behind the model after which the monitor reports a stuck valve", "s", 1e-3, 1e3
    )
    noise_um: float = option(0.0, "standard deviation of the position sensor; 0: estimated", "µm", 0.0, 1e4)
    max_rate: float = option(1000.0, "largest rate of messages on predicted/joint_states and residual", "Hz", 0.1, 1e5)

    @classmethod
    def table(cls) -> dict[str, NodeParameter]:
        """Every parameter of monitor_node by name, its valve included."""
        return {**cls.rows(), **valve_table(default_valve(), read_only=True)}

    @classmethod
    def passes_over(cls, name: str, given: Mapping[str, object]) -> bool:
        """See `NodeSettings`; a machine in place of the valve cannot be watched, and is refused."""
        return name != "plant" and super().passes_over(name, given)

    @classmethod
    def values(cls, given: Mapping[str, object], sources: Mapping[str, str]) -> dict[str, Value]:
        """The values at the start; arguments and errors: see `check_with_valve`."""
        if given.get("plant"):
            where = f"{sources.get('plant', 'command line')}: plant"
            raise ParameterError(f"{where}: found {short(given['plant'])}; a monitor watches valves, take it out")
        given = {name: value for name, value in given.items() if name != "plant"}
        return check_with_valve(given, cls.table(), sources, cls.program)

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
