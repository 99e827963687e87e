"""The inputs of `world_model` that a camera with any detector has: boxes, lenses, depth images or scans.

What was in view comes from them, so that what a detector does not report is evidence, too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any

import numpy as np
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, LaserScan
from vision_msgs.msg import Detection2DArray, Detection3DArray

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.frame_tree import TransformError
from whereabouts.messages.compressed_depth import SUFFIXES
from whereabouts.nodes.messages.conversions import scan_from_message
from whereabouts.nodes.messages.packed import Packed
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.messages.transforms import frame_name
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.recorded.camera_messages import TOLERANCE, Cameras, check_depth, depth_from_message
from whereabouts.recorded.evidence_messages import SeenFrame
from world_model.camera import (
    CameraModel,
    CameraView,
    DepthImage,
    ImageBox,
    LevelScan,
    LocatedBox,
    SightRates,
)
from world_model.camera import located as placed_by_depth
from world_model.camera import located_by_scan as placed_by_scan
from world_model.camera.rates import SUFFIX
from world_model.kept_file import KeptFile
from world_model.memory.store import Store


class CameraDoor:
    """A node's camera inputs, and the view at a stamp.

    store : the world's. take_boxes, take_detections : handlers of `detections_2d` and `detections`. kept : the file of
    what was learned.
    """

    def __init__(
        self,
        node: SuiteNode,
        map_frame: str,
        store: Store | None,
        take_boxes: Callable[[Detection2DArray, int], None],
        take_detections: Callable[[Detection3DArray, int], None],
    ) -> None:
        self._node, self._map = node, map_frame
        settings = node.settings
        self.from_scan = settings.depth_from_scan
        self.cameras = Cameras()
        self.rates = SightRates()
        beside = None if store is None else store.path.with_name(store.path.name + SUFFIX)
        self.kept = KeptFile(beside, "rates of detection", self.rates.read, self.rates.write)
        self.reset()
        node.add_input(CameraInfo, settings.camera_info_topic, self._take_info, sensor=False)
        topic = settings.scan_topic if self.from_scan else settings.depth_topic
        packed = node.resolve_topic_name(topic).endswith(SUFFIXES)
        kind = LaserScan if self.from_scan else CompressedImage if packed else Image
        self._depth = node.add_input(
            kind, topic, self._take_depth, sensor=False, packed=not self.from_scan, awaited=True
        )
        # Detections come after the image they are of, but a depth image may take longer to be registered to it.
        given: dict[str, Any] = {"frames": self._frames, "companions": [self._depth]}
        self._detections = [
            node.add_input(Detection3DArray, settings.detections_topic, take_detections, **given),
            node.add_input(Detection2DArray, settings.detections_2d_topic, take_boxes, **given),
        ]

    def reset(self) -> None:
        """A new run: lenses stay, images go."""
        self.cameras = Cameras(rectified=self._node.settings.camera_rectified, lenses=self.cameras.lenses)
        self.without_depth = self.unplaced = 0

    def keep(self, stamp: int, now: bool = False) -> None:
        """Write what was learned at a stamp, ns, now and then or `now`. Does not raise."""
        if self.rates.looks:
            self.kept.keep(stamp / NANOSECONDS, now)

    def _frames(self, message: Any) -> list[tuple[str, str]]:
        """What tf must know: where detections are, and where the camera was."""
        frame = frame_name(message.header.frame_id)
        wanted = [frame] if frame else []
        if frame not in self.cameras.lenses and len(self.cameras.lenses) == 1:
            wanted += list(self.cameras.lenses)
        return [(self._map, name) for name in wanted]

    def _take_info(self, message: CameraInfo, stamp: int) -> None:
        self.cameras.take_info(message, frame_name(message.header.frame_id))

    def _take_depth(self, message: Any, stamp: int) -> None:
        # A depth image stays packed; a scan is of no camera.
        self.cameras.keep(stamp, message, "" if self.from_scan else frame_name(message.frame))
        for item in self._detections:
            item.serve_waiting()

    def lens_of(self, message: Any, of_image: bool) -> tuple[str, CameraModel] | None:
        """The camera that detections are of, with its frame; None where nobody says. Raises InputError."""
        return self.cameras.lens_for(frame_name(message.header.frame_id), of_image)

    def view(self, lens: tuple[str, CameraModel], stamp: int, robot: SeenFrame) -> CameraView:
        """What the camera saw at a stamp, ns; robot : as `SeenFrame` of the camera has it. Raises TransformError."""
        frame, camera = lens
        self.keep(stamp)
        if self.from_scan:
            scan = self._scan(stamp, robot.matrix[:3, 3])
            return robot.view(camera, self.rates, frame, scan=scan)
        depth, at = self._image(stamp, frame, camera)
        turned = None
        if at != stamp:
            with suppress(TransformError):
                then = self._node.transforms.lookup(self._map, frame, at)
                turned = np.asarray(np.linalg.solve(then, robot.matrix))
        return robot.view(camera, self.rates, frame, depth=depth, turned=turned)

    def says_nothing(self, view: CameraView, stamp: int, frame: str) -> bool:
        """Whether what a look did not show means nothing: what hides things is not known, or it is another picture of
        the same view: those miss the same things.
        """
        if view.depth is None and view.scan is None and self.cameras.has_depth:
            self.without_depth += 1
            return True
        return self.cameras.repeats(frame, stamp)

    def placing(self, view: CameraView) -> Callable[[ImageBox, Sequence[ImageBox]], LocatedBox]:
        """Where the object in a box is, in the camera's frame, among other boxes.

        Raises InputError where there is no depth at all.
        """
        if view.depth is not None:
            depth = view.depth
            return lambda box, others: placed_by_depth(box, view.camera, depth, view.turned, others)
        if view.scan is not None:
            scan = view.scan
            return lambda box, others: placed_by_scan(box, view.camera, view.pose, scan)
        raise InputError(
            f"no usable message on {self._depth.topic} within {1e-9 * TOLERANCE:g} s of these detections: "
            "how far away things are is not known"
        )

    def _image(self, stamp: int, frame: str, camera: CameraModel) -> tuple[DepthImage | None, int]:
        """The depth image of detections, and its stamp, ns."""
        found = self.cameras.nearest(stamp, frame)
        if found is None or found[1] is None:
            return None, stamp
        at, kept = found
        own = frame_name(kept.frame) if isinstance(kept, Packed) else kept[0]
        try:
            if isinstance(kept, Packed):
                kept = (own, depth_from_message(kept.unpack()))
                self.cameras.replace(at, kept, own)
            check_depth(kept[1], own, camera, frame)
        except InputError as error:
            self._depth.refuse(str(error))
            # That of another camera is of use to that one.
            if own == frame:
                self.cameras.replace(at, None, own)
            return None, stamp
        return kept[1], at

    def _scan(self, stamp: int, origin: Array) -> LevelScan | None:
        found = self.cameras.nearest(stamp)
        if found is None:
            return None
        at, message = found
        try:
            points = scan_from_message(message).points()
            frame = frame_name(message.header.frame_id)
            there = self._node.transforms.lookup(self._map, frame, at)
        except (InputError, TransformError) as error:
            self._depth.refuse(str(error))
            return None
        level = np.column_stack([points, np.zeros(len(points))])
        return LevelScan(level @ there[:3, :3].T + there[:3, 3], origin)
