"""The integrator: steps from event to event, from whose polynomials all samples are read.

A step ends where error control or an event ends it, never at the time of a sample: samples within it are read from its
polynomial. Only a command cuts a step. So the state does not depend on when it was sampled, and a valve that is stepped
live equals one whole run, to the last bit.

Begin to read at `run`. `steps` takes one step, `events` does what happens at its end, `samples` reads what the sensors
show in it, and `modes` says what the equations are asked for. All of these functions are compiled by `lowering`; the
kernels that they invoke are made by `kernels`. `b` is the block of a valve, one array with all its parameters and
states; `layout` names its slots. `t` has the tangents of the block, (slots, directions); the block says how many
directions.
"""

from __future__ import annotations

from typing import Final

from valve_sim.model.core import events, gas_steps, modes, polynomials, samples, steps
from valve_sim.model.core import layout as at
from valve_sim.model.core.events import arrive, end_step, leave, set_voltage
from valve_sim.model.core.gas_steps import finish_gas_step, know_rate, regime_at, rest_at, take_gas_step
from valve_sim.model.core.modes import GAP_HOLD, MAIN, OPEN, PILOT, RIGID, before, enter, set_tangents
from valve_sim.model.core.polynomials import Block, invoke
from valve_sim.model.core.samples import GAS_COLUMNS, ROW_COLUMNS, fill, fill_row, shown_main, shown_pilot
from valve_sim.model.core.steps import commit, step
from valve_sim.model.core_types import Outcome

FINISHED, STEP_TOO_SMALL, TOO_MANY_STEPS, CHATTERING = (int(outcome) for outcome in Outcome)
SHORTEST_PROGRESS: Final = 1e-12
LONGEST_CHATTER: Final = 1000
"""Steps in a row that are shorter, s, after which a run ends with an error."""
MOST_STEPS: Final = 1_000_000
"""Steps that a run may take, and as many again for each second of it."""
LONGEST_RUN: Final = 1e9
"""s, of which the steps are counted."""
NEVER: Final = -1e300
"""s: before any run."""
NO_TRAVEL: Final = -1
"""In place of an Outcome: the gap is not inside the stroke."""
LIVE_EVENTS: Final = 256
"""Events of a live valve that are kept from one look to the next."""
LIVE_STEPS: Final = 4_000_000
"""Steps of a live valve between two looks, after which it ends with an error."""
CHANGES: Final = 5
"""Numbers of a command: see `drive`."""


def start_gas(b: Block, t: Block) -> None:
    """Put the declared gas into the outlet of a valve at rest, and the declared pressures at both ends."""
    b[at.TANK] = b[at.DECLARED_TANK]
    b[at.TANK_RATE] = 0.0
    b[at.TANK_TIME] = b[at.TIME]
    b[at.DEMAND] = b[at.DECLARED_DEMAND]
    b[int(b[at.DENSITY])] = b[at.FIRST_DENSITY]
    set_tangents(b, t, at.TANK, at.DECLARED_TANK, 1.0)
    set_tangents(b, t, at.DEMAND, at.DECLARED_DEMAND, 1.0)
    set_tangents(b, t, int(b[at.DENSITY]), at.FIRST_DENSITY, 1.0)


def settle_flow(b: Block, t: Block) -> None:
    """Decide afresh what the flow of gas does at the state, of a valve whose pressures are set."""
    rest_at(b, t)
    b[at.REGIME] = 0.0
    b[at.REGIME] = regime_at(b, t, 0.0, 0.0, 0.0)


def supply(b: Block, t: Block, change: Block) -> None:
    """Pressures change now: of the tank, Pa, and its rate, Pa/s, and behind the demand, Pa; NaN where one does not."""
    b[at.GAS_KNOWN] = 0.0
    if change[0] == change[0]:
        b[at.TANK] = change[0]
        b[at.TANK_RATE] = change[1]
        b[at.TANK_TIME] = b[at.TIME]
        set_tangents(b, t, at.TANK, at.TANK, 0.0)
        set_tangents(b, t, at.TANK_TIME, at.DELTA, 1.0)
    if change[2] == change[2]:
        b[at.DEMAND] = change[2]
        set_tangents(b, t, at.DEMAND, at.DEMAND, 0.0)
    b[at.PENDING] = 0.0


def run(
    b: Block, t: Block, end: float, cuts: bool, most: int, times: Block, count: int, rows: Block,
    columns: int, slopes: Block, current_times: Block, current_count: int, currents: Block, current_slopes: Block,
    events: Block, room: int,
) -> int:  # fmt: skip
    """Step a valve from its state to a time under one voltage; returns an Outcome.

    Args:
        b, t: see the module.
        end: s. cuts: whether to stop exactly there, before a command, or at the last whole step.
        most: steps, after which the run ends with an error.
        times: s, ascending, of `count` samples. rows: what they show, `columns` numbers each: 1, the pilot plunger as
            shown, or ROW_COLUMNS, or GAS_COLUMNS of a valve with gas.
        current_times: s, ascending, of `current_count` samples of the current u, and with gas of the outlet's pressure,
            Pa, in turn, unless whole rows are asked for.
        slopes, current_slopes: with derivatives, those of the pilot plunger and of u: (samples, directions); with gas
            (samples, 2, directions) of u and the pressure.
        events: four numbers each, time, kind, position and the velocity before, for `room` of them.
    """
    others = count if columns > 1 else current_count
    for _ in range(most):
        if b[at.PENDING] == 0.0:
            if b[at.TIME] >= end and b[at.SAMPLED] >= count and b[at.SAMPLED_ROWS] >= others:
                return FINISHED
            ends = step(b, t)
            if ends < 0:
                return STEP_TOO_SMALL
            b[at.ENDS] = ends
            b[at.PENDING] = 1.0
        following = b[at.TIME] + b[at.STEP]
        if count + others > 0:
            # A sample at the very end of a step is of the next one, as it is live: that has what happens there.
            last = end if following > end else before(following)
            fill(
                b, t, last, times, count, rows, columns, slopes, current_times, current_count, currents, current_slopes
            )
        if following > end:
            if cuts:
                if end > b[at.TIME]:
                    cut(b, t, end)
                b[at.PENDING] = 0.0
            return FINISHED
        b[at.CHATTER] = b[at.CHATTER] + 1.0 if b[at.STEP] < SHORTEST_PROGRESS else 0.0
        if b[at.CHATTER] > LONGEST_CHATTER:
            return CHATTERING
        ends = int(b[at.ENDS])
        commit(b, t, following)
        if ends != at.NO_EVENT:
            end_step(b, t, ends, events, room)
        elif b[at.DENSITY] > 0.0:
            know_rate(b, t)
    return TOO_MANY_STEPS


def cut(b: Block, t: Block, end: float) -> None:
    """End the present step at a time, s, before a command; with gas the step is repeated, so that it is as exact."""
    if b[at.DENSITY] > 0.0:
        take_gas_step(b, t, end - b[at.TIME])
        finish_gas_step(b, t)
        b[at.GAS_KNOWN] = 0.0
    else:
        b[at.ELAPSED] = end - b[at.TIME]
        invoke(b[at.AT], b, t)
    commit(b, t, end)


def drive(
    b: Block, t: Block, commands: Block, command_count: int, end: float, most: int, times: Block,
    count: int, rows: Block, columns: int, slopes: Block, current_times: Block, current_count: int, currents: Block,
    current_slopes: Block, moves: Block, events: Block, room: int,
) -> int:  # fmt: skip
    """Step a valve through a whole drive; arguments as for `run`.

    Args:
        commands: CHANGES numbers each: s, V, and of a valve with gas Pa of the tank, Pa/s, and Pa behind the demand,
            see `supply`; NaN where something does not change. What is before the state's time was so from the start.
        moves: with derivatives, those of time and voltage: (commands, 2, directions).
    """
    width = int(b[at.WIDTH])
    for command in range(command_count):
        change = commands[CHANGES * command :]
        when = change[0]
        is_new = when >= b[at.TIME]
        if when > end:
            break
        outcome = run(
            b, t, when, True, most, times, count, rows, columns, slopes, current_times, current_count, currents,
            current_slopes, events, room,
        )  # fmt: skip
        if outcome != FINISHED:
            return outcome
        own = moves[2 * command * width :]
        for k in range(width):
            t[at.DELTA * width + k] = own[k]
        if is_new:
            leave(b, t, at.NO_EVENT)
        if change[1] == change[1]:
            for k in range(width):
                t[at.VOLTS * width + k] = own[width + k]
            set_voltage(b, t, change[1])
        if b[at.DENSITY] > 0.0:
            supply(b, t, change[2:])
        if is_new:
            arrive(b, t)
    return run(
        b, t, end, False, most, times, count, rows, columns, slopes, current_times, current_count, currents,
        current_slopes, events, room,
    )  # fmt: skip


def renumber(b: Block, t: Block, numbers: Block, slopes: Block) -> None:
    """Go on with other numbers of the same valve, from the state's time, that of the last command, on.

    Args:
        numbers: of the valve. slopes: with derivatives, the tangents of these: (numbers, directions).
    """
    leave(b, t, at.NO_EVENT)
    width = int(b[at.WIDTH])
    count = int(b[at.NUMBER_COUNT])
    for i in range(count):
        b[at.NUMBERS + i] = numbers[i]
    for i in range(count * width):
        t[at.NUMBERS * width + i] = slopes[i]
    invoke(b[at.PREPARE], b, t)
    enter(b, t)
    arrive(b, t)


def start(b: Block, t: Block, blank: Block, numbers: Block, count: int, time: float) -> None:
    """Make the block of a valve that rests closed and without current at a time, s.

    Args:
        blank: the block of no valve in particular, with the addresses of its kernels. numbers: `count` of the valve.
    """
    for i in range(at.SERIES_X):
        b[i] = blank[i]
    for i in range(count):
        b[at.NUMBERS + i] = numbers[i]
    b[at.TIME] = time
    b[at.UNSEATED_TIME] = time
    b[at.FLIPPED] = 0.0
    b[at.FLIPPED_AT] = NEVER
    invoke(b[at.PREPARE], b, t)
    b[at.ONE_PLUNGER] = 1.0 if b[at.GAP] == 0.0 else 0.0
    if b[at.DENSITY] > 0.0:
        b[at.CHANGED] = time
        start_gas(b, t)
    enter(b, t)
    if b[at.DENSITY] > 0.0:
        settle_flow(b, t)


def whole(
    b: Block, blank: Block, numbers: Block, number_count: int, commands: Block, command_count: int, times: Block,
    count: int, rows: Block, room: int, time: float, end: float, tolerance: float,
) -> int:  # fmt: skip
    """Run one valve that rests closed and without current at a time, s, through a drive; returns an Outcome.

    Args:
        b: room for the block, and behind it for `room` events. tolerance: relative error of one step.
        blank, numbers: as for `start`. commands, times, end: as for `drive`. rows: whole ones.
    """
    start(b, b, blank, numbers, number_count, time)
    b[at.TOLERANCE] = tolerance
    if not (0.0 <= b[at.GAP] < b[at.STROKE]):
        return NO_TRAVEL
    columns = GAS_COLUMNS if b[at.DENSITY] > 0.0 else ROW_COLUMNS
    most = int(MOST_STEPS * (1.0 + min(max(0.0, end - time), LONGEST_RUN)))
    return drive(
        b, b, commands, command_count, end, most, times, count, rows, columns, b, times, 0, b, b, b, b[at.SIZE:], room
    )  # fmt: skip


def batch(
    b: Block, blank: Block, numbers: Block, number_count: int, valves: int, time: float, commands: Block,
    command_count: int, end: float, most: int, times: Block, count: int, rows: Block,
) -> int:  # fmt: skip
    """The positions of many valves under one drive, each (count,) in a row; returns how many ran to their end.

    Args:
        b: room for the block of one valve. numbers: of each valve in turn. Others: as for `start` and `drive`.
    """
    for valve in range(valves):
        start(b, b, blank, numbers[valve * number_count :], number_count, time)
        outcome = drive(
            b, b, commands, command_count, end, most, times, count, rows[valve * count :], 1, b, times, 0, b, b, b, b, 0
        )
        if outcome != FINISHED:
            b[at.OUTCOME] = outcome
            return valve
    return valves


def read(b: Block, t: Block, time: float, row: Block) -> None:
    """Fill a row of ROW_COLUMNS at a time within the step that is under way, without the sensor's delay."""
    h = max(0.0, time - b[at.TIME])
    row[0] = b[at.GAIN] * shown_pilot(b, h)
    row[1] = b[at.GAIN] * shown_main(b, h)
    b[at.ELAPSED] = h
    fill_row(b, t, row)


def advance(b: Block, time: float) -> int:
    """Step a live valve to a time, s, or to where it is if that is later, and read it there; returns an Outcome.

    Args:
        b: its block; behind it a row of output, and room for LIVE_EVENTS events, of which COUNT have been counted.
    """
    row = b[at.SIZE :]
    events = b[at.SIZE + GAS_COLUMNS :]
    outcome = run(b, b, time, False, LIVE_STEPS, row, 0, row, 1, row, row, 0, row, row, events, LIVE_EVENTS)
    if outcome == FINISHED and b[at.PENDING] == 0.0:
        b[at.ENDS] = step(b, b)
        b[at.PENDING] = 1.0
        if b[at.ENDS] < 0.0:
            outcome = STEP_TOO_SMALL
    if outcome == FINISHED:
        read(b, b, time, row)
    return outcome


def halt(b: Block, time: float) -> int:
    """Step a live valve exactly to a time, s; returns an Outcome."""
    row = b[at.SIZE :]
    events = b[at.SIZE + GAS_COLUMNS :]
    return run(b, b, time, True, LIVE_STEPS, row, 0, row, 1, row, row, 0, row, row, events, LIVE_EVENTS)


def command(b: Block, time: float, volts: float) -> int:
    """Command a live valve: a voltage in force from a time on, or from where it is; reads it there, see `advance`."""
    when = max(time, b[at.TIME])
    outcome = halt(b, when)
    if outcome != FINISHED:
        return outcome
    set_voltage(b, b, volts)
    return advance(b, when)


def set_pressures(b: Block, change: Block) -> None:
    """Change the pressures at both ends of a live valve with gas at its state's time, see `supply`."""
    supply(b, b, change)


def settle(b: Block) -> None:
    """Make a state agree with another valve: only a contact or a blocking diode makes it jump."""
    at_contact = b[at.MOVING] == 0.0 and (b[at.MODE] == GAP_HOLD or b[at.MODE] == OPEN)
    contact = b[at.STROKE] if b[at.MODE] == OPEN else b[at.GAP]
    if b[at.COMPLIANCE] <= RIGID:
        b[at.X] = min(b[at.X], b[at.STROKE])
    if at_contact and b[at.X] != contact:
        # The contact has gone: at rest between contacts, free to move off.
        b[at.MODE] = MAIN if b[at.X] >= b[at.GAP] else PILOT
    elif (b[at.MODE] == OPEN and b[at.X] < b[at.STROKE]) or (b[at.MODE] == PILOT and b[at.X] >= b[at.GAP]):
        b[at.MODE] = MAIN
    elif b[at.MODE] == MAIN and b[at.X] < b[at.GAP]:
        b[at.MODE] = PILOT
    if b[at.MODE] == MAIN and b[at.X] >= b[at.STROKE] and b[at.V] >= 0.0:
        b[at.MODE] = OPEN
        if b[at.COMPLIANCE] <= RIGID:
            b[at.MOVING] = 0.0
            b[at.V] = 0.0
    set_voltage(b, b, b[at.VOLTS])


FUNCTIONS: Final = (
    *polynomials.FUNCTIONS, *gas_steps.FUNCTIONS, *modes.FUNCTIONS, *samples.FUNCTIONS, *steps.FUNCTIONS,
    *events.FUNCTIONS, start_gas, settle_flow, supply, run, cut, drive, renumber, start, whole, batch, read, advance,
    halt, command, set_pressures, settle,
)  # fmt: skip
"""The functions that `lowering` compiles."""
