"""A valve that differs from its declared file as data sheets allow: every declared number is drawn from its tolerance.

Pilot and main plunger are weighed one by one, so that the tolerances are those of pilot_mass and of the difference
moving_mass - pilot_mass. The attraction has a gain and three shapes: Legendre polynomials of degree 1 to 3 over the
stroke, in units of the mean force there. A cubic and these shapes stay a cubic.
"""

from collections.abc import Mapping

import numpy as np
from numpy.polynomial import Legendre, Polynomial

from .common import FloatArray
from .declared import CAMPAIGN_VALVE

Entries = Mapping[str, float | tuple[float, float, float, float]]

# One standard deviation of each declared value: as a share of the value, or in its unit.
SHARES = {
    "pilot_mass": 0.005,
    "main_mass": 0.005,
    "spring_rate": 0.03,
    "spring_preload": 0.03,
    "coil_time_constant": 0.05,
    "seat_load": 0.10,
}
LENGTHS = {"pilot_gap": 4e-6, "stroke": 4e-6}  # m
ATTRACTION_GAIN = 0.015
ATTRACTION_SHAPE = 0.01  # of the mean force over the stroke, for each of the shapes
SHAPES = 3
ATTRACTION = ("attraction_gain", *(f"attraction_shape_{degree}" for degree in range(1, SHAPES + 1)))

NAMES = (*SHARES, *LENGTHS, *ATTRACTION)
"""What deviates, each on its own."""

SHEET_VALVE: Entries = {**CAMPAIGN_VALVE, "seat_load": 0.3}
"""The campaign's valve with a seat load, N, for a tolerance to be a share of."""


def deviated(
    declared: Entries, deviations: Mapping[str, float]
) -> dict[str, float | tuple[float, float, float, float]]:
    """The valve whose numbers are off by so many standard deviations; a name that is not given is exact."""
    if unknown := set(deviations) - set(NAMES):
        raise ValueError(f"deviations of {sorted(unknown)}: known are {NAMES}")
    entries = dict(declared)
    spread = _spread(declared)
    for name in (*SHARES, *LENGTHS):
        if name != "main_mass":
            entries[name] = _scalar(declared, name) + deviations.get(name, 0.0) * spread[name]
    main = _main_mass(declared) + deviations.get("main_mass", 0.0) * spread["main_mass"]
    entries["moving_mass"] = float(np.asarray(entries["pilot_mass"])) + main
    coordinates = np.array([deviations.get(name, 0.0) for name in ATTRACTION])
    a0, a1, a2, a3 = (
        np.asarray(declared["attraction_polynomial"]) + coordinates @ attraction_directions(declared)
    ).tolist()
    entries["attraction_polynomial"] = (a0, a1, a2, a3)
    return entries


def drawn_deviations(random: np.random.Generator) -> dict[str, float]:
    """Independent standard normal deviations of every number."""
    return dict(zip(NAMES, random.standard_normal(len(NAMES)).tolist(), strict=True))


def declared_tolerances(declared: Entries) -> dict[str, float | list[float]]:
    """What a parameter file says of them: standard deviations by name, and the polynomial's covariance row by row."""
    spread = _spread(declared)
    scalars = {("moving_mass" if name == "main_mass" else name): value for name, value in spread.items()}
    directions = attraction_directions(declared)
    return {**scalars, "attraction_covariance": (directions.T @ directions).ravel().tolist()}


def attraction_directions(declared: Entries) -> FloatArray:
    """Change of a0 … a3 for one standard deviation of the gain and of each shape, (4, 4)."""
    polynomial = Polynomial(np.asarray(declared["attraction_polynomial"], dtype=np.float64))
    stroke = _scalar(declared, "stroke")
    area = polynomial.integ()
    mean = (area(stroke) - area(0.0)) / stroke
    rows = [ATTRACTION_GAIN * polynomial.coef]
    for degree in range(1, SHAPES + 1):
        shape = Legendre.basis(degree, domain=[0.0, stroke]).convert(kind=Polynomial, domain=[-1.0, 1.0])
        rows.append(ATTRACTION_SHAPE * mean * np.pad(shape.coef, (0, 4 - shape.coef.size)))
    return np.array(rows)


def _spread(declared: Entries) -> dict[str, float]:
    """One standard deviation of every scalar, SI."""
    values = {name: _main_mass(declared) if name == "main_mass" else _scalar(declared, name) for name in SHARES}
    return {**{name: share * values[name] for name, share in SHARES.items()}, **LENGTHS}


def _scalar(entries: Entries, name: str) -> float:
    return float(np.asarray(entries[name]))


def _main_mass(entries: Entries) -> float:
    return _scalar(entries, "moving_mass") - _scalar(entries, "pilot_mass")
