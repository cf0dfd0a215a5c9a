"""What a monitor tells, in words and as JSON: of each stroke, and after an alarm of what has changed in the valve."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime, timezone
from typing import Any, Final

from valve_sim.files.json_text import plain_mapping
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
from valve_sim.identification.plants.valve_model import DAMPINGS
from valve_sim.identification.reporting.units import measured, percent, quantity
from valve_sim.identification.reporting.values import intervals_json
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
    Unusable.SAMPLES_MISSING: "samples are missing while it moved",
    Unusable.COMMANDS_UNSEEN: "the coil's voltage does not show its commands, as it does those of other strokes",
    Unusable.UNCOMMANDED: "it moved otherwise than by the commands that came in: some were lost, or are late",
    Unusable.HEARD_LATE: "its samples came in so late that its commands may have, too: this machine is too busy",
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
    """A finding in the words of every channel: valve, time, change and probability."""
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


def not_judged_words(report: StrokeReport) -> str:
    """That a stroke was not compared with the baseline, and why."""
    words = "" if report.remark is None else remark_words(report.remark)
    return f"stroke {report.record.number} is not judged: {words}"


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
    values = {name: value for name, value in finding.parameters.items() if name.startswith(f"{effect}.")}
    if effect in DAMPINGS:
        (damping,) = values
        return f"{title_of(effect)} {_value(damping, DECLARED[effect].unit, finding)}"
    if remaining := CATALOGUE[effect].remaining:
        ((name, share),) = values.items()
        before = finding.declared.get(name, finding.commissioned.get(name))
        of_what = "of when commissioned" if before is None else f"of its full size, {_was(name, '', finding)}"
        return f"{remaining} at {_percent(share)} {of_what}"
    rules = [CATALOGUE[effect].parameter(name.partition(".")[2]) for name in values]
    told = [_value(name, rule.unit, finding) for name, rule in zip(values, rules, strict=True)]
    if len(told) == 1:
        return f"{title_of(effect)} {told[0]}"
    if all(_is_new(name, finding) for name in values):
        told = [measured(value, rule.unit) for value, rule in zip(values.values(), rules, strict=True)]
        told[-1] += ", none when commissioned"
    listed = ", ".join(f"{rule.description} {words}" for rule, words in zip(rules, told, strict=True))
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


# --- as JSON --------------------------------------------------------------------------------------------------------


def stroke_json(report: StrokeReport, valve: str) -> dict[str, Any]:
    """Plain numbers in SI units; null for what is not known."""
    plain = {
        "schema": "valve_sim/stroke/1",
        "valve": valve,
        "stroke": report.record.number,
        "name": stroke_name(report),
        "time": report.record.stamp / 1e9,
        "state": state_words(report.state),
        "remark": None if report.remark is None else remark_words(report.remark),
        "opened": report.record.opened,
        "closed": report.record.closed,
        "fault": None if report.record.fault is None else fault_words(report.record.fault),
        "opening_delay": report.opening_delay,
        "t1": report.t1,
        "t2": report.t2,
        "closing_time": report.closing_time,
        **dict(zip(("t1_stderr", "t2_stderr", "closing_time_stderr"), report.errors, strict=True)),
        **_errors(report),
        "command_scatter": report.command_scatter,
        "damping": intervals_json(report.damping),
        "scores": report.scores,
        "alarm": {
            "raised": report.alarm is not None,
            "cause": (report.alarm.cause if report.alarm else report.cause) or None,
            "sum": report.sum,
            "threshold": report.threshold,
        },
    }
    return plain_mapping(plain)


def keys_and_values(report: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    """A report as texts: nested names are joined by dots, such as "alarm.sum"; what is not known is left out."""
    for name, value in report.items():
        if isinstance(value, Mapping):
            yield from keys_and_values(value, f"{prefix}{name}.")
        elif value is not None:
            text = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
            yield f"{prefix}{name}", text.lower() if isinstance(value, bool) else text


def _errors(report: StrokeReport) -> dict[str, float]:
    """Residual and noise of the position, µm, or of the current alone, mA."""
    if report.has_positions:
        return {"residual_rms_um": 1e6 * report.rms, "noise_um": 1e6 * report.noise}
    return {"residual_rms_ma": 1e3 * report.rms, "noise_ma": 1e3 * report.noise}


def finding_json(finding: FaultFinding, occasion: Occasion) -> dict[str, Any]:
    """A finding as ~/finding has it; `occasion` is that of the last of the strokes that it rests on."""
    verdict = finding.verdict
    plain = {
        "schema": "valve_sim/finding/1",
        "valve": occasion.valve,
        "stroke": occasion.stroke,
        "time": occasion.stamp / 1e9,
        "kind": verdict.kind,
        "effects": list(verdict.effects),
        "summary": told_finding(finding, occasion),
        "confusable_with": {name: list(others) for name, others in verdict.confusable_with.items()},
        "parameters": intervals_json(finding.parameters),
        "was": {**finding.commissioned, **finding.declared},
        "probability": verdict.probability,
        "unnamed": verdict.unnamed,
        "strokes": finding.strokes,
    }
    return plain_mapping(plain)
