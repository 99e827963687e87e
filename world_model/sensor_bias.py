"""Systematic errors of a moving sensor, estimated from what it says about resting objects from different places.

A detection of an object at distance d (m) and bearing b (rad, off the sensor's axis) is taken to be off by
`scale d + offset + depth d b² / 2` along the line of sight and by `turn d` across it. depth is -1 where a detector
reports depth for distance. Objects and the four numbers are estimated together by least squares; the objects are
eliminated (Schur complement), so that only what changes with the place of the sensor says something.
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from world_model.drift import Drift
from world_model.evidence import Measurements
from world_model.leaves import IntArray, Leaves

PRIOR = np.array([0.1, 0.05, 1.0, 0.02])
"""Standard deviations of offset (m), scale, depth and turn (rad) before anything is known."""
TAKEN = 0.1
"""The same, of these, once everything that was seen has been explained."""
PARALLAX = 0.5
"""m: a sensor that has not moved farther than this cannot tell its errors from the objects' places."""
EVERY = 5
"""Looks from one solution to the next."""
FADE = 0.999
"""Weight of what was known at the last solution."""
MOVED = 0.15
"""m: an object that is this far from where all its detections put it was carried."""
SIGNIFICANT = 40.0
"""What a sensor without errors stays below: squared length of the estimate in its standard deviations, (4 expected)."""
FORGOTTEN = 1e-3
"""1/m²: sums with less weight have faded away."""
SHARED = [0, 3]
"""Columns of `basis` that are a common error of range and turn."""
OUTLIER = 16.0
"""Squared Mahalanobis distance from which a detection is no witness."""


def basis(positions: FloatArray, pose: FloatArray) -> FloatArray:
    """Displacements (M, 2, 4) per unit of offset, scale, depth and turn of positions (M, 3) seen from a pose (4,)."""
    off = positions[:, :2] - pose[:2]
    distance = np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-6)
    along = off / distance[:, None]
    bearing = np.arctan2(off[:, 1], off[:, 0]) - pose[3]
    bearing -= 2.0 * np.pi * np.round(bearing / (2.0 * np.pi))
    out = np.empty((len(positions), 2, 4))
    out[:, :, 0] = along
    out[:, :, 1] = off
    out[:, :, 2] = (0.5 * np.minimum(bearing**2, 1.0))[:, None] * off
    out[:, 0, 3], out[:, 1, 3] = -off[:, 1], off[:, 0]
    return out


class SensorBias:
    """The errors of one sensor, `values` (4,), and sums over the detections of every object.

    Per object: weights (2, 2), weights times basis (2, 4) and weights times position (2,); over all: basis, weight,
    basis (4, 4) and basis, weight, position (4,).
    """

    def __init__(self, known: FloatArray | None = None, learning: bool = True) -> None:
        self.learning = learning
        self.known: FloatArray = np.zeros(4) if known is None else np.asarray(known, dtype=float)
        """(4,) what a calibration says."""
        self.reset()

    def reset(self) -> None:
        """Nothing is known but the calibration."""
        self.values: FloatArray = self.known.copy()
        self.base: FloatArray = self.known.copy()
        self.prior: FloatArray = PRIOR
        self.moved = False
        self.significant = False
        self._start: FloatArray | None = None
        self._rows: dict[int, int] = {}
        self._weight: FloatArray = np.zeros((0, 2, 2))
        self._mixed: FloatArray = np.zeros((0, 2, 4))
        self._place: FloatArray = np.zeros((0, 2))
        self._normal: FloatArray = np.zeros((4, 4))
        self._right: FloatArray = np.zeros(4)
        self._looks = 0
        self.drift = Drift()

    def follow(self, pose: FloatArray) -> bool:
        """Whether there is something to correct: errors are known, or the sensor has moved far enough to learn."""
        if self._start is None:
            self._start = pose[:2].copy()
        self.moved = self.moved or (self.learning and bool(np.hypot(*(pose[:2] - self._start)) > PARALLAX))
        return self.moved or bool(self.known.any())

    def corrected(self, positions: FloatArray, pose: FloatArray) -> FloatArray:
        """Positions (M, 3) without the errors known so far."""
        result = positions.copy()
        result[:, :2] -= basis(positions, pose) @ self.values
        return result

    def aligned(
        self,
        positions: FloatArray,
        measured: Measurements,
        leaves: Leaves,
        slots: IntArray,
        likelihood: FloatArray,
        blocks: IntArray,
        stamp: float,
    ) -> FloatArray:
        """Corrected positions (M, 3) without the error that all of them share, by the resting leaves `slots`."""
        assert measured.sensor is not None
        self.drift.predict(stamp)
        J = basis(positions, measured.sensor.pose)[:, :, SHARED]
        apart = positions[:, None, :2] - leaves.rest[slots, :2]
        covariances = measured.covariances[:, None, :2, :2] + leaves.rest_cov[slots, :2, :2]
        likely = np.zeros(apart.shape[:2])
        for begin, end in blocks.tolist():
            if end > begin:
                likely -= 2.0 * np.log(
                    likelihood[:, begin:end] @ leaves.attributes[slots, begin:end].T + 1e-9
                )
        result = positions.copy()
        result[:, :2] -= J @ self.drift.align(apart, J, covariances, likely)
        return result

    def add(
        self,
        tracks: list[int],
        places: FloatArray,
        positions: FloatArray,
        covariances: FloatArray,
        pose: FloatArray,
    ) -> None:
        """Detections (n, 3) as they came, with covariances (n, 3, 3), of objects believed at places (n, 3)."""
        if not tracks:
            return
        J = basis(places, pose)
        W = np.linalg.inv(covariances[:, :2, :2])
        apart = positions[:, :2] - J @ self.values - places[:, :2]
        shared = J[:, :, SHARED]
        left = apart - shared @ self.drift.values
        good = np.einsum("ni,nij,nj->n", left, W, left) < OUTLIER
        if self.moved and good.any():
            self.drift.learn(apart[good], shared[good], covariances[good][:, :2, :2])
        parts = zip(tracks, J, W, positions[:, :2], places[:, :2], good.tolist(), strict=True)
        for track, J_k, W_k, z, place, fits in parts:
            if not fits:
                continue
            row = self._row(track)
            if self._elsewhere(row, place):
                self._begin_anew(row)
            weighted = W_k @ J_k
            self._weight[row] += W_k
            self._mixed[row] += weighted
            self._place[row] += W_k @ z
            self._normal += J_k.T @ weighted
            self._right += weighted.T @ z

    def take(self, values: FloatArray, shared: FloatArray) -> None:
        """Start anew from constant errors (4,) and a shared one (2,) that explain all that was seen."""
        self.values, self.prior, self.significant = values.copy(), TAKEN * PRIOR, True
        self.base = values.copy()
        self.drift.values = shared.copy()
        self._rows.clear()
        for sums in (self._weight, self._mixed, self._place, self._normal, self._right):
            sums[:] = 0.0

    def _row(self, track: int) -> int:
        row = self._rows.get(track)
        if row is None:
            row = len(self._rows)
            if row == len(self._weight):
                more = max(row, 16)
                self._weight = np.concatenate([self._weight, np.zeros((more, 2, 2))])
                self._mixed = np.concatenate([self._mixed, np.zeros((more, 2, 4))])
                self._place = np.concatenate([self._place, np.zeros((more, 2))])
            self._rows[track] = row
        return row

    def _elsewhere(self, row: int, place: FloatArray) -> bool:
        """Whether an object believed at `place` (2,) was somewhere else when its sums began."""
        weight = self._weight[row]
        if weight[0, 0] <= 0.0:
            return False
        before = np.linalg.solve(weight, self._place[row] - self._mixed[row] @ self.values)
        return bool(np.hypot(*(place - before)) > MOVED)

    def _begin_anew(self, row: int) -> None:
        """What an object said from its old place counts; its new place is another unknown."""
        normal, right = self._eliminated(np.array([row]))
        self._normal += normal
        self._right += right
        self._weight[row], self._mixed[row], self._place[row] = 0.0, 0.0, 0.0

    def keep_only(self, tracks: set[int]) -> None:
        """Objects that are gone keep saying what they said; their rows are given back, as those not seen for ages."""
        old = {track for track, row in self._rows.items() if self._weight[row, 0, 0] < FORGOTTEN}
        tracks = tracks - old
        gone = [track for track in self._rows if track not in tracks]
        if not gone:
            return
        normal, right = self._eliminated(np.array([self._rows[track] for track in gone]))
        self._normal += normal
        self._right += right
        left = {track: row for track, row in self._rows.items() if track in tracks}
        order = np.array(list(left.values()), np.int64)
        self._weight, self._mixed, self._place = (
            self._weight[order],
            self._mixed[order],
            self._place[order],
        )
        self._rows = {track: index for index, track in enumerate(left)}

    def _eliminated(self, rows: IntArray) -> tuple[FloatArray, FloatArray]:
        """What eliminating the places of these objects adds to the normal equations, (4, 4) and (4,)."""
        solved = np.linalg.solve(self._weight[rows], self._mixed[rows])
        normal = -np.einsum("nij,nik->jk", self._mixed[rows], solved)
        right = -np.einsum("nij,ni->j", solved, self._place[rows])
        return normal, right

    def solve(self) -> tuple[list[int], FloatArray] | None:
        """Every few looks: a new estimate; the objects and the shifts (n, 2) of their places that go with it."""
        self._looks += 1
        count = len(self._rows)
        if self._looks % EVERY or not count or not self.moved:
            return None
        rows = np.arange(count)
        normal, right = self._eliminated(rows)
        before = self.values
        prior = 1.0 / self.prior**2
        left, ahead = self._normal + normal + np.diag(prior), self._right + right + prior * self.base
        solved = np.asarray(np.linalg.solve(left, ahead), dtype=np.float64)
        apart = solved - self.base
        if self.significant or apart @ left @ apart > SIGNIFICANT:
            self.significant, self.values = True, solved
        shifts: FloatArray = -np.linalg.solve(self._weight[:count], self._mixed[:count]) @ (
            self.values - before
        )
        for sums in (self._weight, self._mixed, self._place, self._normal, self._right):
            sums *= FADE
        return list(self._rows), shifts
