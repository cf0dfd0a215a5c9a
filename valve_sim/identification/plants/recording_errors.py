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

import copy
import functools
import itertools
from collections.abc import Iterable, Mapping, Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from valve_sim.identification.plants.protocol import Array, Nuisance, SharedSize
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
VARIATION: Final = "stroke_variation"
COMMAND_TIME: Final = "command_error"
TIME_CONSTANT: Final = "coil_time_constant"
SUPPLY_SCALE: Final = 0.1
"""Ω, of the prior of a source's resistance: that of its cables and contacts."""
LARGEST: Final = 0.9
"""Of δ: a stroke's number keeps its sign."""
SMALL_SHARE: Final = 1e-4
"""Step of δ in a difference quotient."""


class Varying(NamedTuple):
    """A number of the valve that differs from stroke to stroke.

    Attributes:
        number: as the valve names it. group: numbers of one group share a size.
        scale: of the half-normal prior of that size, relative. bounds: of the relative deviation in a stroke.
        effect: whose parameter it is; empty: it is declared.
    """

    number: str
    group: str
    scale: float
    bounds: tuple[float, float] = (-LARGEST, LARGEST)
    effect: str = ""


VARYING: Final = (
    Varying("pilot_damping", "damping", 0.05),
    Varying("main_damping", "damping", 0.05),
    Varying("seat_load", "seat_load", 0.05),
    Varying("spring_preload", "spring_preload", 0.02),
)
"""Lubrication changes by some per cent from stroke to stroke, and seats and springs settle by less."""
FIELDS: Final = (*(own.number for own in VARYING), TIME_CONSTANT)
"""Numbers of a valve that have a factor in each interval, beside parameters of effects that change over the strokes."""
CHANGE_SCALE: Final = 0.5
"""Scale of the size by which a parameter of an effect changes over the strokes, relative to its mean."""
FROM_NOTHING: Final = (-1.0, 4.0)
"""Bounds of that change: an effect may begin in a recording, and be five times its mean."""
FACTOR_SCALE: Final = 0.02
"""The same scale of a factor, such as a gain, which is 1 where nothing is wrong."""


def changing(effect: str) -> list[Varying]:
    """What may change of an effect over the strokes: what switches it, if it has a size; the sizes before the factors.

    Each has a size of its own.
    """
    of_kind = {0.0: (CHANGE_SCALE, FROM_NOTHING), 1.0: (FACTOR_SCALE, (-LARGEST, LARGEST))}
    return [
        Varying(f"{effect}.{own.name}", f"{effect}/{own.name}", *as_prior, effect)
        for off, as_prior in of_kind.items()
        for own in CATALOGUE[effect].parameters
        if own.off == off
    ]


class ErringRecording:
    """The errors of a recording, and what their values make of its commands, its stamps, and the valve by interval.

    Args:
        trace: the recording. index: its number.
        valve: as declared; of one that freewheels a measured voltage is not used while the command is 0.
        channels: indices of the recording's channels, the position first.
        part_of: the recording that it was cut out of, whose strokes vary by as much; None: it is whole.

    Attributes:
        trace: as given.
        clock_offset: samples are stamped late by it.
        clock_rate: how much faster the clock of the commands runs than that of the samples.
        stamps: how much later than stamped the voltage changes, for each command that was recorded as it was sent.
        readings: the zero of a position sensor, and errors of times and levels of commands that were read from a
            voltage.
    """

    def __init__(
        self, trace: Trace, index: int, valve: Valve, channels: tuple[int, ...] = (), part_of: int | None = None
    ) -> None:
        self.trace, self._index, self._channels, self._valve, self._part_of = trace, index, channels, valve, part_of
        self._changes: dict[str, Mapping[str, Nuisance]] = {}
        self._measured, self._freewheels = trace.measured_input, valve.parameters.release_voltage > 0.0
        self._resistance = valve.parameters.coil_resistance
        drive, during = trace.drive, command_strokes(trace.drive)
        starts = stroke_starts(drive)
        self._count = len(starts)
        strokes = np.searchsorted(starts, np.arange(len(drive.times)), side="right") - 1
        self._strokes = np.concatenate([[-1], strokes])
        self._is_on = np.concatenate([[False], drive.volts != 0.0])
        edges = sorted({edge for own in during for edge in own})
        self._windows = [
            (stroke, own) for stroke, own in enumerate(itertools.pairwise(edges)) if self._is_sampled(*own)
        ]

        self.clock_offset = self._error("clock_offset", CLOCK_SIGMA, "s")._replace(error="clock_offset")
        self.clock_rate = self._error("clock_rate", RATE_SIGMA, "–")._replace(step=1e-7, error="clock_rate")
        self._zero = self._error("position_zero", trace.zero_error, "m")._replace(channels=channels[:1])
        self._supply = self._error(SUPPLY, SUPPLY_SCALE, "Ω")._replace(
            step=1e-4, lower=0.0, upper=10.0, error=SUPPLY, group=SharedSize(SUPPLY, index)
        )
        times, levels = self._errors_of_times(during), self._errors_of_levels(during)
        zeros, self.stamps = [self._zero] if trace.zero_error > 0.0 else [], list[Nuisance]()
        if trace.drive_errors is None:
            self.readings = zeros
            at = zip(times, drive.times.tolist(), strict=True)
            self.stamps = [own for own, begin in at if self._is_sampled(begin, own.during[1])]
        else:
            self.readings = [*zeros, *(own for own in times if own.sigma > 0.0), *levels.values()]
        self._dates = [own.name for own in times]
        self._levels = [levels[own].name if own in levels else "" for own in drive.volts.tolist()] if levels else []
        clock = () if self._measured is None else (self.clock_offset.name,)
        self._of_drive = frozenset((self.clock_rate.name, self._supply.name, *self._dates, *self._levels, *clock))

    # -- what is unknown -----------------------------------------------------------------------------------------------

    def _error(self, number: str, sigma: float, unit: str, part: int = -1) -> Nuisance:
        place = f"{self._index}" if part < 0 else f"{self._index},{part}"
        return Nuisance(
            f"{number}[{place}]", sigma, unit, self._channels, number=number, recording=self._index, part=part
        )  # fmt: skip

    def _errors_of_times(self, during: Sequence[tuple[float, float]]) -> list[Nuisance]:
        """How much later the voltage changes than each command's stamp or reading says; see `_errors_of_levels`."""
        drive, errors = self.trace.drive, self.trace.drive_errors
        sigmas = np.full(len(drive.times), CLOCK_SIGMA) if errors is None else errors.times
        error = "command_stamps" if errors is None else ""
        return [
            self._error(COMMAND_TIME, sigma, "s", command)._replace(during=during[command], error=error)
            for command, sigma in enumerate(sigmas.tolist())
        ]

    def _errors_of_levels(self, during: Sequence[tuple[float, float]]) -> dict[float, Nuisance]:
        """The error of each level, V, that was read and not measured; `during`: the stroke of each command, s."""
        errors, found = self.trace.drive_errors, dict[float, Nuisance]()
        if errors is None or self.trace.coil_voltage is not None:
            return found
        levels, first, which = np.unique(self.trace.drive.volts, return_index=True, return_inverse=True)
        for place, (level, command) in enumerate(zip(levels.tolist(), first.tolist(), strict=True)):
            sigma = float(errors.volts[command])
            if level != 0.0 and sigma > 0.0:
                own = [during[other] for other in np.flatnonzero(which == place).tolist()]
                of_all = min(begin for begin, _ in own), max(end for _, end in own)
                error = self._error("voltage_error", sigma, "V", command)
                found[level] = error._replace(during=of_all, step=VOLTAGE_DIFFERENCE)
        return found

    def _is_sampled(self, since: float, until: float) -> bool:
        """Whether anything was recorded in between: of what nobody saw no error can be estimated."""
        first, last = np.searchsorted(self.trace.sample_times, [since, until])
        return bool(last > first)

    def with_samples(self, trace: Trace) -> ErringRecording:
        """This recording with other samples of the same signals."""
        same = copy.copy(self)
        same.trace, same._measured = trace, trace.measured_input
        return same

    @property
    def varying(self) -> list[Nuisance]:
        """What varies of the valve from stroke to stroke, and the resistance of the source.

        The latter where the motion is seen and the voltage at the coil was not measured, and not of a part of a
        recording.
        """
        has_supply = self._part_of is None and self.trace.coil_voltage is None and self.trace.has_positions
        return [*self._variations.values(), *([self._supply] if has_supply else [])]

    @functools.cached_property
    def _variations(self) -> Mapping[str, Nuisance]:
        """How much declared numbers differ in each stroke, by the names of the nuisances."""
        has_one_plunger, declared = self._valve.parameters.has_one_plunger, self._valve.declared()
        return self._by_stroke([
            own for own in VARYING
            if declared[own.number] > 0.0 and not (has_one_plunger and own.number == "pilot_damping")
        ])  # fmt: skip

    def changes(self, effect: str) -> Mapping[str, Nuisance]:
        """How much parameters of an effect differ in each stroke, by the names of the nuisances."""
        if effect not in self._changes:
            self._changes[effect] = self._by_stroke(changing(effect))
        return self._changes[effect]

    def _by_stroke(self, what: Sequence[Varying]) -> dict[str, Nuisance]:
        """How much each number that varies differs in each stroke.

        There are none of a recording of one stroke that is no part of another, and none where the motion is not seen,
        or is of a measured voltage, whose steps are not the commands'.
        """
        if (self._count < 2 and self._part_of is None) or self._measured is not None or not self.trace.has_positions:
            return {}
        whole = self._index if self._part_of is None else self._part_of
        found = {}
        for stroke, during in self._windows:
            for own in what:
                name = f"{VARIATION}[{self._index},{stroke},{own.group if own.effect else own.number}]"
                low, high = own.bounds
                found[name] = Nuisance(
                    name, own.scale, "–", self._channels, during, SMALL_SHARE, lower=low, upper=high, error=VARIATION,
                    group=SharedSize(own.group, whole, own.effect), number=own.number, recording=self._index,
                    part=stroke,
                )  # fmt: skip
        return found

    # -- what values of it make ----------------------------------------------------------------------------------------

    def lateness(self, values: Mapping[str, float]) -> float:
        """Delay of the stamps of its samples, s; values: of nuisances, by name."""
        return values.get(self.clock_offset.name, 0.0)

    def zero(self, values: Mapping[str, float]) -> float:
        """Reading of the position sensor for a closed valve, m; values: of nuisances, by name."""
        return values.get(self._zero.name, 0.0)

    def drive(self, values: Mapping[str, float]) -> Drive:
        """The voltage as it took effect; values: of nuisances, by name."""
        commands = self._commands(values)
        sag = values.get(self._supply.name, 0.0) / self._resistance
        if sag:
            commands = Drive(commands.times, commands.volts / (1.0 + sag))
        if self._measured is None:
            return commands
        return self._measured.drive(commands, self.lateness(values), freewheels=self._freewheels)

    def _commands(self, values: Mapping[str, float]) -> Drive:
        """The commands as they took effect."""
        drive = self.trace.drive
        late = np.array([values.get(name, 0.0) for name in self._dates])
        volts = drive.volts
        if self._levels:
            volts = volts + np.array([values.get(name, 0.0) for name in self._levels])
        rate = values.get(self.clock_rate.name, 0.0)
        if rate:
            late = late - rate * (drive.times - self.trace.sample_times[0])
        if not np.any(late):
            return Drive(drive.times, volts)
        return Drive(np.maximum.accumulate(drive.times + late), volts)

    def is_driven_by(self, names: Iterable[str]) -> bool:
        """Whether its voltage depends on one of these values."""
        return not self._of_drive.isdisjoint(names)

    def differing(self, values: Mapping[str, float], effects: Iterable[str]) -> Differing | None:
        """The numbers of the valve that differ by interval where these values of nuisances are given; None: none do.

        Args:
            values: by name. effects: that the valve has.
        """
        tables = (self._variations, *(self.changes(own) for own in effects))
        varied = [table[name] for name in values for table in tables if name in table]
        if not varied and self._supply.name not in values:
            return None
        fields = tuple(dict.fromkeys((*FIELDS, *(own.number for own in varied))))
        places = [(self._strokes == own.part, fields.index(own.number), own.name) for own in varied]
        return Differing(fields, places, self._supply.name, self._is_on, self._resistance)


class Differing(NamedTuple):
    """Numbers of a valve that differ by interval between the commands of a recording.

    Attributes:
        fields: their f names.
        places: for each value that makes them differ: (c + 1,) the intervals, the place among the fields, and its name.
        supply: the name of the value of the source's resistance. is_on: (c + 1,) whether the source drives the coil.
        resistance: of the coil, Ω.
    """

    fields: tuple[str, ...]
    places: Sequence[tuple[NDArray[np.bool_], int, str]]
    supply: str
    is_on: NDArray[np.bool_]
    resistance: float

    def is_moved_by(self, names: Iterable[str]) -> bool:
        """Whether they differ with one of these values."""
        return not {self.supply, *(name for _, _, name in self.places)}.isdisjoint(names)

    def factors(self, values: Mapping[str, float]) -> Array:
        """(c + 1, f) of the fields, before the first command and after each; values: of nuisances, by name."""
        found = np.ones((len(self.is_on), len(self.fields)))
        for intervals, field, name in self.places:
            found[intervals, field] = 1.0 + values[name]
        sag = values.get(self.supply, 0.0) / self.resistance
        found[self.is_on, FIELDS.index(TIME_CONSTANT)] = 1.0 / (1.0 + sag)
        return found


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
    of_fields = [{field, *(name for name, to in added if to == field)} for field in fields]
    return [[names.index(name) for name in names if name in own] for own in of_fields]
