"""Gas: the pressure that the pilot relieves, and the flow through the valve.

`parameters` and `fluids` say what is declared, `record` how the compiled code reads it, `flow` what the gas does at a
given pressure, `boundary` which pressures it is given, and `step` how it is stepped together with the plungers, whose
forces are in `equations` and whose coil is in `flux`. `driver` goes from event to event; `linearised`, `variational`
and `variational_pressure` are the derivatives. Whoever declares no gas runs none of this. `line` is what several
valves fill.
"""

from valve_sim.model.gas.fluids import FLUIDS, Fluid
from valve_sim.model.gas.parameters import GAS, GasParameters, check_gas

__all__ = ["FLUIDS", "GAS", "Fluid", "GasParameters", "check_gas"]
