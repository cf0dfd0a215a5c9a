"""Fault isolation: after an alarm, the last strokes are diagnosed against the baseline to name what has changed.

A diagnosis of a recording must free the dampings, which nobody knows; beside a valve that was commissioned they are
known. So here they are candidates like any effect, "the main damping has changed" beside "Coulomb friction has
appeared", and a refit does not absorb what separates the two. Their errors of commissioning and the errors of the
commands' stamps are nuisance parameters whose priors commissioning has given.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from valve_sim.identification.diagnosis.run import Verdict, begin
from valve_sim.identification.fit.errors.hum import HUM
from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.fit.problem import shows_rest
from valve_sim.identification.monitoring.kept_samples import joined, with_joined_ends
from valve_sim.identification.monitoring.lift_times import starts_by_lift
from valve_sim.identification.monitoring.scores import FINEST, Baseline
from valve_sim.identification.plants.commissioned import in_service
from valve_sim.identification.plants.effect_titles import WRONG
from valve_sim.identification.plants.protocol import Plant
from valve_sim.identification.plants.recording_errors import VARIATION
from valve_sim.identification.plants.tolerances import hypothesis_of
from valve_sim.identification.plants.valve_model import DAMPINGS
from valve_sim.model import Drive
from valve_sim.recordings import Signal, Trace

FEWEST: Final = 6
"""Strokes needed to isolate a fault without gas: four to fit, two held out."""
HELD_OUT: Final = 3
"""Every third stroke is held out."""

Progress = Callable[[str, float], None]


@dataclass(frozen=True)
class FaultFinding:
    """What fault isolation found.

    Attributes:
        verdict: of the diagnosis; its effects may be dampings, which are candidates here.
        parameters: estimates of what it names, of an effect by `<effect>.<parameter>`, of a declared value by
            `valve.<name>`; none of "unknown", whose nearest names are not claimed.
        commissioned: of these, by the same names, the values before where commissioning has estimated them.
        declared: likewise, where a file has declared them; of an effect that was not there neither has a value.
        strokes: how many were used.
    """

    verdict: Verdict
    parameters: Mapping[str, Interval]
    commissioned: Mapping[str, float]
    declared: Mapping[str, float]
    strokes: int


def isolate_fault(strokes: Sequence[Trace], baseline: Baseline, progress: Progress | None = None) -> FaultFinding:
    """Find what has changed in a valve since it was commissioned.

    Args:
        strokes: one each, at least `FEWEST`, or four with gas; every `HELD_OUT`-th is held out, with gas every fourth.
        baseline: the valve as commissioned.
        progress: told what is being tried, and the fraction done.

    Raises:
        SimulationError: the commissioned valve cannot be simulated.
    """
    plants = _plants(strokes, baseline)
    # A simulated valve shows rounding alone, and less than was declared: no model is white beside that. Where the rests
    # are too short to show any noise, what a fit leaves of a fault would pass for it.
    kind = "position" if baseline.has_positions else "current"
    least = {**FINEST, kind: baseline.noise.sigma}
    holdout = plants[1] if len(plants) > 1 else None
    held = _known_sizes(plants[0], baseline)
    session = begin(plants[0], holdout, progress, least=least, known={kind: baseline.noise}, held=held)
    verdict, intervals = session.name()
    named = () if verdict.kind == "unknown" else verdict.effects
    parameters = estimates(named, plants[0], intervals)
    there = [name for name in parameters if _was_there(name, baseline)]
    before = {name: plants[0].declared(name.removeprefix("valve.")) for name in there}
    known = {name for name in before if _estimated_name(name) in baseline.estimated}
    return FaultFinding(
        verdict, parameters, {name: before[name] for name in before if name in known},
        {name: before[name] for name in before if name not in known}, len(strokes),
    )  # fmt: skip


def _known_sizes(plant: Plant, baseline: Baseline) -> Mapping[str, float]:
    """Sizes of errors that are those of commissioning: a fault would be taken for more of them.

    That is how much strokes vary. Drift is read again while the valve rests, if it does so for long enough. Hum is
    learned again: over several strokes its phase is one, and it tells more than in each by itself.
    """
    if not shows_rest(plant):
        return {name: size for name, size in baseline.error_sizes.items() if name != HUM.name}
    return {name: size for name, size in baseline.error_sizes.items() if name.startswith(VARIATION)}


def _was_there(name: str, baseline: Baseline) -> bool:
    """Whether the valve had a value of this name before, and not merely lacked an effect."""
    effect = name.partition(".")[0]
    return name.startswith(WRONG) or effect in DAMPINGS or effect in baseline.valve.effects


def _estimated_name(name: str) -> str:
    """The name under which commissioning keeps a value that a finding names."""
    first = name.partition(".")[0]
    return first if first in DAMPINGS else name.removeprefix("valve.")


def _plants(strokes: Sequence[Trace], baseline: Baseline) -> list[Plant]:
    """The valve behind the strokes that are fitted, and behind those that are held out.

    With gas the valve behind all of them: a stroke begins with the pressure that those before it have left behind the
    valve, so that none may be missing; the diagnosis holds samples of some out.
    """
    parts: list[Sequence[Trace]] = [strokes]
    if baseline.valve.gas is None:
        training = [stroke for index, stroke in enumerate(strokes) if index % HELD_OUT != HELD_OUT - 1]
        parts = [training, [stroke for index, stroke in enumerate(strokes) if index % HELD_OUT == HELD_OUT - 1]]
    traces = [join(part, baseline) for part in parts]
    starts = starts_by_lift(traces[0], baseline.valve)
    return [in_service(trace, baseline.commissioned, baseline.scatter, starts) for trace in traces]


def estimates(effects: Sequence[str], plant: Plant, intervals: Mapping[str, Interval]) -> dict[str, Interval]:
    """What was estimated of named effects, and of declared values that are named.

    Returns:
        Intervals by `<effect>.<parameter>`, or by `valve.<name>`.
    """
    choices = [plant.effects[effect] for effect in effects]
    return {
        hypothesis_of(name) if choice.is_declared_value else name: intervals[name]
        for choice in choices
        for name in choice.free_names()
        if name in intervals
    }


def join(strokes: Sequence[Trace], baseline: Baseline) -> Trace:
    """Strokes as one trace, with the rests between them as they were; motion and current put back in time."""
    epoch = strokes[0].epoch_ns
    starts = [(stroke.epoch_ns - epoch) / 1e9 for stroke in strokes]
    commands = np.concatenate([stroke.drive.times + start for stroke, start in zip(strokes, starts, strict=True)])
    drive = Drive(commands, np.concatenate([stroke.drive.volts for stroke in strokes]))
    source = f"{strokes[0].source} to {strokes[-1].source}"
    back = [start - baseline.lateness for start in starts]
    if not baseline.has_positions:
        current = joined([stroke.coil_current for stroke in strokes], back)
        voltage = joined([stroke.coil_voltage for stroke in strokes], back)
        nothing = np.empty(0)
        alone = Trace(
            source, drive, nothing, nothing, coil_current=current, coil_voltage=voltage, epoch_ns=epoch,
            outlet_start=strokes[0].outlet_start,
        )  # fmt: skip
        return with_joined_ends(alone, strokes, starts)
    position = joined([Signal(stroke.times, stroke.pilot_position) for stroke in strokes], back)
    assert position is not None
    commissioned = baseline.current
    currents = [
        commissioned and stroke.coil_current and commissioned.as_modelled(stroke.coil_current) for stroke in strokes
    ]
    whole = Trace(
        source, drive, *position, coil_current=joined(currents, starts), epoch_ns=epoch,
        outlet_start=strokes[0].outlet_start,
    )  # fmt: skip
    return with_joined_ends(whole, strokes, starts)
