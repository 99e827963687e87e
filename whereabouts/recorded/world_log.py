"""Evidence of a recorded bag, look by look, for the world model; without ROS."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from estimation.errors import InputError
from whereabouts.logs import open_raw
from whereabouts.logs.bags.ros_types import Decoder
from whereabouts.logs.bags.storage import Topic
from whereabouts.logs.summary import Summary
from whereabouts.messages.cdr import UnreadableTypeError
from whereabouts.recorded.camera_log import TYPES, CameraLog, CameraSettings
from whereabouts.recorded.evidence_messages import Reader, SeenFrame
from whereabouts.system.log_errors import NothingRecognisedError
from world_model import WorldEvidence

EVIDENCE = "whereabouts_msgs/msg/WorldEvidence"
DETECTIONS = "vision_msgs/msg/Detection3DArray"
TARGETS = "whereabouts_msgs/msg/TargetArray"
NANOSECONDS = 1_000_000_000


@dataclass(frozen=True)
class LoggedLook:
    """One message: stamp (s), its frame, and what it says; `missing` are ids that were looked for and not found."""

    stamp: float
    frame: str
    evidence: WorldEvidence
    missing: tuple[str, ...]


class EvidenceLog:
    """All evidence of a bag in the order of recording; a context manager.

    Evidence, detections in space and targets must be in one frame, that of the first or `frame`. Boxes in an image
    (Detection2DArray) are placed by CameraInfo, depth image and tf of the bag, as `camera` says. What cannot be used is
    skipped and accounted for in `summary`. Raises LogError where there is no such bag.
    """

    def __init__(
        self, path: Path, reader: Reader, frame: str = "", camera: CameraSettings | None = None
    ) -> None:
        self.path = path
        self.frame = frame
        self.camera = CameraLog(reader, camera or CameraSettings())
        self._reader = reader
        self._bag = open_raw(path)
        self._decoders: dict[str, Decoder] = {}

    @property
    def summary(self) -> Summary:
        """Account of the pass: skipped messages with their reasons."""
        return self._bag.summary

    @property
    def progress(self) -> float:
        """Share of the bag that has been read."""
        return self._bag.progress

    def __iter__(self) -> Iterator[LoggedLook]:
        count = 0
        for raw in self._bag:
            if raw.type_name not in (EVIDENCE, DETECTIONS, TARGETS, *TYPES):
                continue
            try:
                message = self._decoder(raw.topic)(raw.data)
                if raw.type_name in TYPES:
                    self.camera.take(raw.type_name, message, raw.name)
                    looks = list(self._of_boxes())
                else:
                    looks = [self._look(raw.type_name, message)]
            except (UnreadableTypeError, InputError) as error:
                self._bag.summary.skip(f"{raw.name}: {error}", f"time {raw.log_time / NANOSECONDS:.3f}")
                continue
            count += len(looks)
            yield from looks
        for look in self._of_boxes(ended=True):
            count += 1
            yield look
        if count == 0:
            raise NothingRecognisedError(
                self.path, f"there is no usable evidence in it{_first(self._bag.summary)}"
            )

    def _of_boxes(self, ended: bool = False) -> Iterator[LoggedLook]:
        """What boxes say whose depth image and transforms have come."""
        for stamp, found in self.camera.ready(ended):
            seconds = stamp / NANOSECONDS
            if isinstance(found, InputError):
                self._bag.summary.skip(f"boxes: {found}", f"time {seconds:.3f}")
            else:
                yield LoggedLook(seconds, self.frame, found, ())

    def _decoder(self, topic: Topic) -> Decoder:
        if topic.name not in self._decoders:
            self._decoders[topic.name] = Decoder(topic)
        return self._decoders[topic.name]

    def _look(self, type_name: str, message: Any) -> LoggedLook:
        header = message.header
        frame = str(header.frame_id).lstrip("/")
        if not frame:
            raise InputError("header.frame_id is empty")
        self.frame = self.frame or frame
        if frame != self.frame:
            raise InputError(f"is in frame '{frame}', '{self.frame}' expected")
        stamp = int(header.stamp.sec) + int(header.stamp.nanosec) / NANOSECONDS
        missing: list[str] = []
        if type_name == EVIDENCE:
            evidence, missing = self._reader.evidence(message, SeenFrame())
        elif type_name == DETECTIONS:
            evidence = self._reader.detections(message, SeenFrame())
        else:
            evidence, _ = self._reader.targets(message, SeenFrame(), {})
        return LoggedLook(stamp, frame, evidence, tuple(missing))

    def close(self) -> None:
        """Release files."""
        self._bag.close()

    def __enter__(self) -> EvidenceLog:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _first(summary: Summary) -> str:
    first = next(iter(summary.lines()), "")
    return f"; {first}" if first else ""
