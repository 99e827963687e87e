"""Polar measurements (range, bearing) as Cartesian Gaussians, and how Gaussian they are: chapter 6 of the
anchoring text.

Five conversions share one interface. With q = exp(-σ_θ²), all of them are diagonal in the frame that points
along the measured bearing, so each is a mean along it and a variance along and across it:

linear      first-order Taylor expansion
dcm         debiased: minus the average bias given the measurement (Lerro, Bar-Shalom 1993)
ucm         unbiased: divided by E[cos θ̃], so unbiased given the truth (Longbin et al. 1998)
mucm        the mean and covariance of the truth given the measurement (Duan et al. 2004)
unscented   five sigma points at √3 σ
sampled     mean and covariance of random samples

Their variances are written as products in 1 - q and stay accurate, and positive, for small angles.
"""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_square, require_count, require_fitting
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from estimation.filters.normality import mardia_statistics, mardia_test

__all__ = [
    "METHODS", "Method", "absolute_bias", "bias_significance", "condition_ratio", "convert",
    "convert_samples", "mardia_statistics", "mardia_test", "rotate_local",
]  # fmt: skip

Method = Literal["linear", "dcm", "ucm", "mucm", "unscented", "sampled"]
METHODS: tuple[str, ...] = get_args(Method)

# Angles are checked against π with room for single-precision messages, whose π is 9e-8 too large.
ANGLE_ROOM = 1e-6

# Sigma points sit at sqrt(n + κ) = √3 standard deviations: κ = 3 - n matches a Gaussian's fourth moment.
SIGMA_POINT = 3.0**0.5


def check_positive(name: str, value: npt.ArrayLike) -> FloatArray:
    """Finite array of numbers above zero."""
    array = as_finite(name, value)
    if not (array > 0).all():
        raise InputError(f"{name} must be above 0; its smallest value is {array.min():g}")
    return array


def check_angle(name: str, value: npt.ArrayLike, limit: float = np.pi) -> FloatArray:
    """Finite array of angles within ±limit, rad."""
    array = as_finite(name, value)
    if not (np.abs(array) <= limit + ANGLE_ROOM).all():
        raise InputError(
            f"{name} must be within ±{limit:.6g} rad; its largest magnitude is {np.abs(array).max():g}"
        )
    return array


def check_spread(name: str, value: npt.ArrayLike) -> FloatArray:
    """Finite array of an angle's standard deviations, above 0 and up to π, rad: in degrees they would be more."""
    return check_positive(name, check_angle(name, value))


def check_measurement(
    range_: npt.ArrayLike, bearing: npt.ArrayLike, sigma_range: npt.ArrayLike, sigma_bearing: npt.ArrayLike
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Range, bearing and their standard deviations as arrays that broadcast; InputError naming the argument."""
    r, sr = check_positive("range_", range_), check_positive("sigma_range", sigma_range)
    theta, st = check_angle("bearing", bearing), check_spread("sigma_bearing", sigma_bearing)
    require_fitting(range_=r, bearing=theta, sigma_range=sr, sigma_bearing=st)
    return r, theta, sr, st


def check_method(method: str) -> None:
    """InputError unless `method` names a conversion."""
    if method not in METHODS:
        raise InputError(f"method must be one of {', '.join(METHODS)}, not {method!r}")


def local_moments(
    range_: FloatArray, sigma_range: FloatArray, sigma_bearing: FloatArray, method: str
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Mean along the bearing and variances along and across it (m, m², m²) of a closed-form conversion.

    The "dcm" and "ucm" variances are those of the error given the measurement, hence with the squared
    difference of their mean from E[truth | measurement].
    """
    r2, s2, v = range_**2, sigma_range**2, sigma_bearing**2
    if method == "linear":
        return range_, s2, r2 * v
    if method == "unscented":
        c, s = np.cos(SIGMA_POINT * sigma_bearing), np.sin(SIGMA_POINT * sigma_bearing)
        # The mean is r (2 + c) / 3; the points lie r (1 - c) / 3 above and 2 r (1 - c) / 3 below it.
        return range_ * (2.0 + c) / 3.0, s2 + 2.0 / 9.0 * r2 * (1.0 - c) ** 2, r2 * s**2 / 3.0
    q = np.exp(-v)
    p = -np.expm1(-v)
    if method == "dcm":
        along = 0.5 * r2 * p * p * (1 + q + q * q) + s2 * (1 + q**4 - 0.5 * q * (1 + q * q))
        across = 0.5 * r2 * p * (1 + q**3) + s2 * (1 - q**4 - 0.5 * q * (1 - q * q))
        return range_ * (1 - q + np.sqrt(q)), along, across
    across = 0.5 * (r2 + s2) * p * (1 + q)
    noise = 0.5 * s2 * (1 + q * q)
    if method == "ucm":
        return range_ / np.sqrt(q), 0.5 * r2 * p * p * (2 + q) / q + noise, across
    return range_ * np.sqrt(q), 0.5 * r2 * p * p + noise, across


def rotate_local(
    bearing: FloatArray, along: FloatArray, across: FloatArray, cross: FloatArray | float = 0.0
) -> FloatArray:
    """Covariance (..., 2, 2) in the outer frame of one given along and across a bearing (...), rad."""
    c, s = np.cos(bearing), np.sin(bearing)
    cc, ss, cs = c * c, s * s, c * s
    out = np.empty((*np.broadcast_shapes(c.shape, np.shape(along)), 2, 2))
    out[..., 0, 0] = cc * along + ss * across - 2.0 * cs * cross
    out[..., 1, 1] = ss * along + cc * across + 2.0 * cs * cross
    out[..., 0, 1] = cs * (along - across) + (cc - ss) * cross
    out[..., 1, 0] = out[..., 0, 1]
    return out


def convert(
    range_: npt.ArrayLike,
    bearing: npt.ArrayLike,
    sigma_range: npt.ArrayLike,
    sigma_bearing: npt.ArrayLike,
    method: Method = "ucm",
    samples: int = 1000,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """Mean (..., 2) and covariance (..., 2, 2), m and m², in the frame the bearing is measured in (6.3).

    range_ : m, > 0. bearing : rad, within ±π. sigma_range, sigma_bearing : standard deviations, m and rad,
    > 0, the latter up to π. All scalars or arrays that broadcast against each other. samples, seed : of method
    "sampled" only.
    An uncertain robot heading adds to the bearing and its variance (6.6); see `estimation.conversion.map_frame`.
    Raises InputError naming the argument.
    """
    check_method(method)
    r, theta, sr, st = check_measurement(range_, bearing, sigma_range, sigma_bearing)
    if method == "sampled":
        points = convert_samples(r, theta, sr, st, samples, seed)
        return moments_of_samples(points)
    mean, along, across = local_moments(r, sr, st, method)
    cov = rotate_local(theta, *np.broadcast_arrays(along, across))
    radius, angle = np.broadcast_arrays(mean, theta)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle)], -1), cov


def moments_of_samples(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Mean (..., d) and unbiased covariance (..., d, d) of samples (N, ..., d)."""
    mean = points.mean(0)
    offsets = points - mean
    return mean, np.einsum("n...i,n...j->...ij", offsets, offsets) / (len(points) - 1)


def convert_samples(
    range_: npt.ArrayLike,
    bearing: npt.ArrayLike,
    sigma_range: npt.ArrayLike,
    sigma_bearing: npt.ArrayLike,
    samples: int = 1000,
    seed: int | np.random.Generator = 0,
) -> FloatArray:
    """Samples (N, ..., 2), m, of polar measurements drawn with their noise and converted with (6.3)."""
    samples = require_count("samples", samples, 2)
    arrays = [as_finite(n, v) for n, v in (("range_", range_), ("bearing", bearing))]
    arrays += [as_finite(n, v) for n, v in (("sigma_range", sigma_range), ("sigma_bearing", sigma_bearing))]
    rng = np.random.default_rng(seed)
    shape = (
        samples,
        *require_fitting(range_=arrays[0], bearing=arrays[1], sigma_range=arrays[2], sigma_bearing=arrays[3]),
    )
    r = arrays[0] + arrays[2] * rng.standard_normal(shape)
    theta = arrays[1] + arrays[3] * rng.standard_normal(shape)
    return np.stack([r * np.cos(theta), r * np.sin(theta)], -1)


def condition_ratio(
    range_: npt.ArrayLike,
    bearing: npt.ArrayLike,
    sigma_range: npt.ArrayLike,
    sigma_bearing: npt.ArrayLike,
    position_covariance: npt.ArrayLike | None = None,
) -> float | FloatArray:
    """K of (6.12): λmin / λmax of the UCM covariance over λmin / λmax of the linearised one.

    Arguments as of `convert`. position_covariance : (..., 2, 2), m², of the robot's position in the frame of
    the bearing, added to both; without it K depends on σ_range / range and σ_bearing only. A float for
    scalars, else (...). Above 1.075, (6.13), the converted measurement no longer looks Gaussian.
    """
    r, theta, sr, st = check_measurement(range_, bearing, sigma_range, sigma_bearing)
    _, u_along, u_across = local_moments(r, sr, st, "ucm")
    _, l_along, l_across = local_moments(r, sr, st, "linear")
    if position_covariance is None:
        ratio = _axis_ratio(u_along, u_across) / _axis_ratio(l_along, l_across)
        ratio = np.broadcast_to(ratio, np.broadcast_shapes(ratio.shape, theta.shape))
    else:
        Sigma = as_square("position_covariance", repair_covariance(position_covariance, definite=False), 2)
        u = rotate_local(theta, *np.broadcast_arrays(u_along, u_across)) + Sigma
        lin = rotate_local(theta, *np.broadcast_arrays(l_along, l_across)) + Sigma
        ratio = _eigenvalue_ratio(u) / _eigenvalue_ratio(lin)
    return float(ratio) if ratio.ndim == 0 else ratio


def _axis_ratio(a: FloatArray, b: FloatArray) -> FloatArray:
    return np.minimum(a, b) / np.maximum(a, b)


def _eigenvalue_ratio(P: FloatArray) -> FloatArray:
    """λmin / λmax of covariances (..., 2, 2); λmin by the determinant, exact also for flat ellipses."""
    half = 0.5 * (P[..., 0, 0] + P[..., 1, 1])
    gap = np.hypot(0.5 * (P[..., 0, 0] - P[..., 1, 1]), P[..., 0, 1])
    largest = half + gap
    return (P[..., 0, 0] * P[..., 1, 1] - P[..., 0, 1] ** 2) / largest**2


def absolute_bias(
    range_: npt.ArrayLike, bearing: npt.ArrayLike, sigma_range: npt.ArrayLike, sigma_bearing: npt.ArrayLike
) -> float | FloatArray:
    """Distance, m, between the linearised and the UCM mean: the candidate measure (6.10)."""
    linear, _ = convert(range_, bearing, sigma_range, sigma_bearing, "linear")
    ucm, _ = convert(range_, bearing, sigma_range, sigma_bearing, "ucm")
    bias = np.linalg.norm(linear - ucm, axis=-1)
    return float(bias) if bias.ndim == 0 else bias


def bias_significance(
    range_: npt.ArrayLike, bearing: npt.ArrayLike, sigma_range: npt.ArrayLike, sigma_bearing: npt.ArrayLike
) -> float | FloatArray:
    """Absolute bias over the smallest standard deviation of the UCM: the candidate measure β of (6.11)."""
    bias = absolute_bias(range_, bearing, sigma_range, sigma_bearing)
    r, sr, st = (np.asarray(v, dtype=np.float64) for v in (range_, sigma_range, sigma_bearing))
    _, along, across = local_moments(r, sr, st, "ucm")
    beta = bias / np.sqrt(np.minimum(along, across))
    return float(beta) if np.ndim(beta) == 0 else beta
