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
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from world_model.memory.store_format import PAGE

LEAF = 13
INDEX = (2, 10)
LOG_HEAD, FRAME_HEAD = 32, 24
FRAME = FRAME_HEAD + PAGE
LOG_MAGIC = 0x377F0682.to_bytes(4, "big")
"""Of logs with checksums over words of small-endian machines, the only ones there are."""
LARGEST_ROW = 1 << 20
PIECE = 1 << 18  # Bytes that are read at once, where all are looked at once
LOCAL = PAGE - 35
LEAST_LOCAL = (PAGE - 12) * 32 // 255 - 23
SIZES = (0, 1, 2, 3, 4, 6, 8, 8, 0, 0)  # Bytes of the values of serial types 0 to 9
_CODES = {1: "b", 2: "h", 4: "i", 6: "q", 7: "d"}
_MASK = 0xFFFFFFFF
# How a record begins: the size of its head, and the type of the key, which is not in it.
_RECORD = re.compile(rb"[\x05-\x40]\x00")
Sums = tuple[int, int]


class Pages:
    """A file and the log beside it. `problems` : what is wrong with the log. `log_size` : bytes of it."""

    def __init__(self, path: Path) -> None:
        self._path = path
        with path.open("rb", buffering=0) as file:
            self._head = file.read(PAGE)
            size = os.fstat(file.fileno()).st_size
        beside = Path(f"{path}-wal")
        log = beside.read_bytes() if beside.exists() else b""
        self._over, self.problems = read_log(log)
        self.log_size = len(log)
        self._log = sha256(log).digest()
        self.count = max(-(-size // PAGE), *self._over, 0)

    @cached_property
    def _content(self) -> bytes:
        return self._path.read_bytes()

    @cached_property
    def digest(self) -> bytes:
        """Of all that is in the file and its log, 32 bytes: the same only where every bit is.

        Read piece by piece: a file that is whole need not be in memory.
        """
        found, piece = sha256(self._log), bytearray(PIECE)
        view = memoryview(piece)
        with self._path.open("rb", buffering=0) as file:
            while count := file.readinto(piece):
                found.update(view[:count])
        return found.digest()

    def __getitem__(self, number: int) -> bytes:
        """Page from 1 on; what is missing of it is zero."""
        over = self._over.get(number)
        if over is not None:
            return over
        if number == 1 and len(self._head) == PAGE:
            return self._head
        page = self._content[(number - 1) * PAGE : number * PAGE]
        return page if len(page) == PAGE else page.ljust(PAGE, b"\0")

    def rows(self) -> Iterator[tuple[int, list[tuple[Any, ...]]]]:
        """(page, rows of it) for every page that may hold rows of tables; see `rows_of`."""
        for number in range(2, self.count + 1):
            page = self[number]
            if page[0] not in INDEX and any(page[:12]):
                yield number, rows_of(self, page)


def rows_of(pages: Pages, page: bytes) -> list[tuple[Any, ...]]:
    """Rows of a page, the key in place of the first value, text as bytes; also those nothing points to any more."""
    found = []
    rest = bytearray(page)
    if page[0] == LEAF:
        count = min(int.from_bytes(page[3:5], "big"), (PAGE - 8) // 2)
        for (start,) in struct.iter_unpack(">H", page[8 : 8 + 2 * count]):
            row, end = _cell(pages, page, start)
            if row is not None:
                found.append(row)
                rest[start:end] = b"\xff" * (end - start)
    # Where the head of the page is wrong, or an entry of its list, rows lie where none is said to be.
    for match in _RECORD.finditer(rest):
        at = match.start()
        for start in range(max(at - 12, 8), at - 1):
            row, end = _cell(pages, page, start)
            if row is not None:
                found.append(row)
    return found


def _cell(pages: Pages, page: bytes, at: int) -> tuple[tuple[Any, ...] | None, int]:
    """The row at a place of a page and where it ends; None where there is none."""
    try:
        size, at = _varint(page, at)
        key, at = _varint(page, at)
        if not 4 < size < LARGEST_ROW:
            return None, at
        local = size
        if size > LOCAL:
            local = LEAST_LOCAL + (size - LEAST_LOCAL) % (PAGE - 4)
            local = local if local <= LOCAL else LEAST_LOCAL
        end = at + local
        if end > PAGE or not 4 < page[at] <= 100 or page[at + 1] != 0:
            return None, at
        if size == local:
            return _record(key, page, at, end), end
        content = page[at:end] + _overflow(pages, page, end, size - local)
        return _record(key, content, 0, size), end + 4
    except (IndexError, ValueError, struct.error):
        return None, at


def _overflow(pages: Pages, page: bytes, at: int, size: int) -> bytes:
    parts = []
    number = int.from_bytes(page[at : at + 4], "big")
    while size > 0:
        if not 1 < number <= pages.count:
            raise ValueError("a row goes on outside the file")
        following = pages[number]
        parts.append(following[4 : 4 + size])
        size -= PAGE - 4
        number = int.from_bytes(following[:4], "big")
    return b"".join(parts)


def _record(key: int, content: bytes, at: int, end: int) -> tuple[Any, ...] | None:
    body = at + content[at]
    layout = _layout(content[at + 1 : body])
    if layout is None:
        return None
    packer, others = layout
    if body + packer.size != end:
        return None
    values = list(packer.unpack_from(content, body))
    for index, kind in others:
        values[index] = _value(kind, values[index])
    values[0] = key
    return tuple(values)


@lru_cache(4096)
def _layout(head: bytes) -> tuple[struct.Struct, list[tuple[int, int]]] | None:
    """How the values lie in a record with such a head, which many rows share, and those that `struct` does not know."""
    kinds: list[int] = []
    place = 0
    try:
        while place < len(head):
            kind, place = _varint(head, place)
            kinds.append(kind)
    except IndexError:
        return None
    if len(kinds) < 3 or not all(0 <= kind < 2 * LARGEST_ROW and kind not in (10, 11) for kind in kinds):
        return None
    codes = [_CODES.get(kind) or f"{SIZES[kind] if kind < 10 else (kind - 12) // 2}s" for kind in kinds]
    others = [(index, kind) for index, kind in enumerate(kinds) if kind < 10 and kind not in _CODES]
    return struct.Struct(f">{''.join(codes)}"), others


def _value(kind: int, data: bytes) -> Any:
    """Of a type that `struct` does not know: nothing, 0, 1, and integers of 3 and 6 bytes."""
    if kind in (8, 9):
        return kind - 8
    return None if kind == 0 else int.from_bytes(data, "big", signed=True)


def _varint(data: bytes, at: int) -> tuple[int, int]:
    byte = data[at]
    if byte < 128:
        return byte, at + 1
    value = byte & 127
    for step in range(1, 9):
        byte = data[at + step]
        if step == 8:
            value = value << 8 | byte
            return value - (1 << 64) if value >> 63 else value, at + 9
        value = value << 7 | byte & 127
        if byte < 128:
            return value, at + step + 1
    raise AssertionError


def read_log(log: bytes) -> tuple[dict[int, bytes], list[str]]:
    """Pages of a write-ahead log up to its last whole transaction, and what is damaged in it.

    SQLite stops at the first frame that is not as it was written, and says nothing about those behind it. Here every
    frame is checked against the one before. A log that only ends too early is none that is damaged: a process that
    was killed leaves one.
    """
    count = max(len(log) - LOG_HEAD, 0) // FRAME
    if count == 0:
        return {}, []
    head = log[:LOG_HEAD]
    seeds = {_sums(head[:24], (0, 0)), struct.unpack(">2I", head[24:32])}
    told = struct.unpack(">2I", head[24:32])
    sound = told == _sums(head[:24], (0, 0)) and head[:4] == LOG_MAGIC
    frames = [log[LOG_HEAD + k * FRAME : LOG_HEAD + (k + 1) * FRAME] for k in range(count)]
    salt = head[16:24] if sound else Counter(frame[8:16] for frame in frames[:9]).most_common(1)[0][0]
    whole: list[int] = []
    odd: list[int] = []
    unsure = False
    for number, frame in enumerate(frames):
        stored = struct.unpack(">2I", frame[16:24])
        computed = [_sums(frame[:8] + frame[FRAME_HEAD:], seed) for seed in seeds]
        # Behind a frame whose own sums are gone nothing can be said; the rows in it have marks of their own.
        if frame[8:16] == salt and (stored in computed or unsure):
            whole.append(number)
            seeds, unsure = {stored}, False
            continue
        unsure = bool(odd) and frame[8:16] != salt
        if frame[8:16] == salt or not any(frame[8:16]):
            odd.append(number)
            unsure = frame[8:16] != salt
        elif number > (whole[-1] if whole else -1) + 1 and not odd:
            break  # left from before the log was begun anew
        seeds = {stored, *computed}
    last = whole[-1] if whole else -1
    damaged = sorted({*odd, *(set(range(last + 1)) - set(whole))})
    problems = [f"the write-ahead log is damaged at frame {damaged[0] + 1} of {count}"] if damaged else []
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


def _sums(data: bytes, sums: Sums) -> Sums:
    """SQLite's running checksum of a log over words x, y, ...: a += x + b, then b += y + a, modulo 2^32.

    Being linear, it is one product with the coefficients of each word; of sums before, with those in front.
    """
    words = np.concatenate([np.array(sums, np.uint32), np.frombuffer(data, "<u4")])
    both = (_coefficients(len(words)) * words).sum(1, dtype=np.uint32)
    return int(both[0]), int(both[1])


@cache
def _coefficients(count: int) -> NDArray[np.uint32]:
    """(2, count) what a unit of each word, the two sums before in front, adds to the two sums at the end."""
    made = np.zeros((2, count), np.uint32)
    power = [[1, 0], [0, 1]]
    for at in range(count - 2, -1, -2):
        (p, q), (r, s) = power
        # A word x counts for both sums, y for the second; the sums themselves go through one step less.
        here = [[p + q, q], [r + s, s]] if at else [[p, q], [r, s]]
        made[:, at : at + 2] = np.array(here, np.uint64) & _MASK
        power = [[(p + q) & _MASK, (p + 2 * q) & _MASK], [(r + s) & _MASK, (r + 2 * s) & _MASK]]
    return made
