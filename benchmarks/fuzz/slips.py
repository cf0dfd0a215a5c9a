"""Recordings that were put together in Python, with one defect: a surface of `benchmarks.fuzz`.

Each must end in one typed error of one line that says what is wrong. A number gives a case again.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.diagnosis.identify import identify
from valve_sim.identification.diagnosis.run import diagnose
from valve_sim.identification.validation.replay import validate
from valve_sim.model import Drive, Valve, ValveError, simulate
from valve_sim.recordings import Signal, Trace

LONGEST: Final = 400
"""Characters of a message that is read at a glance."""

Array = NDArray[np.float64]
Random = np.random.Generator


Spoil = Callable[[Array, Random], Any]
"""Makes another array, or something else, of a sound one."""


def _holed(values: Array, random: Random, hole: float = np.nan) -> Array:
    values = np.array(values, dtype=np.float64)
    values[random.integers(0, len(values), random.integers(1, 5))] = hole
    return values


SPOILT: Final[Sequence[Spoil]] = (
    _holed,
    lambda values, random: _holed(values, random, np.inf),
    lambda values, random: _holed(values, random, -np.inf),
    lambda values, random: values[: -int(random.integers(1, min(len(values), 9)))],
    lambda values, random: values[:, None],
    lambda values, random: values.astype(complex),
    lambda values, random: values.astype(object),
    lambda values, random: values.astype(str),
)
"""What no array may be, wherever it stands: with holes, too short, a column, complex, of objects, of words."""


def refused(work: Callable[[], object], place: str) -> str:
    """'refused'.

    Raises:
        AssertionError: it does not end in a typed error of one line, short enough to be read, that names the place.
        Exception: what else it ends in.
    """
    try:
        work()
    except ValveError as error:
        message = str(error)
        is_a_line = message.strip() and "\n" not in message and len(message) <= LONGEST
        assert is_a_line and place in message, f"{place}: {message[:200]!r}"
        return "refused"
    raise AssertionError("nothing was refused")


@cache
def sound_trace() -> Trace:
    """Four strokes of the default valve with noise, its current recorded."""
    random = np.random.default_rng(1)
    valve = Valve.from_mapping(DECLARED, "the declared valve")
    drive = Drive.of([0.01, 0.04, 0.07, 0.10, 0.13, 0.16, 0.19, 0.22], [9.0, 0.0, 12.0, 0.0, 8.0, 0.0, 14.0, 0.0])
    times = np.arange(1200) / 5e3
    run = simulate(valve, drive, times)
    position = run.pilot_position + random.normal(0.0, 1e-6, len(times))
    main = run.main_position + random.normal(0.0, 1e-6, len(times))
    current = Signal(np.copy(times), run.coil_current + random.normal(0.0, 1e-3, len(times)))
    return Trace("made.mcap", drive, times, position, main, coil_current=current)


DECLARED: Final[dict[str, Any]] = {
    "valve": {
        "attraction_polynomial": [3.0336, 17.096e3, -30.931e6, 24.026e9], "coil_time_constant": 0.9934e-3,
        "coil_resistance": 10.0,
    }
}  # fmt: skip

COLUMNS: Final = ("times", "pilot_position", "main_position", "drive.times", "drive.volts", "coil_current.times",
                  "coil_current.values")  # fmt: skip


def _with_column(trace: Trace, column: str, values: Any) -> Trace:
    owner, _, name = column.rpartition(".")
    if not owner:
        return replace(trace, **{name: values})
    return replace(trace, **{owner: getattr(trace, owner)._replace(**{name: values})})


def _column(trace: Trace, column: str) -> Array:
    found: Any = trace
    for name in column.split("."):
        found = getattr(found, name)
    return np.copy(found)


Defect = Callable[[Trace, Random], Any]


def _in_column(spoil: Spoil, column: str) -> Defect:
    return lambda trace, random: _with_column(trace, column, spoil(_column(trace, column), random))


TIMES: Final = ("times", "drive.times", "coil_current.times")
DEFECTS: Final[Sequence[Defect]] = (
    *(_in_column(spoil, column) for column in COLUMNS for spoil in SPOILT),
    *(_in_column(lambda values, random: np.float64(values[0]), column) for column in COLUMNS),
    *(_in_column(lambda values, random: values.tolist(), column) for column in COLUMNS),
    *(_in_column(lambda values, random: (1e6 * values).astype(np.int64), column) for column in COLUMNS),
    *(_in_column(lambda values, random: None, column) for column in (
        "times", "pilot_position", "drive.times", "coil_current.values",
    )),
    *(_in_column(lambda values, random: values[::-1], column) for column in TIMES),
    *(_in_column(lambda values, random: random.permutation(values), column) for column in TIMES),
    _in_column(lambda values, random: np.full(len(values), values[0]), "times"),
    lambda trace, random: replace(trace, drive=(0.0, 9.0)),
    lambda trace, random: replace(trace, coil_current=trace.coil_current.values),  # type: ignore[union-attr]
    lambda trace, random: {"made.mcap": trace},
    lambda trace, random: [str(trace.source)],
    lambda trace, random: trace,
    lambda trace, random: [],
    lambda trace, random: replace(trace, drive=Drive.of([], [])),
    lambda trace, random: _few(trace, 0),
    lambda trace, random: _few(trace, int(random.integers(1, 3))),
)  # fmt: skip
"""What may be wrong with a recording."""


def _few(trace: Trace, count: int) -> Trace:
    """The first samples alone."""
    return Trace(trace.source, trace.drive, trace.times[:count], trace.pilot_position[:count])


def try_recording(number: int) -> str:
    """Diagnose, identify or validate with a spoilt recording; see `refused`."""
    spoilt = DEFECTS[number % len(DEFECTS)](sound_trace(), np.random.default_rng([number, 2]))
    # A recording may be given bare, where a list is wanted.
    traces = [spoilt] if isinstance(spoilt, Trace) and spoilt is not sound_trace() else spoilt
    valve = Valve.from_mapping(DECLARED, "the declared valve")
    uses: Sequence[Callable[[], object]] = (
        lambda: diagnose(traces, [], valve),
        lambda: identify(traces, valve),
        lambda: validate(traces, valve),
    )
    return refused(uses[number % len(uses)], "")
