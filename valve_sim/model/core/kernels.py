"""From the equations to the functions that the integrator calls: a step in motion or at rest, and looks at a valve.

    prepare   numbers of the valve after its effects
    move      one step in motion: Taylor series, step size, states at its end, whether anything may happen in it
    rest      one step at rest, likewise: only the coil moves
    at        the states at some time within the step
    spot      x and v at some time within the step
    row       what a row of output shows at some time within the step
    look      forces, rates and currents at the state
    place     where a curve of splines is read
    decide    which comparisons of the equations hold at the state

A valve with gas is stepped by `gas_steps`; in place of move and rest it has

    flow      rate of the density at a stage, and its slope
    stage     rates of all other states there
    bend      the rate of the density's rate there
    watch     what must not become negative, and the pressures, at some time within the step

of which the first three stand for `flow_slopes`, `stage_slopes` and `bend_slopes`, too, with tangents if any are asked.

With directions of derivatives each carries the tangents of what it computes along.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final

from valve_sim.model.core import layout as at
from valve_sim.model.core.code import Code, Value
from valve_sim.model.core.equations import System
from valve_sim.model.core.series import Series
from valve_sim.model.core.steps import SIZE_OF_FORCE, SIZE_OF_V
from valve_sim.model.core.tracer import Node, ancestors, derivative

SIZE_OF_X: Final = 1e-5
"""m: below this size errors are held absolutely."""
SAFETY: Final = 0.1
"""Of the tolerance: the last terms of a series, of which a step tolerates that much, are larger than what is left out,
but many steps add up."""
CHAINS: Final = 3
"""In which a polynomial is summed."""
FINE: Final = 5
"""Order up to which a guard's Bernstein coefficients are taken; the terms above are bounded by their size."""
NOT_COMPARED: Final = 3
"""Places among what is held that are of no comparison: velocity, or forces upwards and downwards; and the current."""
CHECKED_AT: Final = (0.5, 1.0)
"""Fractions of a step at which its series is compared with the equation."""
DYNAMIC: Final = (
    "unseated_time", "seen", "peak", "tank", "tank time", "demand", *(f"curve {power}" for power in range(4)),
)  # fmt: skip
"""Numbers that events change, and their tangents with them."""
OF_TAYLOR: Final = ("move", "rest")
OF_GAS: Final = ("flow", "stage", "bend", "watch", "flow_slopes", "stage_slopes", "bend_slopes")
OF_BOTH: Final = ("at", "spot", "row", "look", "place", "decide", "prepare")
NAMES: Final = (*OF_TAYLOR, *OF_GAS, *OF_BOTH)
CURVED: Final = ("exp", "log", "expm1", "log1p", "sin", "cos", "tanh", "power", "div")
"""Functions whose series does not end."""


def _is_curved(guard: Node) -> bool:
    """Whether what is compared is more than a polynomial of time and the states.

    A largest value so far, while it grows, is watched by its slope, which its own value says nothing of.
    """
    return guard.op != "rising" and any(node.op in CURVED and not node.steady for node in ancestors([guard]))


class Kernels:
    """The kernels of one set of equations.

    Args:
        system: the equations.
        width: directions of derivatives, to any parameters; 0 for none.
    """

    def __init__(self, system: System, width: int = 0) -> None:
        self.system, self.width = system, width
        self.names = tuple(system.states)
        self._slots = {**at.HELD, **{name: at.NUMBERS + i for i, name in enumerate(system.parameters)}}
        for place, name in enumerate(self.names):
            self._slots[name] = self._slots[f"{name} at start"] = at.COIL + place
        trace = system.trace
        self._x, self._v = trace.state("x"), trace.state("v")
        self._coil = {name: state.rate for name, state in system.states.items()}
        self._seeds: dict[Node, Node] = {}
        if width:
            for name in ("x", "v", *self.names):
                self._seeds[trace.state(name)] = trace.state(f"d {name}")
            for name in (*system.parameters, *DYNAMIC, *(f"{name} at start" for name in self.names)):
                self._seeds[trace.number(name)] = trace.number(f"d {name}")
        self._guards = trace.guards()
        self._curved = [guard for guard in self._guards if _is_curved(guard)]
        self._flags = {guard: at.FLAG + i for i, guard in enumerate(self._guards)}
        self.made = (*(OF_TAYLOR if system.gas is None else OF_GAS), *OF_BOTH)
        self._moving_rates = self._with_tangents({"x": self._v, "v": system.acceleration, **self._coil})
        self._resting_rates = self._with_tangents(self._coil)

    @property
    def guard_count(self) -> int:
        """How many comparisons there are."""
        return len(self._guards)

    @property
    def is_checked(self) -> bool:
        """Whether series are compared with what they are of."""
        return self.system.is_checked or bool(self._curved)

    @property
    def curve(self) -> tuple[int, int, int] | None:
        """Of a curve of splines: the slot of its first coefficient, and its two guards."""
        found = self.system.trace.curve
        if found is None:
            return None
        low, high = (self._guards.index(guard) for guard in (found.low, found.high))
        return self._slots[found.first], low, high

    def text(self) -> str:
        """All kernels, as text of LLVM."""
        codes = {name: getattr(self, f"_{name}")() for name in self.made}
        declared = sorted(set().union(*(code.declared for code in codes.values())))
        return "\n".join([*declared, *(code.function(name) for name, code in codes.items())])

    def _with_tangents(self, nodes: Mapping[str, Node]) -> dict[str, Node]:
        return {**nodes, **self._tangents(nodes)}

    def _tangents(self, nodes: Mapping[str, Node]) -> dict[str, Node]:
        """The tangents of some nodes, named after them; those that are 0 are left out."""
        if not self.width:
            return {}
        slopes = derivative(nodes.values(), self._seeds)
        return {f"d {name}": slope for name, slope in zip(nodes, slopes, strict=True) if slope is not None}

    def _slot_of(self, name: str) -> int:
        return self._slots[name]

    def _code(self) -> Code:
        return Code(width=self.width)

    def _series(self, code: Code, start: Mapping[str, Value], rates: Mapping[str, Node], **how: object) -> Series:
        return Series(code, self._slot_of, start, rates, self._flags, **how)  # type: ignore[arg-type]

    def _prepare(self) -> Code:
        code = self._code()
        nodes = {name: self.system.numbers[name] for name in at.OF_VALVE}
        series = self._series(code, {}, {})
        numbers = self.system.numbers
        nodes["rated"] = numbers["reference_voltage"] / numbers["coil_resistance"]
        if self.system.gas is not None:
            nodes |= {name: numbers[name] for name in at.OF_GAS}
            nodes["first density"] = self.system.gas.first_density
        slots = {**at.OF_VALVE, **at.OF_GAS, "rated": at.RATED, "first density": at.FIRST_DENSITY}
        self._store_all(code, series, nodes, slots)
        return code

    def _store_all(self, code: Code, series: Series, nodes: Mapping[str, Node], slots: Mapping[str, int]) -> None:
        """Store values, and tangents if any are asked for, of nodes."""
        tangents = self._tangents(nodes)
        for name, node in nodes.items():
            code.store(slots[name], series.value(node))
            if self.width:
                slope = tangents.get(f"d {name}")
                code.store(slots[name], code.constant(0.0) if slope is None else series.value(slope), wide=True)

    def _move(self) -> Code:
        code = self._code()
        series = self._series(code, {}, self._moving_rates)
        for order in range(at.ORDER + 1):
            self._store_coefficient(code, series, "x", order)
        taken = self._store_coil(code, series)
        v = [series.coefficient(self._v, order) for order in range(at.TERMS)]
        x = self._or_zero(code, [series.coefficient(self._x, order) for order in range(at.ORDER + 1)])
        controlled = [(x, SIZE_OF_X), (self._or_zero(code, v), SIZE_OF_V), *taken]
        step = self._step_of(code, controlled)
        self._end(code, series, step)
        moved = self._ancestors([self.system.acceleration, *self._coil.values()])
        held = [None, None, self.system.current_left, *(g if g in moved else None for g in self._guards)]
        sure = self._sure(code, series, step, held)
        terms = [
            code.mul(c, h) for c, h in zip(self._or_zero(code, v), self._powers(code, step, at.TERMS), strict=True)
        ]
        way = code.load(at.DIRECTION)
        onwards = self._above_zero(code, [code.mul(way, term) for term in terms[: FINE + 1]], terms[FINE + 1 :])
        sure = onwards if sure is None else code.both(sure, onwards)
        ahead = code.sub(code.load(at.AHEAD), code.load(at.END_X))
        away = code.compare("ogt", code.mul(ahead, code.load(at.DIRECTION)), code.constant(0.0))
        self._store_suspect(code, code.both(sure, away))
        if self.is_checked:
            self._check(code, series, step, self._or_zero(code, v) if self.system.is_checked else ())
        return code

    def _rest(self) -> Code:
        code = self._code()
        series = self._series(code, {}, self._resting_rates)
        for order in range(at.ORDER + 1):
            self._store_coefficient(code, series, "x", order)
        taken = self._store_coil(code, series)
        nets = [self.system.up, self.system.down]
        coefficients = [self._coefficients(code, series, net) for net in nets]
        step = self._step_of(code, [*((c, SIZE_OF_FORCE) for c in coefficients), *taken])
        self._end(code, series, step)
        moved = self._ancestors([*nets, *self._coil.values()])
        flags = [guard if guard in moved else None for guard in self._guards]
        held = [-self.system.up, -self.system.down, self.system.current_left, *flags]
        sure = self._sure(code, series, step, held)
        assert sure is not None
        self._store_suspect(code, sure)
        if self.is_checked:
            self._check(code, series, step)
        return code

    def _ancestors(self, nodes: Iterable[Node]) -> set[Node]:
        return ancestors(nodes)

    def _store_coefficient(self, code: Code, series: Series, name: str, order: int) -> None:
        """Store a coefficient of x or of a state of the coil, and its tangents."""
        if name == "x":
            slot = at.SERIES_X + order
        else:
            slot = at.SERIES_COIL + self.names.index(name) * at.TERMS + order
        trace = self.system.trace
        code.store(slot, series.coefficient(trace.state(name), order) or code.constant(0.0))
        if self.width:
            code.store(slot, series.coefficient(trace.state(f"d {name}"), order) or code.constant(0.0), wide=True)

    def _store_coil(self, code: Code, series: Series) -> list[tuple[list[Value], float]]:
        """Store those series of the coil that are read; returns those whose errors count, with their sizes."""
        taken = []
        for name, state in self.system.states.items():
            if state.after is None:
                for order in range(at.TERMS):
                    self._store_coefficient(code, series, name, order)
            node = self.system.trace.state(name) if state.series is None else state.series
            coefficients = [series.coefficient(node, order) for order in range(at.TERMS)]
            taken.append((self._or_zero(code, coefficients), state.scale))
        return taken

    @staticmethod
    def _or_zero(code: Code, coefficients: Iterable[Value | None]) -> list[Value]:
        return [code.constant(0.0) if c is None else c for c in coefficients]

    def _step_of(self, code: Code, controlled: Sequence[tuple[list[Value], float]]) -> Value:
        """The step at which the last two terms of each series are as large as its tolerance, stored and returned."""
        tolerance, least = code.load(at.TOLERANCE), None
        for coefficients, size in controlled:
            scale = code.larger(code.call("fabs", coefficients[0]), code.constant(size))
            tolerated = code.rough_log2(code.mul(code.mul(tolerance, scale), code.constant(SAFETY)))
            for order in (len(coefficients) - 1, len(coefficients) - 2):
                term = code.rough_log2(code.call("fabs", coefficients[order]))
                exponent = code.mul(code.sub(tolerated, term), code.constant(1.0 / order))
                least = exponent if least is None else code.smaller(exponent, least)
        assert least is not None
        step = code.smaller(code.rough_exp2(least), code.load(at.LONGEST))
        if self.width and any(state.after is None for state in self.system.states.values()):
            # Tangents of a current that is integrated fade with its time constant, even when it has gone.
            lag = code.load(at.LAG)
            step = code.select(code.compare("ogt", lag, code.constant(0.0)), code.smaller(step, lag), step)
        code.store(at.STEP, step)
        return step

    @staticmethod
    def _powers(code: Code, step: Value, count: int) -> list[Value]:
        """Powers of the step, from 0 to count − 1."""
        powers = [code.constant(1.0), step]
        for order in range(2, count):
            powers.append(code.mul(powers[order // 2], powers[order - order // 2]))
        return powers

    @staticmethod
    def _summed(code: Code, terms: Sequence[Value]) -> Value:
        """The sum of terms, in pairs, so that none waits long."""
        left = list(terms)
        while len(left) > 1:
            pairs = [code.add(left[i], left[i + 1]) for i in range(0, len(left) - 1, 2)]
            left = [*pairs, *left[2 * len(pairs) :]]
        return left[0]

    def _polynomial(self, code: Code, coefficients: Sequence[Value | None], powers: Sequence[Value]) -> Value:
        """A sum of coefficients times powers, in chains side by side, so that none waits long."""
        terms = [(c, h) for c, h in zip(coefficients, powers, strict=False) if c is not None]
        sums: list[Value | None] = [None] * CHAINS
        for place, (c, h) in reversed(list(enumerate(terms))):
            before = sums[place % CHAINS]
            if h is powers[0]:
                sums[place % CHAINS] = c if before is None else code.add(before, c)
            else:
                sums[place % CHAINS] = code.mul(c, h) if before is None else code.fma(c, h, before)
        found = [total for total in sums if total is not None]
        return self._summed(code, found) if found else code.constant(0.0)

    def _end(self, code: Code, series: Series, step: Value) -> None:
        """Store the states at the end of a step."""
        powers = self._powers(code, step, at.ORDER + 1)
        trace = self.system.trace
        ends: dict[str, Value] = {}
        kinds = ("", "d ") if self.width else ("",)
        for slot, (name, terms) in enumerate(
            (("x", at.ORDER + 1), ("v", at.TERMS), *((n, at.TERMS) for n in self.names))
        ):
            closed = name in self.system.states and self.system.states[name].after is not None
            for kind in kinds:
                if not closed:
                    state = trace.state(kind + name)
                    coefficients = [series.coefficient(state, order) for order in range(terms)]
                    ends[kind + name] = self._polynomial(code, coefficients, powers)
            if closed:
                ends.update(self._closed(code, name, step))
            for kind in kinds:
                code.store(at.END + slot, ends[kind + name], wide=bool(kind))
        self._store_peak(code, ends, step)

    def _closed(self, code: Code, name: str, step: Value) -> dict[str, Value]:
        """The value of a state with a closed form after a step, and its tangents."""
        after = self.system.states[name].after
        assert after is not None
        start = self._series(code, {"elapsed": step}, {})
        found = {name: start.value(after)}
        if code.width:
            tangents = self._tangents({name: after})
            found[f"d {name}"] = start.value(tangents[f"d {name}"]) if tangents else code.constant(0.0)
        return found

    def _store_peak(self, code: Code, ends: Mapping[str, Value], step: Value) -> None:
        """Store the largest |u| after a step."""
        peak = self.system.peak
        if peak is not None:
            there = self._series(code, ends, {}, clock=step, decides=True)
            code.store(at.END_PEAK, there.value(peak))
            if self.width:
                slope = self._tangents({"peak": peak}).get("d peak")
                code.store(at.END_PEAK, code.constant(0.0) if slope is None else there.value(slope), wide=True)

    def _sure(self, code: Code, series: Series, step: Value, held: Sequence[Node | None]) -> Value | None:
        """Whether it is sure that all that must not become negative in a step, or change its sign, does not.

        A guard of a comparison counts with the sign that its flag tells. None where nothing is held.
        """
        powers, sure = self._powers(code, step, at.TERMS), None
        for place, guard in enumerate(held):
            if guard is None:
                if place < NOT_COMPARED:
                    continue
                for order in range(at.TERMS):
                    code.store(at.GUARD + place * at.TERMS + order, code.constant(0.0 if order else 1.0))
                continue
            coefficients = self._coefficients(code, series, guard)
            if guard in self._flags:
                holds = series.condition(guard)
                coefficients = [code.select(holds, c, code.neg(c)) for c in coefficients]
            for order, c in enumerate(coefficients):
                code.store(at.GUARD + place * at.TERMS + order, c)
            terms = [code.mul(c, h) for c, h in zip(coefficients, powers, strict=True)]
            above = self._above_zero(code, terms[: FINE + 1], terms[FINE + 1 :])
            sure = above if sure is None else code.both(sure, above)
        return sure

    def _above_zero(self, code: Code, terms: Sequence[Value], rest: Sequence[Value]) -> Value:
        """Whether it is sure that a polynomial is positive up to the end of a step, by its terms there.

        A polynomial lies above the smallest of its Bernstein coefficients. Those of the first orders are taken, less
        the size of the other terms.
        """
        others, least = self._summed(code, [code.call("fabs", term) for term in rest]), None
        for j in range(1, FINE + 1):
            total = code.mul(terms[1], code.constant(j / FINE))
            for i in range(2, j + 1):
                total = code.fma(terms[i], code.constant(math.comb(j, i) / math.comb(FINE, i)), total)
            least = total if least is None else code.smaller(total, least)
        assert least is not None
        # Guards that differ by a constant, as those of the knots of a curve, share all but this.
        lowest = code.smaller(code.add(terms[0], least), terms[0])
        return code.compare("ogt", lowest, others)

    @staticmethod
    def _store_suspect(code: Code, sure: Value) -> None:
        code.store(at.SUSPECT, code.select(sure, code.constant(0.0), code.constant(1.0)))

    def _check(self, code: Code, series: Series, step: Value, v: Sequence[Value] = ()) -> None:
        """Store how far series are off what they are of within a step, over what is tolerated.

        They are the velocity `v` of a valve in motion, beside its equation, and what is compared, if that is curved:
        the size of a step does not ask for its error.
        """
        worst, powers = code.constant(0.0), self._powers(code, step, at.TERMS)
        least, tolerance = code.constant(SIZE_OF_V), code.load(at.TOLERANCE)
        for fraction in CHECKED_AT:
            h = code.mul(step, code.constant(fraction))
            states, slope = self._states_at(code, h)
            there = self._series(code, states, {}, clock=h)
            if v:
                off = code.mul(code.sub(there.value(self.system.acceleration), slope), step)
                size = code.larger(code.call("fabs", v[0]), least)
                worst = self._worse(code, worst, off, code.mul(tolerance, size))
            for guard in self._curved:
                terms = [
                    code.mul(c, code.mul(power, code.constant(fraction**order)))
                    for order, (c, power) in enumerate(
                        zip(self._coefficients(code, series, guard), powers, strict=True)
                    )
                ]
                off = code.sub(there.value(guard), self._summed(code, terms))
                size = self._summed(code, [code.call("fabs", term) for term in terms])
                worst = self._worse(code, worst, off, code.mul(tolerance, size))
        code.store(at.DEFECT, worst)

    @staticmethod
    def _worse(code: Code, worst: Value, off: Value, tolerated: Value) -> Value:
        return code.larger(code.div(code.call("fabs", off), tolerated), worst)

    def _coefficients(self, code: Code, series: Series, node: Node) -> list[Value]:
        return self._or_zero(code, [series.coefficient(node, order) for order in range(at.TERMS)])

    def _states_at(self, code: Code, h: Value) -> tuple[dict[str, Value], Value]:
        """All states, with tangents, at a time within the step from the stored series; and v'."""
        powers = self._powers(code, h, at.ORDER + 1)
        states: dict[str, Value] = {}
        slope = code.constant(0.0)
        for wide in (False, True) if code.width else (False,):
            kind = "d " if wide else ""
            x = [code.load(at.SERIES_X + order, wide=wide) for order in range(at.ORDER + 1)]
            v = [code.mul(c, code.constant(float(order))) for order, c in enumerate(x)][1:]
            states[f"{kind}x"] = self._polynomial(code, x, powers)
            states[f"{kind}v"] = self._polynomial(code, v, powers)
            if not wide:
                slope = self._polynomial(
                    code, [code.mul(c, code.constant(float(order))) for order, c in enumerate(v)][1:], powers
                )
            for place, (name, state) in enumerate(self.system.states.items()):
                if state.after is None:
                    first = at.SERIES_COIL + place * at.TERMS
                    c = [code.load(first + order, wide=wide) for order in range(at.TERMS)]
                    states[kind + name] = self._polynomial(code, c, powers)
                elif not wide:
                    states.update(self._closed(code, name, h))
        return states, slope

    def _at(self) -> Code:
        code = self._code()
        elapsed = code.load(at.ELAPSED)
        states, _ = self._states_at(code, elapsed)
        for slot, name in enumerate(("x", "v", *self.names)):
            code.store(at.END + slot, states[name])
            if self.width:
                code.store(at.END + slot, states[f"d {name}"], wide=True)
        self._store_peak(code, states, elapsed)
        return code

    def _current_rate(self) -> list[Node | None]:
        """The rate of u, which no coil makes depend on the acceleration."""
        trace = self.system.trace
        coil = {trace.state(name): rate for name, rate in self._coil.items()}
        return derivative([self.system.current], {**coil, trace.clock(): trace.constant(1.0), self._x: self._v})

    def _spot(self) -> Code:
        code = self._code()
        states, _ = self._states_at(code, code.load(at.ELAPSED))
        code.store(at.ROW_X, states["x"])
        code.store(at.ROW_V, states["v"])
        if self.width:
            code.store(at.ROW_X, states["d x"], wide=True)
        return code

    def _row(self) -> Code:
        code, system = self._code(), self.system
        elapsed = code.load(at.ELAPSED)
        shown, there = self._shown(code, elapsed)
        for slot, value in zip((at.ROW_X, at.ROW_V, at.PULL, at.TERMINAL), shown, strict=False):
            code.store(slot, value)
        if self.width:
            (rate,) = self._current_rate()
            code.store(at.CURRENT_RATE, code.constant(0.0) if rate is None else there.value(rate))
        self._store_all(code, there, {"current": system.current}, {"current": at.CURRENT})
        if system.gas is not None:
            self._store_all(code, there, {"outlet": system.gas.outlet}, {"outlet": at.OUTLET})
            density = self.system.trace.state("density")
            (slope,) = derivative([system.gas.outlet], {density: system.trace.constant(1.0)})
            assert slope is not None
            code.store(at.OUTLET_RATE, code.mul(there.value(slope), self._slope_of(code, "density", elapsed)))
            code.store(at.MASS_FLOW, there.value(system.gas.flow))
        return code

    def _slope_of(self, code: Code, name: str, h: Value) -> Value:
        """The rate of a state at a time within the step, from its polynomial."""
        first = at.SERIES_COIL + self.names.index(name) * at.TERMS
        c = [code.mul(code.load(first + k), code.constant(float(k))) for k in range(1, at.TERMS)]
        return self._polynomial(code, c, self._powers(code, h, at.TERMS))

    def _shown(self, code: Code, elapsed: Value) -> tuple[tuple[Value, ...], Series]:
        """Position, velocity, attraction and voltage at times within the step, and the series that all else is of."""
        states, _ = self._states_at(code, elapsed)
        there = self._series(code, states, {}, clock=elapsed)
        system = self.system
        return (states["x"], states["v"], there.value(system.attraction), there.value(system.terminal)), there

    def _look(self) -> Code:
        code, trace, system = self._code(), self.system.trace, self.system
        series = self._series(code, {}, {})
        coil = {trace.state(name): rate for name, rate in self._coil.items()}
        resting = {**coil, trace.clock(): trace.constant(1.0)}
        up_rate, down_rate = derivative([system.up, system.down], resting)
        (current_rate,) = self._current_rate()
        zero = trace.constant(0.0)
        self._store_all(
            code, series, {"up": system.up, "down": system.down, "current": system.current},
            {"up": at.UP, "down": at.DOWN, "current": at.CURRENT},
        )  # fmt: skip
        values = {
            at.ACCELERATION: system.acceleration, at.NET: system.net, at.UP_RATE: up_rate, at.DOWN_RATE: down_rate,
            at.CURRENT_RATE: current_rate, at.PULL: system.attraction, at.TERMINAL: system.terminal,
            **{at.COIL_RATES + place: rate for place, rate in enumerate(self._coil.values())},
        }  # fmt: skip
        if system.gas is not None:
            values[at.CLOSING] = system.closing
        for slot, node in values.items():
            code.store(slot, series.value(zero if node is None else node))
        if self.width:
            self._store_guards(code, series)
        return code

    def _store_guards(self, code: Code, series: Series) -> None:
        """Store the rates of what is compared, and its tangents: derivatives pass where a force jumps by them."""
        trace = self.system.trace
        moving = {self._x: self._v, self._v: self.system.acceleration * trace.number("moving")}
        coil = {trace.state(name): rate for name, rate in self._coil.items()}
        rates = derivative(self._guards, {**moving, **coil, trace.clock(): trace.constant(1.0)})
        slopes = derivative(self._guards, self._seeds)
        for place, both in enumerate(zip(rates, slopes, strict=True)):
            rate, slope = (code.constant(0.0) if node is None else series.value(node) for node in both)
            code.store(at.GUARD_RATE + place, rate)
            code.store(at.GUARD_RATE + place, slope, wide=True)

    def _at_stage(self, code: Code) -> Series:
        """Everything at a stage of a step of a valve with gas: what is integrated stands where the step's end will."""
        elapsed, states = code.load(at.ELAPSED), dict[str, Value]()
        for slot, name in enumerate(("x", "v", *self.names)):
            if name in self.system.states and self.system.states[name].after is not None:
                states.update(self._closed(code, name, elapsed))
                continue
            states[name] = code.load(at.END + slot)
            if code.width:
                states[f"d {name}"] = code.load(at.END + slot, wide=True)
        return self._series(code, states, {}, clock=elapsed)

    def _flow(self) -> Code:
        return self._flow_of(Code())

    def _flow_slopes(self) -> Code:
        return self._flow_of(self._code())

    def _flow_of(self, code: Code) -> Code:
        gas, series = self.system.gas, self._at_stage(code)
        assert gas is not None
        trace = self.system.trace
        (slope,) = derivative([gas.rate], {trace.state("density"): trace.constant(1.0)})
        nodes = {
            at.FLOW_RATE: gas.rate, at.FLOW_SLOPE: slope, at.INLET_DENSITY: gas.density_of_inlet,
            at.DEMAND_DENSITY: gas.density_of_demand,
        }  # fmt: skip
        for slot, node in nodes.items():
            if node is not None:
                code.store(slot, series.value(node))
        self._store_tangents(code, series, {at.FLOW_RATE: gas.rate})
        return code

    def _stage(self) -> Code:
        return self._stage_of(Code())

    def _stage_slopes(self) -> Code:
        return self._stage_of(self._code())

    def _stage_of(self, code: Code) -> Code:
        series = self._at_stage(code)
        nodes = {at.STAGE_RATES + 1: self.system.acceleration}
        for place, (name, state) in enumerate(self.system.states.items()):
            if state.after is None and name != "density":
                nodes[at.STAGE_RATES + 2 + place] = state.rate
        for slot, node in nodes.items():
            code.store(slot, series.value(node))
        self._store_tangents(code, series, nodes)
        return code

    def _bend(self) -> Code:
        return self._bend_of(Code())

    def _bend_slopes(self) -> Code:
        return self._bend_of(self._code())

    def _bend_of(self, code: Code) -> Code:
        trace, gas = self.system.trace, self.system.gas
        assert gas is not None
        along = {trace.state("density"): gas.rate, self._x: self._v, trace.clock(): trace.constant(1.0)}
        (bend,) = derivative([gas.rate], along)
        assert bend is not None
        series = self._at_stage(code)
        code.store(at.BENT, series.value(bend))
        self._store_tangents(code, series, {at.BENT: bend})
        return code

    def _store_tangents(self, code: Code, series: Series, nodes: Mapping[int, Node]) -> None:
        """Store tangents of nodes by their slots, if the code has any."""
        if code.width:
            for slot, slope in zip(nodes, derivative(nodes.values(), self._seeds), strict=True):
                code.store(slot, code.constant(0.0) if slope is None else series.value(slope), wide=True)

    def _watch(self) -> Code:
        code, system = Code(), self.system
        elapsed = code.load(at.ELAPSED)
        states, _ = self._states_at(code, elapsed)
        moves = system.acceleration * system.trace.number("moving")
        there = self._series(code, states, {"x": self._v, "v": moves, **self._coil}, clock=elapsed)
        left = code.constant(1.0) if system.current_left is None else there.value(system.current_left)
        watched = [code.neg(there.value(system.up)), code.neg(there.value(system.down)), left]
        for guard in self._guards:
            excess = there.value(guard)
            watched.append(code.select(there.condition(guard), excess, code.neg(excess)))
        for place, value in enumerate(watched):
            code.store(at.GUARD + place, value)
        gas = system.gas
        assert gas is not None
        for slot, node in {at.INLET: gas.inlet, at.OUTLET: gas.outlet, at.CRITICAL: gas.critical}.items():
            code.store(slot, there.value(node))
        return code

    def _place(self) -> Code:
        code, curve = Code(), self.system.trace.curve
        if curve is not None:
            series = self._series(code, {}, {})
            code.store(at.CURVE_PLACE, series.value(curve.place))
            code.store(at.CURVE_INTERVALS, series.value(curve.intervals))
        return code

    def _decide(self) -> Code:
        code, trace = self._code(), self.system.trace
        moves = self.system.acceleration * trace.number("moving")
        series = self._series(code, {}, {"x": self._v, "v": moves, **self._coil}, decides=True)
        for guard, slot in self._flags.items():
            code.store(slot, code.select(series.condition(guard), code.constant(1.0), code.constant(0.0)))
        return code
