"""Polynomials of the integrator: their values, where they fall through 0, and how large they are.

As those of `driver` these functions are compiled by `lowering`. A polynomial stands in a block, from a slot on, with
its constant coefficient first.
"""

from __future__ import annotations

from typing import Any, Final, TypeAlias

Block: TypeAlias = Any
"""Doubles that are read and written by index; `b[n:]` begins n further on."""

NARROWEST: Final = 1e-12
"""Of a step: a guard that cannot be told from 0 in a shorter part of it counts as 0 there."""
MOST_TRIALS: Final = 400
FINE: Final = 5
NEWTON_STEPS: Final = 60


def invoke(address: float, b: Block, t: Block) -> None:
    """Call a kernel; what is compiled does so by its address."""
    raise NotImplementedError


def value_at(b: Block, c: int, h: float, terms: int) -> float:
    """The polynomial whose coefficients begin at slot c, at h."""
    total: float = b[c + terms - 1]
    for k in range(terms - 2, -1, -1):
        total = b[c + k] + h * total
    return total


def slope_at(b: Block, c: int, h: float, terms: int) -> float:
    """Its derivative."""
    total: float = (terms - 1) * b[c + terms - 1]
    for k in range(terms - 2, 0, -1):
        total = k * b[c + k] + h * total
    return total


def bound(p: Block, w: float, down: float, terms: int) -> float:
    """A number that a polynomial, times `down`, does not fall below between 0 and w.

    The smallest Bernstein coefficient of its first terms, less the size of the others.
    """
    d1 = down * p[1] * w
    w2 = w * w
    d2 = down * p[2] * w2
    d3 = down * p[3] * w2 * w
    d4 = down * p[4] * w2 * w2
    d5 = down * p[5] * w2 * w2 * w
    power = w2 * w2 * w2
    rest = 0.0
    for k in range(FINE + 1, terms):
        rest += abs(p[k]) * power
        power *= w
    b0: float = down * p[0]
    b1 = b0 + d1 * 0.2
    b2 = b0 + d1 * 0.4 + d2 * 0.1
    b3 = b0 + d1 * 0.6 + d2 * 0.3 + d3 * 0.1
    b4 = b0 + d1 * 0.8 + d2 * 0.6 + d3 * 0.4 + d4 * 0.2
    b5 = b0 + d1 + d2 + d3 + d4 + d5
    return float(min(b0, b1, b2, b3, b4, b5) - rest)


def first_fall(b: Block, c: int, h: float, unsure: float, terms: int, p: Block) -> float:
    """When a polynomial first falls through 0, s; 2 h if it does not before h.

    Args:
        b, c: a block, and the slot where the coefficients of the polynomial begin.
        h: s, up to when it is followed. unsure: it falls only if it comes below −unsure.
        terms: how many coefficients there are. p: room for twice as many.
    """
    slopes = p[terms:]
    power = 1.0
    size = 0.0
    for k in range(terms):
        p[k] = b[c + k] * power
        size += abs(p[k])
        power *= h
    if size == 0.0:
        return 2.0 * h
    left = 0.0
    width = 1.0
    for _ in range(MOST_TRIALS):
        if p[0] < -unsure:
            return left * h
        for k in range(1, terms):
            slopes[k - 1] = k * p[k]
        slopes[terms - 1] = 0.0
        is_sure = bound(p, width, 1.0, terms) > -unsure
        if not is_sure and (bound(slopes, width, -1.0, terms) > 0.0 or width < NARROWEST):
            if value_at(p, 0, width, terms) < -unsure:
                return (left + root(p, 0, width, 0.0, -1.0, terms)) * h
            # It comes close to 0 and does not fall through.
            is_sure = True
        if is_sure:
            left += width
            if left >= 1.0:
                return 2.0 * h
            shift(p, width, terms)
            width = min(2.0 * width, 1.0 - left)
        else:
            width *= 0.5
    return 2.0 * h


def shift(p: Block, by: float, terms: int) -> None:
    """Make a polynomial one about a place further on."""
    for i in range(terms - 1):
        for k in range(terms - 2, i - 1, -1):
            p[k] += by * p[k + 1]


def root(b: Block, c: int, h: float, target: float, way: float, terms: int) -> float:
    """Where a polynomial that is monotone up to h reaches a target, which it does: Newton's method in a bracket.

    Args:
        b, c: a block, and the slot where the coefficients begin. target: as the polynomial. way: +1 upwards, −1 down.
    """
    low = 0.0
    high = h
    here = h
    for _ in range(NEWTON_STEPS):
        ahead = (value_at(b, c, here, terms) - target) * way
        if ahead >= 0.0:
            high = here
        else:
            low = here
        slope = slope_at(b, c, here, terms) * way
        better = here - ahead / slope if slope > 0.0 else low
        if not (low < better < high):
            if better == here or high - low <= 1e-16 * h:
                return here
            better = 0.5 * (low + high)
        if abs(better - here) <= 1e-16 * h:
            return better
        here = better
    return here


def extent(b: Block, c: int, h: float, terms: int) -> float:
    """The size of a polynomial up to h: the sum of the sizes of its terms."""
    total = 0.0
    power = 1.0
    for k in range(terms):
        total += abs(b[c + k]) * power
        power *= h
    return total


FUNCTIONS: Final = (value_at, slope_at, bound, first_fall, shift, root, extent)
"""What is compiled."""
