"""A valve with one plunger in info, identify, diagnose and the live valve, by recordings of the independent plant."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from plants.single_plunger import SinglePlungerPlant

from valve_sim.cli import main
from valve_sim.files.parameter_files import load_valve
from valve_sim.files.resources import config_path
from valve_sim.identification.diagnosis.identify import check_free, identify
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive, ParameterError, Phase, Valve
from valve_sim.nodes.live_valve import LiveValve, self_test
from valve_sim.nodes.realtime import NANOSECONDS
from valve_sim.recordings import Signal, Trace, events_from_sensors, write_bag

FILE = config_path("single_plunger.yaml")
LEVELS = (24.0, 28.0, 22.0, 26.0, 30.0, 23.0, 27.0, 25.0)
STROKES = Drive.of(
    [time for stroke in range(8) for time in (0.01 + 0.07 * stroke, 0.04 + 0.07 * stroke)],
    [volts for level in LEVELS for volts in (level, 0.0)],
)
TIMES = np.arange(0.0, 0.6, 5e-5)


def recorded(effects: dict[str, dict[str, float]] | None = None, **parameters: float) -> Trace:
    """Eight strokes with 1 µm and 1 mA of noise."""
    random = np.random.default_rng(4)
    run = SinglePlungerPlant(parameters, effects or {}).simulate(STROKES.times, STROKES.volts, TIMES)
    current = Signal(TIMES, run.coil_current + random.normal(0.0, 1e-3, len(TIMES)))
    position = run.pilot_position + random.normal(0.0, 1e-6, len(TIMES))
    return Trace("plant", STROKES, TIMES, position, position, coil_current=current)


@pytest.fixture(scope="module")
def rubbing(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A bag of a plunger that rubs and is damped more than declared."""
    bag = tmp_path_factory.mktemp("one_plunger") / "strokes.mcap"
    write_bag(bag, recorded({"coulomb_friction": {"force": 0.4}}, main_damping=1.4))
    return bag


def run(*arguments: object, code: int = 0) -> str:
    result = CliRunner().invoke(main, [str(argument) for argument in arguments])
    assert result.exit_code == code, result.output
    return result.output


@pytest.fixture
def shipped() -> Valve:
    return load_valve(FILE)


def test_identify_refits_the_only_damping(shipped: Valve) -> None:
    found = identify([recorded(main_damping=1.4)], shipped.exact())
    assert list(found.intervals) == ["main_damping"]
    interval = found.intervals["main_damping"]
    assert abs(interval.value - 1.4) < 4.0 * interval.stderr
    assert found.rmse_after == pytest.approx(1e-6, rel=0.05)


def test_the_mass_has_a_tolerance_of_its_own(shipped: Valve) -> None:
    found = identify([recorded(main_damping=1.4, moving_mass=0.0121)], shipped)
    (mass,) = [value for value in found.declared if value.name == "moving_mass"]
    assert mass.value == 0.012
    assert abs(mass.estimate - 0.0121) < 4.0 * mass.stderr
    assert found.valve.tolerances.declared["moving_mass"] == pytest.approx(mass.stderr)


@pytest.mark.parametrize("name", ["pilot_damping", "pilot_mass", "pickup_velocity_ratio", "gap_offset.offset"])
def test_what_one_plunger_has_no_use_for_cannot_be_freed(shipped: Valve, name: str) -> None:
    with pytest.raises(ParameterError, match=rf"^{name}: cannot be freed, .* one plunger"):
        check_free([name], shipped)
    check_free([name])


def test_effects_of_two_plungers_are_not_tried(shipped: Valve) -> None:
    plant = ValvePlant([recorded()], shipped)
    assert tuple(plant.base) == ("main_damping",)
    assert not {"gap_offset", "pickup_impact", "valve.pilot_mass"} & set(plant.effects)
    assert {"pressure_force", "coulomb_friction", "valve.moving_mass"} <= set(plant.effects)


def test_info_shows_no_arrival_at_a_gap(rubbing: Path) -> None:
    shown = run("info", rubbing, "--params", FILE)
    assert "main seats" not in shown
    assert "pilot reaches main" not in shown
    assert shown.count("reaches stop (position)") == shown.count("reaches seat (position)") == len(LEVELS)
    assert "another valve?" not in shown
    assert "another valve? Give its parameter file as --params" in run("info", rubbing)


def test_arrivals_are_those_of_the_plant() -> None:
    trace, truth = recorded(), SinglePlungerPlant().simulate(STROKES.times, STROKES.volts, TIMES)
    seen = [event for stroke in events_from_sensors(trace, 0.0) for event in stroke.events]
    kinds = {"reaches_stop": "opened", "reaches_seat": "seated"}
    for kind, of_plant in kinds.items():
        found = [event.time for event in seen if event.kind == kind]
        true = [event.time for event in truth.events if event.kind == of_plant]
        assert found == pytest.approx(true, abs=5e-4)


def test_arrivals_by_the_current_leave_the_gap_out() -> None:
    trace = replace(recorded(), times=np.empty(0), pilot_position=np.empty(0), main_position=None)
    kinds = {event.kind for stroke in events_from_sensors(trace, 0.0) for event in stroke.events}
    assert kinds <= {"reaches_stop", "reaches_seat"}


@pytest.mark.long
def test_diagnose_names_the_friction(rubbing: Path, tmp_path: Path) -> None:
    run("diagnose", rubbing, "--params", FILE, "--output", tmp_path)
    report = json.loads((tmp_path / "report.json").read_text())
    assert report["verdict"]["effects"] == ["coulomb_friction"]
    friction = report["after"]["effects"]["coulomb_friction"]["force"]
    assert abs(friction["value"] - 0.4) < 4.0 * friction["stderr"]
    assert load_valve(tmp_path / "corrected.yaml").parameters.has_one_plunger


def test_the_live_valve_goes_from_closed_to_main_to_open_and_back(shipped: Valve) -> None:
    live = LiveValve(shipped)
    live.restart(0, 0)
    live.command(NANOSECONDS // 1000, 24.0)
    phases = [live.step(NANOSECONDS // 20).phases]
    live.command(NANOSECONDS // 20, 0.0)
    phases.append(live.step(NANOSECONDS // 10).phases)
    assert phases == [(Phase.MAIN, Phase.OPEN), (Phase.MAIN, Phase.CLOSED)]
    assert live.strokes == 1


def test_the_self_test_tells_when_it_leaves_its_seat_and_is_back(shipped: Valve) -> None:
    has_passed, summary = self_test(shipped)
    assert has_passed
    assert "at 24 V: seat left after 9.060 ms, stop reached after 11.495 ms; at 0 V: stop left" in summary
    assert "plunger seated after" in summary
