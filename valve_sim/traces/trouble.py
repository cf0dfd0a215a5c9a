"""What makes a sound trace hard to use: gaps, no command, no motion, numbers of another unit."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from valve_sim.traces.clocks import find_gaps
from valve_sim.traces.errors import TraceError
from valve_sim.traces.strokes import largest_travel, motion_threshold

if TYPE_CHECKING:
    from collections.abc import Mapping

    from valve_sim.model import ValveParameters
    from valve_sim.traces.trace import Trace

PILOT = "pilot_plunger"
LARGEST_POSITION = 0.1
"""m; a solenoid valve's plunger moves millimetres: beyond this the unit is most likely not metres."""
MOST_STROKES = 10.0
"""No position lies so many strokes from the closed one, or it is no metre."""
MOST_VOLTS = 30.0
"""No voltage is so many reference voltages: a peak-and-hold driver reaches seven."""
MOST_AMPERES = 30.0
"""No current is so many times what the voltage and the declared resistance allow: that may be off by a few."""
LEAST_AMPERES = 0.01
"""Of a valve that moved, no current is below this share of it."""


class Doubt(NamedTuple):
    """A number that the declared valve cannot have: what is wrong, and the mend in a map."""

    quantity: str
    words: str


def trouble_in(trace: Trace, positions: str, voltage: str) -> list[str]:
    """Return one sentence for each trouble; `positions` and `voltage` are the names of where they are recorded."""
    findings = []
    gaps = find_gaps(trace.times)
    if len(gaps):
        longest = float(np.diff(trace.times).max())
        findings.append(f"{positions}: {len(gaps)} gaps in the samples, the longest {longest:.6f} s")
    if not trace.drive.volts.any():
        findings.append(f"{voltage} never leaves 0 V")
    reach = float(np.abs(trace.pilot_position).max())
    if reach > LARGEST_POSITION:
        findings.append(f"{positions}: {PILOT} reaches {reach:.6g} m: positions must be in metres")
    travel = largest_travel(trace.pilot_position)
    if travel <= motion_threshold(trace.pilot_position):
        findings.append(f"{positions}: no motion: {PILOT} stays within {travel * 1e6:.3g} µm")
    elif trace.drive.times[0] > trace.times[-1] or trace.drive.times[-1] < 2 * trace.times[0] - trace.times[-1]:
        findings.append(f"{voltage}: no command falls into the time of the samples")
    return findings


def doubtful_units(trace: Trace, parameters: ValveParameters) -> tuple[Doubt, ...]:
    """What in a trace is off by such a factor that it is in another unit, or is not what it is said to be."""
    checks = (_position, _voltage, _current)
    return tuple(doubt for check in checks if (doubt := check(trace, parameters)) is not None)


def refuse_doubtful_units(trace: Trace, parameters: ValveParameters, names: Mapping[str, str] | None = None) -> None:
    """Stop before anything is fitted to numbers of another unit.

    Args:
        trace: What was read.
        parameters: The declared valve.
        names: Quantity to where it is recorded, for the message.

    Raises:
        TraceError: One line with the quantity, what was found, what is expected, and the mend.
    """
    doubts = doubtful_units(trace, parameters)
    if doubts:
        where = (names or {}).get(doubts[0].quantity, doubts[0].quantity)
        raise TraceError(f"{trace.source}: {where}: {doubts[0].words}")


def _position(trace: Trace, parameters: ValveParameters) -> Doubt | None:
    stroke, travel = parameters.stroke, largest_travel(trace.pilot_position)
    if travel > MOST_STROKES * stroke:
        unit = _unit_of(travel / stroke, {"mm": 1e3, "um": 1e6, "nm": 1e9})
        return Doubt(
            "position",
            f"{PILOT} travels {travel:.4g} m, expected about {stroke:.4g} m (valve.stroke) and at most "
            f"{MOST_STROKES * stroke:.4g} m; publish metres, or read it with --map and unit: {unit}",
        )
    usual = float(np.median(trace.pilot_position))
    if abs(usual) > MOST_STROKES * stroke:
        rest = float(np.median(trace.pilot_position[: max(1, len(trace.pilot_position) // 100)]))
        return Doubt(
            "position",
            f"{PILOT} lies at {usual:.4g} m, expected 0 where the valve is closed and {stroke:.4g} m where it is open; "
            f"take the zero out with --map and an offset: (here {-rest:.6g} m)",
        )
    return None


def _voltage(trace: Trace, parameters: ValveParameters) -> Doubt | None:
    reference, highest = parameters.reference_voltage, float(np.abs(trace.drive.volts).max(initial=0.0))
    expected = f"expected about {reference:g} V (valve.reference_voltage)"
    if highest > MOST_VOLTS * reference:
        return Doubt(
            "voltage",
            f"reaches {highest:.4g} V, {expected} and at most {MOST_VOLTS * reference:g} V; "
            "publish volts, or read it with --map and unit: mV",
        )
    if 0.0 < highest < reference / MOST_VOLTS and _has_moved(trace):
        return Doubt(
            "voltage",
            f"reaches {highest:.4g} V only, though the valve moved; {expected}; give unit: or scale: (of a divider) "
            "with --map",
        )
    return None


def _current(trace: Trace, parameters: ValveParameters) -> Doubt | None:
    signal = trace.coil_current
    if signal is None or not len(signal.values) or not trace.drive.volts.any():
        return None
    highest = float(np.quantile(np.abs(signal.values), 0.999))
    expected = float(np.abs(trace.drive.volts).max()) / parameters.coil_resistance
    words = f"expected about {expected:.3g} A (voltage by valve.coil_resistance {parameters.coil_resistance:g} Ω)"
    if highest > MOST_AMPERES * expected:
        return Doubt(
            "current", f"reaches {highest:.4g} A, {words}; publish amperes, or read it with --map and unit: mA"
        )
    if highest < LEAST_AMPERES * expected and _has_moved(trace):
        return Doubt(
            "current",
            f"reaches {highest:.3g} A only, {words}; correct its unit: or scale: with --map, or leave the current out",
        )
    return None


def _has_moved(trace: Trace) -> bool:
    return largest_travel(trace.pilot_position) > motion_threshold(trace.pilot_position)


def _unit_of(ratio: float, factors: Mapping[str, float]) -> str:
    """The unit whose numbers are so many times too large, most nearly."""
    return min(factors, key=lambda unit: abs(np.log(ratio / factors[unit])))
