"""Event tables: a few displacements and when they were first reached, as papers and data sheets print them.

    event_table:
      valve: published.yaml        # declared valve, a parameter file beside this one
      voltage: 9.0                 # V, applied at time 0 to the closed valve
      events:
        - {name: t1, displacement: 0.26e-3, time: 5.3e-3, uncertainty: 0.05e-3}   # m, s, s (one standard error)
      largest_attraction: 19.1     # N, optional: compared with, never fitted
      ship: [rest_attraction, coil_lag]   # the effects whose values the run writes down

A table is a kind of measurement beside bags: `EventPlant` offers it to the same fit and the same search.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
import yaml

from valve_sim.files.parameter_files import load_valve
from valve_sim.identification.plants.protocol import Array, Channel, Experiment, ForceMap, Nuisance
from valve_sim.identification.plants.valve_model import ValveModel
from valve_sim.model import (
    CATALOGUE,
    Drive,
    ParameterError,
    Response,
    SimulationError,
    Valve,
    simulate,
)

GRID: Final = 5e-5
"""s between the samples in which a crossing is looked for; contacts are found by their events."""
HORIZON: Final = 4.0
"""Times the last event: a displacement not reached by then counts as never reached."""
AT_CONTACT: Final = 1e-9
"""m: a displacement this close to a contact is reached when the contact is."""
_FORM: Final = "expected 'event_table:' with valve, voltage, events (name, displacement, time, uncertainty) and ship"


@dataclass(frozen=True)
class TimedEvent:
    """A displacement (m) that was first reached at a time (s), known to one standard error `uncertainty` (s)."""

    name: str
    displacement: float
    time: float
    uncertainty: float


@dataclass(frozen=True)
class EventTable:
    """What was read from a file.

    Attributes:
        source: the file. valve_file, valve: the declared valve. voltage: V, applied at time 0.
        events: in ascending order of time. largest_attraction: N, or None. ship: names of effects.
    """

    source: str
    valve_file: Path
    valve: Valve
    voltage: float
    events: tuple[TimedEvent, ...]
    largest_attraction: float | None
    ship: tuple[str, ...]

    @property
    def drive(self) -> Drive:
        """The voltage, from time 0 on."""
        return Drive.of([0.0], [self.voltage])

    @property
    def horizon(self) -> float:
        """When a simulation may end, s."""
        return HORIZON * self.events[-1].time


def read_event_table(path: Path | str) -> EventTable:
    """An event table from YAML.

    Raises:
        ParameterError: the file, or the valve that it names, cannot be used; one line with key, found and expected.
    """
    content = _content(path)
    valve_name = content.get("valve")
    if not isinstance(valve_name, str):
        raise ParameterError(f"{path}: valve: found {valve_name!r}, expected a parameter file beside this one")
    valve_file = Path(path).parent / valve_name
    valve = load_valve(valve_file)
    if valve.parameters.has_one_plunger:
        raise ParameterError(
            f"{path}: valve: {valve_file} declares a valve with one plunger (valve.pilot_gap 0), expected one with two"
        )
    rows = content.get("events")
    if not isinstance(rows, list) or not rows:
        raise ParameterError(f"{path}: events: found {rows!r}, expected a list of events")
    events = [_event(row, f"{path}: events[{index}]") for index, row in enumerate(rows)]
    ship = content.get("ship", [])
    if not isinstance(ship, list) or not ship or any(name not in CATALOGUE for name in ship):
        raise ParameterError(f"{path}: ship: found {ship!r}, expected a list of effects such as [rest_attraction]")
    attraction = content.get("largest_attraction")
    return EventTable(
        str(path),
        valve_file,
        valve,
        _number(content.get("voltage"), f"{path}: voltage", "V"),
        tuple(sorted(events, key=lambda event: event.time)),
        None if attraction is None else _number(attraction, f"{path}: largest_attraction", "N"),
        tuple(ship),
    )


def reached(response: Response, displacement: float) -> float:
    """When the pilot plunger first was at a displacement, s; nan if it never was.

    Exact for contacts; elsewhere by the cubic through the samples on both sides, their velocities included.
    """
    for event in response.events:
        if abs(event.position - displacement) < AT_CONTACT:
            return event.time
    position, velocity, times = response.pilot_position, response.pilot_velocity, response.time
    index = int(np.argmax(position >= displacement))
    if index == 0:
        return math.nan
    span = times[index] - times[index - 1]
    rise = position[index] - position[index - 1]
    slopes = span * velocity[index - 1], span * velocity[index]
    cubic = (slopes[0] + slopes[1] - 2.0 * rise, 3.0 * rise - 2.0 * slopes[0] - slopes[1], slopes[0])
    roots = np.roots([*cubic, position[index - 1] - displacement])
    inside = [root.real for root in roots if abs(root.imag) < 1e-9 and -1e-9 <= root.real <= 1.0 + 1e-9]
    share = min(inside) if inside else (displacement - position[index - 1]) / rise
    return float(times[index - 1] + share * span)


class EventPlant(ValveModel):
    """The valve behind an event table; it has no clock offset, because a table's times count from the voltage.

    Declared values are taken as exact, nothing is refitted beside the effect in question, and no curve stands for what
    has no name: a handful of numbers determines no more. A printed table is not recorded again.

    Args:
        table: the measurement; its declared valve is what effects are added to.
    """

    base: Sequence[str] = ()
    timing_errors: Sequence[Nuisance] = ()
    force_maps: Sequence[ForceMap] = ()
    experiments: Sequence[Experiment] = ()

    def __init__(self, table: EventTable) -> None:
        super().__init__(table.valve.exact())
        self.table = table
        self._grid = np.arange(0.0, table.horizon, GRID)
        # Each event is a channel of a kind of its own, because each has a standard error of its own.
        self._channels = [
            Channel(
                f"{table.source}: {event.name}", f"event {event.name}", np.array([event.time]), np.array([event.time]),
                np.zeros(1, dtype=bool), np.zeros(1, dtype=np.int64), "s",
            )
            for event in table.events
        ]  # fmt: skip

    @property
    def channels(self) -> Sequence[Channel]:
        """One for each event."""
        return self._channels

    def response(self, values: Mapping[str, float]) -> Response:
        """The opening that these values give.

        Raises:
            SimulationError: the gap is not inside the stroke, or the simulation could not be carried to its end.
        """
        valve = self.with_values(values)
        gap, stroke = (valve.parameters.pilot_gap, valve.parameters.stroke)
        if valve.gas is None:
            gap, stroke = valve.after_effects("pilot_gap", "stroke")
        if not 0.0 < gap < stroke:
            raise SimulationError(f"{self.table.source}: a valve whose gap is not inside its stroke cannot move")
        return simulate(valve, self.table.drive, self._grid)

    def times(self, values: Mapping[str, float]) -> list[float]:
        """When each event happens, s; nan where it does not."""
        response = self.response(values)
        return [reached(response, event.displacement) for event in self.table.events]

    def predict(self, values: Mapping[str, float]) -> list[Array]:
        """When each event happens, s; where it does not, a time beyond the horizon that grows with what is missing.

        Raises:
            SimulationError: the simulation could not be carried to its end.
        """
        response = self.response(values)
        furthest = float(np.max(response.pilot_position))
        shown = []
        for event in self.table.events:
            time = reached(response, event.displacement)
            late = self.table.horizon * (2.0 - furthest / event.displacement)
            shown.append(np.array([late if math.isnan(time) else time]))
        return shown


def _content(path: Path | str) -> dict[str, Any]:
    try:
        document = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror}); {_FORM}") from error
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        raise ParameterError(f"{path}: {' '.join(str(error).split())}; {_FORM}") from error
    content = document.get("event_table") if isinstance(document, dict) else None
    if not isinstance(content, dict):
        raise ParameterError(f"{path}: holds no event_table; {_FORM}")
    return content


def _event(row: object, where: str) -> TimedEvent:
    if not isinstance(row, dict) or not isinstance(row.get("name"), str):
        raise ParameterError(f"{where}: found {row!r}, expected name, displacement, time and uncertainty")
    displacement, time, uncertainty = (
        _number(row.get(key), f"{where}.{key}", unit)
        for key, unit in (("displacement", "m"), ("time", "s"), ("uncertainty", "s"))
    )
    return TimedEvent(row["name"], displacement, time, uncertainty)


def _number(value: object, where: str, unit: str) -> float:
    """A positive number; YAML 1.1 takes 1e-3 for text."""
    try:
        number = float(value) if isinstance(value, int | float | str) else math.nan
    except ValueError:
        number = math.nan
    if not (math.isfinite(number) and number > 0.0):
        raise ParameterError(f"{where}: found {value!r}, expected a number above 0 {unit}")
    return number
