"""Each stroke compared with the baseline: an alarm at a stated false-alarm rate. No clock, no ROS.

The first strokes commission the valve: its dampings, the clocks' offset, the scatter of the commands' stamps, the
sensor's noise and what differs from stroke to stroke are fitted to them all together, and fixed from then on. `scores`
says how a stroke is compared with that, `cusum` when deviations raise an alarm. Scores are standard normal by theory
where the commissioning strokes do not contradict it; where they do, because the declared form is not the valve's, they
are counted from the mean and spread of those strokes (as Student's t): what is watched is then whether the valve
changes, and `StrokeMonitor` says so. Where commands' times scatter more than at commissioning, strokes are scored with
that scatter, and beyond a tenth of the opening time delays are not scored. An effect with a memory beyond one stroke,
such as coil heating, starts again with each stroke here.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.monitoring.command_timing import (
    UNINFORMATIVE,
    WIDER_SCATTER,
    CommandScatter,
    latest_of,
    level_for,
)
from valve_sim.identification.monitoring.commissioning import (
    Commissioning,
    commission_with,
    is_held_too_short,
    stroke_timing,
)
from valve_sim.identification.monitoring.cusum import FELL, Alarm, Sums, likeliest_change
from valve_sim.identification.monitoring.findings import (
    DidNotClose,
    NotSimulated,
    Remark,
    StrokeRecord,
    StrokeState,
    Unusable,
    WaitsForPressure,
)
from valve_sim.identification.monitoring.held_valve import held_fault
from valve_sim.identification.monitoring.kept_samples import with_joined_ends
from valve_sim.identification.monitoring.scores import (
    DELAYS,
    SIZE,
    Baseline,
    Scored,
    refitted,
    score_stroke,
)
from valve_sim.identification.monitoring.segmenter import FEWEST_SAMPLES
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.monitoring.shared_delay import SharedDelay, without_delay
from valve_sim.identification.monitoring.stroke_delays import crossing, delays_of
from valve_sim.identification.plants.protocol import Array
from valve_sim.identification.plants.valve_sensors import as_it_began
from valve_sim.model import Drive, EventKind, SimulationError, Valve, simulate
from valve_sim.recordings import Trace, events_from_sensors

FEWEST_TO_ISOLATE: Final = 6
"""Strokes of an alarm from which the fault is first isolated."""
FEWEST_WITH_GAS: Final = 4
"""Strokes of an alarm from which a fault of a valve with gas is first isolated: three to fit, one held out."""
ALARM_ENDS_AFTER: Final = 20
"""Scored strokes without a further alarm, after which an alarm is over."""


class StrokeReport(NamedTuple):
    """What is reported on one stroke; times in s after their command, nan where not seen.

    Attributes:
        record: the stroke. volts: its largest command, V, with its sign.
        opening_delay: until the pilot plunger leaves its seat. t1: until it reaches the main plunger. t2: until the
            stop. closing_time: from the closing command until the pilot plunger is back.
        errors: standard errors of t1, t2 and closing_time, s, by the sensor's noise and rate.
        rms: m, of the residual, or A where the record has no positions; nan where it was not compared with the model.
        noise: m or A, of the sensor; nan before commissioning. damping: refitted to this stroke alone, or empty.
        scores: standard normal while healthy, by direction; empty where the stroke was not scored.
        state: what it was used for. remark: why it was not compared with the baseline; None where it was.
        command_scatter: s, standard deviation of its commands' times; nan before commissioning.
        alarm: raised by this stroke. cause, sum: of the highest sum; threshold: at which the alarm is raised.
    """

    record: StrokeRecord
    volts: float
    opening_delay: float
    t1: float
    t2: float
    closing_time: float
    errors: tuple[float, float, float]
    rms: float
    noise: float
    damping: Mapping[str, Interval]
    scores: Mapping[str, float]
    state: StrokeState
    remark: Remark | None
    command_scatter: float
    alarm: Alarm | None
    cause: str
    sum: float
    threshold: float

    @property
    def has_positions(self) -> bool:
        """Whether it was judged by positions; else by the coil's current alone."""
        return self.record.trace.has_positions

    @property
    def is_incomplete(self) -> bool:
        """Whether it was not judged because messages are missing or late."""
        return isinstance(self.remark, Unusable) and self.remark.is_incomplete


class StrokeMonitor:
    """Strokes in, reports out. Some milliseconds per stroke; some seconds at the end of commissioning."""

    def __init__(self, valve: Valve, settings: MonitorSettings) -> None:
        self._declared = valve
        self._settings = settings
        self._first: list[StrokeRecord] = []
        self._scatter: CommandScatter | None = None
        self._shared: SharedDelay | None = None
        self._sums: Sums | None = None
        self._recent: deque[_Assessed] = deque(maxlen=settings.diagnosis_strokes)
        self._between: deque[Trace] = deque(maxlen=settings.diagnosis_strokes)
        self._leading, self._sum, self._threshold = "", math.nan, math.nan
        self._last_raised = -math.inf
        self._judged = 0
        self._isolate_at = 0
        self.commissioning: Commissioning | None = None
        """The result of commissioning; None before."""
        self.alarm: Alarm | None = None
        """The last alarm, while it is not over."""
        self.alarms = 0

    @property
    def baseline(self) -> Baseline | None:
        """The valve as commissioned; None before."""
        return None if self.commissioning is None else self.commissioning.baseline

    @property
    def commissioned(self) -> int:
        """Number of commissioning strokes so far."""
        return len(self._first)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Names of scores whose baseline contradicts the declared model; empty if that explains the valve."""
        if self.commissioning is None:
            return ()
        score_baselines = self.commissioning.score_baselines[self.commissioning.levels[0]]
        return tuple(name for name, score in score_baselines.items() if score.is_learned and name != SIZE)

    @property
    def command_scatter(self) -> float:
        """s, standard deviation of commands' times at present; nan before commissioning."""
        return math.nan if self._scatter is None else self._scatter.sigma

    @property
    def shared_delay(self) -> float:
        """s, by which the last strokes all obey their commands later than at commissioning; 0 where they do not.

        It may be of a clock, of a load, or of the valve, and is no alarm by itself.
        """
        return 0.0 if self._shared is None else self._shared.seconds

    @property
    def is_timing_uncertain(self) -> bool:
        """Whether commands' times scatter too much to score delays."""
        return self._scatter is not None and self._level() >= UNINFORMATIVE

    @property
    def state(self) -> StrokeState:
        """What it does with strokes now."""
        if self.commissioning is None:
            return StrokeState.COMMISSIONING
        return StrokeState.TIMING_UNCERTAIN if self.is_timing_uncertain else StrokeState.WATCHING

    def _level(self) -> float:
        """The standard deviation of commands' times that scores are computed with, s."""
        assert self.commissioning is not None
        return level_for(self.command_scatter, self.commissioning.levels)

    def with_present_scatter(self) -> Baseline:
        """The baseline with the present scatter of commands, for fault isolation."""
        assert self.baseline is not None
        scatter = max(self._established, self._delay_of_evidence)
        return self.baseline if scatter <= self.baseline.jitter else replace(self.baseline, scatter=scatter)

    @property
    def _delay_of_evidence(self) -> float:
        """s, the largest shared delay of the strokes of the alarm: of their commands, or of the valve."""
        if self._declared.gas is not None:
            return 0.0  # a valve that waits for its pressure is late itself, and tells no more by its shape
        began = self._began()
        return max((abs(stroke.delay) for stroke in self._recent if stroke.number >= began), default=0.0)

    @property
    def _established(self) -> float:
        return math.nan if self._scatter is None else self._scatter.established

    def evidence(self) -> list[Trace]:
        """The last strokes since the alarm began to rise, at most `diagnosis_strokes`.

        Where commands scatter more than at commissioning, each is moved to where its stroke shows that it took effect.
        """
        began = self._began()
        is_wider = self.baseline is not None and (
            max(self._established, self._delay_of_evidence) > WIDER_SCATTER * self.baseline.jitter
        )
        found = [
            _retimed(stroke.trace, stroke.shifts) if is_wider else stroke.trace
            for stroke in self._recent
            if stroke.number >= began
        ]
        if self._declared.gas is not None:
            return found[1:]
        # The change may have come within a stroke, or one later than is likeliest.
        return found[1:] if len(found) > FEWEST_TO_ISOLATE else found

    def _began(self) -> int:
        """Number of the stroke with which the alarm most likely began.

        By chance the sum may have begun to rise earlier, and strokes without the fault would bias its size, or make it
        one that nothing explains. With gas it is the first of some that are far from the baseline alike.
        """
        began = self.alarm.began if self.alarm is not None else 0
        found = [stroke for stroke in self._recent if stroke.number >= began]
        if self.alarm is None or not found:
            return began
        if self._declared.gas is None:
            return found[likeliest_change([stroke.along(self.alarm.cause) for stroke in found])].number
        since = [(stroke.number, stroke.furthest) for stroke in found]
        far = 0.5 * float(np.median([furthest for _, furthest in since]))
        return next(number for number, furthest in since if furthest >= far)

    def take_evidence(self) -> list[Trace]:
        """The evidence, when it is time to isolate the fault (again); else none.

        That is once there are `FEWEST_TO_ISOLATE` strokes of the alarm (or `FEWEST_WITH_GAS`), half as many more, twice
        as many again, and at each full buffer of new.
        """
        evidence = self.evidence() if self.alarm is not None else []
        fewest = FEWEST_TO_ISOLATE if self._declared.gas is None else FEWEST_WITH_GAS
        if len(evidence) < fewest or self._judged < self._isolate_at:
            return []
        most = self._settings.diagnosis_strokes
        # A full buffer gives one less, because `evidence` leaves the first out.
        missing = most - 1 - len(evidence)
        further = fewest // 2 if len(evidence) < fewest + fewest // 2 else len(evidence)
        self._isolate_at = self._judged + (min(further, missing) if missing > 0 else most)
        return evidence

    def assess(self, record: StrokeRecord, *, refit: bool = True) -> StrokeReport:
        """Compare a stroke with the baseline, or commission with it.

        Args:
            record: from a `StrokeSegmenter`.
            refit: whether to refit the dampings to it, for the report.
        """
        record = self._with_fault(record)
        scored, scores, alarm, state, remark = None, {}, None, StrokeState.NOT_JUDGED, self._hindrance(record)
        if remark is None:
            try:
                if self.commissioning is None and is_held_too_short(record.trace, self._declared):
                    remark = Unusable.HELD_TOO_BRIEFLY
                elif self.commissioning is None:
                    state = StrokeState.COMMISSIONING
                    self._commission(record)
                else:
                    level = self._allowed(record, self.commissioning)
                    if level >= UNINFORMATIVE and is_held_too_short(record.trace, self.commissioning.baseline.valve):
                        return self._report(record, None, {}, None, state, Unusable.HELD_TOO_BRIEFLY, {})
                    state = StrokeState.TIMING_UNCERTAIN if level >= UNINFORMATIVE else StrokeState.WATCHING
                    trace = without_delay(record.trace, self.shared_delay)
                    scored = score_stroke(trace, self.commissioning.baseline, level)
                    scores = self.commissioning.standard(scored.scores, level)
                    alarm = self._add(record, scored, scores)
            except (SimulationError, np.linalg.LinAlgError) as error:
                state, remark = StrokeState.NOT_JUDGED, NotSimulated(str(error))
        if scored is None and self.commissioning is not None:
            self._between.append(record.trace)
        damping = self._refitted(record.trace) if refit and scored is not None else {}
        return self._report(record, scored, scores, alarm, state, remark, damping)

    def _hindrance(self, record: StrokeRecord) -> Remark | None:
        """Why a stroke cannot be compared with the baseline; None where it can.

        One that waits for the pressure can, once there is a baseline: how long it waits tells a clogged pilot orifice.
        """
        if record.arrival_spread > self._latest:
            return Unusable.HEARD_LATE
        is_waiting = isinstance(record.remark, WaitsForPressure) and record.trace.has_positions
        return None if is_waiting and self.commissioning is not None else record.remark

    @property
    def _latest(self) -> float:
        """Seconds by which samples of a stroke may come in late; while commissioning, by the most timely stroke."""
        if self._scatter is not None:
            return self._scatter.latest
        known = [stroke.arrival_spread for stroke in self._first if math.isfinite(stroke.arrival_spread)]
        return latest_of(min(known)) if known else math.inf

    def _with_fault(self, record: StrokeRecord) -> StrokeRecord:
        """A stroke with what its current says of the valve, and whether it is by the sensor of the baseline."""
        if record.remark is not None:
            return record
        baseline, has_positions = self.baseline, record.trace.has_positions
        if baseline is not None and baseline.has_positions != has_positions:
            return record._replace(remark=Unusable.OTHER_SENSOR)
        if has_positions:
            return record
        valve, lateness = (baseline.valve, baseline.lateness) if baseline is not None else (self._declared, 0.0)
        fault = held_fault(record.trace, valve, lateness)
        is_open = isinstance(fault, DidNotClose)
        return record._replace(
            fault=fault, remark=fault, opened=fault is None or is_open, closed=None if fault is None else not is_open
        )

    def _commission(self, record: StrokeRecord) -> None:
        if self._first and self._first[0].trace.has_positions != record.trace.has_positions:
            self._first = []
        self._first.append(record)
        if len(self._first) < self._settings.commissioning_strokes:
            return
        # Where commissioning fails it is not repeated with each stroke that follows.
        records, self._first = self._first, []
        self.use(commission_with(records, self._declared, self._settings.noise))

    def use(self, commissioning: Commissioning) -> None:
        """Use a commissioning from now on, this monitor's or an earlier one's."""
        baseline, strokes = commissioning.baseline, commissioning.strokes
        run = self._settings.strokes_between_false_alarms
        self._sums = Sums(run, commissioning.names, len(strokes), one_sided=(SIZE,))
        self._leading, self._sum, self._threshold = "", math.nan, self._sums.threshold
        self._scatter, self._shared = CommandScatter(baseline.jitter, strokes), SharedDelay(baseline.jitter, strokes)
        self._recent.clear()
        self._between.clear()
        self._last_raised, self._judged, self._isolate_at = -math.inf, 0, 0
        self._first, self.alarm = [], None
        self.commissioning = commissioning

    def recommission(self) -> None:
        """Discard the baseline: the next strokes are taken as the new one."""
        self.commissioning = self._sums = self._scatter = self._shared = self.alarm = None
        self._first = []
        self._recent.clear()
        self._between.clear()
        self._leading, self._sum, self._threshold = "", math.nan, math.nan

    def _allowed(self, record: StrokeRecord, commissioning: Commissioning) -> float:
        """The standard deviation of this stroke's commands' times, s."""
        assert self._scatter is not None
        assert self._shared is not None
        timing = stroke_timing(record, commissioning.baseline)
        self._scatter.add(timing)
        self._shared.add(timing, is_dated=record.is_dated)
        return self._level()

    def _add(self, record: StrokeRecord, scored: Scored, scores: Mapping[str, float]) -> Alarm | None:
        assert self._sums is not None
        self._judged += 1
        trace = record.trace if self._declared.gas is None else _after(self._between, record.trace)
        shifts = scored.shifts + self.shared_delay
        self._recent.append(_Assessed(record.number, trace, shifts, dict(scores), self.shared_delay))
        self._between.clear()
        # Delays that cannot be scored count as 0, so that earlier ones decay from their sums.
        unknown = {name: 0.0 for name in DELAYS if self.is_timing_uncertain and name in self._sums}
        alarm = self._sums.add(record.number, {**unknown, **scores})
        if alarm is not None:
            self._leading, self._sum = alarm.cause, self._sums.threshold
            # Fault isolation uses all strokes since the first of a row of alarms began.
            began = alarm.began if self.alarm is None else self.alarm.began
            self.alarm = alarm._replace(began=began)
            self.alarms += 1
            self._last_raised = self._judged
        else:
            self._leading, self._sum = self._sums.largest
            if self._judged - self._last_raised > ALARM_ENDS_AFTER:
                self.alarm, self._isolate_at = None, 0
        return alarm

    def _refitted(self, trace: Trace) -> Mapping[str, Interval]:
        assert self.baseline is not None
        try:
            return refitted(trace, self.baseline, self._level())
        except SimulationError:
            return {}

    def _report(
        self,
        record: StrokeRecord,
        scored: Scored | None,
        scores: Mapping[str, float],
        alarm: Alarm | None,
        state: StrokeState,
        remark: Remark | None,
        damping: Mapping[str, Interval],
    ) -> StrokeReport:
        baseline, trace = self.baseline, record.trace
        seen = _arrivals(trace, self._declared) if len(trace.sample_times) >= FEWEST_SAMPLES else {}
        unseen = (math.nan, math.nan)
        t1, t2, closing = (seen.get(kind, unseen) for kind in ("pilot_reaches_main", "reaches_stop", "reaches_seat"))
        lateness = baseline.lateness if baseline is not None else 0.0
        volts = trace.drive.volts
        return StrokeReport(
            record,
            float(volts[np.argmax(np.abs(volts))]),
            _opening_delay(trace, baseline.valve if baseline is not None else self._declared, lateness),
            t1[0] - lateness,
            t2[0] - lateness,
            closing[0] - lateness,
            (t1[1], t2[1], closing[1]),
            scored.rms if scored is not None else math.nan,
            baseline.noise.sigma if baseline is not None else math.nan,
            damping,
            scores,
            state,
            remark,
            self.command_scatter,
            alarm,
            self._leading,
            self._sum,
            self._threshold,
        )


class _Assessed(NamedTuple):
    """A stroke that was compared with the model, the delays of its commands, s, its scores, and the shared delay, s."""

    number: int
    trace: Trace
    shifts: Array
    scores: Mapping[str, float]
    delay: float

    @property
    def furthest(self) -> float:
        """Its largest score."""
        return max(map(abs, self.scores.values()), default=0.0)

    def along(self, cause: str) -> float:
        """Its score in the direction of an alarm; 0 where it has none."""
        name = cause.removesuffix(FELL)
        score = self.scores.get(name, 0.0)
        return score if name == cause else -score


def _after(earlier: Sequence[Trace], trace: Trace) -> Trace:
    """A stroke with the commands of those before it that were not compared, and so are not in the evidence.

    With gas they have filled the line behind the valve all the same.
    """
    if not earlier:
        return trace
    strokes = [*earlier, trace]
    starts = [(stroke.epoch_ns - trace.epoch_ns) / 1e9 for stroke in strokes]
    times = [stroke.drive.times + start for stroke, start in zip(strokes, starts, strict=True)]
    drive = Drive(np.concatenate(times), np.concatenate([stroke.drive.volts for stroke in strokes]))
    return with_joined_ends(replace(trace, drive=drive, outlet_start=earlier[0].outlet_start), strokes, starts)


def _retimed(trace: Trace, shifts: Array) -> Trace:
    """The stroke with its commands moved to where they took effect; those between move with the first.

    Without a current beside positions, whose stamps are those of its arrival.
    """
    late = np.full(len(trace.drive.times), shifts[0])
    late[-1] = shifts[-1]
    if len(shifts) == len(late):
        late = shifts
    times = np.maximum.accumulate(trace.drive.times + late)
    current = None if trace.has_positions else trace.coil_current
    return replace(trace, drive=Drive(times, trace.drive.volts), coil_current=current)


def _arrivals(trace: Trace, valve: Valve) -> dict[str, tuple[float, float]]:
    """Arrivals by kind: s after the command, and the standard error; by positions, or by the bends of the current."""
    strokes = events_from_sensors(trace, valve.parameters.pilot_gap)
    return {event.kind: (event.after_command, event.stderr) for stroke in strokes for event in stroke.events}


def _opening_delay(trace: Trace, valve: Valve, lateness: float) -> float:
    """When the pilot plunger left its seat, s after the command: the model's time, and the delay at a low level.

    The first micrometres hide in the noise, and grow with the third power of time; the level is a quarter of the gap,
    or of one plunger a twentieth of its stroke.
    By the current alone the delay is that with which the current rises. NaN where it is not seen.
    """
    if not len(trace.sample_times):
        return math.nan
    drive = Drive(trace.drive.times[:1], trace.drive.volts[:1])
    is_before_next = trace.sample_times < (trace.drive.times[1] if len(trace.drive.times) > 1 else math.inf)
    times = trace.sample_times[is_before_next]
    try:
        shown = simulate(
            as_it_began(valve, trace),
            drive,
            times - lateness,
            start_time=float(min([drive.times[0], *(times[:1] - lateness)])),
        )
        late = delays_of(trace, valve, lateness)[0] if not trace.has_positions else math.nan
    except SimulationError:
        return math.nan
    if trace.has_positions:
        level = 0.25 * valve.parameters.pilot_gap or 0.05 * valve.parameters.stroke
        measured = crossing(times, trace.pilot_position[is_before_next], level, rises=True)
        late = measured - crossing(times, shown.pilot_position, level, rises=True)
    return shown.first(EventKind.UNSEATED) - float(drive.times[0]) + late
