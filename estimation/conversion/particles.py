"""A particle filter's state: weighted samples, with weights in the log domain."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_floats, as_points
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance

IntArray = npt.NDArray[np.int64]

# Effective size after an update, as a share of the particles, below which the update is taken in stages.
SPARSE = 0.1
# Smoothing between stages: they are needed where the posterior is far from the prior and may be bent.
STAGE_SMOOTHING = 0.5


def log_total(log_weights: FloatArray) -> float:
    """Log of the sum of the weights; several times faster than scipy's for the few thousand of a filter."""
    top = float(log_weights.max())
    if not math.isfinite(top):
        return top
    return top + math.log(float(np.exp(log_weights - top).sum()))


def normalise_log(log_weights: npt.ArrayLike) -> FloatArray:
    """Log weights (N,) shifted so that their exponentials add up to 1.

    Raises InputError for NaN and where every weight is zero (-inf): the measurement fits no particle.
    """
    w = as_floats("log_weights", log_weights)
    if w.ndim != 1 or np.isnan(w).any() or np.isposinf(w).any():
        raise InputError("log_weights must be (N,) numbers below inf")
    total = log_total(w)
    if not math.isfinite(total):
        raise InputError("log_weights must not all be -inf")
    return w - total


def effective_size(log_weights: npt.ArrayLike) -> float:
    """1 / Σ w², between 1 and N, of normalised or unnormalised log weights (N,)."""
    w = np.exp(normalise_log(log_weights))
    return 1.0 / float(w @ w)


def systematic_resample(log_weights: npt.ArrayLike, rng: np.random.Generator) -> IntArray:
    """Indices (N,), ascending, drawn in proportion to the weights with one uniform number.

    Each particle is taken ⌊N w⌋ or ⌈N w⌉ times.
    """
    w = np.exp(normalise_log(log_weights))
    edges = np.cumsum(w)
    edges[-1] = 1.0
    positions = (np.arange(w.size) + rng.uniform()) / w.size
    return np.searchsorted(edges, positions, side="right").astype(np.int64)


def unrelated(noise: FloatArray, states: FloatArray) -> FloatArray:
    """Standard normal noise (N, d) freed of what it has in common with states (N, d), and of its own mean and
    covariance, that are chance: sums of both then have exactly the moments they should have."""
    offsets = states - states.mean(0)
    left = noise - noise.mean(0)
    left -= offsets @ np.linalg.solve(offsets.T @ offsets, offsets.T @ left)
    factor = np.linalg.cholesky(left.T @ left / (len(left) - 1))
    return np.asarray(np.linalg.solve(factor, left.T).T)


@dataclass
class Particles:
    """States (N, d) with log weights (N,), normalised."""

    states: FloatArray
    log_weights: FloatArray

    @classmethod
    def equal(cls, states: npt.ArrayLike) -> Particles:
        """Particles of equal weight."""
        x = as_points("states", states)
        if len(x) == 0:
            raise InputError("states must hold at least one particle")
        return cls(x, np.full(len(x), -np.log(len(x))))

    @property
    def effective_size(self) -> float:
        """1 / Σ w²."""
        return effective_size(self.log_weights)

    @property
    def mean(self) -> FloatArray:
        """(d,)."""
        result: FloatArray = np.exp(self.log_weights) @ self.states
        return result

    @property
    def covariance(self) -> FloatArray:
        """(d, d), unbiased: (6.15) for equal weights."""
        w = np.exp(self.log_weights)
        offsets = self.states - w @ self.states
        # All weight on one particle leaves no spread to estimate: zero, not 0 / 0.
        result: FloatArray = (offsets.T * w) @ offsets / max(1.0 - float(w @ w), 1.0 / len(w))
        return result

    def reweight(self, log_likelihood: npt.ArrayLike) -> float:
        """Multiply the weights by likelihoods (N,); returns the log of their weighted mean, log p(z | past)."""
        joint = self.log_weights + as_floats("log_likelihood", log_likelihood)
        self.log_weights = normalise_log(joint)
        return log_total(joint)

    def move(self, position: FloatArray, noise: FloatArray) -> None:
        """Kalman update of equally weighted particles with a measured position (2,) of covariance `noise` (2, 2).

        Their mean and covariance become exactly the filter's, their shape stays (Whitaker and Hamill 2002).
        """
        mean = self.states.mean(0)
        offsets = self.states - mean
        C = offsets.T @ offsets / (len(offsets) - 1)
        S = C[:2, :2] + noise
        root, root_noise = np.linalg.cholesky(S), np.linalg.cholesky(noise)
        gain = np.linalg.solve(S, C[:2]).T
        # (I - L H) C (I - L H)ᵀ = (I - K H) C.
        less = C[:, :2] @ np.linalg.inv(root).T @ np.linalg.inv(root + root_noise)
        self.states = mean + gain @ (position - mean[:2]) + offsets - offsets[:, :2] @ less.T

    def assimilate(
        self, log_likelihood: Callable[[FloatArray], FloatArray], rng: np.random.Generator, stages: int = 16
    ) -> int:
        """Reweight by a likelihood, in tempered stages with smooth resampling where few particles fit it.

        log_likelihood : maps states (N, d) to values (N,). A stage raises the likelihood to the power that
        halves the effective size. Returns how many it took; 0, with the particles as they were, where `stages`
        did not suffice: the measurement then is far outside all of them.
        """
        before = self.states, self.log_weights
        remaining, count = 1.0, len(self.states)
        for stage in range(1, stages + 1):
            values = log_likelihood(self.states)
            if effective_size(self.log_weights + remaining * values) >= SPARSE * count:
                self.reweight(remaining * values)
                return stage
            target = 0.5 * self.effective_size
            low, high = 0.0, remaining
            for _ in range(20):
                middle = 0.5 * (low + high)
                enough = effective_size(self.log_weights + middle * values) >= target
                low, high = (middle, high) if enough else (low, middle)
            self.reweight(low * values)
            self.resample(rng, smooth=STAGE_SMOOTHING)
            remaining -= low
        self.states, self.log_weights = before
        return 0

    def resample(self, rng: np.random.Generator, below: float = 1.0, smooth: float = 0.0) -> bool:
        """Systematic resampling where the effective size is under `below` · N; True where it was done.

        smooth : above 0, draw from a kernel density in place of the particles (Musso et al. 2001), so that copies
        part again; shrunk towards the mean, it keeps the weighted mean and covariance (Liu, West 2001). 1 is
        the width that suits a Gaussian; less blurs other shapes less.
        """
        if below < 1.0 and self.effective_size > below * len(self.states):
            return False
        count, d = self.states.shape
        chosen = self.states[systematic_resample(self.log_weights, rng)]
        if smooth:
            width = smooth * (4.0 / ((d + 2) * count)) ** (1.0 / (d + 4))
            mean = self.mean
            factor = np.linalg.cholesky(repair_covariance(self.covariance))
            noise = rng.standard_normal((count, d)) @ (width * factor).T
            chosen = mean + math.sqrt(1.0 - width**2) * (chosen - mean) + noise
        self.states = chosen
        self.log_weights = np.full(count, -np.log(count))
        return True
