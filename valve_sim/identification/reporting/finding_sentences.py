"""Findings on a fit in sentences: what the data do not determine, and what else is off."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Final

from valve_sim.identification.fit.findings import (
    Correlated,
    ExplainedByErrors,
    Finding,
    LacksSomething,
    LooselyDetermined,
    NotConverged,
    NotIdentifiable,
    OnBound,
    StampErrors,
)
from valve_sim.identification.fit.static_force import (
    BeginsLate,
    EndsEarly,
    Opening,
    StartOfMotion,
    StaticFinding,
)
from valve_sim.identification.reporting.units import percent
from valve_sim.identification.reporting.values import UNBOUNDED

_SEPARATING: Final = "add strokes at other voltages, or a release."
_LACKING: Final = "so the intervals are too narrow; `diagnose` may name it."
_BY_ERRORS: Final = (
    "with these errors of the recording the model explains the data down to the noise, without them it does not. "
    "It may lack an effect instead: `diagnose` compares both."
)
_AT_THE_SEAT: Final = "measure at x = 0, where the motion starts."


def remarks(findings: Iterable[Finding | StaticFinding]) -> list[str]:
    """A sentence for each finding."""
    return [_sentence(finding) for finding in findings]


def _sentence(finding: Finding | StaticFinding) -> str:
    match finding:
        case NotIdentifiable(name, reason):
            words = f"{name} is not identifiable from these data: {UNBOUNDED[reason]}."
        case OnBound(name, bound):
            words = f"{name} is on its {bound} bound: the best value lies beyond it, or the model lacks something."
        case LooselyDetermined(name, low, high, unit):
            fits = f"{low:.3g} to {high:.3g} {unit}"
            words = f"{name} is determined only loosely by these data: anything from {fits} fits."
        case Correlated(name, other, correlation):
            words = f"{name} and {other} can hardly be separated (correlation {correlation:.4f}); {_SEPARATING}"
        case StampErrors(largest):
            size = f"{1e6 * largest:.3g} µs"
            words = f"the commands' stamps are off by up to {size} beyond the clock offset; the fit estimated each."
        case LacksSomething(probability):
            words = f"the model lacks something (probability {percent(probability)}), {_LACKING}"
        case ExplainedByErrors():
            words = _BY_ERRORS
        case NotConverged():
            words = "the fit did not converge; treat the values with care."
        case StartOfMotion():
            words = _start_of_motion(finding)
        case BeginsLate(displacement):
            words = f"the table begins at {1e6 * displacement:.0f} µm: a0 is extrapolated; {_AT_THE_SEAT}"
        case EndsEarly(displacement, stroke):
            part = f"{1e6 * displacement:.0f} µm of {1e6 * stroke:.0f} µm stroke"
            words = f"the table ends at {part}: beyond it the polynomial is an extrapolation."
    return words


def _start_of_motion(finding: StartOfMotion) -> str:
    """What the constant term, or its lack, means for the start of motion."""
    constant, opening = finding.constant, _opening(finding.opening)
    if constant is None or finding.without is None:
        return (
            f"without a constant term the attraction at x = 0 is 0 N: {opening}. Fit with the constant term; a "
            "magnetised coil pulls at the largest gap too."
        )
    without = _opening(finding.without)
    if constant.low <= 0.0 <= constant.high:
        return (
            f"a0 = {constant.value:.3g} N cannot be told from 0 (95 %: {constant.low:.3g} to {constant.high:.3g} N) "
            f"and a0 alone starts the motion: with it {opening}, without it {without}. Measure more points near x = 0."
        )
    return f"a0 = {constant.value:.4g} N starts the motion: with it {opening}, without it {without}."


def _opening(opening: Opening) -> str:
    volts, meets_main, reaches_stop, has_one_plunger = opening
    plunger = "plunger" if has_one_plunger else "pilot plunger"
    if math.isnan(meets_main):
        return f"the valve never opens at {volts:g} V (nothing lifts the {plunger} off its seat)"
    reached = (
        "never reaches the stop" if math.isnan(reaches_stop) else f"reaches the stop at {1e3 * reaches_stop:.2f} ms"
    )
    first = "leaves its seat" if has_one_plunger else "meets the main plunger"
    return f"the {plunger} {first} at {1e3 * meets_main:.2f} ms and {reached} at {volts:g} V"
