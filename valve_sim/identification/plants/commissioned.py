"""The coil current beside a commissioned valve: how late it is stamped, and its gain.

A live current has no stamp of its own and is timed by its arrival, and the coil's resistance is an assumption unless it
was measured. Neither matters for later changes: both are estimated from the baseline strokes, and
corrected.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from valve_sim.identification.plants.protocol import Array
from valve_sim.model import Valve, simulate
from valve_sim.traces import Signal, Trace

LATEST: Final = 5e-3
"""s: bound of a current's lateness, either way."""
EXPLAINED: Final = 0.05
"""Residual of the current over the current, root mean square, up to which it is used at all."""
FEWEST: Final = 20
"""Samples."""


class CommissionedCurrent(NamedTuple):
    """How a measured current relates to the model's.

    Attributes:
        lateness: s by which it is stamped late. gain: measured over modelled.
    """

    lateness: float
    gain: float

    def as_modelled(self, signal: Signal) -> Signal:
        """Corrected for lateness and gain."""
        return Signal(signal.times - self.lateness, signal.values / self.gain)


def commission_current(traces: Sequence[Trace], valve: Valve) -> CommissionedCurrent | None:
    """Compare the baseline strokes' currents with the model.

    Args:
        traces: one baseline stroke each, from rest.
        valve: as commissioned.

    Returns:
        None where a stroke has no current, or one that the model does not explain.
    """
    currents = [trace.coil_current for trace in traces]
    known = [current for current in currents if current is not None and len(current.times) >= FEWEST]
    if not known or len(known) < len(traces):
        return None
    measured = np.concatenate([current.values for current in known])

    def modelled(lateness: float) -> Array:
        return np.concatenate([
            simulate(valve, trace.drive, current.times - lateness, start_time=_start(trace)).coil_current
            for trace, current in zip(traces, known, strict=True)
        ])  # fmt: skip

    def left(lateness: float) -> float:
        shown = modelled(lateness)
        return float(np.sum(np.square(measured - _gain(measured, shown) * shown)))

    coarse = np.linspace(-LATEST, LATEST, 41)
    nearest = float(coarse[int(np.argmin([left(lateness) for lateness in coarse.tolist()]))])
    step = float(coarse[1] - coarse[0])
    lateness = float(minimize_scalar(left, bounds=(nearest - step, nearest + step), method="bounded").x)
    gain = _gain(measured, modelled(lateness))
    explains = left(lateness) <= EXPLAINED**2 * float(np.sum(np.square(measured)))
    return CommissionedCurrent(lateness, gain) if explains and gain > 0.0 else None


def _gain(measured: Array, shown: Array) -> float:
    power = float(shown @ shown)
    return float(measured @ shown) / power if power > 0.0 else 1.0


def _start(trace: Trace) -> float:
    return float(min(trace.drive.times[0], trace.times[0])) - 2.0 * LATEST
