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
from whereabouts.logs.bags.encode import CLOUD_TYPE, ODOMETRY_TYPE, SCAN_TYPE, nanoseconds
from whereabouts.logs.bags.ros import open_raw
from whereabouts.logs.bags.storage import Topic
from whereabouts.logs.log import Log
from whereabouts.logs.opening import detect, open_log
from whereabouts.logs.summary import Summary
from whereabouts.logs.writer import McapWriter
from whereabouts.messages.message_rotations import planar_matrix
from whereabouts.messages.records import BASE_FRAME, OdometryRecord, Record, ScanRecord, TransformRecord
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

    Parameters
    ----------
    topics : only these; None for all.
    max_range : metres from which a reading is a no-return, for text logs whose lines do not say it.
    rate : scans per second, to stamp the scans of a text log anew from 0 on; None keeps its stamps.
    report : called now and then with the share read, 0 to 1.
    seconds : only so many from the first message on; None for all.

    Raises
    ------
    LogError : the source cannot be read, holds nothing to write, or the target cannot be written.
    """
    if rate is not None and not rate > 0.0:
        raise InputError(f"rate: positive number of scans per second expected, got {rate}")
    if seconds is not None and not seconds > 0.0:
        raise InputError(f"seconds: positive number expected, got {seconds}")
    form, _ = detect(Path(source))
    if form in ("rosbag1", "rosbag2"):
        return _convert_bag(Path(source), Path(target), topics, report, seconds)
    return _convert_text(Path(source), Path(target), topics, max_range, rate, report, seconds)


def _begun(items: Iterable[Item], stamp: Callable[[Item], float], span: float | None) -> Iterator[Item]:
    """Those whose stamps are within a span from the first one's, up to the first that is later."""
    first = None
    for item in items:
        first = stamp(item) if first is None else first
        if span is not None and stamp(item) - first > span:
            return
        yield item


def _convert_bag(
    source: Path,
    target: Path,
    topics: Iterable[str] | None,
    report: Report | None,
    seconds: float | None,
) -> Conversion:
    span = None if seconds is None else 1e9 * seconds
    with open_raw(source, topics) as log, McapWriter(target) as writer:
        for number, message in enumerate(_begun(log, lambda message: message.log_time, span)):
            writer.write_raw(_absolute(message.topic), message.data, message.log_time)
            if report is not None and number % PROGRESS_EVERY == 0:
                report(log.progress)
        if not writer.counts:
            raise NothingRecognisedError(source, f"no message to write; {_reasons(log.summary)}")
        return _figures(writer, log.summary)


def _absolute(topic: Topic) -> Topic:
    """Old bags name some topics without their slash; ROS 2 has no such topics on the wire."""
    return topic if topic.name.startswith("/") else replace(topic, name=f"/{topic.name}")


def _convert_text(
    source: Path,
    target: Path,
    topics: Iterable[str] | None,
    max_range: float | None,
    rate: float | None,
    report: Report | None,
    seconds: float | None,
) -> Conversion:
    chosen = None if topics is None else list(topics)
    with open_log(source, chosen, max_range) as log, McapWriter(target) as writer:
        records = _with_odometry(log) if rate is None else _at_rate(log, rate)
        sink = _TextSink(writer, log)
        for number, record in enumerate(_begun(records, lambda record: record.stamp, seconds)):
            sink.write(record)
            if report is not None and number % PROGRESS_EVERY == 0:
                report(log.progress)
        if not writer.counts:
            raise NothingRecognisedError(source, f"no record to write; {_reasons(log.summary)}")
        return _figures(writer, log.summary)


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


class _TextSink:
    """Writes records of a text log with log times that never go backwards, and the mounts of its lasers."""

    def __init__(self, writer: McapWriter, log: Log) -> None:
        self._writer = writer
        self._log = log
        self._clock = 0
        self._mounts: dict[str, TransformRecord] = {}

    def write(self, record: Record) -> None:
        try:
            self._clock = max(self._clock, nanoseconds(record.stamp))
        except InputError:
            reason = "stamp that a ROS time cannot hold (0 to 2³¹ s); a rate gives new stamps"
            self._log.summary.skip(reason, self._log.place)
            return
        if isinstance(record, ScanRecord):
            self._mount(record)
            self._writer.write_scan(record, self._clock)
        elif isinstance(record, OdometryRecord):
            self._writer.write_odometry(record, self._clock)

    def _mount(self, record: ScanRecord) -> None:
        """Once per laser. Latched topics keep their last message, so each has all mounts known by then."""
        if record.frame_id in self._mounts or record.sensor_pose is None:
            return
        self._mounts[record.frame_id] = TransformRecord(
            planar_matrix(record.sensor_pose), record.stamp, BASE_FRAME, record.frame_id, "tf_static"
        )
        self._writer.write_transforms(list(self._mounts.values()), self._clock)


def _reasons(summary: Summary) -> str:
    return "; ".join(summary.lines()) or "the topics asked for are not in it"


def _figures(writer: McapWriter, summary: Summary) -> Conversion:
    kinds = writer.counts_by_type
    duration = ((writer.end or 0) - (writer.start or 0)) * 1e-9
    return Conversion(
        kinds.get(SCAN_TYPE, 0),
        kinds.get(ODOMETRY_TYPE, 0),
        kinds.get(CLOUD_TYPE, 0),
        dict(writer.counts),
        duration,
        summary.copy(),
    )
