"""Worlds seen from above: walls and furniture as line segments, pillars and legs as circles."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from estimation.errors import InputError

Array = NDArray[np.float64]


def _no_owners() -> NDArray[np.int64]:
    return np.zeros(0, dtype=np.int64)


@dataclass(frozen=True)
class Shapes:
    """Outlines a laser can hit.

    segments : (S, 4) metres, x0, y0, x1, y1. circles : (C, 3) metres, x, y, radius.
    segment_owners, circle_owners : (S,), (C,) whose outline it is; 0 is the building, movers count from 1.
    """

    segments: Array = field(default_factory=lambda: np.zeros((0, 4)))
    circles: Array = field(default_factory=lambda: np.zeros((0, 3)))
    segment_owners: NDArray[np.int64] = field(default_factory=_no_owners)
    circle_owners: NDArray[np.int64] = field(default_factory=_no_owners)

    def __post_init__(self) -> None:
        if self.segments.ndim != 2 or self.segments.shape[1] != 4:
            raise InputError(f"segments: shape (S, 4) expected, got {self.segments.shape}")
        if self.circles.ndim != 2 or self.circles.shape[1] != 3:
            raise InputError(f"circles: shape (C, 3) expected, got {self.circles.shape}")
        # Owners may be left out: everything then belongs to the building.
        if len(self.segment_owners) != len(self.segments):
            object.__setattr__(self, "segment_owners", np.zeros(len(self.segments), dtype=np.int64))
        if len(self.circle_owners) != len(self.circles):
            object.__setattr__(self, "circle_owners", np.zeros(len(self.circles), dtype=np.int64))

    def owned_by(self, owner: int) -> Shapes:
        """The same outlines, all belonging to `owner`."""
        return Shapes(
            self.segments,
            self.circles,
            np.full(len(self.segments), owner, dtype=np.int64),
            np.full(len(self.circles), owner, dtype=np.int64),
        )

    def moved(self, pose: ArrayLike) -> Shapes:
        """The outlines given in the frame of `pose` (3,) x, y, yaw, in the frame `pose` is given in."""
        x, y, yaw = np.asarray(pose, dtype=np.float64)
        rotation = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
        ends = self.segments.reshape(-1, 2) @ rotation.T + [x, y]
        circles = self.circles.copy()
        circles[:, :2] = self.circles[:, :2] @ rotation.T + [x, y]
        return Shapes(ends.reshape(-1, 4), circles, self.segment_owners, self.circle_owners)

    def distance(self, point: ArrayLike) -> float:
        """Metres from `point` (2,) to the nearest outline; negative inside a circle, inf without any."""
        position = np.asarray(point, dtype=np.float64)
        nearest = np.inf
        if len(self.segments):
            start, along = self.segments[:, :2], self.segments[:, 2:] - self.segments[:, :2]
            length = np.maximum(np.einsum("ij,ij->i", along, along), 1e-12)
            at = np.clip(np.einsum("ij,ij->i", position - start, along) / length, 0.0, 1.0)
            gaps = np.linalg.norm(start + at[:, None] * along - position, axis=1)
            nearest = float(gaps.min())
        if len(self.circles):
            gaps = np.linalg.norm(self.circles[:, :2] - position, axis=1) - self.circles[:, 2]
            nearest = min(nearest, float(gaps.min()))
        return nearest


def unit(angle: float) -> Array:
    """Direction (2,) of an angle, rad."""
    return np.array([np.cos(angle), np.sin(angle)])


def joined(parts: Iterable[Shapes]) -> Shapes:
    """All outlines in one."""
    every = list(parts)
    if not every:
        return Shapes()
    return Shapes(
        np.concatenate([part.segments for part in every]),
        np.concatenate([part.circles for part in every]),
        np.concatenate([part.segment_owners for part in every]),
        np.concatenate([part.circle_owners for part in every]),
    )


def polygon(corners: ArrayLike, closed: bool = True) -> Shapes:
    """Outline through `corners` (K, 2) metres, closed or open."""
    points = np.asarray(corners, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 2 or len(points) < 2:
        raise InputError(f"corners: shape (K >= 2, 2) expected, got {points.shape}")
    ends = np.roll(points, -1, axis=0)
    segments = np.hstack((points, ends))
    return Shapes(segments if closed else segments[:-1])


def box(length: float, width: float, pose: ArrayLike = (0.0, 0.0, 0.0)) -> Shapes:
    """Rectangle of `length` × `width` metres centred on `pose` (3,) x, y, yaw, length along its x axis."""
    x, y = 0.5 * length, 0.5 * width
    return polygon([[-x, -y], [x, -y], [x, y], [-x, y]]).moved(pose)


def circle(x: float, y: float, radius: float) -> Shapes:
    """A circle, metres."""
    return Shapes(circles=np.array([[x, y, radius]], dtype=np.float64))
