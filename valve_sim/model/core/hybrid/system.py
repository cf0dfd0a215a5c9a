"""From a machine as data to what its kernels are made of: groups of modes, switches, and sliding along them.

Modes with the same flow are one group: a step's kernel is that of a group. A comparison of what varies is a switch: an
event, located exactly. Where the rates of change on its two sides both point at it, the state slides along it (dry
friction holds): with f⁺ and f⁻ the rates on either side, the machine follows f⁻ + α (f⁺ − f⁻) with the share α between
0 and 1 that keeps the switch's excess e at 0 (Filippov 1988, section 4),

    ė(f⁻) + α (ė(f⁺) − ė(f⁻)) = 0,                                                                          (1)

and leaves it where α reaches 0 or 1. Several switches that slide at once have one linear equation each. A switch that
these keep at 0, too, has none: its side stays as it is.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from valve_sim.model.core import tracer
from valve_sim.model.core.hybrid import layout as at
from valve_sim.model.core.hybrid.description import Description, Region
from valve_sim.model.core.tracer import Node, ancestors, derivative, where
from valve_sim.model.errors import ValveError

GROUP: Final = "group"
"""The name, among the numbers, of the group of modes that is in force."""
NONLINEAR: Final = ("div", "exp", "log", "power", "sin", "cos", "tanh")
"""Operations whose series may be off although its last terms are small."""


class EquationsError(ValveError):
    """Equations that the engine cannot take."""


@dataclass(frozen=True)
class Flow:
    """Rates of all states, a second, by name.

    Attributes:
        free: with every switch as its flag says. sliding: while the state slides along some switches.
        shares: α of equation (1), by the number of the slider.
    """

    free: Mapping[str, Node]
    sliding: Mapping[str, Node]
    shares: Mapping[int, Node]


@dataclass(frozen=True)
class Group:
    """Modes with one flow: of each region those that belong to it, by the region's name."""

    modes: Mapping[str, frozenset[str]]
    flow: Flow


class System:
    """What follows from a machine's description.

    Attributes:
        digest: of the description. groups: of modes with the same flow. flow: of whatever group is in force.
        switches: the excesses of all comparisons of what varies. sliders: the switches along which it may slide.
        guards: of the transitions, outputs: in their order, both while the state slides, too.
        checked: the states whose series must be compared with their equation.

    Raises:
        EquationsError: there is more of something than there is room for.
    """

    def __init__(self, description: Description) -> None:
        self.description, self.trace, self.digest = description, description.trace, description.digest()
        rates = self._rates_by_group()
        guards = [transition.guard for transition in description.transitions]
        outputs = list(description.outputs.values())
        used = ancestors([*(rate for _, own in rates for rate in own.values()), *guards, *outputs])
        picked = {node.args[0] for node in used if node.op == "pick"}
        self.switches = [guard for guard in self.trace.guards() if guard in picked]
        self.sliders = [
            index for index, guard in enumerate(self.switches) if any(self._slides(guard, own) for _, own in rates)
        ]
        self._check_room()
        self.groups = [Group(modes, self._flow(own)) for modes, own in rates]
        self.flow = self._flow(self._of_any_group([own for _, own in rates]))
        self.guards = self.mixed(guards, self.flow.shares)
        self.outputs = self.mixed(outputs, self.flow.shares)
        self.checked = [name for name in description.states if any(self._is_nonlinear(own[name]) for _, own in rates)]

    def _check_room(self) -> None:
        description = self.description
        for what, count, most in (
            ("states", len(description.states), at.MOST_STATES),
            ("inputs", len(description.inputs), at.MOST_INPUTS),
            ("outputs", len(description.outputs), at.MOST_OUTPUTS),
            ("parameters", len(description.parameters), at.MOST_NUMBERS),
            ("held numbers", len(description.held), at.MOST_HELD),
            ("regions", len(description.regions), at.MOST_REGIONS),
            ("transitions", len(description.transitions), at.MOST_TRANSITIONS),
            ("switches", len(self.switches), at.MOST_SWITCHES),
        ):
            if count > most:
                raise EquationsError(f"found {count} {what}, expected at most {most}")
        if len(self.sliders) > at.MOST_SLIDERS:
            raise EquationsError(
                f"found {len(self.sliders)} switches along which the machine may stick, expected at most "
                f"{at.MOST_SLIDERS}; smooth some of them: tanh(v/small) in place of sign(v)"
            )

    # -- modes ---------------------------------------------------------------------------------------------------------

    def _rates_by_group(self) -> list[tuple[Mapping[str, frozenset[str]], Mapping[str, Node]]]:
        """The groups: of each region the modes in it, and the rates of all states."""
        regions = self.description.regions
        found: list[tuple[Mapping[str, frozenset[str]], Mapping[str, Node]]] = []
        for chosen in itertools.product(*(_with_one_flow(region) for region in regions.values())):
            rates = dict(self.description.flows)
            for region, modes in zip(regions.values(), chosen, strict=True):
                rates |= region[modes[0]]
            found.append(({name: frozenset(own) for name, own in zip(regions, chosen, strict=True)}, rates))
            if len(found) > at.MOST_GROUPS:
                raise EquationsError(
                    f"found more than {at.MOST_GROUPS} combinations of modes with different flows; "
                    "let fewer modes change the same states"
                )
        return found

    def _of_any_group(self, rates: Sequence[Mapping[str, Node]]) -> dict[str, Node]:
        group, found = self.trace.number(GROUP), dict(rates[-1])
        for place in range(len(rates) - 2, -1, -1):
            found = {name: where(group > place + 0.5, found[name], rates[place][name]) for name in found}
        return found

    def _is_nonlinear(self, rate: Node) -> bool:
        return any(node.op in NONLINEAR and not node.steady for node in ancestors([rate]))

    # -- sliding -------------------------------------------------------------------------------------------------------

    def _slides(self, guard: Node, rates: Mapping[str, Node]) -> bool:
        """Whether the state may slide along a switch: whether that changes the rate of what it compares."""
        above, below = self.sides(guard, rates)
        return above is not below

    def sides(self, guard: Node, rates: Mapping[str, Node]) -> tuple[Node, Node]:
        """The rate of a switch's excess above and below it."""
        above, below = (
            self.rate_of(guard, dict(zip(rates, decided(rates.values(), guard, flag), strict=True)))
            for flag in (True, False)
        )
        return above, below

    def slides_along(self, slider: int) -> tracer.Condition:
        """Whether the state slides along a switch now."""
        return self.trace.number(slides(slider)) > 0.5

    def _flow(self, rates: Mapping[str, Node]) -> Flow:
        """The flow of a group, with equation (1) of the switches along which it may slide."""
        sliders = [k for k, switch in enumerate(self.sliders) if self._slides(self.switches[switch], rates)]
        zero, one = self.trace.constant(0.0), self.trace.constant(1.0)
        names, free = tuple(rates), list(rates.values())
        uppers = {k: decided(free, self.switches[self.sliders[k]], True) for k in sliders}
        matrix, right = [], []
        for row in sliders:
            guard, is_held = self.switches[self.sliders[row]], self.slides_along(row)
            rest = self.rate_of(guard, rates)
            changes = {k: self.rate_of(guard, dict(zip(names, uppers[k], strict=True))) - rest for k in sliders}
            matrix.append([where(is_held, changes[k], one if k == row else zero) for k in sliders])
            right.append(where(is_held, -rest, zero))
        shares = dict(zip(sliders, _solved(matrix, right), strict=True))
        sliding = dict(zip(names, self.mixed(free, shares), strict=True))
        for k in sliders:  # what is held at 0 stays there to the last bit
            guard = self.switches[self.sliders[k]]
            if guard.op == "state":
                name = str(guard.payload)
                sliding[name] = where(self.slides_along(k), zero, sliding[name])
        return Flow(rates, sliding, shares)

    def mixed(self, nodes: Sequence[Node], shares: Mapping[int, Node]) -> list[Node]:
        """Expressions while the state slides, in which flags of such switches are those of the lower side."""
        zero, found = self.trace.constant(0.0), list(nodes)
        for k, share in shares.items():
            uppers = decided(nodes, self.switches[self.sliders[k]], True)
            for place, (node, upper) in enumerate(zip(nodes, uppers, strict=True)):
                if upper is not node:
                    found[place] = found[place] + where(self.slides_along(k), share * (upper - node), zero)
        return found

    def rate_of(self, node: Node, rates: Mapping[str, Node] | None = None) -> Node:
        """The rate of change of an expression, by default in whatever mode is in force."""
        trace = self.trace
        found = self.flow.sliding if rates is None else rates
        seeds = {trace.state(name): rate for name, rate in found.items()} | {trace.clock(): trace.constant(1.0)}
        (slope,) = derivative([node], seeds)
        return trace.constant(0.0) if slope is None else slope


def slides(slider: int) -> str:
    """The name of what says whether the state slides along a switch, among the numbers."""
    return f"slides along {slider}"


def _with_one_flow(region: Region[Node]) -> list[list[str]]:
    """The modes of a region, those with the same flow together."""
    found: list[list[str]] = []
    for mode, flow in region.items():
        alike = next((own for own in found if region[own[0]] == flow), None)
        if alike is None:
            found.append([mode])
        else:
            alike.append(mode)
    return found


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
    found = list(right)
    for k in reversed(range(size)):
        total = b[k]
        for j in range(k + 1, size):
            total = total - a[k][j] * found[j]
        found[k] = total / a[k][k]
    return found


def decided(nodes: Iterable[Node], guard: Node, flag: bool) -> list[Node]:
    """Expressions in which one comparison is decided."""
    nodes = list(nodes)
    known: dict[Node, Node] = {}
    for node in sorted(ancestors(nodes), key=lambda one: one.index):
        args = [known[own] for own in node.args]
        if node.op == "pick" and node.args[0] is guard:
            known[node] = args[1] if flag else args[2]
        elif all(new is old for new, old in zip(args, node.args, strict=True)):
            known[node] = node
        else:
            known[node] = _MADE[node.op](node, args)
    return [known[node] for node in nodes]


_MADE: Final[Mapping[str, Callable[[Node, list[Node]], Node]]] = {
    "pick": lambda node, a: where(tracer.Condition(a[0]), a[1], a[2]),
    "add": lambda node, a: a[0] + a[1],
    "sub": lambda node, a: a[0] - a[1],
    "neg": lambda node, a: -a[0],
    "mul": lambda node, a: a[0] * a[1],
    "div": lambda node, a: a[0] / a[1],
    "power": lambda node, a: a[0] ** float(str(node.payload)),
    "polynomial": lambda node, a: tracer.polynomial(a[0], *a[1:]),
    "exp": lambda node, a: tracer.exp(a[0]),
    "log": lambda node, a: tracer.log(a[0]),
    "sin": lambda node, a: tracer.sin(a[0]),
    "cos": lambda node, a: tracer.cos(a[0]),
    "tanh": lambda node, a: tracer.tanh(a[0]),
}
"""The function that applies each operation to other arguments."""
