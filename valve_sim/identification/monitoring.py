"""Beside a real valve: each stroke held against the model, an alarm of a stated false-alarm rate. No clock, no ROS.

Two halves, for two threads. A `Watch` is fed commands and samples as they come; it steps the model beside them, cuts
the stream into strokes, and says at once when the valve does not open or does not close. A `Judge` takes the strokes,
some milliseconds each, whenever there is time. A `Monitor` is both in a row.

The first strokes commission the valve: its dampings, the clocks' offset, the scatter of the commands' stamps and the
sensor's noise are fitted to them all together, and held from then on. `stroke_scores` says how a stroke is held against
that, `alarm` how many deviations in a row are too many. Scores are standard normal by theory where the commissioning
strokes do not contradict it; where they do, because the declared form is not the valve's, they are counted from the
mean and spread of those strokes (as Student's t): what is watched is then whether the valve changes, and `Judge` says
so. An effect with a memory beyond one stroke, such as coil heating, begins anew with each stroke here.

All memory is bounded: while nothing moves for longer than `settle`, samples are not kept.
"""

from __future__ import annotations

import bisect
import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np
from scipy.special import ndtri, stdtr

from valve_sim.identification.alarm import Alarm, Sums
from valve_sim.identification.fitting import Interval
from valve_sim.identification.plant import Array
from valve_sim.identification.stroke_scores import (
    SIZE,
    Healthy,
    Scored,
    commission,
    crossing,
    refitted,
    score_stroke,
)
from valve_sim.model import Drive, EventKind, Phase, Reading, SimulationError, Stepper, Valve, simulate
from valve_sim.traces import Signal, Trace, events_from_sensors

LEAD: Final = 0.25
"""s of rest before a stroke that are kept with it: they show the noise."""
MOST_SAMPLES: Final = 100_000
"""Of a stroke; one that has more is ended."""
MOST_COMMANDS: Final = 1000
"""Of a stroke; further ones are not kept."""
OPENED: Final = 0.9
"""Share of the stroke that counts as open."""
CLOSED: Final = 0.1
"""Share of the stroke that counts as closed."""
STILL: Final = 1e-5
"""m/s: below it the model rests."""
NO_CURRENT: Final = 1e-3
"""Share of the reference current that is none."""
CONTRADICTS: Final = 4.0
"""Standard errors by which the mean of commissioning scores is not 0."""
TOO_SPREAD: Final = 1.7
"""Standard deviation of twenty standard normal scores, beyond what one set in 10,000 has."""
TRACED_FROM: Final = 6
"""Strokes of an alarm with which its cause is first looked for."""
SCORED_MOST: Final = 8.0
"""Standard deviations: the most that a score says."""
FEWEST_SAMPLES: Final = 4
"""Of a stroke between its first command and its last."""
FEWEST_TO_LEARN: Final = 8
"""Commissioning strokes that show a direction, from which its mean and spread are learned."""
FORGETS: Final = 20
"""Judged strokes without a further alarm, after which one is over."""
MOST_VOLTS: Final = 1e4
"""V: no coil has more, and stepping the forces of more takes minutes a second."""
LONGEST_GAP: Final = 60.0
"""s without samples, after which the model is not stepped on but begins at rest."""


class MonitorSettings(NamedTuple):
    """How a valve is watched.

    Attributes:
        commissioning_strokes: so many first strokes, taken for healthy.
        strokes_between_false_alarms: mean number, of a healthy valve.
        diagnosis_strokes: so many last strokes are kept for the tracing.
        stroke_timeout: s after which a stroke that has not ended is.
        settle: s of rest after which a stroke has ended.
        noise: standard deviation of the position sensor, m; 0 to estimate it.
        patience: s that a valve may be later than the model before it is said to be stuck; as long as the model took,
            if that is longer.
    """

    commissioning_strokes: int = 20
    strokes_between_false_alarms: float = 10_000.0
    diagnosis_strokes: int = 20
    stroke_timeout: float = 600.0
    settle: float = 0.05
    noise: float = 0.0
    patience: float = 0.1


class Prediction(NamedTuple):
    """The model beside one sample; the residual is measured less predicted, m."""

    reading: Reading
    residual: float


class StrokeRecord(NamedTuple):
    """One stroke as it was cut out.

    Attributes:
        number: from 0 on. time: of the opening command, s. trace: times since `trace.epoch_ns`.
        remark: why it cannot be held against the model; empty if it can.
        opened, closed: whether the valve was seen to; None where the model did not. fault: empty, or what went wrong.
    """

    number: int
    time: float
    trace: Trace
    remark: str
    opened: bool | None
    closed: bool | None
    fault: str


class StrokeReport(NamedTuple):
    """What is said of one stroke; times in s after their command, nan where not seen.

    Attributes:
        record: the stroke. name: for people.
        opening_delay: until the pilot plunger leaves its seat. t1: until it reaches the main plunger. t2: until the
            stop. closing_time: from the closing command until the pilot plunger is back.
        rms: m, of what the model leaves; nan where it was not held against it.
        noise: m, of the sensor; nan before commissioning. damping: refitted to this stroke alone, or empty.
        scores: standard normal while healthy, by direction; empty where the stroke was not judged.
        state: "commissioning", "watching" or "not judged". remark: why, where it was not.
        alarm: raised by this stroke. cause, sum: of the highest sum; threshold: at which the alarm is raised.
    """

    record: StrokeRecord
    name: str
    opening_delay: float
    t1: float
    t2: float
    closing_time: float
    rms: float
    noise: float
    damping: Mapping[str, Interval]
    scores: Mapping[str, float]
    state: str
    remark: str
    alarm: Alarm | None
    cause: str
    sum: float
    threshold: float

    def to_json(self) -> dict[str, Any]:
        """Plain numbers in SI units; null for what is not known."""
        loudest = sorted(self.scores.items(), key=lambda item: -abs(item[1]))[:3]
        return {
            "schema": "valve_sim/stroke/1",
            "stroke": self.record.number,
            "name": self.name,
            "time": self.record.time,
            "state": self.state,
            "remark": self.remark or None,
            "opened": self.record.opened,
            "closed": self.record.closed,
            "fault": self.record.fault or None,
            "opening_delay": _number(self.opening_delay),
            "t1": _number(self.t1),
            "t2": _number(self.t2),
            "closing_time": _number(self.closing_time),
            "residual_rms_um": _number(1e6 * self.rms),
            "noise_um": _number(1e6 * self.noise),
            "damping": {name: interval.to_json() for name, interval in self.damping.items()},
            "scores": dict(loudest),
            "alarm": {
                "raised": self.alarm is not None,
                "cause": (self.alarm.cause if self.alarm else self.cause) or None,
                "sum": _number(self.sum),
                "threshold": _number(self.threshold),
            },
        }


class Watch:
    """The live half: a model stepped beside the samples, and the stream cut into strokes. Some µs a sample.

    Times are seconds since any one moment. Samples come in the order of their times, and so do commands.

    Args:
        valve: the declared valve.
        settings: how it is watched.
    """

    def __init__(self, valve: Valve, settings: MonitorSettings) -> None:
        self._settings = settings
        self._valve = valve
        self._lateness = 0.0
        self._next: tuple[Valve, float] | None = None
        self.strokes = 0
        self.rejected = 0
        self.reset()

    @property
    def valve(self) -> Valve:
        """What is stepped beside the samples."""
        return self._valve

    @property
    def kept(self) -> int:
        """How many samples are in memory."""
        return len(self._times)

    def reset(self) -> None:
        """Begin anew, as after a jump of the clock: a valve at rest, of which nothing is known."""
        self.fault = ""
        """What the valve does not do, in words; empty where it does. Stays until a stroke goes well."""
        self._stepper: Stepper | None = None
        self._stepped = -math.inf
        self._volts = math.nan
        self._last = self._last_command = -math.inf
        self._position = math.nan
        self._pending: deque[tuple[float, float]] = deque()
        self._times: list[float] = []
        self._positions: list[float] = []
        self._current_times: list[float] = []
        self._currents: list[float] = []
        self._phase = Phase.CLOSED
        self._phase_since = -math.inf
        self._rest_since = math.inf
        self._stroke: _Stroke | None = None
        self._finished: deque[StrokeRecord] = deque()

    def use(self, valve: Valve, lateness: float) -> None:
        """Step this valve from the next stroke on, its motion later than the stamps say by `lateness`, s."""
        self._next = valve, lateness

    def command(self, time: float, volts: float) -> None:
        """A voltage in force from `time` on, s; one that repeats the voltage in force changes nothing.

        It waits for the first sample of its time or later, so that either may come in late. What is not finite, or of
        an earlier time than the last, is rejected and counted.
        """
        latest = self._pending[-1][0] if self._pending else self._last_command
        is_possible = math.isfinite(time) and abs(volts) <= MOST_VOLTS
        if not is_possible or time < latest or len(self._pending) >= MOST_COMMANDS:
            self.rejected += 1
            return
        self._pending.append((time, volts))
        self._obey(self._last)

    def _obey(self, until: float) -> None:
        """The commands whose time has come."""
        while self._pending and self._pending[0][0] <= until:
            self._energise(*self._pending.popleft())

    def _energise(self, time: float, volts: float) -> None:
        before = 0.0 if math.isnan(self._volts) else self._volts
        self._volts = volts
        if before == volts:
            return
        self._last_command, self._rest_since = time, math.inf
        if before == 0.0:
            self._begin(time)
        if self._stroke is not None and len(self._stroke.drive) < MOST_COMMANDS:
            self._stroke.drive.append((time, volts))
        try:
            self._model(time).command(time, volts)
        except SimulationError:
            # A voltage that no coil has: the model rests without current until the next command.
            self._stepper = Stepper(self._valve, time)
            if self._stroke is not None:
                self._stroke.is_at_rest = False

    def measure(self, time: float, position: float) -> Prediction | None:
        """One sample of the pilot plunger's position, m; the model beside it, None where the sample was rejected."""
        if not (math.isfinite(time) and math.isfinite(position)) or time <= self._last:
            self.rejected += 1
            return None
        self._obey(time)
        reading = self._step(time)
        self._keep(time, [time], [position])
        self._look(time, position, position, reading)
        return Prediction(reading, position - reading.pilot_position)

    def measure_many(self, times: Array, positions: Array) -> None:
        """A batch of some milliseconds, good and in order; the model is stepped to its end only."""
        last = float(times[-1])
        self._obey(last)
        reading = self._step(last)
        self._keep(last, times.tolist(), positions.tolist())
        self._look(last, float(positions[-1]), float(positions.max()), reading)

    def measure_current(self, time: float, current: float) -> None:
        """One sample of the coil current, A: kept with the stroke for the tracing; rejected as positions are."""
        last = self._current_times[-1] if self._current_times else -math.inf
        if not (math.isfinite(time) and math.isfinite(current)) or time <= last:
            self.rejected += 1
        elif len(self._current_times) < MOST_SAMPLES and self._is_kept(time):
            self._current_times.append(time)
            self._currents.append(current)

    def take_finished(self) -> list[StrokeRecord]:
        """The strokes that have ended since it was last asked."""
        finished = list(self._finished)
        self._finished.clear()
        return finished

    def _model(self, time: float) -> Stepper:
        if self._stepper is None or time - self._stepped > LONGEST_GAP:
            # Stepping over years, where a stamp leaps, would take hours: at rest from here on.
            self._stepper = Stepper(self._valve, time - self._lateness)
            if self._stroke is not None:
                self._stroke.is_at_rest = False
        self._stepped = time
        return self._stepper

    def _step(self, time: float) -> Reading:
        """The model at a sample; a sample that was stamped before the last command sees it at the command."""
        at = max(time - self._lateness, self._last_command)
        try:
            return self._model(time).advance(at)
        except SimulationError:
            self._stepper = Stepper(self._valve, at)
            if self._stroke is not None:
                self._stroke.is_at_rest = False
            return self._stepper.advance(at)

    def _keep(self, time: float, times: list[float], positions: list[float]) -> None:
        """All of a stroke but what comes after a long rest of the model; between strokes, the last moments."""
        if self._is_kept(time):
            self._times.extend(times)
            self._positions.extend(positions)

    def _is_kept(self, time: float) -> bool:
        return self._stroke is None or time - self._rest_since <= self._settings.settle

    def _look(self, time: float, position: float, highest: float, reading: Reading) -> None:
        self._last, self._position = time, position
        is_still = abs(reading.pilot_velocity) <= STILL
        phase = Phase.CLOSED if is_still and self._is_closed(reading.pilot_position) else reading.phase
        if phase is not self._phase:
            self._phase, self._phase_since = phase, time
        self._rest_since = min(self._rest_since, time) if is_still else math.inf
        stroke = self._stroke
        if stroke is not None:
            stroke.highest = max(stroke.highest, highest)
            stroke.model_opened = stroke.model_opened or reading.phase is Phase.OPEN
        self._judge_position(time, position)
        if stroke is not None:
            self._end_if_over(stroke, time)
        elif self._times[-1] - self._times[0] > 2.0 * LEAD or len(self._times) > MOST_SAMPLES:
            self._keep_from(time - LEAD)

    def _judge_position(self, time: float, position: float) -> None:
        """Whether the valve is where the model has been for longer than patience allows."""
        if math.isnan(self._volts):
            return
        took, patience = self._phase_since - self._last_command, self._settings.patience
        if time - max(self._phase_since, self._last_command) <= max(patience, took if math.isfinite(took) else 0.0):
            return
        stroke = self._stroke
        if self._phase is Phase.OPEN and self._volts != 0.0 and stroke is not None and stroke.opened is None:
            self._judge_opening(stroke)
        elif self._phase is Phase.CLOSED and self._volts == 0.0 and (stroke is None or stroke.closed is None):
            closed = self._is_closed(position)
            if not closed:
                self.fault = f"the valve did not close: {1e3 * position:.3f} mm open, without voltage"
            if stroke is not None:
                stroke.closed, stroke.fault = closed, stroke.fault or ("" if closed else self.fault)

    def _is_closed(self, position: float) -> bool:
        """Of the valve, or of the model, which without seat load floats some picometres above its seat."""
        return position <= CLOSED * self._valve.parameters.stroke

    def _judge_opening(self, stroke: _Stroke) -> None:
        parameters = self._valve.parameters
        stroke.opened = stroke.highest >= OPENED * parameters.stroke
        if stroke.opened:
            return
        if stroke.highest < parameters.pilot_gap:
            moved = 1e3 * max(stroke.highest, 0.0)
            self.fault = f"the valve did not open: the pilot plunger moved {moved:.3f} mm only"
        else:
            self.fault = f"the valve opened to {1e3 * stroke.highest:.3f} mm only, of {1e3 * parameters.stroke:.3f} mm"
        stroke.fault = self.fault

    def _begin(self, time: float) -> None:
        """An opening command: what ran before ends, and a stroke begins."""
        if self._stroke is not None:
            self._finish(self._stroke, "")
        at = max(time, self._last - self._lateness)
        reading = self._model(time).advance(at)
        parameters = self._valve.parameters
        has_current = abs(reading.coil_current) * parameters.coil_resistance > NO_CURRENT * parameters.reference_voltage
        is_closed = self._phase is Phase.CLOSED and (math.isnan(self._position) or self._is_closed(self._position))
        is_at_rest = is_closed and not has_current
        self._stroke = _Stroke(is_at_rest)
        if self._next is not None and is_at_rest:
            (self._valve, self._lateness), self._next = self._next, None
            self._stepper = Stepper(self._valve, min(time, at))

    def _end_if_over(self, stroke: _Stroke, time: float) -> None:
        if time - stroke.drive[0][0] > self._settings.stroke_timeout:
            self._finish(stroke, "it did not end before stroke_timeout")
        elif len(self._times) > MOST_SAMPLES or len(stroke.drive) >= MOST_COMMANDS:
            self._finish(stroke, "it is too long to be kept")
        elif self._volts == 0.0 and time - self._rest_since > self._settings.settle and (
            stroke.closed is not None or self._phase is not Phase.CLOSED
        ):  # fmt: skip
            self._finish(stroke, "")

    def _finish(self, stroke: _Stroke, remark: str) -> None:
        """Hand the stroke out; its last moments at rest are the next one's first."""
        if stroke.opened is None and stroke.model_opened:
            self._judge_opening(stroke)
        if stroke.closed is None and self._phase is Phase.CLOSED and self._is_closed(self._position):
            stroke.closed = True
        if not stroke.fault:
            self.fault = ""
        start = self._times[0] if self._times else stroke.drive[0][0]
        times, volts = np.array(stroke.drive, dtype=np.float64).T
        trace = Trace(
            f"stroke {self.strokes}",
            Drive(times - start, volts.copy()),
            np.array(self._times) - start,
            np.array(self._positions),
            coil_current=self._current_since(start),
            epoch_ns=round(start * 1e9),
        )
        remark = remark or ("" if stroke.is_at_rest else "it did not begin at rest") or stroke.fault
        first, last = float(trace.drive.times[0]), float(trace.drive.times[-1])
        opening = (trace.times > first) & ((trace.times < last) | (last == first))
        if np.count_nonzero(opening) < FEWEST_SAMPLES:
            remark = remark or "it has too few samples"
        self._finished.append(
            StrokeRecord(
                self.strokes, stroke.drive[0][0], trace, remark, stroke.opened, stroke.closed, stroke.fault
            )
        )  # fmt: skip
        self.strokes += 1
        self._stroke = None
        is_closed = self._phase is Phase.CLOSED and math.isfinite(self._rest_since)
        self._keep_from(max(self._rest_since, self._last - LEAD) if is_closed else math.inf)

    def _current_since(self, start: float) -> Signal | None:
        """Until the last sample: what came in later belongs to the next stroke."""
        stop = bisect.bisect_right(self._current_times, self._last)
        if stop == 0:
            return None
        return Signal(np.array(self._current_times[:stop]) - start, np.array(self._currents[:stop]))

    def _keep_from(self, time: float) -> None:
        for times, values in ((self._times, self._positions), (self._current_times, self._currents)):
            first = max(bisect.bisect_left(times, time), len(times) - MOST_SAMPLES // 2)
            del times[:first], values[:first]


class Judge:
    """The other half: strokes in, reports out. Some milliseconds a stroke; a second at the end of commissioning.

    Args:
        valve: the declared valve.
        settings: how it is watched.
    """

    def __init__(self, valve: Valve, settings: MonitorSettings) -> None:
        self._declared = valve
        self._settings = settings
        self._first: list[Trace] = []
        self._baseline: dict[str, _Baseline] = {}
        self._sums: Sums | None = None
        self._recent: deque[tuple[int, Trace]] = deque(maxlen=settings.diagnosis_strokes)
        self._loudest, self._sum, self._threshold = "", math.nan, math.nan
        self._last_raised = -math.inf
        self._judged = 0
        self._trace_at = 0
        self.healthy: Healthy | None = None
        """The valve as commissioned; None before."""
        self.alarm: Alarm | None = None
        """The last alarm, while it is not over."""
        self.alarms = 0

    @property
    def commissioned(self) -> int:
        """How many strokes commissioning has had."""
        return len(self._first)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Directions in which the healthy valve differs from the declared form: empty if that explains it."""
        return tuple(name for name, baseline in self._baseline.items() if baseline.is_learned and name != SIZE)

    def evidence(self) -> list[Trace]:
        """The last strokes since the alarm began to rise, at most `diagnosis_strokes`."""
        began = self.alarm.began if self.alarm is not None else 0
        found = [trace for index, trace in self._recent if index >= began]
        # The sum may have begun to rise, by chance, one stroke early.
        return found[1:] if len(found) > TRACED_FROM else found

    def take_evidence(self) -> list[Trace]:
        """The evidence, when it is time to trace the cause (again); else none.

        That is once there are `TRACED_FROM` strokes of the alarm, at twice as many, and at each full ring of new ones.
        """
        evidence = self.evidence() if self.alarm is not None else []
        if len(evidence) < TRACED_FROM or self._judged < self._trace_at:
            return []
        most = self._settings.diagnosis_strokes
        # A full ring gives one less, because `evidence` leaves the first out.
        missing = most - 1 - len(evidence)
        self._trace_at = self._judged + (min(len(evidence), missing) if missing > 0 else most)
        return evidence

    def judge(self, record: StrokeRecord, *, refit: bool = True) -> StrokeReport:
        """Hold a stroke against the commissioned valve, or commission with it.

        Args:
            record: from a `Watch`.
            refit: whether to refit the dampings to it, for the report.
        """
        scored, scores, alarm, state, remark = None, {}, None, "not judged", record.remark
        if not remark:
            try:
                if self.healthy is None:
                    state = "commissioning"
                    self._commission(record.trace)
                else:
                    state = "watching"
                    scored = score_stroke(record.trace, self.healthy)
                    scores = self._standard(scored.scores)
                    alarm = self._add(record, scores)
            except (SimulationError, np.linalg.LinAlgError) as error:
                state, remark = "not judged", f"the model could not be held against it: {error}"
        damping = self._refitted(record.trace) if refit and scored is not None else {}
        return self._report(record, scored, scores, alarm, state, remark, damping)

    def _commission(self, trace: Trace) -> None:
        self._first.append(trace)
        if len(self._first) < self._settings.commissioning_strokes:
            return
        try:
            healthy = commission(self._first, self._declared, self._settings.noise)
            table = [score_stroke(stroke, healthy).scores for stroke in self._first]
        finally:
            # What could not be commissioned with is not tried again with each stroke that follows.
            strokes, self._first = len(self._first), []
        names = tuple(dict.fromkeys(name for scores in table for name in scores))
        self._baseline = {name: _Baseline.of(name, [s[name] for s in table if name in s]) for name in names}
        self._sums = Sums(self._settings.strokes_between_false_alarms, names, strokes, one_sided=(SIZE,))
        self._threshold = self._sums.threshold
        self.healthy = healthy

    def _standard(self, scores: Mapping[str, float]) -> dict[str, float]:
        return {name: self._baseline[name].standard(score) for name, score in scores.items() if name in self._baseline}

    def _add(self, record: StrokeRecord, scores: Mapping[str, float]) -> Alarm | None:
        assert self._sums is not None
        self._judged += 1
        self._recent.append((record.number, record.trace))
        alarm = self._sums.add(record.number, scores)
        if alarm is not None:
            self._loudest, self._sum = alarm.cause, self._sums.threshold
            # The tracing wants all strokes since the first of a row of alarms began.
            began = alarm.began if self.alarm is None else self.alarm.began
            self.alarm = alarm._replace(began=began)
            self.alarms += 1
            self._last_raised = self._judged
        else:
            self._loudest, self._sum = self._sums.largest
            if self._judged - self._last_raised > FORGETS:
                self.alarm, self._trace_at = None, 0
        return alarm

    def _refitted(self, trace: Trace) -> Mapping[str, Interval]:
        assert self.healthy is not None
        try:
            return refitted(trace, self.healthy)
        except SimulationError:
            return {}

    def _report(
        self,
        record: StrokeRecord,
        scored: Scored | None,
        scores: Mapping[str, float],
        alarm: Alarm | None,
        state: str,
        remark: str,
        damping: Mapping[str, Interval],
    ) -> StrokeReport:
        healthy, trace = self.healthy, record.trace
        seen = _arrivals(trace, self._declared) if len(trace.times) >= FEWEST_SAMPLES else {}
        lateness = healthy.lateness if healthy is not None else 0.0
        volts = trace.drive.volts
        return StrokeReport(
            record,
            f"stroke {record.number}, {volts[np.argmax(np.abs(volts))]:.1f} V",
            _opening_delay(trace, healthy.valve if healthy is not None else self._declared, lateness),
            seen.get("pilot_reaches_main", math.nan) - lateness,
            seen.get("reaches_stop", math.nan) - lateness,
            seen.get("reaches_seat", math.nan) - lateness,
            scored.rms if scored is not None else math.nan,
            healthy.noise.sigma if healthy is not None else math.nan,
            damping,
            scores,
            state,
            remark,
            alarm,
            self._loudest,
            self._sum,
            self._threshold,
        )


class Monitor:
    """Watch and judge in a row, for callers that have the time.

    Args:
        valve: the declared valve.
        settings: how it is watched.
        refit: whether reports have refitted dampings.
    """

    def __init__(self, valve: Valve, settings: MonitorSettings | None = None, *, refit: bool = True) -> None:
        settings = settings or MonitorSettings()
        self.watch = Watch(valve, settings)
        self.judge = Judge(valve, settings)
        self._refit = refit
        self._is_handed_over = False

    def command(self, time: float, volts: float) -> list[StrokeReport]:
        """As `Watch.command`; reports of the strokes that it ended."""
        self.watch.command(time, volts)
        return self._reports()

    def measure(self, time: float, position: float) -> list[StrokeReport]:
        """As `Watch.measure`."""
        self.watch.measure(time, position)
        return self._reports()

    def measure_many(self, times: Array, positions: Array) -> list[StrokeReport]:
        """As `Watch.measure_many`."""
        self.watch.measure_many(times, positions)
        return self._reports()

    def _reports(self) -> list[StrokeReport]:
        reports = [self.judge.judge(record, refit=self._refit) for record in self.watch.take_finished()]
        healthy = self.judge.healthy
        if healthy is not None and not self._is_handed_over:
            self.watch.use(healthy.valve, healthy.lateness)
            self._is_handed_over = True
        return reports


@dataclass
class _Stroke:
    """A stroke that is under way."""

    is_at_rest: bool
    drive: list[tuple[float, float]] = field(default_factory=list)
    highest: float = 0.0
    model_opened: bool = False
    opened: bool | None = None
    closed: bool | None = None
    fault: str = ""


@dataclass(frozen=True)
class _Baseline:
    """What a score was while the valve was commissioned; learned where that contradicts a standard normal one."""

    mean: float
    spread: float
    strokes: int
    is_learned: bool

    @classmethod
    def of(cls, name: str, scores: Sequence[float]) -> _Baseline:
        count = len(scores)
        if count < FEWEST_TO_LEARN:
            return cls(0.0, 1.0, count, False)
        mean, spread = float(np.mean(scores)), float(np.std(scores, ddof=1))
        # The size hangs on the noise's variance, which is itself an estimate.
        is_learned = name == SIZE or abs(mean) * math.sqrt(count) > CONTRADICTS or spread > TOO_SPREAD
        return cls(mean, spread, count, is_learned)

    def standard(self, score: float) -> float:
        if self.is_learned:
            quotient = (score - self.mean) / (max(self.spread, 1e-9) * math.sqrt(1.0 + 1.0 / self.strokes))
            tail = float(stdtr(self.strokes - 1, -abs(quotient)))
            score = math.copysign(float(ndtri(max(tail, 1e-16))), quotient)
        return min(max(score, -SCORED_MOST), SCORED_MOST)


def _arrivals(trace: Trace, valve: Valve) -> dict[str, float]:
    """By kind of arrival: s after its command, by the position sensor."""
    strokes = events_from_sensors(trace, valve.parameters.pilot_gap)
    return {event.kind: event.after_command for stroke in strokes for event in stroke.events}


def _opening_delay(trace: Trace, valve: Valve, lateness: float) -> float:
    """When the pilot plunger left its seat, s after the command: the model's time, and how late a low level is passed.

    The first micrometres hide in the noise, and grow with the third power of time; the level is a quarter of the gap.
    """
    drive = Drive(trace.drive.times[:1], trace.drive.volts[:1])
    before_next = trace.times < (trace.drive.times[1] if len(trace.drive.times) > 1 else math.inf)
    times, position = trace.times[before_next], trace.pilot_position[before_next]
    try:
        shown = simulate(
            valve, drive, times - lateness, start_time=float(min([drive.times[0], *(times[:1] - lateness)]))
        )
    except SimulationError:
        return math.nan
    level = 0.25 * valve.parameters.pilot_gap
    late = crossing(times, position, level, rises=True) - crossing(times, shown.pilot_position, level, rises=True)
    return shown.first(EventKind.UNSEATED) - float(drive.times[0]) + late


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None
