"""What is declared of a gas that flows through the valve; its equations are in `core.gas`."""

from valve_sim.model.gas.fluids import FLUIDS, Fluid
from valve_sim.model.gas.parameters import GAS, GasParameters, check_gas

__all__ = ["FLUIDS", "GAS", "Fluid", "GasParameters", "check_gas"]
