"""Simulation of a whole trace, or of many parameter sets at once, by the one compiled core."""

from __future__ import annotations

import functools
import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from valve_sim.model.core import simulation as core
from valve_sim.model.core.equations import NEUTRAL
from valve_sim.model.core.live import Live
from valve_sim.model.core.plan import Plan, plan_of
from valve_sim.model.core.symbols import Own
from valve_sim.model.core.tracer import Trace
from valve_sim.model.core.valve import why_no_flux
from valve_sim.model.core_types import STATE_RECORD, Outcome, Phase
from valve_sim.model.drives import Drive
from valve_sim.model.effects import CATALOGUE, Effect, check_effects
from valve_sim.model.errors import ParameterError, SimulationError
from valve_sim.model.gas import GasParameters, check_gas, driver
from valve_sim.model.gas.boundary import fill_outlets
from valve_sim.model.gas.flux import why_no_flux as why_no_flux_beside_gas
from valve_sim.model.gas.live_record import MOST_STEPS_PER_SECOND, most_steps, new_live, step_live
from valve_sim.model.gas.record import GAS_COLUMNS, GAS_STATE_RECORD, is_of_gas, record_of
from valve_sim.model.gas.sampling import ROW
from valve_sim.model.gas.transitions import FIRST_STEP, set_voltage
from valve_sim.model.parameters import POLYNOMIAL_NAMES, ValveParameters, check_declared, check_geometry
from valve_sim.model.response import EVENT_ROOM, Response, event_log, event_tuple
from valve_sim.model.tolerances import EXACT, Tolerances

Array = NDArray[np.float64]

TOLERANCE: Final = 1e-10
"""Relative error of one step; against a 1e-13 reference it leaves events of random valves within 1e-11 s, where ten
times as much leaves them within 6e-11 s (`python -m benchmarks.accuracy`)."""


OF_TWO_PLUNGERS: Final = ("gap_offset", "pickup_impact")
"""Effects that a valve with one plunger cannot have."""


_POLYNOMIAL: Final = ValveParameters._fields.index("attraction_polynomial")
"""Its place among the declared parameters, where its coefficients stand one by one."""


ALWAYS: Final = (
    "coil_lag", "drive_gain", "gap_offset", "rest_attraction", "sensor_bandwidth", "sensor_delay", "sensor_gain",
    "stop_bounce", "stroke_offset",
)  # fmt: skip
"""Effects that only change numbers, and at their neutral values none: every valve's equations have them, so that
valves with and without share compiled code."""
_NOTHING: Final[Mapping[str, float]] = {}


@functools.cache
def _neutral(effect: Effect) -> dict[str, float]:
    return effect.neutral_values()


class Samples(NamedTuple):
    """What a run shall record, and the arrays to write it to.

    Attributes:
        times: (n,) s, of the positions.
        rows: (n, 1) or (n, 7), written: pilot and main position as shown (m), velocity (m/s), attraction (N), phase,
            position of the pilot itself (m), voltage at the coil's terminals (V). With gas (n, 1), (n, 9), which ends
            with outlet pressure (Pa) and mass flow (kg/s), or (n, 2): position as shown and outlet pressure.
        current_times: (m,) s.
        currents: (m,), written: normalised current u.
    """

    times: Array
    rows: Array
    current_times: Array
    currents: Array


@dataclass(frozen=True)
class Valve:
    """A valve to simulate: the declared parameters, and the effects that are on.

    Attributes:
        parameters: the declared valve.
        effects: effect name to its parameters, e.g. {"coulomb_friction": {"force": 0.3}}.
        tolerances: how well these values are known; changes nothing of the motion.
        gas: what flows through it; None for a valve on a bench, without gas.
    """

    parameters: ValveParameters = field(default_factory=ValveParameters)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    tolerances: Tolerances = EXACT
    gas: GasParameters | None = None

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], source: str) -> Valve:
        """A checked valve from {"valve": {...}, "effects": {...}, "tolerances": {...}, "gas": {...}}, all optional.

        Args:
            values: as found in a parameter file.
            source: the file or node, for messages.

        Raises:
            ParameterError: anything unknown, of the wrong type or out of range; the message names it.
        """
        parameters = check_declared(dict(values.get("valve") or {}), source)
        effects = check_effects(values.get("effects") or {}, source)
        gas = check_gas(values["gas"], source) if values.get("gas") else None
        tolerances = Tolerances.from_mapping(values.get("tolerances") or {}, source, effects, has_gas=gas is not None)
        tolerances.check_against(parameters, source)
        if parameters.has_one_plunger:
            _check_one_plunger(effects, gas, source)
        if gas is not None:
            _check_beside_gas(parameters, effects, source)
        else:
            _check_without_gas(effects, source)
        valve = cls(parameters, effects, tolerances, gas)
        gap, stroke = valve.after_effects("pilot_gap", "stroke")
        check_geometry(gap, stroke, f"{source} (with effects)", has_one_plunger=parameters.has_one_plunger)
        if why_not := valve.why_no_flux():
            raise ParameterError(f"{source}: effects.{why_not}")
        return valve

    def plan(self, width: int = 0) -> Plan:
        """What is compiled for its effects, with so many directions of derivatives; of a valve without gas."""
        effects = tuple([CATALOGUE[name] for name in (*self._own_effects(), *ALWAYS)])
        gas = self.gas
        return plan_of(
            effects, self._shapes(), width, freewheels=self.parameters.release_voltage > 0.0, has_gas=gas is not None,
            has_demand=gas is not None and gas.demand_orifice_diameter > 0.0,
        )  # fmt: skip

    def _own_effects(self) -> list[str]:
        """The effects for which equations are compiled."""
        return [name for name in self.effects if name not in ALWAYS]

    def numbers(self) -> Array:
        """Its numbers in the order of its plan's parameters; a parameter of an effect that is not given is neutral."""
        before, polynomial, after = (
            self.parameters[:_POLYNOMIAL], self.parameters[_POLYNOMIAL], self.parameters[_POLYNOMIAL + 1 :],
        )  # fmt: skip
        values = [*before, *polynomial, *after]  # type: ignore[misc]
        for name in (*self._own_effects(), *ALWAYS):
            # In the order of the parameters.
            values += {**_neutral(CATALOGUE[name]), **self.effects.get(name, _NOTHING)}.values()
        if self.gas is not None:
            values += self.gas.numbers()
        return np.array(values)

    def after_effects(self, *names: str) -> list[float]:
        """Numbers of a valve without gas as its effects leave them, by their names in `core.equations`."""
        trace, declared = Trace(), {**NEUTRAL, **self.declared()}
        found = [trace.constant(declared[name]) for name in names]
        for effect, given in self.effects.items():
            entry = CATALOGUE[effect]
            own = Own(**{name: trace.constant(value) for name, value in {**_neutral(entry), **given}.items()})
            for place, name in enumerate(names):
                if name in entry.changes:
                    found[place] = trace.lift(entry.changes[name](found[place], own))
        return [float(node.value or 0.0) for node in found]

    def _shapes(self) -> tuple[float, ...]:
        """The values of the parameters that shape its effects."""
        entries = [CATALOGUE[name] for name in self._own_effects()]
        return tuple(
            [{**_neutral(entry), **self.effects[entry.name]}[name] for entry in entries for name in entry.shapes]
        )

    def why_no_flux(self) -> str:
        """Why no current follows from its flux, for a message; empty where it does, or is not modelled."""
        if self.gas is not None:
            return why_no_flux_beside_gas(self.record())
        effects = [CATALOGUE[name] for name in (*self._own_effects(), *ALWAYS)]
        return why_no_flux(effects, self._shapes(), self.numbers().tolist())

    def to_mapping(self) -> dict[str, dict[str, Any]]:
        """The plain mapping that `from_mapping` takes back."""
        declared = self.parameters._asdict()
        declared["attraction_polynomial"] = list(self.parameters.attraction_polynomial)
        mapping: dict[str, dict[str, Any]] = {"valve": declared}
        if self.effects:
            mapping["effects"] = {name: CATALOGUE[name].packed(values) for name, values in self.effects.items()}
        if self.gas is not None:
            mapping["gas"] = self.gas._asdict()
        if tolerances := self.tolerances.to_mapping():
            mapping["tolerances"] = tolerances
        return mapping

    def declared(self) -> dict[str, float]:
        """The declared scalars by name, the polynomial as a0 … a3."""
        values = self.parameters._asdict()
        polynomial = values.pop("attraction_polynomial")
        return {**values, **dict(zip(POLYNOMIAL_NAMES, polynomial, strict=True))}

    def record(self) -> Any:
        """The (1,) VALVE_RECORD array that the compiled core reads; with gas a (1,) GAS_VALVE_RECORD."""
        return record_of(self.declared(), self.effects, self.gas)

    def with_values(self, **values: float) -> Valve:
        """The same valve with some declared scalars (a0 … a3 among them) replaced.

        Raises:
            ParameterError: no such scalar.
        """
        declared = self.declared()
        for name, value in values.items():
            if name not in declared:
                raise ParameterError(f"valve.{name}: no such parameter")
            declared[name] = value
        polynomial = tuple(declared.pop(name) for name in POLYNOMIAL_NAMES)
        parameters = ValveParameters(**declared, attraction_polynomial=polynomial)  # type: ignore[arg-type]
        return replace(self, parameters=parameters)

    def exact(self) -> Valve:
        """This valve with its values taken as exact: without tolerances, but for the sensor's."""
        return replace(self, tolerances=Tolerances(sensor=self.tolerances.sensor))

    def can_open(self) -> bool:
        """Whether the reference voltage, held without end, would lift the pilot plunger off its seat."""
        if self.gas is None:
            voltage, *lags = self.after_effects("reference_voltage", "coil_time_constant", "eddy_time_constant")
            settled = 50.0 * sum(lags) + 1e-3
            valve = Live.at_rest(self, 0.0, TOLERANCE)
            valve.command(voltage)
            valve.step(settled, commit=True)
            return bool(valve.row[4] != Phase.CLOSED)
        record = self.record()
        settled = 50.0 * float(record[0]["coil_time_constant"] + record[0]["eddy_time_constant"]) + 1e-3
        state = new_states(record, 0.0)
        set_voltage(record, state, float(record[0]["reference_voltage"]))
        live = new_live(record, state, TOLERANCE)
        check_outcome(step_live(live, settled, True)[1])
        return bool(live[0]["state"]["mode"] != Phase.CLOSED)


def _check_one_plunger(effects: Mapping[str, Mapping[str, float]], gas: GasParameters | None, source: str) -> None:
    """What is declared beside a pilot_gap of 0 must not need a pilot plunger."""
    for name in OF_TWO_PLUNGERS:
        if name in effects:
            raise ParameterError(
                f"{source}: effects.{name}: found beside valve.pilot_gap 0, a valve with one plunger, which picks "
                "nothing up; take the effect out, or declare the gap"
            )
    if gas is not None:
        raise ParameterError(
            f"{source}: gas: found beside valve.pilot_gap 0, a valve with one plunger, but gas equalises through the "
            "orifice of a pilot plunger; take the group gas out, or declare the gap"
        )


def _check_beside_gas(parameters: ValveParameters, effects: Mapping[str, Mapping[str, float]], source: str) -> None:
    """What is declared beside gas must go with it."""
    for name in effects:
        if not CATALOGUE[name].is_of(has_gas=True):
            raise ParameterError(
                f"{source}: effects.{name}: found beside gas, with which it cannot act: gas has the pressure across "
                "the main plunger itself, its stop is rigid, and it reads no expressions; take one of the two out"
            )
    if not parameters.seat_load > 0.0:
        raise ParameterError(
            f"{source}: valve.seat_load: found {parameters.seat_load:g} N beside gas, expected above 0 N: without it "
            "a pilot plunger at equal pressures floats on its seat"
        )


def _check_without_gas(effects: Mapping[str, Mapping[str, float]], source: str) -> None:
    """What is of gas alone needs gas."""
    for name in effects:
        if not CATALOGUE[name].is_of(has_gas=False):
            raise ParameterError(
                f"{source}: effects.{name}: found without gas, of which it is an effect; declare the group gas, or "
                "take the effect out"
            )


def new_states(records: Any, start_time: float) -> Any:
    """States of valves that rest closed and without current: one STATE_RECORD for each record, longer with gas."""
    has_gas = is_of_gas(records)
    states = np.zeros(len(records), GAS_STATE_RECORD if has_gas else STATE_RECORD)
    states["time"] = states["segment_time"] = states["unseated_time"] = start_time
    states["direction"] = 1
    states["step"] = FIRST_STEP
    if has_gas:
        fill_outlets(records, states)
    return states


def columns_of(records: Any) -> int:
    """How many columns a whole row of output has."""
    return ROW + GAS_COLUMNS if is_of_gas(records) else ROW


def simulate(
    valve: Valve,
    drive: Drive,
    sample_times: ArrayLike,
    *,
    tolerance: float = TOLERANCE,
    start_time: float | None = None,
) -> Response:
    """The response of a valve at rest to a commanded voltage.

    Args:
        valve: what is simulated.
        drive: the commanded voltage.
        sample_times: (n,) s, ascending.
        tolerance: relative error of one step.
        start_time: s; the valve rests closed until then. Default: the first command or sample.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    if valve.gas is None:
        return core.simulate(valve, drive, sample_times, tolerance=tolerance, start_time=start_time)
    times = np.ascontiguousarray(sample_times, dtype=np.float64)
    if start_time is None:
        start_time = float(min(np.min(drive.times, initial=math.inf), np.min(times, initial=math.inf)))
        start_time = start_time if math.isfinite(start_time) else 0.0
    run = partial(run_record, drive=drive, tolerance=tolerance)
    return response_of(valve.record(), times, start_time, run)


def response_of(record: Any, times: Array, start_time: float, run: Callable[..., int]) -> Response:
    """The response of a valve at rest until a start.

    Args:
        record: (1,) VALVE_RECORD. times: (n,) s, ascending. start_time: s.
        run: runs a state by a record: takes both, and `samples` and `events` by name; returns how many events.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    rows, currents = np.empty((len(times), columns_of(record))), np.empty(len(times))
    samples, room = Samples(times, rows, times, currents), EVENT_ROOM
    while True:
        state, events = new_states(record, start_time), event_log(room)
        count = run(record, state, samples=samples, events=events)
        if count <= room:
            break
        room = count
    if record[0]["sensor_delay"]:
        # Only the positions are late: the rest is the motion at the sample times.
        shown = rows[:, :2].copy()
        record[0]["sensor_delay"] = 0.0
        run(record, new_states(record, start_time), samples=samples, events=events)
        rows[:, :2] = shown
    return Response(
        times, rows[:, 0], rows[:, 1], rows[:, 2], currents * rated_current(record), rows[:, 3],
        rows[:, 4].astype(np.uint8), event_tuple(events, count), rows[:, 6],
        bool(record[0]["pilot_gap"] == 0.0), *rows[:, ROW:].T,
    )  # fmt: skip


def rated_current(record: Any) -> float:
    """The coil current at u = 1, A, of a (1,) VALVE_RECORD."""
    return float(record[0]["reference_voltage"] / record[0]["coil_resistance"])


def run_record(
    record: Any,
    state: Any,
    drive: Drive,
    samples: Samples,
    events: Any,
    tolerance: float = TOLERANCE,
    vary: Any = None,
) -> int:
    """Run the compiled core on prepared arrays, for callers that run it ten thousand times.

    Args:
        record: (1,) VALVE_RECORD. state: (1,) STATE_RECORD, advanced. drive: the commanded voltage.
        samples: what is written down.
        events: (e,) EVENT_RECORD array for the first e events.
        tolerance: relative error of one step.
        vary: what derivatives are carried along, see `sensitivities`; default none.

    Returns:
        how many events there were.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    course = (drive.times, drive.volts, delay_and_end(record, samples)[1])
    return run_course(record, state, course, samples, events, tolerance, vary)


def run_course(
    record: Any, state: Any, course: tuple[Array, Array, float], samples: Samples, events: Any,
    tolerance: float = TOLERANCE, vary: Any = None,
) -> int:  # fmt: skip
    """The same up to a given time: a long run is made of such pieces, each of which ends with a command.

    Args:
        record, state, samples, events, tolerance, vary: as of `run_record`.
        course: times, s, and voltages, V, of the commands; the time of the end, s, of which a command stops the run
            exactly there, so that the next piece goes on as if there were no pieces.

    Raises:
        SimulationError: the run could not be carried to its end.
    """
    times, rows, current_times, currents = samples
    delay, _ = delay_and_end(record, samples)
    run = (
        record, state, course,
        (times - delay if delay else times, rows, current_times, currents),
        events, (tolerance, most_steps(course[2] - state["time"].item())),
    )  # fmt: skip
    count, outcome = driver.run_drive(*run, vary)
    check_outcome(outcome)
    return int(count)


def delay_and_end(record: Any, samples: Samples) -> tuple[float, float]:
    """How late positions are shown, s, and when the last sample is, s.

    Raises:
        SimulationError: the valve has no travel beyond its gap, or a gap below 0.
    """
    gap, stroke, delay = record["pilot_gap"].item(), record["stroke"].item(), record["sensor_delay"].item()
    if not 0.0 <= gap < stroke:
        raise SimulationError(f"the simulation cannot start: pilot_gap {gap:g} m is not inside stroke {stroke:g} m")
    times, _, current_times, _ = samples
    end = max(times[-1] if len(times) else -math.inf, current_times[-1] if len(current_times) else -math.inf)
    return delay, end


def simulate_many(
    valves: Sequence[Valve],
    drive: Drive,
    sample_times: ArrayLike,
    *,
    tolerance: float = TOLERANCE,
    threads: int | None = None,
) -> Array:
    """Pilot plunger positions of many valves under one drive, on several threads.

    Args:
        valves: (k,), all of them with gas, or none.
        drive: the commanded voltage.
        sample_times: (n,) s, ascending.
        tolerance: relative error of one step.
        threads: how many; default all processors.

    Returns:
        (k, n) m, as the position sensor shows it.

    Raises:
        SimulationError: a run could not be carried to its end; it names the set. Or some valves have gas, some none.
    """
    if len({valve.gas is None for valve in valves}) > 1:
        raise SimulationError("some of the valves have gas and some have none; simulate these apart from those")
    times = np.ascontiguousarray(sample_times, dtype=np.float64)
    positions = np.empty((len(valves), len(times)))
    if valves and valves[0].gas is None:
        plans = [valve.plan() for valve in valves]
        for plan in dict.fromkeys(plans):
            rows = [row for row, own in enumerate(plans) if own is plan]
            numbers = np.array([valves[row].numbers() for row in rows])
            positions[rows] = core.run_numbers(
                valves[rows[0]], numbers, drive, times, tolerance=tolerance, threads=threads, names=rows
            )
    elif valves:
        _run_gas(np.concatenate([valve.record() for valve in valves]), drive, times, positions, (tolerance, threads))
    return positions


def _run_gas(records: Any, drive: Drive, times: Array, positions: Array, how: tuple[float, int | None]) -> None:
    """Positions of many valves with gas; arguments as of `simulate_many`."""
    tolerance, threads = how
    states = new_states(records, core.start_of(drive, times))
    workers = threads or os.cpu_count() or 1
    chunks = [chunk for chunk in np.array_split(np.arange(len(records)), workers * 4) if len(chunk)]

    def work(chunk: NDArray[np.int64]) -> tuple[int, int]:
        first, last = int(chunk[0]), int(chunk[-1]) + 1
        return driver.run_batch(  # type: ignore[no-any-return]
            records[first:last], states[first:last], (drive.times, drive.volts), times, positions[first:last],
            (tolerance, most_steps(float(np.ptp(times)))),
        )  # fmt: skip

    with ThreadPoolExecutor(workers) as pool:
        for chunk, (failed, outcome) in zip(chunks, pool.map(work, chunks), strict=True):
            check_outcome(outcome, f"parameter set {int(chunk[0]) + failed}: ")


def check_flux(valve: Valve) -> None:
    """Check that a current follows from the flux of a valve, if its flux is modelled.

    Raises:
        SimulationError: it does not; the message says why.
    """
    if why_not := valve.why_no_flux():
        raise SimulationError(f"the simulation cannot start: {why_not}")


def check_outcome(outcome: int, what: str = "") -> None:
    """Check that a run was carried to its end.

    Raises:
        SimulationError: it was not; the message says why.
    """
    if outcome == Outcome.FINISHED:
        return
    why = {
        Outcome.STEP_TOO_SMALL: "the forces change faster than error control can follow; look for a parameter that is "
        "many orders of magnitude off",
        Outcome.TOO_MANY_STEPS: f"more than {MOST_STEPS_PER_SECOND} steps a second are needed; look for a "
        "time constant that is far below a microsecond",
        Outcome.CHATTERING: "the plungers chatter without progress in time",
        Outcome.FLUX_FOLDS: "motional_emf: no current follows from the flux, which must grow with it; look for a coil "
        "time constant that is too short, or for a saturation that is too strong",
    }
    raise SimulationError(f"{what}the simulation stopped early: {why[Outcome(outcome)]}")
