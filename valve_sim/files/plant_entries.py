"""Checks of what the file of a plant holds: names, units, expressions and comparisons."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence, Sized
from typing import Any, Final

from valve_sim.files.entries import Entries, alternatives, short
from valve_sim.model.core.own.grammar import (
    FUNCTIONS,
    Expr,
    ExpressionError,
    Modes,
    excess_of,
    is_constant,
    names_in,
    parse,
    parse_comparison,
)
from valve_sim.model.core.own.units import Dimension, Unit, UnitError, dimension_of, dimension_words, same
from valve_sim.model.errors import ValveError

RESERVED: Final = ("t", "time", *FUNCTIONS)
"""Names that no state, input or parameter may have."""
_NAME: Final = re.compile(r"[A-Za-z_][A-Za-z_0-9]*$")


class PlantFileError(ValveError):
    """A file of a plant cannot be used: one line with the file, the key, what was found and the mend."""


def a_second(unit: Unit) -> Dimension:
    """The dimension of the rate at which what has this unit changes."""
    length, mass, time, current, temperature = unit.dimension
    return length, mass, time - 1, current, temperature


class PlantEntries(Entries):
    """The entries of the file of a plant.

    Attributes:
        found: its content. modes: of the machine, which expressions may ask for.
    """

    def __init__(self, found: Mapping[Any, Any], path: str) -> None:
        super().__init__(path, PlantFileError)
        self.found = found
        self.modes: Modes = {}

    def section(self, key: str) -> Mapping[str, Any]:
        """The entries of a section by their names."""
        found = self.found.get(key, {})
        if not isinstance(found, Mapping):
            raise self.fail(key, f"found {short(found)}, expected names, each with its entry: {key}: {{x: {{...}}}}")
        for name in found:
            self.check_name(f"{key}.{name}", name)
        return found

    def check_name(self, key: str, name: object) -> None:
        """Refuse what is no name."""
        if isinstance(name, bool):
            raise self.fail(key, f"found {name} for a name: YAML reads on, off, yes and no so; write it in quotes")
        if not isinstance(name, str) or not _NAME.match(name):
            raise self.fail(key, f"found the name {short(name)}, expected letters, digits and _, a letter first")
        if name in RESERVED:
            raise self.fail(
                key, f"{name} is the name of {'the time' if name in ('t', 'time') else 'a function'}; choose another"
            )
        if len(name) > 60:
            raise self.fail(key[:60], "is longer than 60 characters; choose a shorter name")

    def entry(self, key: str, found: object, known: Sequence[str]) -> Mapping[str, Any]:
        """An entry with known keys."""
        entry = self.mapping(key, found, f"keys {', '.join(known)}")
        self.check_keys(key, entry, known)
        return entry

    def at_most(self, key: str, found: Sized, most: int) -> None:
        """Refuse too many entries."""
        if len(found) > most:
            raise self.fail(key, f"found {len(found)}, expected at most {most}")

    def plant_unit(self, key: str, entry: Mapping[str, Any]) -> Unit:
        """The unit of an entry, which is no scale with a zero of its own."""
        unit = self.unit(f"{key}.unit", entry.get("unit", ""))
        if unit.zero:
            text = entry["unit"]
            raise self.fail(f"{key}.unit", f"found {text}; temperatures of a plant are in K, {text} is for columns")
        return unit

    def si(self, key: str, found: object, unit: Unit | None = None) -> float:
        """A number in the unit of its entry, in SI."""
        return self.number(key, found) * (1.0 if unit is None else unit.factor)

    def expression(self, key: str, found: object, dimensions: Mapping[str, Dimension]) -> Expr:
        """An expression of names that have a dimension."""
        if isinstance(found, int | float) and not isinstance(found, bool):
            found = repr(found)
        expected = "an expression such as (force - viscous*v)/mass; in { } commas need quotes"
        return self._parsed(key, found, dimensions, parse, expected)

    def comparison(self, key: str, found: object, dimensions: Mapping[str, Dimension]) -> Expr:
        """What is above 0 while a comparison of names that have a dimension holds; a lone number in it is SI."""
        parsed = self._parsed(key, found, dimensions, parse_comparison, "a comparison such as x < 0")
        for whole in parsed.args if any(is_constant(side) for side in parsed.args) else (parsed,):
            self.dimension(key, whole, dimensions)
        return excess_of(parsed)

    def _parsed(
        self, key: str, found: object, dimensions: Mapping[str, Dimension], parse: Callable[[str, Modes], Expr],
        expected: str,
    ) -> Expr:  # fmt: skip
        if isinstance(found, bool):
            raise self.fail(key, f"found {found}: YAML reads on, off, yes and no so; write the expression in quotes")
        if not isinstance(found, str):
            raise self.fail(key, f"found {short(found)}, expected {expected}")
        try:
            expression = parse(found, self.modes)
        except ExpressionError as error:
            raise self.fail(key, str(error)) from error
        for name in names_in(expression):
            if name not in dimensions:
                raise self.fail(
                    key, f"uses {name}, which is no state, input or parameter; {alternatives(name, dimensions)}"
                )
        return expression

    def dimension(self, key: str, expression: Expr, dimensions: Mapping[str, Dimension]) -> Dimension | None:
        """The dimension of an expression, whose parts must fit; None where it is 0."""
        try:
            return dimension_of(expression, dimensions)
        except UnitError as error:
            raise self.fail(key, f"{error}; make both sides fit, or correct a unit") from error

    def fits(self, key: str, found: Dimension | None, expected: Dimension, what: str) -> None:
        """Refuse a dimension that is not what it must be; `what` says why it must."""
        if found is not None and not same(found, expected):
            raise self.fail(key, f"is in {dimension_words(found)}, expected {dimension_words(expected)}, {what}")
