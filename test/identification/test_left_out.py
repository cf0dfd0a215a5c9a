"""Readings that are no measurements weigh nothing in fits, noise and verdicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from plants.recording import Recorder

from identification.freed import fit
from identification.recordings import recorded
from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.diagnosis.identify import signal_errors
from valve_sim.identification.diagnosis.run import Diagnosis, diagnose
from valve_sim.identification.fit import problem as problems
from valve_sim.identification.fit.fitter import Fitter
from valve_sim.identification.fit.noise import estimate_noise
from valve_sim.identification.fit.posterior import rivals_of
from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import Fit, rmse
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.identification.validation.replay import validate
from valve_sim.model import Valve
from valve_sim.recordings import Trace, TraceError, read_trace, refuse_doubtful_units, write_bag
from valve_sim.recordings.left_out import LeftOut

VALVE = default_valve().exact()
FINE = Recorder(quantisation=0.1e-6)
"""At 20 kHz, so that spikes and codes of some milliseconds are many samples."""
BOTH = ("pilot_damping", "main_damping")
TRUE = {"pilot_damping": 1.4, "main_damping": 3.2}
CODE = 32.767e-3
SENSORS = {"white": FINE, "coloured": Recorder(colour=0.7), "coarse": Recorder(quantisation=5e-6)}


def spoilt(trace: Trace, seed: int = 3, dropouts: Sequence[tuple[int, int]] = ((2000, 60), (6200, 200))) -> Trace:
    """The recording with twenty spikes a second of 20 to 400 µm, anywhere, and with codes for some milliseconds."""
    random = np.random.default_rng(seed)
    position = trace.pilot_position.copy()
    count = round(20.0 * (trace.times[-1] - trace.times[0]))
    places = random.choice(len(position), count, replace=False)
    position[places] += random.choice([-1.0, 1.0], count) * random.uniform(20e-6, 400e-6, count)
    for start, length in dropouts:
        position[start : start + length] = CODE
    return replace(trace, pilot_position=position)


def wrong(trace: Trace, of: Trace) -> np.ndarray:
    return np.asarray(trace.pilot_position != of.pilot_position)


@pytest.fixture(scope="module", params=SENSORS)
def pair(request: pytest.FixtureRequest) -> tuple[Trace, Trace]:
    """A recording, and what spikes and codes make of it."""
    trace = recorded(SENSORS[request.param])
    return trace, spoilt(trace)


def test_what_is_wrong_is_left_out_of_the_channel(pair: tuple[Trace, Trace]) -> None:
    trace, bad = pair
    (channel,) = ValvePlant([bad], VALVE).channels
    assert channel.left_out is not None
    missed = wrong(bad, trace) & ~channel.left_out
    assert not (channel.left_out & ~wrong(bad, trace)).any()
    assert np.count_nonzero(missed) == 1  # in motion, of less than that moves by
    assert np.abs(channel.data - trace.pilot_position).max() < 0.4e-3
    (sound,) = ValvePlant([trace], VALVE).channels
    assert sound.left_out is None
    assert sound.data is trace.pilot_position
    assert channel.quiet[~channel.left_out].sum() > 0.95 * sound.quiet.sum()


def test_noise_is_that_of_what_is_left(pair: tuple[Trace, Trace]) -> None:
    trace, bad = pair
    sound, found = (estimate_noise(ValvePlant([own], VALVE).channels) for own in (trace, bad))
    assert found.sigma == pytest.approx(sound.sigma, rel=0.03)
    assert found.innovation == pytest.approx(sound.innovation, rel=0.03)
    assert found.step == pytest.approx(sound.step)
    assert len(found.coefficients) == len(sound.coefficients)


def test_a_fit_and_its_errors_are_as_without(pair: tuple[Trace, Trace], monkeypatch: pytest.MonkeyPatch) -> None:
    trace, bad = pair
    sound, found = (
        fit(problem, BOTH, {}, nuisances=problem.plant.nuisances)
        for problem in (Problem(ValvePlant([own], VALVE)).without_outliers(TRUE) for own in (trace, bad))
    )
    for name in BOTH:
        assert abs(found.values[name] - sound.values[name]) < 0.5 * sound.stderr(name)
        assert found.stderr(name) == pytest.approx(sound.stderr(name), rel=0.2)
    assert rmse(found) == pytest.approx(rmse(sound), rel=0.04)  # less of the motion is seen
    by_rows = signal_errors(found)[0].after
    assert by_rows == pytest.approx(rmse(found), rel=0.01)
    monkeypatch.setattr(problems, "LONG", 0)
    assert signal_errors(found)[0].after == pytest.approx(by_rows, rel=1e-9)


def test_a_fit_at_2_khz_is_as_without_where_lines_miss_the_motion() -> None:
    trace = recorded(Recorder(colour=0.7, sample_rate=2e3))
    position = trace.pilot_position.copy()
    for start, length in ((34, 3), (150, 2), (212, 4), (390, 3)):  # in openings and closings
        position[start : start + length] = CODE
    plants = ValvePlant([trace], VALVE), ValvePlant([replace(trace, pilot_position=position)], VALVE)
    assert np.abs(plants[1].channels[0].data - trace.pilot_position).max() > 30e-6
    sound, found = (fit(Problem(plant), BOTH, {}, nuisances=plant.nuisances) for plant in plants)
    for name in BOTH:
        assert abs(found.values[name] - sound.values[name]) < sound.stderr(name)
    assert rmse(found) == pytest.approx(rmse(sound), rel=0.05)


@pytest.mark.parametrize(("rate", "noise"), [(20e3, 1e-6), (5e3, 0.2e-6), (2e3, 1e-6), (1e3, 1e-6)])
def test_a_spike_that_is_not_left_out_moves_no_damping(rate: float, noise: float) -> None:
    """Of 500 standard deviations, in motion, up to four readings long."""
    trace, random = recorded(Recorder(position_noise=noise, sample_rate=rate)), np.random.default_rng(4)
    none = dict.fromkeys(("codes", "repeated", "spikes", "clipped"), np.zeros(len(trace.times), dtype=bool))

    def fitted(own: Trace) -> Fit:
        own.__dict__["left_out"] = LeftOut(**none)
        plant = ValvePlant([own], VALVE)
        return Fitter(Problem(plant).condensed(), rivals_of(plant)).fitted_plainly()

    sound = fitted(trace)
    moves = np.flatnonzero(np.abs(np.diff(trace.pilot_position)) * rate > 0.01 + 8.0 * noise * rate)
    for length in (1, 1, 2, 4):
        position, first = trace.pilot_position.copy(), int(random.choice(moves)) + int(random.integers(-1, 3))
        position[first : first + length] += random.choice([-1.0, 1.0]) * 500.0 * noise
        found = fitted(replace(trace, pilot_position=position))
        for name in BOTH:
            assert abs(found.values[name] - sound.values[name]) < 0.5 * sound.stderr(name)


def test_a_replay_is_judged_by_measurements() -> None:
    trace = recorded(FINE)
    valve = VALVE.with_values(pilot_damping=1.4, main_damping=3.2)
    sound, found = (validate([own], valve).replays[0].errors for own in (trace, spoilt(trace)))
    assert found.samples == sound.samples - np.count_nonzero(wrong(spoilt(trace), trace))
    assert found.rmse == pytest.approx(sound.rmse, rel=0.02)
    assert found.maximum < 1.1 * sound.maximum


def diagnosed(trace: Trace, valve: Valve = VALVE) -> Diagnosis:
    return diagnose([trace], [], valve)


def test_a_healthy_valve_stays_healthy_with_spikes_and_dropouts(tmp_path: Path) -> None:
    trace = recorded(FINE)
    write_bag(tmp_path / "bad.mcap", spoilt(trace))
    bad = read_trace(tmp_path / "bad.mcap")
    refuse_doubtful_units(bad, VALVE.parameters)
    assert bad.left_out.counts == {"codes": 260, "repeated": 0, "spikes": 9, "clipped": 0}
    sound, found = diagnosed(trace), diagnosed(bad)
    assert found.verdict.kind == sound.verdict.kind == "none"
    for name in BOTH:
        stderr = sound.before.fit.stderr(name)
        assert abs(found.before.fit.values[name] - sound.before.fit.values[name]) < 0.5 * stderr
    assert found.before.train_rmse == pytest.approx(1e-6, rel=0.03)


@pytest.mark.long
def test_a_missing_effect_is_named_with_spikes_and_dropouts() -> None:
    bad = spoilt(recorded(FINE, effects={"stop_bounce": {"restitution_stop": 0.2, "restitution_seat": 0.15}}))
    found = diagnosed(bad)
    assert found.verdict.effects == ("stop_bounce",)
    interval = found.after.intervals["stop_bounce.restitution_stop"]
    assert interval.value == pytest.approx(0.2, abs=4.0 * interval.stderr)


@pytest.mark.parametrize("unit", [1e3, 1e6, 1e-3])
def test_another_unit_is_refused_with_codes_in_it(unit: float) -> None:
    bad = spoilt(recorded(FINE))
    with pytest.raises(TraceError, match=r"about (1000|1e\+06) times too (large|small)"):
        refuse_doubtful_units(replace(bad, pilot_position=unit * bad.pilot_position), VALVE.parameters)
