"""What a monitor finds, in words: the fault of a stroke, why it was not compared, and what has changed in the valve."""

from __future__ import annotations

from datetime import datetime, timezone
from typing import Final

from valve_sim.identification.fit.intervals import Interval
from valve_sim.identification.monitoring.fault_isolation import FaultFinding
from valve_sim.identification.monitoring.findings import (
    DidNotClose,
    DidNotOpen,
    Fault,
    NotSimulated,
    Occasion,
    OpenedPartly,
    Remark,
    StrokeState,
    TimingTooUncertain,
    Unusable,
    WaitsForPressure,
)
from valve_sim.identification.monitoring.stroke_monitor import StrokeReport
from valve_sim.identification.plants.effect_titles import WRONG, named, title_of
from valve_sim.identification.plants.valve import DAMPINGS
from valve_sim.identification.reporting.units import measured, quantity
from valve_sim.identification.reporting.wording import percent
from valve_sim.model import CATALOGUE, DECLARED
from valve_sim.model.gas import GAS

TIMING_UNCERTAIN: Final = "timing too uncertain to judge"
_STATES: Final = {
    StrokeState.COMMISSIONING: "commissioning",
    StrokeState.WATCHING: "watching",
    StrokeState.TIMING_UNCERTAIN: TIMING_UNCERTAIN,
    StrokeState.NOT_JUDGED: "not judged",
}
_UNUSABLE: Final = {
    Unusable.TIMED_OUT: "it did not end before stroke_timeout",
    Unusable.TOO_LONG: "it is too long to be kept",
    Unusable.NOT_AT_REST: "it did not begin at rest",
    Unusable.PRESSURE_UNKNOWN: "it began before the pressures at the valve were heard",
    Unusable.TOO_FEW_SAMPLES: "it has too few samples",
    Unusable.OTHER_SENSOR: "positions, or their absence, are not as when the valve was commissioned: recommission it",
    Unusable.HELD_TOO_BRIEFLY: f"{TIMING_UNCERTAIN}: it was held open for less than half as long as commanded",
}
LOPSIDED: Final = 3.0
"""Standard errors from a value to an end of its 95 % interval, beyond which they do not describe it."""


def occasion_words(occasion: Occasion) -> str:
    """The valve, the stroke and its time, such as "/tank_1/valve, stroke 31 at 2026-11-24T14:31:07.123Z"."""
    seconds, nanoseconds = divmod(occasion.stamp, 1_000_000_000)
    time = datetime.fromtimestamp(seconds, timezone.utc).strftime("%Y-%m-%dT%H:%M:%S")
    return f"{occasion.valve}, stroke {occasion.stroke} at {time}.{nanoseconds // 1_000_000:03d}Z"


def told_finding(finding: FaultFinding, occasion: Occasion) -> str:
    """A finding as it is said on every channel: of which valve, when, what has changed, and with which probability."""
    return f"{occasion_words(occasion)}: {finding_words(finding)}; probability {percent(finding.verdict.probability)}"


def stroke_name(report: StrokeReport) -> str:
    """Its number and its largest voltage."""
    return f"stroke {report.record.number}, {report.volts:.1f} V"


def state_words(state: StrokeState) -> str:
    """The state of a monitor in the words of the report on a stroke."""
    return _STATES[state]


def fault_words(fault: Fault) -> str:
    """The motion that the valve failed to make, in words."""
    match fault:
        case DidNotOpen(travel):
            words = f"the valve did not open: the pilot plunger moved {_mm(travel)} only"
        case OpenedPartly(travel, stroke):
            words = f"the valve opened to {_mm(travel)} only, of {_mm(stroke)}"
        case WaitsForPressure(travel):
            words = (
                f"the pilot is open, at {_mm(travel)}; the main plunger waits for the pressure to equalise, longer "
                "than it should"
            )
        case DidNotClose(position):
            words = f"the valve did not close: {_mm(position)} open, without voltage"
    return words


def remark_words(remark: Remark) -> str:
    """Why a stroke was not compared with the baseline."""
    match remark:
        case Unusable():
            words = _UNUSABLE[remark]
        case TimingTooUncertain(held):
            words = f"{TIMING_UNCERTAIN}: held open for {1e3 * held:.0f} ms only"
        case NotSimulated(reason):
            words = f"it could not be compared with the model: {reason}"
        case _:
            words = fault_words(remark)
    return words


def finding_words(finding: FaultFinding) -> str:
    """What has changed in the valve, such as "Coulomb friction 0.310 ± 0.020 N, none when commissioned"."""
    verdict = finding.verdict
    if verdict.kind == "none":
        return "the last strokes do not differ from those at commissioning"
    if verdict.kind == "unknown":
        nearest = f"; the nearest is {named(verdict.effects)}" if verdict.effects else ""
        return f"something has changed that no effect of the catalogue explains{nearest}"
    changes = "; ".join(_change(effect, finding) for effect in verdict.effects) or "no change at all"
    others = named(sorted({other for names in verdict.confusable_with.values() for other in names}), "or")
    alternatives = f" ({others} would explain it about as well)" if others else ""
    uncertain = (
        "the strokes cannot tell what has changed; the most probable: " if verdict.kind == "insufficient" else ""
    )
    return f"{uncertain}{changes}{alternatives}"


def shared_delay_words(seconds: float) -> str:
    """A delay that all of the last strokes share."""
    size = quantity(abs(seconds), "s", 2)
    return (
        f"commands are obeyed {size} {'later' if seconds > 0.0 else 'sooner'} than when commissioned: a clock, a load, "
        "or the valve; hear ~/coil to tell"
    )


def _change(effect: str, finding: FaultFinding) -> str:
    """An effect, a damping or another declared value with its values, and what these were before."""
    if effect.startswith(WRONG):
        return _changed_value(effect, finding)
    own = {name: found for name, found in finding.parameters.items() if name.startswith(f"{effect}.")}
    if effect in DAMPINGS:
        (damping,) = own
        return f"{title_of(effect)} {_value(damping, DECLARED[effect].unit, finding)}"
    if remaining := CATALOGUE[effect].remaining:
        ((name, share),) = own.items()
        before = finding.declared.get(name, finding.commissioned.get(name))
        of_what = "of when commissioned" if before is None else f"of its full size, {_was(name, '', finding)}"
        return f"{remaining} at {_percent(share)} {of_what}"
    rules = [CATALOGUE[effect].parameter(name.partition(".")[2]) for name in own]
    values = [_value(name, rule.unit, finding) for name, rule in zip(own, rules, strict=True)]
    if len(values) == 1:
        return f"{title_of(effect)} {values[0]}"
    if all(_is_new(name, finding) for name in own):
        values = [measured(found, rule.unit) for found, rule in zip(own.values(), rules, strict=True)]
        values[-1] += ", none when commissioned"
    listed = ", ".join(f"{rule.description} {value}" for rule, value in zip(rules, values, strict=True))
    return f"{title_of(effect)}: {listed}"


def _changed_value(effect: str, finding: FaultFinding) -> str:
    """A declared value that is another now; what is estimated by other coordinates has no one number."""
    if effect not in finding.parameters:
        return title_of(effect)
    group, _, name = effect.partition(".")
    return f"{title_of(name)} {_value(effect, (GAS if group == 'gas' else DECLARED)[name].unit, finding)}"


def _value(name: str, unit: str, finding: FaultFinding) -> str:
    """An estimate, and what it was before."""
    return f"{measured(finding.parameters[name], unit)}, {_was(name, unit, finding)}"


def _was(name: str, unit: str, finding: FaultFinding) -> str:
    """What a value was when the valve was commissioned, or declared to be where commissioning did not estimate it."""
    if name in finding.commissioned:
        return f"{quantity(finding.commissioned[name], unit)} when commissioned"
    return "none when commissioned" if _is_new(name, finding) else f"declared {quantity(finding.declared[name], unit)}"


def _is_new(name: str, finding: FaultFinding) -> bool:
    return name not in finding.commissioned and name not in finding.declared


def _percent(share: Interval) -> str:
    """60.0 ± 3.1 %, of a share with its standard error; or 31 % (25 to 61 %), where that says too little.

    Strokes of a valve that never opens say that its pilot orifice is small enough for that, and little more.
    """
    value, error, low, high = (100.0 * bound for bound in (share.value, share.stderr, share.low, share.high))
    if max(high - value, value - low) > LOPSIDED * error:
        return f"{value:.0f} % ({max(low, 0.0):.0f} to {min(high, 100.0):.0f} %)"
    return measured(Interval(value, error, low, high), "%")


def _mm(metres: float) -> str:
    return f"{1e3 * metres:.3f} mm"
