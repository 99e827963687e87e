"""The compiled loops of `conversion.switching`: the Kalman side for many targets, the particle side for one."""

from __future__ import annotations

import math

import numba
import numpy as np

from estimation.conversion.conversion_kernels import mucm_local, rotated, to_map_ucm

# What `update_kalman` returns; 0 is success.
PROBLEMS = {
    1: "robot_pose must be finite with a yaw within ±π",
    2: "robot_covariance must be finite, symmetric and positive semi-definite, its yaw variance up to π² rad²",
    3: "measurement must be finite: a range above 0 and a bearing within ±π",
    4: "covariance must be finite and diagonal (range and bearing are independent) with variances above 0, the "
    "bearing's up to π² rad²",
}
# What `check` also returns: the robot's covariance is indefinite or asymmetric, but by no more than rounding.
ROUNDED = -1
_ROOM = 1e-6
_ROUNDING = 1e-9
WIDEST = (math.pi + _ROOM) ** 2  # rad², variance of an angle; one in degrees is more


@numba.njit(cache=True)
def _semi_definite(P, rounding):  # type: ignore[no-untyped-def]
    """Whether a symmetric (3, 3) is positive semi-definite up to `rounding`, by its principal minors."""
    size = 0.0
    for i in range(3):
        for j in range(3):
            if not math.isfinite(P[i, j]):
                return False
            size = max(size, abs(P[i, j]))
    for i in range(3):
        if P[i, i] < -rounding * size:
            return False
        for j in range(i):
            if abs(P[i, j] - P[j, i]) > rounding * size:
                return False
            if P[i, i] * P[j, j] - P[i, j] * P[i, j] < -rounding * size * size:
                return False
    a = P[1, 1] * P[2, 2] - P[1, 2] * P[1, 2]
    b = P[0, 1] * P[2, 2] - P[1, 2] * P[0, 2]
    c = P[0, 1] * P[1, 2] - P[1, 1] * P[0, 2]
    return P[0, 0] * a - P[0, 1] * b + P[0, 2] * c >= -rounding * size * size * size


@numba.njit(cache=True)
def check(pose, P, z, R):  # type: ignore[no-untyped-def]
    """0, `ROUNDED`, or the number of the problem in `PROBLEMS`. z (M, 2), R (1 or M, 2, 2)."""
    if not (math.isfinite(pose[0]) and math.isfinite(pose[1]) and abs(pose[2]) <= math.pi + _ROOM):
        return 1
    if not _semi_definite(P, _ROUNDING) or P[2, 2] > WIDEST:
        return 2
    for i in range(z.shape[0]):
        if not (0.0 < z[i, 0] < math.inf and abs(z[i, 1]) <= math.pi + _ROOM):
            return 3
    for i in range(R.shape[0]):
        if not (0.0 < R[i, 0, 0] < math.inf and 0.0 < R[i, 1, 1] <= WIDEST):
            return 4
        if R[i, 0, 1] != 0.0 or R[i, 1, 0] != 0.0:
            return 4
    # Minors of a covariance without full rank are zero only up to the last digits.
    return 0 if _semi_definite(P, 1e-15) else ROUNDED


@numba.njit(cache=True)
def predict_kalman(means, covariances, active, dt, q):  # type: ignore[no-untyped-def]
    """Constant-velocity prediction, in place, of the targets with `active`; q is the squared acceleration."""
    q11, q12, q22 = q * dt * dt * dt / 3.0, q * dt * dt / 2.0, q * dt
    for t in range(means.shape[0]):
        if not active[t]:
            continue
        m, P = means[t], covariances[t]
        m[0] += dt * m[2]
        m[1] += dt * m[3]
        for j in range(4):
            P[0, j] += dt * P[2, j]
            P[1, j] += dt * P[3, j]
        for i in range(4):
            P[i, 0] += dt * P[i, 2]
            P[i, 1] += dt * P[i, 3]
        for a in range(2):
            P[a, a] += q11
            P[a, a + 2] += q12
            P[a + 2, a] += q12
            P[a + 2, a + 2] += q22


@numba.njit(cache=True)
def _update_one(m, P, zx, zy, rxx, rxy, ryy):  # type: ignore[no-untyped-def]
    """Kalman update of [x, y, vx, vy] with a position, in Joseph's form: precise noise on a vague prior is safe."""
    sxx, sxy, syy = P[0, 0] + rxx, P[0, 1] + rxy, P[1, 1] + ryy
    det = sxx * syy - sxy * sxy
    ex, ey = zx - m[0], zy - m[1]
    gain = np.empty((4, 2))
    for i in range(4):
        gain[i, 0] = (P[i, 0] * syy - P[i, 1] * sxy) / det
        gain[i, 1] = (P[i, 1] * sxx - P[i, 0] * sxy) / det
        m[i] += gain[i, 0] * ex + gain[i, 1] * ey
    # (I - K H) P, with H taking the first two rows.
    left = np.empty((4, 4))
    for i in range(4):
        for j in range(4):
            left[i, j] = P[i, j] - gain[i, 0] * P[0, j] - gain[i, 1] * P[1, j]
    for i in range(4):
        nx = gain[i, 0] * rxx + gain[i, 1] * rxy
        ny = gain[i, 0] * rxy + gain[i, 1] * ryy
        for j in range(i, 4):
            kept = left[i, j] - left[i, 0] * gain[j, 0] - left[i, 1] * gain[j, 1]
            P[i, j] = P[j, i] = kept + nx * gain[j, 0] + ny * gain[j, 1]


@numba.njit(cache=True)
def predicted_direction(x, y, xx, xy, yy, pose, Pr, r, variance):  # type: ignore[no-untyped-def]
    """From the robot to the predicted target, where that is known better than by the measurement; else (0, 0).

    A covariance aligned with the measured bearing is correlated with the measurement's error: the flat side of
    the ellipse follows the noise, and the target is drawn outwards. (Bordonaro et al. 2012.)
    """
    dx, dy = x - pose[0], y - pose[1]
    across = (dy * dy * xx - 2.0 * dx * dy * xy + dx * dx * yy) / max(dx * dx + dy * dy, 1e-300)
    if across < r * r * (variance + Pr[2, 2]):
        return dx, dy
    return 0.0, 0.0


@numba.njit(cache=True)
def ratio_where_expected(x, y, C, pose, Pr, z, R, position):  # type: ignore[no-untyped-def]
    """K of a measurement whose bearing is as uncertain as measurement and predicted position are together."""
    dx, dy = x - pose[0], y - pose[1]
    square = max(dx * dx + dy * dy, 1e-300)
    across = (dy * dy * C[0, 0] - 2.0 * dx * dy * C[0, 1] + dx * dx * C[1, 1]) / square
    measured, predicted = R[1, 1] + Pr[2, 2], max(across / square, 1e-300)
    both = 1.0 / (1.0 / measured + 1.0 / predicted)
    # The heading is in it: nothing more of it may be added.
    P = np.zeros((3, 3))
    P[:2, :2] = Pr[:2, :2]
    return to_map_ucm(pose, P, z[0], z[1], math.sqrt(R[0, 0]), math.sqrt(both), position, 0.0, 0.0)[5]


@numba.njit(cache=True)
def update_kalman(means, covariances, kalman, targets, pose, Pr, z, R, k_crit, position, decorrelated, K):  # type: ignore[no-untyped-def]
    """Kalman update of every target in Kalman mode with K below k_crit; K is filled in for all of them.

    Arguments as `check` wants them.
    """
    for i in range(targets.size):
        t = targets[i]
        Ri = R[i % R.shape[0]]
        m, P = means[t], covariances[t]
        dx, dy = 0.0, 0.0
        if decorrelated and kalman[t]:
            dx, dy = predicted_direction(m[0], m[1], P[0, 0], P[0, 1], P[1, 1], pose, Pr, z[i, 0], Ri[1, 1])
        zx, zy, rxx, rxy, ryy, K[i] = to_map_ucm(
            pose, Pr, z[i, 0], z[i, 1], math.sqrt(Ri[0, 0]), math.sqrt(Ri[1, 1]), position, dx, dy
        )
        if kalman[t] and K[i] < k_crit:
            _update_one(m, P, zx, zy, rxx, rxy, ryy)


@numba.njit(cache=True)
def predict_particles(states, noise, dt, q):  # type: ignore[no-untyped-def]
    """Move particles (N, 4) in place; noise (N, 4) standard normal."""
    # Cholesky factor of the white-acceleration covariance of one axis.
    a = math.sqrt(q * dt * dt * dt / 3.0)
    b = math.sqrt(3.0 * q * dt) / 2.0
    c = math.sqrt(q * dt) / 2.0
    for n in range(states.shape[0]):
        for axis in range(2):
            states[n, axis] += dt * states[n, axis + 2] + a * noise[n, axis]
            states[n, axis + 2] += b * noise[n, axis] + c * noise[n, axis + 2]


@numba.njit(cache=True)
def gaussian_log_likelihood(states, pose, Pr, z, R, dx, dy, out):  # type: ignore[no-untyped-def]
    """Log likelihood (up to a constant) of each particle under the measurement converted along (dx, dy)."""
    zx, zy, rxx, rxy, ryy, _ = to_map_ucm(
        pose, Pr, z[0], z[1], math.sqrt(R[0, 0]), math.sqrt(R[1, 1]), False, dx, dy
    )
    det = rxx * ryy - rxy * rxy
    for n in range(states.shape[0]):
        ex, ey = states[n, 0] - zx, states[n, 1] - zy
        out[n] = -0.5 * (ex * ex * ryy - 2.0 * ex * ey * rxy + ey * ey * rxx) / det


@numba.njit(cache=True)
def measurement_samples(offsets, width, pose, Pr, z, R, out):  # type: ignore[no-untyped-def]
    """The measurement as Ns small Gaussians in the map: x, y, inverse covariance (3), log weight, (Ns, 6).

    offsets (Ns, 2) : standard normal samples of range and bearing. Each sample carries the share `width`²
    of the polar variances, the samples the rest; the robot's position adds its covariance given the
    heading. So the mixture has the measurement's moments for any number of samples, bent along the arc.
    """
    keep = math.sqrt(1.0 - width * width)
    sr2, v = R[0, 0], R[1, 1] + Pr[2, 2]
    bx, by = Pr[0, 2] / v, Pr[1, 2] / v
    cxx, cxy, cyy = Pr[0, 0] - bx * Pr[0, 2], Pr[0, 1] - bx * Pr[1, 2], Pr[1, 1] - by * Pr[1, 2]
    sr, sv = math.sqrt(sr2), math.sqrt(v)
    for k in range(offsets.shape[0]):
        r = max(z[0] + keep * sr * offsets[k, 0], 1e-3 * z[0])
        turn = keep * sv * offsets[k, 1]
        angle = pose[2] + z[1] + turn
        c, s = math.cos(angle), math.sin(angle)
        mean, along, across = mucm_local(r, width * sr, width * sv)
        xx, xy, yy = rotated(c, s, along, across)
        gx, gy = bx * width * width * v, by * width * width * v
        xx += cxx + bx * gx - 2.0 * gx * s * r
        yy += cyy + by * gy + 2.0 * gy * c * r
        xy += cxy + bx * gy + (gx * c - gy * s) * r
        det = xx * yy - xy * xy
        out[k, 0] = pose[0] + mean * c + bx * turn
        out[k, 1] = pose[1] + mean * s + by * turn
        out[k, 2], out[k, 3], out[k, 4] = yy / det, -xy / det, xx / det
        # Density over x and y from one over range and bearing: a factor r makes it a likelihood again.
        out[k, 5] = math.log(r) - 0.5 * math.log(det)


@numba.njit(cache=True)
def sampled_log_likelihood(states, samples, scratch, out):  # type: ignore[no-untyped-def]
    """Log of the sum over the samples of their Gaussians, at each particle; scratch (Ns,)."""
    count = samples.shape[0]
    for n in range(states.shape[0]):
        x, y = states[n, 0], states[n, 1]
        best = -math.inf
        for k in range(count):
            ex, ey = x - samples[k, 0], y - samples[k, 1]
            value = samples[k, 5] - 0.5 * (
                ex * ex * samples[k, 2] + 2.0 * ex * ey * samples[k, 3] + ey * ey * samples[k, 4]
            )
            scratch[k] = value
            best = max(best, value)
        total = 0.0
        for k in range(count):
            total += math.exp(scratch[k] - best)
        out[n] = best + math.log(total)
