"""What was recorded of a replay: poses, closures and diagnostics."""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass, field
from operator import itemgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound
from whereabouts.logs import MessageRecord, OdometryRecord, TransformRecord, open_log
from whereabouts.messages.decode import seconds
from whereabouts.messages.message_rotations import pose_in_plane, to_plane
from whereabouts.messages.records import MAP_FRAME, ODOM_FRAME

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
    corrections : stamps and (3,) of odom in map, in order.
    """

    stamps: Array
    poses: Array
    figures: dict[str, dict[str, str]] = field(default_factory=dict)
    keyframes: dict[float, Array] = field(default_factory=dict)
    closures: list[tuple[float, float, Array]] = field(default_factory=list)
    corrections: list[tuple[float, Array]] = field(default_factory=list)

    def correction(self, stamp: float) -> Array:
        """Odom in map (3,) as it was known at a stamp."""
        k = bisect_right(self.corrections, stamp + 0.11, key=itemgetter(0)) - 1
        return self.corrections[max(k, 0)][1] if self.corrections else np.zeros(3)

    def live(self) -> Array:
        """Poses (N, 3) in the map as they were said at the time."""
        poses = zip(self.stamps, self.poses, strict=True)
        return np.array([compound(self.correction(float(stamp)), pose) for stamp, pose in poses])

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
    corrections: list[tuple[float, Array]] = []
    topics = ["odometry", "diagnostics", "trajectory", "loop_closures", "tf"]
    with open_log(recording, topics=topics) as log:
        for record in log:
            if isinstance(record, OdometryRecord):
                poses[record.stamp] = np.asarray(record.pose)
            elif isinstance(record, TransformRecord):
                if (record.frame_id, record.child_frame_id) == (MAP_FRAME, ODOM_FRAME):
                    corrections.append((record.stamp, to_plane(record.transform)))
            elif isinstance(record, MessageRecord) and record.topic.strip("/") == "trajectory":
                keyframes = {
                    seconds(item.header.stamp): pose_in_plane(item.pose) for item in record.message.poses
                }
            elif isinstance(record, MessageRecord) and record.topic.strip("/") == "loop_closures":
                message = record.message
                stamps = seconds(message.earlier_stamp), seconds(message.header.stamp)
                closures.append((*stamps, pose_in_plane(message.relative.pose)))
            elif isinstance(record, MessageRecord):
                for status in record.message.status:
                    figures[status.name] = {item.key: item.value for item in status.values}
    ordered = sorted(poses)
    placed = np.array([poses[stamp] for stamp in ordered]).reshape(-1, 3)
    corrections.sort(key=itemgetter(0))
    return Replayed(np.array(ordered), placed, figures, keyframes, closures, corrections)
