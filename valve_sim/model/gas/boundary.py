"""The pressures at both ends of a valve with gas: the tank before it, and what its demand's orifice leads to."""

from __future__ import annotations

from typing import Final

from valve_sim.model.compiling import compiled
from valve_sim.model.gas.flow import density_at, flow_regime, pressure_at

_NO_MARGIN: Final = (0.0, 0.0)


@compiled
def fill_outlets(valves, states):
    """Put the declared gas into the outlets of valves at rest, and the declared pressures at both ends."""
    for i in range(len(valves)):
        p, s = valves[i], states[i]
        s.density = density_at(p, p.outlet_pressure)
        s.tank_pressure, s.tank_time = p.inlet_pressure, s.time
        s.demand_pressure = p.demand_pressure
        s.flow_regime = flow_regime(p, s, p.inlet_pressure, p.outlet_pressure, _NO_MARGIN)


@compiled
def set_inlet(valve, state, pressure, rate):
    """The inlet's pressure, Pa, from the state's time on, and the rate at which it goes on to change, Pa/s."""
    s = state[0]
    s.tank_pressure, s.tank_rate, s.tank_time = pressure, rate, s.time


@compiled
def set_demand(valve, state, pressure):
    """The pressure behind the demand's orifice, Pa, from the state's time on."""
    state[0].demand_pressure = pressure


@compiled
def keep_pressure(valve, state, before):
    """Keep the outlet's pressure where another gas, or one of another temperature, takes the place of that before."""
    p, s = valve[0], state[0]
    pressure = pressure_at(before[0], s.density)
    if density_at(p, pressure) != density_at(before[0], pressure):
        s.density = density_at(p, pressure)
