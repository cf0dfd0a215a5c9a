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
from valve_sim.traces.salvage import full_type

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from valve_sim.files.recording_map import Source
    from valve_sim.traces.batches import Batch
    from valve_sim.traces.cdr import Definitions
    from valve_sim.traces.packed_times import PackedTimes

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


def stamps_of(
    batches: Sequence[Batch], bag_times: PackedTimes, *, may_be_zero: bool
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return when each of n messages was taken by its header, ns, and (n,) whether it says; else its bag time."""
    stamps, is_stamped = bag_times.array(), np.zeros(len(bag_times), dtype=bool)
    for batch in batches:
        if batch.stamps is not None:
            taken = batch.stamps.array()
            usable = np.full(batch.size, True) if may_be_zero else taken != 0
            is_stamped[batch.where] = usable
            np.copyto(taken, stamps[batch.where], where=~usable)
            stamps[batch.where] = taken
    return stamps, is_stamped


def values_of(batches: Sequence[Batch], count: int, source: Source) -> tuple[NDArray[np.float64], Batch | None]:
    """Return the numbers of one field of so many messages, and the last batch without it; NaN in messages without it.

    Where all messages are of one layout it is a view of what was read: of a long recording a copy is large.
    """
    parts = [(batch, field_values(batch, source)) for batch in batches]
    without = [batch for batch, found in parts if found is None]
    batch, found = parts[0]
    if found is not None and isinstance(batch.where, slice) and batch.size == count:
        return found, None
    values = np.full(count, np.nan)
    for batch, found in parts:
        if found is not None:
            values[batch.where] = found
    return values, without[-1] if without else None


def field_values(batch: Batch, source: Source) -> NDArray[np.float64] | None:
    """The numbers of one field, shape (n,); None where messages of this layout do not have it."""
    if source.joint:
        return _of_joint(batch, source)
    path = source.field or only_number(batch)
    if path is None:
        return None
    if path in batch.layout.fields:
        return _number(batch, path, 0) if batch.layout.fields[path].size == 1 else None
    indexed = INDEXED.fullmatch(path)
    return None if indexed is None else _number(batch, indexed[1], int(indexed[2]))


def _number(batch: Batch, path: str, place: int) -> NDArray[np.float64] | None:
    """One of the numbers of a field, shape (n,), those of a double as they lie in memory; None: there are fewer."""
    field = batch.layout.fields.get(path)
    if field is None or place >= field.size:
        return None
    return np.asarray(batch.numbers(path, place), dtype=np.float64)


def _of_joint(batch: Batch, source: Source) -> NDArray[np.float64] | None:
    names, path = batch.layout.texts.get("name", ()), source.field or "position"
    return _number(batch, path, names.index(source.joint)) if source.joint in names else None


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
