"""How the store's rows lie in its file: tables, the mark of each row, and the tally over all of them.

Every row carries a mark, a hash over its table's name and its values: a row says by itself whether it is whole, also
where nothing leads to it any more. The row of `clock` counts the rows of every table and sums their marks, so that one
that is missing, or an old one that came back, shows as well.
"""

from __future__ import annotations

import math
import re
import sqlite3
import struct
from collections.abc import Callable, Iterable, Sequence
from hashlib import blake2b
from operator import itemgetter
from typing import Any, NamedTuple

from world_model.memory.store_rows import COLUMNS

FIRST_VERSION = 1  # Without marks; taken over when it is opened
VERSION = 202611
"""Year and month of the format. A next one differs in two bits or more: one bit is a damage, not a version."""
APPLICATION = 0x77686272  # Marks the file as a world model's among all that SQLite may have written
PAGE = 4096
MAGIC = b"SQLite format 3\0"
HEAD = re.compile(
    rb"SQLite format 3\0\x10\0(\x01\x01|\x02\x02)\0\x40\x20\x20.{20}\0\0\0\x04.{4}\0{7}\x01.{4}\0{4}.{4}\0{20}",
    re.DOTALL,
)
"""How it begins: size of pages, how it is written and read, what pages keep free, layout, root, encoding; between them
what differs."""

Row = tuple[Any, ...]
Picked = Callable[[Sequence[Any]], Row]

_OBJECT = (
    "numbers BLOB NOT NULL, existence REAL NOT NULL, lost INTEGER NOT NULL, last_seen REAL NOT NULL, "
    "first_seen REAL NOT NULL, attributes TEXT NOT NULL, behaviors TEXT NOT NULL, region TEXT"
)
SCHEMA = f"""
CREATE TABLE clock (one INTEGER PRIMARY KEY CHECK (one = 1), epoch INTEGER NOT NULL, stamp REAL,
  identity TEXT NOT NULL, sequence INTEGER NOT NULL, runs INTEGER NOT NULL, names INTEGER NOT NULL,
  present INTEGER NOT NULL, past INTEGER NOT NULL, total INTEGER NOT NULL, mark INTEGER NOT NULL);
CREATE TABLE epochs (epoch INTEGER PRIMARY KEY, first_stamp REAL, last_stamp REAL, mark INTEGER NOT NULL);
CREATE TABLE objects (key INTEGER PRIMARY KEY, epoch INTEGER NOT NULL, id TEXT NOT NULL, mark INTEGER NOT NULL,
  UNIQUE (epoch, id));
CREATE TABLE current (key INTEGER PRIMARY KEY, {_OBJECT}, mark INTEGER NOT NULL);
CREATE TABLE names (key INTEGER PRIMARY KEY, epoch INTEGER NOT NULL, id TEXT NOT NULL, mark INTEGER NOT NULL);
CREATE TABLE history (row INTEGER PRIMARY KEY, key INTEGER NOT NULL, stamp REAL NOT NULL, event TEXT NOT NULL,
  level INTEGER NOT NULL, {_OBJECT}, mark INTEGER NOT NULL);
"""
INDICES = """
CREATE INDEX history_by_object ON history (key, stamp);
CREATE INDEX history_by_level ON history (level, row);
"""


class StoreTable:
    """One table. columns : without the mark, the integer key first. kinds : a letter for each column, i integer,
    r real, t text, b bytes. insert : statement that takes a row and its mark."""

    def __init__(self, name: str, columns: str, kinds: str) -> None:
        self.name, self.columns, self.kinds = name, columns, kinds
        self.insert = f"INSERT OR REPLACE INTO {name} VALUES ({', '.join('?' * (len(kinds) + 1))})"
        whole, real, text = (
            [index for index, kind in enumerate(kinds) if kind in letters] for letters in ("i", "r", "tb")
        )
        self._packer = struct.Struct(f"<{len(whole)}q{len(real)}d{len(text)}q")
        self._whole, self._real, self._text = _picked(whole), _picked(real), _picked(text)
        self._person = name.encode()
        self._texts = [index for index in text if kinds[index] == "t"]
        self._blobs = [kind == "b" for kind in kinds] + [False]

    def mark(self, values: Sequence[Any]) -> int:
        """Hash (64 bits, signed) of a row. Raises AttributeError, TypeError, ValueError or struct.error for
        values of other kinds."""
        texts = self._text(values)
        parts = [b"" if part is None else part if type(part) is bytes else part.encode() for part in texts]
        packed = self._packer.pack(
            *self._whole(values),
            *[math.nan if value is None else value + 0.0 for value in self._real(values)],
            *[-1 if value is None else len(part) for value, part in zip(texts, parts, strict=True)],
        )
        digest = blake2b(packed + b"".join(parts), digest_size=8, person=self._person).digest()
        return int.from_bytes(digest, "little", signed=True)

    def marked(self, values: Row) -> Row:
        """The row of these values."""
        return (*values, self.mark(values))

    def is_whole(self, row: Sequence[Any]) -> bool:
        """Whether a row, its mark last, is as it was written."""
        try:
            # To a mark text and bytes are the same; a damage makes one of the other.
            return [type(value) is bytes for value in row] == self._blobs and self.mark(row) == row[-1]
        except (AttributeError, TypeError, ValueError, struct.error):
            return False

    def found(self, values: list[Any]) -> Row | None:
        """The row that has these values in a page, text as bytes; None where it is not as it was written."""
        row = [*values]
        try:
            for index in self._texts:
                row[index] = None if row[index] is None else row[index].decode()
        except (AttributeError, UnicodeDecodeError):
            return None
        return tuple(row) if self.is_whole(row) else None


def _picked(places: list[int]) -> Picked:
    """Takes what is at these places of a row; rows are many."""
    if len(places) > 1:
        return itemgetter(*places)
    return lambda values: tuple(values[place] for place in places)


CLOCK = StoreTable(
    "clock", "one, epoch, stamp, identity, sequence, runs, names, present, past, total", "iirtiiiiii"
)
EPOCHS = StoreTable("epochs", "epoch, first_stamp, last_stamp", "irr")
OBJECTS = StoreTable("objects", "key, epoch, id", "iit")
NAMES = StoreTable("names", "key, epoch, id", "iit")
"""The same as `objects`, on other pages: without its name the whole history of an object is worth nothing."""
CURRENT = StoreTable("current", f"key, {COLUMNS}", "ibrirrttt")
HISTORY = StoreTable("history", f"row, key, stamp, event, level, {COLUMNS}", "iirtibrirrttt")
COUNTED = (EPOCHS, OBJECTS, NAMES, CURRENT, HISTORY)
TABLES = {table.name: table for table in (*COUNTED, CLOCK)}


class StoreClock(NamedTuple):
    """The row of `clock`: the newest run and stamp, whose file it is, its transactions, and the tally.

    runs, names, present, past : rows of epochs, objects (and names), current, history; total : sum of all their marks.
    """

    epoch: int = 0
    stamp: float | None = None
    identity: str = ""
    sequence: int = 0
    runs: int = 0
    names: int = 0
    present: int = 0
    past: int = 0
    total: int = 0

    @classmethod
    def of(cls, connection: sqlite3.Connection) -> StoreClock:
        """Of a file that is whole."""
        return cls(*connection.execute("SELECT * FROM clock").fetchone()[1:-1])

    @property
    def row(self) -> Row:
        """As it is stored, with its mark."""
        return CLOCK.marked((1, *self))

    @property
    def counts(self) -> tuple[int, ...]:
        """Rows in the tables `COUNTED`."""
        return self.runs, self.names, self.names, self.present, self.past


def summed(marks: Iterable[int]) -> int:
    """Sum of marks as 64 bits, signed: does not depend on the order, and one mark can be taken out again."""
    return (sum(marks) + (1 << 63)) % (1 << 64) - (1 << 63)


def version_of(page: bytes) -> int:
    """Version that the head of a file names; 0 where it is no store's."""
    return int.from_bytes(page[60:64], "big") if page[68:72] == APPLICATION.to_bytes(4, "big") else 0
