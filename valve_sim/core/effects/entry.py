"""What an entry of the catalogue says about its effect: words for people, parameters, and its expressions.

An effect enters the equations by one or more of

* `force(m, own)`: a force in newtons, + opens; `friction(m, own)`: the level of a dry friction, N, against the motion;
* `square(s, own)`: what becomes of the square of the current that pulls, in place of s;
* `changes`: numbers of the valve that are others while the effect is on, each (its value before, own) → its value.

`own` has the effect's parameters by name, `m` is the `Motion` with the symbols of the equations. All are expressions:
arithmetic and the functions of `valve_sim.core.tracer`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TypeAlias

from valve_sim.core.tracer import Condition, Node
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import Parameter


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


@dataclass(frozen=True, kw_only=True, eq=False)
class Effect:
    """One named effect.

    Attributes:
        name: as in parameter files, reports and `effects.<name>`. title: plain name. summary: one line for a person.
        parameters: what it needs; all of them are given when it is on.
        source: where its form, and its size, are documented.
        on_a_real_valve: what it is on a real valve. what_to_do: what to check or do.
        confused_with: names of effects that data often cannot tell from this one, the closest first.
        force, friction, square, changes: its expressions, see the module.
        stands_alone: names of effects that cannot be declared beside it.
        shapes: parameters whose values decide which expressions it has; they are constants there.
        unpack: (what a file has, where) → its parameters one by one, where a file gives them in another form.
    """

    name: str
    title: str
    summary: str
    parameters: tuple[Parameter, ...]
    source: str
    on_a_real_valve: str
    what_to_do: str
    confused_with: tuple[str, ...] = ()
    force: Callable[[Motion, Own], Node] | None = None
    friction: Callable[[Motion, Own], Node] | None = None
    square: Callable[[Node, Own], Node] | None = None
    changes: Mapping[str, Change] = field(default_factory=dict)
    stands_alone: tuple[str, ...] = ()
    shapes: tuple[str, ...] = ()
    unpack: Callable[[Mapping[str, object], str], Mapping[str, object]] | None = None

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its parameters."""
        return tuple(parameter.name for parameter in self.parameters)


def added(parameter: str) -> Change:
    """A number that is larger by one of the effect's parameters."""
    return lambda before, own: before + own.named(parameter)


def replaced(parameter: str) -> Change:
    """A number that one of the effect's parameters takes the place of."""
    return lambda _before, own: own.named(parameter)
