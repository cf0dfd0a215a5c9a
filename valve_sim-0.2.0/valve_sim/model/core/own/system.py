"""The equations of a machine as a graph, with what its integrator needs: switches, and sliding along them.

A comparison of what varies is a switch: an event, located exactly. Where the rates of change on its two sides both
point at it, the state slides along it (dry friction holds): with f⁺ and f⁻ the rates on either side, the machine
follows α f⁺ + (1 − α) f⁻ with the α between 0 and 1 that keeps the switch's excess e at 0 (Filippov 1988, section 4),

    ė(f⁻) + α (ė(f⁺) − ė(f⁻)) = 0,                                                                          (1)

and leaves it where α reaches 0 or 1. Several switches that slide at once have one linear equation each.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

from valve_sim.model.core.own.grammar import Expr, evaluate
from valve_sim.model.core.tracer import (
    Node,
    Trace,
    ancestors,
    cos,
    derivative,
    exp,
    log,
    polynomial,
    sin,
    tanh,
    where,
)
from valve_sim.model.errors import ValveError

MOST_STATES: Final = 12
MOST_SLIDING: Final = 4
TIME: Final = "time"
"""The name of the time at the start of a step among the numbers; in expressions it is `t` or `time`."""


class EquationsError(ValveError):
    """Equations that the integrator cannot take."""


@dataclass(frozen=True)
class Equations:
    """What a machine's equations are, with the effects that are on.

    Attributes:
        derivatives: of the states, by name. outputs: by name.
        inputs: names of what drives it. parameters: names of its numbers.
    """

    derivatives: Mapping[str, Expr]
    outputs: Mapping[str, Expr]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]


@dataclass
class System:
    """The graph of a machine.

    Attributes:
        states: their names. rates: (n,) free of sliding; sliding_rates: with it.
        outputs: likewise, by name. guards: excesses of the comparisons. sliding: indices of the guards along which it
            may slide. alphas: of these, equation (1), in their order. snaps: of these, the state that is the excess
            itself, which is exactly 0 while it slides; None for another excess.
        is_nonlinear: whether the series must be compared with the equation.
    """

    trace: Trace
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    parameters: tuple[str, ...]
    rates: list[Node] = field(default_factory=list)
    outputs: list[Node] = field(default_factory=list)
    guards: list[Node] = field(default_factory=list)
    sliding: list[int] = field(default_factory=list)
    alphas: list[Node] = field(default_factory=list)
    sliding_rates: list[Node] = field(default_factory=list)
    sliding_outputs: list[Node] = field(default_factory=list)
    snaps: list[str | None] = field(default_factory=list)
    is_nonlinear: bool = False


def build(equations: Equations) -> System:
    """The graph of a machine.

    Raises:
        EquationsError: it slides along too many switches at once.
    """
    trace = Trace()
    t = trace.number(TIME) + trace.clock()
    values: dict[str, Node] = {"t": t, TIME: t}
    for name in equations.inputs:
        values[name] = trace.number(name) + trace.number(f"{name} slope") * trace.clock()
    values.update({name: trace.number(name) for name in equations.parameters})
    values.update({name: trace.state(name) for name in equations.derivatives})
    system = System(trace, tuple(equations.derivatives), equations.inputs, equations.parameters)
    system.rates = [trace.lift(evaluate(own, values)) for own in equations.derivatives.values()]
    system.outputs = [trace.lift(evaluate(own, values)) for own in equations.outputs.values()]
    used = ancestors([*system.rates, *system.outputs])
    system.guards = [guard for guard in trace.guards() if any(guard in node.args[:1] for node in used)]
    _slide(system)
    system.is_nonlinear = any(
        node.op in ("exp", "log", "power", "sin", "cos", "tanh", "div") and not node.steady for node in used
    )
    return system


def _slide(system: System) -> None:
    """Equation (1) of the switches along which the machine may slide."""
    trace = system.trace

    above: list[list[Node]] = []
    for index, guard in enumerate(system.guards):
        upper = substituted(system.rates, {guard: True})
        lower = substituted(system.rates, {guard: False})
        if rate_of(system, guard, upper) is rate_of(system, guard, lower):
            continue
        system.sliding.append(index)
        above.append(substituted([*system.rates, *system.outputs], {guard: True}))
        is_state = guard.op == "state"
        system.snaps.append(str(guard.payload) if is_state else None)
    if len(system.sliding) > MOST_SLIDING:
        raise EquationsError(
            f"found {len(system.sliding)} switches along which the machine may stick, expected at most {MOST_SLIDING}; "
            "smooth some of them: tanh(v/small) in place of sign(v)"
        )
    if not system.sliding:
        system.sliding_rates, system.sliding_outputs = system.rates, system.outputs
        return
    plain = [*system.rates, *system.outputs]
    count = len(system.rates)
    guards = [system.guards[index] for index in system.sliding]
    held = [trace.number(f"slides {index}") > 0.5 for index in system.sliding]
    zero, one = trace.constant(0.0), trace.constant(1.0)
    matrix: list[list[Node]] = []
    right: list[Node] = []
    for row, guard in enumerate(guards):
        rest = rate_of(system, guard, plain[:count])
        entries = [
            where(held[row], rate_of(system, guard, upper[:count]) - rest, one if column == row else zero)
            for column, upper in enumerate(above)
        ]
        matrix.append(entries)
        right.append(where(held[row], -rest, zero))
    system.alphas = _solved(matrix, right)
    mixed = []
    for place, node in enumerate(plain):
        total = node
        for k, upper in enumerate(above):
            if upper[place] is not node:
                total = total + where(held[k], system.alphas[k] * (upper[place] - node), zero)
        mixed.append(total)
    for k, name in enumerate(system.snaps):
        if name is not None:  # what is held at 0 stays there to the last bit
            place = system.states.index(name)
            mixed[place] = where(held[k], zero, mixed[place])
    system.sliding_rates, system.sliding_outputs = mixed[:count], mixed[count:]


def _solved(matrix: list[list[Node]], right: list[Node]) -> list[Node]:
    """The solution of linear equations, by elimination without pivots: rows that do not slide are those of identity."""
    size = len(right)
    a, b = [list(row) for row in matrix], list(right)
    for k in range(size):
        for i in range(k + 1, size):
            factor = a[i][k] / a[k][k]
            for j in range(k + 1, size):
                a[i][j] = a[i][j] - factor * a[k][j]
            b[i] = b[i] - factor * b[k]
    found: list[Node] = [right[0]] * size
    for k in reversed(range(size)):
        total = b[k]
        for j in range(k + 1, size):
            total = total - a[k][j] * found[j]
        found[k] = total / a[k][k]
    return found


def rate_of(system: System, node: Node, rates: Sequence[Node]) -> Node:
    """The rate of change of an expression, given those of the states."""
    trace = system.trace
    seeds = {trace.state(name): rate for name, rate in zip(system.states, rates, strict=True)}
    seeds[trace.clock()] = trace.constant(1.0)
    (found,) = derivative([node], seeds)
    return trace.constant(0.0) if found is None else found


def substituted(nodes: Iterable[Node], decided: Mapping[Node, bool]) -> list[Node]:
    """Expressions in which some comparisons are decided."""
    nodes = list(nodes)
    known: dict[Node, Node] = {}
    for node in sorted(ancestors(nodes), key=lambda one: one.index):
        known[node] = _rebuilt(node, [known[own] for own in node.args], decided)
    return [known[node] for node in nodes]


def _rebuilt(node: Node, args: list[Node], decided: Mapping[Node, bool]) -> Node:
    if node.op == "pick":
        excess = node.args[0]
        if excess in decided:
            return args[1] if decided[excess] else args[2]
        if args[0] is not excess:
            return where(args[0] > 0.0, args[1], args[2])
    if all(new is old for new, old in zip(args, node.args, strict=True)):
        return node
    return _OPERATIONS[node.op](node, args)


_OPERATIONS: Final[Mapping[str, Callable[[Node, list[Node]], Node]]] = {
    "pick": lambda node, a: a[1] if a[1] is a[2] else node.trace.node("pick", *a),
    "add": lambda node, a: a[0] + a[1],
    "sub": lambda node, a: a[0] - a[1],
    "neg": lambda node, a: -a[0],
    "mul": lambda node, a: a[0] * a[1],
    "div": lambda node, a: a[0] / a[1],
    "power": lambda node, a: a[0] ** float(str(node.payload)),
    "polynomial": lambda node, a: polynomial(a[0], *a[1:]),
    "exp": lambda node, a: exp(a[0]),
    "log": lambda node, a: log(a[0]),
    "sin": lambda node, a: sin(a[0]),
    "cos": lambda node, a: cos(a[0]),
    "tanh": lambda node, a: tanh(a[0]),
}
"""The function that applies each operation to other arguments."""
