"""The interface of every readable log: iterate it, and it streams records in file order."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Self

from whereabouts.logs.summary import Summary
from whereabouts.messages.records import Record, ScanRecord, TransformRecord, strip_slash


class Recording:
    """A file or folder that is read as a stream, from the start with every iteration; a context manager.

    path : what was opened. topics : those that are asked for, None for all.
    summary : account of the running or last pass; complete when the iterator is exhausted.
    """

    def __init__(self, path: Path | str, topics: Iterable[str] | None = None) -> None:
        self.path = Path(path)
        self.summary = Summary()
        self._wanted = None if topics is None else frozenset(map(strip_slash, topics))

    @property
    def progress(self) -> float:
        """How much of the file the running pass has read, 0 to 1."""
        return 0.0

    def close(self) -> None:
        """Release files. Reading again afterwards is not possible for every format."""

    def wants(self, topic: str) -> bool:
        """Whether the caller asked for this topic (all of them when none was named)."""
        return self._wanted is None or strip_slash(topic) in self._wanted

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


class Log(Recording, ABC):
    """A recording as records.

    format : short name of the format ("carmen", "g2o", "rosbag1", "rosbag2").
    place : where in the file the last record stood, such as "line 12" or "byte 4096".

    Iteration raises DamagedLogError where reading on is not possible and NothingRecognisedError at the end of
    a file that held no record at all.
    """

    format: str = ""
    place: str = ""

    @abstractmethod
    def _records(self) -> Iterator[Record]:
        """All records of wanted topics in file order, filling self.summary."""

    def __iter__(self) -> Iterator[Record]:
        self.summary.clear()
        latest: dict[tuple[type, str], float] = {}
        for record in self._records():
            topic = record.topic
            self.summary.count(topic)
            kind = (type(record), topic)
            if not isinstance(record, TransformRecord):  # one tf topic has many publishers
                previous = latest.get(kind)
                if previous is not None and record.stamp <= previous:
                    order = "earlier than" if record.stamp < previous else "equal to"
                    reason = f"stamp on {topic} {order} the one before it, kept as recorded"
                    self.summary.note(reason, self.place)
                latest[kind] = record.stamp
            yield record
        for topic in sorted((self._wanted or frozenset()) - self.summary.records.keys()):
            self.summary.note(f"no record on topic {topic}, which was asked for", "the end")

    def scans(self, topic: str | None = None) -> Iterator[ScanRecord]:
        """Scans of one topic: the one named, else that of the first scan (others are counted as skips)."""
        chosen = None if topic is None else strip_slash(topic)
        for record in self:
            if not isinstance(record, ScanRecord):
                continue
            chosen = record.topic if chosen is None else chosen
            if record.topic == chosen:
                yield record
            else:
                self.summary.skip(f"{record.topic}: reading {chosen} only", self.place)
