"""Every series of numbers in a recording, with its properties that need no knowledge of what it is."""

from __future__ import annotations

import functools
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from valve_sim.files.recording_map import Source
from valve_sim.recordings.motion import medians_of_three
from valve_sim.recordings.storage import read_recording
from valve_sim.recordings.topics import number_paths
from valve_sim.recordings.voltage_steps import held_between

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from valve_sim.files.tables import DataTable
    from valve_sim.recordings.topics import Topic

    Array = NDArray[np.float64]

OTHER_TYPES = re.compile(
    r".*/(Image|CompressedImage|PointCloud2?|OccupancyGrid|LaserScan|TFMessage|Log|.*Markers?.*)|"
    r"(rcl_interfaces|rosgraph_msgs|diagnostic_msgs|lifecycle_msgs|statistics_msgs|builtin_interfaces)/.*"
)
"""Types that hold no quantity of a valve: large ones, and what ROS tells of itself."""
MOST_LEVELS = 12
"""A voltage rests at so few levels at most."""
LEAST_READINGS, FAR, ENOUGH = 0.9, 3.0, 2000
"""Share of values that are readings, at least; how many of their ranges a code is beyond them; values that show that
they differ."""
MOST_MESSAGES = 200_000
"""Of each topic: enough to see what it is."""
MOST_FIELDS = 60
JOINT_FIELDS = ("position", "velocity", "effort")
LEFT_OUT = re.compile(r"covariance|orientation|angular_velocity|(^|\.)(frame_id|seq|child|sec|nanosec)")


@dataclass(frozen=True)
class Series:
    """One series of numbers.

    Attributes:
        place: As a map's entry has it: topic and field, or column.
        values: Finite ones, as recorded, shape (n,).
        unit: As the file says it; empty where it does not.
        is_first_choice: Whether it is a field that usually holds the quantity of its message.
    """

    place: Mapping[str, str]
    values: Array
    unit: str = ""
    is_first_choice: bool = True

    @property
    def name(self) -> str:
        """The name of this series for people."""
        return " ".join(own for key, own in self.place.items() if key != "time")

    @property
    def words(self) -> str:
        """The text that is searched for hints."""
        return self.name.lower()

    @property
    def number(self) -> str:
        """The number in a name such as tank_2_lift or /plc/volts_2; empty where there is none."""
        found = re.findall(r"\d+", self.place.get("joint", "") or self.name)
        return found[-1] if found else ""

    @functools.cached_property
    def low(self) -> float:
        """Lowest value."""
        return float(self.values.min())

    @functools.cached_property
    def high(self) -> float:
        """Highest value."""
        return float(self.values.max())

    @property
    def span(self) -> float:
        """From lowest to highest."""
        return self.high - self.low

    @functools.cached_property
    def at_rest(self) -> float:
        """Median of the first samples, before anything happens."""
        return float(np.median(self.values[: max(1, min(50, len(self.values) // 50))]))

    @functools.cached_property
    def rest_share(self) -> float:
        """Share of samples within 5 % of the span of either end: near 1 for a motion between two stops."""
        share = (self.values - self.low) / self.span
        return float(np.mean((share < 0.05) | (share > 0.95)))

    @functools.cached_property
    def sharpness(self) -> float:
        """Share of the whole travel that is made in steps of a tenth of the span or more: 1 for a switched quantity."""
        steps = np.abs(np.diff(self.values))
        large = steps[steps > 0.1 * self.span].sum()
        return float(large / max(large, np.abs(np.diff(medians_of_three(self.values))).sum(), 1e-300))


def without_codes(values: Array) -> Array:
    """Finite values, (n,), without a few that stand for no reading, -9999 say: far beyond the range of all others."""
    for end in (np.min, np.max):
        rest = values[values != end(values)] if len(values) > MOST_LEVELS else values
        if LEAST_READINGS * len(values) < len(rest) < len(values) and len(np.unique(rest[:ENOUGH])) > MOST_LEVELS:
            span, gap = float(np.ptp(rest)), float(np.abs(end(rest) - end(values)))
            values = rest if gap > FAR * span else values
    return values


def table_series(table: DataTable, columns: Mapping[str, Array], clocks: Mapping[str, str]) -> list[Series]:
    """Columns of a table; `clocks` has the columns of times of those that have their own."""
    held = {name: held_between(values) for name, values in columns.items()}
    found = [(name, without_codes(values[np.isfinite(values)])) for name, values in held.items()]
    return [
        Series(
            {"column": name, **({"time": clocks[name]} if name in clocks else {})}, values, table.units.get(name, "")
        )
        for name, values in found
        if len(values) > 1
    ]


def bag_series(path: Path) -> tuple[list[Series], dict[str, str]]:
    """Every number that the messages of a bag hold, messages of other things left out; and why others cannot be read.

    Raises:
        TraceError: Nothing can be read from it.
    """

    def select(types: Mapping[str, str]) -> dict[str, None]:
        return {topic: None for topic, message_type in types.items() if not OTHER_TYPES.fullmatch(message_type)}

    recording = read_recording(path, select, most=MOST_MESSAGES)
    series, troubles = list[Series](), dict[str, str]()
    for name, topic in sorted(recording.topics.items()):
        if topic.batches:
            series += _fields(name, topic)
        else:
            troubles[name] = recording.trouble(name).strip(" :").partition(";")[0]
    return series, troubles


def _fields(topic: str, messages: Topic) -> list[Series]:
    largest = max(messages.batches, key=lambda batch: batch.size)
    paths = [path for path in number_paths(largest.layout) if not LEFT_OUT.search(path)]
    names = largest.joints
    if names and "position" in largest.layout.fields:
        places = [
            {"topic": topic, "joint": joint, **({} if field == "position" else {"field": field})}
            for field in JOINT_FIELDS
            for joint in names
            if largest.layout.fields[field].size
        ]
    elif len(paths) == 1:
        places = [{"topic": topic}]
    else:
        places = [{"topic": topic, "field": path} for path in paths[:MOST_FIELDS]]
    series = []
    for place in places:
        source = Source(place["topic"], place.get("field", ""), place.get("joint", ""))
        values, _ = messages.values(source)
        values = without_codes(values[np.isfinite(values)])
        if len(values):
            is_first = place.get("field", "") not in ("velocity", "effort")
            series.append(Series(place, values, is_first_choice=is_first))
    return series
