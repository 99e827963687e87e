"""How good an estimate is: RMSE, NEES, trajectory error, relations, OSPA and GOSPA."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt
from scipy.special import gammaincinv

from estimation.checks import (
    FloatArray,
    as_finite,
    as_number,
    as_square,
    as_vectors,
    require_count,
    require_fitting,
    require_symmetric,
)
from estimation.errors import InputError
from estimation.metrics.set_metrics import GospaParts, gospa, gospa_parts, ospa
from estimation.metrics.trajectory_metrics import (
    RelationErrors,
    TrajectoryErrors,
    absolute_trajectory_error,
    align_points,
    associate,
    relations_error,
)

__all__ = [
    "GospaParts", "RelationErrors", "TrajectoryErrors", "absolute_trajectory_error", "align_points",
    "anees_bounds", "associate", "gospa", "gospa_parts", "nees", "ospa", "relations_error", "rmse",
]  # fmt: skip


def rmse(error: npt.ArrayLike) -> float:
    """Root of the mean squared length of the error vectors (N, d); of a flat (N,) array, of its numbers."""
    array = as_finite("error", error)
    if array.ndim not in (1, 2) or array.shape[0] == 0:
        raise InputError(f"error must have shape (N,) or (N, d) with N > 0, not {array.shape}")
    return math.sqrt(float((array**2).sum()) / array.shape[0])


def nees(error: npt.ArrayLike, cov: npt.ArrayLike) -> float | FloatArray:
    """Normalised estimation error squared, eᵀ P⁻¹ e: (6.8) before averaging.

    error : (..., d); cov : (..., d, d), positive definite, broadcast against the errors.
    Returns a float for one error vector, else an array (...). Of a consistent estimator it is χ² with d
    degrees of freedom. Raises InputError for shapes that do not fit and for covariances that are not
    positive definite.
    """
    e = as_vectors("error", error)
    P = require_symmetric("cov", as_square("cov", cov, e.shape[-1]))
    require_fitting(error=e, cov=P[..., 0])
    try:
        factor = np.linalg.cholesky(P)
    except np.linalg.LinAlgError as problem:
        raise InputError("cov must be positive definite") from problem
    whitened = np.linalg.solve(factor, e[..., None])[..., 0]
    squares = (whitened**2).sum(-1)
    return float(squares) if squares.ndim == 0 else squares


def anees_bounds(count: int, dimension: int, confidence: float = 0.95) -> tuple[float, float]:
    """Interval in which the mean of `count` independent NEES values of a consistent estimator falls.

    The mean is around `dimension`; the interval leaves (1 - confidence) / 2 out on each side (χ²).
    """
    count, dimension = require_count("count", count), require_count("dimension", dimension)
    if not 0.0 < as_number("confidence", confidence) < 1.0:
        raise InputError(f"confidence must be between 0 and 1, not {confidence!r}")
    tail = 0.5 * (1.0 - confidence)
    low, high = 2.0 * gammaincinv(0.5 * count * dimension, [tail, 1.0 - tail]) / count
    return float(low), float(high)
