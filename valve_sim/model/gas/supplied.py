"""A run of a valve with gas while the pressures of its tank and of its demand change."""

from __future__ import annotations

import math
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valve_sim.model.compiling import compiled
from valve_sim.model.drives import Drive
from valve_sim.model.gas import driver
from valve_sim.model.gas.boundary import set_demand, set_inlet
from valve_sim.model.gas.driver import FINISHED, NONE
from valve_sim.model.gas.live_record import most_steps
from valve_sim.model.gas.transitions import set_voltage
from valve_sim.model.gas.variational import enter_segment, leave_segment
from valve_sim.model.gas.variational_pressure import enter_demand, leave_demand, vary_inlet
from valve_sim.model.response import Response
from valve_sim.model.simulation import (
    TOLERANCE,
    Array,
    Samples,
    Valve,
    check_outcome,
    delay_and_end,
    response_of,
)

_NONE: Final = np.empty(0)


class Supply(NamedTuple):
    """The pressures at both ends of a valve with gas. Where there are no samples the declared one holds.

    The tank's is linear between its samples, as a tank empties; that of the demand holds until its next sample, as
    valve_node holds it. Before its first sample each is as it is there.

    Attributes:
        times: (k,) s, ascending. pressures: (k,) Pa, above 0: the tank's.
        demand_times: (m,) s, ascending. demand_pressures: (m,) Pa, above 0: behind the demand's orifice.
    """

    times: Array
    pressures: Array
    demand_times: Array = _NONE
    demand_pressures: Array = _NONE


def simulate_supplied(
    valve: Valve, drive: Drive, supply: Supply, sample_times: ArrayLike, start_time: float
) -> Response:
    """As `simulate`, of a valve with gas; it rests closed until the start, s.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    times = np.ascontiguousarray(sample_times, dtype=np.float64)
    return response_of(valve.record(), times, start_time, partial(run_supplied, drive=drive, supply=supply))


def run_supplied(
    record: Any,
    state: Any,
    drive: Drive,
    supply: Supply,
    samples: Samples,
    events: Any,
    tolerance: float = TOLERANCE,
) -> int:
    """As `simulation.run_record`, of a valve with gas, without derivatives (`sensitivities` has these).

    Args:
        record: (1,) GAS_VALVE_RECORD. state: (1,) GAS_STATE_RECORD, advanced. drive: the commanded voltage.
        supply: in place of the declared pressures. samples, events, tolerance: as there.

    Returns:
        how many events there were.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    course = course_of(record, state, drive, supply, delay_and_end(record, samples)[1])
    return run_changes(record, state, course, samples, events, tolerance, None)


class SuppliedCourse(NamedTuple):
    """All that changes in a run, in its order.

    Attributes:
        changes: times, s; voltages, V; pressures of the tank, Pa, and their rates, Pa/s; pressures behind the demand's
            orifice, Pa: (n,) each, NaN for no change.
        end: of the run, s. commands: (n,) number of the command, −1 where a pressure changes.
    """

    changes: tuple[Array, ...]
    end: float
    commands: NDArray[np.int64]


def run_changes(
    record: Any, state: Any, course: SuppliedCourse, samples: Samples, events: Any, tolerance: float, vary: Any
) -> int:
    """The run itself; `vary`: as of `simulation.run_record`, whose commands are all changes.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    times, rows, current_times, currents = samples
    delay, _ = delay_and_end(record, samples)
    shown = (times - delay if delay else times, rows, current_times, currents)
    control = (tolerance, most_steps(course.end - state["time"].item()))
    count, outcome = _run(record, state, (*course.changes, course.end), shown, events, control, vary)
    check_outcome(outcome)
    return int(count)


def course_of(record: Any, state: Any, drive: Drive, supply: Supply, end: float) -> SuppliedCourse:
    """What changes, and when, up to `end`; the pressures of the start are set in the state."""
    start = float(state["time"].item())
    rates = np.empty(0)
    if len(supply.times):
        rates = np.append(np.diff(supply.pressures) / np.diff(supply.times), 0.0)
        index = int(np.searchsorted(supply.times, start, side="right")) - 1
        rate = float(rates[index]) if index >= 0 else 0.0
        set_inlet(record, state, float(np.interp(start, supply.times, supply.pressures)), rate)
    if len(supply.demand_times):
        index = int(np.searchsorted(supply.demand_times, start, side="right")) - 1
        set_demand(record, state, float(supply.demand_pressures[max(index, 0)]))
    tank, demand = supply.times > start, supply.demand_times > start
    changes = [drive.times, supply.times[tank], supply.demand_times[demand]]
    order = np.argsort(np.concatenate(changes), kind="stable")

    def column(own: int, values: Array) -> Array:
        parts = [values if number == own else np.full(len(times), math.nan) for number, times in enumerate(changes)]
        return np.asarray(np.concatenate(parts)[order])

    found = (
        np.concatenate(changes)[order], column(0, drive.volts), column(1, supply.pressures[tank]),
        column(1, rates[tank]), column(2, supply.demand_pressures[demand]),
    )  # fmt: skip
    return SuppliedCourse(found, end, np.where(order < len(drive.times), order, -1))


@compiled
def _run(valve: Any, state: Any, course: Any, samples: Any, events: Any, control: Any, vary: Any) -> Any:
    """`driver.run_drive` of a course (times, volts, pressures, rates, demands, end): NaN for no change."""
    change_times, volts, pressures, rates, demands, t_end = course
    times, rows, current_times, currents = samples
    at, at_current, count = NONE, NONE, NONE
    for change in range(len(change_times) + 1):
        is_last = change == len(change_times)
        end = t_end if is_last else min(change_times[change], t_end)
        left = (times[at:], rows[at:], current_times[at_current:], currents[at_current:])
        until, log = (end, not is_last), (events, count)
        done, count, outcome = driver.run_varied(valve, state, until, left, log, control, vary)
        at += done[0]
        at_current += done[1]
        if outcome != FINISHED or is_last or change_times[change] > t_end:
            return count, outcome
        if not math.isnan(volts[change]):
            peak = state[0].peak_current
            leave_segment(valve[0], state[0], change, vary)
            set_voltage(valve, state, volts[change])
            enter_segment(valve[0], state[0], change, peak, vary)
        if not math.isnan(pressures[change]):
            set_inlet(valve, state, pressures[change], rates[change])
            vary_inlet(rates[change], change, vary)
        if not math.isnan(demands[change]):
            leave_demand(valve[0], state[0], change, vary)
            set_demand(valve, state, demands[change])
            enter_demand(valve[0], state[0], change, vary)
    return count, FINISHED
