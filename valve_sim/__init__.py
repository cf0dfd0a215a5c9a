"""A pilot-operated solenoid valve of an ultra-high-pressure hydrogen vessel: simulated, identified, diagnosed."""

import os
from typing import Any

# NumPy reads this where it is loaded. The matrices of a fit are thin: threads of the linear algebra wait for each
# other, and beside other work a diagnosis has taken 240 CPU seconds for 32. What a user has set stays.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

__version__ = "0.2.0"


def __getattr__(name: str) -> Any:
    """The front door, loaded when it is first asked for: `read` a recording of any machine as columns."""
    if name == "read":
        from valve_sim.traces.columns import read

        return read
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
