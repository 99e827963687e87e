"""A spinning multi-ring lidar among buildings, walls and trees, and rounds through such a neighbourhood."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Neighbourhood:
    """What stands on flat ground at z = 0.

    blocks : (B, 6) metres, lower and upper corners of boxes along the axes. poles : (P, 4) x, y, radius, height.
    """

    blocks: Array
    poles: Array


@dataclass(frozen=True)
class SpinningLidar:
    """Rings of beams at equally spaced elevations, a full turn each.

    rings, columns : beams per column and columns per turn. lowest, highest : radians of elevation.
    reach : metres. sigma : standard deviation of a range, metres. dropout : share of beams that return nothing.
    """

    rings: int = 16
    columns: int = 360
    lowest: float = math.radians(-15.0)
    highest: float = math.radians(15.0)
    reach: float = 60.0
    sigma: float = 0.02
    dropout: float = 0.02

    def cloud(self, world: Neighbourhood, pose: Array, rng: np.random.Generator) -> Array:
        """Points (N, 3) metres in the sensor frame; pose : (4, 4) of the sensor in the world."""
        azimuth, elevation = np.meshgrid(
            np.arange(self.columns) * 2.0 * np.pi / self.columns,
            np.linspace(self.lowest, self.highest, self.rings),
            indexing="ij",
        )
        turned, raised = azimuth.ravel(), elevation.ravel()
        rays = np.column_stack(
            (np.cos(raised) * np.cos(turned), np.cos(raised) * np.sin(turned), np.sin(raised))
        )
        directions = rays @ pose[:3, :3].T
        ranges = distances(world, pose[:3, 3], directions)
        ranges = ranges + self.sigma * rng.standard_normal(len(ranges))
        kept = (ranges < self.reach) & (ranges > 0.5) & (rng.random(len(ranges)) >= self.dropout)
        return np.asarray(rays[kept] * ranges[kept, None])


def distances(world: Neighbourhood, origin: Array, directions: Array) -> Array:
    """Metres to the first surface along each direction (N, 3), inf where there is none; (N,)."""
    with np.errstate(divide="ignore", invalid="ignore"):
        down = np.where(directions[:, 2] < 0.0, -origin[2] / directions[:, 2], np.inf)
        nearest = np.array(down)
        for block in world.blocks:
            near, far = (block[:3] - origin) / directions, (block[3:] - origin) / directions
            enter = np.minimum(near, far).max(axis=1)
            leave = np.maximum(near, far).min(axis=1)
            nearest = np.where((enter <= leave) & (enter > 0.0), np.minimum(nearest, enter), nearest)
        flat = np.linalg.norm(directions[:, :2], axis=1)
        for x, y, radius, height in world.poles:
            to = np.array([x, y]) - origin[:2]
            along = directions[:, :2] @ to / flat
            square = radius**2 - (to @ to - along**2)
            hit = (along - np.sqrt(square)) / flat
            top = origin[2] + hit * directions[:, 2]
            good = (square > 0.0) & (hit > 0.0) & (top < height)
            nearest = np.where(good, np.minimum(nearest, hit), nearest)
    return np.asarray(nearest)


def random_neighbourhood(rng: np.random.Generator, half: float = 22.0) -> Neighbourhood:
    """Houses and trees inside and outside of a square round of `half` metres to either side of the origin."""
    blocks, poles = [], []
    for ring, count in ((half - 11.0, 7), (half + 11.0, 16)):
        for k in range(count):
            angle = 2.0 * np.pi * (k + rng.uniform(-0.25, 0.25)) / count
            # On a square, not on a circle: distance to the road stays the same.
            scale = ring / max(abs(math.cos(angle)), abs(math.sin(angle)))
            x, y = scale * math.cos(angle), scale * math.sin(angle)
            w, d, h = rng.uniform(2.0, 5.0), rng.uniform(2.0, 5.0), rng.uniform(2.5, 8.0)
            blocks.append([x - w, y - d, 0.0, x + w, y + d, h])
    for _ in range(50):
        x, y = rng.uniform(-half - 14.0, half + 14.0, 2)
        road = abs(max(abs(x), abs(y)) - half)
        inside = any(b[0] - 0.5 < x < b[3] + 0.5 and b[1] - 0.5 < y < b[4] + 0.5 for b in blocks)
        if road > 2.5 and not inside:
            poles.append([x, y, rng.uniform(0.1, 0.35), rng.uniform(3.0, 7.0)])
    clear = [b for b in blocks if _clear_of_road(np.array(b), half)]
    return Neighbourhood(np.array(clear), np.array(poles))


def _clear_of_road(block: Array, half: float) -> bool:
    corners = np.array([[block[i], block[j]] for i in (0, 3) for j in (1, 4)])
    away = np.abs(corners).max(axis=1)
    return bool((away < half - 2.5).all() or _nearest(block) > half + 2.5)


def _nearest(block: Array) -> float:
    """Least Chebyshev distance of a block from the origin."""
    x = 0.0 if block[0] <= 0.0 <= block[3] else min(abs(block[0]), abs(block[3]))
    y = 0.0 if block[1] <= 0.0 <= block[4] else min(abs(block[1]), abs(block[4]))
    return max(x, y)


def round_trip(count: int = 200, half: float = 22.0, overlap: float = 30.0, height: float = 1.5) -> Array:
    """Poses (count, 4, 4) along the square round and `overlap` metres into the second time, corners rounded."""
    length = 8.0 * half + overlap
    radius = 4.0
    poses = np.tile(np.eye(4), (count, 1, 1))
    straight = 2.0 * (half - radius)
    quarter = 0.5 * math.pi * radius
    lap = 4.0 * (straight + quarter)
    for k in range(count):
        s = (k * length / (count - 1)) % lap
        side, rest = divmod(s, straight + quarter)
        if rest < straight:
            x, y, yaw = -half + radius + rest, -half, 0.0
        else:
            bend = (rest - straight) / radius
            x, y, yaw = half - radius + radius * math.sin(bend), -half + radius * (1.0 - math.cos(bend)), bend
        turn = 0.5 * math.pi * side
        c, sn = math.cos(turn), math.sin(turn)
        poses[k, :2, 3] = [c * x - sn * y, sn * x + c * y]
        heading = yaw + turn
        poses[k, :2, :2] = [[math.cos(heading), -math.sin(heading)], [math.sin(heading), math.cos(heading)]]
        poses[k, 2, 3] = height
    return poses
