"""Spherical measurements (range, bearing, elevation) as Cartesian Gaussians, in the sensor's or map frame.

The 2D conversions' definitions, carried over. In the frame turned by the measured bearing let u be the unit
vector to the object, m(σ) = E[u] and S(σ) = E[u uᵀ] over the angular noise; both are products of E[cos] = λ,
E[cos 2·] = λ⁴ of either angle. Given the measurement the truth has mean r m and second moment (r² + σ_r²) S.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_vectors, require_count, require_fitting
from estimation.conversion.polar import (
    SIGMA_POINT,
    Method,
    check_angle,
    check_method,
    check_positive,
    check_spread,
    moments_of_samples,
)
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from estimation.geometry.rotations import euler_rates, rotation_from_euler

__all__ = ["convert_spherical", "convert_spherical_to_map", "spherical_points"]


def spherical_points(range_: npt.ArrayLike, bearing: npt.ArrayLike, elevation: npt.ArrayLike) -> FloatArray:
    """(..., 3) x forward, y left, z up of range (m), bearing (about z) and elevation (above xy), rad."""
    r, b, e = (np.asarray(v, dtype=np.float64) for v in (range_, bearing, elevation))
    return np.stack(
        np.broadcast_arrays(r * np.cos(b) * np.cos(e), r * np.sin(b) * np.cos(e), r * np.sin(e)), -1
    )


def _direction_moments(e: FloatArray, vb: FloatArray, ve: FloatArray) -> tuple[FloatArray, FloatArray]:
    """E[u] (..., 3) and E[u uᵀ] (..., 3, 3) at elevation e with angular variances vb, ve."""
    lb, le = np.exp(-0.5 * vb), np.exp(-0.5 * ve)
    c2, s2 = le**4 * np.cos(2 * e), le**4 * np.sin(2 * e)
    zero = np.zeros_like(c2 * lb)
    mean = np.stack(np.broadcast_arrays(lb * le * np.cos(e), zero, le * np.sin(e)), -1)
    S = np.zeros((*zero.shape, 3, 3))
    S[..., 0, 0] = 0.25 * (1 + lb**4) * (1 + c2)
    S[..., 1, 1] = 0.25 * (1 - lb**4) * (1 + c2)
    S[..., 2, 2] = 0.5 * (1 - c2)
    S[..., 0, 2] = S[..., 2, 0] = 0.5 * lb * s2
    return mean, S


def _outer(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[..., :, None] * b[..., None, :]


def _closed_form(
    r: FloatArray, e: FloatArray, sr: FloatArray, vb: FloatArray, ve: FloatArray, method: str
) -> tuple[FloatArray, FloatArray]:
    """Mean (..., 3) and covariance (..., 3, 3) in the frame turned by the bearing."""
    r2, s2 = (r**2)[..., None, None], (sr**2)[..., None, None]
    zero = np.zeros_like(e)
    u = spherical_points(1.0, zero, e)
    if method == "linear":
        across = np.stack([zero, np.cos(e), zero], -1)
        up = np.stack([-np.sin(e), zero, np.cos(e)], -1)
        P = s2 * _outer(u, u) + r2 * vb[..., None, None] * _outer(across, across)
        return r[..., None] * u, P + r2 * ve[..., None, None] * _outer(up, up)
    mean, S = _direction_moments(e, vb, ve)
    if method == "mucm":
        return r[..., None] * mean, (r2 + s2) * S - r2 * _outer(mean, mean)
    # E[measured u | truth] = shrink · u, component by component.
    lb, le = np.exp(-0.5 * vb), np.exp(-0.5 * ve)
    shrink = np.stack([lb * le, lb * le, le], -1)
    if method == "ucm":
        converted = u / shrink
        mixed = _outer(converted, mean)
        error = _outer(converted, converted) - mixed - np.swapaxes(mixed, -1, -2)
        return r[..., None] * converted, r2 * error + (r2 + s2) * S
    # DCM: bias and covariance given the truth, averaged over the truth given the measurement.
    _, twice = _direction_moments(e, 2 * vb, 2 * ve)
    P = (r2 + 2 * s2) * twice - (r2 + s2) * _outer(shrink, shrink) * S
    return r[..., None] * (u - mean * (shrink - 1.0)), P


def _unscented(r: FloatArray, e: FloatArray, sigmas: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Seven sigma points at √3 σ; the central one has weight 0 for n + κ = 3."""
    steps = SIGMA_POINT * np.concatenate([np.eye(3), -np.eye(3)])
    points = np.stack(np.broadcast_arrays(r, np.zeros_like(e), e), -1) + steps.reshape(
        6, *([1] * r.ndim), 3
    ) * np.broadcast_to(sigmas, (*np.broadcast_shapes(r.shape, e.shape), 3))
    moved = spherical_points(*np.moveaxis(points, -1, 0))
    mean = moved.mean(0)
    return mean, np.einsum("n...i,n...j->...ij", moved - mean, moved - mean) / 6.0


def convert_spherical(
    range_: npt.ArrayLike,
    bearing: npt.ArrayLike,
    elevation: npt.ArrayLike,
    sigma_range: npt.ArrayLike,
    sigma_bearing: npt.ArrayLike,
    sigma_elevation: npt.ArrayLike,
    method: Method = "ucm",
    samples: int = 1000,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """Mean (..., 3) and covariance (..., 3, 3), m and m², in the frame the angles are measured in.

    range_ : m, > 0. bearing : about z, within ±π; elevation : above the xy-plane, within ±π/2, rad. Standard
    deviations > 0, m and rad, of angles up to π. Scalars or arrays that broadcast. Raises InputError naming the
    argument.
    """
    check_method(method)
    given = {
        "range_": check_positive("range_", range_),
        "bearing": check_angle("bearing", bearing),
        "elevation": check_angle("elevation", elevation, np.pi / 2),
        "sigma_range": check_positive("sigma_range", sigma_range),
        "sigma_bearing": check_spread("sigma_bearing", sigma_bearing),
        "sigma_elevation": check_spread("sigma_elevation", sigma_elevation),
    }
    require_fitting(**given)
    r, b, e, sr, sb, se = np.broadcast_arrays(*given.values())
    if method == "sampled":
        samples = require_count("samples", samples, 2)
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal((samples, 3, *r.shape))
        points = spherical_points(r + sr * noise[:, 0], b + sb * noise[:, 1], e + se * noise[:, 2])
        return moments_of_samples(points)
    if method == "unscented":
        mean, P = _unscented(r, e, np.stack([sr, sb, se], -1))
    else:
        mean, P = _closed_form(r, e, sr, sb**2, se**2, method)
    zero = np.zeros_like(b)
    R = rotation_from_euler(np.stack([zero, zero, b], -1))
    P = R @ P @ np.swapaxes(R, -1, -2)
    return (R @ mean[..., None])[..., 0], repair_covariance(P, "converted covariance")


def convert_spherical_to_map(
    robot_pose: npt.ArrayLike,
    robot_covariance: npt.ArrayLike,
    range_: npt.ArrayLike,
    bearing: npt.ArrayLike,
    elevation: npt.ArrayLike,
    sigma_range: npt.ArrayLike,
    sigma_bearing: npt.ArrayLike,
    sigma_elevation: npt.ArrayLike,
    method: Method = "ucm",
    samples: int = 1000,
    seed: int = 0,
) -> tuple[FloatArray, FloatArray]:
    """Mean (..., 3) and covariance (..., 3, 3) in the map frame through an uncertain pose of the sensor.

    robot_pose : (6,) [x, y, z, roll, pitch, yaw] of the sensor; robot_covariance : (6, 6), zero where exact.
    Upright sensors (roll = pitch = 0) add their yaw variance to the bearing's, exactly as in 2D; all other
    rotational uncertainty enters to first order, as does its correlation with the position. samples, seed : of method
    "sampled" only.
    """
    pose = as_vectors("robot_pose", robot_pose, 6)
    P = repair_covariance(robot_covariance, "robot_covariance", definite=False)
    if pose.ndim != 1 or P.shape != (6, 6):
        raise InputError(f"robot_pose and robot_covariance must be (6,), (6, 6), not {pose.shape}, {P.shape}")
    upright = bool((pose[3:5] == 0).all())
    sb = check_spread("sigma_bearing", sigma_bearing)
    heading = P[5, 5] if upright else 0.0
    check_angle("deviation of robot_pose yaw", np.sqrt(heading))
    total = np.sqrt(sb**2 + heading)
    mean, cov = convert_spherical(
        range_, bearing, elevation, sigma_range, total, sigma_elevation, method, samples, seed
    )
    R = rotation_from_euler(pose[3:])
    turned = (R @ mean[..., None])[..., 0]
    # Columns: what one metre or radian of each pose component moves the object by.
    J = np.zeros((*turned.shape, 6))
    J[..., :3, :3] = np.eye(3)
    J[..., :3, 3:] = np.cross(euler_rates(pose[3:]), turned[..., :, None], axis=-2)
    full = J @ P @ np.swapaxes(J, -1, -2)
    if upright:
        full = full - heading * _outer(J[..., 5], J[..., 5])
    return pose[:3] + turned, R @ cov @ R.T + full
