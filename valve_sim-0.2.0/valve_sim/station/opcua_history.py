"""The history of an OPC UA server: asyncua's SQLite file, which also takes nodes named by text and whole alarms.

What is kept is on the disk before a client sees it, so that a server that is killed has lost nothing that was seen.
"""

from __future__ import annotations

import sqlite3
from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta, timezone
from pathlib import Path
from typing import Any, Final

import aiosqlite
from asyncua import ua
from asyncua.common.events import Event
from asyncua.server.history_sql import HistorySQLite
from asyncua.ua.ua_binary import variant_to_binary

from valve_sim.model.errors import ValveError

_WRITES_BETWEEN_PRUNINGS: Final = 10_000
_INSERT: Final = 'INSERT INTO "{table}" VALUES (NULL, ?, ?, ?, ?, ?, ?)'


class History(HistorySQLite):
    """Values and alarms of all valves, of the last days that are to be kept.

    Args:
        path: of the SQLite file, made where it is missing. fields: of every alarm event. days: that are kept.
    """

    def __init__(self, path: Path, fields: Sequence[str], days: float) -> None:
        super().__init__(str(path))
        self._path, self._fields, self._days = path, tuple(fields), days
        self._written = 0

    async def init(self) -> None:
        """Open the file.

        Raises:
            ValveError: it cannot be opened, or is damaged.
        """
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            await super().init()
            # A commit is on the disk when it returns; a reader does not wait for a writer.
            await self._db.execute("PRAGMA journal_mode=WAL")
            await self._db.execute("PRAGMA synchronous=FULL")
            async with self._db.execute("SELECT name FROM sqlite_master LIMIT 1") as cursor:
                await cursor.fetchone()
        except (OSError, sqlite3.Error, aiosqlite.Error) as error:
            raise ValveError(
                f"{self._path}: cannot be used as a history ({error}); move it away, or choose another folder"
            ) from error

    async def add_variable(self, node: Any) -> None:
        """Keep the history of a variable."""
        await self._make(self._get_table_name(node), "ServerTimestamp TIMESTAMP, SourceTimestamp TIMESTAMP, StatusCode "
                         "INTEGER, Value TEXT, VariantType TEXT, VariantBinary BLOB", "SourceTimestamp")  # fmt: skip

    async def add_source(self, node: Any) -> None:
        """Keep the history of a source's alarms."""
        self._event_fields[node] = list(self._fields)
        columns = ", ".join(f'"{name}" BLOB' for name in self._fields)
        await self._make(
            self._get_table_name(node), f"_Timestamp TIMESTAMP, _EventTypeName TEXT, {columns}", "_Timestamp"
        )

    async def save_values(self, values: Mapping[Any, Any]) -> None:
        """Keep values, all or none.

        Args:
            values: node to its DataValue.

        Raises:
            ValveError: the file cannot be written, as where the disk is full.
        """
        rows = [
            (
                _INSERT.format(table=self._get_table_name(node)),
                (
                    value.ServerTimestamp,
                    value.SourceTimestamp,
                    value.StatusCode.value,
                    str(value.Value.Value),
                    value.Value.VariantType.name,
                    sqlite3.Binary(variant_to_binary(value.Value)),
                ),
            )
            for node, value in values.items()
        ]
        await self._write(rows)

    async def save_alarm(self, source: Any, event: Any) -> None:
        """Keep an alarm's event.

        Raises:
            ValveError: the file cannot be written.
        """
        fields = event.get_event_props_as_fields_dict()
        names = ", ".join(f'"{name}"' for name in ("_Timestamp", "_EventTypeName", *fields))
        places = ", ".join("?" * (len(fields) + 2))
        statement = f'INSERT INTO "{self._get_table_name(source)}" ({names}) VALUES ({places})'
        blobs = (sqlite3.Binary(variant_to_binary(value)) for value in fields.values())
        await self._write([(statement, (event.Time, str(event.EventType), *blobs))])

    async def last_value(self, node: Any) -> Any:
        """The DataValue of a variable that was kept last; None if there is none."""
        found, _ = await self.read_node_history(node, None, None, 1)
        return found[0] if found else None

    async def prune(self, now: datetime) -> None:
        """Take out what is older than the days that are kept; `now` in UTC."""
        limit = now - timedelta(days=self._days)
        async with self._db.execute("SELECT name FROM sqlite_master WHERE type = 'index'") as cursor:
            indices = [str(row[0]) async for row in cursor]
        for index in indices:
            table, _, column = index.rpartition("|")
            if table:
                await self._db.execute(f'DELETE FROM "{table}" WHERE "{column}" < ?', (limit,))
        await self._db.commit()

    async def _make(self, table: str, columns: str, time: str) -> None:
        await self._db.execute(f'CREATE TABLE IF NOT EXISTS "{table}" (_Id INTEGER PRIMARY KEY NOT NULL, {columns})')
        await self._db.execute(f'CREATE INDEX IF NOT EXISTS "{table}|{time}" ON "{table}" ("{time}")')
        await self._db.commit()

    async def _write(self, rows: Sequence[tuple[str, tuple[Any, ...]]]) -> None:
        try:
            for statement, values in rows:
                await self._db.execute(statement, values)
            await self._db.commit()
        except (sqlite3.Error, aiosqlite.Error) as error:
            await self._db.rollback()
            raise ValveError(f"{self._path}: cannot be written ({error}); make room on the disk") from error
        self._written += len(rows)
        if self._written >= _WRITES_BETWEEN_PRUNINGS:
            self._written = 0
            await self.prune(datetime.now(timezone.utc))

    def _get_table_name(self, node_id: Any) -> str:
        # asyncua's own name of a table has quotes where a node's identifier is text, and is then refused by itself.
        return f"{node_id.NamespaceIndex}_{node_id.Identifier}"

    def _get_select_clauses(self, source_id: Any, evfilter: Any) -> tuple[list[str], str]:
        # asyncua's own looks at the first name of a path alone, so that ActiveState/Id would be ActiveState.
        wanted = [
            Event.browse_path_to_attribute_name(clause.BrowsePath)
            if clause.BrowsePath
            else ua.AttributeIds(clause.AttributeId).name
            for clause in evfilter.SelectClauses
        ]
        known = [name for name in dict.fromkeys(wanted) if name in self._event_fields[source_id]]
        return known, self._list_to_sql_str(known)
