"""Which anchors a look concerns, and how well each detection fits each: compiled loops over leaves (section 2.5.2)."""

from __future__ import annotations

import numba
import numpy as np

from world_model.anchoring.loops.kernels import (
    SETTLED_HITS,
    attribute_factor,
    class_of,
    clearance,
    log_likelihoods,
    predict,
    visible_probability,
)
from world_model.anchoring.loops.leaves import MOVING, REST

RECENT = 0.5  # s: a sensor does not move far in this time
OUT_OF_GATE = -60.0  # log density below which a detection is of something else
OUTSIDE = 2.5  # standard deviations outside of the stated view from which on a detection contradicts it
BESIDE = 3.0  # standard deviations within which it does so


@numba.njit(cache=True)
def _inside(position, sensor):  # type: ignore[no-untyped-def]
    """How far inside the field of view a position is, level or not, m."""
    return min(clearance(position, sensor, np.bool_(False)), clearance(position, sensor, np.bool_(True)))


@numba.njit(cache=True)
def _square(a, b):  # type: ignore[no-untyped-def]
    """Squared distance of two positions, m²."""
    return (a[0] - b[0]) ** 2 + (a[1] - b[1]) ** 2 + (a[2] - b[2]) ** 2


@numba.njit(cache=True)
def touch(leaves, active, seen, spread, sensor, known, silent, motion):  # type: ignore[no-untyped-def]
    """Leaves that a look concerns: in view, near a detection, or of movers.

    active (N,) rows in use; spread (M,) largest standard deviation of each detection, m; sensor as in
    `clearance`, used where `known`; `silent` where absence means nothing. A look made some time ago says nothing
    about the absence of what has been seen since, nor of what moves. Beside a detection that lies outside of the
    stated view the sensor sees nevertheless. Returns their rows (n,), and the probability (n,) that being there would
    have meant being in view.
    """
    stamp, lag, positions = seen.stamp, seen.lag, seen.positions
    chosen, clear, count = np.empty(active.size, np.int64), np.empty(active.size), 0
    wider, x = sensor.copy(), np.empty(3)
    beyond = np.zeros(positions.shape[0], np.bool_)
    if known and not silent:
        for j in range(positions.shape[0]):
            beyond[j] = _inside(positions[j], sensor) < -OUTSIDE * spread[j]
    for k in range(active.size):
        i = active[k]
        pi = leaves.behavior[i]
        dt = stamp - leaves.stamp[i]
        row = class_of(leaves.attributes[i], motion.shape[0] - 1)
        moves = motion[row, 0] > 0.5
        moving = pi[MOVING] > pi[REST]
        variance = 0.0
        for a in range(3):
            x[a] = leaves.moving[i, a] + dt * leaves.moving[i, a + 3] if moving else leaves.rest[i, a]
            if moving:
                P = leaves.moving_cov[i]
                v = P[a, a] + 2.0 * dt * abs(P[a, a + 3]) + dt * dt * P[a + 3, a + 3]
                w = leaves.moving[i]
                square = w[3] ** 2 + w[4] ** 2 + P[3, 3] + P[4, 4]
                v += (motion[row, 1] ** 2 + motion[row, 5] ** 2 * square) * dt**3 / 3.0
            else:
                v = leaves.rest_cov[i, a, a]
            variance = max(variance, v)
        sigma = np.sqrt(variance)
        view = 0.0
        if not silent and (lag <= 0.0 or not (moving or leaves.last[i] > stamp - lag)):
            view = 1.0
            if known:
                # What has settled must be surely inside: a wrong look would be repeated.
                margin = 3.0 if leaves.hits[i] >= SETTLED_HITS else 1.5
                # Of what was seen just now it is known that the sensor reaches so far.
                wider[5] = sensor[5]
                if leaves.hits[i] < SETTLED_HITS and stamp - leaves.last[i] < RECENT:
                    wider[5] += margin * sigma + 0.06
                view = min(max((_inside(x, wider) - margin * sigma - 0.01) / 0.05, 0.0), 1.0)
                for j in range(positions.shape[0]):
                    limit = BESIDE * (sigma + spread[j])
                    if beyond[j] and _square(x, positions[j]) < limit * limit:
                        view = 1.0
        # What may begin to move while it is looked for is found a little farther away.
        reach = 6.0 * sigma + (0.0 if moves else motion[row, 3] * min(dt, 0.5) * 3.0)
        near = False
        for j in range(positions.shape[0]):
            limit = reach + 6.0 * spread[j]
            if _square(x, positions[j]) < limit * limit:
                near = True
                break
        if near or view > 0.0 or moves:
            chosen[count] = i
            clear[count] = view
            count += 1
    return chosen[:count], clear[:count]


@numba.njit(cache=True)
def _bounds(covariances):  # type: ignore[no-untyped-def]
    """Of each detection: the highest log density it can have, and the trace of its covariance."""
    count = covariances.shape[0]
    sharpest, spread = np.empty(count), np.empty(count)
    for j in range(count):
        R = covariances[j]
        det = (
            R[0, 0] * (R[1, 1] * R[2, 2] - R[1, 2] * R[2, 1])
            - R[0, 1] * (R[1, 0] * R[2, 2] - R[1, 2] * R[2, 0])
            + R[0, 2] * (R[1, 0] * R[2, 1] - R[1, 1] * R[2, 0])
        )
        sharpest[j] = np.inf if det <= 0.0 else -0.5 * np.log(det) - 1.5 * np.log(2.0 * np.pi)
        spread[j] = R[0, 0] + R[1, 1] + R[2, 2]
    return sharpest, spread


@numba.njit(cache=True)
def _near(leaves, i, positions, sharpest, spread, near):  # type: ignore[no-untyped-def]
    """Which detections are not out of the gate by bounds alone, into `near` (M,): no eigenvalue of S exceeds its trace,
    and det S >= det R."""
    near[:] = False
    for m in (REST, MOVING):
        if leaves.behavior[i, m] <= 0.0:
            continue
        x = leaves.rest[i] if m == REST else leaves.moving[i, :3]
        P = leaves.rest_cov[i] if m == REST else leaves.moving_cov[i]
        x0, x1, x2, trace = x[0], x[1], x[2], P[0, 0] + P[1, 1] + P[2, 2]
        for j in range(near.size):
            dx, dy, dz = positions[j, 0] - x0, positions[j, 1] - x1, positions[j, 2] - x2
            square = dx * dx + dy * dy + dz * dz
            if sharpest[j] - 0.5 * square / (trace + spread[j]) >= OUT_OF_GATE:
                near[j] = True


@numba.njit(cache=True)
def weigh(leaves, chosen, clear, seen, classes, detector):  # type: ignore[no-untyped-def]
    """Predict the touched leaves and weigh being missed and being each detection: (2.7), (2.8), (2.10).

    detector (2, 5) : as `detector_table` makes it. Returns log weights (n, M), -inf where a detection is out of the
    gate, and (n, 2) log weight and probability of a detection that did not come. Predicts in place.
    """
    positions, covariances, motion = seen.positions, seen.covariances, classes.motion
    stamp, lag = seen.stamp, seen.lag
    out, S, inverse = np.empty(2), np.empty((3, 3)), np.empty((3, 3))
    sharpest, spread = _bounds(covariances)
    near = np.ones(positions.shape[0], np.bool_)
    matrix, missing = np.full((chosen.size, near.size), -np.inf), np.empty((chosen.size, 2))
    for k in range(chosen.size):
        i = chosen[k]
        dt = stamp - leaves.stamp[i]
        runs = detector[int(motion[class_of(leaves.attributes[i], motion.shape[0] - 1), 0] > 0.5)]
        visible = visible_probability(leaves.visible[i], dt, runs[0], runs[2], runs[3])
        detected = visible * runs[1]
        predict(leaves, i, stamp, motion, runs[4])
        leaves.visible[i] = visible
        pi = leaves.behavior[i]
        here = pi[REST] + pi[MOVING]
        detectable = detected * clear[k]
        missing[k, 0] = np.log(max(1.0 - here * detectable, 1e-12))
        missing[k, 1] = detectable
        # A detection at the edge of the field of view is no contradiction.
        found = np.log(detected)
        if lag == 0.0:
            _near(leaves, i, positions, sharpest, spread, near)
        for j in range(positions.shape[0]):
            if not near[j]:
                continue
            log_likelihoods(leaves, i, positions[j], covariances[j], lag, out, S, inverse)
            top = max(out[0], out[1])
            if top < OUT_OF_GATE or here <= 0.0:
                continue
            weight = pi[REST] * np.exp(out[0] - top) + pi[MOVING] * np.exp(out[1] - top)
            factor = attribute_factor(leaves.attributes[i], seen.likelihood[j], classes.blocks)
            if weight > 0.0 and factor > 0.0:
                matrix[k, j] = found + top + np.log(weight * factor)
    return matrix, missing
