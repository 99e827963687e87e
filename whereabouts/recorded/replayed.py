"""What was recorded of a replay: poses, closures and diagnostics."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound
from whereabouts.logs import MessageRecord, OdometryRecord, open_log
from whereabouts.messages.decode import seconds

Array = NDArray[np.float64]
STEP = 0.1
"""m: the robot has moved once it is so far from where it was."""


@dataclass
class Replayed:
    """What the suite said during a replay.

    stamps (N,), poses (N, 3) : of `odometry`.
    figures : the last diagnostics of each node, by node and key.
    keyframes {stamp: pose (3,)} : the corrected trajectory, as last published.
    closures : (stamp of the earlier, of the later, relative pose (3,)).
    """

    stamps: Array
    poses: Array
    figures: dict[str, dict[str, str]] = field(default_factory=dict)
    keyframes: dict[float, Array] = field(default_factory=dict)
    closures: list[tuple[float, float, Array]] = field(default_factory=list)

    @property
    def corrected(self) -> Array:
        """Poses (N, 3) in the map: each hangs on the keyframe before it; empty where nothing was mapped."""
        if not self.keyframes:
            return np.zeros((0, 3))
        known = np.array(sorted(self.keyframes))
        own = {round(float(stamp), 4): pose for stamp, pose in zip(self.stamps, self.poses, strict=True)}
        placed = []
        for stamp, pose in zip(self.stamps, self.poses, strict=True):
            key = float(known[max(int(np.searchsorted(known, stamp + 1e-4)) - 1, 0)])
            there = own.get(round(key, 4))
            placed.append(pose if there is None else compound(self.keyframes[key], between(there, pose)))
        return np.array(placed)

    @property
    def path_length(self) -> float:
        """Length of the trajectory in metres, without the trembling of a pose that stands still."""
        length = 0.0
        counted = self.poses[:1, :2]
        for xy in self.poses[:, :2]:
            step = math.hypot(*(xy - counted[0]).tolist())
            if step >= STEP:
                length, counted = length + step, xy[None]
        return length


def read_replay(recording: Path) -> Replayed:
    """Collect a recording of the suite's output."""
    poses: dict[float, Array] = {}
    figures: dict[str, dict[str, str]] = {}
    keyframes: dict[float, Array] = {}
    closures: list[tuple[float, float, Array]] = []
    topics = ["odometry", "diagnostics", "trajectory", "loop_closures"]
    with open_log(recording, topics=topics) as log:
        for record in log:
            if isinstance(record, OdometryRecord):
                poses[record.stamp] = np.asarray(record.pose)
            elif isinstance(record, MessageRecord) and record.topic.strip("/") == "trajectory":
                keyframes = {seconds(item.header.stamp): _planar(item.pose) for item in record.message.poses}
            elif isinstance(record, MessageRecord) and record.topic.strip("/") == "loop_closures":
                message = record.message
                stamps = seconds(message.earlier_stamp), seconds(message.header.stamp)
                closures.append((*stamps, _planar(message.relative.pose)))
            elif isinstance(record, MessageRecord):
                for status in record.message.status:
                    figures[status.name] = {item.key: item.value for item in status.values}
    ordered = sorted(poses)
    placed = np.array([poses[stamp] for stamp in ordered]).reshape(-1, 3)
    return Replayed(np.array(ordered), placed, figures, keyframes, closures)


def _planar(pose: Any) -> Array:
    p, q = pose.position, pose.orientation
    yaw = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return np.array([p.x, p.y, yaw])
