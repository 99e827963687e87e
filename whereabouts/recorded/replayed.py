"""What was recorded of a replay: poses, closures and diagnostics, and how well they meet known revisits."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound
from whereabouts.logs import G2oGraph, MessageRecord, OdometryRecord, open_log

Array = NDArray[np.float64]
STEP = 0.1
"""m: the robot has moved once it is so far from where it was."""
BEST_REVISIT_AGE = 50


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
                keyframes = {_seconds(item.header.stamp): _planar(item.pose) for item in record.message.poses}
            elif isinstance(record, MessageRecord) and record.topic.strip("/") == "loop_closures":
                message = record.message
                stamps = _seconds(message.earlier_stamp), _seconds(message.header.stamp)
                closures.append((*stamps, _planar(message.relative.pose)))
            elif isinstance(record, MessageRecord):
                for status in record.message.status:
                    figures[status.name] = {item.key: item.value for item in status.values}
    ordered = sorted(poses)
    placed = np.array([poses[stamp] for stamp in ordered]).reshape(-1, 3)
    return Replayed(np.array(ordered), placed, figures, keyframes, closures)


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _planar(pose: Any) -> Array:
    p, q = pose.position, pose.orientation
    yaw = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return np.array([p.x, p.y, yaw])


def revisit_errors(poses: Array, graph: G2oGraph) -> Array:
    """Distance (K,) in metres by which the trajectory misses each known revisit of the graph.

    poses : (N, 3), one per vertex. For a constraint between vertices i and j with motion z the trajectory
    says that j lies at inverse(p_i) + p_j; the error is the distance between that and z.
    """
    rank = {int(vertex): index for index, vertex in enumerate(graph.ids)}
    errors = []
    for edge in graph.revisits:
        i, j = rank[edge.source], rank[edge.target]
        if abs(i - j) < BEST_REVISIT_AGE or max(i, j) >= len(poses):
            continue
        error = between(edge.motion, between(poses[i], poses[j]))
        errors.append(float(np.hypot(error[0], error[1])))
    return np.array(errors)


def revisit_recall(replayed: Replayed, graph: G2oGraph, near: float = 2.0) -> dict[str, float]:
    """How many known revisits of the graph were closed, and how well the corrected trajectory meets them.

    A revisit counts as closed where a closure joins places within `near` metres of path of its two ends. Closures are
    held against the solved poses too; those more than 3 m off are counted.
    """
    if not replayed.keyframes:
        return {}
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(replayed.poses[:, :2], axis=0).T))))
    ends = np.array([(a, b) for a, b, _ in replayed.closures]).reshape(-1, 2)
    index = np.clip(np.searchsorted(replayed.stamps, ends - 1e-4), 0, len(along) - 1)
    rank = {int(vertex): number for number, vertex in enumerate(graph.ids)}
    closed = 0
    for edge in graph.revisits:
        i, j = sorted((rank[edge.source], rank[edge.target]))
        if j - i < BEST_REVISIT_AGE or j >= len(along):
            continue
        close = (np.abs(along[index[:, 0]] - along[i]) < near) & (
            np.abs(along[index[:, 1]] - along[j]) < near
        )
        closed += bool(close.any())
    off = 0
    for (a, b), (_, _, relative) in zip(index, replayed.closures, strict=True):
        error = between(between(graph.poses[a], graph.poses[b]), relative)
        off += bool(np.hypot(*error[:2]) > 3.0)
    misses = revisit_errors(replayed.corrected, graph)
    return {
        "revisits_closed": closed,
        "closures_off": off,
        "closed_error_median_m": float(np.median(misses)) if len(misses) else float("nan"),
        "closed_error_95_m": float(np.quantile(misses, 0.95)) if len(misses) else float("nan"),
    }
