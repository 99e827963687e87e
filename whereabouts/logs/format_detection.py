"""Which format a log has: told by its content first, by its name where that is silent."""

from __future__ import annotations

import zipfile
from pathlib import Path

from whereabouts.logs.formats.carmen import KEYWORDS
from whereabouts.logs.formats.text import ZIP_MAGIC, TextSource, open_file
from whereabouts.system.log_errors import EmptyLogError, LogNotFoundError, UnknownFormatError

ROS_MAGIC = {
    b"#ROSBAG V": "rosbag1",
    b"\x89MCAP0\r\n": "rosbag2",
    b"SQLite format 3\0": "rosbag2",
    b"\x28\xb5\x2f\xfd": "rosbag2",  # zstd, as rosbag2 compresses whole files
}
G2O_KEYWORDS = frozenset((b"VERTEX_SE2", b"EDGE_SE2"))
SUFFIXES = {".clf": "carmen", ".log": "carmen", ".g2o": "g2o"}
PACKED = (".bag", ".mcap", ".db3")
READABLE = (
    "CARMEN logs (.clf, .log, also .gz, .bz2), g2o with laser (.g2o), ROS 1 bags (.bag), "
    "ROS 2 bags (directory, .mcap, .db3), and a zip archive with one of these"
)


def detect(path: Path) -> tuple[str, str | None]:
    """(format, member of the zip archive or None); format is carmen, g2o, rosbag1 or rosbag2.

    Raises LogNotFoundError, EmptyLogError, UnknownFormatError: as `open_log`.
    """
    if not path.exists():
        raise LogNotFoundError(path, "does not exist; check the path")
    if path.is_dir():
        return "rosbag2", None
    with open_file(path) as stream:
        magic = stream.read(16)
    if not magic:
        raise EmptyLogError(path, "is empty")
    for start, name in ROS_MAGIC.items():
        if magic.startswith(start):
            return name, None
    member = only_member(path) if magic.startswith(ZIP_MAGIC) else None
    if member is not None and member.endswith(PACKED):
        return ("rosbag1" if member.endswith(".bag") else "rosbag2"), member
    return _text_format(path, member), member


def only_member(path: Path) -> str:
    """The one log in a zip archive.

    Raises UnknownFormatError: it is no readable archive, or holds no log, or several.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            # Archives made on some systems carry a shadow of every file.
            names = [name for name in archive.namelist() if "/._" not in f"/{name}"]
    except (zipfile.BadZipFile, OSError) as error:
        raise UnknownFormatError(path, f"is no readable zip archive ({error})") from error
    logs = [name for name in names if name.lower().endswith((*PACKED, *SUFFIXES))]
    if len(logs) != 1:
        raise UnknownFormatError(path, f"the archive holds {len(logs)} logs, one expected; unpack it first")
    return logs[0]


def _text_format(path: Path, member: str | None) -> str:
    head = TextSource(path, member).head()
    if not head:
        raise EmptyLogError(path, "is empty, or its compressed data is broken from the start")
    refuse_compressed_bag(path, head)
    words = {line.split(None, 1)[0] for line in head.splitlines() if line.strip()}
    if words & G2O_KEYWORDS:
        return "g2o"
    if words & KEYWORDS:
        return "carmen"
    if b"\0" not in head:
        _refuse_trajectory(path, head)
        for suffix in Path(member or path.name).suffixes:
            if suffix.lower() in SUFFIXES:
                return SUFFIXES[suffix.lower()]
    raise UnknownFormatError(path, f"is none of the readable formats: {READABLE}")


def refuse_compressed_bag(path: Path, head: bytes) -> None:
    """Bags need random access. head : the first bytes of a file, without the compression that it may have as a whole.

    Raises UnknownFormatError: they are those of a bag.
    """
    if head.startswith(tuple(ROS_MAGIC)):
        raise UnknownFormatError(path, "is a bag in a compressed file; unpack it first (gunzip, bunzip2)")


def _refuse_trajectory(path: Path, head: bytes) -> None:
    rows = [line.split() for line in head.splitlines()[:10] if line.strip() and not line.startswith(b"#")]
    if rows and all(len(row) == 8 for row in rows[:-1]) and len(rows[0]) == 8:
        raise UnknownFormatError(path, "looks like a TUM trajectory, not a log; read_tum reads it")
