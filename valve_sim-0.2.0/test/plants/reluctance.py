"""Plant (c), formed in yet another way: a valve as an engineer would model it from its magnetic circuit.

The pull is that of a reluctance, k w^2 / (d - x)^2, where w follows the coil's current through an eddy-current pole
that slows down as the gap closes. Friction is LuGre, one bristle on the pilot. A pressure holds the main plunger down:
it equalises while the pilot is open, is drawn down again by the demand behind the valve once that has closed, and then
leaks away slowly through the seat. A light return spring acts on the pilot in both phases. Contacts are impacts with a
coefficient; pilot and main plunger meet plastically, with their momentum.

Third-order steps of Bogacki and Shampine, of fixed length, ended by false position where a contact closes or a rest
breaks. Nothing here comes from the package, nor from the other plants but the names of effects.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from .common import CATALOGUE, FloatArray, PlantEvent, PlantRun, check_effects, compiled, compiled_entry
from .declared import CAMPAIGN_VALVE
from .tolerances import Entries

# pickup_impact is not among them: two masses collide here.
EFFECTS = {name: names for name, names in CATALOGUE.items() if name != "pickup_impact"}

SEATED, PILOT, HELD, LIFTED, OPEN = range(5)
X, V, CURRENT, FLUX, BRISTLE, HOT, PRESSURE, DEMAND, EXTRA, SEEN_PILOT, SEEN_MAIN = range(11)
STATE_COUNT = 11
KINDS = ("unseated", "picked_up", "opened", "released", "main_seated", "seated", "held_at_gap", "left_gap", "rebound")
UNSEATED, PICKED_UP, OPENED, RELEASED, MAIN_SEATED, SEATED_AGAIN, HELD_AT_GAP, LEFT_GAP, REBOUND = range(9)

COPPER = 0.00393  # 1/K
SLOW, SLOWEST_REBOUND = 1e-3, 5e-3  # m/s
LIFT_OPEN = 30e-6  # m of pilot lift at which the orifice equalises fully
FALSE_POSITIONS = 60


class Build(NamedTuple):
    """The valve as built, SI. Forces are at the reference current, where u = 1."""

    pilot_mass: float = 0.109
    main_mass: float = 0.025
    pilot_damping: float = 1.2
    main_damping: float = 2.6
    spring_rate: float = 430.0
    spring_preload: float = 2.5
    return_force: float = 0.25
    pilot_gap: float = 0.26e-3
    stroke: float = 1.23e-3
    coil_time_constant: float = 1.2e-3
    reluctance_force: float = 2.592e-5  # N m^2: k
    reluctance_gap: float = 2.4e-3  # m: d, to a gap that never closes
    eddy_time_constant: float = 0.06e-3  # of the widest gap
    friction: float = 0.02
    breakaway: float = 0.01
    stribeck_velocity: float = 0.01
    bristle_deflection: float = 2e-6
    pressure: float = 0.15  # N on the main plunger
    pressure_at_rest: float = 0.2  # of that, before the first stroke
    equalisation_time: float = 3e-3
    drawdown_time: float = 15e-3
    leak_time: float = 0.15
    demand_time: float = 20e-3
    sensor_cutoff: float = 5000.0  # Hz; 0: ideal
    reference_voltage: float = 9.0
    coil_resistance: float = 10.0


# The data sheet of that valve, rounded, but for the attraction, which is measured at rest (`static_table`). Springs are
# given as one force in Phase 2; the dampings are guesses, for a fit to find.
DATA_SHEET: Entries = {
    **CAMPAIGN_VALVE,
    "spring_rate": 430.0,
    "spring_preload": 2.75,
    "seat_load": 0.25,
    "coil_time_constant": 1.2e-3,
    "pickup_velocity_ratio": 0.81,
}
TABLE_STEP, TABLE_END = 0.05e-3, 1.2e-3  # m
LOAD_CELL, STAGE = 0.05, 2e-6  # N and m: one standard deviation of each reading


AS_BUILT = Build()


class _Packed(NamedTuple):
    """What the compiled code reads: the build, and effects with values that change nothing where they are off."""

    build: Build
    gap: float
    stroke: float
    coil: float
    rest_attraction: float
    drive: float
    eddy_extra: float
    heating: float
    cooling: float
    knee: float
    floor: float
    level_opening: float
    level_closing: float
    breakaway: float
    stribeck: float
    damping_opening: float
    damping_closing: float
    constant: float
    extra_pressure: float
    extra_time: float
    drag: float
    film: float
    film_thickness: float
    at_stop: float
    at_seat: float
    hardening: float
    sensor_rate: float


@compiled
def _pull(s: FloatArray, largest: float, p: _Packed) -> float:
    w = abs(s[FLUX])
    if p.floor > 0.0:
        w = max(w, p.floor * min(1.0, largest))
    square = w * w
    if p.knee > 0.0:
        square *= (1.0 + 1.0 / p.knee**2) / (1.0 + square / p.knee**2)
    return float(square * (p.build.reluctance_force / (p.build.reluctance_gap - s[X]) ** 2 + p.rest_attraction))


@compiled
def _net(is_lifted: bool, s: FloatArray, largest: float, p: _Packed) -> float:
    """Of pilot alone or with the main plunger, without bristles, N."""
    x, v = s[X], s[V]
    force = _pull(s, largest, p) - p.build.return_force + p.constant - p.build.pilot_damping * v - p.drag * v * abs(v)
    force -= v * (p.damping_opening if v > 0.0 else p.damping_closing)
    if p.film > 0.0:
        below, above = p.film_thickness / (x + p.film_thickness), p.film_thickness / (p.stroke - x + p.film_thickness)
        force -= p.film * v * (below**3 + above**3)
    if is_lifted:
        force -= p.build.spring_preload + p.build.spring_rate * x + p.hardening * x**3 + p.build.main_damping * v
        force -= p.build.pressure * s[PRESSURE] + p.extra_pressure * s[EXTRA]
    return float(force)


@compiled
def _bristle(z: float, v: float, p: _Packed) -> tuple[float, float]:
    """LuGre friction, N, and the bristle's rate, m/s."""
    level = p.level_opening if v > 0.0 else p.level_closing
    highest = max(p.level_opening, p.level_closing) + p.breakaway
    if highest <= 0.0:
        return 0.0, 0.0
    stiffness = highest / p.build.bristle_deflection
    steady = level + p.breakaway * np.exp(-((v / p.stribeck) ** 2))
    rate = v - stiffness * abs(v) / max(steady, 1e-9) * z
    return -stiffness * z - 0.5 * rate * np.exp(-((v / p.stribeck) ** 2)), rate


@compiled
def _rates(mode: int, s: FloatArray, volts: float, largest: float, p: _Packed, out: FloatArray) -> None:
    out[:] = 0.0
    if mode in (PILOT, LIFTED):
        mass = p.build.pilot_mass + (p.build.main_mass if mode == LIFTED else 0.0)
        friction, out[BRISTLE] = _bristle(s[BRISTLE], s[V], p)
        out[X], out[V] = s[V], (_net(mode == LIFTED, s, largest, p) + friction) / mass
    hot = 1.0 + COPPER * s[HOT]
    out[CURRENT] = (p.drive * volts / p.build.reference_voltage - hot * s[CURRENT]) / p.coil
    closing = p.build.reluctance_gap / (p.build.reluctance_gap - s[X])
    eddy = p.build.eddy_time_constant * closing + p.eddy_extra
    # Without eddy currents the flux is the current's.
    out[FLUX] = (s[CURRENT] - s[FLUX]) / eddy if eddy > 0.0 else out[CURRENT]
    out[HOT] = p.heating * s[CURRENT] ** 2 - p.cooling * s[HOT]
    lift = min(1.0, max(0.0, s[X] / LIFT_OPEN))
    falling = (1.0 - s[PRESSURE]) * s[DEMAND] * (1.0 - lift) / p.build.drawdown_time
    out[PRESSURE] = falling - s[PRESSURE] * (lift / p.build.equalisation_time + 1.0 / p.build.leak_time)
    out[DEMAND] = (lift - s[DEMAND]) / p.build.demand_time
    out[EXTRA] = (1.0 - s[EXTRA]) * (1.0 - lift) / 0.5e-3 - s[EXTRA] * lift / p.extra_time
    out[SEEN_PILOT] = p.sensor_rate * (s[X] - s[SEEN_PILOT])
    out[SEEN_MAIN] = p.sensor_rate * (max(0.0, s[X] - p.gap) - s[SEEN_MAIN])


@compiled
def _stepped(
    mode: int, s: FloatArray, dt: float, volts: float, largest: float, p: _Packed, work: FloatArray
) -> FloatArray:
    """One step of Bogacki and Shampine's third-order method."""
    _rates(mode, s, volts, largest, p, work[0])
    _rates(mode, s + 0.5 * dt * work[0], volts, largest, p, work[1])
    _rates(mode, s + 0.75 * dt * work[1], volts, largest, p, work[2])
    return s + dt * (2.0 / 9.0 * work[0] + 1.0 / 3.0 * work[1] + 4.0 / 9.0 * work[2])


@compiled
def _margin(mode: int, s: FloatArray, largest: float, p: _Packed) -> float:
    """Positive while the mode lasts: distance to the nearer contact in m, or the force that holds a rest, N."""
    if mode == PILOT:
        return float(min(s[X], p.gap - s[X]))
    if mode == LIFTED:
        return float(min(s[X] - p.gap, p.stroke - s[X]))
    if mode == SEATED:
        return -_net(False, s, largest, p)
    if mode == OPEN:
        return _net(True, s, largest, p)
    return min(-_net(True, s, largest, p), _net(False, s, largest, p))


@compiled
def _rebounded(wall: float, coefficient: float, s: FloatArray) -> bool:
    """Whether a rigid wall throws the plunger back; sets position and velocity."""
    s[X], s[V] = wall, -coefficient * s[V]
    if abs(s[V]) > SLOWEST_REBOUND:
        return True
    s[V] = s[BRISTLE] = 0.0
    return False


@compiled
def _met_at_gap(mode: int, s: FloatArray, largest: float, p: _Packed) -> tuple[int, int]:
    """Pilot and main plunger meet or part; sets position and velocity."""
    s[X] = p.gap
    speed = s[V]
    s[V] = 0.0
    if abs(speed) < SLOW and _net(False, s, largest, p) > 0.0 and _net(True, s, largest, p) <= 0.0:
        return HELD, HELD_AT_GAP
    if mode == LIFTED:
        s[V] = speed
        return PILOT, MAIN_SEATED
    s[V] = speed * p.build.pilot_mass / (p.build.pilot_mass + p.build.main_mass)
    return LIFTED, PICKED_UP


@compiled
def _switched(mode: int, s: FloatArray, largest: float, p: _Packed) -> tuple[int, int]:
    """The mode that follows, and what happened; sets position and velocity."""
    follows, kind = LIFTED, RELEASED
    if mode == SEATED:
        follows, kind = PILOT, UNSEATED
    elif mode == HELD:
        follows, kind = (LIFTED if _net(True, s, largest, p) > 0.0 else PILOT), LEFT_GAP
    elif mode == PILOT and s[X] < 0.5 * p.gap:
        follows, kind = (PILOT, REBOUND) if _rebounded(0.0, p.at_seat, s) else (SEATED, SEATED_AGAIN)
    elif mode == LIFTED and s[X] > 0.5 * (p.gap + p.stroke):
        follows, kind = (LIFTED, REBOUND) if _rebounded(p.stroke, p.at_stop, s) else (OPEN, OPENED)
    elif mode != OPEN:
        follows, kind = _met_at_gap(mode, s, largest, p)
    return follows, kind


@compiled
def _is_over(mode: int, s: FloatArray, largest: float, p: _Packed) -> bool:
    return _margin(mode, s, largest, p) < 0.0


@compiled
def _cut(mode: int, s: FloatArray, dt: float, volts: float, largest: float, p: _Packed, work: FloatArray) -> float:
    """Length of the part of a step after which its mode is just over."""
    before, beyond = 0.0, dt
    margin_before = max(0.0, _margin(mode, s, largest, p))
    margin_beyond = _margin(mode, _stepped(mode, s, dt, volts, largest, p, work), largest, p)
    for count in range(FALSE_POSITIONS):
        share = margin_before / (margin_before - margin_beyond)
        # Every third time the middle, so that both ends move.
        middle = before + (0.5 if count % 3 == 2 else min(max(share, 1e-3), 1.0 - 1e-3)) * (beyond - before)
        margin = _margin(mode, _stepped(mode, s, middle, volts, largest, p, work), largest, p)
        if margin < 0.0:
            beyond, margin_beyond = middle, margin
        else:
            before, margin_before = middle, margin
    return beyond


@compiled
def _next(times: FloatArray, index: int) -> float:
    return float(times[index] if index < times.size else np.inf)


@compiled_entry
def _run(
    commands: FloatArray,
    levels: FloatArray,
    position_times: FloatArray,
    current_times: FloatArray,
    step: float,
    p: _Packed,
) -> tuple[FloatArray, FloatArray, list[tuple[float, int, float, float]]]:
    """Positions (n, 3: seen pilot, seen main, velocity), u (n,) and the events."""
    positions, currents = np.zeros((position_times.size, 3)), np.zeros(current_times.size)
    events = [(0.0, -1, 0.0, 0.0)]
    work, s = np.zeros((3, STATE_COUNT)), np.zeros(STATE_COUNT)
    s[PRESSURE], s[EXTRA] = p.build.pressure_at_rest, 1.0
    mode, t, volts, largest = SEATED, 0.0, 0.0, 0.0
    command = position = current = 0
    while True:
        while _next(commands, command) <= t:
            volts = levels[command]
            command += 1
        while _next(position_times, position) <= t:
            seen = p.sensor_rate > 0.0
            positions[position, 0] = s[SEEN_PILOT] if seen else s[X]
            positions[position, 1] = s[SEEN_MAIN] if seen else max(0.0, s[X] - p.gap)
            positions[position, 2] = s[V]
            position += 1
        while _next(current_times, current) <= t:
            currents[current] = s[CURRENT]
            current += 1
        if position == position_times.size and current == current_times.size:
            return positions, currents, events
        stop = min(_next(commands, command), _next(position_times, position), _next(current_times, current))
        pieces = max(1.0, np.ceil((stop - t) / step - 1e-6))
        dt = (stop - t) / pieces
        moved = _stepped(mode, s, dt, volts, largest, p, work)
        ended = _is_over(mode, moved, largest, p)
        if ended:
            dt = _cut(mode, s, dt, volts, largest, p, work)
            moved = _stepped(mode, s, dt, volts, largest, p, work)
        t = stop if pieces == 1.0 and not ended else t + dt
        s[:] = moved
        largest = max(largest, abs(s[CURRENT]))
        if ended:
            speed, place = s[V], s[X]
            mode, kind = _switched(mode, s, largest, p)
            events.append((t, kind, place, speed))


def built(entries: Entries) -> Build:
    """The valve with the numbers of a (true) data sheet; what that does not say is the default's."""

    def entry(name: str) -> float:
        return float(np.asarray(entries[name]))

    same = ("pilot_mass", "spring_rate", "pilot_gap", "stroke", "coil_time_constant")
    return Build(
        main_mass=entry("moving_mass") - entry("pilot_mass"),
        spring_preload=entry("spring_preload") - entry("seat_load"),
        return_force=entry("seat_load"),
        **{name: entry(name) for name in same},
    )


@dataclass(frozen=True)
class ReluctancePlant:
    """A magnetic circuit, bristles and a leaking seat; `effects` holds names of EFFECTS, any other raises ValueError.

    `build` is the valve; `step` the longest step in s.
    """

    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    build: Build = AS_BUILT
    step: float = 1e-6

    def __post_init__(self) -> None:
        """Refuse names that would be ignored silently."""
        check_effects(self.effects, EFFECTS)

    def static_pull(self, displacement: FloatArray) -> FloatArray:
        """Attraction at the reference current with the plunger blocked at each displacement (n,), N."""
        return self.build.reluctance_force / (self.build.reluctance_gap - displacement) ** 2

    def static_table(self, random: np.random.Generator) -> tuple[FloatArray, FloatArray]:
        """What a stage and a load cell read at the reference voltage: displacements (n,) m and forces (n,) N."""
        displacement = np.arange(0.0, TABLE_END + TABLE_STEP / 2.0, TABLE_STEP)
        blocked = np.clip(displacement + STAGE * random.standard_normal(displacement.size), 0.0, None)
        return displacement, self.static_pull(blocked) + LOAD_CELL * random.standard_normal(displacement.size)

    def simulate(self, command_times: FloatArray, volts: FloatArray, sample_times: FloatArray) -> PlantRun:
        """Drive from rest at time 0: command times (k,) s, volts (k,), sample times (n,) s, both ascending."""
        times = np.asarray(sample_times, dtype=np.float64)
        delay = self.effects.get("sensor_delay", {}).get("delay", 0.0)
        gain = self.effects.get("sensor_gain", {}).get("gain", 1.0)
        positions, currents, events = _run(
            np.asarray(command_times, dtype=np.float64),
            np.asarray(volts, dtype=np.float64),
            times - delay,
            times,
            self.step,
            self._packed(),
        )
        return PlantRun(
            times,
            gain * positions[:, 0],
            gain * positions[:, 1],
            positions[:, 2].copy(),
            self.build.reference_voltage / self.build.coil_resistance * currents,
            tuple(PlantEvent(time, KINDS[kind], x, v) for time, kind, x, v in events[1:]),
        )

    def _packed(self) -> _Packed:
        def given(effect: str, parameter: str, off: float = 0.0) -> float:
            return self.effects[effect][parameter] if effect in self.effects else off

        coulomb = self.build.friction + given("coulomb_friction", "force") + given("stiction", "force")
        return _Packed(
            build=self.build,
            gap=self.build.pilot_gap + given("gap_offset", "offset"),
            stroke=self.build.stroke + given("stroke_offset", "offset"),
            coil=self.build.coil_time_constant + given("coil_lag", "time_constant"),
            rest_attraction=given("rest_attraction", "force"),
            drive=given("drive_gain", "gain", 1.0),
            eddy_extra=given("eddy_lag", "time_constant"),
            heating=given("coil_heating", "temperature_rate"),
            cooling=1.0 / given("coil_heating", "cooling_time_constant", np.inf),
            knee=given("magnetic_saturation", "current"),
            floor=given("residual_magnetism", "current"),
            level_opening=coulomb + given("asymmetric_friction", "force_opening"),
            level_closing=coulomb + given("asymmetric_friction", "force_closing"),
            breakaway=self.build.breakaway + given("stiction", "breakaway"),
            stribeck=given("stiction", "stribeck_velocity", self.build.stribeck_velocity),
            damping_opening=given("asymmetric_friction", "damping_opening"),
            damping_closing=given("asymmetric_friction", "damping_closing"),
            constant=given("constant_force", "force"),
            extra_pressure=given("pressure_force", "force"),
            extra_time=given("pressure_force", "equalisation_time", 1.0),
            drag=given("quadratic_drag", "coefficient"),
            film=given("squeeze_film", "coefficient"),
            film_thickness=given("squeeze_film", "film_thickness", 1.0),
            at_stop=given("stop_bounce", "restitution_stop"),
            at_seat=given("stop_bounce", "restitution_seat"),
            hardening=given("spring_hardening", "coefficient"),
            sensor_rate=2.0 * np.pi * given("sensor_bandwidth", "cutoff_frequency", self.build.sensor_cutoff),
        )
