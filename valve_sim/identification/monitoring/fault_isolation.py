"""Fault isolation: after an alarm, the last strokes are diagnosed against the baseline to name what has changed.

A diagnosis of a recording must free the dampings, which nobody knows; beside a valve that was commissioned they are
known. So here they are candidates like any effect, "the main damping has changed" beside "Coulomb friction has
appeared", and a refit does not absorb what separates the two. Their errors of commissioning and the errors of the
commands' stamps are nuisance parameters whose priors commissioning has given.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.diagnosis.run import Diagnosis, diagnose_plant
from valve_sim.identification.estimation.identify import DEFAULT_FREE
from valve_sim.identification.estimation.intervals import Interval
from valve_sim.identification.monitoring.scores import Baseline
from valve_sim.identification.plants.commissioned import CommissionedCurrent, CommissionedPlant
from valve_sim.identification.plants.protocol import Array, Plant
from valve_sim.model import CATALOGUE, DECLARED, Drive, Parameter
from valve_sim.traces import Signal, Trace

FEWEST: Final = 6
"""Strokes needed to isolate a fault: four to fit, two held out."""
HELD_OUT: Final = 3
"""Every third stroke is held out."""

MOST_PRIOR_SCALES: Final = 100.0
"""Multiple of an effect's prior scale beyond which a value is not plausible: 5 N of friction, 30 N of pressure."""
NOT_ISOLATED: Final = (
    "the strokes are not those of the commissioned valve, and no effect is known well enough to be named"
)


Progress = Callable[[str, float], None]


class FaultFinding(NamedTuple):
    """What fault isolation found.

    Attributes:
        kind: of verdict, as in report.json: "none", "effects", "unknown" or "insufficient".
        effects: names from the catalogue. summary: one sentence for a person.
        confusable_with: by effect, look-alikes that explain the strokes about as well.
        parameters: by `<effect>.<parameter>`, estimates. probability: of the verdict. strokes: how many were used.
    """

    kind: str
    effects: tuple[str, ...]
    summary: str
    confusable_with: dict[str, tuple[str, ...]]
    parameters: dict[str, Interval]
    probability: float
    strokes: int


def isolate_fault(strokes: Sequence[Trace], baseline: Baseline, progress: Progress | None = None) -> FaultFinding:
    """Find what has changed in a valve since it was commissioned.

    Args:
        strokes: one each, at least `FEWEST`; every `HELD_OUT`-th is held out.
        healthy: the valve as commissioned.
        progress: told what is being tried, and the fraction done.

    Raises:
        SimulationError: the commissioned valve cannot be simulated.
    """
    training = [stroke for index, stroke in enumerate(strokes) if index % HELD_OUT != HELD_OUT - 1]
    held_out = [stroke for index, stroke in enumerate(strokes) if index % HELD_OUT == HELD_OUT - 1]
    plants = [
        CommissionedPlant(join(part, baseline), baseline.commissioned, baseline.scatter)
        for part in (training, held_out)
    ]
    result = diagnose_plant(plants[0], plants[1], progress)
    verdict, intervals = result.verdict, result.after.intervals
    parameters = {name: interval for name, interval in intervals.items() if name.split(".")[0] in verdict.effects}
    if not all(is_credible(effect, plants[0], parameters) for effect in verdict.effects):
        return FaultFinding("unknown", (), NOT_ISOLATED, {}, {}, 0.0, len(strokes))
    return FaultFinding(
        verdict.kind,
        verdict.effects,
        _summary(result, parameters, baseline),
        dict(verdict.confusable_with),
        parameters,
        verdict.probability,
        len(strokes),
    )


def is_credible(effect: str, plant: Plant, intervals: Mapping[str, Interval]) -> bool:
    """Whether an effect may be named: at least one parameter differs from neutral, and all values are plausible.

    Args:
        effect: its name. plant: whose effect it is.
        intervals: by `<effect>.<parameter>`, 95 %.
    """
    switches = [switch for switch in plant.effects[effect].parameters if switch.off is not None]
    known = [
        (switch, intervals[f"{effect}.{switch.name}"]) for switch in switches if f"{effect}.{switch.name}" in intervals
    ]
    return all(_is_plausible(switch, interval) for switch, interval in known) and any(
        not _holds(interval, switch.off) for switch, interval in known if switch.off is not None
    )


def _holds(interval: Interval, neutral: float) -> bool:
    return not interval.low > neutral and not interval.high < neutral


def _is_plausible(parameter: Parameter, interval: Interval) -> bool:
    """Whether a value and its whole interval lie within `MOST_PRIOR_SCALES` of the neutral value."""
    if parameter.off is None or not math.isfinite(parameter.off):
        return True
    most = MOST_PRIOR_SCALES * parameter.prior_scale
    return max(abs(bound - parameter.off) for bound in (interval.value, interval.low, interval.high)) <= most


def join(strokes: Sequence[Trace], baseline: Baseline) -> Trace:
    """Strokes as one trace, with the rests between them as they were; motion and current put back in time."""
    lateness = baseline.lateness
    epoch = strokes[0].epoch_ns
    starts = [(stroke.epoch_ns - epoch) / 1e9 for stroke in strokes]
    times = np.concatenate([stroke.times + start - lateness for stroke, start in zip(strokes, starts, strict=True)])
    # Rest before a stroke may have been kept with the stroke before it, too.
    is_later = _rises(times)
    commands = [stroke.drive.times + start for stroke, start in zip(strokes, starts, strict=True)]
    return Trace(
        f"{strokes[0].source} to {strokes[-1].source}",
        Drive(np.concatenate(commands), np.concatenate([stroke.drive.volts for stroke in strokes])),
        times[is_later],
        np.concatenate([stroke.pilot_position for stroke in strokes])[is_later],
        coil_current=_join_currents(strokes, starts, baseline.current),
        epoch_ns=epoch,
    )


def _join_currents(
    strokes: Sequence[Trace], starts: Sequence[float], commissioned: CommissionedCurrent | None
) -> Signal | None:
    """None where the current was not commissioned, or a stroke has none."""
    if commissioned is None:
        return None
    known = [commissioned.as_modelled(stroke.coil_current) for stroke in strokes if stroke.coil_current is not None]
    if len(known) < len(strokes):
        return None
    times = np.concatenate([current.times + start for current, start in zip(known, starts, strict=True)])
    is_later = _rises(times)
    return Signal(times[is_later], np.concatenate([current.values for current in known])[is_later])


def _rises(times: Array) -> NDArray[np.bool_]:
    """Which times are later than all before them."""
    return np.asarray(times > np.concatenate([[-math.inf], np.maximum.accumulate(times)[:-1]]))


def _summary(result: Diagnosis, parameters: Mapping[str, Interval], baseline: Baseline) -> str:
    verdict = result.verdict
    if verdict.kind == "none":
        return "the last strokes are as those of the commissioned valve"
    if not verdict.effects:
        return verdict.summary
    words = "; ".join(_effect_words(name, parameters, baseline) for name in verdict.effects)
    others = sorted({other for names in verdict.confusable_with.values() for other in names})
    alternatives = f" ({', '.join(_plain(other) for other in others)} would explain it about as well)" if others else ""
    certainty = "" if verdict.kind == "effects" else f"{verdict.summary.rstrip('.')}: "
    return f"{certainty}{words}{alternatives}"


def _effect_words(effect: str, parameters: Mapping[str, Interval], baseline: Baseline) -> str:
    """Such as "Coulomb friction 0.31 ± 0.04 N, none when commissioned"."""
    own = {name.split(".")[1]: interval for name, interval in parameters.items() if name.split(".")[0] == effect}
    if effect in DEFAULT_FREE:
        before = f"{baseline.valve.declared()[effect]:.3g} when commissioned"
        values = [_value(interval, DECLARED[effect].unit) for interval in own.values()]
    else:
        before = "none when commissioned"
        entry = CATALOGUE[effect]
        values = [
            f"{'' if len(own) == 1 else _plain(name) + ' '}{_value(interval, entry.parameter(name).unit)}"
            for name, interval in own.items()
        ]
    plain = _plain(effect)
    return f"{plain[0].upper()}{plain[1:]} {', '.join(values)}, {before}"


def _value(interval: Interval, unit: str) -> str:
    """Value and half width of the 95 % interval, rounded to where the half width has two digits."""
    half = 0.5 * (interval.high - interval.low)
    plain_unit = "" if unit in ("", "–") else f" {unit}"
    if not math.isfinite(half) or half <= 0.0:
        return f"{interval.value:.3g}{plain_unit}"
    digits = 1 - math.floor(math.log10(half))
    if -3 <= digits <= 6:
        places = max(digits, 0)
        return f"{interval.value:.{places}f} ± {half:.{places}f}{plain_unit}"
    return f"{interval.value:.3g} ± {half:.2g}{plain_unit}"


def _plain(name: str) -> str:
    return name.replace("_", " ").replace("coulomb", "Coulomb")
