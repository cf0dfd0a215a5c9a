"""A valve that does not open: by how far it came, or by its current alone, as that of a valve that is held there.

While a plunger moves, its current is lower than that of one that is held. So a stroke is compared with the valve as
commissioned and with the same valve held at its seat, at the gap and at its stop, each at its own commands' errors.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

from valve_sim.identification.fit.problem import Problem
from valve_sim.identification.fit.result import fit
from valve_sim.identification.fit.unknown import known
from valve_sim.identification.monitoring.findings import DidNotClose, DidNotOpen, Fault, OpenedPartly, WaitsForPressure
from valve_sim.identification.monitoring.stroke_delays import rough_shifts
from valve_sim.identification.plants.valve import ValvePlant
from valve_sim.model import EXACT, SimulationError, Valve
from valve_sim.recordings import Trace

AT_GAP: Final = 0.05
"""Share of the main plunger's travel within which the pilot waits at the gap."""
HOLDING: Final = 1e3
"""N: more than any such valve has."""
NEARLY: Final = 1.0 + 1e-6
"""A stroke that ends at the gap is longer than it by as much."""
PLAINLY_HELD: Final = 0.25
"""χ² of a held valve over that of the valve as commissioned, below which it was held."""
LATEST: Final = 5e-3
"""s: standard deviation of a command's time, which the current itself tells far better."""


def opening_fault(highest: float, valve: Valve) -> Fault:
    """What a valve that did not open stopped at, given how far its pilot plunger came, m."""
    gap, stroke = valve.parameters.pilot_gap, valve.parameters.stroke
    if valve.gas is not None and abs(highest - gap) < AT_GAP * (stroke - gap):
        return WaitsForPressure(highest)
    return DidNotOpen(max(highest, 0.0)) if highest < (gap or AT_GAP * stroke) else OpenedPartly(highest, stroke)


def held_fault(trace: Trace, valve: Valve, lateness: float = 0.0) -> Fault | None:
    """Where the valve was held during a stroke of which only the current was measured; None if it moved."""
    free = _left(trace, valve, lateness)
    found = [(_left(trace, held, lateness), fault) for fault, held in _held(valve)]
    least, fault = min(found, key=lambda candidate: candidate[0])
    return fault if least < PLAINLY_HELD * free else None


def _held(valve: Valve) -> Iterator[tuple[Fault, Valve]]:
    """What each would mean, and the valve; one held open was not closed by the stroke before."""
    gap, stroke = valve.parameters.pilot_gap, valve.parameters.stroke
    yield DidNotOpen(0.0), _pushed(valve, -HOLDING)
    if gap > 0.0:
        at_gap = OpenedPartly(gap, stroke) if valve.gas is None else WaitsForPressure(gap)
        yield at_gap, valve.with_values(stroke=gap * NEARLY)
    yield DidNotClose(stroke), _pushed(valve, HOLDING)


def _pushed(valve: Valve, force: float) -> Valve:
    return replace(valve, effects={**valve.effects, "constant_force": {"force": force}})


def _left(trace: Trace, valve: Valve, lateness: float) -> float:
    """χ² of the current, the errors of the first and the last command fitted; inf where it cannot be simulated."""
    plant = ValvePlant([trace], replace(valve, tolerances=EXACT))
    errors = plant.timing_errors
    late = [known(error._replace(sigma=LATEST)) for error in (errors if len(errors) <= 2 else (errors[0], errors[-1]))]
    try:
        start = dict(zip((error.name for error in errors), rough_shifts(trace, valve, lateness), strict=True))
        held = {"clock_offset[0]": lateness}
        return fit(Problem(plant), late, start, held=held).chi2
    except SimulationError:
        return math.inf
