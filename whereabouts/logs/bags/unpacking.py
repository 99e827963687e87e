"""Unpacking with a limit: a few kilobytes of compressed data may stand for gigabytes."""

from __future__ import annotations

import bz2
import io
from collections.abc import Callable
from pathlib import Path
from typing import BinaryIO, cast

import lz4.frame
import zstandard

from whereabouts.system.log_errors import OversizedLogError

UNPACKED_LIMIT = 4 << 30
"""Bytes that a file may unpack to, unless its reader is told otherwise."""
BLOCK_LIMIT = 256 << 20
"""Bytes of a chunk or a message, which are unpacked in memory."""


def oversized(path: Path, limit: int, where: str = "") -> OversizedLogError:
    """What is raised where something unpacks to more than its limit."""
    return OversizedLogError(path, f"unpacks to more than {limit / 2**20:g} MiB, the limit", where)


def unpack(form: str, data: bytes, path: Path, limit: int, where: str = "") -> bytes:
    """A chunk or message in memory; form : zstd, lz4, bz2, or "" for none.

    Raises OversizedLogError beyond `limit` bytes or `BLOCK_LIMIT`, ValueError for an unknown form, what the decoder
    raises where the data are broken.
    """
    limit = min(limit, BLOCK_LIMIT)
    if form == "zstd":
        # Frames come with and without their size.
        with zstandard.ZstdDecompressor().stream_reader(data) as stream:
            found = stream.read(limit + 1)
    elif form == "lz4":
        found = _whole(lz4.frame.LZ4FrameDecompressor(), data, limit)
    elif form == "bz2":
        found = _whole(bz2.BZ2Decompressor(), data, limit)
    elif form in ("", "none"):
        found = data
    else:
        raise ValueError(f"compression {form!r} is not known")
    if len(found) > limit:
        raise oversized(path, limit, where)
    return found


def _whole(decoder: lz4.frame.LZ4FrameDecompressor | bz2.BZ2Decompressor, data: bytes, limit: int) -> bytes:
    found = bytes(decoder.decompress(data, max_length=limit + 1))
    if not decoder.eof and len(found) <= limit:
        raise EOFError("compressed data end too early")
    return found


def copy(read: Callable[[int], bytes], sink: BinaryIO, path: Path, limit: int) -> None:
    """Write what `read` gives to a file. Raises OversizedLogError, and what `read` raises."""
    left = limit
    while part := read(1 << 20):
        left -= len(part)
        if left < 0:
            raise oversized(path, limit)
        sink.write(part)


class Bounded(io.RawIOBase):
    """A stream that may be read up to a limit of bytes. Raises OversizedLogError beyond it."""

    def __init__(self, stream: BinaryIO, path: Path, limit: int) -> None:
        self._stream, self._path, self._limit = stream, path, limit
        self._left = limit

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: memoryview) -> int:  # type: ignore[override]
        data = self._stream.read(len(buffer))
        self._left -= len(data)
        if self._left < 0:
            raise oversized(self._path, self._limit)
        buffer[: len(data)] = data
        return len(data)


def bounded(stream: object, path: Path, limit: int) -> BinaryIO:
    """A stream to read lines from, up to a limit of bytes."""
    return cast(BinaryIO, io.BufferedReader(Bounded(cast(BinaryIO, stream), path, limit), 1 << 16))
