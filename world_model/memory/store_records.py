"""What the store remembers, read back: the last world, the world at any time, the history of an object."""

from __future__ import annotations

import sqlite3
from bisect import bisect_left
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.checks import as_stamp, require_word
from estimation.geometry.places import LIKELY, Place, Places
from world_model.memory.store_file import StoreError, StoreFile
from world_model.memory.store_format import StoreClock
from world_model.memory.store_rows import COLUMNS, EVENT, NAME, RUN, Written, decode, places_of
from world_model.state import WorldObject
from world_model.symbols import parse_symbol

REACH = 1.0  # m around a place from which nothing is there more probably than not
NEWEST_FIRST = "ORDER BY h.stamp DESC, h.row DESC"
SIGHT = "h.stamp, h.event, substr(h.numbers, 1, 24), h.existence, h.lost, h.last_seen, h.first_seen"
Sight = tuple[float, str, bytes, float, int, float, float]
"""Stamp, event, position (3 × 8 bytes), existence, whether it is lost, when it was last and first seen."""
AT_ONCE = 5000  # Rows of history that are sooner looked through than objects one by one


@dataclass(frozen=True)
class Memory:
    """What a store remembers. objects : of the most probable world. stamp, epoch : of the last message. names : the
    highest number used for each class, so that no symbol is given twice."""

    objects: tuple[WorldObject, ...]
    stamp: float
    epoch: int
    names: dict[str, int]


@dataclass(frozen=True)
class HistoryEntry:
    """One event of an object: appeared, moved, changed, seen, lost, found, gone, returned or renamed, at `stamp`."""

    stamp: float
    event: str
    object: WorldObject
    epoch: int


class Records:
    """The reading part of `Store`."""

    _file: StoreFile
    _clock: StoreClock
    _written: dict[str, Written]

    @property
    def data_version(self) -> int:
        """Another number whenever another process has written since."""
        return int(self._value("PRAGMA data_version"))

    def restore(self) -> Memory | None:
        """What was known at the last message, for a new `WorldModel`; None where nothing is remembered."""
        epoch, stamp, *_ = self._clock
        if stamp is None and epoch == 0 and not self._written:
            return None
        numbers: dict[str, int] = {}
        for (name,) in self._execute("SELECT id FROM objects WHERE epoch = ?", epoch):
            parsed = parse_symbol(name)
            if parsed is not None:
                numbers[parsed[0]] = max(numbers.get(parsed[0], 0), parsed[1])
        return Memory(tuple(self.present()), -float("inf") if stamp is None else stamp, epoch, numbers)

    def places(self, stamp: float = float("inf")) -> Places:
        """Rooms and furniture as they were at `stamp`, s; the first ones before that. Empty where none were kept."""
        text = self._places_row(stamp) or self._places_row()
        return places_of(text) if text else Places()

    def _places_row(self, stamp: float = float("inf")) -> str:
        order = "AND h.stamp <= ? ORDER BY h.row DESC LIMIT 1"
        found = self._of(NAME, RUN, "h.attributes", order, stamp).fetchone()
        return str(found[0]) if found else ""

    def epochs(self) -> list[tuple[int, float | None, float | None]]:
        """All runs: number, first and last stamp."""
        return list(
            self._execute("SELECT epoch, first_stamp, last_stamp FROM epochs WHERE epoch >= 0 ORDER BY epoch")
        )

    def objects_at(self, stamp: float, epoch: int | None = None) -> list[WorldObject]:
        """All objects as they were known at `stamp`, of the newest run that had begun by then or of `epoch`.

        Covariances have grown by the process noise since the last row.
        """
        stamp = as_stamp("stamp", stamp)
        begun = "SELECT max(epoch) FROM epochs WHERE first_stamp <= ? AND epoch >= 0"
        run = self._value(begun, stamp) if epoch is None else epoch
        rows = self._execute(
            f"SELECT o.id, h.stamp, h.event, {COLUMNS} FROM objects o JOIN history h ON h.row = "
            "(SELECT row FROM history WHERE key = o.key AND stamp <= ? ORDER BY stamp DESC, row DESC LIMIT 1) "
            "WHERE o.epoch = ? AND h.event != 'gone' ORDER BY o.key",
            stamp,
            run,
        )
        return [_aged(decode(name, tuple(values)), stamp - then) for name, then, _, *values in rows]

    def last_seen(self, place: Place, epoch: int | None = None) -> float | None:
        """The newest stamp at which something was measured at a place in a run (this one by default), None if never."""
        low, high = place.polygon.min(0) - REACH, place.polygon.max(0) + REACH
        rows = self._execute(
            "SELECT DISTINCT h.numbers, h.last_seen FROM history h JOIN objects o ON o.key = h.key "
            "WHERE o.epoch = ? AND NOT h.lost ORDER BY h.last_seen DESC",
            self._clock.epoch if epoch is None else epoch,
        )
        for numbers, seen in rows:
            values = np.frombuffer(numbers, "<f8")
            inside = (values[:2] >= low).all() and (values[:2] <= high).all()
            if inside and place.probability(values[:3], values[6:15].reshape(3, 3)) > LIKELY:
                return float(seen)
        return None

    def history(
        self,
        object_id: str,
        epoch: int | None = None,
        start: float = -float("inf"),
        end: float = float("inf"),
    ) -> list[HistoryEntry]:
        """Events of one object, oldest first, in the newest run that knew it or in `epoch`."""
        newest = "SELECT max(epoch) FROM objects WHERE id = ?"
        run = self._value(newest, require_word("object_id", object_id)) if epoch is None else epoch
        order = "AND h.stamp BETWEEN ? AND ? ORDER BY h.stamp, h.row"
        rows = self._of(object_id, run, f"h.stamp, h.event, {COLUMNS}", order, start, end)
        return [
            HistoryEntry(stamp, happened, decode(object_id, tuple(values)), run)
            for stamp, happened, *values in rows
        ]

    def events(self, epoch: int | None = None) -> Iterable[tuple[float, str, str]]:
        """All events of a run (the newest by default) in order of time: stamp, event, object id."""
        return self._execute(
            "SELECT h.stamp, h.event, o.id FROM history h JOIN objects o ON o.key = h.key WHERE o.epoch = ? "
            "ORDER BY h.stamp, h.row",
            self._clock.epoch if epoch is None else epoch,
        )

    # For questions: read from the file, also while another process writes to it.

    def newest(self) -> tuple[int, float | None, int]:
        """Run, stamp and number of the last message that the file has."""
        clock = StoreClock.of(self._file.connection)
        return clock.epoch, clock.stamp, clock.sequence

    def present(self) -> list[WorldObject]:
        """The objects of the last message that the file has."""
        rows = self._execute(
            f"SELECT o.id, {COLUMNS} FROM current c JOIN objects o ON o.key = c.key ORDER BY c.key"
        )
        return [decode(name, tuple(values)) for name, *values in rows]

    def names(self) -> dict[str, int]:
        """The newest run of every object that was ever known, by id."""
        return dict(self._execute("SELECT id, epoch FROM objects WHERE epoch >= 0 ORDER BY epoch"))

    def sights(
        self, object_id: str, epoch: int, start: float = -float("inf"), end: float = float("inf")
    ) -> list[Sight]:
        """History of an object in a run, oldest first, from the last row before `start` on."""
        before = "ifnull((SELECT max(stamp) FROM history WHERE key = o.key AND stamp <= ?), ?)"
        order = f"AND h.stamp BETWEEN {before} AND ? ORDER BY h.stamp, h.row"
        return self._of(object_id, epoch, SIGHT, order, start, start, end).fetchall()

    def happened(self, start: float, most: int) -> tuple[dict[str, list[Sight]], float]:
        """History of all objects of the newest run since a stamp, oldest first, without rows that only say that
        something was seen again; and since when it is complete: more than the newest `most` rows are not read."""
        newest = self._newest_row()
        # Rows lie in the order in which they were written: this is read from one end, without an index.
        first = self._row_at(start, newest) - 1
        if first < newest - most:
            first = newest - most
            oldest = self._value("SELECT stamp FROM history WHERE row > ? ORDER BY row LIMIT 1", first)
            start = max(start, float(oldest))
        of_run = "SELECT key, id FROM objects WHERE epoch = (SELECT epoch FROM clock)"
        ids: dict[int, str] = dict(self._execute(of_run).fetchall())
        found: dict[str, list[Sight]] = {}
        rows = self._execute(
            f"SELECT h.key, {SIGHT} FROM history h WHERE h.row > ? AND h.stamp >= ? AND h.event != 'seen' "
            "ORDER BY h.row",
            first,
            start,
        )
        for row in rows.fetchall():
            if row[0] in ids:
                found.setdefault(ids[row[0]], []).append(row[1:])
        return found, start

    def _row_at(self, stamp: float, newest: int) -> int:
        """First row of the newest run from which on all have at least this stamp."""
        # Rows lie in the order in which they were written, keys in the order in which objects were first met.
        first = self._value("SELECT min(key) FROM objects WHERE epoch = (SELECT epoch FROM clock)")
        if first is None:
            return newest + 1
        later = (
            "SELECT key >= ? AND stamp >= ? FROM history WHERE row >= ? AND event != ? ORDER BY row LIMIT 1"
        )
        return bisect_left(
            range(newest + 1), True, key=lambda row: self._value(later, first, stamp, row, EVENT) != 0
        )

    def lives(self, prefix: str) -> list[tuple[str, float, float, str]]:
        """Objects of the newest run whose id begins so: id, first and last seen, JSON of the attributes."""
        return self._execute(
            "SELECT o.id, h.first_seen, h.last_seen, h.attributes FROM objects o JOIN history h ON h.row = "
            "(SELECT row FROM history WHERE key = o.key ORDER BY stamp DESC, row DESC LIMIT 1) "
            "WHERE o.epoch = (SELECT epoch FROM clock) AND substr(o.id, 1, ?) = ?",
            len(prefix),
            prefix,
        ).fetchall()

    def look(self, object_id: str, epoch: int, first: bool = False) -> WorldObject | None:
        """The newest row of history of an object, or the first."""
        order = "ORDER BY h.stamp, h.row" if first else NEWEST_FIRST
        found = self._of(object_id, epoch, COLUMNS, f"{order} LIMIT 1").fetchone()
        return None if found is None else decode(object_id, tuple(found))

    def active(self, start: float, end: float) -> list[str]:
        """Objects of the newest run with history between two stamps."""
        newest = self._newest_row()
        first = self._row_at(start, newest)
        few = "o.key IN (SELECT key FROM history WHERE row >= ? AND stamp BETWEEN ? AND ?)"
        many = "EXISTS (SELECT 1 FROM history h WHERE h.key = o.key AND h.stamp BETWEEN ? AND ?)"
        if newest - first < AT_ONCE:
            return self._these(few, first, start, end)
        return self._these(many, start, end)

    def departed(self, start: float) -> list[str]:
        """Objects of the newest run that went, or were lost, since a stamp."""
        first = self._row_at(start, self._newest_row())
        went = "SELECT key FROM history WHERE row >= ? AND stamp >= ? AND event IN ('gone', 'lost')"
        return self._these(f"o.key IN ({went})", first, start)

    def _these(self, which: str, *values: Any) -> list[str]:
        """Objects of the newest run, in the order in which they were met."""
        of_run = "SELECT o.id FROM objects o WHERE o.epoch = (SELECT epoch FROM clock)"
        return [name for (name,) in self._execute(f"{of_run} AND {which} ORDER BY o.key", *values)]

    def _of(self, object_id: str, epoch: int, columns: str, rest: str, *values: Any) -> sqlite3.Cursor:
        """Columns of the history of an object in a run."""
        rows = "history h JOIN objects o ON o.key = h.key WHERE o.id = ? AND o.epoch = ?"
        return self._execute(f"SELECT {columns} FROM {rows} {rest}", object_id, epoch, *values)

    def _newest_row(self) -> int:
        return self._value("SELECT max(row) FROM history") or 0

    def _value(self, statement: str, *values: Any) -> Any:
        """The first value of the first row, None where there is none."""
        found = self._execute(statement, *values).fetchone()
        return found[0] if found else None

    def _execute(self, statement: str, *values: Any) -> sqlite3.Cursor:
        try:
            return self._file.connection.execute(statement, values)
        # It is closed, or was asked for what no row can hold.
        except (sqlite3.ProgrammingError, OverflowError) as error:
            raise StoreError(f"{self._file.path}: {error}") from error


def _aged(item: WorldObject, age: float) -> WorldObject:
    """An object of which nothing was heard for `age` seconds."""
    if age <= 0.0 or item.lost or not item.process_noise.any():
        return item
    return replace(item, covariance=item.covariance + age * item.process_noise)
