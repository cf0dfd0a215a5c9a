"""A machine of a plant file that lives by a clock, against `simulate --plant`; and files that topics cannot serve."""

from __future__ import annotations

import itertools
from pathlib import Path

import numpy as np
import pytest

from valve_sim.files.plant_entries import PlantFileError
from valve_sim.model import ParameterError
from valve_sim.nodes.diagnostics import Level, valve_status
from valve_sim.nodes.live_plant import LivePlant, NodePlant
from valve_sim.nodes.realtime import NANOSECONDS

from .simulated_plant import MICROMETRE, PLANT, simulated

START = 1_700_000_000 * NANOSECONDS
COMMANDS = ((3_000_000, 24.0), (31_234_567, 0.0), (60_000_001, 12.0), (61_500_000, 24.0), (90_000_000, 0.0))
"""ns after the start, V."""


def started(plant: NodePlant, **options: float) -> LivePlant:
    live = LivePlant(plant, {name: own.value for name, own in plant.file.parameters.items()}, **options)
    live.restart(START, START)
    return live


def test_a_live_machine_is_the_simulated_one_to_the_bit_however_time_is_cut(tmp_path: Path) -> None:
    live = started(NodePlant(str(PLANT)))
    for at, volts in COMMANDS:
        live.command(START + at, volts)
    looks = sorted(np.random.default_rng(2).integers(0, 130_000_000, 400).tolist())
    steps = [live.step(START + look) for look in looks]
    expected = simulated(PLANT, tmp_path, COMMANDS, looks)
    assert [step.reading.pilot_position / MICROMETRE for step in steps] == expected
    assert max(expected) > 1000.0
    phases = [phase for step in steps for phase in step.phases]
    assert phases[:3] == [0, 1, 2]
    assert phases[-1] == 0 and all(a != b for a, b in itertools.pairwise(phases))
    assert [step.stamp for step in steps] == [START + look for look in looks]
    switches = [(stamp - START, coil.voltage) for step in steps for stamp, coil in step.switches]
    assert switches[:2] == [(2_999_999, 0.0), (3_000_000, 24.0)]
    status = valve_status(live, "")
    assert (status.level, status.message, status.values["last event"]) == (Level.OK, "shut", "seated")


def test_the_watchdog_the_limit_a_reset_and_other_parameters_act_as_on_a_valve() -> None:
    live = started(NodePlant(str(PLANT)), command_timeout=0.1, max_voltage=30.0)
    assert not live.command(START, 31.0)
    assert live.command(START, 24.0)
    assert live.step(START + 30_000_000).reading.pilot_position > 1e-3
    numbers = {name: own.value for name, own in NodePlant(str(PLANT)).file.parameters.items()}
    live.go_on_as(START + 30_000_000, {**numbers, "stroke": 0.9e-3})
    changed = live.step(START + 60_000_000)
    assert changed.reading.pilot_position == pytest.approx(0.9e-3, abs=2e-5), "pressed back to the new stop"
    late = live.step(START + 300_000_000)
    assert "no command for 0.1 s" in late.switched_off and late.reading.phase == 0
    live.command(START + 300_000_000, 24.0)
    assert live.step(START + 330_000_000).reading.pilot_position == pytest.approx(0.9e-3, abs=2e-5)
    live.reset(START + 330_000_000)
    rested = live.step(START + 330_000_000)
    assert (rested.reading.pilot_position, rested.phases, live.volts) == (0.0, (0,), 0.0)
    live.go_on_as(START + 340_000_000, {**numbers, "moving_mass": 0.0})
    live.command(START + 340_000_000, 24.0)
    failed = live.step(START + 370_000_000)
    assert "not finite" in failed.failure and failed.reading.pilot_position == 0.0
    assert valve_status(live, failed.failure).level is Level.ERROR


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"{voltage:": "{volts:", "voltage/": "volts/"}, r"inputs.voltage: is missing; .* voltage at its coil, in V"),
        ({"{voltage:": "{load: {unit: N}, voltage:", "- spring_pre": "- load - spring_pre"}, "inputs.load: no topic"),
        ({"position: {value: x": "current: {value: x"}, r"outputs.current.unit: is m, expected A"),
        (
            {"position: {value: x, unit: um": "phase: {value: u, unit: 1"},
            r"phase.value: is no region .* expected mode,",
        ),
        ({"coil_time_constant: {value: 5.0": "coil_time_constant: {value: 0"}, "not finite"),
    ],
)
def test_a_file_that_topics_cannot_serve_is_one_line(tmp_path: Path, changes: dict[str, str], words: str) -> None:
    path, text = tmp_path / "mine.yaml", PLANT.read_text()
    for old, new in changes.items():
        assert old in text
        text = text.replace(old, new, 1)
    path.write_text(text)
    with pytest.raises(PlantFileError, match=words) as caught:
        NodePlant(str(path))
    assert str(caught.value).startswith(f"{path}: ") and "\n" not in str(caught.value)


def test_its_parameters_are_those_of_its_file_in_si_and_a_valves_are_refused() -> None:
    table = NodePlant(str(PLANT))
    entry = table.table()["parameters.stop_rate"]
    assert (entry.default, entry.unit, entry.range, entry.read_only) == (2e6, "N/m", (1e5, 1e8), False)
    assert table.values({"parameters.stroke": 2e-3}, {})["parameters.stroke"] == 2e-3
    for given, words in (
        ({"parameters.stop_rate": 1.0}, "stop_rate: found 1.0, expected a number from 100000 to"),
        ({"parameters.strok": 1.0}, "did you mean parameters.stroke"),
        ({"gas.inlet_pressure": 1e6}, r"a.yaml: gas.inlet_pressure: is of the valve, which plant:=.* replaces"),
        ({"effects.stiction.force": 1.0}, "effects.stiction.force: is of the valve"),
        ({"parameters.coil_time_constant": 0.0}, "with these parameters .* not finite"),
    ):
        with pytest.raises(ParameterError, match=words):
            table.values(given, dict.fromkeys(given, "a.yaml"))
