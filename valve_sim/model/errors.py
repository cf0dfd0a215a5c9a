"""The errors that a user of valve_sim can meet: few, typed, one line each."""

from __future__ import annotations


class ValveError(Exception):
    """Base of all errors raised on purpose: one line that names the thing, what was found and the mend."""


class ParameterError(ValveError):
    """A parameter is unknown, of the wrong type, or outside its range."""


class SimulationError(ValveError):
    """A simulation could not be carried to its end."""
