"""Expressions of equations as text: read by a grammar of their own, never evaluated as Python.

    sum      = product {("+" | "-") product}
    product  = unary {("*" | "/") unary}
    unary    = ("+" | "-") unary | power
    power    = atom ["**" signed number]
    atom     = number | name | name "(" sum {"," sum} ")" | "(" sum ")"
    where    = "where(" comparison "," sum "," sum ")"
    comparison = sum (">" | "<" | ">=" | "<=") sum | region "==" mode

Length, depth and the count of operations are bounded, so that no text can take long to read or to compile.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Iterator, Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple, TypeAlias

from valve_sim.model.core import tracer
from valve_sim.model.errors import ValveError

LONGEST: Final = 2000
"""Characters of an expression."""
DEEPEST: Final = 40
"""Brackets and signs within each other."""
MOST: Final = 400
"""Operations, numbers and names of an expression."""
LARGEST_POWER: Final = 20.0
"""Exponents lie between this and its negative."""
FUNCTIONS: Final[Mapping[str, tuple[int, int]]] = {
    "sign": (1, 1), "abs": (1, 1), "min": (2, 8), "max": (2, 8), "sqrt": (1, 1), "exp": (1, 1), "log": (1, 1),
    "sin": (1, 1), "cos": (1, 1), "tan": (1, 1), "tanh": (1, 1), "where": (3, 3),
}  # fmt: skip
"""Name to the least and the largest count of arguments."""
_TOKEN: Final = re.compile(
    r"\s*(?:(?P<number>(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?)|(?P<name>[A-Za-z_][A-Za-z_0-9]*)"
    r"|(?P<mark>\*\*|>=|<=|==|[-+*/(),<>]))"
)
_MENDS: Final = {
    "^": "powers are written **",
    "=": "conditions are written where(a > b, y, z)",
    "&": "conditions are nested: where(a > b, where(c > d, y, z), z)",
    "|": "conditions are nested: where(a > b, y, where(c > d, y, z))",
    "[": "names have no index: write one name for each",
    ".": "names are letters, digits and _",
    "−": "a minus sign is -",
    "·": "a product is written *",
    "×": "a product is written *",
}


class ExpressionError(ValveError):
    """An expression that cannot be read: what was found where, and what is expected."""


class Expr(NamedTuple):
    """One operation of an expression.

    Attributes:
        op: "number", "name", "+", "-", "*", "/", "**", "neg", ">" of two sides, or the name of a function.
        args: of the operation; of "where" the comparison comes first.
        value: the number, the name, or the exponent.
    """

    op: str
    args: tuple[Expr, ...] = ()
    value: Any = None


Modes: TypeAlias = Mapping[str, tuple[str, int]]
"""Modes of a machine: the region of each, and its number there."""


def parse(text: str, modes: Modes = MappingProxyType({})) -> Expr:
    """The expression that a text is.

    Raises:
        ExpressionError: it is none; the message says what was found and what to write.
    """
    return _Parser(text, modes).whole()


def parse_comparison(text: str, modes: Modes = MappingProxyType({})) -> Expr:
    """The comparison, ">" of two sides, that a text is; errors: see `parse`."""
    return _Parser(text, modes).whole_comparison()


def excess_of(comparison: Expr) -> Expr:
    """What is above 0 while a comparison holds."""
    a, b = comparison.args
    return a if b == Expr("number", (), 0.0) else Expr("-", (a, b))


def is_constant(expression: Expr) -> bool:
    """Whether an expression is a number, or its negative."""
    return expression.op == "number" or (expression.op == "neg" and expression.args[0].op == "number")


def names_in(expression: Expr) -> tuple[str, ...]:
    """The names that an expression uses, each once, in order."""
    return tuple(dict.fromkeys(one.value for one in walk(expression) if one.op == "name"))


def walk(expression: Expr) -> Iterator[Expr]:
    """All operations of an expression, itself first."""
    yield expression
    for own in expression.args:
        yield from walk(own)


def evaluate(expression: Expr, values: Mapping[str, tracer.Expression]) -> tracer.Expression:
    """An expression as a node of the tracer, or as a plain number where it has no names.

    Args:
        expression: that was read. values: nodes or numbers by name.
    """
    if expression.op == "number":
        return float(expression.value)
    if expression.op == "name":
        return values[expression.value]
    if expression.op == "where":
        (compared, if_so, if_not) = expression.args
        a, b = (evaluate(own, values) for own in compared.args)
        chosen = evaluate(if_so, values), evaluate(if_not, values)
        if isinstance(a, float) and isinstance(b, float):
            return chosen[0] if a > b else chosen[1]
        return tracer.where(_node(a, b) > _node(b, a), *chosen)
    made: tracer.Expression = _MADE[expression.op](expression, *(evaluate(own, values) for own in expression.args))
    return made


def _node(value: tracer.Expression, beside: tracer.Expression) -> tracer.Node:
    if isinstance(value, tracer.Node):
        return value
    assert isinstance(beside, tracer.Node)
    return beside.trace.constant(value)


def _plain(name: str, made: Callable[..., float]) -> Callable[..., tracer.Expression]:
    """A function of a node, and of plain numbers; what is no number there is NaN."""

    def call(expression: Expr, *values: tracer.Expression) -> tracer.Expression:
        if any(isinstance(value, tracer.Node) for value in values):
            return _of_nodes(name, values)
        try:
            return float(made(*values))
        except (ValueError, OverflowError, ZeroDivisionError):
            return math.nan

    return call


def _of_nodes(name: str, values: tuple[tracer.Expression, ...]) -> tracer.Expression:
    if name in ("min", "max"):
        pick = tracer.minimum if name == "min" else tracer.maximum
        found = values[0]
        for value in values[1:]:
            found = pick(found, value)
        return found
    (a,) = values
    assert isinstance(a, tracer.Node)
    if name == "abs":
        return tracer.where(a > 0.0, a, -a)  # the switch of sign(a), so that both change at once
    if name == "tan":
        return tracer.sin(a) / tracer.cos(a)
    made: tracer.Expression = getattr(tracer, name)(a)
    return made


def _quotient(_: Expr, a: tracer.Expression, b: tracer.Expression) -> tracer.Expression:
    if isinstance(b, float) and b == 0.0:
        return math.nan if isinstance(a, float) else a * math.inf
    found: tracer.Expression = a / b
    return found


def _power(expression: Expr, a: tracer.Expression) -> tracer.Expression:
    if isinstance(a, tracer.Node):
        return a ** float(expression.value)
    try:
        found = a**expression.value
    except (ZeroDivisionError, OverflowError):
        return math.nan
    return float(found) if isinstance(found, float) else math.nan


_MADE: Final[Mapping[str, Callable[..., tracer.Expression]]] = {
    "+": lambda _, a, b: a + b,
    "-": lambda _, a, b: a - b,
    "*": lambda _, a, b: a * b,
    "/": _quotient,
    "**": _power,
    "neg": lambda _, a: -a,
    "sign": _plain("sign", lambda a: math.copysign(1.0, a) if a else 0.0),
    "abs": _plain("abs", abs),
    "min": _plain("min", min),
    "max": _plain("max", max),
    **{name: _plain(name, getattr(math, name)) for name in ("sqrt", "exp", "log", "sin", "cos", "tan", "tanh")},
}


class _Parser:
    """Reads one expression."""

    def __init__(self, text: str, modes: Modes) -> None:
        self._modes = modes
        if len(text) > LONGEST:
            raise ExpressionError(f"is {len(text)} characters long, expected at most {LONGEST}; name parts of it")
        self._text, self._count, self._depth = text, 0, 0
        self._tokens = list(self._split())
        self._place = 0

    def whole(self) -> Expr:
        """The expression, of which nothing may be left."""
        if not self._tokens:
            raise ExpressionError("is empty, expected an expression such as (force - viscous*v)/mass")
        return self._ended(self._sum())

    def whole_comparison(self) -> Expr:
        """The comparison, of which nothing may be left."""
        if not self._tokens:
            raise ExpressionError("is empty, expected a comparison such as x < 0")
        return self._ended(self._compared("x < 0"))

    def _ended(self, found: Expr) -> Expr:
        if self._place < len(self._tokens):
            self._fail("expected an operator or the end")
        return found

    def _split(self) -> Iterator[tuple[str, str]]:
        place, text = 0, self._text.rstrip()
        while place < len(text):
            match = _TOKEN.match(text, place)
            if match is None or match.lastgroup is None:
                found = text[place:].lstrip()[0]
                mend = _MENDS.get(found, "expected names, numbers, + - * / **, brackets and functions")
                raise ExpressionError(f"found {found!r} in {_short(text)}; {mend}")
            yield match.lastgroup, match[match.lastgroup]
            place = match.end()

    def _fail(self, expected: str) -> None:
        if self._place < len(self._tokens):
            found = repr(self._tokens[self._place][1])
            before = "".join(one for _, one in self._tokens[max(0, self._place - 3) : self._place])
            place = f" after {before}" if before else ""
        else:
            found, place = "the end", ""
        if found in ("'>'", "'<'", "'>='", "'<='", "'=='"):
            expected = "comparisons stand first in where(a > b, y, z) alone"
        raise ExpressionError(f"found {found}{place} in {_short(self._text)}; {expected}")

    def _is(self, *marks: str) -> bool:
        return self._place < len(self._tokens) and self._tokens[self._place] in [("mark", mark) for mark in marks]

    def _next(self) -> str:
        token = self._tokens[self._place][1]
        self._place += 1
        return token

    def _made(self, op: str, args: tuple[Expr, ...] = (), value: object = None) -> Expr:
        self._count += 1
        if self._count > MOST:
            raise ExpressionError(f"has more than {MOST} operations; name parts of it")
        return Expr(op, args, value)

    def _sum(self) -> Expr:
        self._depth += 1
        if self._depth > DEEPEST:
            raise ExpressionError(f"has more than {DEEPEST} brackets or signs within each other; name parts of it")
        found = self._product()
        while self._is("+", "-"):
            op = self._next()
            found = self._made(op, (found, self._product()))
        self._depth -= 1
        return found

    def _product(self) -> Expr:
        found = self._unary()
        while self._is("*", "/"):
            op = self._next()
            found = self._made(op, (found, self._unary()))
        return found

    def _unary(self) -> Expr:
        negative = False
        signs = 0
        while self._is("+", "-"):
            negative ^= self._next() == "-"
            signs += 1
            if signs > DEEPEST:
                raise ExpressionError(f"has more than {DEEPEST} signs in a row")
        found = self._power()
        return self._made("neg", (found,)) if negative else found

    def _power(self) -> Expr:
        base = self._atom()
        if not self._is("**"):
            return base
        self._next()
        sign = -1.0 if self._is("-") else 1.0
        if self._is("-", "+"):
            self._next()
        bracketed = self._is("(")
        if bracketed:
            self._next()
            if self._is("-"):
                self._next()
                sign = -sign
        if self._place >= len(self._tokens) or self._tokens[self._place][0] != "number":
            self._fail("an exponent is a number; write exp(b*log(a)) for a**b")
        exponent = sign * float(self._next())
        if bracketed:
            if self._is("/"):
                self._next()
                if self._place >= len(self._tokens) or self._tokens[self._place][0] != "number":
                    self._fail("an exponent is a number")
                below = float(self._next())
                exponent = exponent / below if below else math.nan
            self._close()
        if self._is("**"):
            self._fail("one exponent is expected; write brackets")
        if not abs(exponent) <= LARGEST_POWER:
            raise ExpressionError(f"found the exponent {exponent:g}, expected one from -20 to 20")
        return self._made("**", (base,), exponent)

    def _close(self) -> None:
        if not self._is(")"):
            self._fail("expected )")
        self._next()

    def _atom(self) -> Expr:
        if self._is("("):
            self._next()
            found = self._sum()
            self._close()
            return found
        if self._place >= len(self._tokens) or self._tokens[self._place][0] == "mark":
            self._fail("expected a number, a name or a bracket")
        kind, _ = self._tokens[self._place]
        text = self._next()
        if kind == "number":
            value = float(text)
            if not math.isfinite(value):
                raise ExpressionError(f"found the number {text}, expected a finite one")
            if self._place < len(self._tokens) and self._tokens[self._place][0] != "mark":
                self._fail("a product is written *")
            return self._made("number", (), value)
        if self._is("("):
            return self._call(text)
        if text in FUNCTIONS:
            self._place -= 1
            self._fail(f"{text} is a function: write {text}(...)")
        return self._made("name", (), text)

    def _call(self, name: str) -> Expr:
        if name not in FUNCTIONS:
            self._place -= 1
            self._fail(f"there is no function {name}; expected one of {', '.join(FUNCTIONS)}")
        self._next()
        args = [self._compared("where(a > b, y, z)") if name == "where" else self._sum()]
        while self._is(","):
            self._next()
            args.append(self._sum())
        self._close()
        least, most = FUNCTIONS[name]
        if not least <= len(args) <= most:
            expected = f"{least}" if least == most else f"{least} to {most}"
            raise ExpressionError(f"found {name} with {len(args)} values, expected {expected}")
        return self._made(name, tuple(args))

    def _compared(self, expected: str) -> Expr:
        left = self._sum()
        if self._is("=="):
            return self._in_mode(left)
        if not self._is(">", "<", ">=", "<="):
            self._fail(f"expected a comparison: {expected}")
        op = self._next()
        right = self._sum()
        return self._made(">", (left, right) if op[0] == ">" else (right, left))

    def _in_mode(self, region: Expr) -> Expr:
        """Whether a mode is in force: its number is less than a half off that of its region's mode."""
        self._next()
        mode = self._next() if self._place < len(self._tokens) else ""
        if region.op != "name" or self._modes.get(mode, ("", 0))[0] != region.value:
            self._place -= 1
            some = next(iter(self._modes), "")
            mend = f": {self._modes[some][0]} == {some}" if some else ", of which there are none here"
            self._fail(f"== compares a region with one of its modes{mend}; two numbers never stay equal")
        off = self._made("-", (region, self._made("number", (), float(self._modes[mode][1]))))
        return self._made(">", (self._made("number", (), 0.25), self._made("*", (off, off))))


def _short(text: str) -> str:
    return repr(text if len(text) <= 60 else f"{text[:57]}...")
