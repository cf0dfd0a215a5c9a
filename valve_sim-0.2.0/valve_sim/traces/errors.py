"""The error that reading a recording raises."""

from __future__ import annotations

from valve_sim.model.errors import ValveError


class TraceError(ValveError):
    """A recording cannot be used: one line with the file and the topic, what was found, and the remedy."""
