"""What every bag file is read as: topics, and stored messages in time order."""

from __future__ import annotations

import heapq
import struct
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import NamedTuple, Protocol

import yaml
import zstandard
from mcap.exceptions import McapError

from whereabouts.logs.bags.unpacking import UNPACKED_LIMIT
from whereabouts.logs.formats.text import open_file
from whereabouts.logs.summary import Summary
from whereabouts.system.log_errors import OversizedLogError, UnreadableTypeError

# Numbers of rmw, as written by rosbag2 up to Iron; later ones write the names.
_QOS_NAMES = {
    "history": {0: "system_default", 1: "keep_last", 2: "keep_all"},
    "reliability": {0: "system_default", 1: "reliable", 2: "best_effort", 4: "best_available"},
    "durability": {0: "system_default", 1: "transient_local", 2: "volatile", 4: "best_available"},
}


@dataclass(frozen=True)
class Qos:
    """A publisher's offer: history (keep_last, keep_all), depth, reliability (reliable, best_effort),
    durability (volatile, transient_local); "unknown" or "system_default" where the bag says no more."""

    history: str = "keep_last"
    depth: int = 10
    reliability: str = "reliable"
    durability: str = "volatile"


@dataclass(frozen=True, eq=False)
class Topic:
    """One recorded topic.

    name : as recorded, usually with a leading slash.
    type_name : such as "sensor_msgs/msg/LaserScan".
    definition : text of the message definition with all types it uses, "" where the bag has none.
    definition_format : "ros2msg" or "ros2idl".
    type_hash : "RIHS01_..." where recorded, else "".
    qos : offers of its publishers at the time of recording, empty where not recorded.
    to_cdr : makes stored bytes CDR, None where they are.
    problem : why its messages cannot be read, "" where they can.
    """

    name: str
    type_name: str
    definition: str = ""
    definition_format: str = "ros2msg"
    type_hash: str = ""
    qos: tuple[Qos, ...] = ()
    to_cdr: Callable[[bytes], bytes] | None = field(default=None, repr=False)
    problem: str = ""


LATCHED = Qos(depth=1, durability="transient_local")


class Stored(NamedTuple):
    """One message as it lies in the file; `where` is its place, such as "byte 4096"."""

    topic: Topic
    data: bytes
    log_time: int
    where: str

    def cdr(self) -> bytes:
        """The message as ROS 2 has it. Raises UnreadableTypeError where its bytes do not fit."""
        try:
            return self.data if self.topic.to_cdr is None else self.topic.to_cdr(self.data)
        except Exception as error:  # generated code on arbitrary bytes: any error means the same
            raise UnreadableTypeError(f"bytes do not fit {self.topic.type_name}") from error


class BagFile(Protocol):
    """A bag file or a set of them."""

    def topics(self) -> list[Topic]:
        """All topics. Reads the whole file where its index is missing."""

    def messages(self) -> Iterator[Stored]:
        """All messages by log time, as far as the file's own order of chunks allows it."""

    @property
    def progress(self) -> float:
        """Share of the file read by the running pass."""

    def close(self) -> None:
        """Release files."""


class BrokenOffError(Exception):
    """The file ends inside the record that begins at `offset`."""

    def __init__(self, offset: int) -> None:
        super().__init__(offset)
        self.offset = offset


# What damaged bytes make the decoders of records, chunks and compressed data raise.
DECODING_ERRORS = (
    BrokenOffError,
    ValueError,
    KeyError,
    IndexError,
    RuntimeError,
    EOFError,
    OSError,
    MemoryError,
    OverflowError,  # a length that no file has
    struct.error,
    McapError,
    zstandard.ZstdError,
)


class ChunkedFile(ABC):
    """A bag file in chunks, read by its index where there is one, else from front to back.

    path : the file; shown : what error messages and remarks call it (the archive it came from).
    summary : account of damage. limit : bytes that a chunk may unpack to, `BLOCK_LIMIT` at most.
    """

    def __init__(
        self, path: Path, summary: Summary, shown: Path | None = None, limit: int = UNPACKED_LIMIT
    ) -> None:
        self.path = path
        self._limit = limit
        self._shown = shown or path
        self._summary = summary
        self._stream = open_file(path)
        self._size = path.stat().st_size
        self._topics: dict[int, Topic] = {}
        self._chunks: list[tuple[int, int]] = []  # log time of the first message, byte offset
        self._indexed = False
        self._scanned = False

    @property
    def progress(self) -> float:
        return 1.0 if self._stream.closed else self._stream.tell() / max(self._size, 1)

    def close(self) -> None:
        self._stream.close()

    def topics(self) -> list[Topic]:
        if not self._indexed and not self._scanned:
            for _ in self._scan():
                pass
            self._scanned = True
        return list(self._topics.values())

    def messages(self) -> Iterator[Stored]:
        yield from self._in_time_order() if self._indexed else self._scan()
        self._scanned = True

    @abstractmethod
    def _chunk_at(self, offset: int) -> list[Stored]:
        """Messages of the chunk at a byte offset. Raises one of DECODING_ERRORS where it is damaged."""

    @abstractmethod
    def _scan(self) -> Iterator[Stored]:
        """From front to back, each chunk by log time, up to where the file breaks off."""

    def _whole(self, what: str, offset: int, read: Callable[[], list[Stored]]) -> list[Stored]:
        """What is read of a chunk or a record, by log time; none where it is damaged, which is counted."""
        try:
            return sorted(read(), key=lambda stored: stored.log_time)
        except OversizedLogError:
            raise
        except DECODING_ERRORS:
            self._summary.skip(f"{self._shown.name}: damaged {what}", f"byte {offset}")
            return []

    def _in_time_order(self) -> Iterator[Stored]:
        """Messages by log time, each chunk loaded only when its time has come.

        Chunks that overlap in time are open together, so memory is that of the overlapping chunks.
        """
        waiting = sorted(self._chunks, key=lambda chunk: chunk[0])
        open_chunks: list[tuple[int, int, int, list[Stored]]] = []  # (time, rank, position, messages)
        rank = 0
        while rank < len(waiting) or open_chunks:
            start = waiting[rank][0] if rank < len(waiting) else None
            if start is not None and (not open_chunks or start <= open_chunks[0][0]):
                offset = waiting[rank][1]
                messages = self._whole("chunk", offset, partial(self._chunk_at, offset))
                if messages:
                    heapq.heappush(open_chunks, (messages[0].log_time, rank, 0, messages))
                rank += 1
                continue
            _, chunk, position, messages = heapq.heappop(open_chunks)
            if not open_chunks and (start is None or messages[-1].log_time < start):
                yield from messages[position:]
                continue
            yield messages[position]
            if position + 1 < len(messages):
                following = (messages[position + 1].log_time, chunk, position + 1, messages)
                heapq.heappush(open_chunks, following)


def parse_qos(text: object) -> tuple[Qos, ...]:
    """Offers from the YAML text (or the list read from it) that rosbag2 stores; () where unreadable."""
    if isinstance(text, str):
        try:
            text = yaml.safe_load(text)
        except yaml.YAMLError:
            return ()
    if not isinstance(text, list):
        return ()
    return tuple(_qos(entry) for entry in text if isinstance(entry, dict))


def _qos(entry: dict[str, object]) -> Qos:
    named = {}
    for key, names in _QOS_NAMES.items():
        value = entry.get(key)
        named[key] = (
            names.get(value, "unknown") if isinstance(value, int) else str(value or "unknown").lower()
        )
    depth = entry.get("depth", 10)
    return Qos(
        named["history"], depth if isinstance(depth, int) else 10, named["reliability"], named["durability"]
    )


def format_qos(offers: Sequence[Qos]) -> str:
    """The YAML text rosbag2 stores; deadlines and lease are written as unset."""
    unset = "{sec: 9223372036, nsec: 854775807}"
    return "\n".join(
        f"- history: {offer.history}\n  depth: {offer.depth}\n  reliability: {offer.reliability}\n"
        f"  durability: {offer.durability}\n  deadline: {unset}\n  lifespan: {unset}\n"
        f"  liveliness: automatic\n  liveliness_lease_duration: {unset}\n"
        "  avoid_ros_namespace_conventions: false"
        for offer in offers
    )
