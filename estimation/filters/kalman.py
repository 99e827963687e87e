"""The Kalman filter as two functions over any number of filters at once."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_square, as_vectors, require_fitting
from estimation.errors import InputError
from estimation.filters.gaussians import LOG_TWO_PI, repair_covariance


def predict(
    mean: npt.ArrayLike, covariance: npt.ArrayLike, F: npt.ArrayLike, Q: npt.ArrayLike
) -> tuple[FloatArray, FloatArray]:
    """Mean F m and covariance F P Fᵀ + Q. mean (..., d), covariance, F and Q (..., d, d), broadcast."""
    m = as_vectors("mean", mean)
    P, Q = (repair_covariance(value, name, False) for name, value in (("covariance", covariance), ("Q", Q)))
    P, F, Q = (as_square(name, value, m.shape[-1]) for name, value in (("covariance", P), ("F", F), ("Q", Q)))
    require_fitting(mean=m, covariance=P[..., 0], F=F[..., 0], Q=Q[..., 0])
    P = F @ P @ np.swapaxes(F, -1, -2) + Q
    return (F @ m[..., None])[..., 0], 0.5 * (P + np.swapaxes(P, -1, -2))


def update(
    mean: npt.ArrayLike, covariance: npt.ArrayLike, z: npt.ArrayLike, H: npt.ArrayLike, R: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Posterior mean (..., d), covariance (..., d, d) and log likelihood (...) of z (..., m) = H x + N(0, R).

    H (m, d) or (..., m, d); R (..., m, m). The covariance is in Joseph's form, which rounding cannot turn
    indefinite for any gain. Raises InputError naming the argument.
    """
    m, z = as_vectors("mean", mean), as_vectors("z", z)
    P = as_square("covariance", repair_covariance(covariance, definite=False), m.shape[-1])
    R, H = repair_covariance(R, "R"), as_finite("H", H)
    if H.shape[-2:] != (z.shape[-1], m.shape[-1]) or R.shape[-1] != z.shape[-1]:
        raise InputError(f"H must have shape (..., {z.shape[-1]}, {m.shape[-1]}) and R fit z, not {H.shape}")
    require_fitting(mean=m, covariance=P[..., 0], H=H[..., 0, :])
    require_fitting(z=z, H=H[..., 0], R=R[..., 0])
    Ht = np.swapaxes(H, -1, -2)
    S = H @ P @ Ht + R
    innovation = z - (H @ m[..., None])[..., 0]
    gain = np.swapaxes(np.linalg.solve(S, H @ P), -1, -2)
    keep = np.eye(m.shape[-1]) - gain @ H
    P = keep @ P @ np.swapaxes(keep, -1, -2) + gain @ R @ np.swapaxes(gain, -1, -2)
    square = (innovation * np.linalg.solve(S, innovation[..., None])[..., 0]).sum(-1)
    log_likelihood = -0.5 * (square + np.linalg.slogdet(S)[1] + z.shape[-1] * LOG_TWO_PI)
    return (
        m + (gain @ innovation[..., None])[..., 0],
        0.5 * (P + np.swapaxes(P, -1, -2)),
        np.asarray(log_likelihood),
    )
