"""SQLite files of rosbag2, with the log of what a killed recorder had not finished: ahead, or to be undone."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from valve_sim.recordings.cdr import full_type
from valve_sim.recordings.mcap_files import Contents

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from valve_sim.recordings.topics import Topic

SQLITE_MAGIC: Final = b"SQLite format 3\0"


def read_database(path: Path, topics: Mapping[str, Topic]) -> Contents:
    """Read a database up to a damage; arguments: see `mcap_files.read_records`."""
    logs = [log for end in ("-wal", "-journal") if (log := Path(f"{path}{end}")).exists() and log.stat().st_size]
    if not logs:
        return _read(f"{path.absolute().as_uri()}?immutable=1", topics)
    with tempfile.TemporaryDirectory() as folder:  # SQLite would merge the log into the recording itself
        for file in (path, *logs):
            shutil.copyfile(file, Path(folder) / file.name)
        return _read((Path(folder) / path.name).as_uri(), topics)


def _read(uri: str, topics: Mapping[str, Topic]) -> Contents:
    found = Contents(complete=True)
    with closing(sqlite3.connect(uri, uri=True)) as connection:
        # Without it SQLite refuses a file that was cut before it reads one row.
        list(_rows(connection, "PRAGMA writable_schema=ON", found))
        tables = {name for (name,) in _rows(connection, "SELECT name FROM sqlite_master WHERE type = 'table'", found)}
        if not {"topics", "messages"} <= tables:  # a view may go on for ever
            return Contents()
        names = _topics(connection, found)
        for kind, encoding, text in _rows(
            connection, "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions", Contents()
        ):
            if isinstance(text, str):
                found.definitions[full_type(str(kind))] = (str(encoding), text)
        for number, time, payload in _rows(connection, "SELECT topic_id, timestamp, data FROM messages", found):
            # Of a row on a damaged page, any column may be missing or of another kind.
            if number in names and isinstance(time, int) and isinstance(payload, bytes):
                found.count += 1
                topic = topics.get(names[number])
                if topic is not None:
                    topic.add(time, payload)
    return found


def _topics(connection: sqlite3.Connection, found: Contents) -> dict[int, str]:
    names = {}
    for number, name, kind, encoding in _rows(
        connection, "SELECT id, name, type, serialization_format FROM topics", found
    ):
        if isinstance(name, str) and isinstance(kind, str):
            if encoding == "cdr":
                names[number] = found.add_topic(name, full_type(kind))
            else:
                found.encodings.add(str(encoding))
    return names


def _rows(connection: sqlite3.Connection, query: str, found: Contents) -> Iterator[tuple[Any, ...]]:
    """Rows up to the first that cannot be read."""
    try:
        yield from connection.execute(query)
    except (sqlite3.Error, MemoryError):  # a damaged page, or one that claims terabytes: what came before it is kept
        found.complete = False
