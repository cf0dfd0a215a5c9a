"""What `info` says of a recording: the work it takes, and rates that are true of messages that come in bursts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from recordings.bag_makers import COMMANDS, GAP, RATE, clean_trace
from valve_sim.model import Drive, ValveParameters
from valve_sim.recordings import Signal, Trace, describe, doubtful_units, events_from_sensors

PERIOD = 0.1


class Weighed(np.ndarray):
    """An array that counts how many elements NumPy was given of it and of what was cut out of it."""

    elements = 0

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **settings: Any) -> Any:
        Weighed.elements += sum(given.size for given in inputs if isinstance(given, Weighed))
        plain = [given.view(np.ndarray) if isinstance(given, Weighed) else given for given in inputs]
        if "out" in settings:
            settings["out"] = tuple(into.view(np.ndarray) for into in settings["out"])
        result = getattr(ufunc, method)(*plain, **settings)
        return result.view(Weighed) if isinstance(result, np.ndarray) else result


def repeated(strokes: int) -> Trace:
    """So many openings, each with its closing, as a Weighed trace with an accelerometer and a current probe."""
    one = clean_trace(PERIOD, noise=0.0)
    count = len(one.times)
    starts = PERIOD * np.arange(strokes)
    times = np.arange(strokes * count) / RATE
    random = np.random.default_rng(3)
    position = np.tile(one.pilot_position, strokes) + random.normal(0, 1e-6, len(times))
    drive = Drive(
        np.concatenate([[start + time for time, _ in COMMANDS] for start in starts]),
        np.tile([volts for _, volts in COMMANDS], strokes),
    )
    acceleration = Signal(times.view(Weighed), random.normal(0, 0.1, len(times)).view(Weighed))
    current = Signal(times.view(Weighed), np.full(len(times), 0.9).view(Weighed))
    return replace(
        one,
        times=times.view(Weighed),
        pilot_position=position.view(Weighed),
        main_position=None,
        drive=drive,
        acceleration=acceleration,
        coil_current=current,
    )


def summed_up(trace: Trace) -> None:
    """All that `info` asks of a recording that has been read."""
    describe(trace)
    assert doubtful_units(trace, ValveParameters()) == ()
    assert len(events_from_sensors(trace, GAP)) == len(trace.drive.times)


def weight(work: Callable[[Trace], None], strokes: int) -> int:
    trace = repeated(strokes)
    Weighed.elements = 0
    work(trace)
    return Weighed.elements


def test_the_work_grows_no_faster_than_the_recording() -> None:
    """A sensor's step is told by some of the readings, so that this part of the work does not grow at all."""
    few, many = weight(summed_up, 4), weight(summed_up, 40)
    assert few > 4 * PERIOD * RATE
    assert 7 * few < many < 10 * few


def rate_of(times: np.ndarray) -> tuple[float, bool]:
    rate = describe(replace(clean_trace(), coil_current=Signal(times, np.ones(len(times))))).signals["coil_current"]
    assert rate.samples == len(times)
    return rate.rate, rate.in_bursts


def test_a_rate_of_messages_in_bursts_is_that_of_the_messages() -> None:
    # 10,000 samples in 0.2 s, fifty at a time and 7 µs apart: 50 kHz, though most intervals say 143 kHz.
    times = (np.arange(200)[:, None] * 1e-3 + np.arange(50) * 7e-6).ravel()
    assert rate_of(times) == (pytest.approx(50_000, rel=0.02), True)


def test_a_rate_does_not_suffer_from_gaps_and_jitter() -> None:
    times = np.arange(2000) / 1e4 + np.random.default_rng(5).uniform(0, 2e-5, 2000)
    times[1000:] += 5.0
    assert rate_of(times) == (pytest.approx(10_000, rel=0.01), False)


@pytest.mark.parametrize("count", [1, 2, 3, 15])
def test_a_rate_of_a_few_samples(count: int) -> None:
    assert rate_of(0.01 * np.arange(count)) == (pytest.approx(100.0 if count > 1 else 0.0), False)
