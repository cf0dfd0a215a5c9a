"""The error of the traces room."""

from __future__ import annotations

from valve_sim.model.errors import ValveError


class TraceError(ValveError):
    """A recording cannot be used: one line that names the file and the topic, what was found, and the mend."""
