"""Whether a moving sensor has errors at all: what its detections say for the joint filter and against independent ones.

Two models predict every detection of a resting object before they take it in: `sensor_filter`, with errors that are not
known yet, and one filter per object, of a sensor whose detections are off independently. Log odds of the two are a
Bayes factor: a sensor without errors loses with every detection what the first spends on errors that might be.
Densities have the tails of Student's t, so that single detections decide nothing, and the scale that detections so far
had under either model, so that stated covariances that are too small or too large do not either. Several objects must
say so, each by itself: one that was moved does not decide.
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.loops.kernels import MEMORY

TAILS = 4.0  # Degrees of freedom of a detection's density
CLEARLY = 1.5  # Log odds from which an object is a witness
WITNESSES = 2  # Fewest of them that are enough, where the constant errors are significant; else one more
SHARE = 0.3  # The same, of all objects that said something
SAYS = 6.0  # Most that one object counts, log odds
ENOUGH = 10.0  # Log odds of all objects together from which there are errors, whichever they are
USUAL = 20.0  # Detections that the stated covariances count when the scale is found
FARTHEST = 12.0  # Squared Mahalanobis distance beyond which one is no farther off, for the scale


class Scaled:
    """Densities of displacements (2,) under one model, up to a constant; their scale follows them."""

    def __init__(self) -> None:
        self._count, self._sum = USUAL, 2.0 * USUAL

    def log_density(self, off: FloatArray, S: FloatArray) -> float:
        """Under Student's t with S (2, 2), scaled by what came before."""
        a, b, c = S[0, 0], S[0, 1], S[1, 1]
        determinant = a * c - b * b
        square = (c * off[0] ** 2 - 2.0 * b * off[0] * off[1] + a * off[1] ** 2) / determinant
        scale = 0.5 * self._sum / self._count
        self._count += 1.0
        self._sum += min(square, FARTHEST)
        tails = -0.5 * (TAILS + 2.0) * np.log1p(square / (TAILS * scale))
        return float(tails - 0.5 * np.log(determinant) - np.log(scale))


class SensorEvidence:
    """Objects go by numbers; `odds` : log odds of errors by object."""

    def __init__(self) -> None:
        self.places: dict[int, tuple[FloatArray, FloatArray]] = {}
        self.odds: dict[int, float] = {}
        self._with, self._without = Scaled(), Scaled()

    def enough(self, significant: bool) -> bool:
        """Whether several objects, and not a few of many, say that the sensor has errors.

        significant : whether the constant errors are, by their estimate.
        """
        witnesses = sum(said > CLEARLY for said in self.odds.values())
        total = sum(min(said, SAYS) for said in self.odds.values())
        least = max(WITNESSES + (not significant), SHARE * len(self.odds))
        return witnesses >= least and (significant or total > ENOUGH)

    def begin(self, number: int, place: FloatArray, spread: FloatArray) -> None:
        """An object at a place (2,), m, with covariance spread (2, 2)."""
        self.places[number] = place, spread

    def weigh(self, number: int, z: FloatArray, R: FloatArray, off: FloatArray, S: FloatArray) -> None:
        """A detection (2,) with R (2, 2) of a known object, off (2,), S (2, 2) from where the joint filter had it."""
        place, spread = self.places[number]
        least = np.trace(R) / MEMORY
        if np.trace(spread) < least:
            spread = spread + 0.5 * (least - np.trace(spread)) * np.eye(2)
        own = spread + R
        gained = self._with.log_density(off, S) - self._without.log_density(z - place, own)
        self.odds[number] = self.odds.get(number, 0.0) + gained
        gain = np.linalg.solve(own, spread).T
        self.places[number] = place + gain @ (z - place), spread - gain @ spread

    def keep_only(self, numbers: set[int]) -> None:
        """Places of others are forgotten; what they said is not."""
        self.places = {number: place for number, place in self.places.items() if number in numbers}
