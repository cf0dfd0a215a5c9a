"""What a unit shows to a master: its inputs, outputs and parameters, from the tables of the model."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Final, Literal, NamedTuple

from valve_sim.model import CATALOGUE, DECLARED, Parameter, Valve
from valve_sim.model.gas.parameters import GAS
from valve_sim.model.parameters import POLYNOMIAL_NAMES

Causality = Literal["input", "output", "parameter"]
Kind = Literal["real", "integer", "boolean"]


class Variable(NamedTuple):
    """One variable of a unit.

    Attributes:
        name: as a master knows it. Parameters are named as in a parameter file; members of a list count from 1.
        causality: who sets it: the master (input, parameter) or the valve (output).
        unit: SI, "" for a pure number. description: one line.
        kind: the type of its value.
    """

    name: str
    causality: Causality
    unit: str
    description: str
    kind: Kind = "real"


COIL_VOLTAGE: Final = Variable("coil_voltage", "input", "V", "commanded voltage of the coil, held during a step")
INLET_PRESSURE: Final = Variable("inlet_pressure", "input", "Pa", "absolute pressure of the tank, held during a step")
DEMAND_PRESSURE: Final = Variable(
    "demand_pressure", "input", "Pa", "absolute pressure behind the demand's orifice, held during a step"
)
_INPUTS_OF_GAS: Final = (INLET_PRESSURE, DEMAND_PRESSURE)
_OUTPUTS: Final = (
    Variable("pilot_position", "output", "m", "pilot plunger, from its seat, as the position sensor shows it"),
    Variable("main_position", "output", "m", "main plunger, from its seat, as the position sensor shows it"),
    Variable("pilot_velocity", "output", "m/s", "velocity of the pilot plunger"),
    Variable("coil_current", "output", "A", "current of the coil"),
    Variable("phase", "output", "", "0 closed, 1 pilot, 2 gap_hold, 3 main, 4 open", "integer"),
    Variable("is_open", "output", "", "whether the flow path is fully open", "boolean"),
)
_OUTPUTS_OF_GAS: Final = (
    Variable("outlet_pressure", "output", "Pa", "absolute pressure behind the valve"),
    Variable("mass_flow", "output", "kg/s", "flow through the valve, from the tank to the outlet"),
)


def variables_of(valve: Valve) -> tuple[Variable, ...]:
    """All variables of a valve's unit: inputs, outputs, then its parameters, of which effects only those declared."""
    has_gas = valve.gas is not None
    return (
        COIL_VOLTAGE,
        *(_INPUTS_OF_GAS if has_gas else ()),
        *_OUTPUTS,
        *(_OUTPUTS_OF_GAS if has_gas else ()),
        *(Variable(name, "parameter", found.unit, found.description) for name, found, _ in _numbers(valve)),
    )


def parameter_values(valve: Valve) -> dict[str, float]:
    """The values of the unit's parameters by name."""
    return {name: value for name, _, value in _numbers(valve)}


def flat_values(values: dict[str, float]) -> dict[str, object]:
    """Parameters as a parameter file names them: members of a list in one list."""
    flat: dict[str, object] = {}
    for name, value in values.items():
        whole, bracket, _ = name.partition("[")
        if not bracket:
            flat[name] = value
            continue
        members = flat.setdefault(whole, [])
        assert isinstance(members, list)
        members.append(value)
    return flat


def _numbers(valve: Valve) -> Iterator[tuple[str, Parameter, float]]:
    """Name, entry of the model's table, and value of each number that a master may set."""
    for name, value in valve.parameters._asdict().items():
        if isinstance(value, tuple):
            for place, (member, number) in enumerate(zip(POLYNOMIAL_NAMES, value, strict=True), start=1):
                yield f"valve.{name}[{place}]", DECLARED[member], number
        else:
            yield f"valve.{name}", DECLARED[name], value
    for effect, values in valve.effects.items():
        entries = {entry.name: entry for entry in CATALOGUE[effect].parameters}
        whole = CATALOGUE[effect].given_as_list
        for name, given in CATALOGUE[effect].packed(values).items():
            if isinstance(given, list):
                assert whole is not None
                for place, (member, number) in enumerate(zip(whole.members, given, strict=False), start=1):
                    yield f"effects.{effect}.{name}[{place}]", entries[member], number
            else:
                yield f"effects.{effect}.{name}", entries[name], given
    if valve.gas is not None:
        inputs = {entry.name for entry in _INPUTS_OF_GAS}
        for name, value in valve.gas._asdict().items():
            if name in GAS and name not in inputs:
                # The outlet's pressure as declared is that of the start; the output of this name is that of now.
                yield f"gas.{name}", GAS[name], value
