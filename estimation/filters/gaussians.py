"""The repair of covariances that rounding made indefinite."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_square, require_symmetric
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

    Asymmetry of 1e-6 and eigenvalues down to -1e-9 of the largest are rounding: the eigenvalues are raised to 1e-12 of
    the largest and `repairs.count` grows by one per matrix. With `definite` false eigenvalues of zero are left
    as they are, a zero matrix included. Raises InputError naming `name` for anything worse.
    """
    P = as_square(name, covariance)
    transposed = np.swapaxes(P, -1, -2)
    try:
        np.linalg.cholesky(P)
    except np.linalg.LinAlgError:
        pass
    else:
        if (transposed == P).all():
            return P
    symmetric = 0.5 * (require_symmetric(name, P) + transposed)
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
