"""Errors of a recording, estimated beside the valve's parameters: of clocks and commands, and of what varies.

Commands that were sent are known to the last digit, and their stamps nearly. Commands that were read from samples of a
voltage are not: a step lies anywhere between two samples, and a level is known as well as its noise averages out. Both
are nuisances with the errors that the reader of the recording gives.

Other errors act on the valve, whose numbers then differ by interval between commands. Friction, seat load and preload
of a real valve are not quite those of the stroke before. Each varies by a factor 1 + δ of its own in every stroke, with
δ ~ N(0, s²) and a size s that is learned: estimates of the parameters are then of the mean stroke. A source with a
resistance in series with the coil makes the coil's time constant shorter, by 1/(1 + q), q = R_source/R_coil, but only
while the driver is on.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.plants.protocol import Array, Nuisance
from valve_sim.identification.plants.variation import LARGEST, VARIATION, stroke_of, variation, varies_in
from valve_sim.model import CATALOGUE, Drive, Valve
from valve_sim.model.valve import ALWAYS
from valve_sim.recordings import Trace
from valve_sim.recordings.strokes import command_strokes, stroke_starts

CLOCK_SIGMA: Final = 50e-6
"""s: the prior of a bag's clock offset and of each command's stamp."""
RATE_SIGMA: Final = 100e-6
"""The prior of the difference of two clocks' rates: twice what quartzes differ by."""
VOLTAGE_DIFFERENCE: Final = 1e-3
"""V: step of a voltage in a difference quotient."""

SUPPLY: Final = "supply"
TIME_CONSTANT: Final = "coil_time_constant"
SUPPLY_SCALE: Final = 0.1
"""Ω, of the prior of a source's resistance: that of its cables and contacts."""
Channels = tuple[int, ...]
_NAMES: Final = (
    "clock_offset[", "clock_rate[", "command_error[", "voltage_error[", "position_zero[", f"{VARIATION}[", f"{SUPPLY}["
)  # fmt: skip


class Varying(NamedTuple):
    """A number of the valve that differs from stroke to stroke.

    Attributes:
        group: numbers of one group share a size. scale: of the half-normal prior of that size, relative.
        bounds: of the relative deviation in a stroke.
    """

    group: str
    scale: float
    bounds: tuple[float, float] = (-LARGEST, LARGEST)


VARYING: Final[Mapping[str, Varying]] = {
    "pilot_damping": Varying("damping", 0.05),
    "main_damping": Varying("damping", 0.05),
    "seat_load": Varying("seat_load", 0.05),
    "spring_preload": Varying("spring_preload", 0.02),
}
"""Lubrication changes by some per cent from stroke to stroke, and seats and springs settle by less."""
FIELDS: Final = (*VARYING, TIME_CONSTANT)
"""Numbers of a valve that have a factor in each interval, beside parameters of effects that change over the strokes."""
CHANGE_SCALE: Final = 0.5
"""Scale of the size by which a parameter of an effect changes over the strokes, relative to its mean."""
FROM_NOTHING: Final = (-1.0, 4.0)
"""Bounds of that change: an effect may begin in a recording, and be five times its mean."""
FACTOR_SCALE: Final = 0.02
"""The same scale of a factor, such as a gain, which is 1 where nothing is wrong."""


def changing(effect: str) -> dict[str, Varying]:
    """What may change of an effect over the strokes, by `<effect>/<parameter>`: what switches it, if it has a size."""
    switches = {f"{effect}/{own.name}": own for own in CATALOGUE[effect].parameters}
    sized = {name: Varying(name, CHANGE_SCALE, FROM_NOTHING) for name, own in switches.items() if own.off == 0.0}
    return sized | {name: Varying(name, FACTOR_SCALE) for name, own in switches.items() if own.off == 1.0}


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


def is_of_recording(name: str) -> bool:
    """Whether a value is one of those above, which no valve's record depends on."""
    return name.startswith(_NAMES)


def variations(
    what: Mapping[str, Varying], trace: Trace, index: int, channels: tuple[int, ...], part_of: int | None = None
) -> list[Nuisance]:
    """How much each number that varies differs in each stroke.

    There are none of a recording of one stroke that is no part of another, and none where the motion is not seen, or is
    of a measured voltage, whose steps are not the commands'.

    Args:
        what: varies, by the name of the number. trace: the recording. index, channels: of it.
        part_of: the recording that it was cut out of, whose strokes vary by as much; None: it is whole.
    """
    starts = stroke_starts(trace.drive)
    if (len(starts) < 2 and part_of is None) or trace.measured_input is not None or not trace.has_positions:
        return []
    recording = index if part_of is None else part_of
    edges = sorted({edge for during in command_strokes(trace.drive) for edge in during})
    found = []
    for stroke, during in enumerate(itertools.pairwise(edges)):
        if not np.any((trace.sample_times >= during[0]) & (trace.sample_times < during[1])):
            continue
        for name, own in what.items():
            group = f"{own.group}[{recording}]"
            found.append(variation((index, stroke, name), own.scale, group, channels, during, own.bounds))
    return found


def varying_numbers(valve: Valve) -> dict[str, Varying]:
    """Declared numbers of a valve that vary from stroke to stroke."""
    return {name: own for name, own in VARYING.items() if _is_used(valve, name)}


def _is_used(valve: Valve, name: str) -> bool:
    return valve.declared()[name] > 0.0 and not (valve.parameters.has_one_plunger and name == "pilot_damping")


def supply_errors(trace: Trace, index: int, channels: tuple[int, ...]) -> list[Nuisance]:
    """The resistance of the source, where the motion is seen and the voltage at the coil was not measured."""
    if trace.coil_voltage is not None or not trace.has_positions:
        return []
    name = f"{SUPPLY}[{index}]"
    return [
        Nuisance(name, SUPPLY_SCALE, "Ω", channels, step=1e-4, lower=0.0, upper=10.0, error=SUPPLY, group=name)
    ]  # fmt: skip


class ErringRecording:
    """What the values of a recording's errors make of its commands, its stamps, and the valve's numbers by interval.

    Args:
        trace: the recording. index: of it.
        valve: as declared; of one that freewheels a measured voltage is not used while the command is 0.

    Attributes:
        trace: as given.
    """

    def __init__(self, trace: Trace, index: int, valve: Valve) -> None:
        self.trace, drive = trace, trace.drive
        _, first, which = np.unique(drive.volts, return_index=True, return_inverse=True)
        levels = [] if trace.drive_errors is None else first[which].tolist()
        self._stamps = [f"command_error[{index},{command}]" for command in range(len(drive.times))]
        self._levels = [f"voltage_error[{index},{command}]" for command in levels]
        self._offset, self._rate, self._zero, self._supply = (
            f"{name}[{index}]" for name in ("clock_offset", "clock_rate", "position_zero", SUPPLY)
        )
        self._begins = f"{VARIATION}[{index},"
        self._measured, self._freewheels = trace.measured_input, valve.parameters.release_voltage > 0.0
        clock = () if self._measured is None else (self._offset,)
        self._of_drive = frozenset((self._rate, self._supply, *self._stamps, *self._levels, *clock))
        self._resistance = valve.parameters.coil_resistance
        strokes = np.searchsorted(stroke_starts(drive), np.arange(len(drive.times)), side="right") - 1
        self._strokes = np.concatenate([[-1], strokes])
        self._is_on = np.concatenate([[False], drive.volts != 0.0])

    def lateness(self, values: Mapping[str, float]) -> float:
        """Delay of the stamps of its samples, s; arguments: see `factors`."""
        return values.get(self._offset, 0.0)

    def zero(self, values: Mapping[str, float]) -> float:
        """Reading of the position sensor for a closed valve, m; arguments: see `factors`."""
        return values.get(self._zero, 0.0)

    def drive(self, values: Mapping[str, float]) -> Drive:
        """The voltage as it took effect; arguments: see `factors`."""
        commands = self._commands(values)
        sag = values.get(self._supply, 0.0) / self._resistance
        if sag:
            commands = Drive(commands.times, commands.volts / (1.0 + sag))
        if self._measured is None:
            return commands
        return self._measured.drive(commands, self.lateness(values), freewheels=self._freewheels)

    def _commands(self, values: Mapping[str, float]) -> Drive:
        """The commands as they took effect."""
        drive = self.trace.drive
        late = np.array([values.get(name, 0.0) for name in self._stamps])
        volts = drive.volts
        if self._levels:
            volts = volts + np.array([values.get(name, 0.0) for name in self._levels])
        rate = values.get(self._rate, 0.0)
        if rate:
            late = late - rate * (drive.times - self.trace.sample_times[0])
        if not np.any(late):
            return Drive(drive.times, volts)
        return Drive(np.maximum.accumulate(drive.times + late), volts)

    def is_driven_by(self, names: Iterable[str]) -> bool:
        """Whether its voltage depends on one of these values."""
        return not self._of_drive.isdisjoint(names)

    def varies_with(self, names: Iterable[str]) -> bool:
        """Whether numbers of the valve differ by interval with one of these values."""
        return any(name == self._supply or name.startswith(self._begins) for name in names)

    def fields(self, values: Mapping[str, float]) -> tuple[str, ...]:
        """The numbers that have factors; arguments: see `factors`."""
        return tuple(dict.fromkeys((*FIELDS, *(varies_in(name) for name in self._own(values)))))

    def factors(self, values: Mapping[str, float]) -> Array | None:
        """(c + 1, f) factors of `fields` before the first command and after each; None where nothing differs.

        Args:
            values: of nuisances, by name.
        """
        own = self._own(values)
        if not own and self._supply not in values:
            return None
        fields = self.fields(values)
        found = np.ones((len(self._strokes), len(fields)))
        for name in own:
            found[self._strokes == stroke_of(name), fields.index(varies_in(name))] = 1.0 + values[name]
        sag = values.get(self._supply, 0.0) / self._resistance
        found[self._is_on, FIELDS.index(TIME_CONSTANT)] = 1.0 / (1.0 + sag)
        return found

    def _own(self, values: Mapping[str, float]) -> list[str]:
        return [name for name in values if name.startswith(self._begins)]


def places_of_fields(valve: Valve, fields: Sequence[str]) -> list[list[int]]:
    """Of each field where it is among the numbers of a valve: the declared one, and what effects add to it.

    Of an effect that a valve does not have it is nowhere.
    """
    names = valve.names
    added = [
        (f"{effect}.{parameter}", number)
        for effect in dict.fromkeys((*valve.effects, *ALWAYS))
        for parameter, number in CATALOGUE[effect].adds_to.items()
    ]
    of_fields = [{field.replace("/", "."), *(name for name, to in added if to == field)} for field in fields]
    return [[names.index(name) for name in names if name in own] for own in of_fields]
