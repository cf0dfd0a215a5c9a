"""The live stream of a valve: a model stepped along with the samples, and the stream cut into strokes. No ROS.

A `StrokeSegmenter` reports at once when the valve does not open or close. Its memory is bounded: while nothing moves
for longer than `settle`, samples are not kept. Time is passed in with commands and samples.
"""

from __future__ import annotations

import math
from collections import deque
from typing import Final

import numpy as np

from valve_sim.identification.monitoring.command_timing import EXTREME_SIGMAS, LATEST, ArrivalSpread, HeardCommands
from valve_sim.identification.monitoring.findings import (
    DidNotClose,
    Fault,
    Prediction,
    Remark,
    StrokeRecord,
    TimingTooUncertain,
    Unusable,
)
from valve_sim.identification.monitoring.held_valve import opening_fault
from valve_sim.identification.monitoring.kept_samples import (
    MOST_SAMPLES,
    KeptSamples,
    MeasuredMotion,
    StrokeInProgress,
    hides_motion,
)
from valve_sim.identification.monitoring.line_pressure import LinePressure, unknown_pressure
from valve_sim.identification.monitoring.settings import MonitorSettings
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import Phase, Reading, SimulationError, Stepper, Valve
from valve_sim.recordings import Trace
from valve_sim.recordings.strokes import begins_stroke

LEAD: Final = 0.25
"""s of rest before a stroke that are kept with it, for the noise."""
MOST_COMMANDS: Final = 1000
"""Commands of a stroke; further ones are not kept."""
OPENED: Final = 0.9
"""Share of the stroke that counts as open."""
CLOSED: Final = 0.1
"""Share of the stroke that counts as closed."""
RESTING: Final = 0.01
"""Share of the stroke below which the valve counts as seated."""
EARLIEST: Final = 0.05
"""s by which a command may arrive here after the valve has begun to follow it."""
LIFTING: Final = 5e-3
"""s before the first visible motion, in which the valve leaves its seat."""
STILL: Final = 1e-5
"""m/s: below it the model counts as at rest."""
NO_CURRENT: Final = 1e-3
"""Share of the reference current below which there is none."""
FEWEST_SAMPLES: Final = 4
"""Of a stroke between its first command and its last."""
MOST_VOLTS: Final = 1e4
"""V: no coil takes more, and stepping its forces would take minutes per second."""
LONGEST_GAP: Final = 60.0
"""s without samples, after which the model is not stepped on but begins at rest."""
TAIL: Final = 3.0
"""Multiple of the recent delays that one delay in many thousands exceeds."""
LONGEST_DELAY: Final = 1.0
"""s: a valve that closes later than this is not one whose command came late."""
STILL_AFTER: Final = 0.01
"""s after it was last seen open: the remaining motion is below the noise."""
CONFIRMED: Final = 5
"""Failed strokes in a row that make a fault where the times of commands are too uncertain for one to do so.

So many that move otherwise than commanded are the valve's, where messages come in time."""
ALONE: Final = 1.0
"""s of currents without any position, after which the valve is watched by its current alone."""


class StrokeSegmenter:
    """Steps a model along with the samples and cuts the stream into strokes. Some µs per sample.

    Times are seconds since any fixed moment. Samples come in the order of their times, and so do commands. Where no
    position comes, those of the coil's current are the samples; where the valve is then only the model says, so that
    neither opening nor closing is judged here, see `held_valve`.
    """

    def __init__(self, valve: Valve, settings: MonitorSettings) -> None:
        self._settings = settings
        self._valve = valve
        self._lateness = 0.0
        self._next: tuple[Valve, float] | None = None
        self.strokes = 0
        self.rejected = 0
        self.scatter = 0.0
        """s, standard deviation of the commands' times, as the `StrokeMonitor` has last found it."""
        self._has_positions = self._by_current = False
        self._first_current = math.inf
        self.reset()

    @property
    def valve(self) -> Valve:
        """The valve whose model is stepped."""
        return self._valve

    @property
    def by_current(self) -> bool:
        """Whether the samples are those of the coil's current, for no position comes."""
        return self._by_current

    @property
    def kept(self) -> int:
        """How many samples are in memory."""
        return len(self._samples.times)

    @property
    def uncertainty(self) -> float:
        """Seconds by which a healthy valve may be later than the model, because the time of its command is uncertain.

        A multiple of the present scatter, because delays of a busy machine have a long tail.
        """
        return TAIL * (EXTREME_SIGMAS * self.scatter + max(self._arrivals.spread, self._heard.spread))

    @property
    def _longest_wait(self) -> float:
        """Seconds beyond `patience` before a valve is said not to follow: as long as commands have ever been late."""
        return max(self.uncertainty, TAIL * self._latest)

    def reset(self) -> None:
        """Start again, as after a jump of the clock: with a valve at rest."""
        self.fault: Fault | None = None
        """None where there is none. Stays until a stroke without a fault."""
        self._arrivals, self._heard = ArrivalSpread(), HeardCommands()
        self._missed, self._uncommanded, self._latest = 0, 0, 0.0
        self._stepper: Stepper | None = None
        self._stepped = -math.inf
        self._volts = math.nan
        self._last = self._last_command = -math.inf
        self._position = math.nan
        self._last_open = -math.inf
        self._valve_left, self._model_left = -math.inf, math.inf
        self._pending: deque[tuple[float, float]] = deque()
        self._samples = KeptSamples(by_current=self._by_current)
        self._motion = MeasuredMotion(RESTING * self._valve.parameters.stroke)
        self.line = LinePressure()
        """The pressures at a valve with gas; where they are measured, it is to hear them."""
        self._phase = Phase.CLOSED
        self._phase_since = -math.inf
        self._rest_since = math.inf
        self._stroke: StrokeInProgress | None = None
        self._finished: deque[StrokeRecord] = deque()

    def go_by_current(self) -> None:
        """Take currents as the samples, from a valve at rest on; until a position comes."""
        self._by_current = True
        self.reset()

    def use(self, valve: Valve, lateness: float) -> None:
        """Step this valve from the next stroke on, its motion delayed by `lateness`, s, against the stamps."""
        # The model is stepped by the commands as they are heard.
        self._next = valve, lateness - self._heard.lateness

    def command(self, time: float, volts: float) -> None:
        """A voltage in force from `time` on, s; one that repeats the voltage in force changes nothing.

        It takes effect with the first sample of its time or later, so that either may arrive late. One that is not
        finite, or earlier than the last, is rejected and counted.
        """
        latest = self._pending[-1][0] if self._pending else self._last_command
        is_possible = math.isfinite(time) and abs(volts) <= MOST_VOLTS
        if not is_possible or time < latest or len(self._pending) >= MOST_COMMANDS:
            self.rejected += 1
            return
        self._pending.append((time, volts))
        self._apply_due(self._last)

    def _apply_due(self, until: float) -> None:
        """Apply the commands that are due."""
        while self._pending and self._pending[0][0] <= until:
            self._apply(*self._pending.popleft())

    def _apply(self, time: float, volts: float) -> None:
        before = 0.0 if math.isnan(self._volts) else self._volts
        self._volts = volts
        if before == volts:
            return
        self._last_command = time
        if begins_stroke(before, volts):
            self._begin(time)
        self._rest_since = math.inf
        if self._stroke is not None and len(self._stroke.drive) < MOST_COMMANDS:
            self._stroke.drive.append((time, volts))
        try:
            self._model(time).command(time, volts)
        except SimulationError:
            # The voltage cannot be simulated.
            self._rest_model(time)

    def measure(self, time: float, position: float, arrival: float = math.nan) -> Prediction | None:
        """Take one sample of the pilot plunger's position.

        Args:
            time: its stamp, s. position: m.
            arrival: s, by the clock that times commands; nan where not known.

        Returns:
            the model at that time; None where the sample was rejected.
        """
        last = -math.inf if self._by_current else self._last
        if not (math.isfinite(time) and math.isfinite(position)) or time <= last:
            self.rejected += 1
            return None
        self._go_by_positions()
        reading = self._take(time, [time], [position], [math.nan])
        self._note_arrival(time, arrival)
        self._observe(time, position, position, reading)
        return Prediction(reading, position - reading.pilot_position)

    def measure_many(self, times: Array, positions: Array) -> None:
        """Take a batch of some milliseconds, valid and in order; the model is stepped to its end only."""
        self._go_by_positions()
        last = float(times[-1])
        reading = self._take(last, times.tolist(), positions.tolist(), [math.nan] * len(times))
        self._observe(last, float(positions[-1]), float(positions.max()), reading)

    def measure_current(
        self, time: float, current: float, voltage: float = math.nan, arrival: float = math.nan
    ) -> Prediction | None:
        """Take one sample of the coil: beside positions for fault isolation, without any in their place.

        Args:
            time: its stamp, s. current: A. voltage: at the coil's terminals, V; nan where not measured.
            arrival: s, by the clock that times commands; nan where not known.

        Returns:
            the model at that time; None where the sample was rejected, or is one beside positions.
        """
        self._first_current = min(self._first_current, time)
        if not self._has_positions and not self._by_current and time - self._first_current > ALONE:
            self.go_by_current()
        last = self._last if self._by_current else self._samples.latest_current
        if not (math.isfinite(time) and math.isfinite(current)) or time <= last:
            self.rejected += 1
        elif self._by_current:
            reading = self._take(time, [time], [current], [voltage])
            self._note_arrival(time, arrival)
            self._observe(time, reading.pilot_position, reading.pilot_position, reading)
            return Prediction(reading, current - reading.coil_current)
        else:
            self._samples.add_current(time, current, voltage, is_kept=self._is_kept(time))
        return None

    def measure_currents(self, times: Array, currents: Array, voltages: Array) -> None:
        """Take a batch of some milliseconds of the coil alone, valid and in order, as `measure_many` does."""
        if not self._by_current:
            self.go_by_current()
        last = float(times[-1])
        reading = self._take(last, times.tolist(), currents.tolist(), voltages.tolist())
        self._observe(last, reading.pilot_position, reading.pilot_position, reading)

    def _go_by_positions(self) -> None:
        """A position has come: the current is no longer alone."""
        self._has_positions = True
        if self._by_current:
            self._by_current = False
            self.reset()

    def _take(self, time: float, times: list[float], values: list[float], voltages: list[float]) -> Reading:
        """Step the model to the last of these samples, and keep them where they are needed."""
        self._apply_due(time)
        reading = self._step(time)
        if not self._by_current:
            self._motion.see(time, values)
        if self._is_kept(time):
            self._samples.add(times, values, voltages)
        return reading

    def _note_arrival(self, time: float, arrival: float) -> None:
        self._arrivals.add(time, arrival - time)
        if self._stroke is not None and arrival - time > self._stroke.latest:
            self._stroke.latest = arrival - time

    def take_finished(self) -> list[StrokeRecord]:
        """The strokes that have ended since it was last asked."""
        finished = list(self._finished)
        self._finished.clear()
        return finished

    def _model(self, time: float) -> Stepper:
        if self._stepper is None or time - self._stepped > LONGEST_GAP:
            # Stepping over years, where a stamp leaps, would take hours: at rest from here on.
            self._stepper = self._rest_model(time - self._lateness)
        self._stepped = time
        return self._stepper

    def _rest_model(self, time: float) -> Stepper:
        """Let the model rest without current from here on; the stroke cannot be compared with it then."""
        self._stepper = self.line.supplied_anew(Stepper(self._valve, time), time)
        if self._stroke is not None:
            self._stroke.is_at_rest = False
        return self._stepper

    def _step(self, time: float) -> Reading:
        """The model at a sample; for one stamped before the last command, the model at that command."""
        at = max(time - self._lateness, self._last_command)
        try:
            return self.line.supplied(self._model(time), at).advance(at)
        except SimulationError:
            return self._rest_model(at).advance(at)

    def _is_kept(self, time: float) -> bool:
        """Keep all of a stroke except long rests of both valve and model; between strokes, the last moments."""
        return self._stroke is None or time - max(self._rest_since, self._motion.last) <= self._settle

    @property
    def _settle(self) -> float:
        """Seconds of the model's rest after which the valve rests too, even if it received its command later."""
        return self._settings.settle + self.uncertainty / TAIL

    def _observe(self, time: float, position: float, highest: float, reading: Reading) -> None:
        last, self._last, self._position = self._last, time, position
        self.line.note(time, reading.outlet_pressure)
        if not self._is_closed(highest):
            self._last_open = time
        elif self._last_open == last > -math.inf and self._phase is Phase.CLOSED:
            # It closes after the model had. Where its command came late, it has begun to as late; a slow valve has not.
            late = min(time - self._phase_since, self._valve_left - self._model_left)
            self._latest = max(self._latest, min(late, LONGEST_DELAY))
        if position >= OPENED * self._valve.parameters.stroke:
            self._valve_left = time
        if reading.pilot_position >= OPENED * self._valve.parameters.stroke:
            self._model_left = math.inf
        else:
            self._model_left = min(self._model_left, time)
        is_still = abs(reading.pilot_velocity) <= STILL
        phase = Phase.CLOSED if is_still and self._is_closed(reading.pilot_position) else reading.phase
        if phase is not self._phase:
            self._phase, self._phase_since = phase, time
        self._rest_since = min(self._rest_since, time) if is_still else math.inf
        stroke = self._stroke
        if stroke is not None:
            stroke.highest = max(stroke.highest, highest)
            if reading.phase is Phase.OPEN and not stroke.model_opened:
                stroke.model_opened, stroke.model_opened_at = True, time
        self._judge_position(time, position)
        if stroke is not None:
            self._end_if_over(stroke, time)
        elif self._samples.times[-1] - self._samples.times[0] > 2.0 * LEAD or self.kept > MOST_SAMPLES:
            self._samples.drop_before(time - LEAD)

    def _judge_position(self, time: float, position: float) -> None:
        """Compare the valve with a model that has been open, or closed, for longer than `patience`."""
        if math.isnan(self._volts):
            return
        took, patience = self._phase_since - self._last_command, self._settings.patience
        patience = max(patience, took if math.isfinite(took) else 0.0) + self._longest_wait
        if time - max(self._phase_since, self._last_command) <= patience:
            return
        stroke = self._stroke
        if self._phase is Phase.OPEN and self._volts != 0.0 and stroke is not None and stroke.opened is None:
            self._judge_opening(stroke)
        elif self._phase is Phase.CLOSED and self._volts == 0.0 and (stroke is None or stroke.closed is None):
            closed = self._is_closed(position)
            if not closed:
                self.fault = DidNotClose(position)
            if stroke is not None:
                stroke.closed, stroke.fault = closed, stroke.fault or (None if closed else self.fault)

    def _is_closed(self, position: float) -> bool:
        """Whether valve or model is closed; without seat load the model rests some picometres above its seat."""
        return position <= CLOSED * self._valve.parameters.stroke

    def _judge_opening(self, stroke: StrokeInProgress) -> None:
        stroke.opened = stroke.highest >= OPENED * self._valve.parameters.stroke
        if stroke.opened:
            self._missed = 0
            return
        self.fault = stroke.fault = opening_fault(stroke.highest, self._valve)

    def _judge_late(self, stroke: StrokeInProgress) -> TimingTooUncertain | None:
        """Judge a stroke that ended before `patience` had passed; return why it cannot be judged, None if it can.

        A valve that may have received its opening command together with the closing one need not have opened. What
        timing alone may explain counts as a fault when it happens `CONFIRMED` times in a row.
        """
        remark = None
        if stroke.opened is None and stroke.model_opened:
            is_open = stroke.highest >= OPENED * self._valve.parameters.stroke
            self._missed = 0 if is_open else self._missed + 1
            held = (stroke.drive[-1][0] if len(stroke.drive) > 1 else self._last) - stroke.model_opened_at
            if is_open or held > self.uncertainty or self._missed >= CONFIRMED:
                self._judge_opening(stroke)
            else:
                remark = TimingTooUncertain(max(held, 0.0))
        if stroke.closed is None and self._phase is Phase.CLOSED and self._is_closed(self._position):
            stroke.closed = True
        return remark

    def _begin(self, time: float) -> None:
        """An opening command: the stroke before ends, and one begins."""
        left_seat = self._left_seat()
        begins_early = math.isfinite(left_seat)
        if self._stroke is not None:
            self._finish(self._stroke, None, left_seat - LIFTING if begins_early else math.inf)
        at = max(time, self._last - self._lateness)
        reading = self._model(time).advance(at)
        parameters = self._valve.parameters
        has_current = abs(reading.coil_current) * parameters.coil_resistance > NO_CURRENT * parameters.reference_voltage
        is_closed = math.isnan(self._position) or self._is_closed(self._position) or begins_early
        is_at_rest = is_closed and self._phase is Phase.CLOSED and not has_current
        self._stroke = StrokeInProgress(is_at_rest)
        self.line.keep(time)
        if begins_early:
            self._stroke.highest = 0.0 if self._by_current else self._samples.highest_since(left_seat)
        if self._next is not None and is_at_rest:
            (self._valve, self._lateness), self._next = self._next, None
            if self._valve.gas is None:
                self._stepper = Stepper(self._valve, min(time, at))
            else:
                self.line.exchange(self._model(time), self._valve, at)

    def _what_is_missing(self, trace: Trace, *, is_dated: bool, is_shown: bool) -> Remark | None:
        """Why a stroke is incomplete; None where it is whole, as far as can be seen.

        Args:
            is_dated: whether the voltage shows its commands. is_shown: whether it does those of most strokes.
        """
        parameters = self._valve.parameters
        values, full = trace.pilot_position, parameters.stroke
        if not trace.has_positions:
            assert trace.coil_current is not None
            values, full = trace.coil_current.values, parameters.reference_voltage / parameters.coil_resistance
        if hides_motion(trace.sample_times, values, full):
            return Unusable.SAMPLES_MISSING
        if not is_dated and is_shown:
            return Unusable.COMMANDS_UNSEEN
        is_otherwise = trace.has_positions and not self._is_commanded(trace, is_dated=is_dated)
        self._uncommanded = self._uncommanded + 1 if is_otherwise else 0
        is_of_valve = self._uncommanded >= CONFIRMED and self._arrivals.spread <= LATEST
        return Unusable.UNCOMMANDED if is_otherwise and not is_of_valve else None

    def _is_commanded(self, trace: Trace, *, is_dated: bool) -> bool:
        """Whether the valve opened at most once, no sooner than its command, and closed no sooner than it was told.

        Where the voltage shows the commands, what the valve does after the first of them is its own.
        """
        share = trace.pilot_position / self._valve.parameters.stroke
        ends = np.flatnonzero((share <= CLOSED) | (share >= OPENED))
        is_open = share[ends] >= OPENED
        moves = np.flatnonzero(np.diff(is_open, prepend=False))
        at = trace.sample_times[ends[moves]]
        earliest = trace.drive.times[[0, -1]] - EARLIEST
        if is_dated:
            return not np.any(at < earliest[0])
        return len(at) <= 2 and not np.any(at < earliest[: len(at)])

    def _left_seat(self) -> float:
        """When the valve was last at rest, s, if it moved before its command arrived; nan if it did not.

        By the current alone: when the coil was last without current.
        """
        parameters = self._valve.parameters
        full = parameters.reference_voltage / parameters.coil_resistance if self._by_current else parameters.stroke
        left = self._samples.last_within(RESTING * full, self._last - EARLIEST)
        closing = self._stroke.drive[-1][0] if self._stroke is not None else -math.inf
        return math.nan if left < closing else left

    def _end_if_over(self, stroke: StrokeInProgress, time: float) -> None:
        if time - stroke.drive[0][0] > self._settings.stroke_timeout:
            self._finish(stroke, Unusable.TIMED_OUT)
        elif self.kept > MOST_SAMPLES or len(stroke.drive) >= MOST_COMMANDS:
            self._finish(stroke, Unusable.TOO_LONG)
        elif self._volts == 0.0 and time - self._rest_since > self._settle and (
            stroke.closed is not None or self._phase is not Phase.CLOSED
        ):  # fmt: skip
            self._finish(stroke, None)

    def _finish(self, stroke: StrokeInProgress, remark: Remark | None, until: float = math.inf) -> None:
        """Emit the stroke; its last samples at rest are also the first of the next one."""
        remark = remark or self._judge_late(stroke)
        self._latest = max(self._latest, min(self._heard.spread, LONGEST_DELAY))
        if stroke.fault is None:
            self.fault = None
        # Later currents than the last position belong to the next stroke.
        trace = self._samples.trace(f"stroke {self.strokes}", stroke.drive, until, self._last)
        if self._valve.gas is not None:
            trace = self.line.before(trace, stroke.drive[0][0])
            remark = remark or unknown_pressure(trace)
        is_shown = self._heard.are_usually_seen
        heard, trace = trace, self._heard.dated(trace, self._samples.voltage(trace, self._last))
        if self._by_current:
            stroke.opened = stroke.closed = None
        remark = remark or (None if stroke.is_at_rest else Unusable.NOT_AT_REST) or stroke.fault
        first, last, at = float(trace.drive.times[0]), float(trace.drive.times[-1]), trace.sample_times
        opening = (at > first) & ((at < last) | (last == first))
        if np.count_nonzero(opening) < FEWEST_SAMPLES:
            remark = remark or Unusable.TOO_FEW_SAMPLES
        if remark is None or remark is stroke.fault:
            remark = self._what_is_missing(trace, is_dated=trace is not heard, is_shown=is_shown) or remark
        self._finished.append(
            StrokeRecord(
                self.strokes, stroke.drive[0][0], trace, remark, stroke.opened, stroke.closed, stroke.fault,
                self._arrivals.beyond_earliest(stroke.latest) if trace is heard else math.nan,
                is_dated=trace is not heard,
            )
        )  # fmt: skip
        self.strokes += 1
        self._stroke = None
        if math.isfinite(until):
            self._samples.drop_before(until)
            return
        is_closed = self._phase is Phase.CLOSED and math.isfinite(self._rest_since)
        still = max(self._rest_since + self.uncertainty / TAIL, self._last_open + STILL_AFTER, self._last - LEAD)
        self._samples.drop_before(still if is_closed else math.inf)
