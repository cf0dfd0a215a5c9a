"""The state of a recording: its errors beside the declared valve, and what they cost.

Beside the refitted declared valve each effect has a detection limit (`selection.detection_limits`). The limits of the
same recording without its errors say how small an effect could be named if they were mended.
"""

from __future__ import annotations

from dataclasses import dataclass

from valve_sim.identification.diagnosis.identify import Identification, Progress, identify
from valve_sim.identification.fit.detection_limits import Limits, detection_limits
from valve_sim.identification.fit.fitter import Fitter
from valve_sim.identification.fit.posterior import rivals_of
from valve_sim.identification.fit.recorded_errors import RecordedError
from valve_sim.identification.fit.result import Fit
from valve_sim.identification.fit.unknown import SMALLEST
from valve_sim.model import Valve
from valve_sim.recordings import Trace


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
    limits = _limits(best, has_errors=True)
    say("limits", 0.75)
    without_errors = _limits(best, has_errors=False)
    say("done", 1.0)
    return RecordingState(found, limits, without_errors)


def _limits(best: Fit, *, has_errors: bool) -> Limits:
    """Detection limits beside a fit, and beside the same of a recording that has errors of its clocks only.

    Nothing is fitted again: limits depend on what the data determine, not on where a fit ends.
    """
    fitter = Fitter(best.problem, rivals_of(best.problem.plant), free=best.free)
    nothing = {name: SMALLEST * group.scale for name, group in fitter.groups.items()}
    fitter.sizes = dict(best.gaussian.sizes) if has_errors else nothing
    return detection_limits(fitter, fitter.tried_at(best.values))
