"""Gaussians, Gaussian mixtures, their entropy, and the repair of covariances that rounding made indefinite."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import logsumexp

from estimation.checks import FloatArray, as_finite, as_square, as_vectors, require_count
from estimation.errors import InputError

LOG_TWO_PI = math.log(2.0 * math.pi)

# An eigenvalue this far below zero, relative to the largest, is rounding; further below it is a wrong matrix.
ROUNDING = 1e-9
# A repaired eigenvalue, relative to the largest: large enough for a Cholesky factor to exist.
FLOOR = 1e-12


@dataclass
class RepairCounter:
    """How many covariances have been repaired in this process; a number that grows belongs in diagnostics."""

    count: int = 0


repairs = RepairCounter()


def repair_covariance(
    covariance: npt.ArrayLike, name: str = "covariance", definite: bool = True
) -> FloatArray:
    """`covariance` (..., d, d), symmetric and positive definite, repaired where only rounding denies that.

    Asymmetry and eigenvalues down to -1e-9 of the largest are rounding: the eigenvalues are raised to 1e-12 of
    the largest and `repairs.count` grows by one per matrix. With `definite` false eigenvalues of zero are left
    as they are, a zero matrix included. Raises InputError naming `name` for anything worse.
    """
    P = as_square(name, covariance)
    transposed = np.swapaxes(P, -1, -2)
    if definite:
        try:
            np.linalg.cholesky(P)
        except np.linalg.LinAlgError:
            pass
        else:
            if (transposed == P).all():
                return P
    largest = np.abs(P).max(axis=(-1, -2), initial=0.0)
    if (np.abs(P - transposed).max(axis=(-1, -2), initial=0.0) > ROUNDING * largest).any():
        raise InputError(f"{name} must be symmetric")
    symmetric = 0.5 * (P + transposed)
    values, vectors = np.linalg.eigh(symmetric)
    top = values[..., -1:]
    if (values < -ROUNDING * np.abs(top)).any() or (definite and (top <= 0).any()):
        kind = "definite" if definite else "semi-definite"
        raise InputError(f"{name} must be positive {kind}; its smallest eigenvalue is {values.min():g}")
    floor = FLOOR * top if definite else np.zeros_like(top)
    broken = np.asarray((values < floor).any(-1))
    if not broken.any():
        return symmetric
    repairs.count += int(broken.sum())
    rebuilt = (vectors * np.maximum(values, floor)[..., None, :]) @ np.swapaxes(vectors, -1, -2)
    return np.where(broken[..., None, None], 0.5 * (rebuilt + np.swapaxes(rebuilt, -1, -2)), symmetric)


def gaussian_entropy(covariance: npt.ArrayLike) -> float | FloatArray:
    """Differential entropy, nat, of Gaussians with covariance (..., d, d): (3.3)."""
    P = repair_covariance(covariance)
    d = P.shape[-1]
    entropy = 0.5 * d * (1.0 + LOG_TWO_PI) + 0.5 * np.linalg.slogdet(P)[1]
    return float(entropy) if np.ndim(entropy) == 0 else entropy


def log_density(x: npt.ArrayLike, mean: npt.ArrayLike, covariance: npt.ArrayLike) -> FloatArray:
    """Log density (...) of Gaussians at x (..., d); mean (..., d), covariance (..., d, d) broadcast."""
    x, mean = as_vectors("x", x), as_vectors("mean", mean)
    factor = np.linalg.cholesky(repair_covariance(covariance))
    whitened = np.linalg.solve(factor, (x - mean)[..., None])[..., 0]
    volume = np.log(np.diagonal(factor, axis1=-2, axis2=-1)).sum(-1)
    result: FloatArray = -0.5 * (whitened**2).sum(-1) - volume - 0.5 * x.shape[-1] * LOG_TWO_PI
    return result


@dataclass(frozen=True)
class Gaussian:
    """N(mean (d,), covariance (d, d)). Raises InputError where the covariance is not positive definite."""

    mean: FloatArray
    covariance: FloatArray

    def __post_init__(self) -> None:
        mean = as_vectors("mean", self.mean)
        if mean.ndim != 1:
            raise InputError(f"mean must have shape (d,), not {mean.shape}")
        covariance = repair_covariance(self.covariance)
        if covariance.shape != (mean.size, mean.size):
            raise InputError(f"covariance must have shape {(mean.size, mean.size)}, not {covariance.shape}")
        object.__setattr__(self, "mean", mean)
        object.__setattr__(self, "covariance", covariance)

    def log_density(self, x: npt.ArrayLike) -> FloatArray:
        """Log density (...) at x (..., d)."""
        return log_density(x, self.mean, self.covariance)

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Samples (count, d)."""
        factor = np.linalg.cholesky(self.covariance)
        return self.mean + rng.standard_normal((count, self.mean.size)) @ factor.T

    def entropy(self) -> float:
        """Differential entropy, nat: (3.3)."""
        return float(gaussian_entropy(self.covariance))


@dataclass(frozen=True)
class GaussianMixture:
    """Σ w_i N(m_i, P_i): weights (K,) ≥ 0, normalised on creation; means (K, d); covariances (K, d, d)."""

    weights: FloatArray
    means: FloatArray
    covariances: FloatArray

    def __post_init__(self) -> None:
        weights = as_finite("weights", self.weights)
        if weights.ndim != 1 or (weights < 0).any() or not weights.sum() > 0:
            raise InputError("weights must be (K,) numbers of at least 0, not all 0")
        means = as_vectors("means", self.means)
        covariances = repair_covariance(self.covariances, "covariances")
        if means.shape[:-1] != weights.shape or covariances.shape != (*means.shape, means.shape[-1]):
            raise InputError(
                f"means and covariances must be (K, d) and (K, d, d), not {means.shape}, {covariances.shape}"
            )
        object.__setattr__(self, "weights", weights / weights.sum())
        object.__setattr__(self, "means", means)
        object.__setattr__(self, "covariances", covariances)

    def log_density(self, x: npt.ArrayLike) -> FloatArray:
        """Log density (...) at x (..., d)."""
        x = as_vectors("x", x, self.means.shape[-1])
        with np.errstate(divide="ignore"):
            parts = np.log(self.weights) + log_density(x[..., None, :], self.means, self.covariances)
        return np.asarray(logsumexp(parts, axis=-1))

    def moments(self) -> Gaussian:
        """The Gaussian of the same mean and covariance."""
        mean = self.weights @ self.means
        spread = self.means - mean
        scatter = np.einsum("k,ki,kj->ij", self.weights, spread, spread)
        return Gaussian(mean, np.einsum("k,kij->ij", self.weights, self.covariances) + scatter)

    def sample(self, count: int, rng: np.random.Generator) -> FloatArray:
        """Samples (count, d)."""
        chosen = rng.choice(self.weights.size, count, p=self.weights)
        factors = np.linalg.cholesky(self.covariances)[chosen]
        noise = rng.standard_normal((count, self.means.shape[1], 1))
        return self.means[chosen] + (factors @ noise)[..., 0]

    def entropy(self, rng: np.random.Generator, samples: int = 2000) -> float:
        """Differential entropy, nat, by Monte Carlo (there is no closed form)."""
        return float(-self.log_density(self.sample(samples, rng)).mean())

    def entropy_bound(self) -> float:
        """Upper bound of the entropy, nat: Σ w_i (H(N_i) - ln w_i), at most ln K above the entropy."""
        kept = self.weights > 0
        w = self.weights[kept]
        return float(w @ (np.asarray(gaussian_entropy(self.covariances[kept])) - np.log(w)))

    def reduced(self, size: int) -> GaussianMixture:
        """At most `size` components: the pair whose merging costs least by Runnalls' bound goes first."""
        size = require_count("size", size)
        w, m, P = list(self.weights), list(self.means), list(self.covariances)
        while len(w) > size:
            merged = [
                (*_merge(w[i], m[i], P[i], w[j], m[j], P[j]), i, j)
                for i in range(len(w))
                for j in range(i + 1, len(w))
            ]
            _, weight, mean, covariance, i, j = min(merged, key=lambda entry: entry[0])
            for values, value in ((w, weight), (m, mean), (P, covariance)):
                values[i] = value
                del values[j]
        return GaussianMixture(np.array(w), np.array(m), np.array(P))


def _merge(
    w1: float, m1: FloatArray, P1: FloatArray, w2: float, m2: FloatArray, P2: FloatArray
) -> tuple[float, float, FloatArray, FloatArray]:
    """Runnalls' bound on the Kullback-Leibler cost of a merge (2007), then the merged component."""
    weight = w1 + w2
    if weight == 0:
        return 0.0, 0.0, m1, P1
    a, b = w1 / weight, w2 / weight
    offset = m1 - m2
    P = a * P1 + b * P2 + a * b * np.outer(offset, offset)
    logs = [float(np.linalg.slogdet(M)[1]) for M in (P, P1, P2)]
    return 0.5 * (weight * logs[0] - w1 * logs[1] - w2 * logs[2]), weight, a * m1 + b * m2, P
