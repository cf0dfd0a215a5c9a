"""What programs beside the package are given: rights for SROS 2, and figures of each stroke for plots."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

from identification.live_strokes import LiveValve, feed
from identification.one_thread import Monitor

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.nodes.monitor_work import stroke_status

CONFIG = Path(__file__).parents[1] / "config"


def test_each_node_has_an_enclave_of_its_own_name() -> None:
    root = ElementTree.parse(CONFIG / "sros2" / "station.policy.xml").getroot()
    enclaves = {
        enclave.attrib["path"]: [
            f"{profile.attrib['ns'].rstrip('/')}/{profile.attrib['node']}" for profile in enclave.iter("profile")
        ]
        for enclave in root.iter("enclave")
    }
    assert enclaves == {path: [path] for path in enclaves}
    assert {f"/tank_{n}/{node}" for n in (1, 2, 3) for node in ("valve", "monitor")} < set(enclaves)


def test_every_figure_of_a_stroke_is_a_number_as_a_whole_in_one_series() -> None:
    """PlotJuggler 3.8.8 makes a series of each value that is a number; a slash would make a branch of it."""
    monitor = Monitor(default_valve(), MonitorSettings(commissioning_strokes=8))
    valve = LiveValve(seed=5, rate=2e3, jitter=0.0)
    reports = [report for _ in range(12) for report in feed(monitor, valve.stroke())]
    told = [stroke_status(report, "/valve").values for report in reports]
    known = [{name for name, value in values.items() if is_number(value)} for values in told]
    assert known[0] >= {"stroke", "opening_delay", "t1", "t2", "closing_time"}
    assert known[8] >= {"noise_um", "command_scatter", "alarm.threshold", "residual_rms_um", "alarm.sum"}
    assert known[8] >= {
        f"damping.{name}.{part}" for name in ("pilot_damping", "main_damping") for part in ("value", "stderr")
    }
    assert known[8] >= {f"scores.{name}" for name in reports[8].scores}
    assert not any("/" in name for values in told for name in values)


def is_number(value: str) -> bool:
    try:
        return math.isfinite(float(value))
    except ValueError:
        return False
