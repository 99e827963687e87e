"""Movers that go where they are predicted to go: the person behaviour of section 2.4.2, fed by chapter 4.

A mover has no use for the constant-position filter, so its place is taken by the predicted path: position and
covariance step along with it, and what is measured decides between it and constant velocity.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Mapping

import numba
import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.clusters import Track
from world_model.anchoring.kernels import class_of, start_moving
from world_model.anchoring.leaves import MOVING, NONE, REST
from world_model.anchoring.single import SingleObjects
from world_model.anchoring.walking import walk
from world_model.predictions import Path

SURE = 0.95
DOUBT_SECONDS = 5.0
"""What was found out about who keeps to the predicted path is forgotten in this time."""


@numba.njit(cache=True)
def lead(leaves, i, stamp, motion, removed, step, growth, velocity):  # type: ignore[no-untyped-def]
    """Propagate a mover's leaf to `stamp`: one filter along the path, the other straight on, in place."""
    dt = stamp - leaves.stamp[i]
    row = class_of(leaves, i, motion.shape[0] - 1)
    share = motion[row, 4]
    if dt <= 0.0 or motion[row, 0] < 0.5 or share <= 0.0:
        return
    leaves.stamp[i] = stamp
    pi = leaves.behavior[i]
    if pi[REST] <= 0.0:
        leaves.rest[i] = leaves.moving[i, :3]
        leaves.rest_cov[i] = leaves.moving_cov[i, :3, :3]
        pi[REST] = share * pi[MOVING]
        pi[MOVING] -= pi[REST]
    elif pi[MOVING] <= 0.0:
        start_moving(leaves, i, motion[row, 3], 0.0)
    here = pi[REST] + pi[MOVING]
    fade = 1.0 - np.exp(-dt / DOUBT_SECONDS)
    pi[REST] += fade * (share * here - pi[REST])
    pi[MOVING] = here - pi[REST]
    walk(leaves, i, dt, motion[row, 1] ** 2, motion[row, 5])
    leaves.rest[i] += step
    leaves.rest_cov[i] += growth
    leaves.led[i] = velocity
    gone = 1.0 - np.exp(-removed * dt)
    for m in range(3):
        pi[NONE] += gone * pi[m]
        pi[m] -= gone * pi[m]


class Guidance(SingleObjects):
    """Part of `Anchoring`: paths that movers are predicted to take, by number of track."""

    paths: dict[int, Path]

    @abstractmethod
    def _forget_track(self, number: int) -> None: ...

    def guide(self, predictions: Mapping[str, Path | None]) -> None:
        """Take predictions in; those of objects that are not known say nothing."""
        if not predictions:
            return
        named = {track.id: track.number for track in self.tracks.values() if track.id is not None}
        for name, path in predictions.items():
            number = named.get(name)
            if number is None:
                continue
            if path is not None:
                self.paths[number] = path
            elif self.paths.pop(number, None) is not None:
                self._withdraw(self.tracks[number])

    def _withdraw(self, track: Track) -> None:
        """Straight on, as if nothing had been predicted."""
        behavior = self.pool.leaves.behavior
        for slot in self._leaves_of(track).tolist():
            if behavior[slot, MOVING] > 0.0:
                behavior[slot, MOVING] += behavior[slot, REST]
                behavior[slot, REST] = 0.0

    def _lead(self, stamp: float) -> None:
        """All that are predicted go along their paths; a path that has ended says nothing any more."""
        for number, path in list(self.paths.items()):
            track = self.tracks.get(number)
            if track is None or path.end < stamp:
                del self.paths[number]
                continue
            for slot in self._leaves_of(track).tolist():
                self._lead_leaf(slot, path, stamp)

    def _lead_leaf(self, slot: int, path: Path, stamp: float) -> None:
        leaves = self.pool.leaves
        begin = float(leaves.stamp[slot])
        if stamp > begin:
            removed = self.config.removed_per_second
            lead(leaves, slot, stamp, self.motion, removed, *path.step(begin, stamp))

    def _lead_copy(self, track: Track, slot: int, stamp: float) -> None:
        """A copy of a leaf, as far along its path as that reaches."""
        path = self.paths.get(track.number)
        if path is not None:
            self._lead_leaf(slot, path, min(stamp, path.end))

    def _led(self, track: Track, slot: int) -> bool:
        """Whether a mover is most probably on its predicted path."""
        pi = self.pool.leaves.behavior[slot]
        return track.number in self.paths and bool(pi[REST] > pi[MOVING])

    def _moves(self, slot: int) -> bool:
        """Whether a leaf is of a class that moves by itself."""
        classes = len(self.motion) - 1
        row = int(self.pool.leaves.attributes[slot, :classes].argmax()) if classes else classes
        return bool(self.motion[row, 0] > 0.5)

    def _rests(self, slot: int) -> bool:
        """Whether a leaf is surely of something that lies where it is."""
        return bool(self.pool.leaves.behavior[slot, REST] > SURE) and not self._moves(slot)

    def _growth(self, track: Track, slot: int) -> FloatArray:
        """(3, 3) m² by which the covariance of what is shown grows in the next second without a look."""
        leaves, pi = self.pool.leaves, self.pool.leaves.behavior[slot]
        path = self.paths.get(track.number)
        if path is not None and pi[REST] > pi[MOVING]:
            now = float(leaves.stamp[slot])
            return path.step(now, min(now + 1.0, max(path.end, now)))[1]
        if pi[MOVING] <= pi[REST]:
            return np.zeros((3, 3))
        P = leaves.moving_cov[slot]
        classes = len(self.motion) - 1
        row = int(leaves.attributes[slot, :classes].argmax()) if classes else classes
        noise: FloatArray = P[:3, 3:] + P[3:, :3] + P[3:, 3:] + self.motion[row, 1] ** 2 / 3.0 * np.eye(3)
        return noise
