"""Errors that all detections of a look share and that change slowly: of the robot's pose, of the sensor's mounting.

What is left after `sensor_bias`: an offset in range (m) and a turn (rad) that go towards zero within some time (an
Ornstein-Uhlenbeck process), and a part that changes with every look. The detections of a look together say which: each
known object explains one of them at most.
"""

from __future__ import annotations

import numpy as np

from estimation.assignment import cheapest
from estimation.checks import FloatArray

SECONDS = 30.0
"""After which what was found is forgotten."""
SLOW = np.array([0.02, 0.015])
"""Standard deviations of the slow part, of range (m) and turn (rad)."""
QUICK = np.array([0.01, 0.006])
"""The same of what changes with every look."""
STEPS = np.linspace(-2.0, 2.0, 9)
"""Turns that are tried, in standard deviations."""
RANGES = np.linspace(-1.5, 1.5, 5)
"""The same of ranges."""
UNKNOWN = 25.0
"""Squared Mahalanobis distance from which a detection is of nothing that is known."""


def best_shared(costs: FloatArray, prior: FloatArray) -> int:
    """Which of S shared errors explains M detections by K objects best: costs (S, M, K), prior (S,)."""
    nearest = costs.argmin(2)
    order = np.argsort(costs.min(2).sum(1) + prior, kind="stable")
    first = int(order[0])
    known = nearest[first][costs[first].min(1) < UNKNOWN]
    if len(np.unique(known)) == len(known):
        # If the best of each is nobody else's, it is the best of all.
        return first
    values = np.empty(len(costs))
    for index, cost in enumerate(costs):
        rows, columns = cheapest(cost)
        # Those that are left over when there are fewer objects are of nothing known.
        values[index] = cost[rows, columns].sum() + UNKNOWN * (cost.shape[0] - len(rows)) + prior[index]
    return int(values.argmin())


class Drift:
    """The common error, `values` (2,) of range and turn with `covariance` (2, 2), at `stamp`."""

    def __init__(self) -> None:
        self.reset()

    def reset(self) -> None:
        """Nothing is known."""
        self.values: FloatArray = np.zeros(2)
        self.covariance: FloatArray = np.diag(SLOW**2)
        self.stamp: float | None = None

    def predict(self, stamp: float) -> None:
        """To a later stamp, s."""
        elapsed = 0.0 if self.stamp is None else max(stamp - self.stamp, 0.0)
        self.stamp = stamp if self.stamp is None else max(stamp, self.stamp)
        fade = float(np.exp(-elapsed / SECONDS))
        self.values = fade * self.values
        self.covariance = fade**2 * self.covariance + (1.0 - fade**2) * np.diag(SLOW**2)

    def align(
        self, apart: FloatArray, basis: FloatArray, covariances: FloatArray, likely: FloatArray
    ) -> FloatArray:
        """The most probable common error (2,) of a look.

        apart (M, K, 2) : detections less places of objects, m. basis (M, 2, 2) : displacement per unit of range and
        turn. covariances (M, K, 2, 2) : of `apart`. likely (M, K) : -2 log of how well an object's attributes explain a
        detection's.
        """
        M, K = apart.shape[:2]
        if M < 2 or K < 1:
            return self.values
        spread = self.covariance + np.diag(QUICK**2)
        sigma = np.sqrt(spread.diagonal())
        inverse = np.linalg.inv(covariances)
        steps = np.stack(np.meshgrid(RANGES, STEPS), -1).reshape(-1, 2)
        tried = self.values + sigma * steps
        off = apart - np.einsum("mij,sj->smi", basis, tried)[:, :, None]
        cost = np.einsum("smki,mkij,smkj->smk", off, inverse, off) + likely
        choice = best_shared(np.minimum(cost, UNKNOWN), (steps**2).sum(1))
        found: FloatArray = tried[choice]
        return found

    def learn(self, apart: FloatArray, basis: FloatArray, covariances: FloatArray) -> None:
        """Take in how far detections (M, 2) of known objects are from these, m; basis and covariances (M, 2, 2)."""
        weights = np.linalg.inv(covariances)
        mixed = np.einsum("mji,mjk->mik", basis, weights)
        information = np.einsum("mij,mjk->ik", mixed, basis)
        seen = np.linalg.solve(information, np.einsum("mij,mj->i", mixed, apart))
        noise = np.linalg.inv(information) + np.diag(QUICK**2)
        gain = self.covariance @ np.linalg.inv(self.covariance + noise)
        self.values = self.values + gain @ (seen - self.values)
        self.covariance = self.covariance - gain @ self.covariance
