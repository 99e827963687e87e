"""ROS 1 and ROS 2 bags: as records, and as raw messages for replay and conversion."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from whereabouts.logs.bags.bag_directory import open_bag
from whereabouts.logs.bags.ros_types import decoded
from whereabouts.logs.bags.storage import Stored, Topic
from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT
from whereabouts.logs.log import Log, Recording
from whereabouts.messages.decode import RECORDS, UnusableMessageError, other
from whereabouts.messages.records import Record, strip_slash
from whereabouts.system.log_errors import (
    EmptyLogError,
    LogNotFoundError,
    NothingRecognisedError,
    UnreadableTypeError,
)


class _OfBag(Recording):
    """A recording in a bag. Raises LogNotFoundError, EmptyLogError, UnknownFormatError, DamagedLogError."""

    def __init__(
        self, path: Path | str, topics: Iterable[str] | None = None, unpacked_limit: int = UNPACKED_LIMIT
    ) -> None:
        super().__init__(path, topics)
        if not self.path.exists():
            raise LogNotFoundError(self.path, "does not exist; check the path")
        if self.path.is_file() and not self.path.stat().st_size:
            raise EmptyLogError(self.path, "is empty")
        self._bag = open_bag(self.path, self.summary, unpacked_limit)
        self._found = self.summary.copy()

    @property
    def progress(self) -> float:
        return self._bag.progress

    def close(self) -> None:
        self._bag.close()


class RosLog(_OfBag, Log):
    """A bag as a stream of records by log time.

    Topics of other types than scans, clouds, odometry and tf are counted skips, except where `topics` names
    them: then each message is a MessageRecord.
    """

    def __init__(
        self,
        path: Path,
        topics: Iterable[str] | None = None,
        format: str = "rosbag2",
        unpacked_limit: int = UNPACKED_LIMIT,
    ) -> None:
        super().__init__(path, topics, unpacked_limit)
        self.format = format

    def _records(self) -> Iterator[Record]:
        self.summary.update(self._found)
        messages = 0
        for stored in self._bag.messages():
            messages += 1
            if self.wants(stored.topic.name):
                self.place = stored.where
                yield from self._decode(stored)
        if not messages:
            note = f"; {next(iter(self.summary.notes))}" if self.summary.notes else ""
            raise NothingRecognisedError(self.path, f"holds no message{note}")

    def _decode(self, stored: Stored) -> Iterator[Record]:
        topic = stored.topic
        if topic.type_name not in RECORDS and self._wanted is None and not topic.problem:
            self.summary.skip(f"{topic.name}: {topic.type_name} is not used", stored.where)
            return
        try:
            yield from _records_of(stored)
        except (UnreadableTypeError, UnusableMessageError) as error:
            self.summary.skip(f"{topic.name}: {error}", stored.where)


def _records_of(stored: Stored) -> list[Record]:
    topic = stored.topic
    message = decoded(topic, stored.cdr())
    name = strip_slash(topic.name)
    handler = RECORDS.get(topic.type_name)
    if handler is None:
        return [other(message, name, topic.type_name, stored.log_time)]
    try:
        return list(handler(message, name))
    except (AttributeError, TypeError) as error:  # the bag's own definition of the type is another one
        raise UnusableMessageError(f"not the fields of {topic.type_name}") from error


@dataclass(frozen=True, slots=True)
class RawMessage:
    """One message as recorded: CDR bytes, and nanoseconds at which it was recorded."""

    topic: Topic
    data: bytes
    log_time: int

    @property
    def name(self) -> str:
        return self.topic.name

    @property
    def type_name(self) -> str:
        return self.topic.type_name

    def decoded(self) -> Any:
        """The message, its fields as attributes. Raises UnreadableTypeError."""
        return decoded(self.topic, self.data)


class RawLog(_OfBag):
    """A bag as a stream of undecoded messages by log time; ROS 1 messages are converted to CDR.

    topics : all topics that can be read, with type, definition and offered QoS. Where the bag has no index,
        asking for them reads it once.
    """

    @property
    def topics(self) -> list[Topic]:
        return [topic for topic in self._bag.topics() if self.wants(topic.name) and not topic.problem]

    def __iter__(self) -> Iterator[RawMessage]:
        self.summary.clear()
        self.summary.update(self._found)
        for stored in self._bag.messages():
            topic = stored.topic
            if not self.wants(topic.name):
                continue
            if topic.problem:
                self.summary.skip(f"{topic.name}: {topic.type_name}: {topic.problem}", stored.where)
                continue
            try:
                data = stored.cdr()
            except UnreadableTypeError as error:
                self.summary.skip(f"{topic.name}: {error}", stored.where)
                continue
            self.summary.count(strip_slash(topic.name))
            yield RawMessage(topic, data, stored.log_time)


def open_raw(path: Path | str, topics: Iterable[str] | None = None) -> RawLog:
    """Open a bag for its raw messages.

    Raises LogNotFoundError, EmptyLogError, UnknownFormatError, DamagedLogError: as `open_log`.
    """
    return RawLog(path, topics)
