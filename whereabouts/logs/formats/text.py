"""Lines of a text log that may be plain, gzipped, bzipped or a member of a zip archive."""

from __future__ import annotations

import bz2
import gzip
import zipfile
import zlib
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import BinaryIO

from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT, bounded
from whereabouts.logs.log import Log
from whereabouts.logs.summary import Summary
from whereabouts.system.log_errors import DamagedLogError, LogNotFoundError

GZIP_MAGIC = b"\x1f\x8b"
BZIP2_MAGIC = b"BZh"
ZIP_MAGIC = b"PK\x03\x04"

# No line of a log is longer; a binary file without line ends must not be read as one line.
LONGEST_LINE = 1 << 20
DECODING_ERRORS = (EOFError, OSError, zlib.error, zipfile.BadZipFile)


def open_file(path: Path) -> BinaryIO:
    """The raw file.

    Raises LogNotFoundError: it does not exist or may not be read.
    """
    try:
        return path.open("rb")
    except OSError as error:
        raise LogNotFoundError(path, f"cannot be read ({error.strerror}); check the path") from error


def decompressed(
    raw: BinaryIO, path: Path, member: str | None = None, limit: int = UNPACKED_LIMIT
) -> BinaryIO:
    """Content of the open file, decompressed when its first bytes say so; `member` of a zip archive.

    Reading raises OversizedLogError beyond `limit` bytes of what was compressed.
    """
    if member is not None:
        try:
            return bounded(zipfile.ZipFile(raw).open(member), path, limit)  # closed with `raw`
        except (*DECODING_ERRORS, KeyError, NotImplementedError, RuntimeError) as error:
            raise DamagedLogError(
                path, f"member {member} cannot be read ({error}); unpack it first"
            ) from error
    magic = raw.read(4)
    raw.seek(0)
    if magic.startswith(GZIP_MAGIC):
        return bounded(gzip.GzipFile(fileobj=raw), path, limit)
    if magic.startswith(BZIP2_MAGIC):
        return bounded(bz2.BZ2File(raw), path, limit)
    return raw


class TextSource:
    """Numbered lines of a text log; can be read any number of times. limit : bytes that it may unpack to."""

    def __init__(self, path: Path, member: str | None = None, limit: int = UNPACKED_LIMIT) -> None:
        self.path = path
        self.member = member
        self.limit = limit
        self._raw: BinaryIO | None = None

    @property
    def progress(self) -> float:
        """Share of the (compressed) file read by the running or last pass."""
        if self._raw is None:
            return 0.0
        return 1.0 if self._raw.closed else self._raw.tell() / max(self.path.stat().st_size, 1)

    def head(self, size: int = 1 << 16) -> bytes:
        """The first bytes of the content."""
        with open_file(self.path) as raw:
            try:
                return decompressed(raw, self.path, self.member, self.limit).read(size)
            except DECODING_ERRORS:
                return b""

    def lines(self, summary: Summary) -> Iterator[tuple[int, bytes]]:
        """(line number from 1, line), to the end or to where compressed data breaks off, which is noted."""
        number = 0
        with open_file(self.path) as raw:
            self._raw = raw
            content = decompressed(raw, self.path, self.member, self.limit)
            while True:
                try:
                    line = content.readline(LONGEST_LINE)
                except DECODING_ERRORS as error:
                    reason = f"compressed data breaks off ({error}); read up to there"
                    summary.note(reason, f"line {number + 1}")
                    return
                if not line:
                    return
                number += 1
                if len(line) == LONGEST_LINE:
                    summary.skip("line longer than 1 MiB", f"line {number}")
                    continue
                yield number, line

    def fields(self, summary: Summary) -> Iterator[tuple[int, list[bytes]]]:
        """(line number, words) of the lines that say something; `#` begins a comment."""
        for number, line in self.lines(summary):
            words = line.split()
            if words and not words[0].startswith(b"#"):
                yield number, words


class TextLog(Log):
    """A log of one record a line.

    path : the file, plain, .gz or .bz2, or a zip archive holding one. topics : hand out only these; None for all.
    max_range : metres from which a reading is a no-return, instead of what the log says.
    member : name inside a zip archive. unpacked_limit : bytes that a compressed log may unpack to.
    """

    def __init__(
        self,
        path: Path,
        topics: Iterable[str] | None = None,
        max_range: float | None = None,
        member: str | None = None,
        unpacked_limit: int = UNPACKED_LIMIT,
    ) -> None:
        super().__init__(path, topics)
        self._source = TextSource(path, member, unpacked_limit)
        self._max_range = max_range

    @property
    def progress(self) -> float:
        return self._source.progress
