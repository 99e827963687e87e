"""Compiled loop of the social forces: several people step by step, each along its own way."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray

IntArray = NDArray[np.int64]
BRAKING = 0.4  # s
PASSED = 1.5  # m
NEAR = 1.0  # m


@njit(cache=True)
def push(distance: float, strength: float, spread: float, hard: float, radii: float) -> float:
    """Size of the acceleration (4.17) + (4.18) away from something at a distance."""
    overlap = radii - distance
    size = strength * math.exp(min(overlap / spread, 0.0))
    if overlap > 0.0:
        size += hard * overlap
    return size


class Repulsion(NamedTuple):
    """What pushes away: m/s², m, 1/s², sum of the radii in m."""

    strength: float
    spread: float
    hard: float
    radii: float


class Walls(NamedTuple):
    """Obstacle points (K, 2) sorted by cells of `size` m, row by row from `origin` (2,): those of cell c are cells[c]
    to cells[c + 1]. shape (2,) : numbers of cells."""

    points: FloatArray
    cells: IntArray
    origin: FloatArray
    size: float
    shape: IntArray


class Walkers(NamedTuple):
    """People at `states` (P, 4) x, y, vx, vy. Person p wants to go at speeds[p] along ways[p, :lengths[p]].

    It stands at the end of that; with moving[p] False it only goes on as it is. relaxation (P,) s; arriving (P,) in
    (0, 1]: how surely it stops at the end.
    """

    states: FloatArray
    speeds: FloatArray
    ways: FloatArray
    lengths: IntArray
    moving: NDArray[np.bool_]
    relaxation: FloatArray
    arriving: FloatArray


@njit(cache=True)
def nearest_in_cells(x: float, y: float, walls: Walls) -> int:
    """Index of the nearest obstacle within the nine cells around a place, -1 where there is none."""
    column = math.floor((x - walls.origin[0]) / walls.size)
    row = math.floor((y - walls.origin[1]) / walls.size)
    best, found = np.inf, -1
    for i in range(max(column - 1, 0), min(column + 2, walls.shape[0])):
        for j in range(max(row - 1, 0), min(row + 2, walls.shape[1])):
            cell = i * walls.shape[1] + j
            for k in range(walls.cells[cell], walls.cells[cell + 1]):
                dx, dy = x - walls.points[k, 0], y - walls.points[k, 1]
                away = dx * dx + dy * dy
                if away < best:
                    best, found = away, k
    return found


@njit(cache=True)
def _next_point(way: FloatArray, at: int, last: int, x: float, y: float) -> int:
    """The way point to make for: one is done when it is near, or when the next one lies nearer than it does to it."""
    while at < last:
        gx, gy = way[at, 0] - x, way[at, 1] - y
        sx, sy = way[at + 1, 0] - way[at, 0], way[at + 1, 1] - way[at, 1]
        if math.sqrt(gx * gx + gy * gy) > NEAR and gx * sx + gy * sy > 0.0:
            break
        at += 1
    return at


@njit(cache=True)
def _drawn(walkers: Walkers, p: int, at: int, state: FloatArray) -> tuple[float, float]:
    """Acceleration of person p towards way point `at`."""
    x, y, vx, vy = state[0], state[1], state[2], state[3]
    gx, gy = walkers.ways[p, at, 0] - x, walkers.ways[p, at, 1] - y
    away = math.sqrt(gx * gx + gy * gy)
    pace, tau = walkers.speeds[p], walkers.relaxation[p]
    if at == walkers.lengths[p] - 1:
        # The nearer the goal, the more it takes to miss it; the last steps are slower.
        # One who may be going on is not stopped by a goal on the way.
        sure = walkers.arriving[p]
        tau = min(tau, max(0.5 * away / max(pace, 1e-6), BRAKING) / sure)
        pace += sure * (min(pace, away / BRAKING) - pace)
        if away < PASSED and gx * vx + gy * vy < 0.0:
            # Once past the goal, nobody turns back to it.
            return -vx * sure / BRAKING, -vy * sure / BRAKING
    if away > 1e-9:
        return (pace * gx / away - vx) / tau, (pace * gy / away - vy) / tau
    return -vx / tau, -vy / tau


@njit(cache=True)
def _against_wall(
    x: float, y: float, vx: float, vy: float, dt: float, repulsion: Repulsion, borne: float, wall: FloatArray
) -> tuple[float, float]:
    """Acceleration away from a point (2,) of a wall, beyond what is borne already, of who would be at vx, vy next."""
    dx, dy = x - wall[0], y - wall[1]
    away = math.sqrt(dx * dx + dy * dy)
    force = push(away, repulsion.strength, repulsion.spread, repulsion.hard, repulsion.radii)
    if force <= borne or away <= 1e-9:
        return 0.0, 0.0
    # A wall stops somebody and does not throw him back.
    closing = -(vx * dx + vy * dy) / away
    contact = repulsion.hard * max(repulsion.radii - away, 0.0)
    force = min(force - borne, max(closing, 0.0) / dt + contact)
    return force * dx / away, force * dy / away


@njit(cache=True)
def _borne(states: FloatArray, people: Repulsion, repulsion: Repulsion, walls: Walls) -> FloatArray:
    """What each bears already, (P, P), m/s²: from companions, and on the diagonal along a wall."""
    count = len(states)
    borne = np.zeros((count, count))
    for p in range(count):
        for w in range(count):
            if w != p:
                dx, dy = states[p, 0] - states[w, 0], states[p, 1] - states[w, 1]
                away = math.sqrt(dx * dx + dy * dy)
                borne[p, w] = push(away, people.strength, people.spread, people.hard, people.radii)
        found = nearest_in_cells(states[p, 0], states[p, 1], walls)
        if found >= 0:
            dx, dy = states[p, 0] - walls.points[found, 0], states[p, 1] - walls.points[found, 1]
            away = math.sqrt(dx * dx + dy * dy)
            borne[p, p] = push(away, repulsion.strength, repulsion.spread, repulsion.hard, repulsion.radii)
    return borne


@njit(cache=True)
def walk(
    walkers: Walkers, steps: int, dt: float, people: Repulsion, repulsion: Repulsion, walls: Walls
) -> FloatArray:
    """States (steps + 1, P, 4) x, y, vx, vy of people who push each other away and are pushed away by walls."""
    count = len(walkers.states)
    out = np.empty((steps + 1, count, 4))
    for p in range(count):
        for a in range(4):
            out[0, p, a] = walkers.states[p, a]
    at = np.zeros(count, dtype=np.int64)
    # What somebody bears already, from companions or along a wall, does not turn him: only more of it does.
    borne = _borne(walkers.states, people, repulsion, walls)
    for k in range(steps):
        for p in range(count):
            x, y, vx, vy = out[k, p, 0], out[k, p, 1], out[k, p, 2], out[k, p, 3]
            ax, ay = 0.0, 0.0
            if walkers.moving[p]:
                at[p] = _next_point(walkers.ways[p], at[p], walkers.lengths[p] - 1, x, y)
                ax, ay = _drawn(walkers, p, at[p], out[k, p])
            for w in range(count):
                if w == p:
                    continue
                dx, dy = x - out[k, w, 0], y - out[k, w, 1]
                away = math.sqrt(dx * dx + dy * dy)
                force = push(away, people.strength, people.spread, people.hard, people.radii)
                if force > borne[p, w] and away > 1e-9:
                    ax += (force - borne[p, w]) * dx / away
                    ay += (force - borne[p, w]) * dy / away
            found = nearest_in_cells(x, y, walls)
            if found >= 0:
                bx, by = _against_wall(
                    x, y, vx + ax * dt, vy + ay * dt, dt, repulsion, borne[p, p], walls.points[found]
                )
                ax, ay = ax + bx, ay + by
            out[k + 1, p, 0] = x + vx * dt + 0.5 * ax * dt * dt
            out[k + 1, p, 1] = y + vy * dt + 0.5 * ay * dt * dt
            out[k + 1, p, 2] = vx + ax * dt
            out[k + 1, p, 3] = vy + ay * dt
    return out
