"""Plant (a), form known: the theory's physics, modes and effects, by classical Runge-Kutta steps of fixed length.

A step never straddles a command or a sample, and one that crosses a contact, a turn of the velocity or the breaking
of a rest is cut there by bisection of the step itself, to a few femtoseconds. Nothing here comes from the package.

Where the paper and the catalogue leave a choice:

- drive_gain multiplies u's target, so the measured current and the heat show it.
- residual_magnetism is a floor under the u behind eddy_lag and before magnetic_saturation; `largest abs(u) so far` is
  the coil current's.
- friction holds at every rest (seat, gap, stop, in mid travel) and has no say in whether a contact is a GAP_HOLD.
- a rebound at the seat leaves x = 0 anew, so pressure_force starts again from there.
- squeeze_film and the main plunger's displacement see the contacts where stroke_offset and gap_offset have put them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from math import inf

import numpy as np

from .common import CATALOGUE, FloatArray, PlantEvent, PlantRun, check_effects, compiled, compiled_entry

# The paper's valve with the two corrections of docs/theory/paper.md that make both published event times come out.
CAMPAIGN_VALVE: dict[str, float | tuple[float, float, float, float]] = {
    "pilot_mass": 0.109,
    "moving_mass": 0.134,
    "pilot_damping": 1.0,
    "main_damping": 4.0,
    "spring_rate": 428.0,
    "spring_preload": 2.524,
    "attraction_polynomial": (3.0336, 17.096e3, -30.931e6, 24.026e9),
    "pilot_gap": 0.26e-3,
    "stroke": 1.23e-3,
    "reference_voltage": 9.0,
    "coil_time_constant": 0.9934e-3,
    "coil_resistance": 10.0,
    "seat_load": 0.0,
    "pickup_velocity_ratio": 1.0,
}

# Disturbances that the catalogue does not hold, with the parameters of each.
UNCATALOGUED: dict[str, tuple[str, ...]] = {
    # N, m, m: amplitude * exp(-((x - centre) / width)^2), in both phases
    "force_bump": ("amplitude", "centre", "width"),
    # N, m, rad: amplitude * sin(2 pi x / wavelength + phase), in both phases
    "force_ripple": ("amplitude", "wavelength", "phase"),
    # N, Hz, rad: amplitude * sin(2 pi frequency t + phase), always, so it rattles an unloaded pilot on its seat
    "vibration": ("amplitude", "frequency", "phase"),
    # N s/m per s: extra viscous damping rate * t, in both phases
    "damping_drift": ("rate",),
    # N s/m, m, m: extra viscous damping amplitude * exp(-((x - centre) / width)^2), in both phases
    "damping_bump": ("amplitude", "centre", "width"),
}

CLOSED, PILOT, GAP_HOLD, MAIN, OPEN = range(5)
EVENT_KINDS = (
    "unseated",
    "picked_up",
    "opened",
    "released",
    "main_seated",
    "seated",
    "held_at_gap",
    "dropped_from_gap",
    "lifted_from_gap",
    "stop_rebound",
    "seat_rebound",
    "stuck",
    "freed",
)
(
    UNSEATED,
    PICKED_UP,
    OPENED,
    RELEASED,
    MAIN_SEATED,
    SEATED,
    HELD_AT_GAP,
    DROPPED_FROM_GAP,
    LIFTED_FROM_GAP,
    STOP_REBOUND,
    SEAT_REBOUND,
    STUCK,
    FREED,
) = range(13)
NO_EVENT = -1

# Places in the packed parameter array that the compiled code reads.
(
    PILOT_MASS,
    MOVING_MASS,
    PILOT_DAMPING,
    MAIN_DAMPING,
    SPRING_RATE,
    SPRING_PRELOAD,
    A0,
    A1,
    A2,
    A3,
    GAP,
    STROKE,
    REFERENCE_VOLTAGE,
    COIL_TIME_CONSTANT,
    SEAT_LOAD,
    PICKUP_RATIO,
    COULOMB_OPENING,
    COULOMB_CLOSING,
    BREAKAWAY,
    STRIBECK_VELOCITY,
    DAMPING_OPENING,
    DAMPING_CLOSING,
    CONSTANT_FORCE,
    DRIVE_GAIN,
    EDDY_TIME_CONSTANT,
    TEMPERATURE_RATE,
    COOLING_RATE,
    SATURATION_CURRENT,
    RESIDUAL_CURRENT,
    PRESSURE_FORCE,
    EQUALISATION_TIME,
    QUADRATIC_DRAG,
    FILM_COEFFICIENT,
    FILM_THICKNESS,
    RESTITUTION_STOP,
    RESTITUTION_SEAT,
    SPRING_HARDENING,
    SENSOR_RATE,
    BUMP_FORCE,
    BUMP_CENTRE,
    BUMP_WIDTH,
    RIPPLE_FORCE,
    RIPPLE_NUMBER,
    RIPPLE_PHASE,
    VIBRATION_FORCE,
    VIBRATION_RATE,
    VIBRATION_PHASE,
    DAMPING_DRIFT,
    DAMPING_BUMP,
    DAMPING_BUMP_CENTRE,
    DAMPING_BUMP_WIDTH,
    STEP,
) = range(52)
PARAMETER_COUNT = 52

COPPER = 0.00393  # 1/K, IEC 60028: theory, eq. (10)
SEAT_HOLDS = 1e-9  # N: no smaller net force lifts the pilot off its seat
SLOW_CONTACT = 1e-3  # m/s: theory, eq. (14)
SLOWEST_REBOUND = 5e-3  # m/s: theory, eq. (15)
BISECTIONS = 30  # of a 2 µs step: 2 fs

State = tuple[float, float, float, float, float, float, float]  # x, v, u, eddy u, temperature, seen pilot, seen main
Moment = tuple[float, float, float, float]  # t, commanded V, largest abs(u) so far, time when x = 0 was last left
Condition = tuple[int, int, int]  # mode, 1 when stuck in mid travel, direction of motion (friction's sign)


@compiled
def _coil_current(state: State, volts: float, p: FloatArray) -> float:
    if p[COIL_TIME_CONSTANT] > 0.0:
        return float(state[2])
    return float(p[DRIVE_GAIN] * volts / (p[REFERENCE_VOLTAGE] * (1.0 + COPPER * state[4])))


@compiled
def _pulling_current(state: State, current: float, p: FloatArray) -> float:
    if p[EDDY_TIME_CONSTANT] > 0.0:
        return float(state[3])
    return float(current)


@compiled
def _attraction(x: float, current: float, pulling: float, largest: float, p: FloatArray) -> float:
    pulling = abs(pulling)
    if p[RESIDUAL_CURRENT] > 0.0:
        pulling = max(pulling, p[RESIDUAL_CURRENT] * min(1.0, max(largest, abs(current))))
    square = pulling * pulling
    if p[SATURATION_CURRENT] > 0.0:
        knee = p[SATURATION_CURRENT] ** 2
        square *= (1.0 + 1.0 / knee) / (1.0 + square / knee)
    return float(square * (p[A0] + x * (p[A1] + x * (p[A2] + x * p[A3]))))


@compiled
def _fluid(x: float, v: float, p: FloatArray) -> float:
    force = -p[QUADRATIC_DRAG] * v * abs(v)
    if p[FILM_COEFFICIENT] != 0.0:
        film = p[FILM_THICKNESS]
        force -= p[FILM_COEFFICIENT] * v * ((film / (x + film)) ** 3 + (film / (p[STROKE] - x + film)) ** 3)
    return float(force)


@compiled
def _disturbance(t: float, x: float, v: float, p: FloatArray) -> float:
    force = -p[DAMPING_DRIFT] * t * v
    if p[BUMP_FORCE] != 0.0:
        force += p[BUMP_FORCE] * np.exp(-(((x - p[BUMP_CENTRE]) / p[BUMP_WIDTH]) ** 2))
    if p[RIPPLE_FORCE] != 0.0:
        force += p[RIPPLE_FORCE] * np.sin(p[RIPPLE_NUMBER] * x + p[RIPPLE_PHASE])
    if p[VIBRATION_FORCE] != 0.0:
        force += p[VIBRATION_FORCE] * np.sin(p[VIBRATION_RATE] * t + p[VIBRATION_PHASE])
    if p[DAMPING_BUMP] != 0.0:
        force -= v * p[DAMPING_BUMP] * np.exp(-(((x - p[DAMPING_BUMP_CENTRE]) / p[DAMPING_BUMP_WIDTH]) ** 2))
    return float(force)


@compiled
def _load(phase: int, moment: Moment, x: float, v: float, p: FloatArray) -> float:
    if phase == 1:
        return float(p[SEAT_LOAD] + p[PILOT_DAMPING] * v)
    load = p[SPRING_PRELOAD] + p[SPRING_RATE] * x + p[SPRING_HARDENING] * x**3 + p[MAIN_DAMPING] * v
    if p[PRESSURE_FORCE] != 0.0:
        load += p[PRESSURE_FORCE] * np.exp(-(moment[0] - moment[3]) / p[EQUALISATION_TIME])
    return float(load)


@compiled
def _net(phase: int, moment: Moment, state: State, v: float, p: FloatArray) -> float:
    """Net force of the Phase 1 or Phase 2 equation at velocity v, without friction."""
    x = state[0]
    current = _coil_current(state, moment[1], p)
    pull = _attraction(x, current, _pulling_current(state, current, p), moment[2], p)
    others = p[CONSTANT_FORCE] + _fluid(x, v, p) + _disturbance(moment[0], x, v, p)
    return float(pull + others - _load(phase, moment, x, v, p))


@compiled
def _holding(direction: int, p: FloatArray) -> float:
    return float((p[COULOMB_OPENING] if direction > 0 else p[COULOMB_CLOSING]) + p[BREAKAWAY])


@compiled
def _friction(v: float, direction: int, p: FloatArray) -> float:
    if direction > 0:
        level, damping = p[COULOMB_OPENING], p[DAMPING_OPENING]
    else:
        level, damping = p[COULOMB_CLOSING], p[DAMPING_CLOSING]
    if p[BREAKAWAY] != 0.0:
        level += p[BREAKAWAY] * np.exp(-((v / p[STRIBECK_VELOCITY]) ** 2))
    return float(-direction * level - damping * v)


@compiled
def _rates(moment: Moment, state: State, condition: Condition, p: FloatArray) -> State:
    x, v, _, eddy, temperature, seen_pilot, seen_main = state
    mode, stuck, direction = condition
    current = _coil_current(state, moment[1], p)
    x_rate = v_rate = u_rate = eddy_rate = 0.0
    if mode in (PILOT, MAIN) and stuck == 0:
        phase, mass = (1, p[PILOT_MASS]) if mode == PILOT else (2, p[MOVING_MASS])
        x_rate = v
        v_rate = (_net(phase, moment, state, v, p) + _friction(v, direction, p)) / mass
    if p[COIL_TIME_CONSTANT] > 0.0:
        # (target / r - u) / (tau / r) with r = R / R0
        target = p[DRIVE_GAIN] * moment[1] / p[REFERENCE_VOLTAGE]
        u_rate = (target - (1.0 + COPPER * temperature) * current) / p[COIL_TIME_CONSTANT]
    if p[EDDY_TIME_CONSTANT] > 0.0:
        eddy_rate = (current - eddy) / p[EDDY_TIME_CONSTANT]
    heat = p[TEMPERATURE_RATE] * current * current - p[COOLING_RATE] * temperature
    lag = p[SENSOR_RATE]
    main = max(0.0, x - p[GAP])
    return (x_rate, v_rate, u_rate, eddy_rate, heat, lag * (x - seen_pilot), lag * (main - seen_main))


@compiled
def _moved(state: State, rate: State, dt: float) -> State:
    return (
        state[0] + dt * rate[0],
        state[1] + dt * rate[1],
        state[2] + dt * rate[2],
        state[3] + dt * rate[3],
        state[4] + dt * rate[4],
        state[5] + dt * rate[5],
        state[6] + dt * rate[6],
    )


@compiled
def _later(moment: Moment, dt: float) -> Moment:
    return (moment[0] + dt, moment[1], moment[2], moment[3])


@compiled
def _stepped(moment: Moment, state: State, dt: float, condition: Condition, p: FloatArray) -> State:
    """One classical Runge-Kutta step."""
    half = 0.5 * dt
    rate1 = _rates(moment, state, condition, p)
    rate2 = _rates(_later(moment, half), _moved(state, rate1, half), condition, p)
    rate3 = _rates(_later(moment, half), _moved(state, rate2, half), condition, p)
    rate4 = _rates(_later(moment, dt), _moved(state, rate3, dt), condition, p)
    moved = _moved(_moved(state, rate1, dt / 6.0), rate2, dt / 3.0)
    return _moved(_moved(moved, rate3, dt / 3.0), rate4, dt / 6.0)


@compiled
def _freed(moment: Moment, state: State, condition: Condition, p: FloatArray) -> int:
    """Direction in which a valve at rest begins to move, 0 while it is held."""
    mode = condition[0]
    if mode != OPEN:
        upward = _net(1 if mode in (CLOSED, PILOT) else 2, moment, state, 0.0, p)
        held = _holding(1, p)
        if upward > (max(held, SEAT_HOLDS) if mode == CLOSED else held):
            return 1
    if mode != CLOSED:
        downward = _net(1 if mode in (PILOT, GAP_HOLD) else 2, moment, state, 0.0, p)
        if downward < -_holding(-1, p):
            return -1
    return 0


@compiled
def _at_rest(condition: Condition) -> bool:
    return condition[1] == 1 or condition[0] in (CLOSED, GAP_HOLD, OPEN)


@compiled
def _switches(moment: Moment, state: State, condition: Condition, p: FloatArray) -> bool:
    """Whether this state lies beyond the end of its condition."""
    if _at_rest(condition):
        return _freed(moment, state, condition, p) != 0
    x, v = state[0], state[1]
    if condition[2] * v < 0.0:
        return True
    if condition[0] == PILOT:
        return x < 0.0 or x > p[GAP]
    return bool(x < p[GAP] or x > p[STROKE])


@compiled
def _released(condition: Condition, direction: int) -> tuple[Condition, int]:
    """Condition after a rest has been broken, and the event that it is."""
    mode = condition[0]
    if mode == CLOSED:
        return (PILOT, 0, 1), UNSEATED
    if mode == OPEN:
        return (MAIN, 0, -1), RELEASED
    if mode == GAP_HOLD:
        if direction > 0:
            return (MAIN, 0, 1), LIFTED_FROM_GAP
        return (PILOT, 0, -1), DROPPED_FROM_GAP
    return (mode, 0, direction), FREED


@compiled
def _placed(state: State, x: float, v: float) -> State:
    return (x, v, state[2], state[3], state[4], state[5], state[6])


@compiled
def _end_contact(state: State, mode: int, p: FloatArray) -> tuple[State, Condition, int]:
    """Seat or stop: rebound or rest."""
    v = state[1]
    if mode == MAIN:
        if p[RESTITUTION_STOP] > 0.0 and abs(v) >= SLOWEST_REBOUND:
            return _placed(state, p[STROKE], -p[RESTITUTION_STOP] * v), (MAIN, 0, -1), STOP_REBOUND
        return _placed(state, p[STROKE], 0.0), (OPEN, 0, -1), OPENED
    if p[RESTITUTION_SEAT] > 0.0 and abs(v) >= SLOWEST_REBOUND:
        return _placed(state, 0.0, -p[RESTITUTION_SEAT] * v), (PILOT, 0, 1), SEAT_REBOUND
    return _placed(state, 0.0, 0.0), (CLOSED, 0, 1), SEATED


@compiled
def _gap_contact(moment: Moment, state: State, mode: int, p: FloatArray) -> tuple[State, Condition, int]:
    """Pick-up from below, seating of the main plunger from above, or a hold in between."""
    v = state[1]
    touching = _placed(state, p[GAP], 0.0)
    if abs(v) < SLOW_CONTACT and _net(1, moment, touching, 0.0, p) > 0.0 and _net(2, moment, touching, 0.0, p) <= 0.0:
        return touching, (GAP_HOLD, 0, 1), HELD_AT_GAP
    if mode == PILOT:
        return _placed(state, p[GAP], p[PICKUP_RATIO] * v), (MAIN, 0, 1), PICKED_UP
    return _placed(state, p[GAP], v), (PILOT, 0, -1), MAIN_SEATED


@compiled
def _turned(moment: Moment, state: State, condition: Condition, p: FloatArray) -> tuple[State, Condition, int]:
    """Velocity came to 0 in mid travel: stick, or go back."""
    standing = _placed(state, state[0], 0.0)
    mode = condition[0]
    direction = _freed(moment, standing, (mode, 1, condition[2]), p)
    if direction == 0:
        return standing, (mode, 1, condition[2]), STUCK
    return standing, (mode, 0, direction), NO_EVENT


@compiled
def _switched(moment: Moment, state: State, condition: Condition, p: FloatArray) -> tuple[State, Condition, int]:
    """State and condition after the switch that `_switches` has found."""
    if _at_rest(condition):
        condition, kind = _released(condition, _freed(moment, state, condition, p))
        return state, condition, kind
    mode, x = condition[0], state[0]
    if (mode == PILOT and x > p[GAP]) or (mode == MAIN and x < p[GAP]):
        return _gap_contact(moment, state, mode, p)
    if x < 0.0 or x > p[STROKE]:
        return _end_contact(state, mode, p)
    return _turned(moment, state, condition, p)


@compiled
def _cut(moment: Moment, state: State, dt: float, condition: Condition, p: FloatArray) -> float:
    """Length of the part of this step that ends just beyond its first switch."""
    before, beyond = 0.0, dt
    for _ in range(BISECTIONS):
        middle = 0.5 * (before + beyond)
        trial = _stepped(moment, state, middle, condition, p)
        if _switches(_later(moment, middle), trial, condition, p):
            beyond = middle
        else:
            before = middle
    return beyond


@compiled
def _next(times: FloatArray, index: int) -> float:
    return float(times[index] if index < times.size else np.inf)


@compiled_entry
def _run(
    command_times: FloatArray,
    command_volts: FloatArray,
    position_times: FloatArray,
    current_times: FloatArray,
    p: FloatArray,
) -> tuple[FloatArray, FloatArray, list[tuple[float, int, float, float]]]:
    """Positions (n, 3: seen pilot, seen main, velocity), u (n,) and the events."""
    positions = np.zeros((position_times.size, 3))
    currents = np.zeros(current_times.size)
    events = [(0.0, NO_EVENT, 0.0, 0.0)]
    state = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    condition = (CLOSED, 0, 1)
    moment = (0.0, 0.0, 0.0, 0.0)
    command = position = current = 0
    while True:
        t, _, largest, opened_at = moment
        while _next(command_times, command) <= t:
            moment = (t, command_volts[command], largest, opened_at)
            command += 1
        while _next(position_times, position) <= t:
            seen = p[SENSOR_RATE] > 0.0
            positions[position, 0] = state[5] if seen else state[0]
            positions[position, 1] = state[6] if seen else max(0.0, state[0] - p[GAP])
            positions[position, 2] = state[1]
            position += 1
        while _next(current_times, current) <= t:
            currents[current] = _coil_current(state, moment[1], p)
            current += 1
        if position == position_times.size and current == current_times.size:
            return positions, currents, events
        stop = min(_next(command_times, command), _next(position_times, position), _next(current_times, current))
        pieces = max(1.0, np.ceil((stop - t) / p[STEP] - 1e-6))
        dt = (stop - t) / pieces
        if _at_rest(condition) and _switches(moment, state, condition, p):
            dt = 0.0  # a command with no lag behind it frees the valve at once
            trial, switches = state, True
        else:
            trial = _stepped(moment, state, dt, condition, p)
            switches = _switches(_later(moment, dt), trial, condition, p)
            if switches:
                dt = _cut(moment, state, dt, condition, p)
                trial = _stepped(moment, state, dt, condition, p)
        t = stop if pieces == 1.0 and not switches else t + dt
        largest = max(largest, abs(_coil_current(trial, moment[1], p)))
        moment = (t, moment[1], largest, opened_at)
        if switches:
            state, condition, kind = _switched(moment, trial, condition, p)
            if kind in (UNSEATED, SEAT_REBOUND):
                moment = (t, moment[1], largest, t)
            if kind != NO_EVENT:
                events.append((t, kind, trial[0], trial[1]))
        else:
            state = trial


def _packed(
    valve: Mapping[str, float | tuple[float, float, float, float]],
    effects: Mapping[str, Mapping[str, float]],
    step: float,
) -> FloatArray:
    """The array that the compiled code reads; effects that are off get the value that changes nothing."""

    def given(effect: str, parameter: str, off: float = 0.0) -> float:
        return effects[effect][parameter] if effect in effects else off

    values = {**_declared_values(valve, given), **_values_of_effects(given), STEP: step}
    return np.array([values[place] for place in range(PARAMETER_COUNT)], dtype=np.float64)


def _declared_values(
    valve: Mapping[str, float | tuple[float, float, float, float]], given: Callable[..., float]
) -> dict[int, float]:
    """What is declared, with what effects add to it."""

    def plain(name: str) -> float:
        return float(np.asarray(valve[name]))

    polynomial = np.asarray(valve["attraction_polynomial"], dtype=np.float64)
    return {
        PILOT_MASS: plain("pilot_mass"),
        MOVING_MASS: plain("moving_mass"),
        PILOT_DAMPING: plain("pilot_damping"),
        MAIN_DAMPING: plain("main_damping"),
        SPRING_RATE: plain("spring_rate"),
        SPRING_PRELOAD: plain("spring_preload"),
        A0: polynomial[0] + given("rest_attraction", "force"),
        A1: polynomial[1],
        A2: polynomial[2],
        A3: polynomial[3],
        GAP: plain("pilot_gap") + given("gap_offset", "offset"),
        STROKE: plain("stroke") + given("stroke_offset", "offset"),
        REFERENCE_VOLTAGE: plain("reference_voltage"),
        COIL_TIME_CONSTANT: plain("coil_time_constant") + given("coil_lag", "time_constant"),
        SEAT_LOAD: plain("seat_load"),
        PICKUP_RATIO: given("pickup_impact", "velocity_ratio", plain("pickup_velocity_ratio")),
    }


def _values_of_effects(given: Callable[..., float]) -> dict[int, float]:
    """What effects have of their own."""
    coulomb = given("coulomb_friction", "force") + given("stiction", "force")
    return {
        COULOMB_OPENING: coulomb + given("asymmetric_friction", "force_opening"),
        COULOMB_CLOSING: coulomb + given("asymmetric_friction", "force_closing"),
        BREAKAWAY: given("stiction", "breakaway"),
        STRIBECK_VELOCITY: given("stiction", "stribeck_velocity", 1.0),
        DAMPING_OPENING: given("asymmetric_friction", "damping_opening"),
        DAMPING_CLOSING: given("asymmetric_friction", "damping_closing"),
        CONSTANT_FORCE: given("constant_force", "force"),
        DRIVE_GAIN: given("drive_gain", "gain", 1.0),
        EDDY_TIME_CONSTANT: given("eddy_lag", "time_constant"),
        TEMPERATURE_RATE: given("coil_heating", "temperature_rate"),
        COOLING_RATE: 1.0 / given("coil_heating", "cooling_time_constant", inf),
        SATURATION_CURRENT: given("magnetic_saturation", "current"),
        RESIDUAL_CURRENT: given("residual_magnetism", "current"),
        PRESSURE_FORCE: given("pressure_force", "force"),
        EQUALISATION_TIME: given("pressure_force", "equalisation_time", 1.0),
        QUADRATIC_DRAG: given("quadratic_drag", "coefficient"),
        FILM_COEFFICIENT: given("squeeze_film", "coefficient"),
        FILM_THICKNESS: given("squeeze_film", "film_thickness", 1.0),
        RESTITUTION_STOP: given("stop_bounce", "restitution_stop"),
        RESTITUTION_SEAT: given("stop_bounce", "restitution_seat"),
        SPRING_HARDENING: given("spring_hardening", "coefficient"),
        SENSOR_RATE: 2.0 * np.pi * given("sensor_bandwidth", "cutoff_frequency"),
        BUMP_FORCE: given("force_bump", "amplitude"),
        BUMP_CENTRE: given("force_bump", "centre"),
        BUMP_WIDTH: given("force_bump", "width", 1.0),
        RIPPLE_FORCE: given("force_ripple", "amplitude"),
        RIPPLE_NUMBER: 2.0 * np.pi / given("force_ripple", "wavelength", inf),
        RIPPLE_PHASE: given("force_ripple", "phase"),
        VIBRATION_FORCE: given("vibration", "amplitude"),
        VIBRATION_RATE: 2.0 * np.pi * given("vibration", "frequency"),
        VIBRATION_PHASE: given("vibration", "phase"),
        DAMPING_DRIFT: given("damping_drift", "rate"),
        DAMPING_BUMP: given("damping_bump", "amplitude"),
        DAMPING_BUMP_CENTRE: given("damping_bump", "centre"),
        DAMPING_BUMP_WIDTH: given("damping_bump", "width", 1.0),
    }


@dataclass(frozen=True)
class DeclaredPlant:
    """A valve with effects of the catalogue and disturbances that no catalogue holds.

    `parameters` replaces entries of CAMPAIGN_VALVE; `effects` holds names of CATALOGUE and UNCATALOGUED; `step` is the
    longest step in s. An unknown name raises ValueError.
    """

    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    parameters: Mapping[str, float | tuple[float, float, float, float]] = field(default_factory=dict)
    step: float = 2e-6

    def __post_init__(self) -> None:
        """Refuse names that would be ignored silently."""
        check_effects(self.effects, CATALOGUE | UNCATALOGUED)
        if unknown := set(self.parameters) - set(CAMPAIGN_VALVE):
            raise ValueError(f"parameters {sorted(unknown)}: known are {list(CAMPAIGN_VALVE)}")

    def simulate(self, command_times: FloatArray, volts: FloatArray, sample_times: FloatArray) -> PlantRun:
        """Drive from rest at time 0: command times (k,) s, volts (k,), sample times (n,) s, both ascending."""
        valve = CAMPAIGN_VALVE | dict(self.parameters)
        times = np.asarray(sample_times, dtype=np.float64)
        delay = self.effects.get("sensor_delay", {}).get("delay", 0.0)
        gain = self.effects.get("sensor_gain", {}).get("gain", 1.0)
        positions, currents, events = _run(
            np.asarray(command_times, dtype=np.float64),
            np.asarray(volts, dtype=np.float64),
            times - delay,
            times,
            _packed(valve, self.effects, self.step),
        )
        reference_current = float(np.asarray(valve["reference_voltage"])) / float(np.asarray(valve["coil_resistance"]))
        return PlantRun(
            times,
            gain * positions[:, 0],
            gain * positions[:, 1],
            positions[:, 2].copy(),
            reference_current * currents,
            tuple(PlantEvent(time, EVENT_KINDS[kind], x, v) for time, kind, x, v in events[1:]),
        )
