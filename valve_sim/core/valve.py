"""A valve as it is declared: its parameters and its effects, checked together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.core.effects import Effect, check_effects, shipped
from valve_sim.core.equations import build
from valve_sim.core.plan import Plan, plan_of
from valve_sim.core.tracer import evaluate
from valve_sim.model.errors import ParameterError
from valve_sim.model.parameters import POLYNOMIAL_NAMES, ValveParameters, check_declared, check_geometry

OF_TWO_PLUNGERS: Final = ("gap_offset", "pickup_impact")
"""Effects that a valve with one plunger cannot have."""
_PLACES: Final = 65
_CURRENTS: Final = np.geomspace(1e-3, 1e3, 241)
"""Places along the stroke, and currents u, at which the flux is checked to grow with the current."""


@dataclass(frozen=True)
class Valve:
    """A valve to simulate.

    Attributes:
        parameters: the declared valve.
        effects: effect name to its parameters, e.g. {"coulomb_friction": {"force": 0.3}}.
        catalogue: the effects that there are, by name; a program may add its own to a copy of `shipped()`.
    """

    parameters: ValveParameters = field(default_factory=ValveParameters)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    catalogue: Mapping[str, Effect] = field(default_factory=shipped, repr=False, compare=False)

    @classmethod
    def from_mapping(
        cls, values: Mapping[str, Any], source: str, catalogue: Mapping[str, Effect] | None = None
    ) -> Valve:
        """A checked valve from {"valve": {...}, "effects": {...}}, both optional.

        Args:
            values: as found in a parameter file. source: the file or node, for messages.
            catalogue: the effects that there are; default those of this package.

        Raises:
            ParameterError: anything unknown, of the wrong type or out of range; the message names it.
        """
        known = shipped() if catalogue is None else catalogue
        parameters = check_declared(dict(values.get("valve") or {}), source)
        valve = cls(parameters, check_effects(values.get("effects") or {}, source, known), known)
        valve.check(source)
        return valve

    def declared(self) -> dict[str, float]:
        """The declared scalars by name, the polynomial as a0 … a3."""
        values = self.parameters._asdict()
        polynomial = values.pop("attraction_polynomial")
        return {**values, **dict(zip(POLYNOMIAL_NAMES, polynomial, strict=True))}

    def with_values(self, **values: float) -> Valve:
        """The same valve with some declared scalars (a0 … a3 among them) replaced.

        Raises:
            ParameterError: no such scalar.
        """
        declared = self.declared()
        for name, value in values.items():
            if name not in declared:
                raise ParameterError(f"valve.{name}: no such parameter")
            declared[name] = value
        polynomial = tuple(declared.pop(name) for name in POLYNOMIAL_NAMES)
        return replace(self, parameters=ValveParameters(**declared, attraction_polynomial=polynomial))  # type: ignore[arg-type]

    def plan(self, free: tuple[str, ...] = (), width: int = 0) -> Plan:
        """What is compiled for its effects, with derivatives to some parameters."""
        effects = tuple([self.catalogue[name] for name in self.effects])
        return plan_of(effects, self._shapes(effects), self.parameters.release_voltage > 0.0, free, width)

    def _shapes(self, effects: tuple[Effect, ...]) -> tuple[float, ...]:
        """The values of the parameters that shape its effects."""
        return tuple([self.effects[effect.name][name] for effect in effects for name in effect.shapes])

    def numbers(self) -> NDArray[np.float64]:
        """Its numbers in the order of its plan's parameters."""
        return self.plan().numbers(self.parameters, self.effects)

    def check(self, source: str) -> None:
        """Check what only shows when all is taken together.

        Args:
            source: the file or node, for messages.

        Raises:
            ParameterError: a gap that is not inside the stroke, an effect that the valve cannot have, or a flux that
                falls while the current grows, so that no current follows from it.
        """
        one = self.parameters.has_one_plunger
        for name in OF_TWO_PLUNGERS if one else ():
            if name in self.effects:
                raise ParameterError(
                    f"{source}: effects.{name}: found beside valve.pilot_gap 0, a valve with one plunger, which picks "
                    "nothing up; take the effect out, or declare the gap"
                )
        effects = tuple(self.catalogue[name] for name in self.effects)
        system = build(effects, shapes=self._shapes(effects))
        values = dict(zip(system.parameters, self.numbers().tolist(), strict=True))
        gap, stroke, lag = evaluate(
            [system.numbers[name] for name in ("pilot_gap", "stroke", "coil_time_constant")], values
        )
        check_geometry(float(gap), float(stroke), f"{source} (with effects)", has_one_plunger=one)
        if system.flux_slope is not None:
            self._check_flux(system.flux_slope, values, float(stroke), float(lag), source)

    @staticmethod
    def _check_flux(slope: Any, values: Mapping[str, float], stroke: float, lag: float, source: str) -> None:
        """Check that the flux grows with the current, from seat to stop and at any current."""
        if lag == 0.0:
            raise ParameterError(
                f"{source}: effects.motional_emf: found a coil time constant of 0 s, expected above 0: a coil without "
                "inductance has no flux; declare valve.coil_time_constant, the coil's L/R at its largest gap"
            )
        x = np.linspace(0.0, stroke, _PLACES)[:, None]
        currents = np.concatenate([[0.0], _CURRENTS])[None, :]
        (slopes,) = evaluate([slope], {**values, "x": x, "w": currents})
        smallest = float(np.min(slopes))
        if not smallest > 0.0:
            raise ParameterError(
                f"{source}: effects.motional_emf: found a coil time constant of {lag:g} s, expected above "
                f"{lag - smallest:.6g} s: somewhere in the stroke more current would make less flux; check "
                "valve.coil_time_constant, the attraction, valve.coil_resistance and magnetic_saturation"
            )
