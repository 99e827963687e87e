"""The apartment's morning as a rosbag2 recording: what the robot measured, and the truth on `ground_truth/*`."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from estimation.geometry.poses import pose_to_matrix
from whereabouts.logs import CloudRecord, McapWriter, OdometryRecord, ScanRecord, TransformRecord
from whereabouts.logs.bags.encode import time, xyz
from whereabouts.messages.type_names import EVIDENCE, TARGETS
from whereabouts.simulation.home.apartment_day import (
    CLOUD_RATE,
    LASER_MOUNT,
    THINGS,
    TICKS,
    ApartmentDay,
    Moment,
)
from whereabouts.simulation.home.floor_plan import CAMERA_HEIGHT, LASER_HEIGHT
from whereabouts.simulation.shapes import Array
from whereabouts.simulation.world_bag import SuiteMessages, distribution, pose
from whereabouts.system.clocks import NANOSECONDS

START = datetime(2026, 5, 4, 9, 0, tzinfo=UTC).timestamp()
STATE = "whereabouts_msgs/msg/WorldState"
GRAIN = 64.0
"""Points of the sparse cloud are rounded to 1/64 m, which is less than their error, to be small."""


def record(path: Path, duration: float | None = None, day: ApartmentDay | None = None) -> None:
    """Write the run, or its first `duration` seconds, to an MCAP file."""
    with McapWriter(path) as writer:
        recorder = MomentWriter(writer)
        for moment in (day or ApartmentDay()).moments(duration):
            recorder.write(moment)


class MomentWriter:
    """Writes moments as the robot's drivers publish them, and the truth."""

    def __init__(self, writer: McapWriter) -> None:
        self._writer = writer
        self._messages = SuiteMessages(EVIDENCE, TARGETS, STATE)
        self._topics = {
            "/evidence": self._messages.topic("/evidence", EVIDENCE),
            "/ground_truth/people": self._messages.topic("/ground_truth/people", TARGETS),
            "/ground_truth/objects": self._messages.topic("/ground_truth/objects", STATE),
        }
        laser = pose_to_matrix(np.array([*LASER_MOUNT[:2], LASER_HEIGHT, 0.0, 0.0, 0.0]))
        mount = TransformRecord(laser, START, "base_link", "laser", "tf_static")
        writer.write_transforms([mount], self._nanoseconds(0.0))

    def write(self, moment: Moment) -> None:
        """Everything of one moment, what others need to be placed first."""
        stamp, at = START + moment.time, self._nanoseconds(moment.time)
        self._writer.write_odometry(OdometryRecord(_rounded(moment.wheels), stamp), at)
        if moment.scan is not None:
            scan = ScanRecord(moment.scan, stamp)
            self._writer.write_scan(scan, at)
            truth = OdometryRecord(_rounded(moment.pose), stamp, "ground_truth/pose", "map", "base_link")
            self._writer.write_odometry(truth, at)
            self._raw("/ground_truth/people", TARGETS, self._people(moment, stamp), at)
        if moment.evidence is not None or moment.cloud is not None:
            head = pose_to_matrix(np.array([0.0, 0.0, CAMERA_HEIGHT, 0.0, 0.0, moment.pan]))
            self._writer.write_transforms([TransformRecord(head, stamp, "base_link", "camera", "tf")], at)
        if moment.evidence is not None:
            message = self._messages.evidence(moment.evidence, stamp, "camera")
            self._raw("/evidence", EVIDENCE, message, at)
        if moment.cloud is not None:
            points = np.round(moment.cloud * GRAIN) / GRAIN
            self._writer.write_cloud(CloudRecord(points, stamp, "points", "camera"), at)
        if round(moment.time * TICKS) % (TICKS // CLOUD_RATE) == 0:
            self._raw("/ground_truth/objects", STATE, self._objects(moment, stamp), at)

    @staticmethod
    def _nanoseconds(time: float) -> int:
        return round(START) * NANOSECONDS + round(time * NANOSECONDS)

    def _raw(self, topic: str, kind: str, message: Any, at: int) -> None:
        self._writer.write_raw(self._topics[topic], self._messages.serialized(message, kind), at)

    def _people(self, moment: Moment, stamp: float) -> Any:
        """Everybody: label from 1 on, beams of the scan in `measurement_rate`, `occluded` where there is none."""
        targets = [
            {
                "label": number,
                "label_probability": 1.0,
                "position": xyz([*_rounded(spot), 0.0]),
                "velocity": xyz([*_rounded(velocity), 0.0]),
                "weight": 1.0,
                "measurement_rate": float(returns),
                "class_distribution": distribution({"person": 1.0}),
                "last_seen": _time(stamp),
                "occluded": bool(returns == 0),
            }
            for number, (spot, velocity, returns) in enumerate(
                zip(moment.people, moment.velocities, moment.returns, strict=True), start=1
            )
        ]
        return self._messages.make(
            TARGETS,
            header={"stamp": _time(stamp), "frame_id": "map"},
            targets=targets,
            expected_count=float(len(targets)),
        )

    def _objects(self, moment: Moment, stamp: float) -> Any:
        """What lies about; what is carried is left out."""
        objects = [_object(name, spot, stamp) for name, spot in moment.things.items() if spot is not None]
        return self._messages.make(
            STATE,
            header={"stamp": _time(stamp), "frame_id": "map"},
            objects=objects,
            probability=1.0,
            expected_count=float(len(objects)),
        )


def _object(name: str, spot: Array, stamp: float) -> dict[str, Any]:
    item = THINGS[name][0]
    return {
        "id": name,
        "class_distribution": distribution({item.kind: 1.0}),
        "predicates": [item.color],
        "pose": {"pose": pose(spot)},
        "size": xyz(2.0 * np.array(item.half)),
        "existence_probability": 1.0,
        "region": {"center": pose(np.zeros(3))},
        "last_seen": _time(stamp),
        "first_seen": _time(START),
    }


def _time(stamp: float) -> dict[str, int]:
    return time(round(stamp * NANOSECONDS))


def _rounded(values: Array) -> Array:
    """To a tenth of a millimetre: what sine and cosine of another machine change is less."""
    return np.round(values, 4)
