"""Signals of several strokes in a row as one."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array
from valve_sim.traces import Signal, Trace


def joined(signals: Sequence[Signal | None], starts: Sequence[float]) -> Signal | None:
    """Signals of one stroke each in a row; None where one is missing. What two strokes have is there once.

    Args:
        signals: of the strokes. starts: s, by which each is later than its own times say.
    """
    known = [signal for signal in signals if signal is not None]
    if len(known) < len(signals):
        return None
    times = np.concatenate([signal.times + start for signal, start in zip(known, starts, strict=True)])
    is_later = _rises(times)
    return Signal(times[is_later], np.concatenate([signal.values for signal in known])[is_later])


def with_joined_ends(trace: Trace, strokes: Sequence[Trace], starts: Sequence[float]) -> Trace:
    """A trace with the pressures at both ends of the valve as these strokes have them; arguments as of `joined`."""
    return replace(
        trace,
        inlet_pressure=joined([stroke.inlet_pressure for stroke in strokes], starts),
        demand_pressure=joined([stroke.demand_pressure for stroke in strokes], starts),
    )


def _rises(times: Array) -> NDArray[np.bool_]:
    """Mask of the times that are later than all before them."""
    return np.asarray(times > np.concatenate([[-math.inf], np.maximum.accumulate(times)[:-1]]))
