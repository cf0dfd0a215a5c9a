"""Graphs: derivatives and Taylor coefficients of expressions against NumPy."""

from __future__ import annotations

import ctypes
import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_sim.model.core import layout
from valve_sim.model.core.code import Code
from valve_sim.model.core.machine import Library, compiled
from valve_sim.model.core.series import Series
from valve_sim.model.core.tracer import (
    Node,
    Trace,
    cos,
    derivative,
    evaluate,
    exp,
    log,
    maximum,
    minimum,
    polynomial,
    sign,
    sin,
    sqrt,
    tanh,
    where,
)
from valve_sim.model.errors import ParameterError

EXPRESSIONS: dict[str, Callable[[Node, Node], Node]] = {
    "sum and product": lambda x, p: (x + 3.0) * (p - 2.0 * x) * x,
    "quotient": lambda x, p: (1.0 + x) / (2.0 + p * x - x * x),
    "reciprocal cube": lambda x, p: (p / (1.5 + x)) ** 3,
    "negative power": lambda x, p: (2.0 + x) ** -2,
    "root": lambda x, p: sqrt(2.0 + x * x) + (3.0 + x) ** 1.7,
    "exp": lambda x, p: exp(-p * x * x) * x,
    "log": lambda x, p: log(2.0 + sin(x)),
    "angles": lambda x, p: sin(p * x) - cos(x * x),
    "tanh": lambda x, p: tanh(1.0 + p * x),
    "polynomial": lambda x, p: polynomial(1.0 + x, p, 2.0, -p, 0.3),
    "short polynomial": lambda x, p: polynomial(x, p, 2.0) * x,
    "larger": lambda x, p: maximum(x * x - 4.0, p * x) + minimum(x, 5.0) * sign(x + 2.0),
    "chosen": lambda x, p: where(x > 3.0, p, x * p),
}


def coefficients(expression: Callable[[Node, Node], Node], start: float, p: float) -> np.ndarray:
    """The series of an expression of x = start + t by compiled code."""
    trace = Trace()
    x, number = trace.state("x"), trace.number("p")
    node = expression(x, number)
    code = Code()
    slots = {"x": 0, "p": 1}
    series = Series(code, slots.__getitem__, {}, {"x": trace.constant(1.0)}, {}, decides=True)
    for order in range(layout.TERMS):
        code.store(2 + order, series.coefficient(node, order) or code.constant(0.0))
    library = Library(compiled("\n".join(sorted(code.declared)) + "\n" + code.function("run")))
    block = np.zeros(2 + layout.TERMS)
    block[:2] = start, p
    ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(library.address("run"))(block.ctypes.data, 0)
    return block[2:]


@pytest.mark.parametrize("name", EXPRESSIONS)
def test_coefficients_are_those_of_cauchy_s_integral(name: str) -> None:
    expression, start, p, radius, count = EXPRESSIONS[name], 0.4, 0.7, 0.25, 64
    trace = Trace()
    node = expression(trace.state("x"), trace.number("p"))
    circle = radius * np.exp(2j * np.pi * np.arange(count) / count)
    values = np.zeros(count) + evaluate([node], {"x": start + circle, "p": p})[0]
    expected = (np.fft.fft(values) / count).real[: layout.TERMS] / radius ** np.arange(layout.TERMS)
    found = coefficients(expression, start, p)
    size = np.abs(expected * radius ** np.arange(layout.TERMS)).max()
    assert np.abs((found - expected) * radius ** np.arange(layout.TERMS)).max() < 1e-14 * max(1.0, size)


@pytest.mark.parametrize("name", EXPRESSIONS)
@pytest.mark.parametrize("symbol", ["x", "p"])
@settings(max_examples=20)
@given(x=st.floats(-0.9, 0.9), p=st.floats(0.1, 2.0))
def test_derivatives_are_those_of_a_complex_step(name: str, symbol: str, x: float, p: float) -> None:
    trace = Trace()
    nodes = {"x": trace.state("x"), "p": trace.number("p")}
    node = EXPRESSIONS[name](nodes["x"], nodes["p"])
    (slope,) = derivative([node], {nodes[symbol]: trace.constant(1.0)})
    found = 0.0 if slope is None else float(evaluate([slope], {"x": x, "p": p})[0])
    values = {"x": x + 0j, "p": p + 0j}
    values[symbol] += 1e-40j
    with np.errstate(all="ignore"):
        expected = float(np.imag(evaluate([node], values)[0])) / 1e-40
    assert found == pytest.approx(expected, rel=1e-11, abs=1e-11)


def test_equal_expressions_are_one_node() -> None:
    trace = Trace()
    x, p = trace.state("x"), trace.number("p")
    assert x * p + 1.0 is 1.0 + p * x
    assert (x - x.trace.constant(0.0)) is x
    negative = -x
    assert x * 1.0 is x and -negative is x and (x * 0.0).value == 0.0


def test_what_is_no_expression_is_refused_with_the_reason() -> None:
    x = Trace().state("x")
    with pytest.raises(ParameterError, match="expected where"):
        bool(x)
    with pytest.raises(ParameterError, match="exponent"):
        x**x
    with pytest.raises(ParameterError, match="plain numbers alone"):
        exp(1.0)


@settings(max_examples=200)
@given(st.floats(-750.0, 700.0))
def test_exp_is_right_to_rounding(value: float) -> None:
    found = coefficients_of_exp()(value)
    assert found == pytest.approx(math.exp(value), rel=5e-16, abs=1e-300)


def coefficients_of_exp() -> Callable[[float], float]:
    if not _LOADED:
        code = Code()
        code.store(0, code.exp(code.load(0)))
        _LOADED.append(Library(compiled("\n".join(sorted(code.declared)) + "\n" + code.function("run"))))
    run = ctypes.CFUNCTYPE(None, ctypes.c_void_p, ctypes.c_void_p)(_LOADED[0].address("run"))

    def call(value: float) -> float:
        block = np.array([value])
        run(block.ctypes.data, 0)
        return float(block[0])

    return call


_LOADED: list[Library] = []
