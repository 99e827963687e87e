"""Evidence of a recorded bag, look by look, for the world model; without ROS."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from estimation.errors import InputError
from estimation.geometry.frame_tree import TransformError
from whereabouts.logs import RawLog, RawMessage
from whereabouts.messages.decode import nanoseconds
from whereabouts.messages.records import strip_slash
from whereabouts.messages.type_names import BOXES, DETECTIONS, EVIDENCE, TARGETS
from whereabouts.recorded.camera_log import TYPES, CameraLog, CameraSettings
from whereabouts.recorded.evidence_messages import Reader, SeenFrame
from whereabouts.system.clocks import NANOSECONDS
from whereabouts.system.log_errors import NothingRecognisedError, UnreadableTypeError
from world_model import WorldEvidence

PATIENCE = NANOSECONDS
"""of recording that what is seen waits for transforms and depth images."""


@dataclass(frozen=True)
class LoggedLook:
    """One message: stamp (s), its frame, and what it says; `missing` are ids that were looked for and not found."""

    stamp: float
    frame: str
    evidence: WorldEvidence
    missing: tuple[str, ...]


class EvidenceLog(RawLog):
    """All evidence of a bag; a context manager.

    Evidence, detections in space and targets in other frames than the map's are placed by the tf of the bag, boxes in
    an image (Detection2DArray) by CameraInfo and depth image, too, as `camera` says. In a bag whose tf has no map they
    are placed in the frame in which the robot moves, such as `odom`, and left in their own where nothing moves; `frame`
    is another one for all. What cannot be used is skipped and accounted for in `summary`.
    Raises LogError where there is no such bag.
    """

    def __init__(
        self, path: Path, reader: Reader, frame: str = "", camera: CameraSettings | None = None
    ) -> None:
        super().__init__(path)
        self.frame = frame
        settings = camera or CameraSettings()
        self._map_frame = settings.map_frame
        self.camera = CameraLog(reader, settings)
        self._waiting: deque[tuple[RawMessage, Any]] = deque()
        self._reader = reader

    def looks(self) -> Iterator[LoggedLook]:
        """Look by look, in the order of recording. Raises NothingRecognisedError where there is none."""
        count = 0
        for raw in self:
            if raw.type_name not in (EVIDENCE, DETECTIONS, TARGETS, BOXES, *TYPES):
                continue
            try:
                message = raw.decoded()
                if raw.type_name in TYPES:
                    self.camera.take(raw.type_name, message, raw.name)
                else:
                    self._waiting.append((raw, message))
            except (UnreadableTypeError, InputError) as error:
                self._skip(raw, error)
                continue
            for look in self._due(raw.log_time - PATIENCE):
                count += 1
                yield look
        for look in self._due(None):
            count += 1
            yield look
        if count == 0:
            raise NothingRecognisedError(
                self.path, "; ".join(["there is no usable evidence in it", *self.summary.lines()])
            )

    def _skip(self, raw: RawMessage, reason: Exception | str) -> None:
        self.summary.skip(f"{raw.name}: {reason}", f"time {raw.log_time / NANOSECONDS:.3f}")

    def _due(self, until: int | None) -> Iterator[LoggedLook]:
        """What is said by messages for which all has come that they need; those of before `until`, ns, or all where
        that is None, wait no longer."""
        while self._waiting:
            raw, message = self._waiting[0]
            last = until is None or raw.log_time <= until
            try:
                look = self._look(raw, message, last)
            except (InputError, TransformError) as error:
                # Of boxes the depth image may be still to come.
                if not last and (isinstance(error, TransformError) or raw.type_name == BOXES):
                    return
                self._skip(raw, error)
            else:
                yield look
            self._waiting.popleft()

    def _look(self, raw: RawMessage, message: Any, last: bool) -> LoggedLook:
        header = message.header
        frame, stamp = strip_slash(str(header.frame_id)), nanoseconds(header.stamp)
        missing: list[str] = []
        if raw.type_name == BOXES:
            self._place_of(frame, stamp, last)
            evidence, refused = self.camera.evidence(message, frame, stamp, last)
            for reason in refused:
                self._skip(raw, reason)
            return LoggedLook(stamp / NANOSECONDS, self.frame, evidence, ())
        if not frame:
            raise InputError("header.frame_id is empty")
        seen = self._place_of(frame, stamp, last)
        if raw.type_name == EVIDENCE:
            evidence, missing = self._reader.evidence(message, seen)
        elif raw.type_name == DETECTIONS:
            evidence = self._reader.detections(message, seen)
        else:
            evidence, _ = self._reader.targets(message, seen, {})
        return LoggedLook(stamp / NANOSECONDS, self.frame, evidence, tuple(missing))

    def _place_of(self, frame: str, stamp: int, last: bool) -> SeenFrame:
        """How to get from a frame to the world. last : nothing is waited for. Raises TransformError, InputError."""
        world = self.camera.map_frame = self._world_of(frame, last)
        seen = SeenFrame()
        if frame != world:
            try:
                seen = self.camera.placed(frame, stamp)
            except TransformError as error:
                if not last:
                    raise
                raise InputError(f"is in frame '{frame}', '{world}' expected: {error}") from None
        if world not in (self.frame, self._map_frame, frame):
            reason = f"its tf has no '{self._map_frame}': things are placed in '{world}', and drift with it"
            self.summary.note(reason, f"time {stamp / NANOSECONDS:.3f}")
        self.frame = world
        return seen

    def _world_of(self, frame: str, last: bool) -> str:
        """The frame of the world; where tf knows of no map, that in which the robot moves, or else the message's."""
        world, transforms = self.frame or self._map_frame, self.camera.transforms
        if not last or self.frame or frame == world or transforms.knows(world):
            return world
        chain = transforms.chain(frame)
        return chain[-1] if transforms.moving.keys() & set(chain) else frame
