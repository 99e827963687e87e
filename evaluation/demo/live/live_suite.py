"""How the live demo runs the suite: parameters as they are shipped, but for what tells of this home and this robot."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import pose_to_matrix
from evaluation.demo.demo_suite import parameters
from whereabouts.parameters.object_search import ObjectSearchParameters
from whereabouts.parameters.world_maintenance import WorldMaintenanceParameters
from whereabouts.parameters.world_model import WorldModelParameters
from whereabouts.recorded.evidence_messages import SeenFrame
from whereabouts.simulation.home.floor_plan import CAMERA_HEIGHT
from world_model import WorldEvidence

Array = NDArray[np.float64]

REACH = 4.0
"""m up to which the camera finds things; it sees a metre farther."""
NOBODY = {"class_names": ["person", "other"], "class_values": [1e6, 1e6]}
"""People come and go, and are not looked after."""


def live_parameters(folder: Path) -> dict[str, dict[str, Any]]:
    """Parameters by node, on top of the shipped files. folder : for the world model's memory."""
    recorded = parameters(folder)
    nothing: dict[str, dict[str, Any]] = {name: {} for name in recorded}
    world = recorded["world_model"]
    return nothing | {
        "world_model": world,
        "world_maintenance": {
            **NOBODY,
            "sensor_range_max": [REACH],
            "navigate": True,
        },
        "object_search": {"places_file": world["places_file"]},
    }


def library_settings() -> tuple[WorldModelParameters, WorldMaintenanceParameters, ObjectSearchParameters]:
    """The same for the libraries beneath the three nodes, without a memory."""
    given = live_parameters(Path())
    world = {name: value for name, value in given["world_model"].items() if name != "store_path"}
    return (
        WorldModelParameters(**world),
        WorldMaintenanceParameters(**given["world_maintenance"]),
        ObjectSearchParameters(**given["object_search"]),
    )


def placed(evidence: WorldEvidence, pose: Array, pan: float, covariance: Array) -> WorldEvidence:
    """What the simulated camera says, in the world.

    pose (3,) of the robot; pan, rad, of the camera on it; covariance (3, 3) that is taken for the pose.
    """
    eye = pose_to_matrix(np.array([pose[0], pose[1], CAMERA_HEIGHT, 0.0, 0.0, pose[2] + pan]))
    frame = SeenFrame(eye, pose[:2], covariance)
    objects = []
    for item in evidence.objects:
        position, turned = frame.position(np.asarray(item.position), np.asarray(item.covariance))
        objects.append(replace(item, position=position, covariance=turned))
    assert evidence.sensor is not None
    x, y, z, yaw = evidence.sensor["pose"]
    middle = eye[:3, 3] + np.array([x, y, z])
    sensor = {**evidence.sensor, "pose": (*middle, pose[2] + pan + yaw)}
    return WorldEvidence(objects, sensor)
