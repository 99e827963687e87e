"""MCAP files that rosbag2 reads: a bare .mcap, or a directory with metadata.yaml."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import yaml
from mcap.writer import CompressionType, Writer

from estimation.errors import InputError
from whereabouts.logs.bags.encode import (
    cloud_message,
    nanoseconds,
    odometry_message,
    scan_message,
    transform_message,
)
from whereabouts.logs.bags.ros_types import standard_types
from whereabouts.logs.bags.storage import LATCHED, Qos, Topic, format_qos
from whereabouts.messages.records import CloudRecord, OdometryRecord, ScanRecord, TransformRecord
from whereabouts.messages.type_names import CLOUD, ODOMETRY, SCAN, TF
from whereabouts.system.atomic import atomic_path
from whereabouts.system.log_errors import WriteError

RELIABLE = Qos()
METADATA_VERSION = 9
# As rosbag2's own writer: small enough that a killed recorder loses little, large enough to compress well.
CHUNK_BYTES = 768 * 1024


class McapWriter:
    """Writes a rosbag2 recording in chunks compressed with zstd; a context manager.

    A target that ends in .mcap becomes a bare file, any other a directory with one file and metadata.yaml.
    Either appears when the block ends without an error; after an error nothing is left and what was there
    before is unchanged. The same messages give the same bytes.

    Topics are written with a leading slash. Where no log time (nanoseconds) is given it is that of the stamp.
    Raises WriteError: the target's directory is missing or not writable; a raw message lies outside the block;
    InputError: a stamp that ROS cannot express, or a log time that is negative.
    """

    def __init__(self, target: Path | str) -> None:
        self.target = Path(target)
        self.counts: dict[str, int] = {}
        self.start: int | None = None
        self.end: int | None = None
        self._stack = ExitStack()
        self._writer: Writer | None = None
        self._schemas: dict[tuple[str, str], int] = {}
        self._channels: dict[tuple[str, str], tuple[int, Topic]] = {}
        self._sequence: dict[int, int] = {}

    @property
    def bare(self) -> bool:
        return self.target.suffix == ".mcap"

    def __enter__(self) -> Self:
        temporary = self._stack.enter_context(atomic_path(self.target, directory=not self.bare))
        self._directory = None if self.bare else temporary
        path = temporary if self.bare else temporary / self._file_name
        stream = self._stack.enter_context(path.open("wb"))
        self._writer = Writer(stream, chunk_size=CHUNK_BYTES, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="whereabouts")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        writer, self._writer = self._writer, None
        if error is not None or writer is None:
            self._stack.__exit__(kind, error, trace)
            return
        with self._stack:  # finishing may fail too, on a full disk, and then nothing may be left
            information = self._information()
            text = yaml.safe_dump(information, sort_keys=False)
            writer.add_metadata("rosbag2", {"serialized_metadata": text})
            writer.finish()
            if self._directory is not None:
                whole = yaml.safe_dump({"rosbag2_bagfile_information": information}, sort_keys=False)
                (self._directory / "metadata.yaml").write_text(whole, encoding="utf-8")

    def write_scan(self, record: ScanRecord, log_time: int | None = None) -> None:
        """sensor_msgs/LaserScan on the record's topic."""
        self.write_message(record.topic, SCAN, scan_message(record), _or_stamp(log_time, record.stamp))

    def write_odometry(self, record: OdometryRecord, log_time: int | None = None) -> None:
        """nav_msgs/Odometry on the record's topic."""
        message = odometry_message(record)
        self.write_message(record.topic, ODOMETRY, message, _or_stamp(log_time, record.stamp))

    def write_cloud(self, record: CloudRecord, log_time: int | None = None) -> None:
        """sensor_msgs/PointCloud2 on the record's topic."""
        self.write_message(record.topic, CLOUD, cloud_message(record), _or_stamp(log_time, record.stamp))

    def write_transforms(self, records: list[TransformRecord], log_time: int | None = None) -> None:
        """tf2_msgs/TFMessage with all of them on the topic of the first; tf_static is latched."""
        if not records:
            raise InputError("transforms: at least one expected, got none")
        first = records[0]
        qos = LATCHED if first.static else RELIABLE
        time = _or_stamp(log_time, first.stamp)
        self.write_message(first.topic, TF, transform_message(records), time, qos)

    def write_message(
        self, topic: str, type_name: str, message: Any, log_time: int, qos: Qos = RELIABLE
    ) -> None:
        """A message made of rosbags' Jazzy types."""
        data = bytes(standard_types().serialize_cdr(message, type_name))
        name = "/" + topic.lstrip("/")
        known = self._channels.get((name, type_name))
        self.write_raw(Topic(name, type_name, qos=(qos,)) if known is None else known[1], data, log_time)

    def write_raw(self, topic: Topic, data: bytes, log_time: int) -> None:
        """CDR bytes, with the definition the topic carries or, where it has none, Jazzy's."""
        if self._writer is None:
            raise WriteError(self.target, "is not open; write inside the `with` block")
        if not 0 <= log_time < 2**63:
            raise InputError(f"log_time: nanoseconds from 0 to 2⁶³ expected, got {log_time}")
        channel = self._channel(topic)
        number = self._sequence.get(channel, 0)
        self._sequence[channel] = number + 1
        self._writer.add_message(channel, log_time, data, publish_time=log_time, sequence=number)
        self.counts[topic.name] = self.counts.get(topic.name, 0) + 1
        self.start = log_time if self.start is None else min(self.start, log_time)
        self.end = log_time if self.end is None else max(self.end, log_time)

    def _channel(self, topic: Topic) -> int:
        found = self._channels.get((topic.name, topic.type_name))
        if found is None:
            found = self._channels[topic.name, topic.type_name] = self._declare(_with_definition(topic))
        return found[0]

    def _declare(self, topic: Topic) -> tuple[int, Topic]:
        assert self._writer is not None
        key = (topic.type_name, topic.definition)
        if key not in self._schemas:
            encoding = topic.definition_format if topic.definition else ""
            self._schemas[key] = self._writer.register_schema(
                topic.type_name, encoding, topic.definition.encode()
            )
        metadata = {"offered_qos_profiles": format_qos(topic.qos), "topic_type_hash": topic.type_hash}
        return self._writer.register_channel(topic.name, "cdr", self._schemas[key], metadata), topic

    @property
    def counts_by_type(self) -> dict[str, int]:
        """Messages written so far, by type."""
        counts: dict[str, int] = {}
        for number, topic in self._channels.values():
            counts[topic.type_name] = counts.get(topic.type_name, 0) + self._sequence.get(number, 0)
        return counts

    @property
    def _file_name(self) -> str:
        return f"{self.target.stem}.mcap" if self.bare else f"{self.target.name}_0.mcap"

    def _information(self) -> dict[str, Any]:
        """What rosbag2 keeps in metadata.yaml, and inside the file."""
        total = sum(self.counts.values())
        start = {"nanoseconds_since_epoch": self.start or 0}
        duration = {"nanoseconds": (self.end or 0) - (self.start or 0)}
        per_channel = {number: self._sequence.get(number, 0) for number, _ in self._channels.values()}
        return {
            "version": METADATA_VERSION,
            "storage_identifier": "mcap",
            "duration": duration,
            "starting_time": dict(start),
            "message_count": total,
            "topics_with_message_count": [
                {"topic_metadata": _topic_metadata(topic), "message_count": per_channel[number]}
                for number, topic in self._channels.values()
            ],
            "compression_format": "",
            "compression_mode": "",
            "relative_file_paths": [self._file_name],
            "files": [
                {
                    "path": self._file_name,
                    "starting_time": dict(start),
                    "duration": dict(duration),
                    "message_count": total,
                }
            ],
            "custom_data": None,
            "ros_distro": "jazzy",
        }


def _topic_metadata(topic: Topic) -> dict[str, Any]:
    return {
        "name": topic.name,
        "type": topic.type_name,
        "serialization_format": "cdr",
        "offered_qos_profiles": yaml.safe_load(format_qos(topic.qos)) or [],
        "type_description_hash": topic.type_hash,
    }


def _with_definition(topic: Topic) -> Topic:
    store = standard_types()
    if topic.definition or topic.type_name not in store.fielddefs:
        return topic
    text, _ = store.generate_msgdef(topic.type_name, ros_version=2)
    form = "ros2idl" if text.startswith("=") else "ros2msg"
    return replace(
        topic, definition=text, definition_format=form, type_hash=store.hash_rihs01(topic.type_name)
    )


def _or_stamp(log_time: int | None, stamp: float) -> int:
    return nanoseconds(stamp) if log_time is None else log_time
