"""Simulation of a whole trace, of one valve or of many at once."""

from __future__ import annotations

import math
import os
from concurrent.futures import ThreadPoolExecutor
from typing import Any, Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valve_sim.model.core import layout
from valve_sim.model.core.driver import CHANGES, LONGEST_RUN, MOST_STEPS
from valve_sim.model.core.samples import GAS_COLUMNS, ROW_COLUMNS
from valve_sim.model.core_types import Outcome
from valve_sim.model.drives import Drive, Supply
from valve_sim.model.errors import SimulationError
from valve_sim.model.response import Response, events_of
from valve_sim.model.valve import Valve

Array = NDArray[np.float64]

TOLERANCE: Final = 1e-10
"""Relative error of one step; against a 1e-13 reference it leaves events of random valves within 1e-11 s, where ten
times as much leaves them within 6e-11 s (`python -m benchmarks.accuracy`)."""
EVENT_ROOM: Final = 256
"""Events for which there is room at first; a run with more is repeated."""


def most_steps(duration: float) -> int:
    """Largest number of steps that a run of a duration, s, may take."""
    return int(MOST_STEPS * (1.0 + max(0.0, min(duration, LONGEST_RUN))))


def start_of(drive: Drive, times: Array) -> float:
    """The default start of a run, s: the first command or sample."""
    start = min(drive.times[0] if len(drive.times) else math.inf, times[0] if len(times) else math.inf)
    return float(start) if math.isfinite(start) else 0.0


def simulate(
    valve: Valve,
    drive: Drive,
    sample_times: ArrayLike,
    *,
    tolerance: float = TOLERANCE,
    start_time: float | None = None,
    supply: Supply | None = None,
) -> Response:
    """The response of a valve at rest to a commanded voltage.

    Args:
        valve: what is simulated.
        drive: the commanded voltage.
        sample_times: (n,) s, ascending.
        tolerance: relative error of one step.
        supply: of a valve with gas: pressures in place of the declared ones.
        start_time: s; the valve rests closed until then. Default: the first command or sample.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    times = np.ascontiguousarray(sample_times, dtype=np.float64)
    start = start_of(drive, times) if start_time is None else start_time
    plan, count, room = valve.plan(), len(times), EVENT_ROOM
    numbers, commands = valve.numbers(), commands_of(drive, supply, start)
    end, rows = float(times[-1]) if count else -math.inf, np.empty((count, columns_of(valve)))
    while True:
        block = np.empty(layout.SIZE + 4 * room)
        outcome = plan.entry("whole")(
            block.ctypes.data, plan.blank.ctypes.data, numbers.ctypes.data, len(numbers), commands.ctypes.data,
            len(commands), times.ctypes.data, count, rows.ctypes.data, room, start, end, tolerance,
        )  # fmt: skip
        if outcome:
            check_geometry(block)
            check_outcome(outcome)
        found = int(block[layout.COUNT])
        if found <= room:
            break
        room = found
    events = events_of(block[layout.SIZE : layout.SIZE + 4 * found].reshape(-1, 4))
    pilot, main, velocity, attraction, phase, _, voltage, _, current, *of_gas = rows.T
    return Response(
        times, pilot, main, velocity, current, attraction, phase.astype(np.uint8), events, voltage,
        bool(block[layout.ONE_PLUNGER]), *of_gas,
    )  # fmt: skip


def commands_of(drive: Drive, supply: Supply | None = None, start: float = -math.inf) -> Array:
    """(c, `driver.CHANGES`) s, V, and what changes of pressures, in the order of time.

    Args:
        drive: the commanded voltage. supply: pressures of a valve with gas, from a start on, s.
    """
    commands = np.full((len(drive.times), CHANGES), math.nan)
    commands[:, 0], commands[:, 1] = drive
    if supply is None:
        return commands
    pressures = supply.changes(start)
    both = np.concatenate([commands, np.insert(pressures, 1, math.nan, axis=1)])
    return both[np.argsort(both[:, 0], kind="stable")]


def columns_of(valve: Valve) -> int:
    """How many columns a whole row of output has: see `samples.ROW_COLUMNS`."""
    return ROW_COLUMNS if valve.gas is None else GAS_COLUMNS


def check_geometry(block: Array) -> None:
    """Check that the gap of a block is inside its stroke.

    Raises:
        SimulationError: it is not.
    """
    gap, stroke = float(block[layout.GAP]), float(block[layout.STROKE])
    if not 0.0 <= gap < stroke:
        raise SimulationError(f"the simulation cannot start: pilot_gap {gap:g} m is not inside stroke {stroke:g} m")


def check_outcome(outcome: int, what: str = "") -> None:
    """Check that a run was carried to its end.

    Raises:
        SimulationError: it was not; the message says why.
    """
    if outcome == Outcome.FINISHED:
        return
    why = {
        Outcome.STEP_TOO_SMALL: "the forces change faster than error control can follow; look for a parameter that is "
        "many orders of magnitude off, or, with motional_emf, for a flux that does not grow with the current",
        Outcome.TOO_MANY_STEPS: f"more than {MOST_STEPS} steps a second are needed; look for a time constant that is "
        "far below a microsecond",
        Outcome.CHATTERING: "the plungers chatter without progress in time",
    }
    raise SimulationError(f"{what}the simulation stopped early: {why[Outcome(outcome)]}")


def run_numbers(
    valve: Valve,
    numbers: Array,
    drive: Drive,
    sample_times: ArrayLike,
    *,
    tolerance: float = TOLERANCE,
    threads: int | None = None,
) -> Array:
    """Pilot plunger positions of one valve with other numbers under one drive, on several threads.

    Args:
        valve: whose effects all have.
        numbers: (k, m) the numbers of each in the order of `Valve.names`.
        drive: the commanded voltage.
        sample_times: (n,) s, ascending.
        tolerance: relative error of one step.
        threads: how many; default all processors.

    Returns:
        (k, n) m, as the position sensor shows it.

    Raises:
        SimulationError: a run could not be carried to its end; it names the row.
    """
    times = np.ascontiguousarray(sample_times, dtype=np.float64)
    numbers = np.ascontiguousarray(numbers, dtype=np.float64)
    positions = np.empty((len(numbers), len(times)))
    commands = commands_of(drive)
    start = start_of(drive, times)
    plan = valve.plan(runs=len(numbers))
    blank = plan.blank.copy()
    blank[layout.TOLERANCE] = tolerance
    workers = threads or os.cpu_count() or 1
    chunks = [chunk for chunk in np.array_split(np.arange(len(numbers)), workers * 4) if len(chunk)]
    end = float(times[-1]) if len(times) else -math.inf

    def work(chunk: Any) -> int:
        own, shown, room = numbers[chunk[0] :], positions[chunk[0] :], np.empty(layout.SIZE)
        done = plan.entry("batch")(
            room.ctypes.data, blank.ctypes.data, own.ctypes.data, own.shape[1], len(chunk), start,
            commands.ctypes.data, len(commands), end, most_steps(end - start), times.ctypes.data, len(times),
            shown.ctypes.data,
        )  # fmt: skip
        if done < len(chunk):
            check_outcome(int(room[layout.OUTCOME]), f"parameter set {int(chunk[0]) + done}: ")
        return int(done)

    if workers == 1:
        for chunk in chunks:
            work(chunk)
    else:
        with ThreadPoolExecutor(workers) as pool:
            list(pool.map(work, chunks))
    return positions


def check_flux(valve: Valve) -> None:
    """Check that a current follows from the flux of a valve, if its flux is modelled.

    Raises:
        SimulationError: it does not; the message says why.
    """
    if why_not := valve.why_no_flux():
        raise SimulationError(f"the simulation cannot start: {why_not}")
