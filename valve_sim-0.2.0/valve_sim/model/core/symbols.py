"""What the expressions of an effect are made of.

An effect enters the equations by one or more of

* `force(m, own)`: a force in newtons, + opens; `friction(m, own)`: the level of a dry friction, N, against the motion;
* `square(s, own)`: what becomes of the square of the current that pulls, in place of s;
* `changes`: numbers of the valve that are others while the effect is on, each (its value before, own) → its value.

`own` has the effect's parameters by name, `m` is the `Motion` with the symbols of the equations. All are expressions:
arithmetic and the functions of `valve_sim.model.core.tracer`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol, TypeAlias

from valve_sim.model.core.tracer import Condition, Node
from valve_sim.model.errors import ParameterError


class Own:
    """Nodes by name: the parameters of one effect, or the numbers of a valve."""

    def __init__(self, **nodes: Node) -> None:
        vars(self).update(nodes)

    def named(self, name: str) -> Node:
        """The node of a name that is known at run time only."""
        found: Node = vars(self)[name]
        return found

    def __getattr__(self, name: str) -> Node:
        raise ParameterError(f"{name}: no such parameter; expected {', '.join(vars(self))}")


Change: TypeAlias = Callable[[Node, Own], Node]


@dataclass(frozen=True)
class Motion:
    """The symbols that an effect's expressions may use.

    Attributes:
        x: m, displacement of the pilot plunger. v: m/s. u: the current at the terminals. w: the current that pulls.
        t: s. since: s since the pilot plunger last left its seat.
        direction: +1 while the plungers open, −1 while they close; `direction * v` is their speed.
        lifted: whether the main plunger moves along, Phase 2; a condition for `where`.
        beyond: whether the plungers press into a compliant stop; a condition for `where`.
        p: numbers of the valve by their names, effects included: p.stroke, p.pilot_gap.
    """

    x: Node
    v: Node
    u: Node
    w: Node
    t: Node
    since: Node
    direction: Node
    lifted: Condition
    beyond: Condition
    p: Own


Force: TypeAlias = Callable[[Motion, Own], Node]


class Effect(Protocol):
    """What the equations ask of an effect: its names, and its expressions; see the module."""

    @property
    def name(self) -> str: ...  # noqa: D102
    @property
    def names(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def shapes(self) -> tuple[str, ...]: ...  # noqa: D102
    @property
    def force(self) -> Force | None: ...  # noqa: D102
    @property
    def friction(self) -> Force | None: ...  # noqa: D102
    @property
    def square(self) -> Change | None: ...  # noqa: D102
    @property
    def changes(self) -> Mapping[str, Change]: ...  # noqa: D102


def added(parameter: str) -> Change:
    """A number that is larger by one of the effect's parameters."""
    return lambda before, own: before + own.named(parameter)


def replaced(parameter: str) -> Change:
    """A number that one of the effect's parameters takes the place of."""
    return lambda _before, own: own.named(parameter)
