"""The valve without its measurements: freed values in, the valve that they describe out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from typing import Final

from valve_sim.identification.plants.protocol import Array, EffectChoice, Nuisance
from valve_sim.identification.plants.tolerances import GAS_NAMES, ToleratedValues
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Valve, ValveParameters
from valve_sim.model.gas import GAS, GasParameters
from valve_sim.model.parameters import POLYNOMIAL_NAMES
from valve_sim.model.valve import OF_TWO_PLUNGERS

SWITCHES: Final = (
    "coil_time_constant", "eddy_time_constant", "residual_current", "restitution_stop", "restitution_seat",
    "stop_compliance", "sensor_time_constant", "release_voltage",
)  # fmt: skip
"""Numbers that are off at 0 and act differently on either side of it: difference quotients are needed there."""
WATCHED: Final = frozenset({*SWITCHES, "reference_voltage", "coil_resistance"})
"""These, and what the rated current follows from: effects change what is declared of them."""
DAMPINGS: Final = ("pilot_damping", "main_damping")
"""Declared values that every fit frees, because they are not known beforehand; see `dampings_of`."""


def dampings_of(valve: Valve) -> tuple[str, ...]:
    """The names of the dampings that a valve uses: one plunger has no Phase 1."""
    return DAMPINGS[1:] if valve.parameters.has_one_plunger else DAMPINGS


def switches_of(valve: Valve) -> list[float]:
    """The switches of a valve, with its effects."""
    return valve.after_effects(*SWITCHES)


class ValveModel:
    """What every plant of a valve holds, whatever was measured of it.

    Args:
        valve: the declared valve; effects that it has on already stay on as they are, unless freed.

    Attributes:
        valve: as given. refitted: declared values that every fit frees.
        scatter: s, standard deviation of the commands' times where they and the clocks are known; None: they are not.
        effects: the catalogue; of effects that the declared valve has on, that they are not as large as declared; and
            that a declared value is wrong.
        nuisances: declared values with a tolerance.
        of_effects: see `tolerances.parameters_of_effects`.
    """

    scatter: float | None = None

    def __init__(self, valve: Valve) -> None:
        self.valve, self.refitted = valve, dampings_of(valve)
        self._tolerated = ToleratedValues(valve)
        self.of_effects = self._tolerated.of_effects
        self.nuisances: tuple[Nuisance, ...] = self._tolerated.nuisances
        left_out = {name for name, entry in CATALOGUE.items() if not entry.tried}
        left_out |= {name for name, entry in CATALOGUE.items() if not entry.is_of(has_gas=valve.gas is not None)}
        if valve.parameters.has_one_plunger:
            left_out |= {*OF_TWO_PLUNGERS}
        if valve.parameters.coil_time_constant == 0.0:
            left_out |= {name for name, entry in CATALOGUE.items() if entry.needs_inductance}
        effects = {
            name: EffectChoice(
                name, entry.parameters, tuple(other for other in entry.confused_with if other not in left_out)
            )
            for name, entry in CATALOGUE.items()
            if entry.named and name not in left_out and name not in valve.effects
        }
        grown = {name: declared_effect(name, valve.effects[name]) for name in valve.effects if CATALOGUE[name].named}
        # What is declared already is among them: a wrong reference voltage is a drive gain of another size.
        effects |= {name: choice for name, choice in grown.items() if choice.parameters}
        self.effects: Mapping[str, EffectChoice] = self._tolerated.with_hypotheses(effects, self.refitted)
        self._declared = valve.declared()
        self._watched = WATCHED | {name for name, entry in CATALOGUE.items() if not WATCHED.isdisjoint(entry.changes)}
        self._gas = GAS_NAMES if valve.gas is not None else {}

    def parameter(self, name: str) -> Parameter:
        """Unit and range of a declared parameter, of `gas.<name>`, or of `<effect>.<parameter>`.

        Raises:
            KeyError: there is none.
        """
        if name in self._gas:
            return self._tolerated.parameter(name) or GAS[self._gas[name]]
        if name in self.of_effects:
            effect, parameter = self.of_effects[name]
            return CATALOGUE[effect].parameter(parameter)
        return self._tolerated.parameter(name) or DECLARED[name]

    def declared(self, name: str) -> float:
        """The declared value, or the one at which an effect changes nothing."""
        if name in self._gas:
            return float(getattr(self.valve.gas, self._gas[name]))
        if name not in self.of_effects:
            return self._tolerated.declared(name)
        effect, parameter = self.of_effects[name]
        if effect in self.valve.effects:
            return self.valve.effects[effect][parameter]
        return CATALOGUE[effect].parameter(parameter).neutral

    @cached_property
    def _names(self) -> frozenset[str]:
        hypotheses = (name for choice in self.effects.values() for name in choice.free_names())
        nuisances = (own.name for own in self.nuisances)
        return frozenset().union(self.of_effects, self._declared, self._gas, hypotheses, nuisances)

    def has(self, name: str) -> bool:
        """Whether a value is one of the valve, not of a recording of it."""
        return name in self._names

    def is_watched(self, name: str) -> bool:
        """Whether a declared value, or a parameter of an effect, may change a switch or the rated current."""
        return (self.of_effects[name][0] if name in self.of_effects else name) in self._watched

    def as_declared(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Values by the names of declared scalars and parameters of effects, in place of what stands for them."""
        return self._tolerated.as_declared(values)

    def with_values(self, values: Mapping[str, float]) -> Valve:
        """The valve that freed values and estimates of declared values describe; its tolerances stay as declared."""
        declared, freed = self._freed(values)
        on = self.valve.effects
        own = {name: {**(on.get(name) or CATALOGUE[name].neutral_values()), **few} for name, few in freed.items()}
        return replace(self.valve.with_values(**declared), effects={**on, **own}, gas=self._gas_with(values))

    def _freed(self, values: Mapping[str, float]) -> tuple[dict[str, float], dict[str, dict[str, float]]]:
        """Declared scalars, and by effect its parameters, that freed values describe."""
        declared, effects = dict[str, float](), dict[str, dict[str, float]]()
        for name, value in self.as_declared(values).items():
            if name in self._declared:
                declared[name] = float(value)
            elif name in self.of_effects:
                effect, parameter = self.of_effects[name]
                effects.setdefault(effect, {})[parameter] = float(value)
        return declared, effects

    def _gas_with(self, values: Mapping[str, float]) -> GasParameters | None:
        """The gas that freed values describe."""
        gas = self.valve.gas
        freed = {own: float(values[name]) for name, own in self._gas.items() if name in values}
        return gas if gas is None or not freed else gas._replace(**freed)  # type: ignore[arg-type] # numbers by name

    def propagated(self, names: Sequence[str], covariance: Array) -> tuple[tuple[str, ...], Array]:
        """Declared scalars and `<effect>.<parameter>` with their covariance, for those of what was estimated.

        Args:
            names: (k,) of what was estimated, coordinates of declared values among them. covariance: (k, k) of it.

        Returns:
            (m,) names, and (m, m).
        """
        return self._tolerated.propagated(names, covariance)

    def plain_slopes(self, slopes: Mapping[str, float], values: Mapping[str, float]) -> dict[str, float]:
        """How declared values and parameters of effects move along a direction, by their plain names."""
        return self._tolerated.plain_slopes(slopes, values)

    def simulated(self, values: Mapping[str, float]) -> Valve:
        """The valve that is simulated where freed values describe it.

        Nothing is checked, and parameters of effects that are not given are neutral.
        """
        scalars, freed = self._freed(values)
        declared, on = self._declared | scalars, self.valve.effects
        effects = {**on, **{name: {**on.get(name, {}), **few} for name, few in freed.items()}}
        polynomial = tuple(declared.pop(name) for name in POLYNOMIAL_NAMES)
        parameters = ValveParameters(**declared, attraction_polynomial=polynomial)  # type: ignore[arg-type] # by name
        return Valve(parameters, effects, gas=self._gas_with(values))


def declared_effect(name: str, values: Mapping[str, float]) -> EffectChoice:
    """The hypothesis that an effect which is declared is not as large as that; its shape stays as declared."""
    entry = CATALOGUE[name]
    switches = tuple(own._replace(off=values[own.name]) for own in entry.parameters if own.off is not None)
    return EffectChoice(name, switches, entry.confused_with, is_on=True)
