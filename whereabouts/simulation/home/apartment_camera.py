"""A camera on a head that turns from side to side: which things it detects, and a sparse depth image."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from whereabouts.simulation.home.floor_plan import CAMERA_HEIGHT, first_hits
from whereabouts.simulation.objects import classified
from whereabouts.simulation.shapes import Array
from world_model import ObjectEvidence, WorldEvidence

BODY = (0.22, 1.75)
"""m, half the width and the height of a person for whom a camera cannot see past."""


@dataclass(frozen=True)
class Item:
    """A thing of the apartment: its class and colour, and half its size in m."""

    kind: str
    color: str
    half: tuple[float, float, float] = (0.05, 0.05, 0.05)


@dataclass(frozen=True)
class Camera:
    """Field of view and errors.

    opening : rad, horizontal. reach : m. down, up : rad, of what is recognised. sure : rad, half the height of the part
    in which what is not reported is not there. swing, period : rad and s, of the head. detected : share of visible
    things that are reported. false_per_look : detections of nothing. accuracy : how often class and colour are right.
    sigma_range : m per m. sigma_bearing : rad. sigma_height : m.
    """

    opening: float = 1.2
    reach: float = 5.0
    down: float = 0.75
    up: float = 0.25
    sure: float = 0.3
    swing: float = 0.9
    period: float = 7.0
    detected: float = 0.9
    false_per_look: float = 0.04
    accuracy: float = 0.92
    sigma_range: float = 0.012
    sigma_bearing: float = 0.008
    sigma_height: float = 0.015

    def pan(self, time: float) -> float:
        """Where the head looks, rad to the left of straight ahead."""
        return self.swing * math.sin(2.0 * math.pi * time / self.period)

    def look(
        self,
        rng: np.random.Generator,
        pose: Array,
        blocks: Array,
        things: Mapping[str, tuple[Item, Array]],
    ) -> WorldEvidence:
        """Evidence in the frame of the camera, from its pose (3,) x, y, yaw.

        blocks : all that hides. things : by name, with the position (3,) of each that lies about.
        """
        kinds = sorted({item.kind for item, _ in things.values()})
        colors = sorted({item.color for item, _ in things.values()})
        found = []
        for item, position in things.values():
            local = self._local(pose, position)
            if self._visible(pose, local, blocks, position) and rng.random() < self.detected:
                found.append(self._detection(rng, local, item, kinds, colors))
        view = self._clear_view(pose, blocks)
        for _ in range(rng.poisson(self.false_per_look)):
            bearing, away = view["pose"][3] + rng.uniform(-0.4, 0.4) * view["angle"], rng.uniform(0.8, 4.0)
            local = np.array([away * math.cos(bearing), away * math.sin(bearing), rng.uniform(-0.8, -0.2)])
            item = Item(str(rng.choice(kinds)), str(rng.choice(colors)))
            found.append(self._detection(rng, local, item, kinds, colors))
        order = rng.permutation(len(found))
        return WorldEvidence([found[k] for k in order], view)

    def depth(self, rng: np.random.Generator, pose: Array, blocks: Array, shape: tuple[int, int]) -> Array:
        """Points (N, 3) in the camera's frame, one for each of `shape` (columns, rows) directions that meet
        something.
        """
        yaws = np.linspace(0.5, -0.5, shape[0]) * self.opening
        pitches = np.linspace(self.up, -self.down, shape[1])
        yaw, pitch = (grid.ravel() for grid in np.meshgrid(yaws, pitches))
        rays = np.stack([np.cos(pitch) * np.cos(yaw), np.cos(pitch) * np.sin(yaw), np.sin(pitch)], axis=1)
        ranges = first_hits(blocks, np.array([*pose[:2], CAMERA_HEIGHT]), _turned(rays, pose[2]))
        with np.errstate(divide="ignore"):
            floor = np.where(rays[:, 2] < 0.0, -CAMERA_HEIGHT / rays[:, 2], np.inf)
        ranges = np.minimum(np.minimum(ranges, floor), 2.0 * self.reach)
        ranges = ranges * (1.0 + self.sigma_range * rng.standard_normal(len(rays)))
        seen = ranges < self.reach
        return np.asarray(rays[seen] * ranges[seen, None])

    def sees(self, pose: Array, blocks: Array, position: Array) -> bool:
        """Whether a thing at a position (3,) of the world could be detected from a pose (3,); blocks : what hides."""
        return self._visible(pose, self._local(pose, position), blocks, position)

    def _local(self, pose: Array, position: Array) -> Array:
        """A position of the world in the frame of the camera."""
        offset = np.array([*(position[:2] - pose[:2]), position[2] - CAMERA_HEIGHT])
        return _turned(offset[None], -pose[2])[0]

    def _visible(self, pose: Array, local: Array, blocks: Array, position: Array) -> bool:
        level, away = math.hypot(*local[:2]), float(np.linalg.norm(local))
        bearing, elevation = math.atan2(local[1], local[0]), math.atan2(local[2], level)
        if abs(bearing) > 0.5 * self.opening or not 0.4 < away < self.reach:
            return False
        if not -self.down < elevation < self.up:
            return False
        origin = np.array([*pose[:2], CAMERA_HEIGHT])
        hit = first_hits(blocks, origin, ((position - origin) / away)[None])[0]
        return bool(hit > away - 0.15)

    def _clear_view(self, pose: Array, blocks: Array) -> dict[str, Any]:
        """The largest part of the view that nothing upright stands in: what is not reported in it is not there."""
        bearings = np.linspace(-0.5, 0.5, 15) * self.opening
        rays = np.stack([np.cos(bearings), np.sin(bearings), np.zeros(15)], axis=1)
        origin = np.array([*pose[:2], 1.0])
        depth = np.minimum(first_hits(blocks, origin, _turned(rays, pose[2])) - 0.1, self.reach - 0.2)
        best, chosen = 0.0, (6, 8, 0.5)
        for a in range(15):
            for b in range(a + 2, 15):
                free = float(depth[a : b + 1].min())
                area = (b - a) * max(free, 0.0) ** 2
                if area > best:
                    best, chosen = area, (a, b, free)
        a, b, free = chosen
        middle = float(0.5 * (bearings[a] + bearings[b]))
        return {
            "pose": (0.0, 0.0, 0.0, middle), "range": max(free, 0.4), "angle": float(bearings[b] - bearings[a]),
            "range_min": 0.3, "vertical_angle": 2.0 * self.sure,
        }  # fmt: skip

    def _detection(
        self,
        rng: np.random.Generator,
        local: Array,
        item: Item,
        kinds: Sequence[str],
        colors: Sequence[str],
    ) -> ObjectEvidence:
        level, bearing = math.hypot(*local[:2]), math.atan2(local[1], local[0])
        sigma = np.array(
            [0.01 + self.sigma_range * level, 0.01 + self.sigma_bearing * level, self.sigma_height]
        )
        noise = rng.standard_normal(3) * sigma
        turn = _turned(np.eye(3), bearing).T
        attributes = {
            "class": classified(rng, item.kind, kinds, self.accuracy),
            "color": classified(rng, item.color, colors, self.accuracy),
        }
        return ObjectEvidence(local + turn @ noise, turn @ np.diag(sigma**2) @ turn.T, attributes)


def person_block(position: Array) -> list[float]:
    """A person (2,) as what hides something from a camera."""
    x, y = position
    return [x - BODY[0], y - BODY[0], 0.0, x + BODY[0], y + BODY[0], BODY[1]]


def _turned(vectors: Array, angle: float) -> Array:
    """Vectors (N, 3) turned about z."""
    c, s = math.cos(angle), math.sin(angle)
    return vectors @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
