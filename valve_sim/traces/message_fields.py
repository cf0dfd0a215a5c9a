"""Numbers out of messages of any type: a field by its dotted path, types by the definitions in the recording."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from rosbags.interfaces import MessageDefinitionFormat
from rosbags.rosbag2 import Reader
from rosbags.typesys import get_types_from_idl, get_types_from_msg

from valve_sim.traces.cdr import typestore
from valve_sim.traces.clocks import SECOND
from valve_sim.traces.salvage import full_type

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from valve_sim.files.recording_map import Source
    from valve_sim.traces.cdr import Batch, Definitions

INDEXED = re.compile(r"(.+)\[(\d+)\]")


def definitions_of(path: Path, message_type: str) -> Definitions | None:
    """Definitions of a message type and of those in it: the usual ones, or those that the recording holds.

    None: nobody knows. The definitions are parsed, never run.
    """
    usual: Definitions = typestore().fielddefs
    if message_type in usual:
        return usual
    try:
        with Reader(path) as reader:
            for connection in reader.connections:
                if full_type(connection.msgtype) == message_type:
                    found = _parsed(connection.msgdef.format, connection.msgdef.data, message_type)
                    if found:
                        return {**usual, **found}
    except Exception:  # a damaged file, or a definition that is none: the library raises what it stumbles over
        return None
    return None


def _parsed(kind: MessageDefinitionFormat, text: str, message_type: str) -> Mapping[str, Any]:
    if kind == MessageDefinitionFormat.MSG:
        return get_types_from_msg(text, message_type)
    return get_types_from_idl(text) if kind == MessageDefinitionFormat.IDL else {}


def has_stamp(batch: Batch) -> bool:
    """Whether messages of this layout have a header."""
    return "header.stamp.sec" in batch.layout.fields


def stamps(batch: Batch) -> NDArray[np.int64]:
    """Header stamps, ns, shape (n,)."""
    seconds, nanoseconds = batch.column("header.stamp.sec"), batch.column("header.stamp.nanosec")
    return np.asarray(seconds[:, 0].astype(np.int64) * SECOND + nanoseconds[:, 0].astype(np.int64))


def field_values(batch: Batch, source: Source) -> NDArray[np.float64] | None:
    """The numbers of one field, shape (n,); None where messages of this layout do not have it."""
    if source.joint:
        return _of_joint(batch, source)
    path = source.field or only_number(batch)
    if path is None:
        return None
    if path in batch.layout.fields:
        values = batch.column(path)
        return np.asarray(values[:, 0], dtype=np.float64) if values.shape[1] == 1 else None
    indexed = INDEXED.fullmatch(path)
    if indexed is None or indexed[1] not in batch.layout.fields:
        return None
    values, place = batch.column(indexed[1]), int(indexed[2])
    return np.asarray(values[:, place], dtype=np.float64) if place < values.shape[1] else None


def _of_joint(batch: Batch, source: Source) -> NDArray[np.float64] | None:
    names, path = batch.layout.texts.get("name", ()), source.field or "position"
    if source.joint not in names or path not in batch.layout.fields:
        return None
    values, place = batch.column(path), names.index(source.joint)
    return np.asarray(values[:, place], dtype=np.float64) if place < values.shape[1] else None


def only_number(batch: Batch) -> str | None:
    """The path of the only number that the messages hold beside their header; None where there are several."""
    paths = number_paths(batch)
    return paths[0] if len(paths) == 1 else None


def number_paths(batch: Batch) -> list[str]:
    """Every number that messages of this layout hold beside their header: "point.x", "position[0]"."""
    paths = []
    for path, field in batch.layout.fields.items():
        if path.startswith("header."):
            continue
        # A list has an index even if it has one number now: that of the next message may be longer.
        is_list = field.size != 1 or _is_list(path)
        paths += [f"{path}[{place}]" for place in range(field.size)] if is_list else [path]
    return paths


def _is_list(path: str) -> bool:
    return path in ("position", "velocity", "effort")


def missing_field(batch: Batch, source: Source) -> str:
    """What to say of a source that messages of this layout do not have: what was asked for, and what there is."""
    names = batch.layout.texts.get("name", ())
    if source.joint and "name" in batch.layout.texts:
        return f"names {', '.join(names) or 'no joint'}, expected {source.joint}"
    listed = number_paths(batch)
    has = ", ".join(listed[:24]) + (f" and {len(listed) - 24} more" if len(listed) > 24 else "") or "no number"
    if source.joint:
        return f"has no joint names, expected {source.joint} among them; it has {has}; give field: in place of joint:"
    if not source.field:
        return f"holds several numbers ({has}); choose one with field:"
    return f"has no number {source.field}; it has {has}; choose one with field:"
