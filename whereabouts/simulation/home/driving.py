"""A robot that is told where to drive: it plans on the floor plan, and lets people pass."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt

from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.grid_paths import GridPaths
from whereabouts.simulation.home.floor_plan import Apartment
from whereabouts.simulation.shapes import Array
from world_model.tasks.maintenance_kernels import resampled

CELL = 0.1
"""m, of the floor plan."""
FREE, OCCUPIED = -2.0, 2.0
ASIDE = 0.5
"""m to the side of the robot's middle from which on somebody is not in its way."""
CLOSE = 0.75
"""Share of these distances that is kept on a way around somebody."""


@dataclass(frozen=True)
class Base:
    """What the robot can do.

    speed : m/s. turn_rate : rad/s. clearance : m, its middle keeps from walls and furniture. slow, stop : m from a
    person ahead at which it slows down, and stands. around : s of standing after which it looks for a way around them.
    patience : s without getting any farther after which it gives a goal up.
    """

    speed: float = 0.5
    turn_rate: float = 0.9
    clearance: float = 0.3
    slow: float = 1.3
    stop: float = 0.75
    around: float = 3.0
    patience: float = 25.0


def floor_plan(home: Apartment) -> OccupancyGrid:
    """What a robot can drive over: rooms and doors without furniture; tables are furniture, whatever is below them."""
    rooms = np.vstack([room.polygon for room in home.places.rooms])
    low, high = rooms.min(0) - CELL, rooms.max(0) + CELL
    columns, rows = (math.ceil(size / CELL) for size in high - low)
    grid = OccupancyGrid(CELL, low, np.full((rows, columns), FREE, dtype=np.float32))
    x, y = grid.centres(np.moveaxis(np.indices((rows, columns)), 0, -1)).transpose(2, 0, 1)
    for x0, y0, _, x1, y1, _ in home.blocks:
        half = 0.5 * CELL
        inside = (x > x0 - half) & (x < x1 + half) & (y > y0 - half) & (y < y1 + half)
        grid.log_odds[inside] = OCCUPIED
    return grid


class Driver:
    """Drives to one goal after the other.

    pose (3,) is where it truly is; goal (3,) the last one, moved to where it can stand. status : "idle", "driving",
    "reached" or "failed", of the last goal. metres : driven. stands : where it stood because of somebody, (2,) each.
    waited : s. closest : m, between the middles of the robot and of a person while it drove on.
    """

    def __init__(self, grid: OccupancyGrid, pose: Array, base: Base | None = None) -> None:
        self.base = base or Base()
        self.pose = np.array(pose, dtype=np.float64)
        self.status = "idle"
        self.metres, self.waited, self.closest = 0.0, 0.0, math.inf
        self.stands: list[Array] = []
        self._grid = grid
        self._room = distance_transform_edt(~grid.occupied) * grid.resolution
        self.goal = np.array(pose, dtype=np.float64)
        self._path: list[Array] = []
        self._standing, self._stuck, self._around, self._apart = 0.0, 0.0, False, 0.0

    def go(self, goal: Array, near: float = 1.5, apart: float = 0.0) -> bool:
        """Drive to a goal (3,) x, y, yaw, or to the nearest place within `near` metres of it that can be reached.

        A yaw that is nan leaves the heading as it is on arrival. False where there is no way. apart : m that the robot
        keeps from the place, which it then faces: something stands there.
        """
        self._standing, self._stuck, self._around, self._apart = 0.0, 0.0, False, apart
        found = self._plan(np.asarray(goal, dtype=np.float64), near, np.zeros((0, 2)))
        self.status = "driving" if found else "failed"
        return found

    def stop(self) -> None:
        self._path, self.status = [], "idle"

    def step(self, seconds: float, people: Array) -> None:
        """Go on for a moment, among people (P, 2)."""
        if self.status != "driving":
            return
        before = self.pose.copy()
        left = seconds
        while left > 1e-9 and self.status == "driving":
            left = self._turn_or_move(left, people)
        moved = float(np.hypot(*(self.pose - before)[:2]))
        self.metres += moved
        if moved > 0.0 and len(people):
            self.closest = min(self.closest, float(np.hypot(*(people - self.pose[:2]).T).min()))
        turned = abs(self.pose[2] - before[2]) > 1e-9
        self._stuck = 0.0 if moved > 0.0 or turned else self._stuck + seconds
        if self._stuck > self.base.patience:
            self._path, self.status = [], "failed"

    def _turn_or_move(self, seconds: float, people: Array) -> float:
        """Turn on the spot, or drive on; seconds that are left."""
        if not self._path:
            return self._face(self.goal[2], seconds, last=True)
        offset = self._path[0] - self.pose[:2]
        away = float(np.hypot(*offset))
        if away < 1e-6:
            self._path.pop(0)
            return seconds
        heading = math.atan2(offset[1], offset[0])
        if abs(_turn(heading - self.pose[2])) > 1e-6:
            return self._face(heading, seconds)
        speed = self._speed(people, seconds)
        if speed <= 0.0:
            return 0.0
        step = min(away, speed * seconds)
        self.pose[:2] += offset * (step / away)
        return seconds - step / speed

    def _face(self, heading: float, seconds: float, last: bool = False) -> float:
        turn = 0.0 if math.isnan(heading) else _turn(heading - self.pose[2])
        able = self.base.turn_rate * seconds
        if abs(turn) > able:
            self.pose[2] += math.copysign(able, turn)
            return 0.0
        if not math.isnan(heading):
            self.pose[2] = heading
        if last:
            self.status = "reached"
        return seconds - abs(turn) / self.base.turn_rate

    def _speed(self, people: Array, seconds: float) -> float:
        """m/s, with regard to who is ahead; stands for them, and looks for a way around those who stay."""
        base = self.base
        offsets = people - self.pose[:2]
        c, s = math.cos(self.pose[2]), math.sin(self.pose[2])
        forward, aside = offsets @ [c, s], np.abs(offsets @ [-s, c])
        # Who goes around somebody comes nearer.
        stop, width = (CLOSE * base.stop, CLOSE * ASIDE) if self._around else (base.stop, ASIDE)
        ahead = forward[(forward > 0.0) & (aside < width)]
        nearest = float(ahead.min(initial=math.inf))
        if nearest > stop:
            self._standing = 0.0
            share = (nearest - stop) / (base.slow - stop)
            return base.speed * min(1.0, max(share, 0.3))
        if self._standing == 0.0:
            self.stands.append(self.pose[:2].copy())
        self.waited += seconds
        self._standing += seconds
        if self._standing > base.around:
            self._standing = seconds
            self._apart = 0.0
            self._around = self._plan(self.goal, 0.8, people)
        return 0.0

    def _plan(self, goal: Array, near: float, people: Array) -> bool:
        """Make a way, with those who stand there as obstacles; without any the old one stays."""
        grid = self._grid
        if len(people):
            grid = OccupancyGrid(grid.resolution, grid.origin, grid.log_odds)
            centres = grid.centres(np.moveaxis(np.indices(grid.shape), 0, -1))
            for person in people[np.hypot(*(people - self.pose[:2]).T) < 2.5]:
                grid.log_odds[np.hypot(*(centres - person).transpose(2, 0, 1)) < 0.35] = OCCUPIED
        paths = GridPaths(grid, self.pose[:2], self.base.clearance)
        cells = np.argwhere(paths.reachable())
        if not len(cells):
            return False
        spots = grid.centres(cells)
        # What is far off its way is no better for being a little nearer.
        away = np.hypot(*(spots - goal[:2]).T)
        best = int(np.argmin(away))
        if self._apart > 0.0:
            ring = (away >= self._apart) & (away <= max(self._apart, away.min()) + grid.resolution)
            lengths = np.where(ring, paths.lengths(spots), np.inf)
            best = int(np.argmin(lengths))
        if away[best] > near:
            return False
        spot = goal[:2] if away[best] <= 0.71 * grid.resolution else spots[best]
        if self._apart > 0.0:
            goal = np.array([*goal[:2], math.atan2(*(goal[:2] - spot)[::-1])])
        points = paths.path(spots[best])
        if points is None:
            return False
        if not len(people):
            self.goal = np.array([*spot, goal[2]])
        self._path = self._straightened([*points[:-1], spot]) if not len(people) else [*points[1:-1], spot]
        return True

    def _straightened(self, points: list[Array]) -> list[Array]:
        """The same way by fewer corners, between places along it that can see each other."""
        points, kept, here = list(resampled(np.array(points), CELL)), [], 0
        while here < len(points) - 1:
            there = len(points) - 1
            while there > here + 1 and not self._open(points[here], points[there]):
                there -= 1
            kept.append(np.array(points[there]))
            here = there
        return kept

    def _open(self, start: Array, end: Array) -> bool:
        count = math.ceil(float(np.hypot(*(end - start))) / (0.5 * CELL)) + 1
        cells = self._grid.cells(np.linspace(start, end, count))
        return bool((self._room[cells[:, 0], cells[:, 1]] >= self.base.clearance).all())


def _turn(angle: float) -> float:
    """To between -π and π."""
    return (angle + math.pi) % (2.0 * math.pi) - math.pi
