"""Prediction, gating and correction of anchors: compiled loops over leaves (section 2.5.2).

`motion` (C + 1, 6) has one row per class and the default last: 1 for constant velocity, root of the acceleration
density q, rate of being carried (1/s), standard deviation of a first velocity (m/s), share that keeps to a
predicted path, diffusion of the heading (rad/s^0.5).
"""

from __future__ import annotations

import numba
import numpy as np
from numba import literal_unroll

from world_model.anchoring.loops.leaves import AWAY, MOVING, NONE, REST
from world_model.anchoring.loops.walking import flow, walk

CARRY_SECONDS = 2.0  # an object in somebody's hand is put down after this long, on average
VANISH_SECONDS = 5.0  # and is taken out of sight after this long
UNMODELLED = (
    0.02  # that a settled object is where it was, although it was not seen there: for unknown reasons
)
HAND = 0.1  # m: put down this near, what was taken may as well have stayed
NEARBY = 0.5  # m: and what was followed is known this well where it was put down
SETTLED_HITS = 3
MEMORY = 100.0  # detections after which a resting object's position forgets: their errors are not independent
LATE = 0.5  # share of the last detection in how far a mover was from where it was expected lately
STRAINED = 8.0  # mean squared Mahalanobis distance, 2 or 3 expected, from which it must have turned
TURNS = 0.01  # probability of that at any look
UNSEEN = 0.1  # s: who was not seen for longer may be anywhere near
ATTRIBUTE_FLOOR = 1e-4
SAME = 1e-9  # Between two probabilities of which neither is the larger


@numba.njit(cache=True)
def inverse_3x3(m, out):  # type: ignore[no-untyped-def]
    """Inverse of a symmetric matrix into `out`; returns the determinant."""
    a, b, c = m[0, 0], m[0, 1], m[0, 2]
    d, e, f = m[1, 1], m[1, 2], m[2, 2]
    c00, c01, c02 = d * f - e * e, c * e - b * f, b * e - c * d
    determinant = a * c00 + b * c01 + c * c02
    scale = 1.0 / determinant
    out[0, 0], out[0, 1], out[0, 2] = c00 * scale, c01 * scale, c02 * scale
    out[1, 0], out[1, 1], out[1, 2] = c01 * scale, (a * f - c * c) * scale, (b * c - a * e) * scale
    out[2, 0], out[2, 1], out[2, 2] = c02 * scale, (b * c - a * e) * scale, (a * d - b * b) * scale
    return determinant


@numba.njit(cache=True)
def class_of(attributes, classes):  # type: ignore[no-untyped-def]
    """Row of `motion` for the attributes (A,) of a leaf: its most probable class, the default where there is none."""
    best, at = 0.0, classes
    for k in range(classes):
        if attributes[k] > best + SAME:
            best, at = attributes[k], k
        elif attributes[k] > best - SAME:
            at = classes
    return at


@numba.njit(cache=True)
def start_moving(leaves, i, speed, dt):  # type: ignore[no-untyped-def]
    """The moving filter of a leaf from where it rests: it began to move within dt at about `speed`."""
    P = leaves.moving_cov[i]
    P[:, :] = 0.0
    for a in range(3):
        leaves.moving[i, a] = leaves.rest[i, a]
        leaves.moving[i, a + 3] = 0.0
        for b in range(3):
            P[a, b] = leaves.rest_cov[i, a, b]
        P[a, a] += (speed * dt) ** 2
        P[a, a + 3] = speed * speed * dt
        P[a + 3, a] = P[a, a + 3]
        P[a + 3, a + 3] = speed * speed


@numba.njit(cache=True)
def predict(leaves, i, stamp, motion, removed):  # type: ignore[no-untyped-def]
    """Propagate a leaf to `stamp` with its behaviour models and the transitions between them, in place."""
    dt = stamp - leaves.stamp[i]
    if dt <= 0.0:
        return
    leaves.stamp[i] = stamp
    row = class_of(leaves.attributes[i], motion.shape[0] - 1)
    q, carried, speed = motion[row, 1] ** 2, motion[row, 2], motion[row, 3]
    # Turns without notice are of what moves by itself, where turning is no part of its motion anyway.
    walks = motion[row, 0] > 0.5 and motion[row, 5] <= 0.0
    leaves.strain[i] = max(leaves.strain[i], 0.0) if walks else -1.0
    pi = leaves.behavior[i]
    gone = 1.0 - np.exp(-removed * dt)
    if motion[row, 0] > 0.5:
        if pi[REST] > 0.0:
            if pi[REST] >= pi[MOVING]:
                start_moving(leaves, i, speed, 0.0)
                for a in range(3):
                    leaves.moving[i, a + 3] = leaves.led[i, a]
            pi[MOVING] += pi[REST]
            pi[REST] = 0.0
        walk(leaves, i, dt, q, motion[row, 5])
        off = (1.0 - np.exp(-carried * dt)) * pi[MOVING]
        pi[MOVING] -= off
        pi[AWAY] += off
    else:
        begun = (1.0 - np.exp(-carried * dt)) * pi[REST]
        settled = (1.0 - np.exp(-dt / CARRY_SECONDS)) * pi[MOVING]
        vanished = (1.0 - np.exp(-dt / VANISH_SECONDS)) * (pi[MOVING] - settled)
        # Of what was taken since the last look only the latest may still be in somebody's hand.
        held = 0.5 * begun * CARRY_SECONDS / dt * (1.0 - np.exp(-dt / CARRY_SECONDS))
        here = settled
        if pi[MOVING] > 1e-3 * pi[REST]:
            flow(leaves.moving[i], leaves.moving_cov[i], dt, q)
            rest, moving = leaves.rest[i], leaves.moving[i]
            stayed = pi[REST] - begun
            likely = pi[MOVING] < stayed
            if not put_down(rest, leaves.rest_cov[i], moving, leaves.moving_cov[i], likely, stayed, settled):
                here = 0.0
        else:
            start_moving(leaves, i, speed, min(dt, CARRY_SECONDS))
        pi[REST] += here - begun
        pi[MOVING] += held - settled - vanished
        pi[AWAY] += begun - held + vanished + settled - here
    leaves.led[i] = 0.0
    for m in range(3):
        pi[NONE] += gone * pi[m]
        pi[m] -= gone * pi[m]


@numba.njit(cache=True)
def put_down(rest, P, moving, Q, likely, stayed, settled):  # type: ignore[no-untyped-def]
    """Mix what was put down into the resting filter, matching moments; whether that was possible.

    rest (3,), P (3, 3), moving (6,), Q (6, 6) : the two filters; `likely` where it more probably stayed.

    What may have been put down far from where it rested, or nobody knows where, is not: the mixture would blur a place
    that is known well.
    """
    total = stayed + settled
    if total <= 0.0 or settled <= 1e-9 * total:
        return True
    share = settled / total
    around = 0.0
    for a in range(3):
        around += Q[a, a] / 3.0
        if likely:
            around += (moving[a] - rest[a]) ** 2
    if around > (HAND if likely else NEARBY) ** 2:
        return False
    for a in range(3):
        for b in range(3):
            gap = (moving[a] - rest[a]) * (moving[b] - rest[b])
            P[a, b] = (1.0 - share) * P[a, b] + share * Q[a, b] + share * (1.0 - share) * gap
    for a in range(3):
        rest[a] += share * (moving[a] - rest[a])
    return True


@numba.njit(cache=True)
def visible_probability(before, dt, visible, persistence, rate):  # type: ignore[no-untyped-def]
    """Probability that the object is not in a run of misses at a look `dt` after its last, (2.10).

    before : the same at its last look. A chain with two states, `visible` in the long run; `persistence` is its
    eigenvalue per look.
    """
    frames = max(1.0, dt * rate)
    fade = persistence**frames if persistence > 0.0 else 0.0
    return max(visible + (before - visible) * fade, 0.02 * visible)


@numba.njit(cache=True)
def log_gauss(dx, dy, dz, S, inverse):  # type: ignore[no-untyped-def]
    determinant = inverse_3x3(S, inverse)
    if determinant <= 0.0:
        return -np.inf
    d2 = (
        inverse[0, 0] * dx * dx
        + inverse[1, 1] * dy * dy
        + inverse[2, 2] * dz * dz
        + 2.0 * (inverse[0, 1] * dx * dy + inverse[0, 2] * dx * dz + inverse[1, 2] * dy * dz)
    )
    return -0.5 * (d2 + np.log(determinant) + 3.0 * np.log(2.0 * np.pi))


@numba.njit(cache=True)
def innovation(P, R, lag, S):  # type: ignore[no-untyped-def]
    """Covariance of a measured position `lag` seconds ago; P is (3, 3) or (6, 6)."""
    for a in range(3):
        for b in range(3):
            S[a, b] = P[a, b] + R[a, b]
            if P.shape[0] == 6:
                S[a, b] += lag * lag * P[a + 3, b + 3] - lag * (P[a, b + 3] + P[a + 3, b])


@numba.njit(cache=True)
def inflate_rest(P, R):  # type: ignore[no-untyped-def]
    """Keep the resting filter, P (3, 3), from believing that more than `MEMORY` detections were independent."""
    have = P[0, 0] + P[1, 1] + P[2, 2]
    least = (R[0, 0] + R[1, 1] + R[2, 2]) / MEMORY
    if have < least:
        for a in range(3):
            P[a, a] += (least - have) / 3.0


@numba.njit(cache=True)
def widen(x, P, since, S):  # type: ignore[no-untyped-def]
    """Add to a covariance (3, 3) where a mover may be that turned since it was last seen, `since` seconds ago."""
    unseen = 2.0 * min(max(since, 0.0), UNSEEN)
    square = 0.0
    for a in range(3):
        square += x[a + 3] ** 2
    for a in range(3):
        # What does not move in a direction does not turn there.
        if P[a + 3, a + 3] + x[a + 3] ** 2 > 1e-3 * square:
            S[a, a] += unseen * unseen * square


@numba.njit(cache=True)
def log_likelihoods(leaves, i, z, R, lag, out, S, inverse):  # type: ignore[no-untyped-def]
    """Log densities of a measured position under rest and moving, into `out` (2,): (2.7)."""
    out[0] = -np.inf
    out[1] = -np.inf
    if leaves.behavior[i, REST] > 0.0:
        x, v = leaves.rest[i], leaves.led[i]
        innovation(leaves.rest_cov[i], R, lag, S)
        out[0] = log_gauss(
            z[0] - x[0] + lag * v[0], z[1] - x[1] + lag * v[1], z[2] - x[2] + lag * v[2], S, inverse
        )
    if leaves.behavior[i, MOVING] > 0.0:
        y = leaves.moving[i]
        innovation(leaves.moving_cov[i], R, lag, S)
        dx, dy, dz = z[0] - y[0] + lag * y[3], z[1] - y[1] + lag * y[4], z[2] - y[2] + lag * y[5]
        out[1] = log_gauss(dx, dy, dz, S, inverse)
        if leaves.hits[i] >= SETTLED_HITS and leaves.together[i] == 0 and leaves.strain[i] >= 0.0:
            widen(y, leaves.moving_cov[i], leaves.stamp[i] - leaves.last[i], S)
            wide = log_gauss(dx, dy, dz, S, inverse) + np.log(TURNS)
            if wide > out[1]:
                out[1] = wide


@numba.njit(cache=True)
def attribute_factor(attributes, likelihood, blocks):  # type: ignore[no-untyped-def]
    """How much better a leaf with attributes (A,) explains the measured attributes than an unknown object does."""
    factor = 1.0
    for k in range(blocks.shape[0]):
        if blocks[k, 0] == blocks[k, 1]:
            continue
        total = 0.0
        for c in range(blocks[k, 0], blocks[k, 1]):
            total += attributes[c] * likelihood[c]
        factor *= total
    return factor


@numba.njit(cache=True)
def copy_leaf(leaves, source, target):  # type: ignore[no-untyped-def]
    for array in literal_unroll(leaves):
        _copy_row(array, source, target)
    leaves.said[target] = -1


@numba.njit(cache=True)
def _copy_row(array, source, target):  # type: ignore[no-untyped-def]
    if array.ndim == 1:
        array[target] = array[source]
    elif array.ndim == 2:
        for a in range(array.shape[1]):
            array[target, a] = array[source, a]
    else:
        for a in range(array.shape[1]):
            for b in range(array.shape[2]):
                array[target, a, b] = array[source, a, b]


@numba.njit(cache=True)
def learn_attributes(attributes, likelihood, blocks):  # type: ignore[no-untyped-def]
    """Bayes' rule for every discrete attribute (A,), in place; nothing becomes impossible."""
    for k in range(blocks.shape[0]):
        total = 0.0
        for c in range(blocks[k, 0], blocks[k, 1]):
            attributes[c] *= likelihood[c]
            total += attributes[c]
        if total <= 0.0:
            continue
        size = blocks[k, 1] - blocks[k, 0]
        for c in range(blocks[k, 0], blocks[k, 1]):
            kept = attributes[c] / total
            attributes[c] = (kept + ATTRIBUTE_FLOOR / size) / (1.0 + ATTRIBUTE_FLOOR)


@numba.njit(cache=True)
def correct(leaves, i, z, R, lag, likelihood, blocks, stamp):  # type: ignore[no-untyped-def]
    """Correct a leaf (already predicted) with its detection, in place."""
    out, S, inverse, off = np.empty(2), np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    inflate_rest(leaves.rest_cov[i], R)
    log_likelihoods(leaves, i, z, R, lag, out, S, inverse)
    pi = leaves.behavior[i]
    top = max(out[0], out[1])
    a = pi[REST] * np.exp(out[0] - top) if pi[REST] > 0.0 else 0.0
    b = pi[MOVING] * np.exp(out[1] - top) if pi[MOVING] > 0.0 else 0.0
    if not a + b > 0.0:
        a, b = pi[REST], pi[MOVING]
    if pi[REST] > 0.0:
        for k in range(3):
            off[k] = z[k] + lag * leaves.led[i, k] - leaves.rest[i, k]
        _update(leaves.rest[i], leaves.rest_cov[i], off, R, 0.0)
    if pi[MOVING] > 0.0:
        moves = pi[MOVING] > pi[REST] and leaves.hits[i] >= SETTLED_HITS and lag <= 0.0
        if moves and leaves.together[i] == 0 and leaves.strain[i] >= 0.0:
            innovation(leaves.moving_cov[i], R, lag, S)
            inverse_3x3(S, inverse)
            for k in range(3):
                off[k] = z[k] - leaves.moving[i, k]
            leaves.strain[i] += LATE * (off @ inverse @ off - leaves.strain[i])
            if leaves.strain[i] > STRAINED:
                turned(leaves.moving[i], leaves.moving_cov[i], leaves.stamp[i] - leaves.last[i])
                leaves.strain[i] = 0.0
        for k in range(3):
            off[k] = z[k] - leaves.moving[i, k] + lag * leaves.moving[i, k + 3]
        _update(leaves.moving[i], leaves.moving_cov[i], off, R, lag)
    pi[REST], pi[MOVING], pi[AWAY], pi[NONE] = a / (a + b), b / (a + b), 0.0, 0.0
    leaves.visible[i] = 1.0
    leaves.last[i] = max(stamp, leaves.last[i])
    leaves.hits[i] += 1
    leaves.missed[i] = 0.0
    leaves.together[i] = 0
    learn_attributes(leaves.attributes[i], likelihood, blocks)


@numba.njit(cache=True)
def _update(x, P, off, R, lag):  # type: ignore[no-untyped-def]
    """Kalman update, in place, of a filter (3,) or (6,) with a position `lag` seconds ago, measured `off` (3,) from
    where it was; H = [I, -lag I]."""
    S, inverse, PH = np.empty((3, 3)), np.empty((3, 3)), P[:, :3].copy()
    innovation(P, R, lag, S)
    inverse_3x3(S, inverse)
    if x.size == 6:
        PH -= lag * P[:, 3:]
    gain = PH @ inverse
    x += gain @ off
    P -= gain @ PH.T
    for a in range(x.size):
        for b in range(a):
            P[a, b] = P[b, a] = 0.5 * (P[a, b] + P[b, a])


@numba.njit(cache=True)
def turned(x, P, since):  # type: ignore[no-untyped-def]
    """A mover went otherwise than expected accelerations explain, as at a wall: since it was last seen, `since` seconds
    ago, its speed is about what it was, in whatever direction."""
    unseen = 2.0 * min(max(since, 0.0), UNSEEN)
    square = x[3] ** 2 + x[4] ** 2 + x[5] ** 2
    for a in range(3):
        if P[a + 3, a + 3] + x[a + 3] ** 2 > 1e-3 * square:
            P[a, a] += unseen * unseen * square
            P[a, a + 3] += unseen * square
            P[a + 3, a] = P[a, a + 3]
            P[a + 3, a + 3] += square


@numba.njit(cache=True)
def miss(leaves, i, detectable, clear):  # type: ignore[no-untyped-def]
    """Correct a leaf with not being detected, in place; `detectable` is the probability that it would have been.

    What has settled keeps a little probability: it may have been there, unseen for reasons that no model has.
    """
    if detectable <= 0.0:
        return
    pi = leaves.behavior[i]
    before = pi[REST]
    pi[REST] *= 1.0 - detectable
    pi[MOVING] *= 1.0 - detectable
    if leaves.hits[i] >= SETTLED_HITS:
        pi[REST] = max(pi[REST], min(UNMODELLED, before))
    total = pi[REST] + pi[MOVING] + pi[AWAY] + pi[NONE]
    for m in range(4):
        pi[m] /= total
    leaves.visible[i] = max(leaves.visible[i] - detectable, 0.0) / max(1.0 - detectable, 1e-12)
    leaves.missed[i] += clear


@numba.njit(cache=True)
def create(leaves, i, track, j, seen, classes):  # type: ignore[no-untyped-def]
    """A leaf for an object first seen now, with detection j of `look.Detections`."""
    motion, stamp, existence = classes.motion, seen.stamp - seen.lag, seen.existence[j]
    leaves.track[i] = track
    for a in range(3):
        leaves.rest[i, a] = seen.positions[j, a]
        for b in range(3):
            leaves.rest_cov[i, a, b] = seen.covariances[j, a, b]
    leaves.led[i] = 0.0
    for c in range(classes.prior.size):
        leaves.attributes[i, c] = classes.prior[c]
    learn_attributes(leaves.attributes[i], seen.likelihood[j], classes.blocks)
    row = class_of(leaves.attributes[i], motion.shape[0] - 1)
    start_moving(leaves, i, motion[row, 3], 0.0)
    leaves.behavior[i] = 0.0
    leaves.behavior[i, MOVING if motion[row, 0] > 0.5 else REST] = existence
    leaves.behavior[i, NONE] = 1.0 - existence
    leaves.variances[i] = -1.0
    leaves.said[i] = seen.indices[j]
    leaves.visible[i] = 1.0
    leaves.stamp[i] = stamp
    leaves.last[i] = stamp
    leaves.first[i] = stamp
    leaves.hits[i] = 1
    leaves.together[i] = 0
    leaves.strain[i] = 0.0
    leaves.missed[i] = 0.0


@numba.njit(cache=True)
def clearance(position, sensor, planar):  # type: ignore[no-untyped-def]
    """How far inside the field of view a position is, m; negative outside.

    sensor (8,) : x, y, z, yaw, range_min, range_max, half opening, half opening in height (0: any).
    """
    dx, dy, dz = position[0] - sensor[0], position[1] - sensor[1], position[2] - sensor[2]
    level = np.sqrt(dx * dx + dy * dy)
    distance = level if planar else np.sqrt(level * level + dz * dz)
    inside = sensor[5] - distance
    if sensor[4] > 0.0:
        inside = min(inside, distance - sensor[4])
    if sensor[6] < np.pi - 1e-3:
        bearing = np.arctan2(dy, dx) - sensor[3]
        bearing = abs(bearing - 2.0 * np.pi * np.round(bearing / (2.0 * np.pi)))
        # Beyond a right angle off the edge the sensor itself is what is nearest.
        inside = min(inside, level * np.sin(min(max(sensor[6] - bearing, -0.5 * np.pi), 0.5 * np.pi)))
    if sensor[7] > 0.0:
        elevation = abs(np.arctan2(dz, level))
        inside = min(inside, distance * np.sin(max(sensor[7] - elevation, -0.5 * np.pi)))
    return inside
