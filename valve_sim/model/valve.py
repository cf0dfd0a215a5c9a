"""A valve: its declared values, the effects that are on, and the numbers that its equations take."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from valve_sim.model.core.equations import NEUTRAL, names_of_numbers
from valve_sim.model.core.flux import why_no_flux
from valve_sim.model.core.plan import Plan, plan_of
from valve_sim.model.core.symbols import Own
from valve_sim.model.core.tracer import Node, Trace
from valve_sim.model.core_types import Phase
from valve_sim.model.effects import CATALOGUE, Effect, check_effects
from valve_sim.model.errors import ParameterError
from valve_sim.model.gas import GasParameters, check_gas
from valve_sim.model.parameters import POLYNOMIAL_NAMES, ValveParameters, check_declared, check_geometry
from valve_sim.model.tolerances import EXACT, Tolerances

Array = NDArray[np.float64]

OF_TWO_PLUNGERS: Final = ("gap_offset", "pickup_impact")
"""Effects that a valve with one plunger cannot have."""
_POLYNOMIAL: Final = ValveParameters._fields.index("attraction_polynomial")
"""Its place among the declared parameters, where its coefficients stand one by one."""
ALWAYS: Final = (
    "coil_lag", "drive_gain", "gap_offset", "rest_attraction", "sensor_bandwidth", "sensor_delay", "sensor_gain",
    "stop_bounce", "stroke_offset",
)  # fmt: skip
"""Effects that only change numbers, and at their neutral values none: every valve's equations have them, so that
valves with and without share compiled code."""
_NOTHING: Final[Mapping[str, float]] = {}


@functools.cache
def _neutral(effect: Effect) -> dict[str, float]:
    return effect.neutral_values()


@functools.lru_cache(maxsize=512)
def _names_of(effects: tuple[Effect, ...], has_gas: bool) -> tuple[str, ...]:
    return names_of_numbers(effects, has_gas=has_gas)


@dataclass(frozen=True)
class Valve:
    """A valve to simulate: the declared parameters, and the effects that are on.

    Attributes:
        parameters: the declared valve.
        effects: effect name to its parameters, e.g. {"coulomb_friction": {"force": 0.3}}.
        tolerances: how well these values are known; changes nothing of the motion.
        gas: what flows through it; None for a valve on a bench, without gas.
    """

    parameters: ValveParameters = field(default_factory=ValveParameters)
    effects: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    tolerances: Tolerances = EXACT
    gas: GasParameters | None = None

    @classmethod
    def from_mapping(cls, values: Mapping[str, Any], source: str) -> Valve:
        """A checked valve from {"valve": {...}, "effects": {...}, "tolerances": {...}, "gas": {...}}, all optional.

        Args:
            values: as found in a parameter file.
            source: the file or node, for messages.

        Raises:
            ParameterError: anything unknown, of the wrong type or out of range; the message names it.
        """
        parameters = check_declared(dict(values.get("valve") or {}), source)
        effects = check_effects(values.get("effects") or {}, source)
        gas = check_gas(values["gas"], source) if values.get("gas") else None
        tolerances = Tolerances.from_mapping(values.get("tolerances") or {}, source, effects, has_gas=gas is not None)
        tolerances.check_against(parameters, source)
        if parameters.has_one_plunger:
            _check_one_plunger(effects, gas, source)
        if gas is not None:
            _check_beside_gas(parameters, effects, source)
        else:
            _check_without_gas(effects, source)
        valve = cls(parameters, effects, tolerances, gas)
        gap, stroke = valve.after_effects("pilot_gap", "stroke")
        check_geometry(gap, stroke, f"{source} (with effects)", has_one_plunger=parameters.has_one_plunger)
        if why_not := valve.why_no_flux():
            raise ParameterError(f"{source}: effects.{why_not}")
        return valve

    def plan(self, width: int = 0, runs: int = 1) -> Plan:
        """Its equations with these effects, compiled, with so many directions of derivatives, for some runs."""
        gas = self.gas
        return plan_of(
            self._all_effects(), self._shapes(), width, freewheels=self.parameters.release_voltage > 0.0,
            has_gas=gas is not None, has_demand=gas is not None and gas.demand_orifice_diameter > 0.0, runs=runs,
        )  # fmt: skip

    def _own_effects(self) -> list[str]:
        """The effects for which equations are compiled."""
        return [name for name in self.effects if name not in ALWAYS]

    def _all_effects(self) -> tuple[Effect, ...]:
        return tuple([CATALOGUE[name] for name in (*self._own_effects(), *ALWAYS)])

    @property
    def names(self) -> tuple[str, ...]:
        """The names of `numbers`, "coulomb_friction.force" of an effect's."""
        return _names_of(self._all_effects(), self.gas is not None)

    def numbers(self) -> Array:
        """(m,) what its equations take, in the order of `names`; what is not given is neutral."""
        before, polynomial, after = (
            self.parameters[:_POLYNOMIAL], self.parameters[_POLYNOMIAL], self.parameters[_POLYNOMIAL + 1 :],
        )  # fmt: skip
        values = [*before, *polynomial, *after]  # type: ignore[misc]
        for name in (*self._own_effects(), *ALWAYS):
            # In the order of the parameters.
            values += {**_neutral(CATALOGUE[name]), **self.effects.get(name, _NOTHING)}.values()
        if self.gas is not None:
            values += self.gas.numbers()
        return np.array(values)

    def after_effects(self, *names: str) -> list[float]:
        """The numbers of the equations with the changes that its effects make, by their names in `core.equations`."""
        declared = {**NEUTRAL, **self.declared()}
        found: list[Any] = [declared[name] for name in names]
        trace: Trace | None = None
        for effect, given in self.effects.items():
            entry = CATALOGUE[effect]
            changed = [place for place, name in enumerate(names) if name in entry.changes]
            if changed:
                trace = trace or Trace()
                numbers = {**_neutral(entry), **given}
                own = Own(**{name: trace.constant(value) for name, value in numbers.items()})
                for place in changed:
                    found[place] = trace.lift(entry.changes[names[place]](trace.lift(found[place]), own))
        return [float(own.value or 0.0) if isinstance(own, Node) else float(own) for own in found]

    def _shapes(self) -> tuple[float, ...]:
        """The values of the parameters that shape its effects."""
        entries = [CATALOGUE[name] for name in self._own_effects()]
        return tuple(
            [{**_neutral(entry), **self.effects[entry.name]}[name] for entry in entries for name in entry.shapes]
        )

    def why_no_flux(self) -> str:
        """Why its current does not follow from its flux, for a message; empty where it does or no flux is modelled."""
        return why_no_flux(self._all_effects(), self._shapes(), self.numbers().tolist())

    def to_mapping(self) -> dict[str, dict[str, Any]]:
        """The plain mapping that `from_mapping` takes back."""
        declared = self.parameters._asdict()
        declared["attraction_polynomial"] = list(self.parameters.attraction_polynomial)
        mapping: dict[str, dict[str, Any]] = {"valve": declared}
        if self.effects:
            mapping["effects"] = {name: CATALOGUE[name].packed(values) for name, values in self.effects.items()}
        if self.gas is not None:
            mapping["gas"] = self.gas._asdict()
        if tolerances := self.tolerances.to_mapping():
            mapping["tolerances"] = tolerances
        return mapping

    def declared(self) -> dict[str, float]:
        """The declared scalars by name, the polynomial as a0 … a3."""
        values = self.parameters._asdict()
        polynomial = values.pop("attraction_polynomial")
        return {**values, **dict(zip(POLYNOMIAL_NAMES, polynomial, strict=True))}

    def with_values(self, **values: float) -> Valve:
        """This valve with some declared scalars (a0 … a3 among them) replaced.

        Raises:
            ParameterError: no such scalar.
        """
        declared = self.declared()
        for name, value in values.items():
            if name not in declared:
                raise ParameterError(f"valve.{name}: no such parameter")
            declared[name] = value
        polynomial = tuple(declared.pop(name) for name in POLYNOMIAL_NAMES)
        parameters = ValveParameters(**declared, attraction_polynomial=polynomial)  # type: ignore[arg-type]
        return replace(self, parameters=parameters)

    def exact(self) -> Valve:
        """This valve with its values taken as exact: without tolerances, but for the sensor's."""
        return replace(self, tolerances=Tolerances(sensor=self.tolerances.sensor))

    def can_open(self) -> bool:
        """Whether the reference voltage, held without end, would lift the pilot plunger off its seat."""
        # Imported here, for both are of a valve.
        from valve_sim.model.live import Live
        from valve_sim.model.simulation import TOLERANCE

        voltage, *lags = self.after_effects("reference_voltage", "coil_time_constant", "eddy_time_constant")
        settled = 50.0 * sum(lags) + 1e-3
        live = Live.at_rest(self, 0.0, TOLERANCE)
        live.command(voltage)
        live.step(settled, commit=True)
        return bool(live.row[4] != Phase.CLOSED)


def _check_one_plunger(effects: Mapping[str, Mapping[str, float]], gas: GasParameters | None, source: str) -> None:
    """What is declared beside a pilot_gap of 0 must not need a pilot plunger."""
    for name in OF_TWO_PLUNGERS:
        if name in effects:
            raise ParameterError(
                f"{source}: effects.{name}: found beside valve.pilot_gap 0, a valve with one plunger, which picks "
                "nothing up; take the effect out, or declare the gap"
            )
    if gas is not None:
        raise ParameterError(
            f"{source}: gas: found beside valve.pilot_gap 0, a valve with one plunger, but gas equalises through the "
            "orifice of a pilot plunger; take the group gas out, or declare the gap"
        )


def _check_beside_gas(parameters: ValveParameters, effects: Mapping[str, Mapping[str, float]], source: str) -> None:
    """Refuse declared values that contradict a valve with gas."""
    for name in effects:
        if not CATALOGUE[name].is_of(has_gas=True):
            raise ParameterError(
                f"{source}: effects.{name}: found beside gas, with which it cannot act: gas has the pressure across "
                "the main plunger itself, and its stop is rigid; take one of the two out"
            )
    if not parameters.seat_load > 0.0:
        raise ParameterError(
            f"{source}: valve.seat_load: found {parameters.seat_load:g} N beside gas, expected above 0 N: without it "
            "a pilot plunger at equal pressures floats on its seat"
        )


def _check_without_gas(effects: Mapping[str, Mapping[str, float]], source: str) -> None:
    """Refuse effects that only a valve with gas has."""
    for name in effects:
        if not CATALOGUE[name].is_of(has_gas=False):
            raise ParameterError(
                f"{source}: effects.{name}: found without gas, of which it is an effect; declare the group gas, or "
                "take the effect out"
            )
