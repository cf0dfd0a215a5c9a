"""The valve's equations. This page is what is traced, and everything else is derived from it.

Symbols and equation numbers:

    (1)  τ u' = V/V_ref − r u                                    coil; r = R/R_0
    (2)  F_a(x, u) = s(u) (a0 + a1 x + a2 x² + a3 x³)            attraction; s(u) = u²
    (3)  Phase 1:  m_1 v' = F_a − F_seat − c_1 v + Σ effects     the paper's equation for 0 ≤ t ≤ t1
    (4)  Phase 2:  m_2 v' = F_a − F_0 − k x − c_2 v + Σ effects  the paper's equation for t1 ≤ t ≤ t2
    (5)  Σ effects: the forces of the files in `effects`
    (6)  dry friction: the levels F(v) of these files, against the motion; at rest it holds up to F(0)
    (7)  saturation: effects replace s(u)
    (8)  residual magnetism: the u that pulls never falls below u_r min(1, max |u| so far)
    (9)  eddy currents: τ_e w' = u − w; w pulls, u is measured
    (10) heating: T' = q u² − T/τ_c;  r = 1 + α T

Where `motional_emf` is declared, the coil follows its flux linkage in place of (1) and (9). With the power P at u = 1
and the work W(x) = ∫ (a0 + a1 ξ + a2 ξ² + a3 ξ³) dξ of the attraction at u = 1:

    (C1)  φ = ∂/∂w of the co-energy over P, which is τ w²/2 + σ W(x)/P s(w); σ is the share
    (C2)  φ' = V/V_ref − r u
    (C3)  u = w + φ'/ρ,  ρ = τ/τ_e                               eddy currents: a resistance parallel to the flux
    (C4)  w' = (φ' − φ_x v)/φ_w
    (C5)  freewheeling: V = ∓V_r while the command is 0 and |u| > 0; then the diode blocks: u = 0 and φ' = −ρ w
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

from valve_sim.model.core.gas import NUMBERS, PREFIX, Gas, closing_force, gas_of
from valve_sim.model.core.symbols import Effect, Motion, Own
from valve_sim.model.core.tracer import (
    Condition,
    Node,
    Trace,
    ancestors,
    derivative,
    exp,
    maximum,
    minimum,
    polynomial,
    running_maximum,
    where,
)
from valve_sim.model.parameters import DECLARED

COPPER: Final = 0.00393
"""α, 1/K: the temperature coefficient of the resistance of copper at 20 °C (IEC 60028)."""
INSTANT: Final = 1e-12
"""s: a current that settles faster than this follows at once."""
NEARLY_EQUAL: Final = 0.1
"""Relative difference of two time constants below which the difference of their exponentials loses digits."""
DECAYED: Final = 4e-15
"""A part of a current that is below rounding."""
SHORTEST_INTEGRATED: Final = 2e-8
"""s: likewise of a current that is integrated, while the coil heats or follows its flux."""
SEAT_HOLDS: Final = 1e-9
"""N: a smaller net force does not lift the pilot plunger off its seat. Without a seat load it would float on the tail
of a current that has gone; event times move by nanoseconds."""

NEUTRAL: Final = {
    "drive_gain": 1.0, "eddy_time_constant": 0.0, "temperature_rate": 0.0, "cooling_time_constant": 1.0,
    "motional_share": 0.0, "residual_current": 0.0, "restitution_stop": 0.0, "restitution_seat": 0.0,
    "stop_compliance": 0.0, "sensor_delay": 0.0, "sensor_time_constant": 0.0, "sensor_gain": 1.0,
    "leak_area": 0.0, "clogging_ratio": 1.0,
}  # fmt: skip
"""Numbers of the equations that are not declared, and their values while no effect changes them."""


@dataclass(frozen=True)
class State:
    """A state of the coil.

    Attributes:
        rate: its rate of change.
        after: its value after the time `elapsed`, where it has a closed form; its error is then not held.
        scale: the size below which its error is held absolutely.
        series: what its series is to be read from, if not from the state itself.
    """

    rate: Node
    after: Node | None = None
    scale: float = 1e-2
    series: Node | None = None


@dataclass
class System:
    """One valve's equations as a graph.

    Attributes:
        states: of the coil by name.
        acceleration: v' in motion, m/s².
        net: (3) or (4) in motion without dry friction, N. up, down: of plungers at rest, by how much the net force
            exceeds what holds them, N, upwards and downwards. current: u. current_left: positive while a current
            freewheels; None where none does.
        peak: the largest |u| after a step; None where nothing asks for it.
        attraction: (2), N. terminal: V at the terminals.
        flux_slope: φ_w; None where the coil does not follow its flux.
        gas: what flows through the valve; None without gas. closing: its force, (G5), N.
        reads_time: whether a force changes with time while nothing else does.
        numbers: numbers of the valve after its effects, by name.
        parameters: the names of the numbers that a valve gives: declared ones, and "effect.parameter".
        is_checked: whether a series of these equations must be compared with them.
    """

    trace: Trace
    states: dict[str, State] = field(default_factory=dict)
    acceleration: Any = None
    net: Any = None
    up: Any = None
    down: Any = None
    current: Any = None
    current_left: Any = None
    peak: Any = None
    attraction: Any = None
    terminal: Any = None
    flux_slope: Any = None
    gas: Gas | None = None
    closing: Any = None
    reads_time: bool = False
    numbers: dict[str, Node] = field(default_factory=dict)
    parameters: tuple[str, ...] = ()
    is_checked: bool = False


def names_of_numbers(effects: Sequence[Effect], *, has_gas: bool) -> tuple[str, ...]:
    """The names of the numbers that a valve gives: declared ones, "effect.parameter", and those of its gas."""
    of_effects = (f"{effect.name}.{name}" for effect in effects for name in effect.names)
    return (*DECLARED, *of_effects, *(f"{PREFIX}{name}" for name in NUMBERS if has_gas))


def build(
    effects: Sequence[Effect],
    *,
    shapes: Sequence[float] = (),
    freewheels: bool = False,
    has_gas: bool = False,
    has_demand: bool = False,
) -> System:
    """The equations of a valve.

    Args:
        effects: what it has. shapes: values of the parameters that shape these, in their order.
        freewheels: whether its current may freewheel, (C5), and its sign must be watched.
        has_gas: whether gas flows through it. has_demand: whether gas leaves its outlet volume.
    """
    trace = Trace()
    system = System(trace)
    owns, given = {}, iter(shapes)
    for effect in effects:
        nodes = {name: trace.number(f"{effect.name}.{name}") for name in effect.names}
        owns[effect.name] = Own(**{**nodes, **{name: trace.constant(next(given)) for name in effect.shapes}})
    numbers = {name: trace.number(name) for name in DECLARED}
    numbers.update({name: trace.constant(value) for name, value in NEUTRAL.items()})
    numbers.update({name: trace.number(f"{PREFIX}{name}") for name in NUMBERS if has_gas})
    for effect in effects:
        for name, change in effect.changes.items():
            numbers[name] = trace.lift(change(numbers[name], owns[effect.name]))
    p = Own(**numbers)
    on = [(effect, owns[effect.name]) for effect in effects]
    names = {effect.name for effect in effects}

    clock, beyond = trace.clock(), trace.number("beyond") > 0.5
    t = trace.number("time") + clock
    since = where(trace.number("on seat") > 0.5, 0.0, trace.number("time") - trace.number("unseated_time") + clock)
    x, v, direction = trace.state("x"), trace.state("v"), trace.number("direction")
    if "motional_emf" in names:
        u, w = _flux_coil(system, p, on, x, v, heats="coil_heating" in names)
    elif "coil_heating" in names:
        u, w = _heating_coil(system, p, has_eddies="eddy_lag" in names)
    else:
        u, w = _linear_coil(system, p, has_eddies="eddy_lag" in names)
    pulling = w
    if "residual_magnetism" in names:
        peak = trace.number("peak")
        floor = p.residual_current * minimum(1.0, running_maximum(abs(u), peak))  # (8)
        pulling = maximum(abs(w), floor)
        system.peak = maximum(peak, abs(u))
    square = _square(pulling, on)

    motion = Motion(x, v, u, w, t, since, direction, trace.number("lifted") > 0.5, beyond, p)
    system.reads_time = t in ancestors([net_force(motion, square, on, None)])
    if has_gas:
        system.gas = gas = gas_of(motion, has_demand=has_demand)
        system.states["density"] = State(gas.rate)
        system.closing = closing_force(motion, gas)
    system.net = net_force(motion, square, on, system.gas)
    friction = direction * _friction(motion, on)
    mass = where(motion.lifted, p.moving_mass, p.pilot_mass)
    system.acceleration = (system.net - friction) / mass
    _at_rest(system, motion, square, on)
    system.current = u
    if freewheels:
        way = trace.number("freewheels")
        system.current_left = u * way + (1.0 - way * way)
    system.attraction = attraction(p, x, square)
    system.numbers = numbers
    system.parameters = names_of_numbers(effects, has_gas=has_gas)
    system.is_checked = any(
        node.op in ("exp", "log", "power", "sin", "cos", "tanh") and _varies_with_motion(node) for node in trace.nodes
    )
    return system


def attraction(p: Own, x: Node, square: Node) -> Node:
    """F_a of equation (2), N, given s."""
    return square * polynomial(x, p.a0, p.a1, p.a2, p.a3)


def work_of_attraction(p: Own, x: Node) -> Node:
    """W(x), J."""
    return polynomial(x, 0.0, p.a0, p.a1 / 2.0, p.a2 / 3.0, p.a3 / 4.0)


def net_force(m: Motion, square: Node, on: Sequence[tuple[Effect, Own]], gas: Gas | None) -> Node:
    """Right-hand sides of (3) and (4) with (5) and (G5), N; the dry friction of (6) is the caller's.

    What waits longest in a series is added last: the attraction is known before the velocity.
    """
    p = m.p
    load = where(m.lifted, p.spring_preload, p.seat_load)
    rate = where(m.lifted, p.spring_rate, 0.0)
    damping = where(m.lifted, p.main_damping, p.pilot_damping)
    force = attraction(p, m.x, square) - load
    for effect, own in on:
        if effect.force is not None:
            force = force + effect.force(m, own)
    if gas is not None:
        force = force - closing_force(m, gas)
    return force - rate * m.x - damping * m.v


def _square(pulling: Node, on: Sequence[tuple[Effect, Own]]) -> Node:
    """The s of the current that pulls, (2) and (7)."""
    square = pulling * pulling
    for effect, own in on:
        if effect.square is not None:
            square = effect.square(square, own)
    return square


def _friction(m: Motion, on: Sequence[tuple[Effect, Own]]) -> Node:
    """Magnitude of (6), N."""
    level = m.x.trace.constant(0.0)
    for effect, own in on:
        if effect.friction is not None:
            level = level + effect.friction(m, own)
    return level


def _at_rest(system: System, motion: Motion, square: Node, on: Sequence[tuple[Effect, Own]]) -> None:
    """By how much the net forces on plungers at rest exceed what holds them."""
    trace, p = system.trace, motion.p
    nothing = trace.constant(0.0)

    def net(way: float, lifted: Condition) -> Node:
        m = replace(motion, v=nothing, direction=trace.constant(way), lifted=lifted)
        held = _friction(m, on)
        if way > 0.0:
            on_seat = trace.number("on seat")
            held = maximum(held, SEAT_HOLDS * trace.number("closed")) + on_seat * p.seat_load
        return way * net_force(m, square, on, system.gas) - held

    system.up = where(trace.number("may rise") > 0.5, net(1.0, trace.number("lifted up") > 0.5), -1.0)
    system.down = where(trace.number("may fall") > 0.5, net(-1.0, trace.number("lifted down") > 0.5), -1.0)


def _varies_with_motion(node: Node) -> bool:
    """Whether an expression is a function of x or v, and not of time or the coil alone."""
    left, seen = [node], set()
    while left:
        one = left.pop()
        if one.op == "state" and one.payload in ("x", "v"):
            return True
        if one not in seen:
            seen.add(one)
            left.extend(one.args)
    return False


def _linear_coil(system: System, p: Own, *, has_eddies: bool) -> tuple[Node, Node]:
    """Equations (1) and (9) of a coil that does not heat: u and w."""
    trace = system.trace
    h = trace.number("elapsed")
    target = p.drive_gain * trace.number("seen") / p.reference_voltage
    lags = p.coil_time_constant > INSTANT
    state = trace.state("u")
    u = where(lags, state, target)
    decay = where(lags, exp(-h / p.coil_time_constant), 0.0)
    rate = where(lags, 1.0 / p.coil_time_constant, 0.0)
    system.states["u"] = State(rate * (target - state), after=target + (state - target) * decay)
    system.terminal = trace.number("seen")
    if not has_eddies:
        return u, u
    chases = p.eddy_time_constant > INSTANT
    chaser = trace.state("w")
    rest = where(chases, exp(-h / p.eddy_time_constant), 0.0)
    moved = target + (chaser - target) * rest + where(lags, (state - target) * _chase(p, h), 0.0)
    # Where the time constants differ, w is two exponentials, and the fast one of them is 0 when it has decayed: the
    # difference u − w, of which (9) makes the series, would keep a rounding error that a tiny time constant magnifies.
    apart = 1.0 - p.eddy_time_constant / p.coil_time_constant
    of_coil = (trace.number("u at start") - target) / apart
    of_eddies = trace.number("w at start") - target - of_coil
    of_eddies = where(abs(of_eddies) > DECAYED, of_eddies, 0.0)

    def two_exponentials(time: Node) -> Node:
        return target + of_coil * exp(-time / p.coil_time_constant) + of_eddies * exp(-time / p.eddy_time_constant)

    differ = abs(apart) > NEARLY_EQUAL
    series = where(chases, where(lags, where(differ, two_exponentials(trace.clock()), chaser), chaser), u)
    moved = where(chases, where(lags, where(differ, two_exponentials(h), moved), moved), moved)
    rate = where(chases, 1.0 / p.eddy_time_constant, 0.0) * (u - chaser)
    system.states["w"] = State(rate, after=moved, series=series)
    return u, series


def _chase(p: Own, h: Node) -> Node:
    """(τ/(τ − τ_e)) (e^{−h/τ} − e^{−h/τ_e}), also where τ is near τ_e: the response of (9) to (1)."""
    a, b = h / p.coil_time_constant, h / p.eddy_time_constant
    apart = abs(b - a)
    near: Node | float = 1.0
    for order in range(14, 1, -1):
        near = 1.0 - apart / float(order) * near
    share = where(apart > 0.5, (1.0 - exp(-apart)) / apart, near)
    return where(p.eddy_time_constant > INSTANT, b * exp(-minimum(a, b)) * share, 0.0)


def _heating_coil(system: System, p: Own, *, has_eddies: bool) -> tuple[Node, Node]:
    """Equations (1), (9) and (10): u and w."""
    trace = system.trace
    target = p.drive_gain * trace.number("seen") / p.reference_voltage
    r = _resistance_ratio(system)
    lags = p.coil_time_constant > SHORTEST_INTEGRATED
    state = trace.state("u")
    u = where(lags, state, target / r)
    rate = where(lags, 1.0 / p.coil_time_constant, 0.0)
    system.states["u"] = State(rate * (target - r * state))
    _heat(system, p, u)
    system.terminal = trace.number("seen")
    if not has_eddies:
        return u, u
    chases = p.eddy_time_constant > SHORTEST_INTEGRATED
    chaser = trace.state("w")
    system.states["w"] = State(where(chases, 1.0 / p.eddy_time_constant, 0.0) * (u - chaser))
    return u, where(chases, chaser, u)


def _resistance_ratio(system: System) -> Node:
    """The ratio r of (10)."""
    return 1.0 + COPPER * system.trace.state("temperature")


def _heat(system: System, p: Own, u: Node) -> None:
    """Equation (10)."""
    warm = system.trace.state("temperature")
    system.states["temperature"] = State(p.temperature_rate * u * u - warm / p.cooling_time_constant, scale=1e-1)


def _flux_coil(
    system: System, p: Own, on: Sequence[tuple[Effect, Own]], x: Node, v: Node, *, heats: bool
) -> tuple[Node, Node]:
    """Equations (C1) to (C5): u at the terminals and w, which pulls."""
    trace = system.trace
    w, seen = trace.state("w"), p.drive_gain * trace.number("seen") / p.reference_voltage
    blocked = trace.number("blocked") > 0.5
    r: Node | float = _resistance_ratio(system) if heats else 1.0
    per_power = p.motional_share * p.coil_resistance / (p.reference_voltage * p.reference_voltage)
    co_energy = p.coil_time_constant * w * w / 2.0 + per_power * work_of_attraction(p, x) * _square(w, on)
    flux = _gradient(co_energy, w)  # (C1)
    eddy = p.eddy_time_constant / p.coil_time_constant
    u = where(blocked, 0.0, (w + eddy * seen) / (1.0 + eddy * r))  # (C2) and (C3)
    circulates = p.eddy_time_constant > SHORTEST_INTEGRATED
    driven = seen - r * u  # (C2)
    flux_rate = where(blocked, where(circulates, -w * p.coil_time_constant / p.eddy_time_constant, 0.0), driven)
    system.flux_slope = _gradient(flux, w)
    rate = (flux_rate - _gradient(flux, x) * v) / system.flux_slope  # (C4)
    system.states["w"] = State(rate)
    if heats:
        _heat(system, p, u)
    induced = p.reference_voltage / p.drive_gain * flux_rate
    system.terminal = where(blocked, induced, trace.number("seen"))
    return u, w


def _gradient(node: Node, state: Node) -> Node:
    (slope,) = derivative([node], {state: node.trace.constant(1.0)})
    return node.trace.constant(0.0) if slope is None else slope
