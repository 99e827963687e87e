"""ROS 1 bags, format 2.0: by their index where there is one, else from front to back.

`rosbags` refuses a bag whose recorder was killed and holds an entry for every message of a whole one; this
reader holds an entry for every chunk, and shares the framing between whole and damaged bags.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import BinaryIO

from whereabouts.logs.bags.ros1_types import topic_of
from whereabouts.logs.bags.storage import DECODING_ERRORS, BrokenOffError, ChunkedFile, Stored
from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT, unpack
from whereabouts.logs.summary import Summary
from whereabouts.system.log_errors import DamagedLogError, UnknownFormatError

VERSION = re.compile(rb"#ROSBAG V(\d+\.\d+)\n")
MESSAGE, CHUNK, CHUNK_INFO, CONNECTION = 2, 5, 6, 7
Fields = dict[bytes, bytes]

_LENGTH = struct.Struct("<I")
_TIME = struct.Struct("<II")
_REINDEX = "`rosbag reindex` repairs the file itself"


class Ros1File(ChunkedFile):
    """A .bag file.

    Raises UnknownFormatError: not of version 2.0, or encrypted; DamagedLogError: breaks off before its first record.
    """

    def __init__(
        self, path: Path, summary: Summary, shown: Path | None = None, limit: int = UNPACKED_LIMIT
    ) -> None:
        super().__init__(path, summary, shown, limit)
        self._start = self._read_start()

    def _read_start(self) -> int:
        """Read the bag header and, where it points to one, the index; returns where the data begin."""
        version = VERSION.match(self._stream.readline(64))
        if version is None or version[1] != b"2.0":
            found = version[1].decode() if version else "unknown"
            raise UnknownFormatError(
                self._shown, f"is a bag of version {found}; `rosbag migrate` makes it 2.0"
            )
        try:
            fields, _, start = _read_record(self._stream, self._stream.tell(), self._size)
            if fields.get(b"encryptor"):
                raise UnknownFormatError(self._shown, "is encrypted; `rosbag decrypt` it first")
            index = int.from_bytes(fields[b"index_pos"], "little")
            counts = _LENGTH.unpack(fields[b"conn_count"])[0], _LENGTH.unpack(fields[b"chunk_count"])[0]
        except (BrokenOffError, KeyError, struct.error) as error:
            raise DamagedLogError(self._shown, "breaks off in its header; nothing can be read") from error
        try:
            if index:
                self._read_index(index, *counts)
        except DECODING_ERRORS:
            self._topics.clear()
            self._chunks.clear()
        if not self._indexed:
            reason = f"{self._shown.name}: no index (recorder killed, or file cut), read from front to back"
            self._summary.note(f"{reason}; {_REINDEX}", f"byte {index}" if index else "its end")
        return start

    def _read_index(self, offset: int, connections: int, chunks: int) -> None:
        for number in range(connections + chunks):
            fields, data, offset = _read_record(self._stream, offset, self._size)
            expected = CONNECTION if number < connections else CHUNK_INFO
            if fields[b"op"][0] != expected:
                raise ValueError("another record in the index")
            if expected == CONNECTION:
                self._declare(fields, data)
            elif _LENGTH.unpack(fields[b"count"])[0]:
                position = int.from_bytes(fields[b"chunk_pos"], "little")
                if position >= self._size:
                    raise ValueError("chunk outside the file")
                self._chunks.append((_nanoseconds(fields[b"start_time"]), position))
        self._indexed = True

    def _declare(self, fields: Fields, data: bytes) -> None:
        number = _LENGTH.unpack(fields[b"conn"])[0]
        if number not in self._topics:
            self._topics[number] = topic_of(fields[b"topic"], _fields(data))

    def _chunk_at(self, offset: int) -> list[Stored]:
        fields, data, _ = _read_record(self._stream, offset, self._size)
        return self._unpack(fields, data, offset)

    def _unpack(self, fields: Fields, data: bytes, offset: int) -> list[Stored]:
        """Messages of a chunk in the order they lie in it."""
        where = f"byte {offset}"
        form = fields[b"compression"].decode("ascii")
        content = unpack(form, data, self._shown, self._limit, where)
        if len(content) != _LENGTH.unpack(fields[b"size"])[0]:
            raise ValueError("chunk of another size than it says")
        found: list[Stored] = []
        position = 0
        while position < len(content):
            inner, begin, end = _split(content, position)
            operation = inner[b"op"][0]
            if operation == MESSAGE:
                topic = self._topics[_LENGTH.unpack(inner[b"conn"])[0]]
                found.append(Stored(topic, content[begin:end], _nanoseconds(inner[b"time"]), where))
            elif operation == CONNECTION:
                self._declare(inner, content[begin:end])
            position = end
        return found

    def _scan(self) -> Iterator[Stored]:
        offset = self._start
        while offset < self._size:
            try:
                fields, data, following = _read_record(self._stream, offset, self._size)
                operation = fields[b"op"][0]
            except (BrokenOffError, KeyError, IndexError):
                reason = f"{self._shown.name}: breaks off, read up to the last whole chunk; {_REINDEX}"
                self._summary.note(reason, f"byte {offset}")
                return
            what = "chunk" if operation == CHUNK else "record"
            yield from self._whole(what, offset, partial(self._read, operation, fields, data, offset))
            offset = following

    def _read(self, operation: int, fields: Fields, data: bytes, offset: int) -> list[Stored]:
        if operation == CHUNK:
            return self._unpack(fields, data, offset)
        if operation == CONNECTION:
            self._declare(fields, data)
        return []


def _read_record(stream: BinaryIO, offset: int, size: int) -> tuple[Fields, bytes, int]:
    """(header fields, data, offset of the next record) of the record at a byte offset."""
    stream.seek(offset)
    begin, parts = offset, []
    for _ in range(2):
        prefix = stream.read(_LENGTH.size)
        offset += _LENGTH.size
        length = _LENGTH.unpack(prefix)[0] if len(prefix) == _LENGTH.size else size
        if length > size - offset:
            raise BrokenOffError(begin)
        parts.append(stream.read(length))
        offset += length
    try:
        return _fields(parts[0]), parts[1], offset
    except (ValueError, struct.error) as error:
        raise BrokenOffError(begin) from error


def _split(content: bytes, position: int) -> tuple[Fields, int, int]:
    """(header fields, begin, end of the data) of the record at a position of a chunk."""
    begin = position + _LENGTH.size + _LENGTH.unpack_from(content, position)[0]
    end = begin + _LENGTH.size + _LENGTH.unpack_from(content, begin)[0]
    if end > len(content):
        raise ValueError("record longer than its chunk")
    return _fields(content[position + _LENGTH.size : begin]), begin + _LENGTH.size, end


def _fields(header: bytes) -> Fields:
    """Fields `name=value`, each preceded by its length."""
    fields: Fields = {}
    position = 0
    while position < len(header):
        end = position + _LENGTH.size + _LENGTH.unpack_from(header, position)[0]
        name, equals, value = header[position + _LENGTH.size : end].partition(b"=")
        if not equals or end > len(header):
            raise ValueError("header field without a value")
        fields[name] = value
        position = end
    return fields


def _nanoseconds(value: bytes) -> int:
    seconds, nanoseconds = _TIME.unpack(value)
    return int(seconds) * 1_000_000_000 + int(nanoseconds)
