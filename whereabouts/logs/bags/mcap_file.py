"""MCAP files: by their index where there is one, else from front to back as far as they are whole.

Records are framed here and decoded by the `mcap` package: its own readers take a short read for a record and
cannot say where a file breaks off.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, ChunkIndex, Footer, Schema

from whereabouts.logs.bags.storage import (
    DECODING_ERRORS,
    BrokenOffError,
    ChunkedFile,
    Stored,
    Topic,
    parse_qos,
)
from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT, unpack
from whereabouts.logs.summary import Summary
from whereabouts.system.log_errors import UnknownFormatError

MAGIC = b"\x89MCAP0\r\n"
_PREFIX = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_FOOTER_SIZE = _PREFIX.size + 20
_FORMATS = {"ros2msg": "ros2msg", "ros2idl": "ros2idl", "omgidl": "ros2idl"}
# A record longer than this is a sign of damage, not of data (rosbag2 writes chunks below 1 MiB).
_LARGEST_RECORD = 1 << 32


class McapFile(ChunkedFile):
    """A bare .mcap file."""

    def __init__(
        self, path: Path, summary: Summary, shown: Path | None = None, limit: int = UNPACKED_LIMIT
    ) -> None:
        super().__init__(path, summary, shown, limit)
        self._schemas: dict[int, Schema] = {}
        if self._stream.read(len(MAGIC)) != MAGIC:
            raise UnknownFormatError(self._shown, "is no MCAP file: its first bytes are not MCAP's")
        self._finished = self._read_index()

    def _read_index(self) -> bool:
        """Topics and chunks from the summary at the end; returns whether the writer finished the file."""
        if self._size < len(MAGIC) * 2 + _FOOTER_SIZE:
            return False
        self._stream.seek(self._size - len(MAGIC) - _FOOTER_SIZE)
        tail = self._stream.read()
        if not tail.endswith(MAGIC) or tail[0] != Opcode.FOOTER:
            return False
        footer = Footer.read(ReadDataStream(BytesIO(tail[_PREFIX.size :])))
        if not 0 < footer.summary_start < self._size:
            return True
        self._stream.seek(footer.summary_start)
        try:
            for opcode, _, content in _frames(self._stream, self._size):
                self._declare(opcode, content)
                if opcode == Opcode.CHUNK_INDEX:
                    chunk = ChunkIndex.read(ReadDataStream(BytesIO(content)))
                    if chunk.chunk_start_offset >= self._size:
                        raise ValueError("chunk outside the file")
                    self._chunks.append((chunk.message_start_time, chunk.chunk_start_offset))
                elif opcode == Opcode.FOOTER:
                    break
        except DECODING_ERRORS:
            self._chunks.clear()
            self._summary.note(f"{self._shown.name}: index damaged, read from front to back", "its end")
            return True
        self._indexed = bool(self._chunks) and bool(self._topics)
        return True

    def _declare(self, opcode: int, content: bytes) -> None:
        """Take note of a schema or a channel."""
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(ReadDataStream(BytesIO(content)))
            self._schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(ReadDataStream(BytesIO(content)))
            if channel.id not in self._topics:
                self._topics[channel.id] = _topic(channel, self._schemas.get(channel.schema_id))

    def _chunk_at(self, offset: int) -> list[Stored]:
        self._stream.seek(offset)
        opcode, _, content = next(_frames(self._stream, self._size))
        if opcode != Opcode.CHUNK:
            raise ValueError("another record in the place of a chunk")
        return self._unpack(content, offset)

    def _unpack(self, content: bytes, offset: int) -> list[Stored]:
        chunk = Chunk.read(ReadDataStream(BytesIO(content)))
        where = f"byte {offset}"
        data = memoryview(self._decompress(chunk, where))
        found: list[Stored] = []
        position = 0
        while position < len(data):
            opcode, size = _PREFIX.unpack_from(data, position)
            begin, end = position + _PREFIX.size, position + _PREFIX.size + size
            if end > len(data):
                raise ValueError("record longer than its chunk")
            if opcode == Opcode.MESSAGE:
                found += self._message(data[begin:end], where)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._declare(opcode, bytes(data[begin:end]))
            position = end
        return found

    def _decompress(self, chunk: Chunk, where: str) -> bytes:
        data = unpack(chunk.compression, chunk.data, self._shown, self._limit, where)
        if len(data) != chunk.uncompressed_size:
            raise ValueError("chunk of another size than it says")
        if chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            raise ValueError("checksum of the chunk is wrong")
        return data

    def _message(self, content: memoryview, where: str) -> list[Stored]:
        """The message, or nothing where its channel was never declared, which is counted."""
        channel, _, log_time, _ = _MESSAGE.unpack_from(content)
        topic = self._topics.get(channel)
        if topic is None:
            self._summary.skip(f"{self._shown.name}: message of an undeclared channel", where)
            return []
        return [Stored(topic, bytes(content[_MESSAGE.size :]), log_time, where)]

    def _scan(self) -> Iterator[Stored]:
        self._stream.seek(len(MAGIC))
        offset = len(MAGIC)
        unit = "message"
        try:
            for opcode, offset, content in _frames(self._stream, self._size):
                if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                    break
                if opcode == Opcode.CHUNK:
                    unit = "chunk"
                what = "chunk" if opcode == Opcode.CHUNK else "record"
                yield from self._whole(what, offset, partial(self._read, opcode, content, offset))
        except BrokenOffError as error:
            offset = error.offset
        if not self._finished:
            self._summary.note(
                f"{self._shown.name}: not finished by its recorder, read up to the last whole {unit}",
                f"byte {offset}",
            )

    def _read(self, opcode: int, content: bytes, offset: int) -> list[Stored]:
        if opcode == Opcode.CHUNK:
            return self._unpack(content, offset)
        if opcode == Opcode.MESSAGE:
            return self._message(memoryview(content), f"byte {offset}")
        self._declare(opcode, content)
        return []


def _frames(stream: BinaryIO, size: int) -> Iterator[tuple[int, int, bytes]]:
    """(opcode, byte offset, content) of the records from the stream's position on."""
    offset = stream.tell()
    while offset < size:
        stream.seek(offset)
        prefix = stream.read(_PREFIX.size)
        if len(prefix) < _PREFIX.size:
            raise BrokenOffError(offset)
        opcode, length = _PREFIX.unpack(prefix)
        if length > min(size - offset - _PREFIX.size, _LARGEST_RECORD):
            raise BrokenOffError(offset)
        yield opcode, offset, stream.read(length)
        offset += _PREFIX.size + length


def _topic(channel: Channel, schema: Schema | None) -> Topic:
    if channel.message_encoding != "cdr":
        problem = f"encoded as {channel.message_encoding or 'nothing'}, CDR expected"
        return Topic(channel.topic, schema.name if schema else "", problem=problem)
    if schema is None:
        return Topic(channel.topic, "", problem="has no type in the file")
    known = schema.encoding in _FORMATS
    return Topic(
        channel.topic,
        schema.name,
        schema.data.decode(errors="replace") if known else "",
        _FORMATS.get(schema.encoding, "ros2msg"),
        channel.metadata.get("topic_type_hash", ""),
        parse_qos(channel.metadata.get("offered_qos_profiles", "")),
    )
