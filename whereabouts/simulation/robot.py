"""A robot that drives a path, and the wheels that report it with their errors."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from estimation.errors import InputError
from whereabouts.simulation.shapes import Array


class Drive:
    """A path through waypoints at constant speed, with corners turned on the spot.

    waypoints : (K, 2) metres. speed : m/s. turn_rate : rad/s. rests : (K,) seconds at each waypoint before it turns on,
    zeros where left out. Call with a time in seconds for the pose (3,); before the start and after `duration` the
    robot stands.
    """

    def __init__(
        self,
        waypoints: ArrayLike,
        speed: float = 0.6,
        turn_rate: float = 0.8,
        rests: ArrayLike | None = None,
    ) -> None:
        points = np.asarray(waypoints, dtype=np.float64)
        if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
            raise InputError(f"waypoints: shape (K >= 2, 2) expected, got {points.shape}")
        pauses = np.zeros(len(points)) if rests is None else np.asarray(rests, dtype=np.float64)
        if pauses.shape != (len(points),) or (pauses < 0.0).any():
            raise InputError(f"rests: one of at least 0 s for each waypoint expected, got {rests!r}")
        legs = np.diff(points, axis=0)
        lengths = np.linalg.norm(legs, axis=1)
        moving = lengths > 1e-9
        legs, lengths = legs[moving], lengths[moving]
        headings = np.unwrap(np.arctan2(legs[:, 1], legs[:, 0]))
        times, poses = [0.0], [np.array([*points[0], headings[0]])]
        for leg, length, heading, pause in zip(legs, lengths, headings, pauses[:-1][moving], strict=True):
            if pause > 0.0:
                times.append(times[-1] + pause)
                poses.append(poses[-1])
            turn = heading - poses[-1][2]
            if abs(turn) > 1e-9:
                times.append(times[-1] + abs(turn) / turn_rate)
                poses.append(np.array([*poses[-1][:2], heading]))
            times.append(times[-1] + length / speed)
            poses.append(np.array([*(poses[-1][:2] + leg), heading]))
        times.append(times[-1] + pauses[-1])
        poses.append(poses[-1])
        self._times, self._poses = np.array(times), np.array(poses)

    @property
    def duration(self) -> float:
        """Seconds from start to end."""
        return float(self._times[-1])

    def __call__(self, time: float) -> Array:
        return np.array([np.interp(time, self._times, self._poses[:, k]) for k in range(3)])


def relative(a: ArrayLike, b: ArrayLike) -> Array:
    """Pose b (3,) seen from pose a (3,): the motion from a to b."""
    first, second = np.asarray(a, dtype=np.float64), np.asarray(b, dtype=np.float64)
    cosine, sine = np.cos(first[2]), np.sin(first[2])
    dx, dy = second[:2] - first[:2]
    turn = second[2] - first[2]
    return np.array(
        [cosine * dx + sine * dy, -sine * dx + cosine * dy, np.arctan2(np.sin(turn), np.cos(turn))]
    )


@dataclass(frozen=True)
class Wheels:
    """Errors of wheel odometry.

    scale : systematic factor on distance, 1 is right. bias : radians of heading error per metre.
    per_metre : standard deviation of distance per √m, metres. per_radian : of heading per √rad, radians.
    """

    scale: float = 1.0
    bias: float = 0.0
    per_metre: float = 0.02
    per_radian: float = 0.03

    def motion(self, a: ArrayLike, b: ArrayLike, rng: np.random.Generator) -> Array:
        """What the wheels report between true poses a and b, (3,) each: motion in the frame of a."""
        motion = relative(a, b)
        distance = float(np.hypot(motion[0], motion[1]))
        stretch = self.scale + self.per_metre * rng.standard_normal() / np.sqrt(max(distance, 1e-3))
        drift = self.bias * distance + self.per_radian * np.sqrt(abs(motion[2])) * rng.standard_normal()
        return np.array([motion[0] * stretch, motion[1] * stretch, motion[2] + drift])
