"""The core: the valve's equations written once, everything else derived from them.

`equations` is the page to begin with; `effects` has a file for each effect. `tracer` makes graphs of these, `series`
and `kernels` make the steps of the integrator of the graphs, `driver` is the integrator, `lowering` and `machine`
compile it all. The ways in are `simulate`, `run_many`, `run_sloped` with derivatives, and `Stepper`, live.
"""

from valve_sim.core.derivatives import Directions, Sloped, run_sloped
from valve_sim.core.effects import Effect, Motion, Own, shipped
from valve_sim.core.simulation import TOLERANCE, run_many, run_numbers, simulate
from valve_sim.core.stepper import Reading, Stepper
from valve_sim.core.valve import Valve

__all__ = [
    "TOLERANCE",
    "Directions",
    "Effect",
    "Motion",
    "Own",
    "Reading",
    "Sloped",
    "Stepper",
    "Valve",
    "run_many",
    "run_numbers",
    "run_sloped",
    "shipped",
    "simulate",
]
