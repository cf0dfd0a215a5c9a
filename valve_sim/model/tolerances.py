"""How well the declared values are known: one standard deviation each, and a covariance for the attraction polynomial.

Nothing here changes a motion. Fits read it: a value with a tolerance is a quantity that was measured, not a constant.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, NamedTuple

import numpy as np

from valve_sim.model.effects import CATALOGUE
from valve_sim.model.errors import ParameterError
from valve_sim.model.gas.parameters import GAS
from valve_sim.model.parameters import (
    DECLARED,
    POLYNOMIAL_NAMES,
    UNUSED_BY_ONE_PLUNGER,
    Parameter,
    ValveParameters,
    closest,
    unused_words,
)

Matrix = tuple[tuple[float, ...], ...]

TOLERATED: Final = tuple(name for name in ValveParameters._fields if name in DECLARED)
"""Declared values that may have a tolerance of their own: the scalars, not the polynomial."""
COVARIANCE_NAME: Final = "attraction_covariance"
"""Key of the polynomial's covariance, as 16 numbers row by row."""
COVARIANCE_FORM: Final = "16 numbers, the 4 by 4 covariance of a0 … a3 row by row, N/m^i times N/m^j"

_GROUPS: Final = ("effects", "gas", "sensor")
"""Keys below which there are names of their own."""
_TERMS: Final = len(POLYNOMIAL_NAMES)
_LARGEST_COVARIANCE: Final = 1e32
_ROUNDING: Final = 1e-6
"""Error that a correlation may have, because the numbers of a file are rounded."""


class SensorTolerances(NamedTuple):
    """How true the sensor of the position is, by its data sheet; not a value of the valve, and never exact by silence.

    Attributes:
        gain: one standard deviation of what is shown over what is there. linearity: scale of the largest deviation from
            a straight line, as a share of the stroke. 0: exact.
    """

    gain: float = 0.002
    linearity: float = 0.001


USUAL_SENSOR: Final = SensorTolerances()
"""Tolerances of a sensor for which the file gives none: usual values of data sheets."""
SENSOR: Final = {
    rule.name: rule
    for rule in (
        Parameter("gain", "1", "gain of the position's sensor, one standard deviation; 0: exact", 0.0, 0.1),
        Parameter("linearity", "1", "linearity of the position's sensor, as a share of the stroke; 0: exact", 0.0, 0.1),
    )
}
"""Name, unit and range of each of the sensor's tolerances."""


@dataclass(frozen=True)
class Tolerances:
    """One standard deviation of declared values, in SI units. What is not listed is exact, but for the sensor.

    Attributes:
        declared: name of a declared scalar to its standard deviation, above 0. That of `moving_mass` is of the
            difference moving_mass − pilot_mass: two bodies are weighed; of one plunger it is of its own mass.
        attraction_covariance: (4, 4), N/m^i times N/m^j, of a0 … a3; symmetric, positive semidefinite.
        effects: effect name to {parameter: standard deviation}, of effects that the valve has on.
        gas: name of a number of the group `gas` to its standard deviation, above 0.
        sensor: how true the sensor of the position is.
    """

    declared: Mapping[str, float] = field(default_factory=dict)
    attraction_covariance: Matrix | None = None
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    gas: Mapping[str, float] = field(default_factory=dict)
    sensor: SensorTolerances = USUAL_SENSOR

    @property
    def is_exact(self) -> bool:
        """Whether no declared value has a tolerance."""
        return not (self.declared or self.attraction_covariance is not None or self.effects or self.gas)

    @classmethod
    def from_mapping(
        cls,
        values: Mapping[str, Any],
        source: str,
        effects: Mapping[str, Mapping[str, float]],
        *,
        has_gas: bool = False,
    ) -> Tolerances:
        """Checked tolerances, as found below `tolerances:` in a parameter file. Zero means exact.

        Args:
            values: scalar names to standard deviations, `attraction_covariance` to its 16 numbers row by row,
                `effects` to {effect: {parameter: standard deviation}}, `gas` to {name: standard deviation}, and
                `sensor` to {gain, linearity}; all optional.
            source: the file or node, for messages.
            effects: those that the valve has on. has_gas: whether the valve has gas.

        Raises:
            ParameterError: an unknown name, a tolerance that is no number at least 0, a matrix that is no covariance,
                or a tolerance of an effect that is not on; the message names it.
        """
        scalars: dict[str, float] = {}
        for name, value in values.items():
            if name not in (COVARIANCE_NAME, *_GROUPS):
                scalars[name] = _scalar_rule(name, value, source).check(value, _where(name, source))
        covariance = values.get(COVARIANCE_NAME)
        of_effects, of_gas, of_sensor = ({} if values.get(group) is None else values[group] for group in _GROUPS)
        if not isinstance(of_effects, Mapping):
            raise ParameterError(f"{_where('effects', source)}: found {of_effects!r}, expected effects and parameters")
        if not isinstance(of_gas, Mapping):
            raise ParameterError(f"{_where('gas', source)}: found {of_gas!r}, expected names of gas and tolerances")
        if not isinstance(of_sensor, Mapping):
            raise ParameterError(f"{_where('sensor', source)}: found {of_sensor!r}, expected {{{', '.join(SENSOR)}}}")
        return cls(
            {name: scalars[name] for name in TOLERATED if scalars.get(name)},
            None if covariance is None else _check_covariance(covariance, _where(COVARIANCE_NAME, source)),
            _check_effects(of_effects, effects, source),
            _check_gas(of_gas, source, has_gas=has_gas),
            _check_sensor(of_sensor, source),
        )

    def check_against(self, parameters: ValveParameters, source: str) -> None:
        """Check that the declared valve uses what has a tolerance, and that of two masses the whole is the larger.

        Raises:
            ParameterError: a value has a tolerance that a valve with one plunger does not use; or the moving mass is
                not above the pilot's, so that there is no difference to be known.
        """
        if parameters.has_one_plunger:
            for name in UNUSED_BY_ONE_PLUNGER:
                if name in self.declared:
                    raise ParameterError(
                        f"{_where(name, source)}: found {self.declared[name]:g}, but {unused_words(name)}; "
                        "take the line out"
                    )
            return
        known = [name for name in ("pilot_mass", "moving_mass") if name in self.declared]
        if known and parameters.moving_mass <= parameters.pilot_mass:
            raise ParameterError(
                f"{_where(known[0], source)}: the two bodies that move together are weighed one by one, but found "
                f"valve.moving_mass {parameters.moving_mass:g} kg and valve.pilot_mass {parameters.pilot_mass:g} kg; "
                "expected moving_mass, the mass of both, above pilot_mass"
            )

    def to_mapping(self) -> dict[str, Any]:
        """The plain mapping that `from_mapping` takes back; empty where all is exact."""
        mapping: dict[str, Any] = dict(self.declared)
        if self.attraction_covariance is not None:
            mapping[COVARIANCE_NAME] = [value for row in self.attraction_covariance for value in row]
        if self.effects:
            mapping["effects"] = {name: dict(values) for name, values in self.effects.items()}
        if self.gas:
            mapping["gas"] = dict(self.gas)
        if self.sensor != USUAL_SENSOR:
            mapping["sensor"] = self.sensor._asdict()
        return mapping


EXACT: Final = Tolerances()
"""No tolerances: every declared value is taken as exact."""


def tolerance_rule(parameter: Parameter) -> Parameter:
    """Name, unit and range of a parameter's tolerance: from 0 (exact) to the width of the parameter's range."""
    what = parameter.name
    if parameter.name == "moving_mass":
        what = "moving_mass - pilot_mass (of one plunger: moving_mass)"
    return Parameter(
        parameter.name,
        parameter.unit,
        f"tolerance of {what}, one standard deviation; 0: exact",
        0.0,
        parameter.upper - parameter.lower,
        parameter.prior_scale,
        off=0.0,
    )


def _where(name: str, source: str) -> str:
    return f"{source}: tolerances.{name}"


def _scalar_rule(name: str, value: object, source: str) -> Parameter:
    """The rule of a declared scalar's tolerance.

    Raises:
        ParameterError: the name has no tolerance, with the name that was meant.
    """
    if name in TOLERATED:
        return tolerance_rule(DECLARED[name])
    found = f"{_where(name, source)}: found {value!r}"
    if name in POLYNOMIAL_NAMES or name == "attraction_polynomial":
        raise ParameterError(
            f"{found}; the attraction's coefficients are known together, so give them as {COVARIANCE_NAME}: "
            f"{COVARIANCE_FORM}; `valve-sim fit-force` writes it"
        )
    if name in CATALOGUE:
        raise ParameterError(f"{found}; expected the tolerances of an effect as tolerances.effects.{name}")
    if name in GAS:
        raise ParameterError(f"{found}; expected it as tolerances.gas.{name}")
    likely = closest(name.removeprefix("valve.").partition(".")[0], [*TOLERATED, COVARIANCE_NAME, *_GROUPS])
    raise ParameterError(f"{found} under an unknown name; did you mean tolerances.{likely}?")


def _check_effects(
    values: Mapping[str, Any], effects: Mapping[str, Mapping[str, float]], source: str
) -> dict[str, dict[str, float]]:
    checked: dict[str, dict[str, float]] = {}
    for name, found in values.items():
        where = _where(f"effects.{name}", source)
        if name not in CATALOGUE:
            raise ParameterError(f"{where}: no such effect; did you mean {closest(name, list(CATALOGUE))}?")
        names = [parameter.name for parameter in CATALOGUE[name].parameters]
        if not isinstance(found, Mapping):
            raise ParameterError(f"{where}: found {found!r}, expected {{{', '.join(names)}}}")
        for parameter, value in found.items():
            if parameter not in names:
                raise ParameterError(
                    f"{where}.{parameter}: found {value!r} under an unknown name; did you mean "
                    f"{closest(parameter, names)}? Expected {', '.join(names)}"
                )
            rule = tolerance_rule(CATALOGUE[name].parameter(parameter))
            tolerance = rule.check(value, f"{where}.{parameter}")
            if tolerance == 0.0:
                continue
            if not CATALOGUE[name].named:
                raise ParameterError(f"{where}.{parameter}: found {value!r}, but {name} has no tolerances; take it out")
            if name not in effects:
                raise ParameterError(
                    f"{where}.{parameter}: found {value!r}, a tolerance of an effect that is not declared on; "
                    f"declare effects.{name}, or take the line out"
                )
            checked.setdefault(name, {})[parameter] = tolerance
    return {
        name: {parameter: checked[name][parameter] for parameter in effects[name] if parameter in checked[name]}
        for name in effects
        if name in checked
    }


def _known(name: str, rules: Mapping[str, Parameter], value: object, where: str) -> Parameter:
    """The rule of a name in a group.

    Raises:
        ParameterError: there is none, with the name that was meant.
    """
    if name not in rules:
        likely = closest(name, list(rules))
        raise ParameterError(f"{where}: found {value!r} under an unknown name; did you mean {likely}?")
    return rules[name]


def _check_gas(values: Mapping[str, Any], source: str, *, has_gas: bool) -> dict[str, float]:
    found = {}
    for name, value in values.items():
        where = _where(f"gas.{name}", source)
        tolerance = tolerance_rule(_known(name, GAS, value, where)).check(value, where)
        if tolerance and not has_gas:
            raise ParameterError(
                f"{where}: found {value!r}, but no gas is declared; declare the group gas, or take the line out"
            )
        found[name] = tolerance
    return {name: found[name] for name in GAS if found.get(name)}


def _check_sensor(values: Mapping[str, Any], source: str) -> SensorTolerances:
    found = {}
    for name, value in values.items():
        where = _where(f"sensor.{name}", source)
        found[name] = _known(name, SENSOR, value, where).check(value, where)
    return SensorTolerances(**found)


def _check_covariance(value: object, where: str) -> Matrix | None:
    """The matrix, made symmetric to the last digit; None where all is 0.

    Raises:
        ParameterError: not 16 numbers, not symmetric, or not positive semidefinite.
    """
    if isinstance(value, str) or not isinstance(value, Sequence):
        raise ParameterError(f"{where}: found {value!r}, expected {COVARIANCE_FORM}")
    if len(value) != _TERMS * _TERMS:
        raise ParameterError(f"{where}: found a list of {len(value)}, expected {COVARIANCE_FORM}")
    rule = Parameter("", "", "", -_LARGEST_COVARIANCE, _LARGEST_COVARIANCE)
    numbers = [rule.check(item, f"{where}[{index}]") for index, item in enumerate(value)]
    matrix = np.array(numbers).reshape(_TERMS, _TERMS)
    variances = np.diag(matrix)
    for name, variance in zip(POLYNOMIAL_NAMES, variances, strict=True):
        if variance < 0.0:
            raise ParameterError(f"{where}: found {variance:g} as the variance of {name}, expected at least 0")
    sigmas = np.sqrt(variances)
    for row in range(_TERMS):
        for column in range(row):
            pair = f"{POLYNOMIAL_NAMES[column]} and {POLYNOMIAL_NAMES[row]}"
            above, below = matrix[column, row], matrix[row, column]
            scale = sigmas[row] * sigmas[column]
            if abs(above - below) > _ROUNDING * max(scale, abs(above), abs(below)):
                raise ParameterError(
                    f"{where}: found {above:g} above and {below:g} below the diagonal for {pair}; "
                    "expected a symmetric matrix"
                )
            if abs(above) > (1.0 + _ROUNDING) * scale:
                raise ParameterError(
                    f"{where}: found {above:g} for {pair}, more than their standard deviations allow ({scale:g}); "
                    "expected a positive semidefinite matrix"
                )
    whole = 0.5 * (matrix + matrix.T)
    safe = np.where(sigmas > 0.0, sigmas, 1.0)
    smallest = float(np.linalg.eigvalsh(whole / np.outer(safe, safe))[0])
    if smallest < -_ROUNDING:
        raise ParameterError(
            f"{where}: found correlations with the eigenvalue {smallest:.3g}; expected a positive semidefinite matrix"
        )
    return tuple(tuple(row) for row in whole.tolist()) if math.fsum(variances) > 0.0 else None
