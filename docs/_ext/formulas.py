"""Expressions as LaTeX: the formulas of the reference are printed from the graphs that the simulator is made from.

So a page cannot say another formula than the one that is computed. Symbols are those of the paper where it has one;
a parameter of an effect goes by its name.
"""

from __future__ import annotations

import math
import operator
from collections import Counter
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Final, TypeAlias

from valve_sim.model.core.equations import NEUTRAL, build
from valve_sim.model.core.symbols import Effect, Motion, Own
from valve_sim.model.core.tracer import Condition, Node, Trace
from valve_sim.model.parameters import DECLARED

SYMBOLS: Final[Mapping[str, str]] = {
    "a0": "a_0", "a1": "a_1", "a2": "a_2", "a3": "a_3", "pilot_mass": "m_1", "moving_mass": "m_2",
    "pilot_damping": "c_1", "main_damping": "c_2", "spring_rate": "k", "spring_preload": "F_0", "pilot_gap": "g",
    "stroke": "s", "reference_voltage": r"V_\mathrm{ref}", "coil_time_constant": r"\tau", "coil_resistance": "R",
    "seat_load": r"F_\mathrm{seat}", "direction": r"\operatorname{sgn} v", "since": "(t - t_o)", "square": "u^2",
    "seen": "V", "temperature": "T",
}  # fmt: skip
"""How the numbers of the equations are written; any other goes by its name."""
CONDITIONS: Final[Mapping[str, tuple[str, str]]] = {
    "lifted": (r"\text{in Phase 2}", r"\text{in Phase 1}"),
    "beyond": (r"\text{while } x > s", r"\text{while } x \le s"),
    "direction": (r"\text{while opening}", r"\text{while closing}"),
    "blocked": (r"\text{while a diode blocks}", r"\text{otherwise}"),
}
"""What is said of the two branches of a choice, by the number that decides it."""
SHORTEST: Final = 1e-6
"""s: time constants are taken to be longer, so that no formula says what a coil does that follows at once."""
ROUNDING: Final = 1e-12
"""A number this near to a whole one, or to a fraction, is that."""
LARGEST_DENOMINATOR: Final = 12
"""Of the fractions that are written as such."""
Written: TypeAlias = tuple[str, int]
"""LaTeX, and how tightly it binds: a sum, a product, or a single thing."""
_SUM, _PRODUCT, _SINGLE = range(3)
_ARITHMETIC: Final[Mapping[str, Callable[..., Node]]] = {
    "add": operator.add, "sub": operator.sub, "mul": operator.mul, "div": operator.truediv, "neg": operator.neg,
}  # fmt: skip
_FUNCTIONS: Final = {"log": r"\ln", "sin": r"\sin", "cos": r"\cos", "tanh": r"\tanh"}


def equations_without_effects() -> list[str]:
    """The equations of motion of both phases, and that of the current, as LaTeX."""
    system = build(())
    lifted = (system.trace.number("lifted") > 0.5).excess
    phases = [(_decided(system.net, lifted, branch), mass) for branch, mass in ((2, "m_1"), (1, "m_2"))]
    return [rf"{mass} \dot v = {latex(net)}" for net, mass in phases] + [
        rf"\dot {name} = {latex(state.rate)}" for name, state in system.states.items()
    ]


def formulas_of(effect: Effect) -> list[str]:
    """What an effect adds to the equations, or changes in them, each formula as LaTeX.

    Returns:
        one for each of its force, dry friction, change of the square of the current, and declared values that it
        changes; of an effect of the coil the states that move by other equations with it. None where the value of a
        parameter decides which expressions the effect has, or where it acts on a sensor or a contact alone.
    """
    if effect.shapes:
        return []
    trace = Trace()
    own = Own(**{name: trace.number(name) for name in effect.names})
    numbers = Own(**{name: trace.number(name) for name in (*DECLARED, *NEUTRAL)})
    x, v, u, w, t = (trace.state(name) for name in "xvuwt")
    lifted, beyond = (Condition(trace.number(name)) for name in ("lifted", "beyond"))
    m = Motion(x, v, u, w, t, trace.number("since"), trace.number("direction"), lifted, beyond, numbers)
    found = []
    if effect.force is not None:
        found.append(f"F = {latex(effect.force(m, own))}")
    if effect.friction is not None:
        found.append(f"F_f = {latex(effect.friction(m, own))}")
    if effect.square is not None:
        found.append(rf"u^2 \;\to\; {latex(effect.square(trace.number('square'), own))}")
    for name, change in effect.changes.items():
        if name in DECLARED:
            before = numbers.named(name)
            found.append(rf"{latex(before)} \;\to\; {latex(trace.lift(change(before, own)))}")
    return found or _of_coil(effect)


def _of_coil(effect: Effect) -> list[str]:
    """The states of the coil that move by other equations than without an effect."""
    before = {name: latex(state.rate) for name, state in build(()).states.items()}
    rates = {name: latex(state.rate) for name, state in build((effect,)).states.items()}
    return [rf"\dot {SYMBOLS.get(name, name)} = {rate}" for name, rate in rates.items() if rate != before.get(name)]


def latex(node: Node) -> str:
    """An expression as LaTeX."""
    return _written(node)[0]


def _written(node: Node) -> Written:
    if node.op in _PRINTED:
        return _PRINTED[node.op](node)
    function = _FUNCTIONS.get(node.op, rf"\operatorname{{{node.op}}}")
    return rf"{function}\left({latex(node.args[0])}\right)", _SINGLE


def _within(node: Node, least: int) -> str:
    """An expression in brackets where it binds less tightly than what it stands in."""
    text, binds = _written(node)
    return text if binds >= least else rf"\left({text}\right)"


def _name(node: Node) -> Written:
    name = str(node.payload).rpartition(".")[2]
    if name in SYMBOLS or len(name) == 1:
        return SYMBOLS.get(name, name), _SINGLE
    return rf"\text{{{name.replace('_', ' ')}}}", _SINGLE


def _constant(node: Node) -> Written:
    value = node.value or 0.0
    return _number(value), _SUM if value < 0.0 else _SINGLE


def _number(value: float) -> str:
    turns, ratio = value / math.pi, Fraction(value).limit_denominator(LARGEST_DENOMINATOR)
    if turns and turns == round(turns):
        return rf"{turns:g} \pi"
    if ratio.denominator > 1 and abs(ratio - value) < ROUNDING:
        return rf"\tfrac{{{ratio.numerator}}}{{{ratio.denominator}}}"
    return f"{value:.10g}"


def _is_long(excess: Node) -> bool:
    """Whether a comparison asks if a time constant is long enough to be seen."""
    return excess.op == "sub" and 0.0 < (excess.args[1].value or 0.0) < SHORTEST


def _parts(node: Node, more: str, less: str, way: int = 1) -> Counter[Node]:
    """What a sum (add, sub) or a product (mul, div) is made of, and how often; negative: subtracted, or divided by."""
    if node.op == "neg" and less == "sub":
        return _parts(node.args[0], more, less, -way)
    if node.op == "pick" and _is_long(node.args[0]):
        return _parts(node.args[1], more, less, way)
    if node.op == "add" and more == "mul" and node.args[0] is node.args[1]:
        return _parts(node.args[0] * node.trace.node("constant", payload=2.0), more, less, way)
    if node.op not in (more, less):
        return Counter({node: way})
    found = _parts(node.args[0], more, less, way)
    for part, count in _parts(node.args[1], more, less, way if node.op == more else -way).items():
        found[part] += count
    return found


def _sum(node: Node) -> Written:
    """Terms with their signs: a positive one first, numbers of the valve before those of an effect."""
    terms = sorted(_parts(node, "add", "sub").items(), key=lambda term: (-term[1], str(term[0].payload) not in SYMBOLS))
    text = " ".join(
        rf"{'+' if times > 0 else '-'} {f'{abs(times)} ' if abs(times) > 1 else ''}{_within(term, _PRODUCT)}"
        for term, times in terms
        if times
    )
    return text.removeprefix("+ "), _SUM if len(terms) > 1 or terms[0][1] < 0 else _PRODUCT


def _product(node: Node) -> Written:
    """A fraction of factors: a number, then names, then states, each with its power."""
    parts = _parts(node, "mul", "div")
    number = math.prod(one.value**power for one, power in parts.items() if one.value is not None)
    found = sorted((item for item in parts.items() if item[0].value is None), key=lambda item: item[0].op == "state")
    above, below = (_multiplied([(one, way * power) for one, power in found if way * power > 0]) for way in (1, -1))
    if abs(number - 1.0) > ROUNDING or not above:
        above = rf"{_number(number)} \, {above}" if above else _number(number)
    return (rf"\frac{{{above}}}{{{below}}}" if below else above), _PRODUCT


def _multiplied(factors: list[tuple[Node, int]]) -> str:
    if len(factors) == 1 and factors[0][1] == 1:
        return latex(factors[0][0])
    return r" \, ".join(
        f"{{{_within(factor, _SINGLE)}}}^{power}" if power > 1 else _within(factor, _PRODUCT)
        for factor, power in factors
    )


def _power(node: Node) -> Written:
    if node.payload == 0.5:
        return rf"\sqrt{{{latex(node.args[0])}}}", _SINGLE
    return rf"{{{_within(node.args[0], _SINGLE)}}}^{{{node.payload:g}}}", _SINGLE


def _polynomial(node: Node) -> Written:
    place, *coefficients = node.args
    powers = ["", *(f"{_within(place, _SINGLE)}{f'^{n}' if n > 1 else ''}" for n in range(1, len(coefficients)))]
    terms = [
        rf"{_within(coefficient, _PRODUCT)} \, {power}".removesuffix(r" \, ")
        for coefficient, power in zip(coefficients, powers, strict=True)
        if coefficient.value != 0.0
    ]
    return " + ".join(terms), _SUM


def _pick(node: Node) -> Written:
    """A maximum or minimum of two, or one of two expressions by a condition."""
    excess, a, b = node.args
    if _is_long(excess):
        return _written(a)
    if excess in (a - b, b - a):
        function = r"\max" if excess is a - b else r"\min"
        return rf"{function}\left({latex(a)},\; {latex(b)}\right)", _SINGLE
    a, b = _decided(a, excess, 1), _decided(b, excess, 2)
    decides = excess.args[0] if excess.op == "sub" and excess.args[1].value is not None else excess
    yes, no = CONDITIONS.get(str(decides.payload)) or (rf"\text{{while }} {latex(excess)} > 0", r"\text{otherwise}")
    return rf"\begin{{cases}} {latex(a)} & {yes} \\ {latex(b)} & {no} \end{{cases}}", _PRODUCT


def _decided(node: Node, excess: Node, branch: int) -> Node:
    """An expression where a condition is known to hold (branch 1), or not to (2)."""
    if node.op == "pick" and node.args[0] is excess:
        return _decided(node.args[branch], excess, branch)
    args = [_decided(one, excess, branch) for one in node.args]
    if node.op in _ARITHMETIC:
        return _ARITHMETIC[node.op](*args)  # leaves out what is 0
    return node.trace.node(node.op, *args, payload=node.payload) if args else node


_PRINTED: Final[Mapping[str, Callable[[Node], Written]]] = {
    "number": _name,
    "state": _name,
    "constant": _constant,
    "add": _sum,
    "sub": _sum,
    "neg": _sum,
    "mul": _product,
    "div": _product,
    "exp": lambda node: (f"e^{{{latex(node.args[0])}}}", _SINGLE),
    "power": _power,
    "polynomial": _polynomial,
    "pick": _pick,
}
