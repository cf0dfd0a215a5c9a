"""Reads a record of the magnet: arrays in SI, the zero of the current sensor taken off, and when the ball jumped."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.mat_files import read_variables
from valve_sim.model import ValveError

Array = NDArray[np.float64]

DEFAULT: Final = Path(__file__).resolve().parents[3] / "shared" / "data" / "maglev"
HOW_TO_GET_IT: Final = "expected a record of github.com/Bocchio01/062020-Lab-Mechatronics; give its path"
VARIABLE, ROWS, RATE = "measurements", 7, 200.0
"""What a file holds: rows of time, distance, velocity, two currents and two duty cycles, at this rate in Hz."""
OFF: Final = 0.035
"""Duty cycle below which the bridge passes no current but its leakage: the sensor then shows its zero."""
SHORTEST_REST: Final = 20
"""Samples from which the zero is taken."""
JUMP, JUMP_SAMPLES = 1.5e-3, 5
"""m by which the ball comes nearer within so many samples where it jumps: nothing else is as fast."""


@dataclass(frozen=True)
class MagnetRecord:
    """What was measured, at a fixed rate.

    Attributes:
        source: for messages.
        times: (n,) s. current: (n,) A of the coil, less the sensor's zero. distance: (n,) m from magnet to ball.
        duty: (n,) duty cycle of the coil's voltage, 0 to 1, that is applied from this sample to the next.
        jump: index of the sample after the fastest approach of a jump; None where the ball stays.
    """

    source: str
    times: Array
    current: Array
    distance: Array
    duty: Array
    jump: int | None

    @classmethod
    def of(cls, source: str, times: Array, current: Array, distance: Array, duty: Array) -> MagnetRecord:
        """From raw signals, (n,) each.

        Raises:
            ValveError: the record does not begin with the voltage off, so that the current's zero is not known.
        """
        off = duty < OFF
        begins = len(duty) if off.all() else int(np.argmin(off))
        if begins < SHORTEST_REST:
            raise ValveError(
                f"{source}: the duty cycle is off for {begins} samples at the beginning; expected at least "
                f"{SHORTEST_REST}, from which the current's zero is taken"
            )
        moved = distance[JUMP_SAMPLES:] - distance[:-JUMP_SAMPLES]
        jump = int(np.argmin(np.diff(distance))) + 1 if np.min(moved) < -JUMP else None
        zero = float(np.mean(current[:begins]))
        return cls(source, times, current - zero, distance, duty, jump)

    @property
    def interval(self) -> float:
        """Time from one sample to the next, s."""
        return float((self.times[-1] - self.times[0]) / (len(self.times) - 1))


def read_record(path: Path) -> MagnetRecord:
    """One file of the rig.

    Raises:
        ValveError: the file is missing or not such a file; one line that says how to get it.
    """
    (rows,) = read_variables(path, [VARIABLE], HOW_TO_GET_IT)
    if rows.ndim != 2 or rows.shape[0] != ROWS or not np.isfinite(rows).all():
        raise ValveError(
            f"{path}: {VARIABLE} is {' × '.join(map(str, rows.shape))}, expected {ROWS} rows of finite numbers; "
            f"{HOW_TO_GET_IT}"
        )
    times, distance, _, current, _, duty, _ = rows
    if len(times) < 2 or not np.allclose(np.diff(times), 1.0 / RATE, rtol=1e-3):
        raise ValveError(f"{path}: samples are not {1e3 / RATE:g} ms apart; {HOW_TO_GET_IT}")
    # The first sample of some records is the end of the sensor's range, before it has measured anything.
    distance = np.concatenate([distance[1:2], distance[1:]])
    return MagnetRecord.of(path.name, times, current, distance, duty)


def records_in(folder: Path, kind: str) -> list[Path]:
    """Files of a kind, "force" or "inductance", in order.

    Raises:
        ValveError: there is none.
    """
    found = sorted(folder.glob(f"{kind}_*.mat"))
    if not found:
        raise ValveError(f"{folder}: holds no {kind}_*.mat; {HOW_TO_GET_IT}")
    return found


def read_jumps(paths: Iterable[Path]) -> list[MagnetRecord]:
    """Records in which the ball jumps.

    Raises:
        ValveError: a file is unusable, or its ball does not jump.
    """
    records = [read_record(path) for path in paths]
    still = next((record for record in records if record.jump is None), None)
    if still is not None:
        raise ValveError(f"{still.source}: the ball never comes {1e3 * JUMP:g} mm nearer at once; expected a jump")
    return records
