"""The static experiment: attraction over displacement, from load cell and stage, as the model's polynomial.

The paper measured the force at one voltage while a stage moved the plunger, and fitted a cubic without a constant term.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

from valve_sim.files.data_tables import open_table, read_table
from valve_sim.files.recording_map import FORCE_QUANTITIES, Source
from valve_sim.files.tables import TableError
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.plants.protocol import Array
from valve_sim.model import Drive, Valve, ValveError, published_times, simulate
from valve_sim.model.parameters import POLYNOMIAL_NAMES

HIGHEST_DEGREE: Final = len(POLYNOMIAL_NAMES) - 1
LARGEST_DISPLACEMENT: Final = 0.1
"""m: solenoid plungers move millimetres; beyond this the table is most likely in millimetres."""
OPENING_TIME: Final = 1.0
"""s that a valve is given to open."""

_COLUMNS: Final = {
    "displacement": ("displacement", "displacement_m", "position", "pilot_position", "x"),
    "force": ("force", "force_n", "attraction", "f"),
}


class Opening(NamedTuple):
    """How a valve opens at its reference voltage.

    Attributes:
        volts: V. meets_main, reaches_stop: s, of the pilot plunger; NaN where it does not within `OPENING_TIME`.
        has_one_plunger: whether the valve has no pilot; `meets_main` is then when the plunger leaves its seat.
    """

    volts: float
    meets_main: float
    reaches_stop: float
    has_one_plunger: bool = False


@dataclass(frozen=True)
class StartOfMotion:
    """What the constant term means for the start of motion.

    Attributes:
        constant: a0, N; None where it was left out. opening: of the fitted valve. without: of the valve with a0 = 0.
    """

    constant: Interval | None
    opening: Opening
    without: Opening | None


@dataclass(frozen=True)
class BeginsLate:
    """The table begins at this displacement, m: a0 is extrapolated."""

    displacement: float


@dataclass(frozen=True)
class EndsEarly:
    """The table ends at this displacement, m, short of the stroke, m: beyond it the polynomial is extrapolated."""

    displacement: float
    stroke: float


StaticFinding: TypeAlias = StartOfMotion | BeginsLate | EndsEarly


@dataclass(frozen=True)
class StaticForce:
    """An attraction polynomial from a static table.

    Attributes:
        source: the table. displacement: (n,) m. force: (n,) N, as measured, at `voltage`.
        voltage: V, at which the table was measured.
        intervals: by name a0 … a3, at the reference voltage (u = 1), 95 % by Student's t.
        rmse: of the residuals, N, as measured.
        r_squared: share of the force's variance that the polynomial explains.
        valve: the valve with this polynomial, and its covariance at the reference voltage among the tolerances; terms
            that were not fitted are exact.
        findings: on the start of motion first.
    """

    source: str
    displacement: Array
    force: Array
    voltage: float
    intervals: dict[str, Interval]
    rmse: float
    r_squared: float
    valve: Valve
    findings: tuple[StaticFinding, ...]

    @property
    def predicted(self) -> Array:
        """(n,) N, the polynomial at the table's displacements and voltage."""
        scale = (self.voltage / self.valve.parameters.reference_voltage) ** 2
        polynomial = np.polynomial.Polynomial(self.valve.parameters.attraction_polynomial)
        return np.asarray(scale * polynomial(self.displacement))


def fit_static_force(
    path: Path | str,
    valve: Valve,
    sources: Mapping[str, Source] | None = None,
    *,
    degree: int = HIGHEST_DEGREE,
    voltage: float | None = None,
    constant: bool = True,
) -> StaticForce:
    """Fit the attraction polynomial by least squares.

    Args:
        path: a small table (see `data_tables.read_table`) of displacement, m, and force, N; with `sources` a table of a
            data logger (see `data_tables.open_table`) of any columns and units.
        valve: its other parameters, and the reference voltage that the polynomial is for.
        sources: the columns, as `recording_map.load_force_map` reads them.
        degree: of the polynomial, 0 to 3.
        voltage: V, at which the table was measured; default the reference voltage.
        constant: fit a0 too; the paper has none.

    Raises:
        ValveError: degree or voltage make no sense.
        TableError: the table cannot be used.
    """
    reference = valve.parameters.reference_voltage
    volts = reference if voltage is None else voltage
    powers = np.arange(0 if constant else 1, degree + 1)
    if not 0 <= degree <= HIGHEST_DEGREE or len(powers) == 0:
        raise ValveError(
            f"--degree {degree}: the model holds a0 to a3; expected {0 if constant else 1} to {HIGHEST_DEGREE}"
        )
    if volts == 0.0 or not math.isfinite(volts):
        raise ValveError(f"--voltage {volts:g}: a coil without voltage does not pull; expected the table's voltage")
    displacement, force = _read(path, sources, len(powers))
    at_reference = (reference / volts) ** 2
    values, covariance, rmse = _least_squares(displacement, force, powers)
    errors = np.sqrt(np.diag(covariance))
    # Between the 2.5 % quantiles of Student's t, because the noise is estimated from the same residuals.
    quantile = float(stdtrit(len(force) - len(powers), 0.975))
    intervals = {
        POLYNOMIAL_NAMES[power]: Interval(value, error, value - quantile * error, value + quantile * error)
        for power, value, error in zip(powers, at_reference * values, at_reference * errors, strict=True)
    }
    fitted = _with_attraction(valve, powers, at_reference * values, at_reference**2 * covariance)
    variance = float(np.var(force))
    return StaticForce(
        str(path),
        displacement,
        force,
        volts,
        intervals,
        rmse,
        1.0 - rmse**2 / variance if variance > 0.0 else 0.0,
        fitted,
        tuple(_findings(fitted, intervals.get("a0"), displacement)),
    )


def _read(path: Path | str, sources: Mapping[str, Source] | None, terms: int) -> tuple[Array, Array]:
    if sources is None:
        table = read_table(path, _COLUMNS, "or other names and units with --map")
    else:
        table = _read_mapped(Path(path), sources)
    displacement, force = table["displacement"], table["force"]
    reach = float(np.max(np.abs(displacement)))
    if reach > LARGEST_DISPLACEMENT:
        raise TableError(f"{path}: displacement reaches {reach:g} m; if it is in mm, say so with --map (unit: mm)")
    places = len(np.unique(displacement))
    if places < terms or len(force) <= terms:
        raise TableError(
            f"{path}: has {len(force)} points at {places} displacements; expected more than {terms} for {terms} "
            "coefficients: measure more, or lower --degree"
        )
    return displacement, force


def _read_mapped(path: Path, sources: Mapping[str, Source]) -> dict[str, Array]:
    """The columns that a map names, in SI, (n,) each."""
    table = open_table(path)
    found = {}
    for name, dimension in FORCE_QUANTITIES.items():
        column = table.column(sources[name].column)
        if not np.isfinite(column).all():
            place = table.place(int(np.argmin(np.isfinite(column))))
            raise TableError(f"{path}: {place}: {name}: holds no finite number; correct the row or take it out")
        found[name] = sources[name].to_si(column, dimension)
    return found


def _least_squares(displacement: Array, force: Array, powers: NDArray[np.int_]) -> tuple[Array, Array, float]:
    """Coefficients, their covariance, and the rms of what is left."""
    # In units of the largest displacement: powers of 1e-3 m would otherwise leave half of the digits.
    scale = float(np.max(np.abs(displacement))) or 1.0
    design = (displacement[:, None] / scale) ** powers
    coefficients, *_ = np.linalg.lstsq(design, force, rcond=None)
    residual = force - design @ coefficients
    squares = float(residual @ residual)
    variance = squares / (len(force) - len(powers))
    inverse = np.linalg.pinv(design)
    units = scale ** -powers.astype(np.float64)
    covariance = variance * (inverse @ inverse.T) * np.outer(units, units)
    return coefficients * units, covariance, math.sqrt(squares / len(force))


def _with_attraction(valve: Valve, powers: NDArray[np.int_], coefficients: Array, covariance: Array) -> Valve:
    """The valve with these coefficients of its attraction; all others are 0, and exact."""
    polynomial = dict.fromkeys(POLYNOMIAL_NAMES, 0.0)
    polynomial |= {POLYNOMIAL_NAMES[power]: float(value) for power, value in zip(powers, coefficients, strict=True)}
    whole = np.zeros((len(POLYNOMIAL_NAMES), len(POLYNOMIAL_NAMES)))
    whole[np.ix_(powers, powers)] = covariance
    matrix = tuple(tuple(row) for row in whole.tolist()) if np.any(whole) else None
    return replace(valve.with_values(**polynomial), tolerances=replace(valve.tolerances, attraction_covariance=matrix))


def _findings(valve: Valve, constant: Interval | None, displacement: Array) -> Iterator[StaticFinding]:
    parameters = valve.parameters
    begin, end = float(np.min(displacement)), float(np.max(displacement))
    yield StartOfMotion(
        constant, opening_of(valve), None if constant is None else opening_of(valve.with_values(a0=0.0))
    )
    if begin > 0.1 * (parameters.pilot_gap or parameters.stroke):
        yield BeginsLate(begin)
    if end < 0.98 * parameters.stroke:
        yield EndsEarly(end, parameters.stroke)


def opening_of(valve: Valve) -> Opening:
    """The opening of a valve after its reference voltage is switched on."""
    volts = valve.parameters.reference_voltage
    t1, t2 = published_times(simulate(valve, Drive.of([0.0], [volts]), [OPENING_TIME]))
    return Opening(volts, t1, t2, valve.parameters.has_one_plunger)
