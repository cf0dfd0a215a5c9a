"""A hybrid machine as data: states, inputs, numbers, regions of modes, transitions, outputs.

States flow by differential equations. Each region has one mode in force at a time, in which some states may flow
otherwise. A transition happens as soon as its guard is above 0 while its region is in one of its modes: the first of
its cases whose condition holds sets states and numbers, and changes modes (Henzinger, The theory of hybrid automata,
1996). Of two transitions at one time the first in order goes first. Nothing here computes; `system` and `kernels` do.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, Generic, TypeAlias, TypeVar

from valve_sim.model.core.tracer import Node, Trace

T = TypeVar("T")
S = TypeVar("S")
TIME: Final = "time"
"""The name, among the numbers, of the time at the start of a step, s."""


@dataclass(frozen=True)
class Case(Generic[T]):
    """One way in which a transition may go; T is a node, or what nodes are made of.

    Attributes:
        when: this case is taken if it is above 0; None: in any case.
        to: the modes that are in force afterwards, by the name of their region; other regions stay as they are.
        sets: the values of states and held numbers afterwards, by name, made of the values before.
        event: what it is called; "": it has no name.
    """

    when: T | None = None
    to: Mapping[str, str] = field(default_factory=dict)
    sets: Mapping[str, T] = field(default_factory=dict)
    event: str = ""

    def mapped(self, change: Callable[[T], S]) -> Case[S]:
        """The case of other expressions."""
        when = None if self.when is None else change(self.when)
        return Case(when, self.to, {name: change(own) for name, own in self.sets.items()}, self.event)


@dataclass(frozen=True)
class Transition(Generic[T]):
    """What happens as soon as a guard is above 0.

    Attributes:
        guard: an expression. cases: of which the first that holds is taken; the last one has no condition.
        region: whose modes matter; None: it happens in any mode. modes: of the region, in which it happens.
    """

    guard: T
    cases: tuple[Case[T], ...]
    region: str | None = None
    modes: tuple[str, ...] = ()

    def mapped(self, change: Callable[[T], S]) -> Transition[S]:
        """The transition of other expressions."""
        return Transition(change(self.guard), tuple(own.mapped(change) for own in self.cases), self.region, self.modes)


Region: TypeAlias = Mapping[str, Mapping[str, T]]
"""Modes of which one is in force at a time, the first one at the start: of each the rates of those states that flow
otherwise in it, a second, by name."""


class Description:
    """A machine. Its symbols are made first, then its flows, regions, transitions and outputs of them.

    Args:
        states, inputs, parameters: their names. held: numbers that only transitions change: name to their start.

    Attributes:
        flows: the rates of the states where no mode says otherwise, a second. outputs: by name.
    """

    def __init__(
        self, states: Sequence[str], inputs: Sequence[str], parameters: Sequence[str], held: Mapping[str, float]
    ) -> None:
        self.trace = Trace()
        self.states, self.inputs, self.parameters = tuple(states), tuple(inputs), tuple(parameters)
        self.held = dict(held)
        self.flows: dict[str, Node] = {}
        self.regions: dict[str, Region[Node]] = {}
        self.transitions: list[Transition[Node]] = []
        self.outputs: dict[str, Node] = {}

    @property
    def symbols(self) -> dict[str, Node]:
        """The nodes of all that equations are made of, by name: an input goes on straight within a step."""
        trace, clock = self.trace, self.trace.clock()
        found = {TIME: trace.number(TIME) + clock}
        found |= {name: trace.number(name) + trace.number(slope_of(name)) * clock for name in self.inputs}
        found |= {name: trace.number(name) for name in (*self.parameters, *self.held)}
        return found | {name: trace.state(name) for name in self.states}

    def mode(self, region: str) -> Node:
        """The number of the mode that is in force in a region, from 0 on."""
        return self.trace.number(mode_in(region))

    def digest(self) -> str:
        """A text that is equal for equal machines, and for no others, before anything is derived from them."""
        parts: list[object] = [
            self.trace.digest(), self.states, self.inputs, self.parameters, self.held, _indices(self.flows),
            _indices(self.outputs),
        ]  # fmt: skip
        parts += [(name, [(mode, _indices(flow)) for mode, flow in own.items()]) for name, own in self.regions.items()]
        parts += [own.mapped(lambda node: node.index) for own in self.transitions]
        return repr(parts)


def _indices(nodes: Mapping[str, Node]) -> dict[str, int]:
    return {name: node.index for name, node in nodes.items()}


def slope_of(name: str) -> str:
    """The name of the slope of an input among the numbers."""
    return f"{name} slope"


def mode_in(region: str) -> str:
    """The name of the mode of a region among the numbers."""
    return f"mode of {region}"
