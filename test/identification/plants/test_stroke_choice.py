"""Which strokes of a long recording a diagnosis looks at."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from valve_sim.files.parameter_files import default_valve
from valve_sim.identification.plants import stroke_choice
from valve_sim.identification.plants.stroke_choice import AT_REST, FEWEST, MANY, choose_strokes
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import Drive
from valve_sim.recordings import Signal, Trace, stroke_numbers

RATE = 20_000.0


def still(strokes: list[tuple[float, float]], period: float = 0.08) -> Trace:
    """A valve that does not move; of each stroke the voltage, V, and for how long, s, it holds."""
    rng = np.random.default_rng(1)
    on = 0.01 + period * np.arange(len(strokes))
    times = np.stack([on, on + [held for _, held in strokes]], axis=1).ravel()
    volts = np.stack([[volts for volts, _ in strokes], np.zeros(len(strokes))], axis=1).ravel()
    samples = np.arange(round(period * len(strokes) * RATE)) / RATE
    return Trace("still", Drive(times, volts), samples, 1e-6 * rng.standard_normal(len(samples)))


def test_what_is_not_long_stays_whole() -> None:
    trace = still([(9.0, 0.04)] * 100)
    assert len(trace.times) <= MANY
    assert choose_strokes([trace]) == ([trace], None)


def test_kinds_have_equal_shares_from_the_first_stroke_to_the_last(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stroke_choice, "AT_REST", 10_000)
    # The same voltage for another time is another kind; one of them is rare.
    strokes = [(9.0, 0.04), (12.0, 0.04), (9.0, 0.02)] * 60 + [(7.0, 0.04)] * 3
    trace = still(strokes)
    (kept,), choice = choose_strokes([trace])
    assert choice is not None
    assert (choice.recorded, choice.kinds, choice.of, choice.samples) == (183, 4, len(trace.times), len(kept.times))
    chosen = [stroke for _, stroke in choice.chosen]
    assert len(chosen) == pytest.approx(100_000 / 1600, abs=1)
    shares = [sum(strokes[stroke] == kind for stroke in chosen) for kind in dict.fromkeys(strokes)]
    assert shares[3] == 3
    assert max(shares[:3]) - min(shares[:3]) <= 1
    assert {0, 1, 2, 177, 178, 179} <= set(chosen)
    np.testing.assert_array_equal(np.unique(stroke_numbers(kept.drive, kept.times)), chosen)
    # What the valve has gone through stays.
    np.testing.assert_array_equal(kept.drive.times, trace.drive.times)
    # An error is estimated of the commands of these strokes alone.
    assert len(ValvePlant([kept], default_valve()).timing_errors) == 2 * len(chosen)


def test_of_long_rests_the_middle_is_left_out() -> None:
    trace = still([(9.0, 0.04)] * 30, period=0.5)
    shown = Signal(trace.times, np.zeros(len(trace.times)))
    (kept,), choice = choose_strokes([replace(trace, coil_current=shown, coil_voltage=shown)])
    assert choice is not None
    assert len(choice.chosen) == 30
    assert len(kept.times) < 0.5 * len(trace.times)
    assert kept.coil_current is not None and kept.coil_voltage is not None
    np.testing.assert_array_equal(kept.coil_current.times, kept.times)
    # The voltage drives the model.
    assert len(kept.coil_voltage.times) == len(trace.times)
    for command in kept.drive.times[1:-1]:
        around = np.abs(kept.times - command) < AT_REST / RATE - 1e-4
        assert np.count_nonzero(around) == pytest.approx(2 * AT_REST, abs=8)


def test_of_several_recordings_a_few_strokes_each() -> None:
    traces = [still([(volts, 0.04)] * 60) for volts in (7.0, 8.0, 9.0)]
    kept, choice = choose_strokes(traces)
    assert choice is not None
    assert len(kept) == 3
    assert len(choice.chosen) >= FEWEST
    assert {recording for recording, _ in choice.chosen} == {0, 1, 2}
