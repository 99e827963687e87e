"""A simulated world of landmarks for a moving camera with errors as real ones have, on which settings are chosen.

Like the UTIAS recordings in what it is about (landmarks 15 to 20 cm apart in small groups, a robot that drives from
place to place, a narrow camera), not in its map, its paths or its errors, which each seed draws anew. How large errors
and noise are on the whole was seen in mrclam6.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.rotations import wrap_angle
from evaluation.anchoring.mrclam import FIRST_LANDMARK, Sighting
from world_model.calibration.sensor_bias import CONSTANT, basis

ROOM = np.array([[-1.5, 5.5], [-6.5, 6.5]])
SPREAD = np.array([0.05, 0.02, 0.1, 0.01, 0.03, 0.03, 0.03])
"""Standard deviations of constant errors, without the delay; each is there with probability `PRESENT`."""
PRESENT = 0.6
DELAY = 0.07
"""s: most that stamps are late."""
RATE = 4.2
"""Looks per second."""
SPEED, TURN = 0.15, 0.45
"""m/s and rad/s at which it drives and turns."""
VIEW, REACH = 0.5, 6.0
"""rad to either side and m that it sees."""
SEEN = 0.4
"""Probability of a landmark in view being detected."""
OUTLIERS = 0.01


@dataclass(frozen=True)
class LandmarkWorld:
    """One world by `seed`; errors : whether the camera has systematic ones."""

    seed: int
    minutes: float = 15.0
    errors: bool = True

    def landmarks(self, rng: np.random.Generator) -> FloatArray:
        """(15, 2) m, six groups of two or three."""
        centres: list[FloatArray] = []
        while len(centres) < 6:
            centre = rng.uniform(ROOM[:, 0] + 0.5, ROOM[:, 1] - 0.5)
            if all(np.hypot(*(centre - other)) > 1.5 for other in centres):
                centres.append(centre)
        out = []
        for k, centre in enumerate(centres):
            line = rng.uniform(-np.pi, np.pi)
            for at in range(2 + k % 2):
                off = 0.17 * at + rng.normal(0.0, 0.01)
                bent = 0.5 * at
                out.append(centre + off * np.array([np.cos(line + bent), np.sin(line + bent)]))
        return np.array(out)

    def sightings(self) -> Iterator[Sighting]:
        """What the camera saw, with poses that are known."""
        rng = np.random.default_rng(self.seed)
        places = self.landmarks(rng)
        constant = np.zeros(CONSTANT)
        if self.errors:
            there = rng.random(7) < PRESENT
            constant[:7] = there * SPREAD * rng.normal(size=7)
            constant[7] = rng.uniform(0.0, DELAY)
        slow_sigma = rng.uniform(0.002, 0.01) if self.errors else 0.0
        tau = rng.uniform(8.0, 30.0)
        slow = slow_sigma * rng.normal()
        pose, goal, wait = np.array([*ROOM.mean(1), rng.uniform(-np.pi, np.pi)]), ROOM.mean(1), 0.0
        dt, fade = 1.0 / RATE, np.exp(-1.0 / (RATE * tau))
        before = pose
        for k in range(int(60.0 * self.minutes * RATE)):
            slow = fade * slow + np.sqrt(1.0 - fade**2) * slow_sigma * rng.normal()
            pose, goal, wait = drive(pose, goal, wait, dt, rng)
            rate = np.array([*(pose[:2] - before[:2]), wrap_angle(pose[2] - before[2])]) / dt
            before = pose
            readings, subjects = self._look(places, pose, rate, constant, slow, rng)
            if subjects:
                yield Sighting(k * dt, 1, pose.copy(), np.array(readings), np.array(subjects))

    def _look(
        self,
        places: FloatArray,
        pose: FloatArray,
        rate: FloatArray,
        constant: FloatArray,
        slow: float,
        rng: np.random.Generator,
    ) -> tuple[list[tuple[float, float]], list[int]]:
        off = places - pose[:2]
        distance = np.hypot(*off.T)
        bearing = wrap_angle(np.arctan2(off[:, 1], off[:, 0]) - pose[2])
        seen = (
            (np.abs(bearing) < VIEW) & (distance < REACH) & (distance > 0.7) & (rng.random(len(off)) < SEEN)
        )
        if rng.random() < 0.15:
            seen[:] = False
        late = constant + np.append(np.zeros(CONSTANT - 1), 0.02 * rng.normal() if self.errors else 0.0)
        turn = slow + (0.004 * rng.normal() if self.errors else 0.0)
        stretch = 0.003 * rng.normal() if self.errors else 0.0
        moved = basis(places, np.array([pose[0], pose[1], 0.0, pose[2]]), rate) @ late
        readings, subjects = [], []
        for j in np.flatnonzero(seen).tolist():
            at = off[j] + moved[j]
            d = np.hypot(*at) * (1.0 + stretch + 0.005 * rng.normal())
            b = float(wrap_angle(np.arctan2(at[1], at[0]) - pose[2])) + turn + 0.004 * rng.normal()
            if rng.random() < OUTLIERS:
                b += rng.uniform(-0.1, 0.1)
                d *= rng.uniform(0.9, 1.1)
            readings.append((float(d), b))
            subjects.append(FIRST_LANDMARK + j)
        return readings, subjects


def drive(
    pose: FloatArray, goal: FloatArray, wait: float, dt: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, float]:
    """One step (x, y, yaw) towards a goal (2,), turning first; where it has arrived it stands for `wait` s."""
    if wait > 0.0:
        return pose, goal, wait - dt
    off = goal - pose[:2]
    if np.hypot(*off) < 0.1:
        return pose, rng.uniform(ROOM[:, 0] + 0.3, ROOM[:, 1] - 0.3), float(rng.exponential(3.0))
    left = float(wrap_angle(np.arctan2(off[1], off[0]) - pose[2]))
    turn = np.clip(left, -TURN * dt, TURN * dt)
    ahead = SPEED * dt if abs(left) < 0.3 else 0.0
    yaw = float(wrap_angle(pose[2] + turn))
    return np.array([pose[0] + ahead * np.cos(yaw), pose[1] + ahead * np.sin(yaw), yaw]), goal, 0.0
