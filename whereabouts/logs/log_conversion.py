"""Any readable log as a rosbag2 MCAP recording.

Text logs become LaserScan, Odometry and tf_static; bags keep all their messages, those of ROS 1 as ROS 2's.
Header stamps stay as recorded, also where they go backwards. The log times by which a player paces messages
never do: a message whose stamp lies behind is logged at the time of the one before it, so that messages keep
the order they have in the log and a player waits at most once for a jump.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from pathlib import Path
from typing import TypeVar

from estimation.errors import InputError
from whereabouts.logs.bags.encode import nanoseconds
from whereabouts.logs.bags.ros import RawLog, open_raw
from whereabouts.logs.format_detection import detect
from whereabouts.logs.log import Log
from whereabouts.logs.opening import open_log
from whereabouts.logs.summary import Summary
from whereabouts.logs.writer import McapWriter
from whereabouts.messages.message_rotations import planar_matrix
from whereabouts.messages.records import BASE_FRAME, OdometryRecord, Record, ScanRecord, TransformRecord
from whereabouts.messages.type_names import CLOUD, ODOMETRY, SCAN
from whereabouts.system.log_errors import NothingRecognisedError

WHEEL_TOPIC = "wheel_odom"
# Records looked at to see whether a log has odometry of its own; loggers write it between any two scans.
ODOMETRY_WITHIN = 500
PROGRESS_EVERY = 256
Report = Callable[[float], None]
Item = TypeVar("Item")


@dataclass(frozen=True)
class Conversion:
    """What was written: numbers of messages by kind and by topic, seconds from first to last, and the account of
    what was left out."""

    scans: int
    odometry: int
    clouds: int
    messages: dict[str, int]
    duration: float
    summary: Summary


def convert_log(
    source: Path | str,
    target: Path | str,
    topics: Iterable[str] | None = None,
    max_range: float | None = None,
    rate: float | None = None,
    report: Report | None = None,
    seconds: float | None = None,
) -> Conversion:
    """Write `source` as a rosbag2 recording: a bare file where `target` ends in .mcap, else a directory.

    topics : only these; None for all.
    max_range : metres from which a reading is a no-return, for text logs whose lines do not say it.
    rate : scans per second, to stamp the scans of a text log anew from 0 on; None keeps its stamps.
    report : called now and then with the share read, 0 to 1.
    seconds : only so many from the first message on; None for all.
    Raises LogError: the source cannot be read, holds nothing to write, or the target cannot be written.
    """
    if rate is not None and not rate > 0.0:
        raise InputError(f"rate: positive number of scans per second expected, got {rate}")
    if seconds is not None and not seconds > 0.0:
        raise InputError(f"seconds: positive number expected, got {seconds}")
    is_bag = detect(Path(source))[0] in ("rosbag1", "rosbag2")
    opened = open_raw(source, topics) if is_bag else open_log(source, topics, max_range)
    with opened as log, McapWriter(target) as writer:
        steps = (
            _copied(log, writer, seconds) if isinstance(log, RawLog) else _encoded(log, writer, rate, seconds)
        )
        for number, _ in enumerate(steps):
            if report is not None and number % PROGRESS_EVERY == 0:
                report(log.progress)
        if not writer.counts:
            reasons = "; ".join(log.summary.lines()) or "the topics asked for are not in it"
            raise NothingRecognisedError(source, f"no message to write; {reasons}")
        kinds = writer.counts_by_type
        return Conversion(
            kinds.get(SCAN, 0),
            kinds.get(ODOMETRY, 0),
            kinds.get(CLOUD, 0),
            dict(writer.counts),
            ((writer.end or 0) - (writer.start or 0)) * 1e-9,
            log.summary.copy(),
        )


def _begun(items: Iterable[Item], stamp: Callable[[Item], float], span: float | None) -> Iterator[Item]:
    """Those whose stamps are within a span from the first one's, up to the first that is later."""
    first = None
    for item in items:
        first = stamp(item) if first is None else first
        if span is not None and stamp(item) - first > span:
            return
        yield item


def _copied(log: RawLog, writer: McapWriter, seconds: float | None) -> Iterator[None]:
    """Writes one message of a bag at each step."""
    span = None if seconds is None else 1e9 * seconds
    for message in _begun(log, lambda message: message.log_time, span):
        topic = message.topic
        if not topic.name.startswith("/"):
            # Old bags name some topics so; ROS 2 has no such topics on the wire.
            topic = replace(topic, name=f"/{topic.name}")
        writer.write_raw(topic, message.data, message.log_time)
        yield


def _encoded(log: Log, writer: McapWriter, rate: float | None, seconds: float | None) -> Iterator[None]:
    """Writes one record of a text log at each step, at times that never go backwards, and the lasers' mounts."""
    records = _with_odometry(log) if rate is None else _at_rate(log, rate)
    clock = 0
    mounts: dict[str, TransformRecord] = {}
    for record in _begun(records, lambda record: record.stamp, seconds):
        yield
        try:
            clock = max(clock, nanoseconds(record.stamp))
        except InputError:
            log.summary.skip(
                "stamp that a ROS time cannot hold (0 to 2³¹ s); a rate gives new stamps", log.place
            )
            continue
        if isinstance(record, OdometryRecord):
            writer.write_odometry(record, clock)
        elif isinstance(record, ScanRecord):
            frame, mount = record.frame_id, record.sensor_pose
            if mount is not None and frame not in mounts:
                matrix = planar_matrix(mount)
                mounts[frame] = TransformRecord(matrix, record.stamp, BASE_FRAME, frame, "tf_static")
                # Latched topics keep their last message, so each has all mounts known by then.
                writer.write_transforms(list(mounts.values()), clock)
            writer.write_scan(record, clock)


def _with_odometry(log: Log) -> Iterator[Record]:
    """All records; where the log has no odometry on its own, that of each scan goes before the scan."""
    own = any(isinstance(record, OdometryRecord) for record in islice(log, ODOMETRY_WITHIN))
    for record in log:
        if not own and isinstance(record, ScanRecord) and log.wants(WHEEL_TOPIC):
            yield from _odometry_of(record)
        yield record


def _odometry_of(record: ScanRecord) -> Iterator[OdometryRecord]:
    if record.odometry is not None:
        yield OdometryRecord(record.odometry, record.stamp, WHEEL_TOPIC)


def _at_rate(log: Log, rate: float) -> Iterator[Record]:
    """Scans stamped anew, each after its own odometry: recorded stamps of other readings mean nothing there."""
    counts: dict[str, int] = {}
    for record in log:
        if isinstance(record, ScanRecord):
            number = counts[record.topic] = counts.get(record.topic, -1) + 1
            scan = record.scan
            stamp = number / rate
            again = type(scan)(
                scan.ranges, scan.angle_min, scan.angle_increment, scan.range_min, scan.range_max, stamp
            )
            paced = replace(record, scan=again, stamp=stamp)
            yield from _odometry_of(paced)
            yield paced
