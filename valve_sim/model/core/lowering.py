"""The integrator's functions, written in Python, as text of LLVM's intermediate representation.

They use a small part of Python: doubles, integers, truth values, blocks of doubles that are read and written by index
or handed on from an index (`b[n:]`), assignments, conditions, loops, and calls of each other. All of it means what
Python means by it, so that they can also be run, and read, as Python. Types are those of the annotations; a local
variable has the type of what is first assigned to it. Numbers of the module are constants, and so are tuples of
numbers, of which one is read at a time.
"""

from __future__ import annotations

import ast
import functools
import inspect
import textwrap
from collections.abc import Callable, Mapping, Sequence
from types import FunctionType
from typing import Any, Final, NamedTuple

from valve_sim.model.core.code import POINTER, literal

_TYPES: Final = {"float": "double", "int": "i64", "bool": "i1", "Block": POINTER, "None": "void"}
_ARITHMETIC: Final = {
    ast.Add: ("fadd contract", "add"), ast.Sub: ("fsub contract", "sub"), ast.Mult: ("fmul contract", "mul"),
    ast.Div: ("fdiv", ""), ast.FloorDiv: ("", "sdiv"), ast.Mod: ("", "srem"),
}  # fmt: skip
_COMPARED: Final = {
    ast.Lt: ("olt", "slt"), ast.LtE: ("ole", "sle"), ast.Gt: ("ogt", "sgt"), ast.GtE: ("oge", "sge"),
    ast.Eq: ("oeq", "eq"), ast.NotEq: ("une", "ne"),
}  # fmt: skip
_FUNCTIONS: Final = {
    "sqrt": ("sqrt", 1), "exp": ("exp", 1), "log": ("log", 1), "floor": ("floor", 1), "fabs": ("fabs", 1),
    "expm1": ("", 1),
}  # fmt: skip


class Typed(NamedTuple):
    """A value and its LLVM type."""

    text: str
    type: str


def lowered(functions: Sequence[Callable[..., Any]], entries: Sequence[str], zeros: Sequence[str] = ()) -> str:
    """The text of some functions, of which `entries` can be called from outside.

    Args:
        zeros: what is read of a block and known to be 0, as it is written, `b[at.DENSITY]`: LLVM leaves out what is
            never reached then.

    Raises:
        SyntaxError: a function uses what is not part of the language; the message has its name and line.
    """
    known = {function.__name__: function for function in functions}
    tables: dict[str, tuple[float, ...]] = {}
    parts = [
        _Function(function, known, tables, zeros).text(public=function.__name__ in entries) for function in functions
    ]
    kinds = {"fmuladd": 3, "pow": 2}
    declared = [f"declare double @llvm.{name}.f64(double)" for name, _ in _FUNCTIONS.values() if name]
    declared += [f"declare double @llvm.{name}.f64({', '.join(['double'] * count)})" for name, count in kinds.items()]
    constants = [
        f"@{name} = internal constant [{len(numbers)} x double] ["
        + ", ".join(f"double {literal(float(number))}" for number in numbers) + "]"
        for name, numbers in tables.items()
    ]  # fmt: skip
    return "\n".join([*declared, "declare double @expm1(double)", *constants, *parts])


@functools.cache
def _parsed(function: Callable[..., Any]) -> ast.FunctionDef:
    (tree,) = ast.parse(textwrap.dedent(inspect.getsource(function))).body
    assert isinstance(tree, ast.FunctionDef)
    return tree


class _Function:
    """One function that is being lowered."""

    def __init__(
        self,
        function: Callable[..., Any],
        known: Mapping[str, Callable[..., Any]],
        tables: dict[str, tuple[float, ...]],
        zeros: Sequence[str],
    ) -> None:
        assert isinstance(function, FunctionType)
        tree = _parsed(function)
        self._tree, self._globals, self._known, self._tables = tree, function.__globals__, known, tables
        self._zeros = zeros
        self._name = function.__name__
        self._lines: list[str] = []
        self._places: list[str] = []
        self._locals: dict[str, str] = {}
        self._loops: list[tuple[str, str]] = []
        self._count = 0
        self._is_open = True
        self.returns = _TYPES[ast.unparse(tree.returns)] if tree.returns else "void"
        self.arguments = [(a.arg, _TYPES[ast.unparse(a.annotation)]) for a in tree.args.args if a.annotation]

    def text(self, *, public: bool) -> str:
        """The whole function."""
        for name, kind in self.arguments:
            self._declare(name, kind)
            self._line(f"store {kind} %a.{name}, {self._pointer(kind)} %l.{name}")
        self._body(self._tree.body)
        if self._is_open:
            self._line("ret void" if self.returns == "void" else "unreachable")
        given = ", ".join(f"{kind} %a.{name}" for name, kind in self.arguments)
        linkage = "" if public else "internal "
        body = "\n  ".join([*self._places, *self._lines])
        return f"define {linkage}{self.returns} @{self._name}({given}) {{\n  {body}\n}}\n"

    def _fail(self, node: ast.AST, why: str) -> SyntaxError:
        return SyntaxError(f"{self._name}, line {getattr(node, 'lineno', 0)}: {why}: {ast.unparse(node)}")

    @staticmethod
    def _pointer(kind: str) -> str:
        return "ptr" if POINTER == "ptr" else f"{kind}*"

    def _declare(self, name: str, kind: str) -> None:
        self._locals[name] = kind
        self._places.append(f"%l.{name} = alloca {kind}")

    def _line(self, text: str) -> None:
        if self._is_open:
            self._lines.append(text)
            if text.split(maxsplit=1)[0] in ("ret", "br", "unreachable"):
                self._is_open = False

    def _new(self, text: str, kind: str) -> Typed:
        self._count += 1
        self._line(f"%r{self._count} = {text}")
        return Typed(f"%r{self._count}", kind)

    def _label(self) -> str:
        self._count += 1
        return f"b{self._count}"

    def _start(self, label: str) -> None:
        """Begin a basic block."""
        self._line(f"br label %{label}")
        self._lines.append(f"{label}:")
        self._is_open = True

    # Statements.

    def _body(self, statements: Sequence[ast.stmt]) -> None:
        for statement in statements:
            kind = type(statement).__name__
            if not hasattr(self, f"_do_{kind}"):
                raise self._fail(statement, f"{kind} is not part of the language")
            getattr(self, f"_do_{kind}")(statement)

    def _do_Expr(self, statement: ast.Expr) -> None:  # noqa: N802
        if not isinstance(statement.value, ast.Constant):
            self._value(statement.value)

    def _do_Pass(self, statement: ast.Pass) -> None:  # noqa: N802
        pass

    def _do_Assign(self, statement: ast.Assign) -> None:  # noqa: N802
        value = self._value(statement.value)
        for target in statement.targets:
            self._assign(target, value)

    def _do_AnnAssign(self, statement: ast.AnnAssign) -> None:  # noqa: N802
        assert statement.value is not None
        self._assign(
            statement.target, self._cast(self._value(statement.value), _TYPES[ast.unparse(statement.annotation)])
        )

    def _do_AugAssign(self, statement: ast.AugAssign) -> None:  # noqa: N802
        target = statement.target
        before = ast.copy_location(ast.parse(ast.unparse(target), mode="eval").body, target)
        self._assign(
            target, self._arithmetic(statement, statement.op, self._value(before), self._value(statement.value))
        )

    def _assign(self, target: ast.expr, value: Typed) -> None:
        if isinstance(target, ast.Name):
            if target.id not in self._locals:
                self._declare(target.id, value.type)
            kind = self._locals[target.id]
            value = self._cast(value, kind)
            self._line(f"store {kind} {value.text}, {self._pointer(kind)} %l.{target.id}")
        elif isinstance(target, ast.Subscript):
            place = self._place(target.value, target.slice)
            self._line(f"store double {self._cast(value, 'double').text}, {POINTER} {place.text}")
        else:
            raise self._fail(target, "nothing can be assigned to this")

    def _do_If(self, statement: ast.If) -> None:  # noqa: N802
        then, other, after = self._label(), self._label(), self._label()
        self._branch(statement.test, then, other)
        for label, body in ((then, statement.body), (other, statement.orelse)):
            self._lines.append(f"{label}:")
            self._is_open = True
            self._body(body)
            self._line(f"br label %{after}")
        self._lines.append(f"{after}:")
        self._is_open = True

    def _do_While(self, statement: ast.While) -> None:  # noqa: N802
        test, body, after = self._label(), self._label(), self._label()
        self._start(test)
        self._branch(statement.test, body, after)
        self._loop(statement.body, body, test, after)

    def _loop(self, statements: Sequence[ast.stmt], body: str, again: str, after: str) -> None:
        self._lines.append(f"{body}:")
        self._is_open = True
        self._loops.append((again, after))
        self._body(statements)
        self._loops.pop()
        self._line(f"br label %{again}")
        self._lines.append(f"{after}:")
        self._is_open = True

    def _do_For(self, statement: ast.For) -> None:  # noqa: N802
        call, target = statement.iter, statement.target
        if not (isinstance(call, ast.Call) and ast.unparse(call.func) == "range" and isinstance(target, ast.Name)):
            raise self._fail(statement.target, "a loop goes over a range")
        limits = [self._cast(self._value(argument), "i64") for argument in call.args]
        first, last = limits[:2] if len(limits) > 1 else (Typed("0", "i64"), limits[0])
        by = limits[2].text if len(limits) == 3 else "1"
        down = by.startswith("-")
        self._count += 1
        counter = f"{target.id}.{self._count}"
        self._declare(counter, "i64")
        if target.id not in self._locals:
            self._declare(target.id, "i64")
        pointer = self._pointer("i64")
        self._line(f"store i64 {first.text}, {pointer} %l.{counter}")
        test, body, step, after = self._label(), self._label(), self._label(), self._label()
        self._start(test)
        now = self._new(f"load i64, {pointer} %l.{counter}", "i64")
        more = self._new(f"icmp {'sgt' if down else 'slt'} i64 {now.text}, {last.text}", "i1")
        self._line(f"br i1 {more.text}, label %{body}, label %{after}")
        self._lines.append(f"{body}:")
        self._is_open = True
        self._line(f"store i64 {now.text}, {pointer} %l.{target.id}")
        self._loops.append((step, after))
        self._body(statement.body)
        self._loops.pop()
        self._start(step)
        following = self._new(f"add nsw i64 {now.text}, {by}", "i64")
        self._line(f"store i64 {following.text}, {pointer} %l.{counter}")
        self._line(f"br label %{test}")
        self._lines.append(f"{after}:")
        self._is_open = True

    def _do_Break(self, statement: ast.Break) -> None:  # noqa: N802
        self._line(f"br label %{self._loops[-1][1]}")

    def _do_Continue(self, statement: ast.Continue) -> None:  # noqa: N802
        self._line(f"br label %{self._loops[-1][0]}")

    def _do_Return(self, statement: ast.Return) -> None:  # noqa: N802
        if statement.value is None:
            self._line("ret void")
            return
        value = self._cast(self._value(statement.value), self.returns)
        self._line(f"ret {self.returns} {value.text}")

    # Expressions.

    def _branch(self, test: ast.expr, then: str, other: str) -> None:
        """Go one way or the other; what decides already is not followed by more tests."""
        if isinstance(test, ast.BoolOp):
            for part in test.values[:-1]:
                following = self._label()
                if isinstance(test.op, ast.And):
                    self._branch(part, following, other)
                else:
                    self._branch(part, then, following)
                self._lines.append(f"{following}:")
                self._is_open = True
            self._branch(test.values[-1], then, other)
        elif isinstance(test, ast.UnaryOp) and isinstance(test.op, ast.Not):
            self._branch(test.operand, other, then)
        elif isinstance(test, ast.Constant) and test.value is True:
            self._line(f"br label %{then}")
        else:
            value = self._value(test)
            if value.type != "i1":
                raise self._fail(test, "a condition is a comparison")
            self._line(f"br i1 {value.text}, label %{then}, label %{other}")

    def _cast(self, value: Typed, kind: str) -> Typed:
        if value.type == kind:
            return value
        if (value.type, kind) == ("i64", "double"):
            if value.text.lstrip("-").isdigit():
                return Typed(literal(float(value.text)), "double")
            return self._new(f"sitofp i64 {value.text} to double", "double")
        if (value.type, kind) == ("double", "i64"):
            return self._new(f"fptosi double {value.text} to i64", "i64")
        if (value.type, kind) == ("i1", "double"):
            return self._new(f"uitofp i1 {value.text} to double", "double")
        raise SyntaxError(f"{self._name}: no {kind} can be made of a {value.type}")

    def _value(self, node: ast.expr) -> Typed:
        kind = type(node).__name__
        if not hasattr(self, f"_of_{kind}"):
            raise self._fail(node, f"{kind} is not part of the language")
        return getattr(self, f"_of_{kind}")(node)  # type: ignore[no-any-return]

    def _of_Constant(self, node: ast.Constant) -> Typed:  # noqa: N802
        return self._number(node, node.value)

    def _number(self, node: ast.expr, value: object) -> Typed:
        if isinstance(value, bool):
            return Typed("true" if value else "false", "i1")
        if isinstance(value, int):
            return Typed(str(int(value)), "i64")
        if isinstance(value, float):
            return Typed(literal(value), "double")
        raise self._fail(node, "this is no number")

    def _of_Name(self, node: ast.Name) -> Typed:  # noqa: N802
        if node.id in self._locals:
            kind = self._locals[node.id]
            return self._new(f"load {kind}, {self._pointer(kind)} %l.{node.id}", kind)
        if node.id in self._globals:
            return self._number(node, self._globals[node.id])
        raise self._fail(node, "unknown name")

    def _of_Attribute(self, node: ast.Attribute) -> Typed:  # noqa: N802
        return self._number(node, getattr(self._globals[ast.unparse(node.value)], node.attr))

    def _place(self, block: ast.expr, index: ast.expr) -> Typed:
        table = self._globals.get(block.id) if isinstance(block, ast.Name) and block.id not in self._locals else None
        if isinstance(table, tuple):
            assert isinstance(block, ast.Name)
            self._tables[block.id] = table
            kind, offset = f"[{len(table)} x double]", self._cast(self._value(index), "i64")
            return self._new(
                f"getelementptr {kind}, {self._pointer(kind)} @{block.id}, i64 0, i64 {offset.text}", POINTER
            )
        start, offset = self._value(block), self._cast(self._value(index), "i64")
        return self._new(f"getelementptr double, {POINTER} {start.text}, i64 {offset.text}", POINTER)

    def _of_Subscript(self, node: ast.Subscript) -> Typed:  # noqa: N802
        if isinstance(node.slice, ast.Slice):
            assert node.slice.lower is not None
            return self._place(node.value, node.slice.lower)
        if ast.unparse(node) in self._zeros:
            return Typed(literal(0.0), "double")
        return self._new(f"load double, {POINTER} {self._place(node.value, node.slice).text}", "double")

    def _of_BinOp(self, node: ast.BinOp) -> Typed:  # noqa: N802
        return self._arithmetic(node, node.op, self._value(node.left), self._value(node.right))

    def _arithmetic(self, node: ast.AST, op: ast.operator, a: Typed, b: Typed) -> Typed:
        of_doubles, of_integers = _ARITHMETIC[type(op)]
        kind = "i64" if a.type == b.type == "i64" and of_integers else "double"
        name = of_integers if kind == "i64" else of_doubles
        if not name:
            raise self._fail(node, "no such arithmetic of doubles")
        return self._new(f"{name} {kind} {self._cast(a, kind).text}, {self._cast(b, kind).text}", kind)

    def _of_UnaryOp(self, node: ast.UnaryOp) -> Typed:  # noqa: N802
        value = self._value(node.operand)
        if isinstance(node.op, ast.Not):
            return self._new(f"xor i1 {value.text}, true", "i1")
        if not value.text.startswith("%"):
            operand = node.operand
            if isinstance(operand, ast.Constant) and isinstance(operand.value, int | float):
                return self._number(node, -operand.value)
        if value.type == "i64":
            return self._new(f"sub i64 0, {value.text}", "i64")
        return self._new(f"fneg double {value.text}", "double")

    def _of_Compare(self, node: ast.Compare) -> Typed:  # noqa: N802
        if isinstance(node.ops[0], ast.In | ast.NotIn):
            return self._among(node)
        sides = [self._value(side) for side in (node.left, *node.comparators)]
        found: Typed | None = None
        for op, a, b in zip(node.ops, sides, sides[1:], strict=False):
            one = self._compared(op, a, b)
            found = one if found is None else self._new(f"and i1 {found.text}, {one.text}", "i1")
        assert found is not None
        return found

    def _among(self, node: ast.Compare) -> Typed:
        """Whether a value is one of several, or none of them."""
        value, several = self._value(node.left), node.comparators[0]
        assert isinstance(several, ast.Tuple)
        found = Typed("false", "i1")
        for one in several.elts:
            equal = self._compared(ast.Eq(), value, self._value(one))
            found = self._new(f"or i1 {found.text}, {equal.text}", "i1")
        return self._new(f"xor i1 {found.text}, true", "i1") if isinstance(node.ops[0], ast.NotIn) else found

    def _compared(self, op: ast.cmpop, a: Typed, b: Typed) -> Typed:
        of_doubles, of_integers = _COMPARED[type(op)]
        if a.type == b.type and a.type in ("i64", "i1"):
            return self._new(f"icmp {of_integers} {a.type} {a.text}, {b.text}", "i1")
        return self._new(
            f"fcmp {of_doubles} double {self._cast(a, 'double').text}, {self._cast(b, 'double').text}", "i1"
        )

    def _of_BoolOp(self, node: ast.BoolOp) -> Typed:  # noqa: N802
        return self._chosen(node, Typed("true", "i1"), Typed("false", "i1"))

    def _of_IfExp(self, node: ast.IfExp) -> Typed:  # noqa: N802
        return self._chosen(node.test, node.body, node.orelse)

    def _chosen(self, test: ast.expr, if_so: ast.expr | Typed, if_not: ast.expr | Typed) -> Typed:
        then, other, after = self._label(), self._label(), self._label()
        self._count += 1
        name = f"c.{self._count}"
        self._branch(test, then, other)
        kind = ""
        for label, expression in ((then, if_so), (other, if_not)):
            self._lines.append(f"{label}:")
            self._is_open = True
            value = expression if isinstance(expression, Typed) else self._value(expression)
            if not kind:
                kind = value.type
                self._declare(name, kind)
            self._line(f"store {kind} {self._cast(value, kind).text}, {self._pointer(kind)} %l.{name}")
            self._line(f"br label %{after}")
        self._lines.append(f"{after}:")
        self._is_open = True
        return self._new(f"load {kind}, {self._pointer(kind)} %l.{name}", kind)

    def _of_Call(self, node: ast.Call) -> Typed:  # noqa: N802
        name = ast.unparse(node.func).removeprefix("math.")
        if name == "invoke":
            return self._invoke(node)
        values = [self._value(argument) for argument in node.args]
        if name in ("float", "int"):
            return self._cast(values[0], _TYPES[name])
        if name == "abs":
            name, values = "fabs", [self._cast(values[0], "double")]
        if name in ("min", "max"):
            return self._extreme(name, values)
        if name in _FUNCTIONS:
            inner, _ = _FUNCTIONS[name]
            symbol = f"llvm.{inner}.f64" if inner else name
            return self._new(f"call double @{symbol}(double {self._cast(values[0], 'double').text})", "double")
        if name not in self._known:
            raise self._fail(node, "unknown function")
        called = _Function(self._known[name], self._known, self._tables, self._zeros)
        given = ", ".join(
            f"{kind} {self._cast(value, kind).text}" for value, (_, kind) in zip(values, called.arguments, strict=True)
        )
        text = f"call {called.returns} @{name}({given})"
        if called.returns == "void":
            self._line(text)
            return Typed("", "void")
        return self._new(text, called.returns)

    def _extreme(self, name: str, values: Sequence[Typed]) -> Typed:
        found = values[0]
        for value in values[1:]:
            kind = "i64" if found.type == value.type == "i64" else "double"
            a, b = self._cast(found, kind), self._cast(value, kind)
            test = self._compared(ast.Lt() if name == "min" else ast.Gt(), b, a)
            found = self._new(f"select i1 {test.text}, {kind} {b.text}, {kind} {a.text}", kind)
        return found

    def _invoke(self, node: ast.Call) -> Typed:
        """A call of a kernel, whose address stands in a block as bits."""
        address, *given = (self._value(argument) for argument in node.args)
        bits = self._new(f"bitcast double {address.text} to i64", "i64")
        kinds = ", ".join([POINTER] * len(given))
        pointer = "ptr" if POINTER == "ptr" else f"void ({kinds})*"
        function = self._new(f"inttoptr i64 {bits.text} to {pointer}", pointer)
        self._line(f"call void {function.text}({', '.join(f'{POINTER} {value.text}' for value in given)})")
        return Typed("", "void")
