"""Straight-line code for the processor, as text of LLVM's intermediate representation.

A value is a single double, or one for each direction of a derivative (`width`). Operations between a single and a wide
value repeat the single one. Every operation rounds for itself, and `fma` says where two are one: so the numbers are the
same to the last bit however hard the code is optimised.
"""

from __future__ import annotations

import math
import struct
from typing import Final, NamedTuple

import llvmlite.binding as llvm

POINTER: Final = "ptr" if llvm.llvm_version_info[0] >= 15 else "double*"
"""How LLVM spells a pointer to doubles."""
_LN2_HIGH: Final = 6.93147180369123816490e-01
_LN2_LOW: Final = 1.90821492927058770002e-10
_EXP_TERMS: Final = 13
"""Of the series of exp between −ln 2/2 and ln 2/2: the next one is below rounding."""
_SMALLEST_EXPONENT: Final = -708.0
"""Below it exp is taken as 0: processors are slow with smaller numbers."""


class Value(NamedTuple):
    """The result of an instruction: its name, and its LLVM type."""

    text: str
    type: str


def literal(number: float) -> str:
    """A double as LLVM reads it, to the last bit."""
    return f"0x{struct.unpack('<Q', struct.pack('<d', number))[0]:016X}"


class Code:
    """The body of one function of two pointers: the valve's block, and its tangents.

    Args:
        width: how many directions of derivatives; 0 for none.
    """

    def __init__(self, width: int = 0) -> None:
        self.wide, self.width = f"<{width} x double>", width
        self.lines: list[str] = []
        self.declared: set[str] = set()
        self._repeated: dict[str, Value] = {}
        self._count = 0

    def emit(self, instruction: str, kind: str) -> Value:
        """Append an instruction that makes a value."""
        self._count += 1
        name = f"%v{self._count}"
        self.lines.append(f"{name} = {instruction}")
        return Value(name, kind)

    def constant(self, number: float, kind: str = "double") -> Value:
        """A number, the same in all directions."""
        if kind == "double":
            return Value(literal(number), kind)
        count = int(kind[1:].split(maxsplit=1)[0])
        return Value("<" + ", ".join([f"double {literal(number)}"] * count) + ">", kind)

    def _place(self, slot: int, *, wide: bool = False) -> str:
        pointer, step = ("%t", self.width) if wide else ("%b", 1)
        return self.emit(f"getelementptr double, {POINTER} {pointer}, i64 {slot * step}", POINTER).text

    def load(self, slot: int, *, wide: bool = False) -> Value:
        """The value in a slot of the block, or its tangents."""
        kind = self.wide if wide else "double"
        place, pointer = self._cast(self._place(slot, wide=wide), kind)
        return self.emit(f"load {kind}, {pointer} {place}, align 8", kind)

    def store(self, slot: int, value: Value, *, wide: bool = False) -> None:
        """Put a value into a slot."""
        if wide:
            value = self.repeated(value)
        place, pointer = self._cast(self._place(slot, wide=wide), value.type)
        self.lines.append(f"store {value.type} {value.text}, {pointer} {place}, align 8")

    def _cast(self, place: str, kind: str) -> tuple[str, str]:
        """A place for values of a type, and the type of the pointer to it."""
        if POINTER == "ptr" or kind == "double":
            return place, POINTER
        return self.emit(f"bitcast double* {place} to {kind}*", f"{kind}*").text, f"{kind}*"

    def repeated(self, value: Value) -> Value:
        """A value as a wide one."""
        if not self.width or value.type == self.wide:
            return value
        found = self._repeated.get(value.text)
        if found is None:
            if not value.text.startswith("%"):
                number = struct.unpack("<d", struct.pack("<Q", int(value.text, 16)))[0]
                return self.constant(number, self.wide)
            first = self.emit(f"insertelement {self.wide} undef, double {value.text}, i32 0", self.wide)
            mask = f"<{self.width} x i32> zeroinitializer"
            found = self.emit(f"shufflevector {self.wide} {first.text}, {self.wide} undef, {mask}", self.wide)
            self._repeated[value.text] = found
        return found

    def _matched(self, *values: Value) -> tuple[Value, ...]:
        for value in values:
            if value.type != values[0].type:
                return tuple([self.repeated(own) for own in values])
        return values

    def _binary(self, op: str, a: Value, b: Value) -> Value:
        a, b = self._matched(a, b)
        return self.emit(f"{op} {a.type} {a.text}, {b.text}", a.type)

    def add(self, a: Value, b: Value) -> Value:
        """The sum."""
        return self._binary("fadd", a, b)

    def sub(self, a: Value, b: Value) -> Value:
        """The difference."""
        return self._binary("fsub", a, b)

    def mul(self, a: Value, b: Value) -> Value:
        """The product."""
        return self._binary("fmul", a, b)

    def div(self, a: Value, b: Value) -> Value:
        """The quotient."""
        return self._binary("fdiv", a, b)

    def neg(self, a: Value) -> Value:
        """The negative."""
        return self.emit(f"fneg {a.type} {a.text}", a.type)

    def fma(self, a: Value, b: Value, c: Value) -> Value:
        """The sum a b + c, rounded once where the processor can."""
        a, b, c = self._matched(a, b, c)
        return self.call("fmuladd", a, b, c)

    def call(self, name: str, *arguments: Value) -> Value:
        """One of LLVM's functions of doubles: exp, log, fabs, fmuladd and so on."""
        kind = arguments[0].type
        suffix = "f64" if kind == "double" else f"v{kind[1:].split()[0]}f64"
        types = ", ".join([kind] * len(arguments))
        self.declared.add(f"declare {kind} @llvm.{name}.{suffix}({types})")
        given = ", ".join(f"{kind} {argument.text}" for argument in arguments)
        return self.emit(f"call {kind} @llvm.{name}.{suffix}({given})", kind)

    def library(self, name: str, a: Value) -> Value:
        """One of the functions of C's mathematics that LLVM does not know: expm1, log1p; of each direction in turn."""
        self.declared.add(f"declare double @{name}(double)")
        if a.type == "double":
            return self.emit(f"call double @{name}(double {a.text})", "double")
        made = Value("undef", a.type)
        for lane in range(int(a.type[1:].split()[0])):
            one = self.emit(f"extractelement {a.type} {a.text}, i32 {lane}", "double")
            found = self.emit(f"call double @{name}(double {one.text})", "double")
            made = self.emit(f"insertelement {a.type} {made.text}, double {found.text}, i32 {lane}", a.type)
        return made

    def compare(self, how: str, a: Value, b: Value) -> Value:
        """Whether two values compare so: ogt, olt, oge, ole, oeq."""
        kind = "i1" if a.type == "double" else a.type.replace("double", "i1")
        return self.emit(f"fcmp {how} {a.type} {a.text}, {b.text}", kind)

    def select(self, condition: Value, a: Value, b: Value) -> Value:
        """The one value where the condition holds, the other where not."""
        a, b = self._matched(a, b)
        return self.emit(f"select {condition.type} {condition.text}, {a.type} {a.text}, {b.type} {b.text}", a.type)

    def both(self, a: Value, b: Value) -> Value:
        """Whether both conditions hold."""
        return self.emit(f"and {a.type} {a.text}, {b.text}", a.type)

    def either(self, a: Value, b: Value) -> Value:
        """Whether one of two conditions holds."""
        return self.emit(f"or {a.type} {a.text}, {b.text}", a.type)

    def smaller(self, a: Value, b: Value) -> Value:
        """The smaller of two values; the second if one is no number."""
        return self.select(self.compare("olt", a, b), a, b)

    def larger(self, a: Value, b: Value) -> Value:
        """The larger of two values; the second if one is no number."""
        return self.select(self.compare("ogt", a, b), a, b)

    def exp(self, a: Value) -> Value:
        """The exponential function, 2ⁿ times the series of exp of what is left of a."""
        bounded = self.larger(self.smaller(a, self.constant(709.0, a.type)), self.constant(-709.0, a.type))
        n = self.call("rint", self.mul(bounded, self.constant(1.0 / math.log(2.0), a.type)))
        rest = self.fma(n, self.constant(-_LN2_HIGH, a.type), bounded)
        rest = self.fma(n, self.constant(-_LN2_LOW, a.type), rest)
        total = self.constant(1.0 / math.factorial(_EXP_TERMS), a.type)
        for order in range(_EXP_TERMS - 1, -1, -1):
            total = self.fma(total, rest, self.constant(1.0 / math.factorial(order), a.type))
        grown = self.mul(total, self._power_of_two(self.add(n, self.constant(1023.0, a.type))))
        return self.select(
            self.compare("ogt", a, self.constant(_SMALLEST_EXPONENT, a.type)), grown, self.constant(0.0, a.type)
        )

    def _integers(self, kind: str) -> str:
        return kind.replace("double", "i64")

    def _power_of_two(self, biased: Value) -> Value:
        """The double whose exponent, with the bias of 1023, is the integer part, and whose fraction is the rest."""
        scaled = self.mul(biased, self.constant(2.0**52, biased.type))
        whole = self._integers(biased.type)
        bits = self.emit(f"fptosi {biased.type} {scaled.text} to {whole}", whole)
        return self.emit(f"bitcast {whole} {bits.text} to {biased.type}", biased.type)

    def rough_log2(self, a: Value) -> Value:
        """Logarithm to base 2 of something positive, too small by 0.086 at most; of 0 it is −1023."""
        whole = self._integers(a.type)
        bits = self.emit(f"bitcast {a.type} {a.text} to {whole}", whole)
        number = self.emit(f"sitofp {whole} {bits.text} to {a.type}", a.type)
        return self.fma(number, self.constant(2.0**-52, a.type), self.constant(-1023.0, a.type))

    def rough_exp2(self, a: Value) -> Value:
        """The power of 2, too large by 6 % at most."""
        return self._power_of_two(self.add(a, self.constant(1023.0, a.type)))

    def function(self, name: str) -> str:
        """The whole function; what it calls is in `declared`."""
        body = "\n  ".join(self.lines)
        return f"define void @{name}({POINTER} noalias %b, {POINTER} noalias %t) {{\n  {body}\n  ret void\n}}\n"
