"""Problems of a readable trace: gaps, no command, no motion, numbers in another unit."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from valve_sim.files.channels import CHANNELS, SIGNALS, UNITS, nearest_unit
from valve_sim.model.core_types import Phase
from valve_sim.model.drives import Drive
from valve_sim.recordings.clocks import find_gaps
from valve_sim.recordings.left_out import FASTEST, words_of
from valve_sim.recordings.motion import SMALLEST_MOTION, largest_travel, medians_of_three, motion_threshold
from valve_sim.recordings.strokes import FULL_TRAVEL, find_stroke_parts
from valve_sim.recordings.trace import TraceError

if TYPE_CHECKING:
    from valve_sim.model import ValveParameters
    from valve_sim.recordings.trace import Trace

PILOT = "pilot_plunger"
LARGEST_POSITION = 0.1
"""m; a solenoid valve's plunger moves millimetres: beyond this the unit is most likely not metres."""
MOST_STROKES = 10.0
"""No position lies so many strokes from the closed one, or its unit is not metres."""
TOO_SMALL = (1e3, 1e6)
"""A travel so many times smaller than the stroke is another unit; what lies between may be a valve that sticks."""
ALIKE = 3.0
"""Declared and true stroke differ by less than this factor."""
FEWEST_JUMPS = 2
"""From one end to the other; one may be where the recording was joined."""
NEAR = 0.05
"""Share of the travel; smaller changes may be noise."""
PLACES = 100
"""From a lift to the stop, at which forces are looked at."""
RESTED = 0.25
"""The last share of an opening: a plunger that stands still in it has come to rest."""
SHORTEST_LIFT, LONGEST_LIFT = 20e-6, 0.5
"""s from the gap to the stop or back: it takes milliseconds."""
MOST_VOLTS = 30.0
"""No voltage is so many reference voltages: a peak-and-hold driver reaches seven."""
MOST_AMPERES = 30.0
"""No current is so many times what the voltage and the declared resistance allow: that may be off by a few."""
_LONG_ENOUGH = 0.5
"""s of a constant voltage, after which a valve that can open has."""
LEAST_AMPERES = 0.01
"""Of a valve that moved, no current is below this share of it."""


def find_problems(trace: Trace, positions: str, voltage: str) -> list[str]:
    """Return one sentence for each trouble.

    Args:
        trace: What was read. positions: Where the positions, or without any the current, are recorded.
        voltage: Where the voltage is.
    """
    findings = []
    times = trace.sample_times
    gaps = find_gaps(times)
    if len(gaps):
        longest = float((times[gaps + 1] - times[gaps]).max())
        findings.append(f"{positions}: {len(gaps)} gaps in the samples, the longest {longest:.6f} s")
    if not trace.drive.volts.any():
        findings.append(f"{voltage} never leaves 0 V")
    is_beside = trace.drive.times[0] > times[-1] or trace.drive.times[-1] < 2 * times[0] - times[-1]
    beside = [f"{voltage}: no command falls into the time of the samples"] if is_beside else []
    findings += _impossible(trace) + _opposed(trace)
    if not trace.has_positions:
        return findings + beside
    reach = float(np.abs(trace.kept_position).max(initial=0.0))
    if reach > LARGEST_POSITION:
        findings.append(f"{positions}: {PILOT} reaches {reach:.6g} m: positions must be in metres")
    travel = largest_travel(trace.usable_position)
    if travel <= motion_threshold(trace.kept_position):
        findings.append(f"{positions}: no motion: {PILOT} stays within {travel * 1e6:.3g} µm")
        beside = []
    else:
        findings += _inverted(trace, positions)
    return findings + beside


def _impossible(trace: Trace) -> list[str]:
    """One sentence for each channel that usually reads what it cannot be, as a gauge pressure below 0 is."""
    found, recorded = [], trace.signals()
    for channel in SIGNALS.values():
        signal, (least, most) = recorded.get(channel.name), channel.bounds
        # A noisy sensor may read beyond its end at times: the usual reading, which costs a copy, is looked at then.
        if signal is None or (least <= signal.values.min() and signal.values.max() <= most):
            continue
        usual = float(np.median(signal.values))
        if not least <= usual <= most:
            found.append(
                f"{_where(trace, channel.key)}: the {channel.title} is usually {usual:.4g} {channel.unit}, expected "
                f"{least:g} to {most:g}; correct unit: or offset: with --map"
            )
    return found


def doubtful_units(trace: Trace, parameters: ValveParameters) -> tuple[str, ...]:
    """Quantities of a trace that are off by so large a factor that they are in another unit, or are another quantity.

    Args:
        trace: What was read.
        parameters: The declared valve.

    Returns:
        One line each: where, what was found, what is expected, and the mend.
    """
    exchanged = _exchanged(trace, parameters)
    if exchanged:
        return (exchanged,)
    found = [check(trace, parameters) for check in (_position, _time) if trace.has_positions]
    # A current is judged by the voltage.
    found += [_voltage(trace, parameters) or _current(trace, parameters)]
    return tuple(line for line in found if line)


def refuse_doubtful_units(trace: Trace, parameters: ValveParameters) -> None:
    """Stop before anything is fitted to numbers of another unit; see `doubtful_units`.

    Raises:
        TraceError: One line with the recording, the topic or column, what was found and is expected, and the remedy.
    """
    for line in doubtful_units(trace, parameters):
        raise TraceError(f"{trace.source}: {line}")


def left_out_finding(trace: Trace) -> tuple[str, ...]:
    """Say how many positions are no measurements and take part in no fit, by reason.

    Returns:
        One line, or none.
    """
    words = words_of(trace.left_out.counts)
    return (f"{_where(trace, 'position')}: left out of all that follows: {words}",) if words else ()


def another_valve(trace: Trace, parameters: ValveParameters) -> tuple[str, ...]:
    """Say whether the plunger goes where that of the declared valve cannot: then it is another valve.

    Either it travels beyond the declared stop, or it rests below it, where the declared attraction at the voltage that
    is on exceeds all that is declared to hold it, from there to the stop. Nothing is refused: a valve may be worn, or
    jammed half open.

    Args:
        trace: What was read.
        parameters: The declared valve.

    Returns:
        One line, or none.
    """
    if not trace.has_positions or doubtful_units(trace, parameters):
        return ()
    stroke, travel = parameters.stroke, largest_travel(trace.usable_position)
    is_beyond = FULL_TRAVEL * travel > stroke
    pushed = 0.0 if is_beyond or travel > FULL_TRAVEL * stroke else _pushed_on(trace, parameters)
    if not (is_beyond or pushed > 0.0):
        return ()
    volts = float(np.abs(trace.drive.volts).max())
    why = "beyond its stop" if is_beyond else f"where at least {pushed:.3g} N would draw it on to its stop"
    declared = f"the stroke of the declared valve ({1e3 * stroke:.3g} mm, {parameters.reference_voltage:g} V)"
    return (
        f"{_where(trace, 'position')}: {PILOT} travels {1e3 * travel:.3g} mm at up to {volts:.3g} V, "
        f"{travel / stroke:.2g} times {declared}, {why}: another valve? Give its parameter file as --params",
    )


def _pushed_on(trace: Trace, parameters: ValveParameters) -> float:
    """The largest force, N, by which the declared valve would go on from where the plunger rested; 0 for none."""
    closed, largest = float(trace.usable_position.min()), 0.0
    for part in find_stroke_parts(trace):
        since = part.stop - RESTED * (part.stop - part.start)
        at_end = trace.usable_position[slice(*np.searchsorted(trace.times, [since, part.stop]))]
        if part.kind != "opening" or not part.moved or len(at_end) < 2:
            continue
        if largest_travel(at_end) <= motion_threshold(trace.kept_position):
            lift = float(np.median(at_end)) - closed
            largest = max(largest, _least_force(parameters, lift, part.volts))
    return largest


def _least_force(parameters: ValveParameters, lift: float, volts: float) -> float:
    """The declared valve's least static net force from a lift to the stop, N: above 0 it cannot rest on the way.

    0 at the gap, where a pilot plunger may wait for the pressure. The attraction is at most that at the reference
    voltage: what pulls more may saturate the core.
    """
    gap = parameters.pilot_gap
    if FULL_TRAVEL * gap <= lift <= gap / FULL_TRAVEL:
        return 0.0
    way = np.linspace(lift, parameters.stroke, PLACES)
    share = min(1.0, abs(volts) / parameters.reference_voltage)
    pull = share**2 * np.polynomial.polynomial.polyval(way, parameters.attraction_polynomial)
    held = np.where(way < gap, parameters.seat_load, parameters.spring_preload + parameters.spring_rate * way)
    return float(np.min(pull - held))


def _position(trace: Trace, parameters: ValveParameters) -> str:
    stroke, travel = parameters.stroke, largest_travel(trace.usable_position)
    where = _where(trace, "position")
    if travel > MOST_STROKES * stroke:
        _, _, factor = _unit(trace, "position", stroke / travel)
        return (
            f"{where}: {PILOT} travels {travel:.4g} m, expected about {stroke:.4g} m (valve.stroke), at most "
            f"{MOST_STROKES * stroke:.4g} m: about {1.0 / factor:.4g} times too large{_mend(trace, 'position', factor)}"
        )
    for factor in TOO_SMALL:
        alike = 1.0 / ALIKE < factor * travel / stroke < ALIKE
        if alike and travel > motion_threshold(trace.kept_position) - SMALLEST_MOTION:
            return (
                f"{where}: {PILOT} travels {travel:.4g} m, expected about {stroke:.4g} m (valve.stroke): about "
                f"{factor:g} times too small{_mend(trace, 'position', factor)}"
            )
    usual = float(np.median(trace.kept_position))
    if abs(usual) > MOST_STROKES * stroke:
        rest = float(np.median(trace.usable_position[: max(1, len(trace.usable_position) // 100)]))
        return (
            f"{where}: {PILOT} lies at {usual:.4g} m, expected 0 m where the valve is closed and {stroke:.4g} m where "
            f"it is open (valve.stroke); take the sensor's zero out with --map and offset: (here {-rest:.6g} m)"
        )
    return ""


def _time(trace: Trace, parameters: ValveParameters) -> str:
    """Of tables only: stamps of messages have one unit."""
    if trace.clock in ("header", "bag"):
        return ""
    closed, travel = float(trace.usable_position.min()), largest_travel(trace.usable_position)
    share = (trace.usable_position - closed) / travel if travel > 0.0 else np.zeros(len(trace.times))
    # Below the gap, a pilot may wait until the pressure lets it lift the main plunger.
    level = np.full(len(share), 0)
    level[share < parameters.pilot_gap / parameters.stroke + 0.1] = -1
    level[share > FULL_TRAVEL] = 1
    ends = np.flatnonzero(level)
    changes = np.flatnonzero(np.diff(level[ends]))
    if not len(changes):
        return ""
    fastest = float((trace.times[ends[changes + 1]] - trace.times[ends[changes]]).min())
    if SHORTEST_LIFT < fastest < LONGEST_LIFT:
        return ""
    return (
        f"time: {PILOT} takes {fastest:.3g} s from the gap to the stop at its fastest, expected some milliseconds: "
        "another unit of time; correct it in the map with time: {column: ..., unit: ms}, us or s"
    )


def _voltage(trace: Trace, parameters: ValveParameters) -> str:
    reference, highest = parameters.reference_voltage, float(np.abs(trace.drive.volts).max(initial=0.0))
    quantity = "command" if "command" in trace.origins else "voltage"
    where = _where(trace, quantity)
    expected = f"expected about {reference:g} V (valve.reference_voltage)"
    if highest > MOST_VOLTS * reference:
        return (
            f"{where}: the voltage reaches {highest:.4g} V, {expected} and at most {MOST_VOLTS * reference:g} V"
            f"{_mend(trace, quantity, 1e-3)}"
        )
    is_too_low = highest < reference / MOST_VOLTS
    # What opens with the reference voltage opens with more: that needs no simulation, which would load compiled code.
    is_in_doubt = not is_too_low and trace.has_positions and ALIKE * highest < reference
    if is_in_doubt and largest_travel(trace.usable_position) > 0.5 * parameters.stroke:
        # Behind a divider of ten, say. A valve that cannot open as declared does not tell.
        is_too_low = not _opens(parameters, ALIKE * highest) and _opens(parameters, reference)
    if highest > 0.0 and is_too_low and _has_moved(trace):
        return (
            f"{where}: the voltage reaches {highest:.4g} V only, though the valve moved; {expected}; "
            f"correct it with --map and unit: or scale: (of a divider, {_power_of_ten(reference / highest):g}?)"
        )
    return ""


def _opens(parameters: ValveParameters, volts: float) -> bool:
    """Whether a valve as declared reaches its core when so many volts are held."""
    from valve_sim.model import Valve, simulate

    response = simulate(Valve(parameters), Drive.of([0.0], [volts]), [0.0, _LONG_ENOUGH])
    return bool(response.phase[-1] == Phase.OPEN)


def _current(trace: Trace, parameters: ValveParameters) -> str:
    signal = trace.coil_current
    if signal is None or not len(signal.values) or not trace.drive.volts.any():
        return ""
    highest = float(np.quantile(np.abs(signal.values), 0.999, overwrite_input=True))
    expected = float(np.abs(trace.drive.volts).max()) / parameters.coil_resistance
    where = _where(trace, "current")
    words = f"expected about {expected:.3g} A (voltage by valve.coil_resistance {parameters.coil_resistance:g} Ω)"
    if highest > MOST_AMPERES * expected:
        found = f"the current reaches {highest:.4g} A"
        return f"{where}: {found}, {words}{_mend(trace, 'current', 1e-3)}"
    if highest < LEAST_AMPERES * expected and _has_moved(trace):
        return (
            f"{where}: the current reaches {highest:.3g} A only, {words}"
            f"{_mend(trace, 'current', _power_of_ten(expected / highest))}, or leave the current out of the map"
        )
    return ""


def _where(trace: Trace, quantity: str) -> str:
    return trace.origins.get(quantity, quantity)


def _has_moved(trace: Trace) -> bool:
    """Whether it has; without positions, every valve is taken to have."""
    if not trace.has_positions:
        return True
    return largest_travel(trace.usable_position) > motion_threshold(trace.kept_position)


def _power_of_ten(ratio: float) -> float:
    return float(10.0 ** np.round(np.log10(ratio)))


def _unit(trace: Trace, quantity: str, factor: float) -> tuple[str, str, float]:
    """The unit that was taken, the one that makes the numbers nearest to so many times as large, and what it makes."""
    units, taken = UNITS[CHANNELS[quantity].dimension], trace.units.get(quantity, CHANNELS[quantity].unit)
    right = nearest_unit(CHANNELS[quantity].dimension, units[taken].factor * factor)
    return taken, right, units[right].factor / units[taken].factor


def _mend(trace: Trace, quantity: str, factor: float) -> str:
    """What to do about numbers that should be so many times as large: another unit of the map, or a scale."""
    taken, right, _ = _unit(trace, quantity, factor)
    if right == taken:
        return f"; correct it with --map and scale: {factor:g}"
    return f", as if {right} were taken for {taken}; correct it with --map and unit: {right}"


def _exchanged(trace: Trace, parameters: ValveParameters) -> str:
    """Whether voltage and position, or voltage and current, are each other: the other way round, both can be."""
    voltage, current = _where(trace, "command" if "command" in trace.origins else "voltage"), _where(trace, "current")
    if trace.has_positions and _jumps(trace, parameters):
        return (
            f"{_where(trace, 'position')}: {PILOT} jumps from end to end within a sample, as a voltage does, expected "
            f"milliseconds: is it exchanged with {voltage}? Name each by the other's topic or column in --map"
        )
    signal = trace.coil_current
    if signal is None or not len(signal.values):
        return ""
    volts = float(np.abs(trace.drive.volts).max(initial=0.0))
    amperes = float(np.quantile(np.abs(signal.values), 0.999))
    resistance, reference = parameters.coil_resistance, parameters.reference_voltage
    if not (min(volts, amperes) > 0.0 and amperes > ALIKE * volts / resistance and amperes > volts):
        return ""
    alike = [amperes / reference, volts / (amperes / resistance)]
    if not all(1.0 / ALIKE < ratio < ALIKE for ratio in alike):
        return ""
    return (
        f"{voltage} and {current}: the voltage reaches {volts:.3g} V and the current {amperes:.3g} A, expected about "
        f"{reference:g} V and {reference / resistance:.3g} A (valve.reference_voltage, valve.coil_resistance): they "
        "are exchanged; name each by the other's topic or column in --map"
    )


def _jumps(trace: Trace, parameters: ValveParameters) -> bool:
    """Whether a position mostly goes from end to end within one sample, in less time than any plunger takes."""
    middle = medians_of_three(trace.usable_position)
    changes, travel = np.abs(np.diff(middle)), float(np.ptp(middle)) if len(middle) else 0.0
    is_whole = changes > 0.5 * travel
    if np.count_nonzero(is_whole) < FEWEST_JUMPS or not np.any(middle):
        return False
    interval = float(np.median(np.diff(trace.times)))
    is_most = changes[is_whole].sum() > 0.5 * changes[changes > NEAR * travel].sum()
    return bool(is_most and interval < parameters.stroke / FASTEST)


def _opposed(trace: Trace) -> list[str]:
    """Whether the current flows against the voltage: one sentence, or none."""
    signal = trace.coil_current
    if signal is None or not len(signal.values):
        return []
    volts = trace.drive.at(signal.times)
    along = np.sign(volts) * signal.values
    most = float(np.quantile(np.abs(signal.values), 0.999))
    if not volts.any() or float(np.median(along[volts != 0.0])) > -0.3 * most:
        return []
    return [
        f"{_where(trace, 'current')}: the current flows against the voltage: one of them is inverted; correct it with "
        "--map and sign: -1"
    ]


def _inverted(trace: Trace, positions: str) -> list[str]:
    """Whether the position falls where the coil is switched on: one sentence, or none."""
    volts = np.abs(trace.drive.at(trace.times))
    on, off = volts > 0.5 * volts.max(initial=0.0), volts == 0.0
    if not (on.any() and off.any()):
        return []
    opened, closed = (float(np.median(trace.usable_position[own])) for own in (on, off))
    if closed - opened <= 0.5 * largest_travel(trace.usable_position):
        return []
    return [
        f"{positions}: the position is higher while the coil is off than while it is on, expected 0 where the valve is "
        "closed and positive towards the core: it may be inverted; correct it with --map and sign: -1 (and offset:)"
    ]
