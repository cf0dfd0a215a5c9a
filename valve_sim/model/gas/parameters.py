"""The declared gas: names, units and ranges of the group `gas`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from valve_sim.model.core.gas import critical_cubic
from valve_sim.model.errors import ParameterError
from valve_sim.model.gas.fluids import FLUIDS, Fluid
from valve_sim.model.parameters import Parameter, closest


class GasParameters(NamedTuple):
    """What flows, from where to where, and through what. SI; pressures are absolute.

    Those without a default must be given.
    """

    inlet_pressure: float
    outlet_volume: float
    pilot_orifice_diameter: float
    main_orifice_diameter: float
    seat_diameter: float
    inlet_temperature: float = 288.15
    outlet_pressure: float = 1e5
    demand_orifice_diameter: float = 0.0
    demand_pressure: float = 1e5
    discharge_coefficient: float = 0.8
    fluid: str = "hydrogen"

    def numbers(self) -> list[float]:
        """Those of `core.gas.NUMBERS`, in their order: of the group, and of its fluid."""
        fluid = self.properties
        own: tuple[float, ...] = self[:-1]  # all but the fluid's name
        gamma = fluid.heat_capacity_ratio
        return [*own, fluid.gas_constant, fluid.covolume, gamma, *critical_cubic(gamma)]

    @property
    def properties(self) -> Fluid:
        """The gas that flows."""
        return FLUIDS[self.fluid]


_GAS: Final = (
    Parameter("inlet_pressure", "Pa", "of the tank, absolute; 0: no gas", 1e3, 2e8, 1e6, not_declared=0.0),
    Parameter("outlet_volume", "m³", "behind the valve", 1e-9, 1e3, 1e-5, not_declared=0.0),
    Parameter(
        "pilot_orifice_diameter", "m", "d_p, of the orifice that the pilot plunger opens", 1e-6, 0.1, 1e-4,
        not_declared=0.0,
    ),
    Parameter(
        "main_orifice_diameter", "m", "d_m, of the orifice that the main plunger opens", 1e-6, 0.5, 1e-3,
        not_declared=0.0,
    ),
    Parameter("seat_diameter", "m", "d_s, of the main plunger's seat", 1e-6, 0.5, 1e-3, not_declared=0.0),
    Parameter("inlet_temperature", "K", "of the tank and of all gas", 50, 1000, 10.0, not_declared=288.15),
    Parameter("outlet_pressure", "Pa", "in the outlet volume at the start, absolute", 1e3, 2e8, 1e5),
    Parameter("demand_orifice_diameter", "m", "where the gas goes from the outlet volume; 0: a dead end", 0, 0.1, 1e-4),
    Parameter("demand_pressure", "Pa", "behind the demand's orifice, absolute", 1e3, 2e8, 1e5),
    Parameter("discharge_coefficient", "–", "C_d, of every orifice", 0.05, 1.0, 0.1),
)  # fmt: skip
GAS: Final[dict[str, Parameter]] = {entry.name: entry for entry in _GAS}
"""Every number of the group `gas` by name; `fluid` is a name and stands beside them."""


def check_gas(values: Mapping[str, object], source: str) -> GasParameters:
    """Turn a mapping as found in YAML into declared parameters of gas.

    Args:
        values: name to value. source: the file or node that they come from, for messages.

    Raises:
        ParameterError: unknown or missing name, wrong type, out of range.
    """
    checked: dict[str, float | str] = {}
    for name, value in values.items():
        where = f"{source}: gas.{name}"
        if name == "fluid":
            if value not in FLUIDS:
                raise ParameterError(f"{where}: found {value!r}, expected one of {', '.join(FLUIDS)}")
            checked[name] = str(value)
        elif name in GAS:
            checked[name] = GAS[name].check(value, where)
        else:
            raise ParameterError(f"{where}: no such parameter; did you mean {closest(name, GasParameters._fields)}?")
    required = [name for name in GasParameters._fields if name not in GasParameters._field_defaults]
    missing = [name for name in required if name not in checked]
    if missing:
        raise ParameterError(
            f"{source}: gas.{missing[0]} is missing; gas needs {', '.join(required)}, or take the group gas out"
        )
    return GasParameters(**checked)  # type: ignore[arg-type]
