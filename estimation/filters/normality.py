"""Mardia's test of multivariate normality (Mardia 1974), section 6.5.3."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import combinations_with_replacement
from math import comb, factorial, sqrt

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv, ndtri

from estimation.checks import FloatArray, as_number, as_points
from estimation.errors import InputError


@dataclass(frozen=True)
class Mardia:
    """Multivariate skewness b1, kurtosis b2, and their statistics: χ² with `degrees` and standard normal."""

    skewness: float
    kurtosis: float
    skewness_statistic: float
    kurtosis_statistic: float
    degrees: int


@lru_cache(maxsize=32)
def _monomials(dimension: int) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """Index triples i ≤ j ≤ k and how many ordered triples each stands for."""
    triples = np.array(list(combinations_with_replacement(range(dimension), 3)))
    counts = [6.0 / np.prod([factorial(n) for n in np.bincount(t)]) for t in triples]
    return triples, np.array(counts)


@lru_cache(maxsize=256)
def _limits(alpha: float, dimension: int) -> tuple[float, float]:
    # Each of the two statistics gets half of α, so that a Gaussian fails the pair at a rate of α at most.
    chi2 = 2.0 * gammaincinv(0.5 * comb(dimension + 2, 3), 1 - alpha / 2)
    return float(chi2), float(-ndtri(alpha / 4))


def mardia_statistics(samples: npt.ArrayLike) -> Mardia:
    """Mardia's skewness and kurtosis of samples (N, d), N > d.

    Skewness is the squared norm of the third moment tensor of the whitened samples, which equals the text
    book's mean of (x_iᵀ S⁻¹ x_j)³ over all pairs but costs O(N d³) in place of O(N² d). Its statistic has
    the small-sample factor of Mardia 1974. Raises InputError where the samples span no volume.
    """
    x = as_points("samples", samples)
    count, d = x.shape
    if count <= d + 1:
        raise InputError(f"samples must be more than {d + 1} in {d} dimensions, not {count}")
    offsets = x - x.mean(0)
    S = offsets.T @ offsets / count
    try:
        y = np.linalg.solve(np.linalg.cholesky(S), offsets.T)
    except np.linalg.LinAlgError as error:
        raise InputError("samples must span all dimensions; their covariance is singular") from error
    triples, weights = _monomials(d)
    pairs = {(i, j): y[i] * y[j] for i in range(d) for j in range(i, d)}
    third = np.array([pairs[i, j] @ y[k] for i, j, k in triples.tolist()]) / count
    skewness = float(weights @ third**2)
    kurtosis = float(((y * y).sum(0) ** 2).mean())
    factor = (d + 1) * (count + 1) * (count + 3) / (count * ((count + 1) * (d + 1) - 6))
    return Mardia(
        skewness,
        kurtosis,
        count * factor * skewness / 6,
        (kurtosis - d * (d + 2) * (count - 1) / (count + 1)) / sqrt(8 * d * (d + 2) / count),
        comb(d + 2, 3),
    )


def mardia_test(samples: npt.ArrayLike, alpha: float = 0.05) -> bool:
    """True where neither skewness nor kurtosis of samples (N, d) speaks against a Gaussian.

    alpha : rate at which samples of a Gaussian fail, shared evenly by the two statistics.
    """
    if not 0.0 < as_number("alpha", alpha) < 1.0:
        raise InputError(f"alpha must be between 0 and 1, not {alpha!r}")
    found = mardia_statistics(samples)
    skewness_limit, kurtosis_limit = _limits(float(alpha), np.shape(samples)[1])
    return found.skewness_statistic <= skewness_limit and abs(found.kurtosis_statistic) <= kurtosis_limit
