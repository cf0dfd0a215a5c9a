"""The physics of the valve: parameters, equations, effects, event-accurate simulation. Knows no ROS, file or clock."""

from valve_sim.model.core_types import EventKind, Phase
from valve_sim.model.effects import CATALOGUE, Effect, Severity, Tag
from valve_sim.model.errors import ParameterError, SimulationError, ValveError
from valve_sim.model.parameters import DECLARED, Parameter, ValveParameters
from valve_sim.model.simulation import (
    TOLERANCE,
    Drive,
    Event,
    Response,
    Valve,
    published_times,
    simulate,
    simulate_many,
)
from valve_sim.model.stepper import CoilReading, Reading, Stepper
from valve_sim.model.tolerances import EXACT, Tolerances

__all__ = [
    "CATALOGUE",
    "DECLARED",
    "EXACT",
    "TOLERANCE",
    "CoilReading",
    "Drive",
    "Effect",
    "Event",
    "EventKind",
    "Parameter",
    "ParameterError",
    "Phase",
    "Reading",
    "Response",
    "Severity",
    "SimulationError",
    "Stepper",
    "Tag",
    "Tolerances",
    "Valve",
    "ValveError",
    "ValveParameters",
    "published_times",
    "simulate",
    "simulate_many",
]
