"""The state of a recording: its errors beside the declared valve, and what they cost.

Beside the refitted declared valve each effect has a detection limit (`selection.detection_limits`). The limits of the
same recording without its errors say how small an effect could be named if they were mended.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np

from valve_sim.identification.diagnosis.identify import Identification, Progress, identify
from valve_sim.identification.estimation.descent import SolverOptions
from valve_sim.identification.estimation.errors.error import SMALLEST
from valve_sim.identification.estimation.recorded_errors import RecordedError
from valve_sim.identification.estimation.result import Fit
from valve_sim.identification.estimation.solver import fit
from valve_sim.identification.selection.detection_limits import Limits, detection_limits
from valve_sim.identification.selection.posterior import rivals_of
from valve_sim.model import Valve
from valve_sim.traces import Trace

HERE: Final = SolverOptions(most=0)
"""Nothing is fitted again: limits depend on what the data determine, not on where a fit ends."""


@dataclass(frozen=True)
class RecordingState:
    """The errors of a recording, and what can be named in it.

    Attributes:
        identification: the refitted declared valve, and the errors beside it.
        limits: of this recording. without_errors: of one that has noise and the errors of its clocks only.
    """

    identification: Identification
    limits: Limits
    without_errors: Limits

    @property
    def errors(self) -> tuple[RecordedError, ...]:
        """What is estimated of the errors; none where the model lacks something."""
        return tuple(own for entries in self.identification.recording.values() for own in entries)


def state_of_recording(trace: Trace, valve: Valve, progress: Progress | None = None) -> RecordingState:
    """Estimate the errors of a recording beside the declared valve with refitted dampings.

    Raises:
        SimulationError: the declared valve cannot be simulated.
        TraceError: the recording has columns that cannot be used, say with NaN in them.
    """
    say = progress or (lambda what, fraction: None)
    found = identify([trace], valve, progress=lambda what, fraction: say(what, 0.5 * fraction))
    best = found.fit
    if best.problem.is_long or not found.recording:
        return RecordingState(found, {}, {})
    say("limits", 0.5)
    limits = _limits(best)
    say("limits", 0.75)
    without_errors = _limits(_without_errors(best))
    say("done", 1.0)
    return RecordingState(found, limits, without_errors)


def _limits(result: Fit) -> Limits:
    return detection_limits(result, rivals_of(result.problem.plant))


def _without_errors(result: Fit) -> Fit:
    """A fit, at the same values, to a recording that has noise and the errors of its clocks only."""
    errors = result.problem.errors
    if errors is None:
        return result
    sizes = [SMALLEST * group.scale for group in errors.groups]
    problem = result.problem.with_errors(errors.resized(np.array(sizes)))
    nuisances = (
        *(own for own in result.nuisances if not own.group), *(own for own in problem.nuisances if own.group)
    )  # fmt: skip
    return fit(problem, result.free, result.values, nuisances=nuisances, effort=HERE)
