"""The integrator's language: what is compiled means what Python means."""

from __future__ import annotations

import ctypes
import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from valve_sim.model.core import layout, polynomials, samples
from valve_sim.model.core.lowering import lowered
from valve_sim.model.core.machine import Library, compiled
from valve_sim.model.core.polynomials import Block

NUMBER = 3
TABLE = (0.25, 1.5, -2.0)
HALF = 0.5


def of_all_kinds(b: Block, n: int, x: float) -> float:
    """Every statement and expression of the language."""
    total = 0.0
    for i in range(n):
        if i == 2 and not x < 0.0:
            continue
        if i > NUMBER or (i == 1 and x > 5.0):
            break
        total += b[i] * HALF if i % 2 == 0 else -b[i]
    for i in range(n - 1, -1, -1):
        total -= i // 2
    while abs(total) > 100.0:
        total *= 0.5
    tail = b[1:]
    tail[0] = max(total, x, 1.0) + min(i, n)
    is_near = -1.0 < total <= 1.0
    total += float(int(x)) + math.sqrt(abs(x)) + math.exp(-abs(x)) + math.expm1(x / 100.0) + math.floor(x)
    total += TABLE[n % 3]
    if is_near or i in (7, 8):
        return total
    return total + twice(tail) if i not in (1, 5) else 0.0


def twice(b: Block) -> float:
    return 2.0 * b[0]  # type: ignore[no-any-return]


CALLABLE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_int64, ctypes.c_double)


@pytest.fixture(scope="module")
def library() -> Library:
    functions = [of_all_kinds, twice, *polynomials.FUNCTIONS, samples.lag_moments]
    return Library(compiled(lowered(functions, ["of_all_kinds", "first_fall", "lag_moments"])))


@settings(max_examples=40)
@given(n=st.integers(0, 6), x=st.floats(-20.0, 20.0), values=st.lists(st.floats(-50, 50), min_size=8, max_size=8))
def test_compiled_functions_do_what_python_does(library: Library, n: int, x: float, values: list[float]) -> None:
    if n == 0:
        n = 1
    ours, theirs = np.array(values), np.array(values)
    found = CALLABLE(library.address("of_all_kinds"))(ours.ctypes.data, n, x)
    assert found == pytest.approx(of_all_kinds(theirs, n, x), rel=1e-12, abs=1e-12)
    assert ours == pytest.approx(theirs, rel=1e-12)


@settings(max_examples=60)
@given(
    roots=st.lists(st.floats(0.02, 1.5), min_size=1, max_size=4), scale=st.floats(1e-6, 1e3), h=st.floats(1e-6, 1e-2)
)
def test_the_first_fall_is_found(library: Library, roots: list[float], scale: float, h: float) -> None:
    """A polynomial that is positive at 0 first falls at its smallest root, unless two of them are close."""
    roots = sorted(roots)
    if any(b - a < 1e-3 for a, b in itertools.pairwise(roots)):
        return
    coefficients = np.polynomial.polynomial.polyfromroots(roots)
    coefficients *= scale / coefficients[0]
    block = np.zeros(layout.SIZE)
    first = layout.GUARD
    block[first : first + len(coefficients)] = coefficients / h ** np.arange(len(coefficients))
    pointer, integer, double = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    signature = ctypes.CFUNCTYPE(double, pointer, integer, double, double, integer, pointer)
    room = np.empty(2 * layout.TERMS)
    first_fall = signature(library.address("first_fall"))
    found = first_fall(block.ctypes.data, first, h, 1e-13 * scale, layout.TERMS, room.ctypes.data)
    if roots[0] < 1.0 - 1e-9:
        assert found == pytest.approx(roots[0] * h, rel=1e-9)
    elif roots[0] > 1.0 + 1e-9:
        assert found == 2.0 * h


@pytest.mark.parametrize("b", [1e-6, 1e-2, 0.5, 3.0, 5.9, 6.1, 13.0, 15.0, 60.0])
def test_moments_of_the_low_pass(library: Library, b: float) -> None:
    into = np.zeros(layout.ORDER + 1)
    ctypes.CFUNCTYPE(None, ctypes.c_double, ctypes.c_void_p)(library.address("lag_moments"))(b, into.ctypes.data)
    places, weights = np.polynomial.legendre.leggauss(80)
    phi = 0.5 * (places + 1.0)
    for k, moment in enumerate(into):
        expected = float(np.sum(0.5 * weights * np.exp(-b * (1.0 - phi)) * phi**k * b))
        assert moment == pytest.approx(expected, rel=3e-13)


def breaks_off(b: Block, n: int) -> float:
    return [b[0]][0]  # type: ignore[no-any-return]


def names_nothing(b: Block, n: int) -> float:
    return nowhere  # type: ignore[name-defined,no-any-return]  # noqa: F821


@pytest.mark.parametrize(("function", "why"), [(breaks_off, "List is not part"), (names_nothing, "unknown name")])
def test_what_is_not_of_the_language_is_refused(function: Any, why: str) -> None:
    with pytest.raises(SyntaxError, match=why):
        lowered([function], [])
