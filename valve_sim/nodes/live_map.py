"""Live topics by a map: a value in SI and its stamp from a message of any type. Imports no ROS."""

from __future__ import annotations

import importlib
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np

from valve_sim.files.channels import CHANNELS
from valve_sim.files.recording_map import MapError, Source, load_map
from valve_sim.nodes.realtime import NANOSECONDS

FLOAT: Final = "std_msgs/msg/Float64"
JOINT_STATE: Final = "sensor_msgs/msg/JointState"
_STEP: Final = re.compile(r"([A-Za-z_]\w*)((?:\[\d+\])*)")


class LiveInput(NamedTuple):
    """One quantity of a map, read from live messages.

    Attributes:
        quantity: as the map calls it. source: where it is, and what its numbers mean.
        message_type: "std_msgs/msg/Float64" and the like. message_class: what rclpy subscribes to.
    """

    quantity: str
    source: Source
    message_type: str
    message_class: Any

    def value(self, message: Any) -> float:
        """The quantity in SI; NaN where this message does not hold it."""
        number = _number(message, self.source)
        if math.isnan(number):
            return number
        return float(self.source.to_si(np.array([number]), CHANNELS[self.quantity].dimension)[0])

    def stamp(self, message: Any) -> int:
        """The header's stamp, ns; 0 where there is none, it is not set, or the map says clock: bag."""
        header = getattr(message, "header", None)
        if header is None or self.source.clock == "bag":
            return 0
        return int(header.stamp.sec) * NANOSECONDS + int(header.stamp.nanosec)


def live_inputs(path: str, valve: str) -> Mapping[str, LiveInput]:
    """The inputs of one valve that a map names, by quantity.

    Args:
        path: the map.
        valve: which of several in it; that of a map of one is taken whatever its name.

    Raises:
        MapError: it cannot be used, is of a table, or names a type that is not installed.
    """
    file = Path(path).expanduser()
    found = load_map(file)
    name, sources = found.choose(valve if len(found.valves) > 1 else None)
    if not {"position", "current"} & set(sources):
        raise MapError(
            f"{file}: of {name}: names neither a position nor a current, of which a live node needs one: "
            "position: {topic: ...}"
        )
    inputs = {}
    for quantity, source in sources.items():
        where = f"{file}: {quantity}"
        if source.column:
            raise MapError(f"{where}: names a column; a live node hears topics: give topic: in its place")
        if quantity == "voltage" and "command" in sources:
            continue
        if quantity == "voltage":
            raise MapError(
                f"{where}: of {name}: a live node needs the commands as they are sent, not a measured voltage; "
                "give command: in its place"
            )
        message_type = source.type or (JOINT_STATE if source.joint else FLOAT)
        if not source.field and not source.joint and message_type not in (FLOAT, "std_msgs/msg/Float32"):
            raise MapError(f"{where}: a {message_type} holds several numbers; choose one with field:")
        inputs[quantity] = LiveInput(quantity, source, message_type, _message_class(message_type, where))
    return inputs


def _message_class(message_type: str, where: str) -> Any:
    package, _, name = message_type.partition("/msg/")
    try:
        if re.fullmatch(r"[a-z]\w*", package) is None:
            raise ImportError
        return getattr(importlib.import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError) as error:
        raise MapError(
            f"{where}.type: found {message_type}, which is not installed here; expected a type such as {FLOAT}; "
            "source the workspace that has it"
        ) from error


def _number(message: Any, source: Source) -> float:
    if source.joint:
        names, values = list(message.name), getattr(message, source.field or "position", ())
        place = names.index(source.joint) if source.joint in names else len(values)
        return float(values[place]) if place < len(values) else math.nan
    found = message
    for step in (source.field or "data").split("."):
        parts = _STEP.fullmatch(step)
        found = getattr(found, parts[1], None) if parts else None
        for index in re.findall(r"\d+", parts[2]) if parts else ():
            found = found[int(index)] if found is not None and int(index) < len(found) else None
    return float(found) if isinstance(found, int | float | np.number) else math.nan
