"""The pages of a SQLite file read without SQLite: what its write-ahead log adds, and every row that a page holds.

For files that SQLite refuses, or reads only in part. The formats are those of sqlite.org/fileformat2.html.
"""

from __future__ import annotations

import os
import re
import struct
from collections import Counter
from collections.abc import Iterator
from functools import cache, cached_property, lru_cache
from hashlib import file_digest, sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from world_model.memory.store_format import PAGE, TABLES, Row, StoreTable

INDEX = (2, 10)
LOG_HEAD, FRAME_HEAD = 32, 24
FRAME = FRAME_HEAD + PAGE
LOG_MAGIC = 0x377F0682.to_bytes(4, "big")
"""Of logs with checksums over words of small-endian machines, the only ones there are."""
LARGEST_ROW = 1 << 20
LOCAL = PAGE - 35
LEAST_LOCAL = (PAGE - 12) * 32 // 255 - 23
CODES = ("0s", "b", "h", "3s", "i", "6s", "q", "d", "0s", "0s")
"""Of the values of serial types 0 to 9, for `struct`."""
OTHERS = (0, 3, 5, 8, 9)
"""Those that it does not know: nothing, integers of 3 and 6 bytes, 0, 1."""
_BY_WIDTH: dict[int, list[StoreTable]] = {}
for _table in TABLES.values():
    _BY_WIDTH.setdefault(len(_table.kinds) + 1, []).append(_table)
# How a record begins: the size of its head, and the type of the key, which is not in it but before it.
_RECORD = re.compile(rb"[\x05-\x40]\x00")
Found = tuple[StoreTable | None, Row]
"""A row and its table, None where it is not as it was written."""


class Pages:
    """A file and the log beside it. `problems` : what is wrong with the log. `log` : its bytes."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb", buffering=0) as file:
            self._head = file.read(PAGE)
            size = os.fstat(file.fileno()).st_size
        beside = Path(f"{path}-wal")
        self.log = beside.read_bytes() if beside.exists() else b""
        self._over, self.problems = read_log(self.log)
        self.count = max(-(-size // PAGE), *self._over, 0)

    @cached_property
    def _content(self) -> bytes:
        return self._path.read_bytes()

    @cached_property
    def digest(self) -> bytes:
        """Of all that is in the file and its log, 32 bytes: the same only where every bit is.

        Read piece by piece: a file that is whole need not be in memory.
        """
        with self._path.open("rb", buffering=0) as file:
            return file_digest(file, lambda: sha256(sha256(self.log).digest())).digest()

    def __getitem__(self, number: int) -> bytes:
        """Page from 1 on; what is missing of it is zero."""
        if number in self._over:
            return self._over[number]
        whole = number == 1 and len(self._head) == PAGE
        page = self._head if whole else self._content[(number - 1) * PAGE : number * PAGE]
        return page.ljust(PAGE, b"\0")

    def rows(self) -> Iterator[tuple[str, Found]]:
        """Where, and which, the rows of tables are; see `rows_of`."""
        for number in range(2, self.count + 1):
            page, where = self[number], f"page {number}"
            if page[0] not in INDEX and any(page[:12]):
                for found in rows_of(self, page):
                    yield where, found


def rows_of(pages: Pages, page: bytes) -> Iterator[Found]:
    """Rows of a page, wherever they lie in it: its head may be damaged, or its list of where they begin.

    A row that is not as it was written has text as bytes.
    """
    at = 8
    while match := _RECORD.search(page, at + 1):
        at = match.start()
        layout = _layout(page[at + 1 : at + page[at]])
        values, end = _values(pages, page, at, *layout) if layout else ([], at)
        for table in _BY_WIDTH.get(len(values), ()):
            if row := table.found(values):
                yield table, row
                at = end - 1
                break
        else:
            if values:
                yield None, tuple(values)


def _values(
    pages: Pages, page: bytes, at: int, packer: struct.Struct, others: list[tuple[int, int]]
) -> tuple[list[Any], int]:
    """What a record at a place of a page says, the key in place of the first value, and where its cell ends."""
    size = page[at] + packer.size
    local = size
    if size > LOCAL:
        local = LEAST_LOCAL + (size - LEAST_LOCAL) % (PAGE - 4)
        local = local if local <= LOCAL else LEAST_LOCAL
    end = at + local
    content = page[at:end]
    if size > local:
        content += _overflow(pages, page[end : end + 4], size - local)
        end += 4
    # The key is read backwards: all but the last byte of a number have their highest bit set.
    start = at - 1
    while page[start - 1] & 128 and start > 8:
        start -= 1
    key = _numbers(page[start:at])
    if len(content) != size or not key:
        return [], at
    values = list(packer.unpack_from(content, page[at]))
    for index, kind in others:
        if kind in (3, 5):
            values[index] = int.from_bytes(values[index], "big", signed=True)
        else:
            values[index] = kind - 8 if kind else None
    values[0] = key[0]
    return values, end


def _overflow(pages: Pages, link: bytes, size: int) -> bytes:
    """So many bytes of a row that goes on in other pages; fewer where it goes on outside the file."""
    parts = []
    while size > 0 and 1 < (number := int.from_bytes(link, "big")) <= pages.count:
        parts.append(pages[number][4 : 4 + size])
        link = pages[number][:4]
        size -= PAGE - 4
    return b"".join(parts)


@lru_cache(4096)
def _layout(head: bytes) -> tuple[struct.Struct, list[tuple[int, int]]] | None:
    """How the values lie in a record with such a head, which many rows share, and those that `struct` does not know;
    None where no table has such rows."""
    kinds = _numbers(head)
    if len(kinds) not in _BY_WIDTH or 10 in kinds or 11 in kinds or sum(kinds) > 2 * LARGEST_ROW:
        return None
    codes = [CODES[kind] if kind < 10 else f"{(kind - 12) // 2}s" for kind in kinds]
    others = [(index, kind) for index, kind in enumerate(kinds) if kind in OTHERS]
    return struct.Struct(f">{''.join(codes)}"), others


def _numbers(data: bytes) -> list[int]:
    """SQLite's variable-length integers, seven bits a byte; below 2^56, as all keys and sizes are."""
    found, value = [], 0
    for byte in data:
        value = value << 7 | byte & 127
        if byte < 128:
            found.append(value)
            value = 0
    return found


def read_log(log: bytes) -> tuple[dict[int, bytes], list[str]]:
    """Pages of a write-ahead log up to its last whole transaction, and what is damaged in it.

    SQLite stops at the first frame that is not as it was written, and says nothing about those behind it. Here every
    frame is checked against the one before. A log that only ends too early is none that is damaged: a process that
    was killed leaves one.
    """
    frames = [log[at : at + FRAME] for at in range(LOG_HEAD, len(log) - FRAME + 1, FRAME)]
    if not frames:
        return {}, []
    head, seeds = log[:LOG_HEAD], {log[24:32], _sums(log[:24], bytes(8))}
    sound = len(seeds) == 1 and head[:4] == LOG_MAGIC
    salts = [frame[8:16] for frame in frames]
    salt = head[16:24] if sound else Counter(salts[:9]).most_common(1)[0][0]
    # What follows the last frame with this salt is left from before the log was begun anew, or was never written.
    last = max((number for number, each in enumerate(salts) if each == salt), default=-1)
    whole = []
    for number, frame in enumerate(frames[: last + 1]):
        computed = {_sums(frame[:8] + frame[FRAME_HEAD:], seed) for seed in seeds}
        # Behind a frame whose own sums are gone nothing can be said; the rows in it have marks of their own.
        unsure = number > 0 and salts[number - 1] != salt
        if salts[number] == salt and (frame[16:24] in computed or unsure):
            whole.append(number)
            seeds = {frame[16:24]}
        else:
            seeds = {frame[16:24], *computed}
    zeros = {number for number, each in enumerate(salts) if not any(each)}
    damaged = sorted({*range(last + 1), *zeros} - set(whole))
    problems = (
        [f"the write-ahead log is damaged at frame {damaged[0] + 1} of {len(frames)}"] if damaged else []
    )
    if whole and not sound:
        problems.append("the head of the write-ahead log is damaged")
    return _pages_in([frames[number] for number in whole], bool(problems)), problems


def _pages_in(frames: list[bytes], damaged: bool) -> dict[int, bytes]:
    """Newest page of each number; where a log is damaged also of transactions whose last frame is not there."""
    over: dict[int, bytes] = {}
    pending: dict[int, bytes] = {}
    for frame in frames:
        number, size = struct.unpack(">2I", frame[:8])
        pending[number] = frame[FRAME_HEAD:]
        if size:
            over |= pending
            pending = {}
    return over | pending if damaged else over


def _sums(data: bytes, sums: bytes) -> bytes:
    """SQLite's running checksum of a log, from two sums to two: s[k + 2] = s[k + 1] + s[k] + words[k] modulo 2^32.

    Being linear, it is one product with the numbers of Fibonacci, the second sum in front, the first in the first word.
    """
    first, second = struct.unpack(">2I", sums)
    words = np.concatenate([np.array([second], np.uint32), np.frombuffer(data, "<u4")])
    words[1:2] += np.uint32(first)
    after = _fibonacci(len(words))
    both = (words * after[:-1]).sum(dtype=np.uint32), (words * after[1:]).sum(dtype=np.uint32)
    return struct.pack(">2I", both[1], both[0])


@cache
def _fibonacci(count: int) -> NDArray[np.uint32]:
    """One more of them than `count`, modulo 2^32, from the largest down to 0."""
    found = [0, 1]
    while len(found) <= count:
        found.append((found[-1] + found[-2]) & 0xFFFFFFFF)
    return np.array(found[::-1], np.uint32)
