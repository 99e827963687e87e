"""Compiled loop of the social forces: several people step by step, each along its own way."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray

IntArray = NDArray[np.int64]
BRAKING = 0.4  # s
SURELY = 10.0  # s
PASSED = 1.5  # m


@njit(cache=True)
def push(distance: float, strength: float, spread: float, hard: float, radii: float) -> float:
    """Size of the acceleration (4.17) + (4.18) away from something at a distance."""
    overlap = radii - distance
    size = strength * math.exp(min(overlap / spread, 0.0))
    if overlap > 0.0:
        size += hard * overlap
    return size


@njit(cache=True)
def nearest_in_cells(
    x: float,
    y: float,
    obstacles: FloatArray,
    cells: IntArray,
    origin: FloatArray,
    size: float,
    shape: IntArray,
) -> int:
    """Index of the nearest obstacle within the nine cells around a place, -1 where there is none."""
    column = math.floor((x - origin[0]) / size)
    row = math.floor((y - origin[1]) / size)
    best, found = np.inf, -1
    for i in range(max(column - 1, 0), min(column + 2, shape[0])):
        for j in range(max(row - 1, 0), min(row + 2, shape[1])):
            cell = i * shape[1] + j
            for k in range(cells[cell], cells[cell + 1]):
                dx, dy = x - obstacles[k, 0], y - obstacles[k, 1]
                away = dx * dx + dy * dy
                if away < best:
                    best, found = away, k
    return found


@njit(cache=True)
def walk(
    states: FloatArray,
    speeds: FloatArray,
    ways: FloatArray,
    lengths: IntArray,
    moving: NDArray[np.bool_],
    steps: int,
    dt: float,
    relaxation: FloatArray,
    arriving: FloatArray,
    people: FloatArray,
    walls: FloatArray,
    obstacles: FloatArray,
    cells: IntArray,
    origin: FloatArray,
    size: float,
    shape: IntArray,
    near: float,
) -> FloatArray:
    """States (steps + 1, P, 4) of people that start at `states` (P, 4) x, y, vx, vy.

    Person p wants to go at speeds[p] along ways[p, :lengths[p]], and to stand at its end; with moving[p] False it only
    goes on as it is. relaxation (P,) s; arriving (P,) in (0, 1]: how surely it stops at the end.
    people, walls: strength m/s², range m, hard 1/s², radii m.
    """
    count = len(states)
    out = np.empty((steps + 1, count, 4))
    out[0] = states
    at = np.zeros(count, dtype=np.int64)
    # What somebody bears already, from companions or along a wall, does not turn him: only more of it does.
    borne = np.zeros((count, count))
    for k in range(steps):
        for p in range(count):
            x, y, vx, vy = out[k, p, 0], out[k, p, 1], out[k, p, 2], out[k, p, 3]
            ax, ay = 0.0, 0.0
            if moving[p]:
                last = lengths[p] - 1
                gx, gy = ways[p, at[p], 0] - x, ways[p, at[p], 1] - y
                away = math.sqrt(gx * gx + gy * gy)
                while at[p] < last:
                    # A way point is done when it is near, or when the next one lies nearer than it does to it.
                    sx, sy = (
                        ways[p, at[p] + 1, 0] - ways[p, at[p], 0],
                        ways[p, at[p] + 1, 1] - ways[p, at[p], 1],
                    )
                    if away > near and gx * sx + gy * sy > 0.0:
                        break
                    at[p] += 1
                    gx, gy = ways[p, at[p], 0] - x, ways[p, at[p], 1] - y
                    away = math.sqrt(gx * gx + gy * gy)
                pace = speeds[p]
                tau, sure = relaxation[p], 1.0
                if at[p] == last:
                    # The nearer the goal, the more it takes to miss it; the last steps are slower.
                    # One who may be going on is not stopped by a goal on the way, until it should be reached long ago.
                    sure = max(arriving[p], min((k * dt / SURELY) ** 4, 1.0))
                    tau = min(tau, max(0.5 * away / max(pace, 1e-6), BRAKING) / sure)
                    pace += sure * (min(pace, away / BRAKING) - pace)
                if at[p] == last and away < PASSED and gx * vx + gy * vy < 0.0:
                    # Once past the goal, nobody turns back to it.
                    ax, ay = -vx * sure / BRAKING, -vy * sure / BRAKING
                elif away > 1e-9:
                    ax = (pace * gx / away - vx) / tau
                    ay = (pace * gy / away - vy) / tau
                else:
                    ax, ay = -vx / tau, -vy / tau
            for w in range(count):
                if w != p:
                    dx, dy = x - out[k, w, 0], y - out[k, w, 1]
                    away = math.sqrt(dx * dx + dy * dy)
                    force = push(away, people[0], people[1], people[2], people[3])
                    if k == 0:
                        borne[p, w] = force
                    if force > borne[p, w] and away > 1e-9:
                        ax += (force - borne[p, w]) * dx / away
                        ay += (force - borne[p, w]) * dy / away
            if len(obstacles):
                found = nearest_in_cells(x, y, obstacles, cells, origin, size, shape)
                if found >= 0:
                    dx, dy = x - obstacles[found, 0], y - obstacles[found, 1]
                    away = math.sqrt(dx * dx + dy * dy)
                    force = push(away, walls[0], walls[1], walls[2], walls[3])
                    if k == 0:
                        borne[p, p] = force
                    if force > borne[p, p] and away > 1e-9:
                        # A wall stops somebody and does not throw him back.
                        closing = -((vx + ax * dt) * dx + (vy + ay * dt) * dy) / away
                        contact = walls[2] * max(walls[3] - away, 0.0)
                        force = min(force - borne[p, p], max(closing, 0.0) / dt + contact)
                        ax += force * dx / away
                        ay += force * dy / away
            out[k + 1, p, 0] = x + vx * dt + 0.5 * ax * dt * dt
            out[k + 1, p, 1] = y + vy * dt + 0.5 * ay * dt * dt
            out[k + 1, p, 2] = vx + ax * dt
            out[k + 1, p, 3] = vy + ay * dt
    return out
