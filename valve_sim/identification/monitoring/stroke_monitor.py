"""Each stroke held against the model: an alarm of a stated false-alarm rate. No clock, no ROS.

The first strokes commission the valve: its dampings, the clocks' offset, the scatter of the commands' stamps and the
sensor's noise are fitted to them all together, and held from then on. `scores` says how a stroke is compared
with that, `cusum` when deviations raise an alarm. Scores are standard normal by theory where the commissioning
strokes do not contradict it; where they do, because the declared form is not the valve's, they are counted from the
mean and spread of those strokes (as Student's t): what is watched is then whether the valve changes, and
`StrokeMonitor` says so. Where commands' times scatter more than while commissioning, strokes are scored with as much
allowed, and beyond a tenth of the opening time nothing is said of delays at all. An effect with a memory beyond one
stroke, such as coil heating, begins anew with each stroke here.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.estimation.intervals import Interval
from valve_sim.identification.monitoring.command_timing import PLAINLY_WIDER, UNTIMED, CommandScatter, allowed_for
from valve_sim.identification.monitoring.commissioning import (
    Commissioning,
    came_together,
    commission_with,
    timed_stroke,
)
from valve_sim.identification.monitoring.cusum import Alarm, Sums
from valve_sim.identification.monitoring.scores import (
    DELAYS,
    SIZE,
    Baseline,
    Scored,
    crossing,
    refitted,
    score_stroke,
)
from valve_sim.identification.monitoring.segmenter import FEWEST_SAMPLES, StrokeRecord
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import Drive, EventKind, SimulationError, Valve, simulate
from valve_sim.traces import Trace, events_from_sensors

TRACED_FROM: Final = 6
"""Strokes of an alarm with which its cause is first looked for."""
FORGETS: Final = 20
"""Judged strokes without a further alarm, after which one is over."""
WATCHING: Final = "watching"
UNCERTAIN: Final = "timing too uncertain to judge"
"""State of a stroke of which its shape alone was held against the model: samples carry stamps, commands do not."""

TOGETHER: Final = "timing too uncertain to judge: its commands were obeyed one soon after the other"


class StrokeReport(NamedTuple):
    """What is said of one stroke; times in s after their command, nan where not seen.

    Attributes:
        record: the stroke. name: for people.
        opening_delay: until the pilot plunger leaves its seat. t1: until it reaches the main plunger. t2: until the
            stop. closing_time: from the closing command until the pilot plunger is back.
        rms: m, of what the model leaves; nan where it was not held against it.
        noise: m, of the sensor; nan before commissioning. damping: refitted to this stroke alone, or empty.
        scores: standard normal while healthy, by direction; empty where the stroke was not judged.
        state: "commissioning", "watching", "timing too uncertain to judge" or "not judged". remark: why it was not.
        command_scatter: s, standard deviation that its commands' times were allowed; nan before commissioning.
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
    command_scatter: float
    alarm: Alarm | None
    cause: str
    sum: float
    threshold: float


class StrokeMonitor:
    """The other half: strokes in, reports out. Some milliseconds a stroke; a second at the end of commissioning.

    Args:
        valve: the declared valve.
        settings: how it is watched.
    """

    def __init__(self, valve: Valve, settings: MonitorSettings) -> None:
        self._declared = valve
        self._settings = settings
        self._first: list[StrokeRecord] = []
        self._scatter: CommandScatter | None = None
        self._sums: Sums | None = None
        self._recent: deque[_Judged] = deque(maxlen=settings.diagnosis_strokes)
        self._loudest, self._sum, self._threshold = "", math.nan, math.nan
        self._last_raised = -math.inf
        self._judged = 0
        self._trace_at = 0
        self.commissioning: Commissioning | None = None
        """What commissioning has found; None before."""
        self.alarm: Alarm | None = None
        """The last alarm, while it is not over."""
        self.alarms = 0

    @property
    def healthy(self) -> Baseline | None:
        """The valve as commissioned; None before."""
        return None if self.commissioning is None else self.commissioning.healthy

    @property
    def commissioned(self) -> int:
        """How many strokes commissioning has had."""
        return len(self._first)

    @property
    def contradictions(self) -> tuple[str, ...]:
        """Directions in which the healthy valve differs from the declared form: empty if that explains it."""
        if self.commissioning is None:
            return ()
        baselines = self.commissioning.baselines[self.commissioning.levels[0]]
        return tuple(name for name, baseline in baselines.items() if baseline.is_learned and name != SIZE)

    @property
    def command_scatter(self) -> float:
        """s, standard deviation that commands' times are allowed now; nan before commissioning."""
        return math.nan if self._scatter is None else self._scatter.sigma

    @property
    def is_timing_uncertain(self) -> bool:
        """Whether commands' times scatter too much to say anything of delays."""
        return self._scatter is not None and self._level() >= UNTIMED

    def _level(self) -> float:
        """The standard deviation that commands' times are allowed in the scores, s."""
        assert self.commissioning is not None
        return allowed_for(self.command_scatter, self.commissioning.levels)

    def timed(self) -> Baseline:
        """The valve as commissioned, with the scatter that commands have now, as a tracing wants it."""
        assert self.healthy is not None
        scatter = self._lasting
        return self.healthy if scatter <= self.healthy.jitter else replace(self.healthy, scatter=scatter)

    @property
    def _lasting(self) -> float:
        return math.nan if self._scatter is None else self._scatter.lasting

    def evidence(self) -> list[Trace]:
        """The last strokes since the alarm began to rise, at most `diagnosis_strokes`.

        Where commands scatter more than at commissioning, each is put where its stroke shows that it was obeyed.
        """
        began = self.alarm.began if self.alarm is not None else 0
        is_wider = self.healthy is not None and self._lasting > PLAINLY_WIDER * self.healthy.jitter
        found = [
            _as_obeyed(stroke.trace, stroke.shifts) if is_wider else stroke.trace
            for stroke in self._recent
            if stroke.number >= began
        ]
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
            record: from a `StrokeSegmenter`.
            refit: whether to refit the dampings to it, for the report.
        """
        scored, scores, alarm, state, remark = None, {}, None, "not judged", record.remark
        if not remark:
            try:
                if self.commissioning is None and came_together(record.trace, self._declared):
                    remark = TOGETHER
                elif self.commissioning is None:
                    state = "commissioning"
                    self._commission(record)
                else:
                    level = self._allowed(record, self.commissioning)
                    if level >= UNTIMED and came_together(record.trace, self.commissioning.healthy.valve):
                        return self._report(record, None, {}, None, state, TOGETHER, {})
                    state = UNCERTAIN if level >= UNTIMED else WATCHING
                    scored = score_stroke(record.trace, self.commissioning.healthy, level)
                    scores = self.commissioning.standard(scored.scores, level)
                    alarm = self._add(record, scored, scores)
            except (SimulationError, np.linalg.LinAlgError) as error:
                state, remark = "not judged", f"the model could not be held against it: {error}"
        damping = self._refitted(record.trace) if refit and scored is not None else {}
        return self._report(record, scored, scores, alarm, state, remark, damping)

    def _commission(self, record: StrokeRecord) -> None:
        self._first.append(record)
        if len(self._first) < self._settings.commissioning_strokes:
            return
        # What could not be commissioned with is not tried again with each stroke that follows.
        records, self._first = self._first, []
        self.use(commission_with(records, self._declared, self._settings.noise))

    def use(self, commissioning: Commissioning) -> None:
        """Watch from now on with what a commissioning has found, this one's or an earlier one's."""
        healthy, strokes = commissioning.healthy, commissioning.strokes
        run = self._settings.strokes_between_false_alarms
        self._sums = Sums(run, commissioning.names, len(strokes), one_sided=(SIZE,))
        self._loudest, self._sum, self._threshold = "", math.nan, self._sums.threshold
        self._scatter = CommandScatter(healthy.jitter, strokes)
        self._recent.clear()
        self._last_raised, self._judged, self._trace_at = -math.inf, 0, 0
        self._first, self.alarm = [], None
        self.commissioning = commissioning

    def recommission(self) -> None:
        """Forget what healthy was: the next strokes are taken for it."""
        self.commissioning = self._sums = self._scatter = self.alarm = None
        self._first = []
        self._recent.clear()
        self._loudest, self._sum, self._threshold = "", math.nan, math.nan

    def _allowed(self, record: StrokeRecord, commissioning: Commissioning) -> float:
        """The standard deviation that this stroke's commands are allowed, s."""
        assert self._scatter is not None
        self._scatter.add(timed_stroke(record, commissioning.healthy))
        return self._level()

    def _add(self, record: StrokeRecord, scored: Scored, scores: Mapping[str, float]) -> Alarm | None:
        assert self._sums is not None
        self._judged += 1
        self._recent.append(_Judged(record.number, record.trace, scored.shifts))
        # Of what nothing can be said, nothing that was said before is held against the valve for long.
        unknown = {name: 0.0 for name in DELAYS if self.is_timing_uncertain and name in self._sums}
        alarm = self._sums.add(record.number, {**unknown, **scores})
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
            return refitted(trace, self.healthy, self._level())
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
            self.command_scatter,
            alarm,
            self._loudest,
            self._sum,
            self._threshold,
        )


class _Judged(NamedTuple):
    """A stroke that was held against the model, and by how much its commands were obeyed late, s."""

    number: int
    trace: Trace
    shifts: Array


def _as_obeyed(trace: Trace, shifts: Array) -> Trace:
    """The stroke with its commands where it shows that they were obeyed; those between move with the first.

    Without its current, whose stamps are those of its arrival.
    """
    late = np.full(len(trace.drive.times), shifts[0])
    late[-1] = shifts[-1]
    if len(shifts) == len(late):
        late = shifts
    times = np.maximum.accumulate(trace.drive.times + late)
    return replace(trace, drive=Drive(times, trace.drive.volts), coil_current=None)


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
