"""A camera's messages, by their fields: what has come of its lens and its depth images, and which belong together."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from estimation.errors import InputError
from whereabouts.messages.compressed_depth import decompressed
from world_model.camera import CameraModel, DepthImage, ImageBox

KEPT = 30
"""Depth images that wait for detections: a second of a fast camera."""
TOLERANCE = 50_000_000
"""ns between detections and the depth image or scan of them, at most."""
ABSENCE_PERIOD = 200_000_000
"""ns between images whose missing detections count: pictures of the same view miss the same things."""


def camera_from_message(message: Any, rectified: bool) -> CameraModel:
    """The lens of a sensor_msgs/CameraInfo; rectified : whether images are straightened. Raises InputError."""
    lens = CameraModel.checked(
        (message.width, message.height),
        message.k,
        list(message.d),
        str(message.distortion_model),
        message.r,
        message.p,
        rectified,
    )
    roi = message.roi
    return lens.part(
        (message.binning_x, message.binning_y), (roi.x_offset, roi.y_offset, roi.width, roi.height)
    )


def depth_from_message(message: Any) -> DepthImage:
    """A sensor_msgs/Image or CompressedImage with depths. Raises InputError naming the field."""
    if hasattr(message, "format"):
        return decompressed(message)
    size = (int(message.width), int(message.height))
    return DepthImage.decoded(
        size, str(message.encoding), bytes(message.data), int(message.step), bool(message.is_bigendian)
    )


def box_from_message(bbox: Any) -> ImageBox:
    """A vision_msgs/BoundingBox2D; one that is turned is put into an upright one of its size."""
    centre = bbox.center.position
    return ImageBox(float(centre.x), float(centre.y), float(bbox.size_x), float(bbox.size_y))


@dataclass
class Cameras:
    """Lenses by frame, and the newest depth images or scans by stamp and frame.

    tolerance : ns, between detections and what belongs to them. rectified : whether images are straightened.
    """

    tolerance: int = TOLERANCE
    rectified: bool = False
    lenses: dict[str, CameraModel] = field(default_factory=dict)
    _kept: dict[tuple[int, str], Any] = field(default_factory=dict)
    _counted: dict[str, int] = field(default_factory=dict)

    def take_info(self, message: Any, frame: str) -> None:
        """A CameraInfo. Raises InputError, and what was known of that camera stays."""
        if not frame:
            raise InputError("header.frame_id is empty")
        self.lenses[frame] = camera_from_message(message, self.rectified)

    def keep(self, stamp: int, message: Any, frame: str = "") -> None:
        """A depth image or a scan of a frame that detections may come for; ns."""
        self._kept[stamp, frame] = message
        while len(self._kept) > KEPT * max(len(self.lenses), 1):
            del self._kept[min(self._kept)]

    def repeats(self, frame: str, stamp: int) -> bool:
        """Whether a look, ns, is another picture of what a camera has just looked at: both miss the same things."""
        last = self._counted.get(frame)
        if last is not None and 0 <= stamp - last < ABSENCE_PERIOD:
            return True
        self._counted[frame] = stamp
        return False

    @property
    def has_depth(self) -> bool:
        return bool(self._kept)

    def nearest(self, stamp: int, frame: str = "") -> tuple[int, Any] | None:
        """The depth image or scan nearest in time, of two the earlier; None where none is within the tolerance.

        frame : of the camera whose images are preferred.
        """
        within = [key for key in self._kept if abs(key[0] - stamp) <= self.tolerance]
        best = min(within, key=lambda key: (key[1] != frame, abs(key[0] - stamp), key), default=None)
        return None if best is None else (best[0], self._kept[best])

    def replace(self, stamp: int, read: Any, frame: str = "") -> None:
        """Keep what was made of a message in its place."""
        if (stamp, frame) in self._kept:
            self._kept[stamp, frame] = read

    def lens_for(self, frame: str, of_image: bool) -> tuple[str, CameraModel] | None:
        """The camera of detections in a frame, and its own frame; None where there is none.

        of_image : they are in its pixels, so that no other will do. Raises InputError where it cannot be told.
        """
        if frame in self.lenses:
            return frame, self.lenses[frame]
        if of_image:
            known = ", ".join(f"'{name}'" for name in self.lenses)
            raise InputError(
                f"detections are in the image of '{frame}', camera_info tells of {known}"
                if known
                else f"no camera_info of '{frame}' has come: what a pixel looks at is not known"
            )
        if len(self.lenses) == 1:
            return next(iter(self.lenses.items()))
        return None


def check_depth(depth: DepthImage, depth_frame: str, camera: CameraModel, frame: str) -> None:
    """Raises InputError where a depth image is not one of the camera that the detections are of."""
    if depth_frame != frame:
        raise InputError(
            f"the depth image is in frame '{depth_frame}', camera_info in '{frame}': register it to that image"
        )
    if depth.size != (camera.width, camera.height):
        width, height = depth.size
        raise InputError(
            f"the depth image has {width} x {height} pixels, camera_info tells of {camera.width} x {camera.height}"
        )
