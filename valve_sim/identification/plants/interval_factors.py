"""What differs from stroke to stroke, or while the driver is on: a valve's numbers by interval between commands.

Friction, seat load and preload of a real valve are not quite those of the stroke before. Each varies by a factor
1 + δ of its own in every stroke, with δ ~ N(0, s²) and a size s that is learned: estimates of the parameters are then
of the mean stroke. A source with a resistance in
series with the coil makes the coil's time constant shorter, by 1/(1 + q), q = R_source/R_coil, but only while the
driver is on.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from typing import Final, NamedTuple

import numpy as np

from valve_sim.identification.plants.protocol import Array, Nuisance
from valve_sim.identification.plants.variation import variation, variation_name
from valve_sim.model import CATALOGUE, Valve
from valve_sim.model.valve import ALWAYS
from valve_sim.traces import Trace
from valve_sim.traces.strokes import command_strokes, stroke_starts

SUPPLY: Final = "supply"


class Varying(NamedTuple):
    """A number of the valve that differs from stroke to stroke.

    Attributes:
        group: numbers of one group share a size. scale: of the half-normal prior of that size, relative.
    """

    group: str
    scale: float


VARYING: Final[Mapping[str, Varying]] = {
    "pilot_damping": Varying("damping", 0.05),
    "main_damping": Varying("damping", 0.05),
    "seat_load": Varying("seat_load", 0.05),
    "spring_preload": Varying("spring_preload", 0.02),
}
"""Lubrication changes by some per cent from stroke to stroke, and seats and springs settle by less."""
TIME_CONSTANT: Final = "coil_time_constant"
FIELDS: Final = (*VARYING, TIME_CONSTANT)
"""Numbers of a valve that have a factor in each interval."""
SUPPLY_SCALE: Final = 0.1
"""Ω, of the prior of a source's resistance: that of its cables and contacts."""


def variations(
    valve: Valve, trace: Trace, index: int, channels: tuple[int, ...], part_of: int | None = None
) -> list[Nuisance]:
    """How much each number that varies differs in each stroke.

    There are none of a recording of one stroke that is no part of another, and none where the motion is not seen, or is
    of a measured voltage, whose steps are not the commands'.

    Args:
        valve: as declared. trace: the recording. index, channels: of it.
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
        for name, own in VARYING.items():
            if _is_used(valve, name):
                at = index, stroke, name
                found.append(variation(at, own.scale, f"{own.group}[{recording}]", channels, during))
    return found


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


def sag_with(valve: Valve, index: int, values: Mapping[str, float]) -> float:
    """q: the source's resistance over the coil's."""
    return values.get(f"{SUPPLY}[{index}]", 0.0) / valve.parameters.coil_resistance


class IntervalFactors:
    """What differs of a valve by interval between the commands of a recording.

    Args:
        valve: as declared. trace: the recording. index: of it.
    """

    def __init__(self, valve: Valve, trace: Trace, index: int) -> None:
        drive = trace.drive
        strokes = np.searchsorted(stroke_starts(drive), np.arange(len(drive.times)), side="right") - 1
        self._strokes = np.concatenate([[-1], strokes])
        self._is_on = np.concatenate([[False], drive.volts != 0.0])
        self._supply, self._resistance = f"{SUPPLY}[{index}]", valve.parameters.coil_resistance
        self._places = {
            variation_name(index, stroke, name): (self._strokes == stroke, FIELDS.index(name))
            for stroke in range(int(self._strokes.max(initial=-1)) + 1)
            for name in VARYING
        }

    def of(self, values: Mapping[str, float]) -> Array | None:
        """(c + 1, f) factors of `FIELDS` before the first command and after each; None where nothing differs.

        Args:
            values: of nuisances, by name.
        """
        own = [(place, values[name]) for name, place in self._places.items() if name in values]
        if not own and self._supply not in values:
            return None
        found = np.ones((len(self._strokes), len(FIELDS)))
        for (during, field), deviation in own:
            found[during, field] = 1.0 + deviation
        sag = values.get(self._supply, 0.0) / self._resistance
        found[self._is_on, FIELDS.index(TIME_CONSTANT)] = 1.0 / (1.0 + sag)
        return found


def places_of_fields(valve: Valve) -> list[list[int]]:
    """Of each of `FIELDS` where it is among the numbers of a valve: the declared one, and what effects add to it."""
    names = valve.plan().parameters
    added = [
        (f"{effect}.{parameter}", number)
        for effect in dict.fromkeys((*valve.effects, *ALWAYS))
        for parameter, number in CATALOGUE[effect].adds_to.items()
    ]
    return [[names.index(field), *(names.index(name) for name, to in added if to == field)] for field in FIELDS]
