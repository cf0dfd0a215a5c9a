"""From the graph of a machine to the functions that its integrator calls.

    move    one step: Taylor series of the states, its size, and series of what must not change its sign in it
    slide   likewise while the state slides along a switch
    at      the states at some time within the step
    look    rates of the states, and excesses of the switches with their rates
    row     the outputs at some time within the step

With directions of derivatives each carries the tangents of what it computes along (the variational equations).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Final

from valve_sim.model.core.code import Code, Value
from valve_sim.model.core.own import layout as at
from valve_sim.model.core.own.system import TIME, System, rate_of
from valve_sim.model.core.series import Series
from valve_sim.model.core.tracer import Node, derivative

SAFETY: Final = 0.1
"""Of the tolerance: many steps add up."""
CHECKED_AT: Final = (0.5, 1.0)
"""Fractions of a step at which its series is compared with the equation."""
SMALLEST: Final = 1e-6
"""SI: errors of smaller states are held absolutely, at 1e-6 TOLERANCE: below what any sensor shows, above rounding."""


class Kernels:
    """The kernels of one machine.

    Args:
        system: its graph. free: names of numbers and inputs' values that derivatives are taken to.
        width: directions of derivatives; 0 for none.
    """

    def __init__(self, system: System, free: Sequence[str], width: int) -> None:
        self.system, self.width = system, width
        trace = system.trace
        self._slots = {TIME: at.TIME}
        for i, name in enumerate(system.inputs):
            self._slots |= {name: at.INPUT + i, f"{name} slope": at.SLOPE + i}
        self._slots |= {name: at.NUMBERS + i for i, name in enumerate(system.parameters)}
        self._slots |= {name: at.STATE + i for i, name in enumerate(system.states)}
        self._slots |= {f"slides {guard}": at.SLIDES + k for k, guard in enumerate(system.sliding)}
        self._flags = {guard: at.FLAG + i for i, guard in enumerate(system.guards)}
        self._seeds: dict[Node, Node] = {}
        if width:
            self._seeds = {trace.state(name): trace.state(f"d {name}") for name in system.states}
            self._seeds |= {trace.number(name): trace.number(f"d {name}") for name in free}

    def text(self) -> str:
        """All kernels, as text of LLVM."""
        codes = {
            "move": self._move(self.system.rates, []),
            "slide": self._move(self.system.sliding_rates, self.system.alphas),
            "at": self._at(), "look": self._look(), "row": self._row(),
        }  # fmt: skip
        declared = sorted(set().union(*(code.declared for code in codes.values())))
        return "\n".join([*declared, *(code.function(name) for name, code in codes.items())])

    def _slot_of(self, name: str) -> int:
        return self._slots[name]

    def _rates(self, rates: Sequence[Node]) -> dict[str, Node]:
        found = dict(zip(self.system.states, rates, strict=True))
        if self.width:
            slopes = derivative(rates, self._seeds)
            pairs = zip(self.system.states, slopes, strict=True)
            found |= {f"d {name}": slope for name, slope in pairs if slope is not None}
        return found

    def _series(self, code: Code, start: Mapping[str, Value], rates: Mapping[str, Node], **how: Value) -> Series:
        return Series(code, self._slot_of, start, rates, self._flags, **how)  # type: ignore[arg-type]

    def _move(self, rates: Sequence[Node], alphas: Sequence[Node]) -> Code:
        code, trace = Code(width=self.width), self.system.trace
        series = self._series(code, {}, self._rates(rates))
        zero = code.constant(0.0)
        stored: list[list[Value]] = []
        for i, name in enumerate(self.system.states):
            own = [series.coefficient(trace.state(name), order) or zero for order in range(at.TERMS)]
            stored.append(own)
            for order, value in enumerate(own):
                code.store(at.SERIES + i * at.TERMS + order, value)
                if self.width:
                    slope = series.coefficient(trace.state(f"d {name}"), order)
                    code.store(at.SERIES + i * at.TERMS + order, slope or zero, wide=True)
        for first, nodes in ((at.GUARD_SERIES, self.system.guards), (at.ALPHA_SERIES, alphas)):
            for i, node in enumerate(nodes):
                for order in range(at.TERMS):
                    code.store(first + i * at.TERMS + order, series.coefficient(node, order) or zero)
        self._step(code, stored, rates)
        return code

    def _step(self, code: Code, stored: Sequence[Sequence[Value]], rates: Sequence[Node]) -> None:
        """Store the step at which the last two terms of each state's series are as large as its tolerance."""
        longest, tolerance = code.load(at.LONGEST), code.load(at.TOLERANCE)
        step, scales = longest, []
        tiny = code.constant(SMALLEST)
        for i, own in enumerate(stored):
            moved = code.mul(code.call("fabs", own[1]), longest)
            scale = code.larger(code.larger(code.load(at.PEAK + i), code.call("fabs", own[0])), tiny)
            scale = code.larger(scale, moved)
            scales.append(scale)
            tolerated = code.rough_log2(code.mul(code.mul(tolerance, scale), code.constant(SAFETY)))
            for order in (at.ORDER, at.ORDER - 1):
                term = code.rough_log2(code.call("fabs", own[order]))
                allowed = code.rough_exp2(code.mul(code.sub(tolerated, term), code.constant(1.0 / order)))
                step = code.smaller(allowed, step)
        code.store(at.STEP, step)
        worst = code.constant(0.0)
        if self.system.is_nonlinear:
            for fraction in CHECKED_AT:
                h = code.mul(step, code.constant(fraction))
                there = {name: self._horner(code, own, h) for name, own in zip(self.system.states, stored, strict=True)}
                series = self._series(code, there, {}, clock=h)
                for own, scale, rate in zip(stored, scales, rates, strict=True):
                    slope = self._horner(code, [code.mul(c, code.constant(float(k))) for k, c in enumerate(own)][1:], h)
                    off = code.mul(code.call("fabs", code.sub(series.value(rate), slope)), step)
                    worst = code.larger(code.div(off, code.mul(tolerance, scale)), worst)
        code.store(at.DEFECT, worst)

    @staticmethod
    def _horner(code: Code, coefficients: Sequence[Value], h: Value) -> Value:
        total = coefficients[-1]
        for c in reversed(coefficients[:-1]):
            total = code.fma(total, h, c)
        return total

    def _at(self) -> Code:
        code = Code(width=self.width)
        h = code.load(at.ELAPSED)
        for i in range(len(self.system.states)):
            first = at.SERIES + i * at.TERMS
            for wide in (False, True) if self.width else (False,):
                terms = [code.load(first + order, wide=wide) for order in range(at.TERMS)]
                code.store(at.END + i, self._horner(code, terms, h), wide=wide)
        return code

    def _store(self, code: Code, series: Series, nodes: Sequence[Node], first: int) -> None:
        """Store values of nodes, and their tangents."""
        slopes = derivative(nodes, self._seeds) if self.width else [None] * len(nodes)
        for i, (node, slope) in enumerate(zip(nodes, slopes, strict=True)):
            code.store(first + i, series.value(node))
            if self.width:
                value = code.constant(0.0) if slope is None else series.value(slope)
                code.store(first + i, value, wide=True)

    def _look(self) -> Code:
        code, system = Code(width=self.width), self.system
        series = self._series(code, {}, {})
        for i, rate in enumerate(system.sliding_rates):
            code.store(at.RATE + i, series.value(rate))
        for i, alpha in enumerate(system.alphas):
            code.store(at.ALPHA + i, series.value(alpha))
        self._store(code, series, system.guards, at.EXCESS)
        for i, guard in enumerate(system.guards):
            code.store(at.EXCESS_RATE + i, series.value(rate_of(system, guard, system.sliding_rates)))
        return code

    def _row(self) -> Code:
        code, system = Code(width=self.width), self.system
        there = {name: code.load(at.END + i) for i, name in enumerate(system.states)}
        if self.width:
            there |= {f"d {name}": code.load(at.END + i, wide=True) for i, name in enumerate(system.states)}
        self._store(code, self._series(code, there, {}, clock=code.load(at.ELAPSED)), system.sliding_outputs, at.OUT)
        return code
