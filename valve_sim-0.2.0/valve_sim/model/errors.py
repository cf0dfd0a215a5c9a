"""The errors that valve_sim raises for its users: few, typed, one line each."""

from __future__ import annotations


class ValveError(Exception):
    """Base of all errors raised on purpose: one line with the place, the value found, and the remedy."""


class ParameterError(ValveError):
    """A parameter is unknown, of the wrong type, or outside its range."""


class SimulationError(ValveError):
    """A simulation could not be carried to its end."""
