"""Valves with gas for tests: the default valve, with sizes and pressures that can be changed by name."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from plants.gas import GasValve

from valve_sim.files.parameter_files import default_valve
from valve_sim.model import Valve
from valve_sim.model.gas import GasParameters

BASE = GasParameters(
    inlet_pressure=35e6,
    outlet_volume=1e-5,
    pilot_orifice_diameter=0.2e-3,
    main_orifice_diameter=3e-3,
    seat_diameter=4e-3,
)


def gas_valve(**gas: Any) -> Valve:
    """The default valve with a seat load of 0.3 N and this gas."""
    return replace(default_valve().exact().with_values(seat_load=0.3), gas=BASE._replace(**gas))


def independent(valve: Valve) -> GasValve:
    """The same valve, as the independent plant has it."""
    assert valve.gas is not None
    declared = {**valve.parameters._asdict()}
    return GasValve(declared, {name: value for name, value in valve.gas._asdict().items() if name != "fluid"})
