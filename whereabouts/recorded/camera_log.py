"""The camera's door for a recorded bag: boxes, lenses, depth images and tf, without ROS."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.frame_tree import FrameTree, TransformError
from estimation.geometry.rotations import quaternion_from_rotation
from whereabouts.messages.compressed_depth import encoding_of
from whereabouts.messages.decode import nanoseconds, transforms
from whereabouts.messages.records import strip_slash
from whereabouts.messages.type_names import CAMERA_INFO, COMPRESSED, IMAGE, TF
from whereabouts.recorded.camera_messages import TOLERANCE, Cameras, check_depth, depth_from_message
from whereabouts.recorded.evidence_messages import Reader, SeenFrame
from whereabouts.system.clocks import NANOSECONDS
from world_model import WorldEvidence
from world_model.camera import CameraModel, DepthImage, SightRates, located
from world_model.camera.depth import ENCODINGS

TYPES = (TF, CAMERA_INFO, IMAGE, COMPRESSED)


@dataclass(frozen=True)
class CameraSettings:
    """Parameters of the node by these names; pose_covariance (3, 3) is of the robot's x, y, yaw."""

    map_frame: str = "map"
    base_frame: str = "base_link"
    camera_rectified: bool = False
    pose_covariance: Array | None = None


class CameraLog:
    """Takes what a bag tells of cameras and frames, in the order of recording; gives evidence of boxes by it.

    rates : how good the detector is, learned over the bag. map_frame : in which things are placed.
    """

    def __init__(self, reader: Reader, settings: CameraSettings) -> None:
        self.transforms = FrameTree()
        self.rates = SightRates()
        self._reader, self._settings = reader, settings
        self.map_frame = settings.map_frame
        self._cameras = Cameras(rectified=settings.camera_rectified)

    def take(self, kind: str, message: Any, topic: str) -> None:
        """One message of `TYPES`. Raises InputError."""
        if kind == TF:
            for record in transforms(message, topic):
                child, parent = strip_slash(record.child_frame_id), strip_slash(record.frame_id)
                if record.static:
                    self.transforms.fix(child, parent, record.transform)
                else:
                    stamp = round(record.stamp * NANOSECONDS)
                    turn = quaternion_from_rotation(record.transform[:3, :3])
                    self.transforms.move(child, parent, stamp, np.append(record.transform[:3, 3], turn))
            return
        frame, stamp = strip_slash(str(message.header.frame_id)), nanoseconds(message.header.stamp)
        if kind == CAMERA_INFO:
            self._cameras.take_info(message, frame)
        elif encoding_of(message) if kind == COMPRESSED else str(message.encoding) in ENCODINGS:
            self._cameras.keep(stamp, message, frame)

    def evidence(self, message: Any, frame: str, stamp: int, last: bool) -> tuple[WorldEvidence, list[str]]:
        """Of boxes in the image of a frame, at a stamp, ns, and why some could not be placed.

        last : whether nothing more is waited for.

        Raises TransformError, and InputError also where what belongs to them has not come.
        """
        found = self._cameras.lens_for(frame, of_image=True)
        assert found is not None
        robot = self.placed(frame, stamp)
        camera = found[1]
        depth, at = self._depth(frame, camera, stamp)
        turned = None
        if at != stamp:
            with suppress(*[TransformError] * last):
                then = self.transforms.lookup(self.map_frame, frame, at)
                turned = np.asarray(np.linalg.solve(then, robot.matrix))
        view = robot.view(camera, self.rates, frame, depth=depth, turned=turned)
        evidence, refused = self._reader.boxes(
            message, robot, view, lambda box, others: located(box, camera, depth, turned, others)
        )
        evidence.blocked = self._cameras.repeats(frame, stamp)
        return evidence, refused

    def placed(self, frame: str, stamp: int) -> SeenFrame:
        """A frame on the robot in the map, by tf. Raises TransformError."""
        frames = self.map_frame, self._settings.base_frame
        return SeenFrame.placed(self.transforms, frames, frame, stamp, self._settings.pose_covariance)

    def _depth(self, frame: str, camera: CameraModel, stamp: int) -> tuple[DepthImage, int]:
        """The depth image of detections, and its stamp, ns."""
        found = self._cameras.nearest(stamp, frame)
        if found is None:
            raise InputError(f"no depth image of '{frame}' within {1e-9 * TOLERANCE:g} s of these detections")
        depth = depth_from_message(found[1])
        check_depth(depth, strip_slash(str(found[1].header.frame_id)), camera, frame)
        return depth, found[0]
