"""Libraries of extras: a missing one is one line that says what to install."""

from __future__ import annotations

import importlib

from valve_sim.model.errors import ValveError


def require(module: str, extra: str, purpose: str) -> None:
    """Import a library of an extra.

    Args:
        module: its name. extra: of this package, that brings it. purpose: what it is needed for.

    Raises:
        ValveError: it is not installed, or cannot be imported.
    """
    try:
        importlib.import_module(module)
    except ImportError as error:
        raise ValveError(
            f"{purpose} needs {module}, which cannot be imported ({error}); pip install 'valve_sim[{extra}]'"
        ) from error
