"""The valve without its measurements: freed values in, the valve that they describe out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from valve_sim.identification.plants.protocol import EffectChoice
from valve_sim.model import CATALOGUE, DECLARED, Parameter, Valve
from valve_sim.model.effects import new_record


class ValveModel:
    """What every plant of a valve holds, whatever was measured of it.

    Args:
        valve: the declared valve; effects that it has on already stay on as they are, unless freed.

    Attributes:
        valve: as given. effects: the catalogue, less the effects that the declared valve has on.
    """

    def __init__(self, valve: Valve) -> None:
        self.valve = valve
        self.effects: Mapping[str, EffectChoice] = {
            name: EffectChoice(name, entry.parameters, entry.confused_with)
            for name, entry in CATALOGUE.items()
            if entry.named and name not in valve.effects
        }
        self._declared = valve.declared()

    def parameter(self, name: str) -> Parameter:
        """Unit and range of a declared parameter or of `<effect>.<parameter>`.

        Raises:
            KeyError: there is none.
        """
        effect, dot, parameter = name.partition(".")
        return CATALOGUE[effect].parameter(parameter) if dot else DECLARED[name]

    def declared(self, name: str) -> float:
        """The declared value, or the one at which an effect changes nothing."""
        effect, dot, parameter = name.partition(".")
        if not dot:
            return self._declared[name]
        if effect in self.valve.effects:
            return self.valve.effects[effect][parameter]
        return CATALOGUE[effect].parameter(parameter).neutral

    def with_values(self, values: Mapping[str, float]) -> Valve:
        """The valve that freed values describe; nuisances are left out."""
        effects = {name: dict(parameters) for name, parameters in self.valve.effects.items()}
        declared = {}
        for name, value in values.items():
            effect, dot, parameter = name.partition(".")
            if dot:
                effects.setdefault(effect, CATALOGUE[effect].neutral_values())[parameter] = float(value)
            elif name in self._declared:
                declared[name] = float(value)
        return replace(self.valve.with_values(**declared), effects=effects)

    def record(self, values: Mapping[str, float]) -> Any:
        """The compiled core's record of the valve that freed values describe."""
        effects = {name: dict(parameters) for name, parameters in self.valve.effects.items()}
        declared = dict(self._declared)
        for name, value in values.items():
            effect, dot, parameter = name.partition(".")
            if dot:
                effects.setdefault(effect, {})[parameter] = value
            elif name in declared:
                declared[name] = value
        return new_record(declared, effects)
