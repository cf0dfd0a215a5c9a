"""From a machine to the functions that its integrator calls.

    move g   one step in a group of modes: Taylor series, step size, states at its end, what must not become negative
    at       the states at some time within the step
    look     there: rates, guards and switches with their rates, and both sides of what may slide
    row      there: the outputs
    enter    what the modes in force mean: which transitions may happen, and the group
    jump t   what a transition does

With directions of derivatives each carries the tangents of what it computes along (the variational equations).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

from valve_sim.model.core.code import Code, Value
from valve_sim.model.core.hybrid import layout as at
from valve_sim.model.core.hybrid.description import TIME, Transition, mode_in, slope_of
from valve_sim.model.core.hybrid.system import GROUP, EquationsError, Group, System, slides
from valve_sim.model.core.polynomials import FINE
from valve_sim.model.core.series import Series
from valve_sim.model.core.tracer import Node, ancestors, derivative

SAFETY: Final = 0.1
"""Of the tolerance: many steps add up."""
CHECKED_AT: Final = (0.5, 1.0)
"""Fractions of a step at which its series is compared with the equation."""
SMALLEST: Final = 1e-6
"""SI: errors of smaller states are held absolutely, at 1e-6 TOLERANCE: below what any sensor shows, above rounding."""
FARTHEST: Final = 1e3
"""Times its size that a state may move in a step: a series that ends has no other bound, and rounding hides guards."""
FAR: Final = 60.0
"""The logarithm to base 2 of a time, s, that no step comes to: that of the power of an error of 0 has no end."""
OF_TERMS, OF_DRIFT = 1e-15, 1e-12
"""Of the sizes of what is added up: the rounding error of a sum, and that of one which a state has slid along."""


class _Watch(NamedTuple):
    """Something that must not become negative within a step.

    Attributes:
        node: it, where the flag of a switch says so its negative. event: of `layout`. mask: the slot of what is added.
        flag: the slot of the flag; None: it has none.
    """

    node: Node
    event: int
    mask: int
    flag: int | None = None


class Kernels:
    """The kernels of one machine.

    Args:
        system: what follows from its description. free: names of parameters that derivatives are taken to.
        width: directions of derivatives; 0 for none.

    Attributes:
        slots: of all states and numbers, by name.
    """

    def __init__(self, system: System, free: Sequence[str], width: int) -> None:
        self.system, self.width = system, width
        description, trace = system.description, system.trace
        self.slots = {TIME: at.TIME, GROUP: at.BASE_GROUP}
        for first, names in (
            (at.STATE, description.states), (at.INPUT, description.inputs),
            (at.SLOPE, [slope_of(name) for name in description.inputs]), (at.HELD, list(description.held)),
            (at.MODE, [mode_in(name) for name in description.regions]), (at.NUMBERS, description.parameters),
            (at.SLIDES, [slides(k) for k in range(len(system.sliders))]),
        ):  # fmt: skip
            self.slots |= {name: first + i for i, name in enumerate(names)}
        self._flags = {guard: at.FLAG + i for i, guard in enumerate(system.switches)}
        self._seeds: dict[Node, Node] = {}
        if width:
            self._seeds = {trace.state(name): trace.state(f"d {name}") for name in description.states}
            numbers = (*free, *description.held, *description.inputs)
            self._seeds |= {trace.number(name): trace.number(f"d {name}") for name in numbers}

    def text(self) -> str:
        """All kernels, as text of LLVM."""
        codes = {"at": self._at(), "look": self._look(), "row": self._row(), "enter": self._enter()}
        for g, group in enumerate(self.system.groups):
            codes[f"move{2 * g}"] = self._move(group, group.flow.free)
            if group.flow.shares:
                codes[f"move{2 * g + 1}"] = self._move(group, group.flow.sliding)
        for t, transition in enumerate(self.system.description.transitions):
            codes[f"jump{t}"] = self._jump(transition)
        declared = sorted(set().union(*(code.declared for code in codes.values())))
        return "\n".join([*declared, *(code.function(name) for name, code in codes.items())])

    # -- what is shared ------------------------------------------------------------------------------------------------

    def _series(
        self, code: Code, start: Mapping[str, Value], rates: Mapping[str, Node], *, clock: Value | None = None,
        decides: bool = False,
    ) -> Series:  # fmt: skip
        return Series(code, self.slots.__getitem__, start, rates, self._flags, clock=clock, decides=decides)

    def _with_tangents(self, nodes: Mapping[str, Node]) -> dict[str, Node]:
        """Some nodes by name, and their tangents but for those that are 0."""
        if not self.width:
            return dict(nodes)
        slopes = derivative(nodes.values(), self._seeds)
        return {**nodes, **{f"d {name}": s for name, s in zip(nodes, slopes, strict=True) if s is not None}}

    def _store(self, code: Code, series: Series, first: int, nodes: Sequence[Node], *, wide: bool = True) -> None:
        """Store values of nodes, and their tangents if `wide`."""
        wide &= bool(self.width)
        slopes = derivative(nodes, self._seeds) if wide else [None] * len(nodes)
        for i, (node, slope) in enumerate(zip(nodes, slopes, strict=True)):
            code.store(first + i, series.value(node))
            if wide:
                code.store(first + i, code.constant(0.0) if slope is None else series.value(slope), wide=True)

    def _there(self, code: Code, names: Iterable[str], h: Value) -> dict[str, Value]:
        """States at a time within the step, with their tangents, from its series."""
        found = {}
        for name in names:
            first = at.SERIES + self.system.description.states.index(name) * at.TERMS
            for wide in (False, True) if self.width else (False,):
                terms = [code.load(first + k, wide=wide) for k in range(at.TERMS)]
                found[f"d {name}" if wide else name] = _horner(code, terms, h)
        return found

    # -- a step --------------------------------------------------------------------------------------------------------

    def _move(self, group: Group, rates: Mapping[str, Node]) -> Code:
        code, trace = Code(width=self.width), self.system.trace
        series = self._series(code, {}, self._with_tangents(rates))
        zero = code.constant(0.0)
        stored: dict[str, list[Value]] = {}
        for i, name in enumerate(rates):
            for wide in (False, True) if self.width else (False,):
                key = f"d {name}" if wide else name
                own = [series.coefficient(trace.state(key), k) or zero for k in range(at.TERMS)]
                stored[key] = own
                for k, value in enumerate(own):
                    code.store(at.SERIES + i * at.TERMS + k, value, wide=wide)
        watches = self._watches(group, is_sliding=rates is group.flow.sliding)
        watched = []
        for watch in watches:
            own = [series.coefficient(watch.node, k) or zero for k in range(at.TERMS)]
            if watch.flag is not None:
                holds = series.condition(watch.node)
                own = [code.select(holds, c, code.neg(c)) for c in own]
            watched.append([code.add(own[0], code.load(watch.mask)), *own[1:]])
        step = self._step(code, stored, rates)
        code.store(at.STEP, step)
        for i, name in enumerate(rates):
            for wide in (False, True) if self.width else (False,):
                terms = stored[f"d {name}" if wide else name]
                code.store(at.END + i, _horner(code, terms, step), wide=wide)
        powers = [code.constant(1.0), step]
        for order in range(2, at.TERMS):
            powers.append(code.mul(powers[order // 2], powers[order - order // 2]))
        suspect = code.constant(0.0)
        for place, (watch, own) in enumerate(zip(watches, watched, strict=True)):
            margin = _margin(code, own, powers)
            slot = at.WATCH + at.WATCH_SLOTS * place
            code.store(slot, margin)
            code.store(slot + 1, code.constant(float(watch.event)))
            code.store(slot + 2, self._rounding(code, series, watch.node))
            for k, value in enumerate(own):
                code.store(at.WATCH_SERIES + place * at.TERMS + k, value)
            suspect = code.select(code.compare("ogt", margin, zero), suspect, code.constant(1.0))
        code.store(at.SUSPECT, suspect)
        code.store(at.WATCHES, code.constant(float(len(watches))))
        code.store(at.DEFECT, self._defect(code, step, stored, rates))
        return code

    def _watches(self, group: Group, *, is_sliding: bool) -> list[_Watch]:
        """What must not become negative in a step: guards' negatives, switches on their side, and shares' bounds."""
        system, found = self.system, list[_Watch]()
        transitions = system.description.transitions
        guards = [transition.guard for transition in transitions]
        shares = group.flow.shares if is_sliding else {}
        used = [*group.flow.free.values(), *system.description.outputs.values()]
        for index, (transition, guard) in enumerate(zip(transitions, system.mixed(guards, shares), strict=True)):
            if transition.region is None or group.modes[transition.region].intersection(transition.modes):
                found.append(_Watch(-guard, at.OF_TRANSITION + index, at.MASK + index))
                used.append(transition.guard)
        picked = {node.args[0] for node in ancestors(used) if node.op == "pick"}
        for index, switch in enumerate(system.switches):
            if switch in picked:
                found.append(_Watch(switch, at.OF_SWITCH + index, at.SWITCH_MASK + index, at.FLAG + index))
        for k, share in shares.items():
            exit_of = at.OF_EXIT + 2 * k
            found += [_Watch(1.0 - share, exit_of, at.SLIDER_MASK + k), _Watch(share, exit_of + 1, at.SLIDER_MASK + k)]
        if len(found) > at.MOST_WATCHES:
            raise EquationsError(
                f"found {len(found)} guards and switches in one mode, expected at most {at.MOST_WATCHES}"
            )
        return found

    def _rounding(self, code: Code, series: Series, node: Node) -> Value:
        """Below what size the sign of an expression is that of its rounding: its terms may be large, itself small.

        Along a switch on which it slid it has drifted by rounding of states as large as they have been.
        """
        has_slid = node in [self.system.switches[switch] for switch in self.system.sliders]
        sizes: dict[Node, Value] = {}
        for own in sorted(ancestors([node]), key=lambda one: one.index):
            if own.op in ("add", "sub"):
                sizes[own] = code.add(sizes[own.args[0]], sizes[own.args[1]])
            elif own.op == "neg":
                sizes[own] = sizes[own.args[0]]
            else:
                sizes[own] = code.call("fabs", series.value(own))
                if has_slid and own.op == "state":
                    place = self.system.description.states.index(str(own.payload))
                    sizes[own] = code.larger(code.load(at.PEAK + place), sizes[own])
        return code.mul(sizes[node], code.constant(OF_DRIFT if has_slid else OF_TERMS))

    def _scale(self, code: Code, place: int, first: Value) -> Value:
        """Of what the errors of a state are relative to: the largest size that it has had so far."""
        scale = code.larger(code.load(at.PEAK + place), code.call("fabs", first))
        return code.larger(scale, code.constant(SMALLEST))

    def _step(self, code: Code, stored: Mapping[str, Sequence[Value]], rates: Mapping[str, Node]) -> Value:
        """The step at which the last two terms of each state's series are as large as its tolerance."""
        tolerance, least = code.load(at.TOLERANCE), code.constant(FAR)
        for i, name in enumerate(rates):
            scale = self._scale(code, i, stored[name][0])
            tolerated = code.rough_log2(code.mul(code.mul(tolerance, scale), code.constant(SAFETY)))
            farthest = code.rough_log2(code.mul(scale, code.constant(FARTHEST)))
            for allowed, order in ((farthest, 1), (farthest, 2), (tolerated, at.ORDER - 1), (tolerated, at.ORDER)):
                if stored[name][order].text.startswith("%"):
                    term = code.rough_log2(code.call("fabs", stored[name][order]))
                    exponent = code.mul(code.sub(allowed, term), code.constant(1.0 / order))
                    least = code.smaller(exponent, least)
        return code.smaller(code.rough_exp2(least), code.load(at.LONGEST))

    def _defect(
        self, code: Code, step: Value, stored: Mapping[str, Sequence[Value]], rates: Mapping[str, Node]
    ) -> Value:
        """How far the series is off its equation within a step, over what is tolerated."""
        worst, checked = code.constant(0.0), self.system.checked
        for fraction in CHECKED_AT if checked else ():
            h = code.mul(step, code.constant(fraction))
            series = self._series(code, {name: _horner(code, stored[name], h) for name in rates}, {}, clock=h)
            for i, (name, rate) in enumerate(rates.items()):
                if name in checked:
                    terms = [code.mul(c, code.constant(float(k))) for k, c in enumerate(stored[name]) if k]
                    off = code.call("fabs", code.sub(series.value(rate), _horner(code, terms, h)))
                    tolerated = code.mul(code.load(at.TOLERANCE), self._scale(code, i, stored[name][0]))
                    worst = code.larger(code.div(code.mul(off, step), tolerated), worst)
        return worst

    # -- within a step -------------------------------------------------------------------------------------------------

    def _at(self) -> Code:
        code, names = Code(width=self.width), self.system.description.states
        there = self._there(code, names, code.load(at.ELAPSED))
        for i, name in enumerate(names):
            code.store(at.END + i, there[name])
            if self.width:
                code.store(at.END + i, there[f"d {name}"], wide=True)
        return code

    def _look(self) -> Code:
        code, system = Code(width=self.width), self.system
        there = {}
        for i, name in enumerate(system.description.states):
            there[name] = code.load(at.END + i)
            if self.width:
                there[f"d {name}"] = code.load(at.END + i, wide=True)
        series, flow = self._series(code, there, {}, clock=code.load(at.ELAPSED)), system.flow
        self._store(code, series, at.RATE, list(flow.sliding.values()), wide=False)
        self._store(code, series, at.GUARD, system.guards)
        self._store(code, series, at.GUARD_RATE, [system.rate_of(own) for own in system.guards], wide=False)
        self._store(code, series, at.EXCESS, system.switches)
        for j, guard in enumerate(system.switches):
            code.store(at.UNSURE + j, self._rounding(code, series, guard))
        self._store(code, series, at.EXCESS_RATE, [system.rate_of(own) for own in system.switches], wide=False)
        for k, switch in enumerate(system.sliders):
            slides_now = code.compare("ogt", code.load(at.SLIDES + k), code.constant(0.5))
            share = series.value(flow.shares[k])
            sides = system.sides(system.switches[switch], flow.sliding)
            beyond = code.sub(share, code.constant(1.0)), share
            for slot, side, bound in zip((at.ABOVE, at.BELOW), sides, beyond, strict=True):
                code.store(slot + k, code.select(slides_now, bound, series.value(side)))
            if len(system.sliders) > 1:
                above, below = system.sides(system.switches[switch], flow.free)
                code.store(at.SPAN + k, series.value(below - above))
        return code

    def _row(self) -> Code:
        code, system = Code(width=self.width), self.system
        h = code.load(at.ELAPSED)
        used = {str(node.payload) for node in ancestors(system.outputs) if node.op == "state"}
        there = self._there(code, [name for name in system.description.states if name in used], h)
        self._store(code, self._series(code, there, {}, clock=h), at.OUT, system.outputs)
        return code

    # -- modes ---------------------------------------------------------------------------------------------------------

    def _in(self, code: Code, region: str, modes: Iterable[str]) -> Value:
        """Whether one of some modes is in force."""
        found, names = None, list(self.system.description.regions[region])
        for name in modes:
            number = code.constant(float(names.index(name)))
            one = code.compare("oeq", code.load(self.slots[mode_in(region)]), number)
            found = one if found is None else code.either(found, one)
        assert found is not None
        return found

    def _enter(self) -> Code:
        code, description = Code(), self.system.description
        zero = code.constant(0.0)
        for index, transition in enumerate(description.transitions):
            mask = zero
            if transition.region is not None:
                may = self._in(code, transition.region, transition.modes)
                mask = code.select(may, zero, code.constant(at.HUGE))
            code.store(at.MASK + index, mask)
        number = zero
        for place, group in enumerate(self.system.groups):
            holds = None
            for region, modes in group.modes.items():
                one = self._in(code, region, sorted(modes))
                holds = one if holds is None else code.both(holds, one)
            if holds is not None:
                number = code.select(holds, code.constant(float(place)), number)
        code.store(at.BASE_GROUP, number)
        return code

    def _jump(self, transition: Transition[Node]) -> Code:
        code, trace, description = Code(width=self.width), self.system.trace, self.system.description
        series = self._series(code, {}, {}, decides=True)
        seeds = dict(self._seeds)
        if self.width:  # an event's time moves, and inputs with it
            moved = trace.number(f"d {TIME}")
            seeds[trace.number(TIME)] = moved
            seeds |= {trace.number(name): trace.number(slope_of(name)) * moved for name in description.inputs}
        targets = {name: None for case in transition.cases for name in case.sets}
        slots = [self.slots[name] for name in targets]
        slots += [self.slots[mode_in(name)] for name in {name: None for case in transition.cases for name in case.to}]
        old = {slot: code.load(slot) for slot in slots}
        new = dict(old)
        wide_old = {slot: code.load(slot, wide=True) for slot in slots[: len(targets)] if self.width}
        wide_new = dict(wide_old)
        taken = code.constant(0.0)
        holds_of = [None if case.when is None else series.condition(case.when) for case in transition.cases]
        for number, (case, holds) in reversed(list(enumerate(zip(transition.cases, holds_of, strict=True)))):
            sets = {self.slots[name]: node for name, node in case.sets.items()}
            for region, mode in case.to.items():
                place = float(list(description.regions[region]).index(mode))
                sets[self.slots[mode_in(region)]] = trace.constant(place)
            slopes = dict(zip(sets, derivative(sets.values(), seeds), strict=True)) if self.width else {}
            taken = _chosen(code, holds, code.constant(float(number)), taken)
            for slot in slots:
                new[slot] = _chosen(code, holds, series.value(sets[slot]) if slot in sets else old[slot], new[slot])
                if slot in wide_old:
                    slope = slopes.get(slot)
                    value = wide_old[slot]
                    if slot in sets:
                        value = code.repeated(code.constant(0.0) if slope is None else series.value(slope))
                    wide_new[slot] = _chosen(code, holds, value, wide_new[slot])
        for slot, value in new.items():
            code.store(slot, value)
        for slot, value in wide_new.items():
            code.store(slot, value, wide=True)
        code.store(at.CASE, taken)
        return code


def _chosen(code: Code, holds: Value | None, value: Value, other: Value) -> Value:
    return value if holds is None else code.select(holds, value, other)


def _horner(code: Code, coefficients: Sequence[Value], h: Value) -> Value:
    total = coefficients[-1]
    for c in reversed(coefficients[:-1]):
        total = code.fma(total, h, c)
    return total


def _margin(code: Code, coefficients: Sequence[Value], powers: Sequence[Value]) -> Value:
    """By how much a polynomial is sure to stay above 0 up to the end of a step.

    The smallest Bernstein coefficient of its first terms, less the size of the others.
    """
    terms = [code.mul(c, h) for c, h in zip(coefficients, powers, strict=True)]
    others = code.constant(0.0)
    for term in terms[FINE + 1 :]:
        others = code.add(others, code.call("fabs", term))
    least = code.constant(0.0)
    for j in range(1, FINE + 1):
        total = code.mul(terms[1], code.constant(j / FINE))
        for i in range(2, j + 1):
            total = code.fma(terms[i], code.constant(math.comb(j, i) / math.comb(FINE, i)), total)
        least = code.smaller(least, total)
    return code.add(terms[0], code.sub(least, others))
