"""Opening a log of any format."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from whereabouts.logs.bags.ros import RosLog
from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT
from whereabouts.logs.format_detection import detect
from whereabouts.logs.formats.carmen import CarmenLog
from whereabouts.logs.formats.g2o import G2oLog
from whereabouts.logs.log import Log


def open_log(
    path: Path | str,
    topics: Iterable[str] | None = None,
    max_range: float | None = None,
    unpacked_limit: int = UNPACKED_LIMIT,
) -> Log:
    """Open a log of any readable format.

    path : file or rosbag2 directory.
    topics : hand out only records of these topics (with or without leading slash), None for all.
    max_range : metres from which a reading is a no-return, in formats whose logs may not say (CARMEN, g2o).
    unpacked_limit : bytes that a compressed log may unpack to.
    Raises LogNotFoundError, EmptyLogError: nothing there; UnknownFormatError: the content belongs to no readable
    format; DamagedLogError: the format is known and the file cannot be read, or (OversizedLogError) unpacks to too
    much.
    """
    source = Path(path)
    name, member = detect(source)
    if name == "carmen":
        return CarmenLog(source, topics, max_range, member, unpacked_limit)
    if name == "g2o":
        return G2oLog(source, topics, max_range, member, unpacked_limit)
    return RosLog(source, topics, name, unpacked_limit)
