"""Declared values with a tolerance, as a fit sees them: nuisances with priors, and hypotheses that one is wrong.

Each value moves by itself, but for two: the moving mass of two plungers is the pilot plunger's and the main plunger's,
which are weighed one by one, and the attraction polynomial moves along the principal axes of its covariance,

    (a0, a1, a2, a3) = declared + R z,   R Rᵀ = covariance,   z_k ~ N(0, 1):  theory, eq. (81)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from valve_sim.identification.plants.covariance_root import covariance_root
from valve_sim.identification.plants.protocol import RELEASED, Array, EffectChoice, Nuisance
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Tolerances, Valve
from valve_sim.model.gas import GAS
from valve_sim.model.parameters import POLYNOMIAL_NAMES

MAIN_MASS: Final = "main_mass"
"""Name of the difference moving_mass − pilot_mass, kg."""
STEP: Final = 3e-4
"""Step of a difference quotient, in tolerances. From 3e-3 on, samples change sides of an impact, and standard errors
are off by a factor of up to 5; below 1e-3 they are the same to three digits (measured)."""
GROUP: Final = "gas."
"""Prefix of the names of numbers of the group `gas` in fits."""
SAME_AS: Final[Mapping[str, str]] = {
    "pilot_gap": "gap_offset.offset",
    "stroke": "stroke_offset.offset",
    "coil_time_constant": "coil_lag.time_constant",
    "reference_voltage": "drive_gain.gain",
    "pickup_velocity_ratio": "pickup_impact.velocity_ratio",
}
"""Declared values to the parameters of effects that are the same thing: a wrong value bears the effect's name, where
the effect can be on that side of the declared value."""
LOOK_ALIKES: Final[Mapping[str, tuple[str, ...]]] = {
    "pilot_mass": ("valve.moving_mass", "quadratic_drag"),
    "moving_mass": ("valve.pilot_mass", "pickup_impact", "quadratic_drag"),
    "spring_rate": ("valve.spring_preload", "spring_hardening", "valve.attraction_polynomial"),
    "spring_preload": ("valve.spring_rate", "pressure_force", "constant_force", "valve.attraction_polynomial"),
    "seat_load": ("constant_force", "rest_attraction", "valve.attraction_polynomial"),
    "coil_resistance": ("drive_gain",),
    "attraction_polynomial": ("rest_attraction", "drive_gain", "magnetic_saturation", "spring_hardening"),
    "gas.pilot_orifice_diameter": ("gas.discharge_coefficient", "gas.outlet_volume"),
    "gas.discharge_coefficient": ("pilot_clogging", "gas.pilot_orifice_diameter", "gas.outlet_volume"),
    "gas.outlet_volume": ("pilot_clogging", "seat_leak", "gas.discharge_coefficient", "gas.pilot_orifice_diameter"),
    "gas.demand_orifice_diameter": ("seat_leak", "gas.outlet_volume"),
}
"""Effects that data often cannot tell from a wrong value, the closest first."""


SMALLER_IS: Final[Mapping[str, str]] = {"gas.pilot_orifice_diameter": "pilot_clogging"}
"""Declared values to effects that a smaller one is: its own name can then be claimed above the declared value only."""


WRONG_SHARE: Final = 0.05
"""Of a declared value without a tolerance: the scale of its Cauchy prior, if it is wrong."""
EXACT_RIVALS: Final = (
    "pilot_mass", "moving_mass", "spring_rate", "spring_preload", "pilot_gap", "stroke", "reference_voltage",
    "coil_time_constant", "coil_resistance", "seat_load", "pickup_velocity_ratio",
)  # fmt: skip
"""Declared values that may be wrong although nothing says how well they are known. Of the attraction polynomial without
a covariance `drive_gain` and `rest_attraction` say it."""
OF_TWO_PLUNGERS: Final = ("pilot_mass", "pilot_gap", "pickup_velocity_ratio")
"""Declared values that a valve with one plunger does not use."""
EXACT_RIVALS_OF_GAS: Final = (
    "pilot_orifice_diameter", "main_orifice_diameter", "seat_diameter", "discharge_coefficient", "outlet_volume",
    "demand_orifice_diameter",
)  # fmt: skip
"""Values of the group `gas` that compete with effects where they are declared as exact; pressures are measured."""


def of_gas(name: str) -> str:
    """The name of a number of the group `gas` in fits."""
    return f"{GROUP}{name}"


GAS_NAMES: Final[Mapping[str, str]] = {of_gas(name): name for name in GAS}
"""What fits call a number of the group `gas`, and what the group calls it."""


def parameters_of_effects() -> dict[str, tuple[str, str]]:
    """What fits call the parameters of effects, to the effect and its parameter, of the whole catalogue."""
    return {f"{name}.{own.name}": (name, own.name) for name, entry in CATALOGUE.items() for own in entry.parameters}


class ToleratedValues:
    """The values of a valve that are known within a tolerance.

    Attributes:
        nuisances: one for each value, or principal axis, that has a tolerance.
        of_effects: see `parameters_of_effects`.
    """

    def __init__(self, valve: Valve) -> None:
        self.of_effects = parameters_of_effects()
        self._declared = valve.declared()
        if valve.gas is not None:
            self._declared |= {of_gas(name): float(getattr(valve.gas, name)) for name in GAS}
        self._tolerances = valve.tolerances
        is_pair = not valve.parameters.has_one_plunger
        self._has_masses = is_pair and bool({"pilot_mass", "moving_mass"} & set(valve.tolerances.declared))
        self._axes = principal_axes(valve.tolerances)
        self._axis_names = tuple(f"attraction[{axis}]" for axis in range(self._axes.shape[1]))
        self.nuisances = self._nuisances(valve)
        self._own = {nuisance.name: nuisance for nuisance in self.nuisances}
        # Coordinates that stand for declared values without being one.
        self._stand_for = frozenset({*self._axis_names, *([MAIN_MASS] if self._has_masses else [])})

    def _nuisances(self, valve: Valve) -> tuple[Nuisance, ...]:
        lower, upper = _contacts(valve)
        found = []
        for name, sigma in valve.tolerances.declared.items():
            own = self._coordinate(name)
            rule = self.parameter(own) or DECLARED[name]
            least = max(rule.lower, lower.get(name, rule.lower))
            if not rule.lower_is_allowed and least <= rule.lower:
                least = rule.lower + 1e-6 * min(sigma, self.declared(own))
            most = min(rule.upper, upper.get(name, rule.upper))
            same = SAME_AS.get(name)
            is_on = same is None or self.of_effects[same][0] in valve.effects
            nuisance = _nuisance(own, sigma, rule.unit, self.declared(own), least, most)
            if same is not None and not is_on:
                nuisance = nuisance._replace(same_as=same, same_slope=_slope_of_effect(name, nuisance.mean))
            found.append(nuisance)
        found += [_nuisance(name, 1.0, "–", 0.0) for name in self._axis_names]
        for name, sigma in valve.tolerances.gas.items():
            rule = GAS[name]
            found.append(_nuisance(of_gas(name), sigma, rule.unit, self.declared(of_gas(name)), rule.lower, rule.upper))
        for effect, sigmas in valve.tolerances.effects.items():
            for name, sigma in sigmas.items():
                rule = CATALOGUE[effect].parameter(name)
                mean = valve.effects[effect][name]
                found.append(_nuisance(f"{effect}.{name}", sigma, rule.unit, mean, rule.lower, rule.upper))
        return tuple(found)

    def parameter(self, name: str) -> Parameter | None:
        """Unit and range of what has a tolerance, or of the coordinates that stand for it; None for anything else.

        Its prior scale is that of a wrong value: `RELEASED` tolerances, or `WRONG_SHARE` of what is declared as exact.
        """
        if name == MAIN_MASS and self._has_masses:
            sigma = self._tolerances.declared.get("moving_mass", self.declared(name))
            return DECLARED["moving_mass"]._replace(
                name=name, description="mass of the main plunger and what moves with it", prior_scale=RELEASED * sigma
            )
        if name in self._axis_names:
            return Parameter(name, "–", "attraction polynomial along an axis of its covariance", prior_scale=RELEASED)
        scale = self._scale_if_wrong(name)
        if scale is None:
            return None
        if name not in GAS_NAMES:
            return DECLARED[name]._replace(prior_scale=scale)
        # With an off value it is searched as it is, as its nuisance and every other declared value are: else its
        # logarithm would be compared with what it is declared as, and its tolerance with the logarithm's error.
        return GAS[GAS_NAMES[name]]._replace(name=name, prior_scale=scale, off=self.declared(name))

    def _scale_if_wrong(self, name: str) -> float | None:
        """The prior scale of a declared value that is wrong; None of what is no rival, or is estimated otherwise."""
        if name == "moving_mass" and self._has_masses:
            return None
        gas = GAS_NAMES.get(name)
        sigma = self._tolerances.declared.get(name) if gas is None else self._tolerances.gas.get(gas)
        if sigma is not None:
            return RELEASED * sigma
        known = name in EXACT_RIVALS if gas is None else gas in EXACT_RIVALS_OF_GAS
        value = abs(self._declared.get(name, 0.0))
        return WRONG_SHARE * value if known and value > 0.0 else None

    def declared(self, name: str) -> float:
        """The declared value of any scalar, of `gas.<name>`, of the main mass, and of the polynomial's coordinates."""
        if name == MAIN_MASS:
            return self._declared["moving_mass"] - self._declared["pilot_mass"]
        return 0.0 if name in self._axis_names else self._declared[name]

    def plain_slopes(self, slopes: Mapping[str, float], values: Mapping[str, float]) -> dict[str, float]:
        """Slopes of declared scalars and of effects' parameters in place of their coordinates; see `as_declared`."""
        found: dict[str, float] = {}
        for name, slope in slopes.items():
            for own, by in self._slopes(name):
                if own == name or own not in values:
                    found[own] = found.get(own, 0.0) + by * slope
        return found

    def as_declared(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Values by the names of declared scalars: the mass and the polynomial in place of their coordinates."""
        if not (self._has_masses or self._axis_names):
            return values
        plain = {name: value for name, value in values.items() if name not in self._stand_for}
        if self._has_masses and (MAIN_MASS in values or "pilot_mass" in values):
            main = values.get(MAIN_MASS, self.declared(MAIN_MASS))
            plain.setdefault("moving_mass", values.get("pilot_mass", self._declared["pilot_mass"]) + main)
        at = np.array([values.get(name, 0.0) for name in self._axis_names])
        if at.any():
            for name, change in zip(POLYNOMIAL_NAMES, (self._axes @ at).tolist(), strict=True):
                plain.setdefault(name, self._declared[name] + change)
        return plain

    def propagated(self, names: Sequence[str], covariance: Array) -> tuple[tuple[str, ...], Array]:
        """Declared scalars, and their covariance, in place of the coordinates that stand for them.

        Args:
            names: (k,) of what was estimated. covariance: (k, k) of it.

        Returns:
            (m,) names, and (m, m).
        """
        slopes: dict[str, Array] = {}
        for unit, name in zip(np.eye(len(names)), names, strict=True):
            for own, slope in self._slopes(name):
                # A scalar that is freed itself does not follow a coordinate.
                if own == name or own not in names:
                    slopes[own] = slopes.get(own, np.zeros(len(names))) + slope * unit
        matrix = np.array(list(slopes.values()))
        return tuple(slopes), np.asarray(matrix @ covariance @ matrix.T)

    def _slopes(self, name: str) -> list[tuple[str, float]]:
        """The declared scalars that follow an estimated name, and by how much."""
        if name in self._axis_names:
            return list(zip(POLYNOMIAL_NAMES, self._axes[:, self._axis_names.index(name)].tolist(), strict=True))
        if name == MAIN_MASS:
            return [("moving_mass", 1.0)]
        return [(name, 1.0), ("moving_mass", 1.0)] if name == "pilot_mass" and self._has_masses else [(name, 1.0)]

    def with_hypotheses(
        self, effects: Mapping[str, EffectChoice], refitted: tuple[str, ...]
    ) -> dict[str, EffectChoice]:
        """The effects, and the hypotheses that a declared value is wrong; they are confused with each other both ways.

        Args:
            effects: that a diagnosis may add, or find to be of another size.
            refitted: declared values that every fit frees, of which nothing is declared that could be wrong.
        """
        wrong = {
            hypothesis_of(name): own
            for name, own in self._coordinates().items()
            if name not in refitted and (self._effect_like(name) not in effects or self._is_one_sided(name))
        }
        known = {*effects, *wrong}
        alike = {hypothesis_of(name): tuple(o for o in others if o in known) for name, others in LOOK_ALIKES.items()}
        found = {}
        for name, choice in effects.items():
            others = tuple(value for value in wrong if name in alike.get(value, ()))
            found[name] = replace(choice, confused_with=(*choice.confused_with, *others)) if others else choice
        for name, coordinates in wrong.items():
            others = tuple(value for value in wrong if name in alike.get(value, ()))
            parameters = tuple(self._released(own, effects) for own in coordinates)
            # The closest first: an attraction that is off at rest is a polynomial that is off in its first coefficient.
            both = tuple(dict.fromkeys([*alike.get(name, ()), *others]))
            found[name] = EffectChoice(name, parameters, both, is_declared_value=True)
        return found

    def _coordinate(self, name: str) -> str:
        """The coordinate in which a value with a tolerance is estimated: of two masses the main plunger's own."""
        return MAIN_MASS if name == "moving_mass" and self._has_masses else name

    def _coordinates(self) -> dict[str, tuple[str, ...]]:
        """Declared values that may be wrong, and the names by which each is estimated."""
        unused = OF_TWO_PLUNGERS if self._declared["pilot_gap"] == 0.0 else ()
        exact = [name for name in EXACT_RIVALS if self._declared[name] != 0.0]
        known = [name for name in (*self._tolerances.declared, *exact) if name not in unused]
        found: dict[str, tuple[str, ...]] = {name: (self._coordinate(name),) for name in dict.fromkeys(known)}
        if self._axis_names:
            found["attraction_polynomial"] = self._axis_names
        of_gas_alone = [name for name in EXACT_RIVALS_OF_GAS if self._declared.get(of_gas(name), 0.0) != 0.0]
        return {
            **found,
            **{of_gas(name): (of_gas(name),) for name in dict.fromkeys([*self._tolerances.gas, *of_gas_alone])},
        }

    def _released(self, name: str, effects: Mapping[str, EffectChoice]) -> Parameter:
        """A coordinate as a hypothesis frees it: off where it is as declared, and claimed where no effect stands."""
        parameter = self.parameter(name) or DECLARED[name]
        declared = self._own[name].mean if name in self._own else self.declared(name)
        if SMALLER_IS.get(name) in effects:
            return parameter._replace(off=declared, lower=declared)
        has_effect = self._effect_like(name) in effects
        return parameter._replace(off=declared, upper=declared if has_effect else parameter.upper)

    def _effect_like(self, name: str) -> str | None:
        """The effect that is the same thing as a wrong declared value; None where there is none."""
        return self.of_effects[SAME_AS[name]][0] if name in SAME_AS else None

    def _is_one_sided(self, name: str) -> bool:
        """Whether that effect can only raise the value, so that one below the declared has no other name than its own.

        A coil lag adds to the coil time constant, which may as well be smaller than declared.
        """
        effect, parameter = self.of_effects[SAME_AS[name]]
        rule = CATALOGUE[effect].parameter(parameter)
        return parameter in CATALOGUE[effect].adds_to and rule.lower == rule.off


def hypothesis_of(name: str) -> str:
    """What the hypothesis is called that a declared value is wrong: `valve.<name>`, or `gas.<name>` as it is."""
    return name if name in GAS_NAMES else f"valve.{name}"


def _slope_of_effect(name: str, declared: float) -> float:
    """Slope of the parameter of the effect that is the same thing as a declared value, over that value.

    A gain of the drive is what the declared voltage is divided by: V/(V_ref) · gain. All others are in the value's
    unit.
    """
    return -1.0 / declared if name == "reference_voltage" else 1.0


def principal_axes(tolerances: Tolerances) -> Array:
    """(4, r) R, a square root of the polynomial's covariance, the widest axis first; theory, eq. (81)."""
    if tolerances.attraction_covariance is None:
        return np.empty((len(POLYNOMIAL_NAMES), 0))
    return covariance_root(np.array(tolerances.attraction_covariance))[:, ::-1]


def _nuisance(
    name: str, sigma: float, unit: str, mean: float, lower: float = -np.inf, upper: float = np.inf
) -> Nuisance:
    return Nuisance(
        name, sigma, unit, step=STEP * sigma, mean=mean, lower=lower, upper=upper, is_of_machine=True, number=name
    )  # fmt: skip


def _contacts(valve: Valve) -> tuple[dict[str, float], dict[str, float]]:
    """Bounds, the lower and the upper: the gap stays above 0 and below the stroke, whatever both come to."""
    sigmas = valve.tolerances.declared
    gap, stroke = valve.parameters.pilot_gap, valve.parameters.stroke
    of_gap, of_stroke = sigmas.get("pilot_gap", 0.0), sigmas.get("stroke", 0.0)
    if valve.parameters.has_one_plunger or of_gap + of_stroke == 0.0:
        return {}, {}
    room = (stroke - gap) / (of_gap + of_stroke)
    # In tolerances, both go equally far.
    least = {"stroke": stroke - 0.999 * room * of_stroke, "pilot_gap": 1e-6 * min(of_gap, gap)}
    return least, {"pilot_gap": gap + 0.999 * room * of_gap}
