"""A run of a valve with gas while the pressure of its tank changes."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from valve_sim.model import driver
from valve_sim.model.compiling import compiled
from valve_sim.model.driver import FINISHED, NONE
from valve_sim.model.drives import Drive
from valve_sim.model.gas.step import set_inlet
from valve_sim.model.simulation import TOLERANCE, Array, Samples, check_outcome, delay_and_end, most_steps
from valve_sim.model.transitions import set_voltage


class Supply(NamedTuple):
    """The tank's pressure: linear between its samples, constant before the first and after the last.

    Attributes:
        times: (k,) s, ascending, at least one.
        pressures: (k,) Pa, above 0.
    """

    times: Array
    pressures: Array


def run_supplied(
    record: Any,
    state: Any,
    drive: Drive,
    supply: Supply,
    samples: Samples,
    events: Any,
    tolerance: float = TOLERANCE,
) -> int:
    """As `simulation.run_record`, of a valve with gas, without derivatives.

    Args:
        record: (1,) GAS_VALVE_RECORD. state: (1,) GAS_STATE_RECORD, advanced. drive: the commanded voltage.
        supply: in place of the declared inlet pressure. samples, events, tolerance: as there.

    Returns:
        how many events there were.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    times, rows, current_times, currents = samples
    delay, end = delay_and_end(record, samples)
    start = float(state["time"].item())
    knots, pressures = supply
    rates = np.append(np.diff(pressures) / np.diff(knots), 0.0)
    set_inlet(record, state, float(np.interp(start, knots, pressures)), _rate_at(start, knots, rates))
    later = knots > start
    changes = np.concatenate([drive.times, knots[later]])
    nothing = np.full(len(drive.times), math.nan), np.full(int(later.sum()), math.nan)
    order = np.argsort(changes, kind="stable")
    volts = np.concatenate([drive.volts, nothing[1]])[order]
    tank = np.concatenate([nothing[0], pressures[later]])[order]
    course = (changes[order], volts, tank, np.concatenate([nothing[0], rates[later]])[order], end)
    shown = (times - delay if delay else times, rows, current_times, currents)
    count, outcome = _run(record, state, course, shown, events, (tolerance, most_steps(end - start)))
    check_outcome(outcome)
    return int(count)


def _rate_at(time: float, knots: Array, rates: Array) -> float:
    index = int(np.searchsorted(knots, time, side="right")) - 1
    return float(rates[index]) if index >= 0 else 0.0


@compiled
def _run(valve: Any, state: Any, course: Any, samples: Any, events: Any, control: Any) -> Any:
    """`driver.run_drive` of a course (times, volts, pressures, rates, t_end): NaN where there is no change of it."""
    change_times, volts, pressures, rates, t_end = course
    times, rows, current_times, currents = samples
    at, at_current, count = NONE, NONE, NONE
    for change in range(len(change_times) + 1):
        is_last = change == len(change_times)
        end = t_end if is_last else min(change_times[change], t_end)
        left = (times[at:], rows[at:], current_times[at_current:], currents[at_current:])
        done, count, outcome = driver.run(valve, state, (end, not is_last), left, (events, count), control, None)
        at += done[0]
        at_current += done[1]
        if outcome != FINISHED or is_last or change_times[change] > t_end:
            return count, outcome
        if not math.isnan(volts[change]):
            set_voltage(valve, state, volts[change])
        if not math.isnan(pressures[change]):
            set_inlet(valve, state, pressures[change], rates[change])
    return count, FINISHED
