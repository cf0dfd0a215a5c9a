"""The state of a recording: its errors beside the declared valve, and what they hide.

Beside the refitted declared valve each effect has a detection limit (`selection.detection_limits`). The limits that
this recording would have without one of its errors, or without any, say what that error costs: how small an effect
could be named if it were mended.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final, NamedTuple

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

WORTH_SAYING: Final = 1.1
"""Factor on a limit from which an error is said to hide something."""
HERE: Final = SolverOptions(most=0)
"""Nothing is fitted again: limits depend on what the data determine, not on where a fit ends."""


class Hidden(NamedTuple):
    """The effect whose limit suffers most from an error.

    Attributes:
        effect, parameter, unit: which. limit: of this recording. without: of one that has all errors but this one; SI.
    """

    effect: str
    parameter: str
    unit: str
    limit: float
    without: float


@dataclass(frozen=True)
class RecordingState:
    """The errors of a recording, and what can be named in it.

    Attributes:
        identification: the refitted declared valve, and the errors beside it.
        limits: of this recording. without_errors: of one that has noise and the errors of its clocks only.
        hidden: by name of an error that is there, what it hides; nothing of one that hides next to nothing.
    """

    identification: Identification
    limits: Limits
    without_errors: Limits
    hidden: Mapping[str, Hidden]

    @property
    def errors(self) -> tuple[RecordedError, ...]:
        """What is estimated of the errors; none where the model lacks something."""
        return tuple(own for entries in self.identification.recording.values() for own in entries)


def state_of_recording(trace: Trace, valve: Valve, progress: Progress | None = None) -> RecordingState:
    """Estimate the errors of a recording beside the declared valve with refitted dampings.

    Args:
        trace: the recording. valve: as declared. progress: told what is being done, and the fraction done.

    Raises:
        SimulationError: the declared valve cannot be simulated.
        TraceError: the recording has columns that cannot be used, say with NaN in them.
    """
    say = progress or (lambda what, fraction: None)
    found = identify([trace], valve, progress=lambda what, fraction: say(what, 0.5 * fraction))
    best = found.fit
    if best.problem.is_long or not found.recording:
        return RecordingState(found, {}, {}, {})
    say("limits", 0.5)
    limits = _limits(best)
    groups = () if best.problem.errors is None else best.problem.errors.groups
    with_size = {group.error.name for group in groups}
    likely = {own.error for own in found.recording[trace.source] if own.is_likely and own.error in with_size}
    hidden = {}
    for done, name in enumerate(sorted(likely)):
        say("limits", 0.6 + 0.3 * done / len(likely))
        worst = _most_hidden(best, limits, _limits(_without(best, {name})))
        if worst is not None:
            hidden[name] = worst
    say("limits", 0.9)
    without_errors = _limits(_without(best, with_size))
    say("done", 1.0)
    return RecordingState(found, limits, without_errors, hidden)


def _limits(result: Fit) -> Limits:
    return detection_limits(result, rivals_of(result.problem.plant))


def _without(result: Fit, gone: Collection[str]) -> Fit:
    """A fit, at the same values, to a recording without the errors of these names."""
    errors = result.problem.errors
    if errors is None:
        return result
    sizes = [
        SMALLEST * group.scale if group.error.name in gone else size
        for group, size in zip(errors.groups, errors.sizes.tolist(), strict=True)
    ]
    problem = result.problem.with_errors(errors.resized(np.array(sizes)))
    nuisances = (
        *(own for own in result.nuisances if not own.group), *(own for own in problem.nuisances if own.group)
    )  # fmt: skip
    return fit(problem, result.free, result.values, nuisances=nuisances, effort=HERE)


def _most_hidden(result: Fit, limits: Limits, without: Limits) -> Hidden | None:
    """The effect whose limit is the most times larger than without an error."""
    effects, worst, most = result.problem.plant.effects, None, WORTH_SAYING
    for name, effect in effects.items():
        for switch in effect.parameters:
            limit, better = (own.get(name, {}).get(switch.name, math.inf) for own in (limits, without))
            # Of what does nothing at infinity, a larger value is a smaller effect.
            if effect.is_declared or math.isinf(better) or switch.off is None or math.isinf(switch.off):
                continue
            if limit / better > most:
                worst, most = Hidden(name, switch.name, switch.unit, limit, better), limit / better
    return worst
