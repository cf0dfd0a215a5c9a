"""Units as people write them, and whether those of an equation fit.

A unit is a product of named units with powers: `N*s/m`, `N·s²/m²`, `kg*m^2`, `V/(rad/s)`, `1/s`, `mm`, `m^0.5/s`.
Angles are plain numbers, as in SI: N m/rad is N m.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Iterator, Mapping
from typing import Final, NamedTuple

from valve_sim.model.core.own.grammar import Expr
from valve_sim.model.errors import ValveError

Dimension = tuple[float, ...]
"""Powers of m, kg, s, A, K."""

NONE: Final[Dimension] = (0.0,) * 5
_NAMES: Final = ("m", "kg", "s", "A", "K")


class UnitError(ValveError):
    """A unit that is not known, or that does not fit."""


class Unit(NamedTuple):
    """A unit.

    Attributes:
        factor: SI units in one of it. dimension: powers of the base units. si: the SI unit that it is a part of, as
            people read it. zero: in SI, what a reading of 0 is: of °C, 273.15 K. Differences have no zero.
    """

    factor: float
    dimension: Dimension
    si: str
    zero: float = 0.0


_BASE: Final[Mapping[str, tuple[float, Dimension, str]]] = {
    "m": (1.0, (1, 0, 0, 0, 0), "m"), "g": (1e-3, (0, 1, 0, 0, 0), "kg"), "s": (1.0, (0, 0, 1, 0, 0), "s"),
    "A": (1.0, (0, 0, 0, 1, 0), "A"), "K": (1.0, (0, 0, 0, 0, 1), "K"), "N": (1.0, (1, 1, -2, 0, 0), "N"),
    "J": (1.0, (2, 1, -2, 0, 0), "J"), "W": (1.0, (2, 1, -3, 0, 0), "W"), "V": (1.0, (2, 1, -3, -1, 0), "V"),
    "Ohm": (1.0, (2, 1, -3, -2, 0), "Ω"), "ohm": (1.0, (2, 1, -3, -2, 0), "Ω"), "Ω": (1.0, (2, 1, -3, -2, 0), "Ω"),
    "H": (1.0, (2, 1, -2, -2, 0), "H"), "F": (1.0, (-2, -1, 4, 2, 0), "F"), "C": (1.0, (0, 0, 1, 1, 0), "C"),
    "T": (1.0, (0, 1, -2, -1, 0), "T"), "Wb": (1.0, (2, 1, -2, -1, 0), "Wb"), "Pa": (1.0, (-1, 1, -2, 0, 0), "Pa"),
    "Hz": (1.0, (0, 0, -1, 0, 0), "Hz"), "rad": (1.0, NONE, "rad"), "S": (1.0, (-2, -1, 3, 2, 0), "S"),
    "bar": (1e5, (-1, 1, -2, 0, 0), "Pa"), "L": (1e-3, (3, 0, 0, 0, 0), "m³"), "l": (1e-3, (3, 0, 0, 0, 0), "m³"),
}  # fmt: skip
_ALONE: Final[Mapping[str, tuple[float, Dimension, str]]] = {
    "deg": (math.pi / 180.0, NONE, "rad"), "°": (math.pi / 180.0, NONE, "rad"), "rev": (2.0 * math.pi, NONE, "rad"),
    "rpm": (2.0 * math.pi / 60.0, (0, 0, -1, 0, 0), "rad/s"),
    "%": (0.01, NONE, "1"), "min": (60.0, (0, 0, 1, 0, 0), "s"),
    "h": (3600.0, (0, 0, 1, 0, 0), "s"), "d": (86400.0, (0, 0, 1, 0, 0), "s"), "in": (0.0254, (1, 0, 0, 0, 0), "m"),
    "psi": (6894.757293168, (-1, 1, -2, 0, 0), "Pa"),
    "degC": (1.0, (0, 0, 0, 0, 1), "K"), "°C": (1.0, (0, 0, 0, 0, 1), "K"), "g0": (9.80665, (1, 0, -2, 0, 0), "m/s²"),
    "kgf": (9.80665, (1, 1, -2, 0, 0), "N"), "lbf": (4.4482216152605, (1, 1, -2, 0, 0), "N"),
}  # fmt: skip
_ZEROS: Final = {"degC": 273.15, "°C": 273.15}
"""K, by units that begin elsewhere than at 0; within a product, as in W/°C, they are of differences."""
_PREFIX: Final = {
    "h": 1e2,
    "n": 1e-9,
    "u": 1e-6,
    "µ": 1e-6,
    "μ": 1e-6,
    "m": 1e-3,
    "c": 1e-2,
    "d": 1e-1,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
}
_SUPERSCRIPT: Final = str.maketrans("⁻⁰¹²³⁴⁵⁶⁷⁸⁹", "-0123456789")
_RAISED: Final = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")
_PART: Final = re.compile(
    r"\s*(?:(?P<name>[A-Za-zµμΩ°%]+)|(?P<one>1)(?![0-9.])|(?P<mark>\*\*|[*·/()^ ])"
    r"|(?P<power>-?\d+(?:\.\d+)?|[⁻⁰¹²³⁴⁵⁶⁷⁸⁹]+))"
)


def parse_unit(text: str) -> Unit:
    """The unit that a text names; empty, "1", "-" and "–" are a plain number.

    Raises:
        UnitError: it is none; the message says what is expected.
    """
    if text.strip() in ("", "1", "-", "–"):
        return Unit(1.0, NONE, "–")
    if len(text) > 80:
        raise UnitError(f"found {text[:40]!r}..., expected a unit such as N*s/m")
    factor, dimension, shown = _Reader(text).whole()
    return Unit(factor, dimension, _tidy(shown) or "–", _ZEROS.get(text.strip(), 0.0))


class _Reader:
    def __init__(self, text: str) -> None:
        self._text = text.strip()
        self._parts = list(self._split())
        self._place = 0

    def _split(self) -> Iterator[tuple[str, str]]:
        place = 0
        while place < len(self._text):
            match = _PART.match(self._text, place)
            if match is None or match.lastgroup is None or match.end() == place:
                raise self._unknown(self._text[place:].strip()[:1])
            if match[match.lastgroup] != " ":
                yield match.lastgroup, match[match.lastgroup]
            place = match.end()

    def _unknown(self, found: str) -> UnitError:
        names = [*_BASE, *_ALONE, "mm", "ms", "mA", "mV", "mH", "kg", "kPa"]
        alike = difflib.get_close_matches(found, names, n=1, cutoff=0.5)
        mend = f"did you mean {alike[0]}? " if alike and alike[0] != found else ""
        whole = "" if found == self._text else f" in {self._text!r}"
        return UnitError(f"found {found!r}{whole}; {mend}expected a unit such as m, rad, N*s/m, kg*m^2, Ohm, mH or 1")

    def whole(self) -> tuple[float, Dimension, str]:
        found = self._product()
        if self._place < len(self._parts):
            raise self._unknown(self._parts[self._place][1])
        return found

    def _product(self) -> tuple[float, Dimension, str]:
        factor, dimension, shown = self._atom()
        while self._place < len(self._parts):
            kind, mark = self._parts[self._place]
            if mark == ")":
                break
            divides = mark == "/"
            if kind == "mark" and mark != "(":
                if mark not in ("*", "·", "/"):
                    raise self._unknown(mark)
                self._place += 1
            other = self._atom()
            power = -1.0 if divides else 1.0
            factor *= other[0] ** power
            dimension = tuple(a + power * b for a, b in zip(dimension, other[1], strict=True))
            second = f"({other[2]})" if divides and ("·" in other[2] or "/" in other[2]) else other[2]
            if second not in ("", "1"):
                shown = f"{shown or '1'}/{second}" if divides else f"{shown}·{second}".strip("·")
        return factor, dimension, shown

    def _atom(self) -> tuple[float, Dimension, str]:
        if self._place >= len(self._parts):
            raise UnitError(f"found {self._text!r}, which ends too early; expected a unit such as N*s/m")
        kind, text = self._parts[self._place]
        self._place += 1
        if text == "(":
            found = self._product()
            if self._place >= len(self._parts) or self._parts[self._place][1] != ")":
                raise UnitError(f"found {self._text!r} with a bracket that is not closed; expected )")
            self._place += 1
        elif kind == "one":
            found = (1.0, NONE, "1")
        elif kind == "name":
            found = self._named(text)
        else:
            raise self._unknown(text)
        return self._raised(found)

    def _raised(self, found: tuple[float, Dimension, str]) -> tuple[float, Dimension, str]:
        if self._place < len(self._parts) and self._parts[self._place][1] in ("^", "**"):
            self._place += 1
            if self._place >= len(self._parts) or self._parts[self._place][0] not in ("power", "one"):
                raise UnitError(f"found {self._text!r}, expected a number such as 2 or 0.5 after ^")
        if self._place < len(self._parts) and (
            self._parts[self._place][0] == "power"
            or (self._parts[self._place][0] == "one" and self._parts[self._place - 1][1] in ("^", "**"))
        ):
            power = float(self._parts[self._place][1].translate(_SUPERSCRIPT))
            self._place += 1
            if not 0 < abs(power) <= 9:
                raise UnitError(f"found the power {power:g} in {self._text!r}, expected one from -9 to 9")
            return found[0] ** power, tuple(power * own for own in found[1]), _with_power(found[2], power)
        return found

    def _named(self, text: str) -> tuple[float, Dimension, str]:
        if text == "g" and self._parts[self._place : self._place + 1] == [("power", "0")]:
            self._place += 1
            text = "g0"
        if text in _ALONE:
            return _ALONE[text]
        if text in _BASE:
            return _BASE[text]
        prefix, rest = text[0], text[1:]
        if prefix in _PREFIX and rest in _BASE:
            factor, dimension, shown = _BASE[rest]
            return _PREFIX[prefix] * factor, dimension, shown
        # Without a sign between them: Nm is a newton metre, Ns a newton second.
        for cut in range(len(text) - 1, 0, -1):
            if text[cut:] in ("m", "s", "rad") and (text[:cut] in ("N", "mN", "kN", "A", "V", "Vs")):
                a, b = self._named(text[:cut]), _BASE[text[cut:]]
                return a[0] * b[0], tuple(p + q for p, q in zip(a[1], b[1], strict=True)), f"{a[2]}·{b[2]}"
        raise self._unknown(text)


def _with_power(name: str, power: float) -> str:
    """A unit with its power, as people write it: m², m^0.5."""
    if power == 1:
        return name
    return f"{name}{str(int(power)).translate(_RAISED)}" if power == int(power) else f"{name}^{power:g}"


def _tidy(shown: str) -> str:
    return shown.replace("·1", "").removeprefix("1·")


def dimension_words(dimension: Dimension) -> str:
    """A dimension as a unit of SI: kg·m/s²."""
    powers = dict(zip(_NAMES, dimension, strict=True))
    parts = [(name, powers[name]) for name in ("kg", "m", "s", "A", "K") if powers[name]]
    if not parts:
        return "a plain number"

    above = "·".join(_with_power(name, power) for name, power in parts if power > 0) or "1"
    below = "·".join(_with_power(name, -power) for name, power in parts if power < 0)
    return f"{above}/({below})" if "·" in below else f"{above}/{below}" if below else above


def dimension_of(  # noqa: PLR0911 -- one for each kind of operation
    expression: Expr, names: Mapping[str, Dimension]
) -> Dimension | None:
    """The dimension of an expression; None where it is 0, which has any.

    Raises:
        UnitError: two parts do not fit; the message names them.
    """
    args = [dimension_of(own, names) for own in expression.args]
    op = expression.op
    if op == "number":
        return None if expression.value == 0.0 else NONE
    if op == "name":
        return names[expression.value]
    if op in ("+", "-", ">", "min", "max"):
        return _alike(expression, args)
    if op == "where":
        return _alike(Expr("where", expression.args[1:]), args[1:])
    if op in ("*", "/"):
        a, b = args
        if a is None or b is None:
            return None if a is None and b is None else (NONE if a is None and op == "/" and b == NONE else None)
        return tuple(p + (q if op == "*" else -q) for p, q in zip(a, b, strict=True))
    (a,) = args
    if op in ("neg", "abs"):
        return a
    if op == "sign":
        return NONE
    if op == "**":
        return None if a is None else tuple(expression.value * p for p in a)
    if op == "sqrt":
        return None if a is None else tuple(0.5 * p for p in a)
    if a not in (None, NONE):
        assert a is not None
        raise UnitError(f"{op}({written(expression.args[0])}) is of {dimension_words(a)}, expected a plain number")
    return NONE


def _alike(expression: Expr, dimensions: list[Dimension | None]) -> Dimension | None:
    found: Dimension | None = None
    first: Expr | None = None
    for own, dimension in zip(expression.args, dimensions, strict=True):
        if dimension is None:
            continue
        if found is None:
            found, first = dimension, own
        elif not same(found, dimension):
            assert first is not None
            how = {"+": "added to", "-": "added to", ">": "compared with"}.get(expression.op, "beside")
            raise UnitError(
                f"{written(own)} in {dimension_words(dimension)} is {how} {written(first)} in {dimension_words(found)}"
            )
    return found


def same(a: Dimension, b: Dimension) -> bool:
    """Whether two dimensions are equal, but for rounding of powers such as 1/3."""
    return all(abs(p - q) < 1e-6 for p, q in zip(a, b, strict=True))


def written(expression: Expr) -> str:
    """An expression as text again, cut where it is long."""
    text = text_of(expression)
    return text if len(text) <= 40 else f"{text[:37]}..."


def text_of(expression: Expr) -> str:
    """An expression as text that reads as the same expression."""
    op, args = expression.op, [text_of(own) for own in expression.args]
    if op in ("number", "name"):
        return f"{expression.value!r}" if op == "number" else str(expression.value)
    if op == "neg":
        return f"(-{args[0]})"
    if op == "**":
        return f"({args[0]})**{expression.value!r}" if expression.value >= 0 else f"({args[0]})**({expression.value!r})"
    if op in ("+", "-", "*", "/"):
        return f"({args[0]} {op} {args[1]})"
    if op == ">":
        return f"{args[0]} > {args[1]}"
    return f"{op}({', '.join(args)})"
