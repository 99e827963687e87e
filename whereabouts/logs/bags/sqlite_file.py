"""rosbag2's sqlite3 storage (.db3)."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from whereabouts.logs.bags.storage import Stored, Topic, parse_qos
from whereabouts.logs.summary import Summary
from whereabouts.system.log_errors import DamagedLogError

# Overwritten pages may also show as text that is none, or as names that are missing.
_READING_ERRORS = (sqlite3.Error, UnicodeDecodeError, KeyError, OverflowError)


class SqliteFile:
    """A .db3 file, of any schema version; definitions and type hashes are in files of Iron and later.

    Raises DamagedLogError: no database, or without rosbag2's tables.
    """

    def __init__(self, path: Path, summary: Summary, shown: Path | None = None) -> None:
        self.path = path
        self._shown = shown or path
        self._summary = summary
        self._read = 0
        try:
            self._database = _connect(path)
            self._topics = self._read_topics()
            self._last = self._database.execute("SELECT MAX(id) FROM messages").fetchone()[0] or 0
        except _READING_ERRORS as error:
            raise DamagedLogError(
                self._shown, f"is no readable rosbag2 database ({error}); `sqlite3 FILE .recover` may help"
            ) from error

    @property
    def progress(self) -> float:
        return min(self._read / max(self._last, 1), 1.0)

    def close(self) -> None:
        self._database.close()

    def topics(self) -> list[Topic]:
        return list(self._topics.values())

    def messages(self) -> Iterator[Stored]:
        self._read = 0
        row = 0
        try:
            rows = self._database.execute(
                "SELECT id, topic_id, timestamp, data FROM messages ORDER BY timestamp"
            )
            for row, topic_id, timestamp, data in rows:
                self._read += 1
                topic = self._topics.get(topic_id)
                if topic is None or not isinstance(data, bytes) or not isinstance(timestamp, int):
                    self._summary.skip(f"{self._shown.name}: row without topic, time or data", f"row {row}")
                    continue
                yield Stored(topic, data, timestamp, f"row {row}")
        except _READING_ERRORS as error:
            reason = f"{self._shown.name}: database breaks off ({error}), read up to there"
            self._summary.note(reason, f"after row {row}")

    def _read_topics(self) -> dict[int, Topic]:
        definitions = self._definitions()
        topics = {}
        for row in self._rows("SELECT * FROM topics ORDER BY id"):
            text, form = definitions.get(row["type"], ("", "ros2msg"))
            encoding = row.get("serialization_format", "cdr")
            topics[row["id"]] = Topic(
                row["name"],
                row["type"],
                text,
                form,
                row.get("type_description_hash") or "",
                parse_qos(row.get("offered_qos_profiles") or ""),
                problem="" if encoding == "cdr" else f"encoded as {encoding}, CDR expected",
            )
        self._rows("SELECT id, topic_id, timestamp, data FROM messages LIMIT 1")
        return topics

    def _definitions(self) -> dict[str, tuple[str, str]]:
        try:
            rows = self._rows("SELECT * FROM message_definitions")
        except sqlite3.OperationalError:
            return {}
        return {
            row["topic_type"]: (row["encoded_message_definition"], row["encoding"])
            for row in rows
            if row["encoding"] in ("ros2msg", "ros2idl")
        }

    def _rows(self, query: str) -> list[dict[str, Any]]:
        cursor = self._database.execute(query)
        names = [column[0] for column in cursor.description]
        return [dict(zip(names, row, strict=True)) for row in cursor]


def _connect(path: Path) -> sqlite3.Connection:
    """Read-only; the journal that a killed recorder leaves beside the file is honoured where possible."""
    uri = path.resolve().as_uri()
    try:
        database = sqlite3.connect(f"{uri}?mode=ro", uri=True)
        database.execute("SELECT COUNT(*) FROM sqlite_master").fetchone()
        return database
    except sqlite3.OperationalError:  # the directory cannot be written, so a journal cannot be opened
        return sqlite3.connect(f"{uri}?immutable=1", uri=True)
