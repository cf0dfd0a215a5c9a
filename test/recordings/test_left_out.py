"""Readings that are no measurements are found, and those of contacts, rebounds, coarse and still sensors are not."""

from __future__ import annotations

import functools

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from plants.declared import CAMPAIGN_VALVE, DeclaredPlant
from plants.recording import Recorder, Recording, holdout_profile, record, single_opening, train_profile

from valve_sim.recordings.left_out import LeftOut, bridged, find_left_out

STROKE = CAMPAIGN_VALVE["stroke"]
CODE = 32.767e-3
REASONS = ("codes", "repeated", "spikes", "clipped")
PROFILES = {"train": train_profile(), "holdout": holdout_profile(), "opening": single_opening()}
SENSORS = {
    "white": Recorder(),
    "coloured": Recorder(colour=0.9),
    "coarse": Recorder(quantisation=5e-6),
    "fine steps": Recorder(quantisation=0.1e-6),
    "quiet": Recorder(position_noise=0.2e-6),
    "no noise": Recorder(position_noise=0.0),
    "coarse, no noise": Recorder(position_noise=0.0, quantisation=3e-6),
}


@functools.cache
def measured(
    sensor: str = "white", rate: float = 20e3, bounce: float = 0.0, profile: str = "train", seed: int = 1
) -> Recording:
    effects = {"stop_bounce": {"restitution_stop": bounce, "restitution_seat": 0.9 * bounce}} if bounce else {}
    plant = DeclaredPlant(effects, {**CAMPAIGN_VALVE, "pilot_damping": 1.4, "main_damping": 3.2})
    recorder = SENSORS[sensor]
    given_rate = Recorder(recorder.position_noise, recorder.colour, recorder.quantisation, sample_rate=rate)
    return record(plant, PROFILES[profile], given_rate, seed)


def found_in(recording: Recording, positions: np.ndarray | None = None) -> LeftOut:
    positions = recording.pilot_position if positions is None else positions
    return find_left_out(recording.times, positions)


def with_spikes(recording: Recording, height: float, length: int, every: float = 0.05) -> tuple[np.ndarray, np.ndarray]:
    """Positions with spikes of alternating sign, s apart, and (n,) where they are."""
    spoilt, where = recording.pilot_position.copy(), np.zeros(len(recording.times), dtype=bool)
    rate = (len(recording.times) - 1) / recording.times[-1]
    for number, start in enumerate(range(37, len(spoilt) - 20, round(every * rate))):
        spoilt[start : start + length] += height * (-1) ** number
        where[start : start + length] = True
    return spoilt, where


@pytest.mark.parametrize(("sensor", "seed"), [("white", 2), ("coloured", 3), ("coloured", 4), ("coarse", 5)])
def test_nothing_is_left_out_of_a_sound_recording(sensor: str, seed: int) -> None:
    recording = measured(sensor, seed=seed)
    assert found_in(recording).counts == dict.fromkeys(REASONS, 0)


@pytest.mark.parametrize(
    ("sensor", "rate", "bounce", "profile"),
    [
        ("white", 20e3, 0.3, "train"),
        ("white", 1e3, 0.9, "holdout"),
        ("coloured", 20e3, 0.6, "holdout"),
        ("coarse", 20e3, 0.9, "train"),
        ("fine steps", 2e3, 0.3, "opening"),
        ("quiet", 2e3, 0.9, "train"),
        ("no noise", 20e3, 0.6, "opening"),
        ("coarse, no noise", 1e3, 0.3, "train"),
    ],
)
def test_contacts_rebounds_and_lifts_are_no_spikes(sensor: str, rate: float, bounce: float, profile: str) -> None:
    assert found_in(measured(sensor, rate, bounce, profile)).counts == dict.fromkeys(REASONS, 0)


@pytest.mark.parametrize(
    ("sensor", "height", "length"),
    [("white", 25e-6, 1), ("coloured", 60e-6, 2), ("coarse", 300e-6, 1), ("white", 300e-6, 5), ("coarse", -1.5e-3, 3)],
)
def test_spikes_are_found_at_rest_and_if_they_are_large_in_motion(sensor: str, height: float, length: int) -> None:
    recording = measured(sensor)
    # Every 23 ms: two or three times in each of the eight strokes.
    positions, where = with_spikes(recording, height, length, every=0.023)
    found = found_in(recording, positions)
    assert np.count_nonzero(where) > 20 * length
    np.testing.assert_array_equal(found.any & ~where, False)
    at_rest = where & (np.abs(np.gradient(recording.truth.pilot_position)) < 0.1e-6)
    assert np.count_nonzero(found.any & at_rest) >= (0.95 if sensor == "coarse" else 1.0) * np.count_nonzero(at_rest)
    # Of those in motion that the plunger moves by between samples, the weights of a fit tell.
    assert np.count_nonzero(found.any & where) >= 0.75 * np.count_nonzero(where)


def test_spikes_at_rest_are_found_at_2_khz() -> None:
    recording = measured(rate=2e3)
    spoilt = recording.pilot_position.copy()
    at_rest = np.array([10, 130, 250, 370, 490, 610])  # before each opening
    spoilt[at_rest] += 40e-6
    assert np.flatnonzero(found_in(recording, spoilt).spikes).tolist() == at_rest.tolist()


def test_a_rebound_that_a_spike_lies_beside_stays() -> None:
    recording = measured(bounce=0.5)
    landing = next(event.time for event in recording.truth.events if event.kind == "opened")
    spoilt, at = recording.pilot_position.copy(), round(landing * 20e3) + 5
    spoilt[at] -= 200e-6
    assert np.flatnonzero(found_in(recording, spoilt).any).tolist() == [at]


@pytest.mark.parametrize(
    ("rate", "sensor", "code"),
    [
        (1e3, "white", 4e-3),
        (20e3, "white", -CODE),
        (1e3, "coarse", CODE),
        (20e3, "no noise", CODE),
        (1e3, "no noise", 4e-3),
    ],
)
def test_codes_are_found_however_long_they_last(rate: float, sensor: str, code: float) -> None:
    recording = measured(sensor, rate)
    spoilt, where = recording.pilot_position.copy(), np.zeros(len(recording.times), dtype=bool)
    for start, length in ((0.02, 1), (0.1, 3), (0.31, 10)):  # s, ms
        own = slice(round(start * rate), round(start * rate) + max(1, round(length * rate / 1000)))
        spoilt[own], where[own] = code, True
    found = found_in(recording, spoilt)
    if abs(code) == CODE or sensor == "white":
        np.testing.assert_array_equal(found.codes, where)
    # Without noise and as slow as a plunger might be, 4 mm may be a position; nothing right is left out.
    np.testing.assert_array_equal(found.any & ~where, False)


@pytest.mark.parametrize(("sensor", "rate"), [("white", 1e3), ("coarse", 20e3), ("no noise", 20e3)])
def test_a_valve_that_is_rarely_open_has_no_codes(sensor: str, rate: float) -> None:
    """Its opening is far from nearly all readings; in another unit, too."""
    one = measured(sensor, rate, profile="opening")
    closed = np.resize(one.pilot_position[: round(0.01 * rate)], round(2.0 * rate))
    positions = np.concatenate([one.pilot_position, one.pilot_position[::-1], closed])
    times = np.arange(len(positions)) / rate
    for unit in (1.0, 1e3):
        assert not find_left_out(times, unit * positions).any.any()


def test_held_readings_are_found_at_rest_and_in_motion() -> None:
    recording = measured()
    spoilt, where = recording.pilot_position.copy(), np.zeros(len(recording.times), dtype=bool)
    # At rest; through an opening; through a closing.
    for start, length in ((0.002, 3), (0.014, 50), (0.06, 300), (0.1065, 20)):
        first = round(start * 20e3)
        spoilt[first : first + length], where[first + 1 : first + length] = spoilt[first], True
    found = found_in(recording, spoilt)
    np.testing.assert_array_equal(found.repeated, where)
    assert found.counts["repeated"] == np.count_nonzero(found.any)


@pytest.mark.parametrize("sensor", ["coarse", "no noise"])
def test_a_sensor_that_rests_lawfully_is_held_in_motion_only(sensor: str) -> None:
    recording = measured(sensor)
    spoilt, first = recording.pilot_position.copy(), round(0.0768 * 20e3)  # at 0.4 m/s
    spoilt[first : first + 8] = spoilt[first]
    assert np.flatnonzero(found_in(recording, spoilt).any).tolist() == list(range(first + 1, first + 8))


@pytest.mark.parametrize("sensor", ["white", "coarse", "no noise"])
def test_a_signal_that_drops_to_zero_while_the_valve_is_open_is_left_out(sensor: str) -> None:
    recording = measured(sensor)
    spoilt, where = recording.pilot_position.copy(), np.zeros(len(recording.times), dtype=bool)
    for first, length in ((500, 1), (520, 4), (560, 200)):
        spoilt[first : first + length], where[first : first + length] = 0.0, True
    found = found_in(recording, spoilt)
    np.testing.assert_array_equal(found.any, where)
    assert found.counts["repeated"] >= 200


def test_what_lies_between_two_dropouts_stays() -> None:
    """The first begins while the valve is closed, the second ends there: between them are the only jumps."""
    recording = measured()
    spoilt, where = recording.pilot_position.copy(), np.zeros(len(recording.times), dtype=bool)
    for start, stop in ((1300, 1600), (1840, 2320)):
        spoilt[start:stop], where[start:stop] = 0.0, True
    found = found_in(recording, spoilt)
    assert np.count_nonzero(found.any & ~where) <= 5
    assert np.mean(found.any[where]) > 0.95


@pytest.mark.parametrize("sensor", ["coarse", "no noise"])
def test_a_rest_that_is_held_while_the_plunger_leaves_it_is_left_out_whole(sensor: str) -> None:
    """Of a sensor that shows no noise nobody knows from when on it is held."""
    recording = measured(sensor)
    spoilt, first, stop = recording.pilot_position.copy(), 1440, 1520  # until 0.3 mm of the second opening
    spoilt[first:stop] = spoilt[first]
    found = found_in(recording, spoilt)
    assert found.repeated[first + 1 : stop].all()
    assert not found.any[stop:].any()


@pytest.mark.parametrize("times", [2, 7])
def test_a_sensor_that_is_slower_than_its_recorder_repeats_lawfully(times: int) -> None:
    recording = measured()
    held = np.repeat(recording.pilot_position[::times], times)[: len(recording.times)]
    assert not found_in(recording, held).any.any()


@pytest.mark.parametrize(
    ("sensor", "rate", "low", "high"),
    [("white", 1e3, -1.0, 1.15e-3), ("fine steps", 20e3, 40e-6, 1.0), ("coloured", 20e3, -1.0, 1.15e-3)],
)
def test_clipped_readings_are_found(sensor: str, rate: float, low: float, high: float) -> None:
    recording = measured(sensor, rate)
    clipped = np.clip(recording.pilot_position, low, high)
    found = found_in(recording, clipped)
    at_end = (clipped == low) | (clipped == high)
    assert found.clipped[at_end].all()
    assert found.counts["clipped"] == np.count_nonzero(found.any)
    # Of the motion, what passes within some standard deviations of the end.
    beside = found.clipped & ~at_end
    assert np.minimum(np.abs(clipped - low), np.abs(clipped - high))[beside].max(initial=0.0) < 20e-6
    assert np.count_nonzero(beside) < 0.005 * len(clipped)


@pytest.mark.parametrize(("sensor", "end"), [("white", -3e-6), ("coloured", 0.0), ("fine steps", 1e-6)])
def test_a_rest_that_noise_carries_beyond_the_range_is_left_out_whole(sensor: str, end: float) -> None:
    """What noise leaves within the range would put the stop too low."""
    recording = measured(sensor)
    clipped = np.minimum(recording.pilot_position, STROKE + end)
    found = found_in(recording, clipped)
    rests = recording.truth.pilot_position == STROKE
    assert np.count_nonzero(found.clipped & rests) > 0.95 * np.count_nonzero(rests)
    assert recording.truth.pilot_position[found.any].min() > STROKE - 20e-6


@pytest.mark.parametrize("sensor", ["white", "coloured", "coarse, no noise"])
def test_a_range_that_ends_beyond_the_noise_clips_nothing(sensor: str) -> None:
    recording = measured(sensor)
    clipped = np.clip(recording.pilot_position, -5e-6, STROKE + 5e-6)
    assert not found_in(recording, clipped).any.any()


def test_a_reading_has_one_reason() -> None:
    recording = measured()
    spoilt, _ = with_spikes(in_range_up_to(recording, 1.2e-3), -100e-6, 2)
    spoilt[3000:3040] = CODE
    spoilt[100:110] = spoilt[100]
    found = found_in(recording, spoilt)
    reasons = np.stack([getattr(found, reason) for reason in REASONS])
    assert reasons.sum(axis=0).max() == 1
    assert reasons.any(axis=1).all()
    assert sum(found.counts.values()) == np.count_nonzero(found.any)
    np.testing.assert_array_equal(reasons.any(axis=0), found.any)


def in_range_up_to(recording: Recording, end: float) -> Recording:
    """The recording of a sensor whose range ends there."""
    fields = {name: getattr(recording, name) for name in recording.__dataclass_fields__}
    return Recording(**{**fields, "pilot_position": np.minimum(recording.pilot_position, end)})


@pytest.mark.parametrize("count", [0, 1, 3, 39, 41, 5000])
def test_any_number_of_readings_will_do(count: int) -> None:
    times, positions = np.arange(count) / 20e3, 1e-6 * np.random.default_rng(count).normal(size=count)
    found = find_left_out(times, positions)
    assert found.any.shape == (count,)
    assert not found.any.any()


numbers = st.one_of(st.floats(-1e-3, 1e-3), st.sampled_from([0.0, 1e-3, CODE, 1e-9]), st.floats(-1e200, 1e200))


@settings(max_examples=60, derandomize=True, suppress_health_check=list(HealthCheck))
@given(
    pieces=st.lists(st.tuples(st.integers(1, 60), numbers, numbers), max_size=12),
    noise=st.sampled_from([0.0, 1e-6, 1e-3]),
    step=st.sampled_from([0.0, 1e-6, 1e-4]),
    gaps=st.sampled_from([0.0, 0.3, 1.0]),
    seed=st.integers(0, 100),
)
def test_whatever_is_read_masks_come_back(
    pieces: list[tuple[int, float, float]], noise: float, step: float, gaps: float, seed: int
) -> None:
    random = np.random.default_rng(seed)
    with np.errstate(over="ignore"):
        ramps = [np.linspace(begin, end, length) for length, begin, end in pieces]
        positions = np.concatenate([np.empty(0), *ramps])
        positions = positions + noise * random.normal(size=len(positions))
        positions = np.nan_to_num(np.round(positions / step) * step if step else positions)
    times = np.cumsum(1e-4 * (1.0 - gaps * (random.random(len(positions)) < 0.1)) + gaps * 1e-3 * random.random(1))
    found = find_left_out(times, positions)
    for reason in REASONS:
        mask = getattr(found, reason)
        assert (mask.shape, mask.dtype) == (positions.shape, np.bool_)
    assert sum(found.counts.values()) == np.count_nonzero(found.any)
    assert np.isfinite(bridged(times, positions, found.any)).all()


def test_what_is_left_out_is_bridged() -> None:
    times, values = np.arange(6.0), np.array([0.0, 9.0, 9.0, 3.0, 4.0, 9.0])
    left_out = np.array([False, True, True, False, False, True])
    assert bridged(times, values, left_out).tolist() == [0.0, 1.0, 2.0, 3.0, 4.0, 4.0]
    assert values[1] == 9.0
    assert bridged(times, values, np.zeros(6, dtype=bool)) is values
