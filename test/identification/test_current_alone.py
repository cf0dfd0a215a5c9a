"""Recordings without any position: identified, validated and diagnosed by the current of an independent plant."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from plants.coil_alone import Build, Course, simulate

from identification.recordings import Short
from valve_sim.identification.diagnosis.followed_positions import followed_positions
from valve_sim.identification.diagnosis.identify import identify
from valve_sim.identification.diagnosis.run import diagnose, diagnose_plant
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.reporting.diagnosis_document import diagnosis_document
from valve_sim.identification.reporting.identification_document import identification_document
from valve_sim.identification.reporting.validation_document import validation_document
from valve_sim.identification.validation.replay import validate
from valve_sim.model import Drive, Tolerances, Valve
from valve_sim.recordings import Signal, StrokeEvents, Trace, events_from_sensors

NOISE = 1e-3
"""A."""
BUILD = Build(supply_resistance=0.3, eddy_resistance=40.0)
DRIVE = Drive.of([0.010, 0.040, 0.070, 0.100], [9.0, 0.0, 12.0, 0.0])


def declared(build: Build) -> Valve:
    """The valve as its file has it: its supply droops, and nobody says so."""
    names = (
        "pilot_damping", "main_damping", "spring_rate", "spring_preload", "seat_load", "pilot_gap", "stroke",
        "pilot_mass", "a0", "a1", "a2", "a3", "reference_voltage",
    )  # fmt: skip
    valve = Valve().with_values(
        moving_mass=build.pilot_mass + build.main_mass, coil_resistance=build.resistance,
        coil_time_constant=build.inductance / build.resistance, release_voltage=build.clamp_voltage,
        **{name: getattr(build, name) for name in names},
    )  # fmt: skip
    lag = build.inductance / build.eddy_resistance
    return replace(valve, effects={"motional_emf": {"share": 1.0}, "eddy_lag": {"time_constant": lag}})


@functools.cache
def recorded(build: Build = BUILD, seed: int = 1) -> tuple[Trace, np.ndarray]:
    """A recording of two strokes at 10 kHz, and the positions that nobody measured."""
    random = np.random.default_rng(seed)
    times = np.arange(1300) / 10e3 + 3e-5
    shown = simulate(build, DRIVE.times, DRIVE.volts, times)
    current = shown.current + NOISE * random.standard_normal(len(times))
    voltage = shown.voltage + 5e-3 * random.standard_normal(len(times))
    trace = Trace(
        "coil alone", DRIVE, times[:0], times[:0], coil_current=Signal(times, current),
        coil_voltage=Signal(times, voltage),
    )  # fmt: skip
    return trace, shown.position


def test_dampings_are_refitted_and_the_position_follows() -> None:
    trace, position = recorded()
    wrong = declared(BUILD).with_values(main_damping=8.0)
    result = identify([trace], wrong)
    assert result.valve.parameters.main_damping == pytest.approx(
        BUILD.main_damping, abs=4 * result.fit.stderr("main_damping")
    )
    assert result.rmse_before > 2 * NOISE
    assert result.rmse_after == pytest.approx(NOISE, rel=0.1)
    (followed,) = followed_positions(result.fit)
    error = followed.position - position
    assert np.sqrt(np.mean(error**2)) < 5e-6
    moves = followed.stderr > 0.05e-6
    assert np.mean(np.abs(error[moves]) < 3 * followed.stderr[moves]) > 0.9
    report = identification_document(result).to_json()
    assert report["rmse_ma"]["after"] == pytest.approx(1e3 * result.rmse_after)
    assert not any(key.endswith("_um") for key in [*report, *report["noise"]])
    assert "mA as declared" in identification_document(result).to_text()


def test_a_command_without_its_droop_is_not_the_input_where_the_voltage_was_measured() -> None:
    trace, _ = recorded()
    blind = replace(trace, coil_voltage=None)
    seen, unseen = (validate([entry], declared(BUILD)).replays[0] for entry in (trace, blind))
    assert seen.passed
    assert not unseen.passed
    assert unseen.errors.rmse > 5 * seen.errors.rmse
    report = validation_document(validate([trace], declared(BUILD), current_tolerance=1e-6)).to_json()
    assert not report["passed"]
    assert report["recordings"][0]["tolerance_ma"] == pytest.approx(1e-3)
    assert "mA" in validation_document(validate([trace], declared(BUILD))).to_text()


def test_the_stop_bends_the_current() -> None:
    trace, _ = recorded()
    truth = simulate(BUILD, DRIVE.times, DRIVE.volts, np.array([0.13])).reached_stop
    openings = [found for found in events_from_sensors(trace, 0.26e-3) if found.stroke.kind == "opening"]
    found = [event for stroke in openings for event in stroke.events if event.kind == "reaches_stop"]
    assert [event.sensor for event in found] == ["current", "current"]
    assert [event.time for event in found] == pytest.approx(truth.tolist(), abs=30e-6)


FINE = 20e3
"""Hz, of which the rates below are a part."""


@functools.cache
def coils(held: bool) -> list[tuple[Drive, Course]]:
    """Two openings each of four valves, each 1 / `FINE`."""
    random, found = np.random.default_rng(2), []
    for build in (Build(), BUILD, Build(knee=1.2, pilot_damping=2.5, main_damping=7.0), Build(eddy_resistance=100.0)):
        drive = Drive.of((DRIVE.times + random.uniform(0.0, 1e-3, 4)).tolist(), [10.3, 0.0, 14.0, 0.0])
        times = np.arange(round(0.13 * FINE)) / FINE
        valve = build._replace(seat_load=100.0) if held else build
        found.append((drive, simulate(valve, drive.times, drive.volts, times)))
    return found


def seen(drive: Drive, shown: Course, rate: float, noise: float, random: np.random.Generator) -> list[StrokeEvents]:
    """What `info` says of samples that begin anywhere between two of the plant's."""
    chosen = slice(int(random.integers(round(FINE / rate))), None, round(FINE / rate))
    times = shown.times[chosen]
    current = Signal(times, shown.current[chosen] + noise * random.standard_normal(len(times)))
    return list(events_from_sensors(Trace("coil", drive, times[:0], times[:0], coil_current=current), 0.26e-3))


@pytest.mark.parametrize("noise", [0.1e-3, 1e-3])
@pytest.mark.parametrize(("rate", "share"), [(2e3, 0.5), (5e3, 0.4), (10e3, 0.8), (20e3, 0.8)])
def test_arrivals_by_the_current_are_within_their_errors(rate: float, share: float, noise: float) -> None:
    random, deviations, openings = np.random.default_rng(2), [], 0
    for drive, shown in coils(held=False):
        truth = {"reaches_stop": shown.reached_stop, "pilot_reaches_main": shown.reached_gap}
        for stroke, events in (own for _ in range(6) for own in seen(drive, shown, rate, noise, random)):
            openings += stroke.kind == "opening"
            for event in events:
                true = next(time for time in truth[event.kind] if stroke.start < time < stroke.stop)
                deviations.append((event.time - true) / event.stderr)
                assert event.kind != "reaches_stop" or event.stderr < 1.0 / rate
    assert len(deviations) >= share * openings
    assert np.mean(np.abs(deviations) < 1.96) >= 0.95


@pytest.mark.parametrize("noise", [0.0, 0.1e-3, 5e-3])
@pytest.mark.parametrize("rate", [2e3, 5e3, 20e3])
def test_nothing_bends_the_current_of_a_valve_that_is_held(rate: float, noise: float) -> None:
    random = np.random.default_rng(3)
    for drive, shown in coils(held=True):
        assert not shown.position.any()
        for _ in range(4):
            assert not [event for found in seen(drive, shown, rate, noise, random) for event in found.events]


@pytest.mark.long
def test_a_diagnosis_reports_in_milliamperes_and_gives_the_position() -> None:
    trace, position = recorded()
    result = diagnose([trace], [], replace(declared(BUILD), tolerances=Tolerances({"pilot_gap": 4e-6}, None, {})))
    assert result.verdict.kind == "none"
    report = diagnosis_document(result).to_json()
    assert report["unit"] == "mA"
    assert report["before"]["rmse_ma"]["train"] == pytest.approx(1e3 * NOISE, rel=0.1)
    strokes = report["position_from_current"]
    assert [stroke["stroke"] for stroke in strokes] == [1, 2]
    largest = max(
        abs(x - 1e6 * at)
        for stroke in strokes
        for t, x in zip(stroke["time_s"], stroke["position_um"], strict=True)
        for at in [np.interp(t, trace.sample_times, position)]
    )
    assert largest < 40.0


@pytest.mark.long
def test_the_band_holds_the_truth_where_a_twin_stands_first() -> None:
    """Behind a clamp nothing in the current tells friction from a constant force; they close at different times."""
    build = BUILD._replace(friction=0.35, clamp_voltage=24.0)
    trace, position = recorded(build)
    result = diagnose([trace], [], replace(declared(build), tolerances=Tolerances({"pilot_gap": 4e-6}, None, {})))
    assert {*result.verdict.effects, *sum(result.verdict.confusable_with.values(), ())} >= {
        "coulomb_friction", "constant_force",
    }  # fmt: skip
    (twin,) = (rival.fit for rival in result.rivals if "constant_force.force" in rival.fit.free)
    shares = []
    for others in ([], [(result.after.fit, 1.0)]):
        (followed,) = followed_positions(twin, others)
        moves = np.abs(np.gradient(position, trace.sample_times)) > 1e-2
        error = np.abs(followed.position - position)[moves]
        shares.append(float(np.mean(error < 1.96 * followed.stderr[moves])))
    assert shares[1] > 0.9
    assert shares[0] <= shares[1]


@pytest.mark.parametrize("resistance", [12.0, pytest.param(6.0, marks=pytest.mark.long)])
def test_a_strong_lag_that_held_out_data_refute_leaves_its_rivals_their_weight(resistance: float) -> None:
    """The rival explains the training data better by thousands of S: exp of half of that is no double."""
    build = Build(resistance=resistance, inductance=2e-3 * resistance, eddy_resistance=1.5 * resistance)
    train, held_out = recorded(build)[0], recorded(build._replace(eddy_resistance=0.0), seed=2)[0]
    valve = replace(declared(build), effects={"motional_emf": {"share": 1.0}})
    result = diagnose_plant(Short([train], valve, ["eddy_lag"]), Short([held_out], valve, ["eddy_lag"]))
    assert result.verdict.kind == "unknown"
    assert [rival.weight for rival in result.rivals] == [1.0] * len(result.rivals) != []


def test_the_motional_emf_shows_in_the_positions() -> None:
    """The work of the attraction is taken from the coil, so that the plungers are later than without."""
    build = BUILD._replace(supply_resistance=0.0, eddy_resistance=0.0)
    times = np.arange(650) / 5e3 + 3e-5
    noise = 1e-6 * np.random.default_rng(4).standard_normal(len(times))
    trace = Trace("laser", DRIVE, times, simulate(build, DRIVE.times, DRIVE.volts, times).position + noise)
    plain = replace(declared(BUILD), effects={})
    without = identify([trace], plain)
    found = identify([trace], plain, ("pilot_damping", "main_damping", "motional_emf.share"))
    assert without.rmse_after > 5e-6
    assert found.rmse_after == pytest.approx(1e-6, rel=0.1)
    error = found.fit.stderr("motional_emf.share")
    assert found.valve.effects["motional_emf"]["share"] == pytest.approx(1.0, abs=4 * error)
    assert error < 0.02


def test_the_motional_emf_is_tried_of_a_coil_with_inductance() -> None:
    trace, position = recorded()
    plain = replace(declared(BUILD), effects={})
    with_positions = replace(trace, times=trace.sample_times, pilot_position=position)
    for recording, valve, is_tried in (
        (trace, plain, True),
        (with_positions, plain, True),
        (replace(with_positions, coil_current=None), plain, True),
        (trace, plain.with_values(coil_time_constant=0.0), False),
        # What is declared may be of another size.
        (trace, declared(BUILD), True),
    ):
        effects = ValvePlant([recording], valve).effects
        choice = effects.get("motional_emf")
        assert (choice is not None) == is_tried
        assert choice is None or choice.is_on == ("motional_emf" in valve.effects)
        alike = {other for choice in effects.values() for other in choice.confused_with}
        assert ("motional_emf" in alike) <= (is_tried or "motional_emf" in valve.effects)
