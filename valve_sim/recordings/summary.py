"""Summary of a trace, before anything is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.recordings.clocks import find_gaps
from valve_sim.recordings.motion import sample_noise
from valve_sim.recordings.strokes import find_stroke_parts

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from valve_sim.recordings.strokes import StrokePart
    from valve_sim.recordings.trace import Trace


class Gap(NamedTuple):
    """A time without samples: when it begins and how long it is, both in s."""

    start: float
    length: float


RATE_BLOCKS = 20
"""A rate is the median over so many stretches of equally many samples: gaps and bursts fill only some of them."""

BURST_FACTOR = 1.5
"""Where most intervals are shorter than the rate says by this factor, the samples came in bursts."""


class Rate(NamedTuple):
    """How densely a signal was sampled.

    Attributes:
        samples: How many there are.
        rate: How many a second, Hz: samples over time in a typical stretch of the recording.
        in_bursts: Whether they came in bursts, as messages do that are timed by their arrival.
    """

    samples: int
    rate: float
    in_bursts: bool = False


@dataclass(frozen=True)
class TraceSummary:
    """A trace in a few numbers.

    Attributes:
        source: The file and the valve.
        duration: From the first to the last sample, s.
        epoch_ns: The first stamp, ns.
        clock: "header", "bag", "time column" or "rate".
        timed_by: That in words: a rate with its number and the map that says it.
        signals: Number and rate of the samples by name: position, main_position, coil_current ... as far as recorded.
        jitter: 99 % quantile of the deviation of the sample interval from its median, s.
        gaps: Intervals over three times the usual one.
        commands: How many commands there are.
        voltages: The commanded levels, V, ascending.
        position_range: Lowest and highest position of the pilot plunger, m; None where none was recorded.
        noise: Standard deviation of the noise from sample to sample: of the position, m, or without any of the
            current, A, or else of the outlet's pressure, Pa.
        primary_signal: Which of them, as `Trace.primary_signal`.
        input: What drives a model, in words: a measured voltage and where it is recorded, its levels, or the commands.
        strokes: What the commands did: the parts of its strokes.
        findings: What reading the trace found.
        left_out: How many positions are no measurements, by reason: see `LeftOut`; none without positions.
    """

    source: str
    duration: float
    epoch_ns: int
    clock: str
    signals: dict[str, Rate]
    jitter: float
    gaps: tuple[Gap, ...]
    commands: int
    voltages: tuple[float, ...]
    position_range: tuple[float, float] | None
    noise: float
    strokes: tuple[StrokePart, ...]
    findings: tuple[str, ...]
    primary_signal: str = "position"
    input: str = ""
    left_out: dict[str, int] = field(default_factory=dict)
    timed_by: str = ""


def describe(trace: Trace) -> TraceSummary:
    """Sum up a trace for `valve-sim info`."""
    times = trace.sample_times
    gaps = find_gaps(times)
    return TraceSummary(
        source=trace.source,
        duration=float(times[-1] - times[0]),
        epoch_ns=trace.epoch_ns,
        clock=trace.clock,
        signals=_rates(trace),
        jitter=_jitter(times) if len(times) > 1 else 0.0,
        gaps=tuple(Gap(float(times[place]), float(times[place + 1] - times[place])) for place in gaps),
        commands=len(trace.drive.times),
        voltages=tuple(np.unique(trace.drive.volts).tolist()),
        position_range=_position_range(trace),
        noise=sample_noise(trace.kept_position if trace.has_positions else trace.primary_samples.values),
        strokes=find_stroke_parts(trace),
        findings=trace.findings,
        primary_signal=trace.primary_signal,
        left_out=trace.left_out.counts if trace.has_positions else {},
        input=_input(trace),
        timed_by=trace.origins.get("time", f"{trace.clock} stamps"),
    )


def _input(trace: Trace) -> str:
    voltage, command = trace.origins.get("voltage", "the coil"), trace.origins.get("command", "")
    if trace.coil_voltage is not None:
        return f"the voltage measured by {voltage}" + (f", between the commands of {command}" if command else "")
    return f"the commands of {command}" if command else f"the levels of the voltage measured by {voltage}"


def _jitter(times: NDArray[np.float64]) -> float:
    intervals = np.diff(times)
    return float(np.quantile(np.abs(intervals - np.median(intervals)), 0.99))


def _position_range(trace: Trace) -> tuple[float, float] | None:
    position = trace.usable_position
    return (float(position.min()), float(position.max())) if trace.has_positions else None


def _rates(trace: Trace) -> dict[str, Rate]:
    times = {"position": trace.times} if trace.has_positions else {}
    if trace.main_position is not None:
        times["main_position"] = trace.times
    times |= {name: signal.times for name, signal in trace.signals().items()}
    return {name: _rate(stamps) for name, stamps in times.items()}


def _rate(times: NDArray[np.float64]) -> Rate:
    """The rate of a signal, whose times (s, ascending, shape (n,)) may have gaps and come in bursts.

    The median interval alone would be that within a burst.
    """
    if len(times) < 2:
        return Rate(len(times), 0.0)
    edges = np.unique(np.linspace(0, len(times) - 1, RATE_BLOCKS + 1).astype(np.intp))
    rate = float(np.median(np.diff(edges) / np.diff(times[edges])))
    usual = float(np.median(np.diff(times)))
    return Rate(len(times), rate, in_bursts=usual * rate * BURST_FACTOR < 1.0)
