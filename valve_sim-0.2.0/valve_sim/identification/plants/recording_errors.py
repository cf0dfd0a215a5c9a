"""Errors of a recording, estimated beside the valve's parameters: of clocks, commands and a sensor's zero.

Commands that were sent are known to the last digit, and their stamps nearly. Commands that were read from samples of a
voltage are not: a step lies anywhere between two samples, and a level is known as well as its noise averages out. Both
are nuisances with the errors that the reader of the recording gives.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final

import numpy as np

from valve_sim.identification.plants.interval_factors import SUPPLY, sag_with
from valve_sim.identification.plants.protocol import Nuisance
from valve_sim.identification.plants.variation import VARIATION
from valve_sim.model import Drive, Valve
from valve_sim.traces import Trace, command_strokes

CLOCK_SIGMA: Final = 50e-6
"""s: the prior of a bag's clock offset and of each command's stamp."""
RATE_SIGMA: Final = 100e-6
"""The prior of the difference of two clocks' rates: twice what quartzes differ by."""
VOLTAGE_DIFFERENCE: Final = 1e-3
"""V: step of a voltage in a difference quotient."""

Channels = tuple[int, ...]


def clock_offset(index: int, channels: Channels) -> Nuisance:
    """Samples are stamped late by it."""
    return Nuisance(f"clock_offset[{index}]", CLOCK_SIGMA, "s", channels, error="clock_offset")


def stamp_errors(trace: Trace, index: int, channels: Channels) -> list[Nuisance]:
    """How much later than stamped the voltage changes, for each command that was recorded as it was sent."""
    if trace.drive_errors is not None:
        return []
    return [
        Nuisance(f"command_error[{index},{command}]", CLOCK_SIGMA, "s", channels, during, error="command_stamps")
        for command, during in enumerate(command_strokes(trace.drive))
        if _is_sampled(trace, float(trace.drive.times[command]), during[1])
    ]


def _is_sampled(trace: Trace, since: float, until: float) -> bool:
    """Whether anything was recorded in between: of what nobody saw no error can be estimated."""
    first, last = np.searchsorted(trace.sample_times, [since, until])
    return bool(last > first)


def reading_errors(trace: Trace, index: int, channels: Channels) -> list[Nuisance]:
    """Errors of times and levels of commands that were read from a voltage, and the zero of a position sensor.

    Args:
        trace: the recording. index: of it.
        channels: of it, the position first.
    """
    found: list[Nuisance] = []
    if trace.zero_error > 0.0:
        found.append(Nuisance(f"position_zero[{index}]", trace.zero_error, "m", channels[:1]))
    if trace.drive_errors is None:
        return found
    strokes = command_strokes(trace.drive)
    found += [
        Nuisance(f"command_error[{index},{command}]", float(sigma), "s", channels, strokes[command])
        for command, sigma in enumerate(trace.drive_errors.times)
        if sigma > 0.0
    ]
    if trace.coil_voltage is not None:
        return found
    levels, first, which = np.unique(trace.drive.volts, return_index=True, return_inverse=True)
    for level, command in enumerate(first.tolist()):
        sigma = float(trace.drive_errors.volts[command])
        if levels[level] != 0.0 and sigma > 0.0:
            own = [strokes[other] for other in np.flatnonzero(which == level).tolist()]
            during = min(begin for begin, _ in own), max(end for _, end in own)
            name = f"voltage_error[{index},{command}]"
            found.append(Nuisance(name, sigma, "V", channels, during, VOLTAGE_DIFFERENCE))
    return found


def clock_rate(index: int, channels: Channels) -> Nuisance:
    """How much faster the clock of the commands runs than that of the samples."""
    return Nuisance(f"clock_rate[{index}]", RATE_SIGMA, "–", channels, step=1e-7, error="clock_rate")


def drive_with(trace: Trace, index: int, values: Mapping[str, float], valve: Valve) -> Drive:
    """The voltage as it took effect, by the values of the nuisances.

    Args:
        trace: the recording. index: of it. values: of nuisances, by name.
        valve: as declared; of one that freewheels a measured voltage is not used while the command is 0.
    """
    commands = _commands_with(trace, index, values)
    sag = sag_with(valve, index, values)
    if sag:
        commands = Drive(commands.times, commands.volts / (1.0 + sag))
    measured = trace.measured_input
    if measured is None:
        return commands
    return measured.drive(commands, lateness_with(index, values), freewheels=valve.parameters.release_voltage > 0.0)


def _commands_with(trace: Trace, index: int, values: Mapping[str, float]) -> Drive:
    """The commands as they took effect."""
    drive = trace.drive
    late = np.array([values.get(f"command_error[{index},{command}]", 0.0) for command in range(len(drive.times))])
    volts = drive.volts
    if trace.drive_errors is not None:
        _, first, which = np.unique(volts, return_index=True, return_inverse=True)
        volts = volts + np.array([values.get(f"voltage_error[{index},{command}]", 0.0) for command in first])[which]
    rate = values.get(f"clock_rate[{index}]", 0.0)
    if rate:
        late = late - rate * (drive.times - trace.sample_times[0])
    if not np.any(late):
        return Drive(drive.times, volts)
    return Drive(np.maximum.accumulate(drive.times + late), volts)


def zero_with(index: int, values: Mapping[str, float]) -> float:
    """Reading of the position sensor for a closed valve, m."""
    return values.get(f"position_zero[{index}]", 0.0)


def lateness_with(index: int, values: Mapping[str, float]) -> float:
    """Delay of the stamps of a recording's samples, s."""
    return values.get(f"clock_offset[{index}]", 0.0)


_NAMES: Final = (
    "clock_offset[", "clock_rate[", "command_error[", "voltage_error[", "position_zero[", f"{VARIATION}[", f"{SUPPLY}["
)  # fmt: skip


def is_of_recording(name: str) -> bool:
    """Whether a value is one of those above, which no valve's record depends on."""
    return name.startswith(_NAMES)
