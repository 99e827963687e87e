"""The camera's door: what a camera with any detector has seen, and what it would have seen if it were there.

No ROS here. `CameraModel` is the lens, `DepthImage` and `LevelScan` tell what hides, `CameraView` brings them together
with the camera's pose, `SightRates` learns how good the detector is, and `located` finds where the things in boxes are.
"""

from world_model.camera.boxes import ImageBox, LocatedBox, located, located_by_scan, overlap
from world_model.camera.camera_view import CameraView
from world_model.camera.depth import DepthImage, LevelScan
from world_model.camera.lens import CameraModel
from world_model.camera.rates import SightRates

__all__ = [
    "CameraModel",
    "CameraView",
    "DepthImage",
    "ImageBox",
    "LevelScan",
    "LocatedBox",
    "SightRates",
    "located",
    "located_by_scan",
    "overlap",
]
