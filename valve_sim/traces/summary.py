"""What there is to say about a trace before anything is fitted to it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.traces.clocks import find_gaps
from valve_sim.traces.strokes import find_strokes, sample_noise

if TYPE_CHECKING:
    from valve_sim.traces.strokes import Stroke
    from valve_sim.traces.trace import Trace


class Gap(NamedTuple):
    """A stretch without samples: where it begins, s, and how long it is, s."""

    start: float
    length: float


class Rate(NamedTuple):
    """How many samples a signal has, and how many a second it has as a rule (Hz)."""

    samples: int
    rate: float


@dataclass(frozen=True)
class TraceSummary:
    """A trace in a few numbers.

    Attributes:
        source: The file and the valve.
        duration: From the first to the last sample, s.
        epoch_ns: The first stamp, ns.
        clock: "header" or "bag".
        signals: Samples and usual rate by name: position, main_position, coil_current ... as far as recorded.
        jitter: 99 % quantile of the deviation of the sample interval from its median, s.
        gaps: Intervals over three times the usual one.
        commands: How many commands there are.
        voltages: The commanded levels, V, ascending.
        position_range: Lowest and highest position of the pilot plunger, m.
        noise: Standard deviation of the position's noise from sample to sample, m.
        strokes: What the commands did.
        findings: What reading the trace found.
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
    position_range: tuple[float, float]
    noise: float
    strokes: tuple[Stroke, ...]
    findings: tuple[str, ...]


def describe(trace: Trace) -> TraceSummary:
    """Sum up a trace for `valve-sim info`."""
    intervals = np.diff(trace.times)
    jitter = float(np.quantile(np.abs(intervals - np.median(intervals)), 0.99)) if len(intervals) else 0.0
    return TraceSummary(
        source=trace.source,
        duration=float(trace.times[-1] - trace.times[0]),
        epoch_ns=trace.epoch_ns,
        clock=trace.clock,
        signals=_rates(trace),
        jitter=jitter,
        gaps=tuple(Gap(float(trace.times[place]), float(intervals[place])) for place in find_gaps(trace.times)),
        commands=len(trace.drive.times),
        voltages=tuple(np.unique(trace.drive.volts).tolist()),
        position_range=(float(trace.pilot_position.min()), float(trace.pilot_position.max())),
        noise=sample_noise(trace.pilot_position),
        strokes=find_strokes(trace),
        findings=trace.findings,
    )


def _rates(trace: Trace) -> dict[str, Rate]:
    times = {"position": trace.times}
    if trace.main_position is not None:
        times["main_position"] = trace.times
    for name in ("coil_current", "acceleration", "inlet_pressure", "coil_temperature"):
        signal = getattr(trace, name)
        if signal is not None:
            times[name] = signal.times
    return {name: Rate(len(stamps), _usual_rate(stamps)) for name, stamps in times.items()}


def _usual_rate(times: np.typing.NDArray[np.float64]) -> float:
    return float(1.0 / np.median(np.diff(times))) if len(times) > 1 else 0.0
