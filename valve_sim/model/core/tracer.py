"""Equations as graphs: expressions that remember how they were made.

Equations and effects are ordinary Python expressions. Evaluated with the symbols of a `Trace` in place of numbers
they leave a graph behind, in which equal expressions are one node. What the integrator needs follows from the graph:
`derivative` gives the gradient where an equation asks for one, and the tangents of everything to any parameters;
`series` turns a graph into the recurrences of its Taylor coefficients.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any, Final, NamedTuple, TypeAlias

import numpy as np

from valve_sim.model.errors import ParameterError

_OF_MOTION: Final = ("x", "v", "d x", "d v")


class Node:
    """One expression of a graph; arithmetic on it makes others.

    Attributes:
        trace: the graph that it belongs to.
        op: what makes it of its arguments: "constant", "number", "state", "clock", or an operation.
        args: the nodes that it is made of.
        payload: the value of a constant, the name of a number or state, the exponent of a power.
        index: its place in the order of making, which puts arguments before what is made of them.
        steady: whether it stays constant throughout a step.
        wide: whether it holds one value for each direction of a derivative, and not a single one.
        late: whether it varies with the motion: its coefficients are then known after those of the coil.
    """

    __slots__ = ("args", "index", "late", "op", "payload", "steady", "trace", "wide")

    def __init__(self, trace: Trace, op: str, args: tuple[Node, ...], payload: object, index: int) -> None:
        self.trace, self.op, self.args, self.payload, self.index = trace, op, args, payload, index
        self.steady: bool = op not in ("state", "clock") and all(argument.steady for argument in args)
        is_tangent = op in ("number", "state") and str(payload).startswith("d ")
        self.wide: bool = is_tangent or any(argument.wide for argument in args)
        self.late: bool = (op == "state" and payload in _OF_MOTION) or any(argument.late for argument in args)

    @property
    def value(self) -> float | None:
        """The number that a constant stands for; None for any other node."""
        return float(self.payload) if self.op == "constant" else None  # type: ignore[arg-type]

    def __add__(self, other: Expression) -> Node:
        a, b = self, self.trace.lift(other)
        if a.value is not None and b.value is not None:
            return self.trace.constant(a.value + b.value)
        if a.value == 0.0:
            return b
        if b.value == 0.0:
            return a
        if b.op == "neg":
            return a - b.args[0]
        return self.trace.node("add", *sorted((a, b), key=_made))

    def __radd__(self, other: float) -> Node:
        return self + other

    def __sub__(self, other: Expression) -> Node:
        a, b = self, self.trace.lift(other)
        if a.value is not None and b.value is not None:
            return self.trace.constant(a.value - b.value)
        if a.value == 0.0:
            return -b
        if b.value == 0.0:
            return a
        if b.op == "neg":
            return a + b.args[0]
        return self.trace.node("sub", a, b)

    def __rsub__(self, other: float) -> Node:
        return self.trace.lift(other) - self

    def __neg__(self) -> Node:
        if self.value is not None:
            return self.trace.constant(-self.value)
        return self.args[0] if self.op == "neg" else self.trace.node("neg", self)

    def __mul__(self, other: Expression) -> Node:
        a, b = self, self.trace.lift(other)
        if b.value is not None:
            a, b = b, a
        if a.value is not None:
            return self.trace.constant(a.value * b.value) if b.value is not None else _scaled(b, a.value)
        if a.op == "neg":
            return -(a.args[0] * b)
        if b.op == "neg":
            return -(a * b.args[0])
        return self.trace.node("mul", *sorted((a, b), key=_made))

    def __rmul__(self, other: float) -> Node:
        return self * other

    def __truediv__(self, other: Expression) -> Node:
        a, b = self, self.trace.lift(other)
        if a.value == 0.0 or b.value == 1.0:
            return a
        if a.value is not None and b.value is not None:
            return self.trace.constant(a.value / b.value if b.value else math.inf)
        if b.value is not None:
            return a * (1.0 / b.value if b.value else math.inf)
        if b.steady and a.value != 1.0:
            return a * (1.0 / b)
        return self.trace.node("div", a, b)

    def __rtruediv__(self, other: float) -> Node:
        return self.trace.lift(other) / self

    def __pow__(self, exponent: float) -> Node:
        if isinstance(exponent, Node):
            raise ParameterError(
                "**: found an exponent that is an expression, expected a number; write exp(b * log(a))"
            )
        if exponent == 0:
            return self.trace.constant(1.0)
        if exponent == 1:
            return self
        if exponent == int(exponent) and 0 < exponent <= 8:
            half = self ** (int(exponent) // 2)
            return half * half * self if int(exponent) % 2 else half * half
        if exponent == int(exponent) and exponent < 0:
            return 1.0 / self ** (-exponent)
        if self.value is not None:
            return self.trace.constant(self.value**exponent)
        return self.trace.node("power", self, payload=float(exponent))

    def __abs__(self) -> Node:
        return maximum(self, -self)

    def __bool__(self) -> bool:
        raise ParameterError(
            "an expression was used as a condition of Python, expected where(a > b, y, z), maximum or minimum"
        )

    def __gt__(self, other: Expression) -> Condition:
        return Condition(self - other)

    def __lt__(self, other: Expression) -> Condition:
        return Condition(self.trace.lift(other) - self)

    __ge__, __le__ = __gt__, __lt__


class Condition(NamedTuple):
    """A comparison, which holds while its excess is above 0."""

    excess: Node

    def __bool__(self) -> bool:
        return bool(self.excess)  # refused, with the reason


Expression: TypeAlias = Node | float
"""What an equation may combine: nodes, and plain numbers."""


def _scaled(node: Node, factor: float) -> Node:
    """A node that is no constant, times a number."""
    if factor in (0.0, 1.0, -1.0):
        return (node.trace.constant(0.0), node, -node)[int(factor)]
    return node.trace.node("mul", *sorted((node, node.trace.constant(factor)), key=_made))


def _made(node: Node) -> int:
    return node.index


class Curve(NamedTuple):
    """A curve of uniform cubic B-splines, of which one interval at a time is in the equations.

    It keeps its value beyond its ends.

    Attributes:
        place: where it is read, in intervals from its first knot. intervals: how many there are.
        first: the name of its first coefficient; the others follow it among the parameters.
        low, high: what is above 0 within the interval: the place less its beginning, and its end less the place.
    """

    place: Node
    intervals: Node
    first: str
    low: Node
    high: Node


class Trace:
    """A graph: every distinct expression in it is one node.

    Attributes:
        nodes: in the order of making. curve: the curve of splines in it, if there is one.
    """

    def __init__(self) -> None:
        self._known: dict[tuple[object, ...], Node] = {}
        self.nodes: list[Node] = []
        self.curve: Curve | None = None

    def node(self, op: str, *args: Node, payload: object = None) -> Node:
        """The node of an operation, made if it is new."""
        key = (op, payload, *(argument.index for argument in args))
        found = self._known.get(key)
        if found is None:
            found = Node(self, op, args, payload, len(self.nodes))
            self._known[key] = found
            self.nodes.append(found)
        return found

    def constant(self, value: float) -> Node:
        """A number that is the same in all valves."""
        return self.node("constant", payload=float(value))

    def lift(self, value: Expression) -> Node:
        """The node of an expression, which may be a plain number."""
        return value if isinstance(value, Node) else self.constant(value)

    def number(self, name: str) -> Node:
        """A number that is constant throughout a step: a parameter, or something that only events change."""
        return self.node("number", payload=name)

    def state(self, name: str) -> Node:
        """A state, which varies within a step."""
        return self.node("state", payload=name)

    def clock(self) -> Node:
        """The time since the start of the step, s."""
        return self.node("clock")

    def guards(self) -> tuple[Node, ...]:
        """What must not change its sign within a step: the excesses of all comparisons between things that vary."""
        excesses = {node.args[0]: None for node in self.nodes if node.op == "pick" and not node.args[0].steady}
        return tuple(sorted(excesses, key=_made))

    def digest(self) -> str:
        """A text that is equal for equal graphs, and for no others."""
        content = hashlib.sha256()
        for node in self.nodes:
            content.update(f"{node.op} {node.payload!r} {[a.index for a in node.args]};".encode())
        return content.hexdigest()


def where(condition: Condition, if_so: Expression, if_not: Expression) -> Node:
    """The one expression while the condition holds, the other while not; an event where that changes."""
    excess = condition.excess
    trace = excess.trace
    a, b = trace.lift(if_so), trace.lift(if_not)
    if a is b:
        return a
    if excess.value is not None:
        return a if excess.value > 0.0 else b
    return trace.node("pick", excess, a, b)


def choice(condition: Condition, if_so: Expression, if_not: Expression) -> Node:
    """One of two expressions, as `where`, but without an event: they and their slopes are equal where they change."""
    excess = condition.excess
    a, b = excess.trace.lift(if_so), excess.trace.lift(if_not)
    if a is b:
        return a
    if excess.value is not None:
        return a if excess.value > 0.0 else b
    return excess.trace.node("choice", excess, a, b)


def maximum(a: Expression, b: Expression) -> Node:
    """The larger of two expressions."""
    a, b = _lifted(a, b)
    return where(a > b, a, b)


def minimum(a: Expression, b: Expression) -> Node:
    """The smaller of two expressions."""
    a, b = _lifted(a, b)
    return where(a > b, b, a)


def sign(a: Expression) -> Node:
    """The value 1 where an expression is above 0, else −1."""
    (a,) = _lifted(a)
    return where(a > 0.0, 1.0, -1.0)


def exp(a: Expression) -> Node:
    """The exponential function."""
    return _unary("exp", a)


def log(a: Expression) -> Node:
    """The natural logarithm."""
    return _unary("log", a)


def expm1(a: Expression) -> Node:
    """The exponential function less 1, exact near 0."""
    return _unary("expm1", a)


def log1p(a: Expression) -> Node:
    """The natural logarithm of 1 + a, exact near 0."""
    return _unary("log1p", a)


def sin(a: Expression) -> Node:
    """The sine of an angle in radians."""
    return _unary("sin", a)


def cos(a: Expression) -> Node:
    """The cosine of an angle in radians."""
    return _unary("cos", a)


def tanh(a: Expression) -> Node:
    """The hyperbolic tangent."""
    return _unary("tanh", a)


def sqrt(a: Expression) -> Node:
    """The square root."""
    (a,) = _lifted(a)
    return a**0.5


def polynomial(a: Node, *coefficients: Expression) -> Node:
    """The polynomial c_0 + c_1 a + c_2 a² + … whose coefficients are constant throughout a step.

    Its series is that of its derivative times a', so that a new coefficient of a is waited for once, and not once for
    each power.
    """
    lifted = [a.trace.lift(c) for c in coefficients]
    while len(lifted) > 1 and lifted[-1].value == 0.0:
        lifted.pop()
    if len(lifted) == 1:
        return lifted[0]
    if len(lifted) == 2:
        return lifted[0] + lifted[1] * a
    return a.trace.node("polynomial", a, *lifted)


def spline(place: Node, intervals: Node, first: str) -> Node:
    """A curve of uniform cubic B-splines; the knots are events. See `Curve` for the arguments.

    Raises:
        ParameterError: there is a curve of another place already.
    """
    trace = place.trace
    if trace.curve is not None and trace.curve.place is not place:
        raise ParameterError(f"{first}: found a second curve of splines, expected one; take one of the two out")
    low, high = place - trace.number("curve low"), trace.number("curve high") - place
    trace.curve = Curve(place, intervals, first, low, high)
    c = [trace.number(f"curve {power}") for power in range(4)]
    within = polynomial(place - trace.number("curve at"), *c)
    # The integrator exchanges the coefficients where either comparison ceases to hold, so that it always does.
    return where(Condition(low), where(Condition(high), within, c[0]), c[0])


def running_maximum(a: Node, so_far: Node) -> Node:
    """The largest value of an expression up to now.

    Args:
        a: the expression.
        so_far: the number that holds its largest value before this step.
    """
    return a.trace.node("pick", a.trace.node("rising", a, so_far), a, so_far)


def _lifted(*values: Expression) -> tuple[Node, ...]:
    traces = [value.trace for value in values if isinstance(value, Node)]
    if not traces:
        raise ParameterError("expected an expression of x, v, u, t or a parameter, found plain numbers alone")
    return tuple(traces[0].lift(value) for value in values)


def _unary(op: str, a: Expression) -> Node:
    (a,) = _lifted(a)
    if a.value is not None:
        return a.trace.constant(float(getattr(math, op)(a.value)))
    return a.trace.node(op, a)


def evaluate(nodes: Iterable[Node], values: Mapping[str, Any]) -> list[Any]:
    """Expressions as numbers, or arrays of them, by NumPy; for checks and tests.

    Args:
        nodes: the expressions. values: of the numbers and states that they are made of, by name; the clock is 0.
    """
    nodes, known = list(nodes), dict[Node, Any]()
    with np.errstate(all="ignore"):
        for node in sorted(ancestors(nodes), key=_made):
            if node.op in ("number", "state"):
                known[node] = values[str(node.payload)]
            else:
                known[node] = _EVALUATED[node.op](node, *(known[argument] for argument in node.args))
    return [known[node] for node in nodes]


_EVALUATED: Final[Mapping[str, Any]] = {
    "constant": lambda node: node.value,
    "clock": lambda node: 0.0,
    "add": lambda node, a, b: a + b,
    "sub": lambda node, a, b: a - b,
    "mul": lambda node, a, b: a * b,
    "div": lambda node, a, b: np.divide(a, b),
    "neg": lambda node, a: -a,
    "power": lambda node, a: np.power(a, node.payload),
    "polynomial": lambda node, a, *c: np.polynomial.polynomial.polyval(a, np.array(c)),
    "rising": lambda node, a, so_far: a - so_far,
    "pick": lambda node, excess, a, b: np.where(np.real(excess) > 0.0, a, b),
    "choice": lambda node, excess, a, b: np.where(np.real(excess) > 0.0, a, b),
    **{
        name: lambda node, a, name=name: getattr(np, name)(a)
        for name in ("exp", "log", "expm1", "log1p", "sin", "cos", "tanh")
    },
}
"""The NumPy function for each operation."""


def derivative(nodes: Iterable[Node], seeds: Mapping[Node, Node]) -> list[Node | None]:
    """Derivatives of expressions, given those of the symbols that they are made of.

    One function makes gradients (one symbol has the derivative 1), rates of change (states have their rates) and
    tangents (symbols have wide ones).

    Args:
        nodes: what to differentiate.
        seeds: symbol to its derivative; the others are constant.

    Returns:
        for each the derivative, or None where it is 0 whatever the numbers are.
    """
    known: dict[int, Node | None] = {}
    nodes = list(nodes)
    for node in sorted(ancestors(nodes), key=_made):
        known[node.index] = seeds[node] if node in seeds else _derived(node, known)
    return [known[node.index] for node in nodes]


def ancestors(nodes: Iterable[Node]) -> set[Node]:
    """All nodes that some nodes are made of, themselves included."""
    found: set[Node] = set()
    left = list(nodes)
    while left:
        node = left.pop()
        if node not in found:
            found.add(node)
            left.extend(node.args)
    return found


def _derived(node: Node, known: Mapping[int, Node | None]) -> Node | None:
    """The derivative of an operation, given those of its arguments."""
    slopes = [known[argument.index] for argument in node.args]
    if all(slope is None for slope in slopes):
        return None
    if node.op == "rising":
        return None  # a guard, which is not differentiated: events know what they change
    if node.op in ("pick", "choice"):
        zero = node.trace.constant(0.0)
        return node.trace.node(node.op, node.args[0], *(zero if slope is None else slope for slope in slopes[1:]))
    if node.op == "polynomial":
        return _derived_polynomial(node, slopes)
    return _sum(
        [None if slope is None else part(slope) for part, slope in zip(_PARTS[node.op](node), slopes, strict=True)]
    )


def polynomial_slope(node: Node) -> Node:
    """The derivative of a polynomial by its argument."""
    a, _, *others = node.args
    return polynomial(a, *(c * float(power) for power, c in enumerate(others, 1)))


def _derived_polynomial(node: Node, slopes: list[Node | None]) -> Node | None:
    of_a, *of_coefficients = slopes
    moved = None if of_a is None else of_a * polynomial_slope(node)
    if all(slope is None for slope in of_coefficients):
        return moved
    zero = node.trace.constant(0.0)
    changed = polynomial(node.args[0], *(zero if slope is None else slope for slope in of_coefficients))
    return _sum([changed, moved])


def _sum(terms: Iterable[Node | None]) -> Node | None:
    total: Node | None = None
    for term in terms:
        if term is not None:
            total = term if total is None else total + term
    return total


_Part: TypeAlias = Callable[[Node], Node]
"""The factor by which the derivative of one argument enters that of an operation."""


def _parts_of_mul(node: Node) -> tuple[_Part, ...]:
    a, b = node.args
    return (lambda slope: slope * b, lambda slope: slope * a)


def _parts_of_div(node: Node) -> tuple[_Part, ...]:
    _, b = node.args
    return (lambda slope: slope / b, lambda slope: -(slope * node) / b)


def _chained(inner: Callable[[Node, Node], Node]) -> Callable[[Node], tuple[_Part, ...]]:
    return lambda node: (lambda slope: slope * inner(node, node.args[0]),)


_PARTS: Final[Mapping[str, Callable[[Node], tuple[_Part, ...]]]] = {
    "add": lambda node: (lambda slope: slope, lambda slope: slope),
    "sub": lambda node: (lambda slope: slope, lambda slope: -slope),
    "neg": lambda node: (lambda slope: -slope,),
    "mul": _parts_of_mul,
    "div": _parts_of_div,
    "exp": _chained(lambda node, a: node),
    "log": _chained(lambda node, a: 1.0 / a),
    "expm1": _chained(lambda node, a: 1.0 + node),
    "log1p": _chained(lambda node, a: 1.0 / (1.0 + a)),
    "sin": _chained(lambda node, a: cos(a)),
    "cos": _chained(lambda node, a: -sin(a)),
    "tanh": _chained(lambda node, a: 1.0 - node * node),
    "power": _chained(lambda node, a: float(str(node.payload)) * a ** (float(str(node.payload)) - 1.0)),
}
"""For each operation what its derivative takes from that of each argument."""
