"""What a moving sensor gets wrong and where resting objects are, estimated together: an extended Kalman filter.

Its state are constant errors (`sensor_bias.basis`), two that all detections of a look share and that change slowly, and
the places of objects. All detections from about the same place are off alike: taken for independent,
they would pull objects after these errors, and objects that stand close together would be mixed up. What is common to
them stays common here, in the covariances between places and errors.
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.loops.leaves import IntArray
from world_model.calibration.sensor_bias import CONSTANT, JITTER, PRIOR, QUICK, SECONDS, SLOW, basis

ERRORS = CONSTANT + 2
"""Length of the part of the state before the places: constant errors; shared range and turn."""
STATE = [*range(CONSTANT), 0, 3]  # Columns of `basis` by error of the state
LOG_2PI = float(np.log(2.0 * np.pi))


SHARED = slice(CONSTANT, ERRORS)
NEWLY = slice(CONSTANT - 1, ERRORS)
"""Errors that have a part that changes with every look: delay, shared range and turn."""
SPREAD = np.array([JITTER, *QUICK])  # Its standard deviations


def error_basis(positions: FloatArray, pose: FloatArray, rate: FloatArray | None = None) -> FloatArray:
    """Displacements (M, 2, 10) per unit of each error of positions (M, 2) seen from a pose (4,) that moves at a rate
    (3,)."""
    return basis(positions, pose, rate)[:, :, STATE]


class SensorFilter:
    """x (10 + 2 K,), P : errors, and places (m) of the objects `numbers` (K,). Never changed in place but by `predict`,
    so that a copy is cheap."""

    def __init__(self, known: FloatArray) -> None:
        self.x: FloatArray = np.concatenate([known, np.zeros(2)])
        self.P: FloatArray = np.diag(np.concatenate([PRIOR, SLOW]) ** 2)
        self.numbers: tuple[int, ...] = ()
        self.stamp: float | None = None

    @property
    def places(self) -> FloatArray:
        """(K, 2) m."""
        return self.x[ERRORS:].reshape(-1, 2)

    @property
    def prior(self) -> FloatArray:
        """Covariance (10, 10) of the errors of a look."""
        prior = self.P[:ERRORS, :ERRORS].copy()
        prior.flat[(CONSTANT - 1) * (ERRORS + 1) :: ERRORS + 1] += SPREAD**2
        return prior

    def own(self, which: IntArray) -> FloatArray:
        """Covariances (n, 2, 2) of places."""
        columns = ERRORS + 2 * which[:, None] + np.arange(2)
        return self.P[columns[:, :, None], columns[:, None, :]]

    def predict(self, stamp: float) -> None:
        """To a later stamp, s: what is shared is forgotten by and by."""
        elapsed = 0.0 if self.stamp is None else max(stamp - self.stamp, 0.0)
        self.stamp = stamp if self.stamp is None else max(stamp, self.stamp)
        fade = float(np.exp(-elapsed / SECONDS))
        scale = np.ones(len(self.x))
        scale[SHARED] = fade
        self.x = self.x * scale
        self.P = self.P * scale[:, None] * scale
        self.P[[ERRORS - 2, ERRORS - 1], [ERRORS - 2, ERRORS - 1]] += (1.0 - fade**2) * SLOW**2

    def remember(self, number: int, place: FloatArray, spread: FloatArray) -> None:
        """An object known otherwise than by this sensor."""
        self._grow(number, place, np.zeros((2, len(self.x))), spread)

    def _grow(self, number: int, place: FloatArray, cross: FloatArray, own: FloatArray) -> None:
        D = len(self.x)
        P = np.empty((D + 2, D + 2))
        P[:D, :D], P[D:, :D], P[:D, D:], P[D:, D:] = self.P, cross, cross.T, own
        self.x, self.P = np.concatenate([self.x, place]), P
        self.numbers = (*self.numbers, number)

    def begin(self, number: int, z: FloatArray, R: FloatArray, J: FloatArray) -> None:
        """A place from its first detection (2,), J (2, 10): off as the sensor is."""
        place = z - J @ self.x[:ERRORS]
        self._grow(number, place, -J @ self.P[:ERRORS], J @ self.prior @ J.T + R)

    def innovation(
        self, which: IntArray, z: FloatArray, R: FloatArray, J: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """What is left (2 n,) of detections (n, 2), with R (n, 2, 2) and J (n, 2, 10), of objects `which` (n,), its
        covariance, and that of the state with it (D, 2 n)."""
        n = len(which)
        columns = (ERRORS + 2 * which[:, None] + np.arange(2)).ravel()
        across = J.reshape(2 * n, ERRORS)
        PH = self.P[:, :ERRORS] @ across.T + self.P[:, columns]
        S = across @ PH[:ERRORS] + PH[columns]
        quick = np.einsum("aij,j,bkj->aibk", J[:, :, NEWLY], SPREAD**2, J[:, :, NEWLY])
        for a in range(n):
            quick[a, :, a] += R[a]
        y = z.ravel() - across @ self.x[:ERRORS] - self.x[columns]
        return y, S + quick.reshape(2 * n, 2 * n), PH

    def misfit(self, which: IntArray, z: FloatArray, R: FloatArray, J: FloatArray) -> float:
        """-2 log density of detections being of these objects together."""
        y, S, _ = self.innovation(which, z, R, J)
        return float(y @ np.linalg.solve(S, y) + np.linalg.slogdet(S)[1] + len(y) * LOG_2PI)

    def correct(self, which: IntArray, z: FloatArray, R: FloatArray, J: FloatArray) -> None:
        """Take in detections of known objects."""
        y, S, PH = self.innovation(which, z, R, J)
        gain = np.linalg.solve(S, PH.T).T
        self.x = self.x + gain @ y
        P = self.P - gain @ PH.T
        self.P = 0.5 * (P + P.T)

    def drop(self, numbers: set[int]) -> None:
        """Objects that leave the state."""
        kept = [k for k, number in enumerate(self.numbers) if number not in numbers]
        if len(kept) == len(self.numbers):
            return
        columns = np.concatenate([np.arange(ERRORS), *([ERRORS + 2 * k, ERRORS + 2 * k + 1] for k in kept)])
        columns = columns.astype(np.int64)
        self.x, self.P = self.x[columns], self.P[np.ix_(columns, columns)]
        self.numbers = tuple(self.numbers[k] for k in kept)
