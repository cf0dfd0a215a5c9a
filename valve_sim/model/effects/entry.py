"""What an entry of the catalogue says about its effect."""

from __future__ import annotations

import enum
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

from valve_sim.model.core.symbols import Change, Force, Motion, Own, added
from valve_sim.model.core.tracer import Node, where
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import Parameter

Values = Mapping[str, float]
Term = Callable[..., float]


class Tag(enum.Enum):
    """Kind of an effect, by which lists of effects choose. The catalogue is in this order."""

    DISSIPATIVE = "dissipative"
    """Takes energy out of the motion."""
    FORCE = "force"
    """Any other force on the plungers."""
    COIL = "coil"
    """Between the commanded voltage and the pull."""
    CONTACT = "contact"
    """Effects at the contacts of the plungers: where these are, and how they rebound."""
    SENSOR = "sensor"
    """Effects of a sensor, which do not change the motion."""
    GAS = "gas"
    """Of the gas that flows, where there is any."""
    LIKE_DAMPING = "like damping"
    """Slows the plungers as a viscous damping does, and is easily taken for one."""
    BUILT_IN = "built in"
    """Built into the machine: it cannot appear or disappear while the machine is in service."""


class Severity(NamedTuple):
    """How much of an effect there is, as a share (0.06 for 6 %) of a quantity such as the spring preload."""

    share: float
    of: str

    def __str__(self) -> str:
        """As a report says it, "6 % of the spring preload"."""
        percent = float(f"{100.0 * self.share:.2g}")  # two digits, without an exponent
        return f"{percent:.15g} % of {self.of}"


SeverityOf = Callable[[Values, Values], Severity | None]


@dataclass(frozen=True)
class ListOfParameters:
    """Parameters of an effect that files and nodes give as one list.

    Attributes:
        name, unit, description: of the list. members: names of the parameters, in order; the list may hold fewer.
        count: name of the parameter that says how many it holds, which is not given beside it. fewest: it must hold.
    """

    name: str
    unit: str
    description: str
    members: tuple[str, ...]
    count: str
    fewest: int

    @property
    def range_words(self) -> str:
        """How many numbers it holds, for messages."""
        return f"a list of {self.fewest} to {len(self.members)} numbers {self.unit}"


@dataclass(frozen=True, kw_only=True)
class _Words:
    """What an entry says to people.

    Attributes:
        title: plain name, "Coulomb friction"; default: the name, without underscores.
        on_a_real_valve: one sentence: what it is on a real valve; default: the summary.
        what_to_do: one sentence: what to check or do.
        remaining: of an effect whose one parameter is what is left of something, 1 at first: of what.
        severity: (the effect's values, the declared values) → how much of it that is; None where that means nothing.
    """

    title: str = ""
    on_a_real_valve: str = ""
    what_to_do: str = ""
    remaining: str = ""
    severity: SeverityOf | None = None


@dataclass(frozen=True)
class Effect(_Words):
    """One named effect.

    Attributes:
        name: as in YAML, reports and `effects.<name>`.
        summary: one sentence for a person.
        parameters: what it needs; all of them are given when it is on.
        source: where the form, and the size, are documented.
        term: plain Python function f(x, v, u, t, *parameters, *also_reads) of arithmetic in SI units.
        expected: (checked values) → what is wrong with them together, for a message; empty if nothing is.
        given_as_list: parameters that files and nodes give as one list.
        retired: names of parameters that earlier versions had → what they were. Read where they are 0, else refused.
        also_reads: declared parameters that the term is handed after its own.
        phase_2_only: the term acts only while the main plunger moves along.
        confused_with: names of effects that data often cannot tell from this one, the closest first; listed beside it
            where no form is right and scores mislead. One of two says so: the catalogue adds it to the other.
        named: whether a diagnosis may claim it; False for shapes without a physical name.
        tried: whether a diagnosis tries it where it is not declared; False for one that the user has to declare,
            because it changes what all others mean.
        needs_inductance: it is tried only where the coil has a time constant, without which it has no flux.
        with_gas: whether it is of a valve with gas alone, or of one without gas alone; None: of both.
        tags: what kind of effect it is; the first is the main one.
        adds_to: parameter of the effect → declared parameter that it is added to.
        force: (motion, own) → a force, N, + opens, as an expression; made of `term` where that is given alone.
        friction: (motion, own) → the level of a dry friction, N, against the motion, as an expression.
        square: (s, own) → what becomes of the square of the current that pulls, as an expression.
        changes: numbers of the valve that are others while the effect is on: (its value before, own) → its value, as
            expressions; see `valve_sim.model.core.symbols`.
        shapes: parameters whose values decide which expressions it has; they are constants there.
        stands_alone: names of effects that cannot be declared beside it.
        origin: where an installed package names it, for messages.
    """

    name: str
    summary: str
    parameters: tuple[Parameter, ...]
    source: str
    term: Term | None = None
    expected: Callable[[Values], str] | None = None
    given_as_list: ListOfParameters | None = None
    retired: Mapping[str, str] = field(default_factory=dict, hash=False)
    also_reads: tuple[str, ...] = ()
    phase_2_only: bool = False
    confused_with: tuple[str, ...] = ()
    named: bool = True
    tried: bool = True
    needs_inductance: bool = False
    with_gas: bool | None = None
    tags: tuple[Tag, ...] = (Tag.FORCE,)
    adds_to: Mapping[str, str] = field(default_factory=dict, hash=False)
    force: Force | None = None
    friction: Force | None = None
    square: Change | None = None
    changes: Mapping[str, Change] = field(default_factory=dict)
    shapes: tuple[str, ...] = ()
    stands_alone: tuple[str, ...] = ()
    origin: str = field(default="", compare=False)

    def __post_init__(self) -> None:
        plain = self.name.replace("_", " ")
        defaults = {
            "title": plain[:1].upper() + plain[1:],
            "on_a_real_valve": f"{self.summary[:1].upper()}{self.summary[1:].rstrip('.')}.",
            "what_to_do": f"See {self.source.rstrip('.')}.",
        }
        for attribute, default in defaults.items():
            if not getattr(self, attribute):
                object.__setattr__(self, attribute, default)
        # The entry that this one replaces would be named in what its term raises.
        is_of_term = getattr(self.force, "__func__", None) is Effect._force_of_term
        if (self.force is None or is_of_term) and self.term is not None:
            object.__setattr__(self, "force", self._force_of_term)
        if self.adds_to:
            more = {declared: added(parameter) for parameter, declared in self.adds_to.items()}
            object.__setattr__(self, "changes", {**self.changes, **more})

    def __hash__(self) -> int:
        return hash(self.name)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of its parameters."""
        return tuple([parameter.name for parameter in self.parameters])

    def _force_of_term(self, m: Motion, own: Own) -> Node:
        """The force of `term` as an expression: its arithmetic is that of expressions, too.

        Raises:
            ParameterError: it is more than arithmetic.
        """
        assert self.term is not None
        numbers = [own.named(name) for name in self.names] + [m.p.named(name) for name in self.also_reads]
        try:
            force: Any = self.term(m.x, m.v, m.u, m.t, *numbers)
        except Exception as error:  # a user's own code may raise anything
            where_from = f"effects.{self.name}" + (f" ({self.origin})" if self.origin else "")
            raise ParameterError(
                f"{where_from}: its term cannot be compiled as an expression, {error}; write arithmetic, or `force` "
                "with the functions of valve_sim.model.core.tracer (exp, sin, maximum, where) in place of those of math"
            ) from error
        return where(m.lifted, force, 0.0) if self.phase_2_only else m.x.trace.lift(force)

    @property
    def changes_nothing(self) -> bool:
        """Whether it has no expression, so that it would change nothing."""
        return not (self.force or self.friction or self.square or self.changes)

    def is_of(self, *, has_gas: bool) -> bool:
        """Whether it is an effect of valves with gas, or of those without."""
        return self.with_gas is None or self.with_gas is has_gas

    def parameter(self, name: str) -> Parameter:
        """The parameter of that name.

        Raises:
            KeyError: there is none.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                return parameter
        raise KeyError(name)

    @property
    def given_names(self) -> tuple[str, ...]:
        """The names that files and nodes know: those of the parameters, with a list in place of its members."""
        names = [parameter.name for parameter in self.parameters]
        whole = self.given_as_list
        if whole is None:
            return tuple(names)
        return (*(name for name in names if name not in (*whole.members, whole.count)), whole.name)

    def packed(self, values: Values) -> dict[str, float | list[float]]:
        """Values of all parameters as files and nodes give them."""
        whole = self.given_as_list
        if whole is None:
            return dict(values)
        single = {name: values[name] for name in self.given_names if name != whole.name}
        return {**single, whole.name: [values[name] for name in whole.members[: int(values[whole.count])]]}

    def unpacked(self, found: Mapping[str, object], where: str) -> dict[str, object]:
        """Parameters by name of what files and nodes give; what is not given is left out.

        Args:
            found: names to values. where: the effect, and the file if there is one, for messages.

        Raises:
            ParameterError: a list of another form is expected, or a parameter is given that is no longer read.
        """
        kept = {name: value for name, value in found.items() if name not in self.retired}
        for name, was in self.retired.items():
            if found.get(name, 0.0) != 0.0:
                raise ParameterError(
                    f"{where}.{name}: found {found[name]!r}, {was}, which are not read any more; expected "
                    f"{', '.join(self.given_names)}: run diagnose again"
                )
        whole = self.given_as_list
        if whole is None or whole.name not in kept:
            return kept
        items = kept.pop(whole.name)
        if isinstance(items, str) or not isinstance(items, Sequence):
            raise ParameterError(f"{where}.{whole.name}: found {items!r}, expected {whole.range_words}")
        if not whole.fewest <= len(items) <= len(whole.members):
            raise ParameterError(f"{where}.{whole.name}: found {len(items)} numbers, expected {whole.range_words}")
        padded = [*items, *[0.0] * (len(whole.members) - len(items))]
        return {**kept, whole.count: len(items), **dict(zip(whole.members, padded, strict=True))}

    def neutral_values(self) -> dict[str, float]:
        """Values at which it changes nothing; parameters that only shape it are at their prior scale."""
        return {parameter.name: parameter.neutral for parameter in self.parameters}

    def severity_of(self, values: Values, declared: Values) -> Severity | None:
        """How much of the effect there is in a valve.

        Args:
            values: the effect's, by name. declared: the declared scalars (a0 … a3 among them), SI.

        Returns:
            a share of something known, or None where there is no such measure.
        """
        return None if self.severity is None else self.severity(values, declared)


def share_of_preload(parameter: str) -> SeverityOf:
    """The size of a force over the spring's preload."""

    def severity(values: Values, declared: Values) -> Severity | None:
        return share(values[parameter], declared["spring_preload"], "the spring preload")

    return severity


def share(part: float, whole: float, of: str) -> Severity | None:
    """The size of a part of a whole; None of a whole that is 0."""
    return Severity(abs(part / whole), of) if whole else None


FASTEST: Final = 0.2
"""m/s: about the speed at which such a valve arrives at its stop, for severities."""
