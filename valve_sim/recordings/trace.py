"""What one recording says about one valve: arrays with units on one clock."""

from __future__ import annotations

import math
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

from valve_sim.files.channels import JUDGED, SIGNALS, Signal, Signals
from valve_sim.model.errors import ValveError
from valve_sim.recordings.left_out import LeftOut, bridged, find_left_out
from valve_sim.recordings.measured_input import MeasuredInput, measured_input

if TYPE_CHECKING:
    from collections.abc import Mapping

    import numpy as np
    from numpy.typing import NDArray

    from valve_sim.model import Drive


class TraceError(ValveError):
    """A recording cannot be used: one line with the file and the topic, what was found, and the remedy."""


class DriveErrors(NamedTuple):
    """How well the times and levels of commands are known that were found in samples of a voltage.

    Attributes:
        times: Standard deviation of each command's time, s, shape (k,); 0 where it is exact.
        volts: Standard deviation of its voltage, V, shape (k,); commands of one voltage share one error.
    """

    times: NDArray[np.float64]
    volts: NDArray[np.float64]


@dataclass(frozen=True, repr=False)
class Trace(Signals):
    """One valve in one recording; all times are seconds since `epoch_ns`.

    Beside the positions it has the channels of `Signals`, such as `coil_current`, as far as they were recorded.

    Attributes:
        source: The file and the valve, for messages.
        drive: Commanded voltage (V), held between commands, 0 V before the first.
        times: Times of position samples, strictly ascending, s, shape (n,); none where no position was recorded.
        pilot_position: Pilot plunger, m, shape (n,), as it was recorded; see `usable_position`.
        drive_errors: How well the commands are known; None where they were recorded as they were sent.
        averaging: Of how many readings, the last one included, each recorded position is the mean.
        bandwidth: Of the position sensor's low-pass of first order, Hz, as a map declares it; infinite: none.
        zero_error: Standard deviation of what the position sensor shows of a closed valve, m; 0 where that is 0.
        main_position: Main plunger, m, shape (n,); None where it was not recorded.
        outlet_start: Behind a valve with gas when the trace begins, Pa; None: as the valve declares it.
        epoch_ns: The first stamp of commands or samples, ns, on the samples' clock.
        clock: "header" when samples are timed by their stamps, "bag" when by the time they were recorded; of a table
            "time column", or "rate".
        findings: One sentence each: what was dropped, repaired or salvaged, with counts.
        units: Quantity to the unit that a map gives it; of others SI.
        origins: Quantity as a map calls it ("position") to the topic or column that it was read from, for messages.
    """

    source: str
    drive: Drive
    times: NDArray[np.float64]
    pilot_position: NDArray[np.float64]
    main_position: NDArray[np.float64] | None = None
    _: KW_ONLY
    drive_errors: DriveErrors | None = None
    averaging: int = 1
    bandwidth: float = math.inf
    zero_error: float = 0.0
    outlet_start: float | None = None
    epoch_ns: int = 0
    clock: str = "header"
    findings: tuple[str, ...] = ()
    origins: Mapping[str, str] = field(default_factory=dict)
    units: Mapping[str, str] = field(default_factory=dict)

    def __repr__(self) -> str:
        """Trace('train.mcap', 16 commands, 10000 samples of the position)."""
        count = len(self.sample_times)
        return f"Trace({self.source!r}, {len(self.drive.times)} commands, {count} samples of the {self.primary_signal})"

    @cached_property
    def measured_input(self) -> MeasuredInput | None:
        """The measured voltage as steps; None where none was measured."""
        return None if self.coil_voltage is None else measured_input(self.drive, self.coil_voltage)

    def input(self, release_voltage: float) -> Drive:
        """The voltage that drives a model: as measured, or else as commanded.

        Args:
            release_voltage: V, of the model; above 0 it freewheels by itself while the command is 0.
        """
        measured = self.measured_input
        return self.drive if measured is None else measured.drive(self.drive, freewheels=release_voltage > 0.0)

    @property
    def has_positions(self) -> bool:
        """Whether positions were recorded; else the coil's current or the outlet's pressure was."""
        return len(self.times) > 0

    @property
    def primary_signal(self) -> str:
        """The signal that is compared with a model, the first that was recorded: position, current, outlet_pressure."""
        if self.has_positions:
            return JUDGED[0]
        recorded = self.signals()
        return next((key for key in JUDGED[1:] if SIGNALS[key].name in recorded), JUDGED[-1])

    @cached_property
    def left_out(self) -> LeftOut:
        """Which positions are no measurements, and take part in no fit."""
        return find_left_out(self.times, self.pilot_position)

    @cached_property
    def usable_position(self) -> NDArray[np.float64]:
        """Pilot plunger, m, shape (n,); what is left out lies on lines between the readings beside it."""
        return bridged(self.times, self.pilot_position, self.left_out.any)

    @cached_property
    def kept_position(self) -> NDArray[np.float64]:
        """Pilot plunger, m, of the samples that are not left out: of them noise and steps are seen."""
        left_out = self.left_out.any
        return self.pilot_position[~left_out] if left_out.any() else self.pilot_position

    @property
    def primary_samples(self) -> Signal:
        """The samples of the signal that is compared with a model; a position is `usable_position`."""
        signal = self._other_signal
        return Signal(self.times, self.usable_position) if signal is None else signal

    @property
    def sample_times(self) -> NDArray[np.float64]:
        """The times of the samples of `primary_signal`, s."""
        signal = self._other_signal
        return self.times if signal is None else signal.times

    @property
    def _other_signal(self) -> Signal | None:
        """The signal by which a valve is judged; None where it is the position, or none was recorded."""
        return None if self.has_positions else self.signals().get(SIGNALS[self.primary_signal].name)
