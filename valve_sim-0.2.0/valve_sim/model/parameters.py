"""The declared valve: names, units, ranges and sources of its parameters.

Source of every published number: Choi, Ahn and Kim, "Modeling the Dynamic Behavior of a Pilot-Operated Solenoid
Valve for an Ultra-High Pressure Vessel", Appl. Sci. 2021, 11, 2329 ("the paper"), converted once to SI.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Sequence
from typing import Final, NamedTuple

from valve_sim.model.errors import ParameterError


class Parameter(NamedTuple):
    """One scalar parameter: name, unit and range.

    `prior_scale` is the size that a search starts from, in the parameter's unit; `off` the value at which an effect's
    parameter changes nothing (None: the parameter shapes an effect but does not switch it). `infinite_at_upper`: a
    time constant that may be too long to be seen; its upper bound then stands for "never". `not_declared`: what a
    file or a node gives while its effect is not declared, for an effect that may be declared without changing anything.
    """

    name: str
    unit: str
    description: str
    lower: float = -math.inf
    upper: float = math.inf
    prior_scale: float = 1.0
    off: float | None = None
    lower_is_allowed: bool = True
    infinite_at_upper: bool = False
    not_declared: float | None = None

    @property
    def neutral(self) -> float:
        """The value at which it changes nothing, or the prior scale of a parameter that only shapes an effect."""
        return self.prior_scale if self.off is None else self.off

    def check(self, value: object, where: str) -> float:
        """Return the value as a float.

        Args:
            value: what was found.
            where: the key, and the file if there is one, for the message.

        Raises:
            ParameterError: not a finite number, or outside the range.
        """
        if isinstance(value, bool) or not isinstance(value, int | float):
            in_unit = f" in {self.unit}" if self._unit_words() else ""
            raise ParameterError(f"{where}: found {value!r}, expected a number{in_unit}")
        number = float(value)
        too_low = number < self.lower or (number == self.lower and not self.lower_is_allowed)
        if not math.isfinite(number) or too_low or number > self.upper:
            hint = f"; in kg, {number:g} g are {1e-3 * number:g}" if self.unit == "kg" and number > self.upper else ""
            raise ParameterError(f"{where}: found {value!r}, expected {self.range_words()}{hint}")
        return number

    def range_words(self) -> str:
        """The range in words, as error messages and the reference page say it."""
        unit = self._unit_words()
        if math.isinf(self.lower) and math.isinf(self.upper):
            return f"a finite number{unit}"
        if math.isinf(self.upper):
            return f"a number {'at least' if self.lower_is_allowed else 'above'} {self.lower:g}{unit}"
        low = "from" if self.lower_is_allowed else "above"
        return f"a number {low} {self.lower:g} to {self.upper:g}{unit}"

    def _unit_words(self) -> str:
        return f" {self.unit}" if self.unit not in ("", "–") else ""


class ValveParameters(NamedTuple):
    """The declared parameters of one valve, in SI units. The defaults are the paper's, as printed."""

    pilot_mass: float = 0.109
    moving_mass: float = 0.134
    pilot_damping: float = 1.0
    main_damping: float = 4.0
    spring_rate: float = 428.0
    spring_preload: float = 2.524
    attraction_polynomial: tuple[float, float, float, float] = (0.0, 17.096e3, -30.931e6, 24.026e9)
    pilot_gap: float = 0.26e-3
    stroke: float = 1.23e-3
    reference_voltage: float = 9.0
    coil_time_constant: float = 0.0
    coil_resistance: float = 10.0
    seat_load: float = 0.0
    pickup_velocity_ratio: float = 1.0
    release_voltage: float = 0.0

    @property
    def has_one_plunger(self) -> bool:
        """Whether there is no pilot plunger apart from the main one: a gap of 0."""
        return self.pilot_gap == 0.0


POLYNOMIAL_NAMES: Final = ("a0", "a1", "a2", "a3")
"""The attraction polynomial's coefficients, named one by one where a fit frees them."""

HEAVIEST: Final = 5.0
"""kg: no plunger that a coil of some newtons is to move in milliseconds comes near it; 22 is of grams."""
UNUSED_BY_ONE_PLUNGER: Final = ("pilot_mass", "pilot_damping", "pickup_velocity_ratio", "pilot_gap")
"""Declared values that a valve with one plunger does not use: those of Phase 1 and of the pick-up. Its gap is 0."""

_DECLARED: Final = (
    Parameter("pilot_mass", "kg", "mass that moves in Phase 1", 0, HEAVIEST, 0.1, lower_is_allowed=False),
    Parameter("moving_mass", "kg", "mass that moves in Phase 2", 0, HEAVIEST, 0.1, lower_is_allowed=False),
    Parameter("pilot_damping", "N·s/m", "c1, viscous damping in Phase 1", 0, 1e4, 1.0),
    Parameter("main_damping", "N·s/m", "c2, viscous damping in Phase 2", 0, 1e4, 4.0),
    Parameter("spring_rate", "N/m", "stiffness of the spring in Phase 2", 0, 1e7, 400.0),
    Parameter("spring_preload", "N", "spring force at x = 0 in Phase 2", 0, 1e5, 2.5),
    Parameter("a0", "N", "attraction at x = 0 and u = 1", -1e5, 1e5, 1.0),
    Parameter("a1", "N/m", "attraction polynomial, first order", -1e9, 1e9, 1e4),
    Parameter("a2", "N/m²", "attraction polynomial, second order", -1e13, 1e13, 1e7),
    Parameter("a3", "N/m³", "attraction polynomial, third order", -1e16, 1e16, 1e10),
    Parameter(
        "pilot_gap", "m", "travel of the pilot plunger before pick-up; 0: a valve with one plunger", 0, 0.1, 1e-4
    ),
    Parameter("stroke", "m", "travel of the pilot plunger to the core", 0, 0.1, 1e-3, lower_is_allowed=False),
    Parameter("reference_voltage", "V", "voltage at which u settles to 1", 0, 1e4, 9.0, lower_is_allowed=False),
    Parameter("coil_time_constant", "s", "first-order lag of the coil current", 0, 1.0, 1e-3),
    Parameter("coil_resistance", "Ω", "gives amperes: i = u · V_ref / R", 0, 1e6, 10.0, lower_is_allowed=False),
    Parameter("seat_load", "N", "closing force all through Phase 1; of one plunger on its seat alone", 0, 1e5, 1.0),
    Parameter("pickup_velocity_ratio", "–", "v after pick-up over v before", 0, 1, 0.9),
    Parameter("release_voltage", "V", "of the freewheeling path at a command of 0; 0: shorted", 0, 1e4, 1.0),
)
DECLARED: Final[dict[str, Parameter]] = {entry.name: entry for entry in _DECLARED}
"""Every declared scalar by name; the polynomial's coefficients are a0 … a3."""


def check_declared(values: dict[str, object], source: str) -> ValveParameters:
    """Turn a mapping as found in YAML into declared parameters.

    Missing names take the paper's value.

    Args:
        values: name to value; `attraction_polynomial` is a list of four numbers.
        source: the file (or node) that they come from, for messages.

    Raises:
        ParameterError: unknown name, wrong type, out of range, or a gap that is not inside the stroke.
    """
    checked: dict[str, float | tuple[float, ...]] = {}
    for name, value in values.items():
        where = f"{source}: valve.{name}"
        if name == "attraction_polynomial":
            checked[name] = _check_polynomial(value, where)
        elif name in ValveParameters._fields:
            checked[name] = DECLARED[name].check(value, where)
        else:
            raise ParameterError(f"{where}: no such parameter; did you mean {closest(name, ValveParameters._fields)}?")
    parameters = ValveParameters()._replace(**checked)  # type: ignore[arg-type]
    has_one_plunger = parameters.has_one_plunger
    check_geometry(parameters.pilot_gap, parameters.stroke, source, has_one_plunger=has_one_plunger)
    return parameters


def check_geometry(pilot_gap: float, stroke: float, source: str, *, has_one_plunger: bool) -> None:
    """The gap lies inside the stroke; that of a valve with one plunger is 0.

    Raises:
        ParameterError: it does not.
    """
    if not (0.0 <= pilot_gap < stroke and (pilot_gap > 0.0 or has_one_plunger)):
        raise ParameterError(
            f"{source}: valve.pilot_gap: found {pilot_gap:g} m with stroke {stroke:g} m, "
            "expected 0 < pilot_gap < stroke, or a pilot_gap of 0 for a valve with one plunger"
        )


def unused_words(name: str) -> str:
    """Why one of `UNUSED_BY_ONE_PLUNGER` can neither be estimated nor have a tolerance, for messages."""
    if name == "pilot_gap":
        return "a valve.pilot_gap of 0 says that the valve has one plunger, and is exact"
    return f"{name} is unused in a valve with one plunger (valve.pilot_gap 0)"


def closest(name: str, known: Sequence[str]) -> str:
    """The known name most like a misspelt one, for a message."""
    matches = difflib.get_close_matches(name, known, n=1, cutoff=0.0)
    return matches[0]


def _check_polynomial(value: object, where: str) -> tuple[float, ...]:
    expected = "expected four numbers [a0 N, a1 N/m, a2 N/m², a3 N/m³]"
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise ParameterError(f"{where}: found {value!r}, {expected}")
    if len(value) != len(POLYNOMIAL_NAMES):
        raise ParameterError(f"{where}: found {len(value)} terms {list(value)!r}, {expected}")
    return tuple(
        DECLARED[name].check(term, f"{where}[{index}]")
        for index, (name, term) in enumerate(zip(POLYNOMIAL_NAMES, value, strict=True))
    )
