"""Taylor coefficients of a graph, emitted as code: the recurrences of automatic differentiation (Moore 1966).

With a_k the coefficient of order k of an expression a about the start of a step:

    (a + b)_k = a_k + b_k          (a b)_k = Σ a_i b_{k−i}          (a/b)_k = (a_k − Σ_{j≥1} b_j (a/b)_{k−j}) / b_0
    (eᵃ)_k = Σ_{j≥1} (j/k) a_j (eᵃ)_{k−j}          and likewise for the others

A state s with s' = r has s_{k+1} = r_k/(k + 1).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from valve_sim.model.core.code import Code, Value
from valve_sim.model.core.tracer import Node, polynomial_slope

FLAG_IS_SET = 0.5
"""Between the two values of a flag, 0 and 1."""


class Series:
    """Coefficients of the nodes of one graph, each emitted when it is first asked for.

    Args:
        code: what is appended to.
        slot_of: the slot of a number, by its name.
        start: the values of states, and of numbers, at the start, by name; what is not given is loaded.
        rates: of the states, by name; a state without one stays as it is.
        clock: the time that the start is after that of the step; default 0.
        flag_slots: of each guard its slot; None where flags are decided from the values themselves.
    """

    def __init__(
        self,
        code: Code,
        slot_of: Callable[[str], int],
        start: Mapping[str, Value],
        rates: Mapping[str, Node],
        flag_slots: Mapping[Node, int],
        *,
        clock: Value | None = None,
        decides: bool = False,
    ) -> None:
        self._code, self._slot_of, self._start, self._rates = code, slot_of, dict(start), rates
        self._flag_slots, self._elapsed, self._decides = flag_slots, clock, decides
        self._known: dict[tuple[int, int], Value | None] = {}
        self._conditions: dict[int, Value] = {}
        self._chosen: dict[int, Value] = {}
        self._scaled: dict[tuple[int, int], Value | None] = {}

    def value(self, node: Node) -> Value:
        """The value at the start of the step."""
        found = self.coefficient(node, 0)
        return self._code.constant(0.0) if found is None else found

    def coefficient(self, node: Node, order: int) -> Value | None:
        """The coefficient of some order; None where it is 0."""
        key = (node.index, order)
        if key not in self._known:
            self._known[key] = self._made(node, order)
        return self._known[key]

    def _made(self, node: Node, order: int) -> Value | None:
        if order > 0 and node.steady:
            return None
        return getattr(self, f"_{node.op}")(node, order)  # type: ignore[no-any-return]

    def _constant(self, node: Node, order: int) -> Value | None:
        return None if node.value == 0.0 else self._code.constant(node.value or 0.0)

    def _number(self, node: Node, order: int) -> Value:
        name = str(node.payload)
        return self._start[name] if name in self._start else self._load(name)

    def _load(self, name: str) -> Value:
        if name.startswith("d "):
            return self._code.load(self._slot_of(name[2:]), wide=True)
        return self._code.load(self._slot_of(name))

    def _state(self, node: Node, order: int) -> Value | None:
        name = str(node.payload)
        if order == 0:
            if name not in self._start:
                self._start[name] = self._load(name)
            return self._start[name]
        rate = self._rates.get(name)
        if rate is None:
            return None
        if rate.op == "mul" and rate.args[0].steady != rate.args[1].steady:
            steady, varying = rate.args if rate.args[0].steady else rate.args[::-1]
            slope, factor = self.coefficient(varying, order - 1), self._shared(steady, order)
        else:
            slope, factor = self.coefficient(rate, order - 1), self._code.constant(1.0 / order)
        return None if slope is None else self._code.mul(slope, factor)

    def _shared(self, steady: Node, order: int) -> Value:
        """A steady value over an order."""
        key = (steady.index, -order - 1)
        if key not in self._known:
            self._known[key] = self._code.mul(self.value(steady), self._code.constant(1.0 / order))
        found = self._known[key]
        assert found is not None
        return found

    def _polynomial(self, node: Node, order: int) -> Value | None:
        code = self._code
        a, *coefficients = node.args
        if order == 0:
            total, *others = (self.value(c) for c in reversed(coefficients))
            for other in others:
                total = code.fma(total, self.value(a), other)
            return total
        slope = polynomial_slope(node)
        moved = self._products((self._times_order(a, j), self.coefficient(slope, order - j)) for j in range(1, order))
        if moved is not None:
            moved = code.mul(moved, code.constant(1.0 / order))
        last, first = self.coefficient(a, order), self.value(slope)
        if last is None:
            return moved
        return code.mul(last, first) if moved is None else code.fma(last, first, moved)

    def _clock(self, node: Node, order: int) -> Value | None:
        if order == 0:
            return self._elapsed
        return self._code.constant(1.0) if order == 1 else None

    def _add(self, node: Node, order: int) -> Value | None:
        a, b = (self.coefficient(argument, order) for argument in node.args)
        if a is None or b is None:
            return b if a is None else a
        return self._code.add(a, b)

    def _sub(self, node: Node, order: int) -> Value | None:
        a, b = (self.coefficient(argument, order) for argument in node.args)
        if b is None:
            return a
        return self._code.neg(b) if a is None else self._code.sub(a, b)

    def _neg(self, node: Node, order: int) -> Value | None:
        a = self.coefficient(node.args[0], order)
        return None if a is None else self._code.neg(a)

    def _mul(self, node: Node, order: int) -> Value | None:
        a, b = node.args
        if a is b:
            return self._square(a, order)
        if a.late and not b.late:
            a, b = b, a
        orders = sorted(range(order + 1), key=lambda i: (max(i, order - i), -i))
        return self._products((self.coefficient(a, i), self.coefficient(b, order - i)) for i in orders)

    def _square(self, a: Node, order: int) -> Value | None:
        code = self._code
        total = self._products(
            (self.coefficient(a, order - i), self.coefficient(a, i)) for i in range((order - 1) // 2, -1, -1)
        )
        if total is not None:
            total = code.add(total, total)
        if order % 2 == 0:
            middle = self.coefficient(a, order // 2)
            if middle is not None:
                return code.mul(middle, middle) if total is None else code.fma(middle, middle, total)
        return total

    def _products(self, pairs) -> Value | None:  # type: ignore[no-untyped-def]
        """The sum of products, of which those that are known last are added last."""
        total = None
        for a, b in pairs:
            if a is not None and b is not None:
                total = self._code.mul(a, b) if total is None else self._code.fma(a, b, total)
        return total

    def _reciprocal(self, node: Node) -> Value:
        key = (node.index, -1)
        if key not in self._known:
            start = self.value(node)
            self._known[key] = self._code.div(self._code.constant(1.0, start.type), start)
        found = self._known[key]
        assert found is not None
        return found

    def _div(self, node: Node, order: int) -> Value | None:
        a, b = node.args
        code = self._code
        left = self.coefficient(a, order)
        taken = self._products((self.coefficient(b, j), self.coefficient(node, order - j)) for j in range(order, 0, -1))
        if taken is not None:
            left = code.neg(taken) if left is None else code.sub(left, taken)
        return None if left is None else code.mul(left, self._reciprocal(b))

    def _times_order(self, node: Node, order: int) -> Value | None:
        """The coefficient of the derivative by the logarithm of time: k a_k."""
        rate = self._rates.get(str(node.payload)) if node.op == "state" else None
        if rate is not None and rate.op == "state":
            return self.coefficient(rate, order - 1)
        key = (node.index, order)
        if key not in self._scaled:
            a = self.coefficient(node, order)
            if a is not None and order != 1:
                a = self._code.mul(a, self._code.constant(float(order)))
            self._scaled[key] = a
        return self._scaled[key]

    def _chain(self, node: Node, slope: Node, order: int) -> Value | None:
        """(1/k) Σ j a_j y_{k−j}, the coefficient of something whose derivative is y a'."""
        total = self._products(
            (self._times_order(node.args[0], j), self.coefficient(slope, order - j)) for j in range(order, 0, -1)
        )
        return None if total is None else self._code.mul(total, self._code.constant(1.0 / order))

    def _exp(self, node: Node, order: int) -> Value | None:
        if order == 0:
            return self._code.exp(self.value(node.args[0]))
        return self._chain(node, node, order)

    def _sin(self, node: Node, order: int) -> Value | None:
        if order == 0:
            return self._code.call("sin", self.value(node.args[0]))
        return self._chain(node, node.trace.node("cos", node.args[0]), order)

    def _cos(self, node: Node, order: int) -> Value | None:
        if order == 0:
            return self._code.call("cos", self.value(node.args[0]))
        found = self._chain(node, node.trace.node("sin", node.args[0]), order)
        return None if found is None else self._code.neg(found)

    def _tanh(self, node: Node, order: int) -> Value | None:
        code = self._code
        if order == 0:
            one, grown = (
                code.constant(1.0),
                code.exp(code.mul(code.constant(-2.0), code.call("fabs", self.value(node.args[0])))),
            )
            size = code.div(code.sub(one, grown), code.add(one, grown))
            return code.call("copysign", size, self.value(node.args[0]))
        return self._chain(node, 1.0 - node * node, order)

    def _log(self, node: Node, order: int) -> Value | None:
        if order == 0:
            return self._code.call("log", self.value(node.args[0]))
        return self._chain(node, 1.0 / node.args[0], order)

    def _log1p(self, node: Node, order: int) -> Value | None:
        if order == 0:
            return self._code.library("log1p", self.value(node.args[0]))
        return self._chain(node, 1.0 / (1.0 + node.args[0]), order)

    def _expm1(self, node: Node, order: int) -> Value | None:
        if order == 0:
            return self._code.library("expm1", self.value(node.args[0]))
        return self._chain(node, 1.0 + node, order)

    def _power(self, node: Node, order: int) -> Value | None:
        code, (a,), exponent = self._code, node.args, float(node.payload)  # type: ignore[arg-type]
        if order == 0:
            start = self.value(a)
            return code.call("sqrt", start) if exponent == 0.5 else code.call("pow", start, code.constant(exponent))
        total = self._products(
            (
                self.coefficient(a, j),
                None if (y := self.coefficient(node, order - j)) is None
                else code.mul(y, code.constant((exponent * j - (order - j)) / order)),
            )
            for j in range(order, 0, -1)
        )  # fmt: skip
        return None if total is None else code.mul(total, self._reciprocal(a))

    def _rising(self, node: Node, order: int) -> Value | None:
        a, so_far = node.args
        code = self._code
        above = self.coefficient(a, order)
        if order == 0:
            above = code.sub(self.value(a), self.value(so_far))
        slope = self._times_order(a, order + 1)
        zero = code.constant(0.0)
        return code.select(self.condition(node), slope or zero, above or zero)

    def condition(self, excess: Node) -> Value:
        """Whether a comparison holds in this step."""
        if excess.index not in self._conditions:
            code, zero = self._code, self._code.constant(0.0)
            if excess.steady:
                found = code.compare("ogt", self.value(excess), zero)
            elif self._decides:
                now, slope = self._direction_of(excess)
                grows = code.both(code.compare("oeq", now, zero), code.compare("ogt", slope, zero))
                found = code.either(code.compare("ogt", now, zero), grows)
            else:
                flag = code.load(self._flag_slots[excess])
                found = code.compare("ogt", flag, code.constant(FLAG_IS_SET))
            self._conditions[excess.index] = found
        return self._conditions[excess.index]

    def _direction_of(self, excess: Node) -> tuple[Value, Value]:
        """An excess now, and how it changes: what depends on its own flag takes that by the value alone."""
        code, zero, changing = self._code, self._code.constant(0.0), excess
        if excess.op == "rising":
            changing, so_far = excess.args
            now = code.sub(self.value(changing), self.value(so_far))
        else:
            now = self.value(excess)
        trial = Series(code, self._slot_of, self._start, self._rates, self._flag_slots, decides=True)
        trial._conditions = {**self._conditions, excess.index: code.compare("ogt", now, zero)}
        return now, trial.coefficient(changing, 1) or zero

    def _choice(self, node: Node, order: int) -> Value | None:
        excess = node.args[0]
        if excess.index not in self._chosen:
            self._chosen[excess.index] = self._code.compare("ogt", self.value(excess), self._code.constant(0.0))
        return self._selected(node, order, self._chosen[excess.index])

    def _pick(self, node: Node, order: int) -> Value | None:
        if self.coefficient(node.args[1], order) is None and self.coefficient(node.args[2], order) is None:
            return None
        return self._selected(node, order, self.condition(node.args[0]))

    def _selected(self, node: Node, order: int, condition: Value) -> Value | None:
        _, a, b = node.args
        if_so, if_not = self.coefficient(a, order), self.coefficient(b, order)
        if if_so is None and if_not is None:
            return None
        zero = self._code.constant(0.0)
        return self._code.select(condition, if_so or zero, if_not or zero)
