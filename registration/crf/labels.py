"""Labels of the points of a scan under given motions, and the estimate per beam that they amount to."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.sight import AGREES, UNSEEN
from registration.crf.beams import moved, nearest_point, nearness, per_beam, point_there, seen, shifted
from registration.crf.estimate import JointEstimate
from registration.crf.setup import Start
from registration.result import UNKNOWN

LEAST_MEMBERS = 3  # points of an object
NEAR = 0.6  # of the distance between two beams on a surface, within which the nearest sees the same spot
TURN_SIGMA = 0.12  # radians a thing may be expected to turn, where its points say nothing


def groups_as_labels(begun: Start) -> NDArray[np.int64]:
    """(n,) cluster of each point by the groups alone: 0 agrees with the background, -1 neither.

    Objects with a motion come first, in the order of `begun.found`, then those that are gone.
    """
    labels = np.where(begun.sight == AGREES, 0, -1)
    for number, group in enumerate([*begun.found, *begun.gone], start=1):
        taken = group.members & (labels <= 0)
        labels[taken] = number
    return labels


def estimate_of(begun: Start, labels: NDArray[np.int64], probability: FloatArray) -> JointEstimate:
    """The estimate in which points of scan a are in the clusters `labels` (n,), see `groups_as_labels`.

    Clusters beyond the groups have no motion. Those of less than `LEAST_MEMBERS` points are dropped. The partner of a
    point is the beam of scan b nearest to where its cluster's motion takes it.
    probability : (n,) that each point moves.
    """
    a, b = begun.a, begun.b
    motions, covariances = [begun.registration.transform], [begun.registration.covariance]
    partners = np.full(len(a), -1, dtype=np.int64)
    grain = nearness(a, begun.noise) + 0.5 * a.spacing
    # Between two surfaces, at edges and flanks, a point may have its partner although b does not see it agree.
    _associate(begun, (labels == 0) | ((labels < 0) & (begun.sight == UNSEEN)), motions[0], partners)
    clusters = np.where(partners >= 0, 0, -1)
    for number in range(1, int(labels.max(initial=0)) + 1):
        members = labels == number
        if members.sum() < LEAST_MEMBERS:
            clusters[members] = -1
            continue
        clusters[members] = len(motions)
        if number <= len(begun.found):
            motion = begun.found[number - 1].motion
            _associate(begun, members, motion, partners)
            motions.append(motion)
            covariances.append(_covariance(a.points[members], grain[members], motion))
        else:
            motions.append(motions[0])
            covariances.append(UNKNOWN)
    associations, labels, probabilities = per_beam(a, b, partners, clusters, probability)
    score = _log_score(clusters > 0, probability)
    return JointEstimate(
        associations, labels, np.array(motions), score, np.array(covariances), probabilities
    )  # fmt: skip


def _log_score(moving: NDArray[np.bool_], probability: FloatArray) -> float:
    """Log probability of labels (n,), those of which nothing is known left out."""
    own = np.where(moving, probability, 1.0 - probability)
    return float(np.log(np.maximum(own[np.isfinite(own)], 1e-9)).sum())


def confirmed(begun: Start, members: NDArray[np.bool_], known: JointEstimate) -> JointEstimate:
    """The estimate where only what is `known` to move left its place, `members` (n,): one cluster of unknown motion."""
    labels = np.where(members, 1, np.where(begun.sight == AGREES, 0, -1))
    before = known.probabilities[begun.a.beams]
    return estimate_of(begun, labels, np.where(members, before, np.where(labels == 0, 0.0, np.nan)))


def _associate(
    begun: Start,
    members: NDArray[np.bool_],
    motion: FloatArray,
    partners: NDArray[np.int64],
) -> None:
    """Write which point of b each member (n,) is under `motion`."""
    b = begun.b
    noise = nearness(b, begun.noise)
    same, near = np.maximum(b.gaps, noise), np.maximum(NEAR * b.gaps, noise)
    _partners(begun.a.points, members, motion, b.points, seen(b), same, near, partners)


@njit(cache=True)
def _partners(points, members, motion, others, there, same, near, partners):  # type: ignore[no-untyped-def]
    """Write which of `others` (m, 2) each member (n,) is.

    That which the beam saw that looks there, if it is the same surface, less than `same` (m,) metres off: noise along a
    beam then changes nothing. Else the nearest, if that is less than `near` (m,) metres off.
    """
    moved_there = shifted(points, motion)
    reach = near.max() if len(near) else 0.0
    for i in range(len(points)):
        if not members[i]:
            continue
        x, y = moved_there[i]
        found, _ = point_there(x, y, there)
        if found < 0 or not math.hypot(x - others[found, 0], y - others[found, 1]) < same[found]:
            found, away = nearest_point(x, y, reach, there)
            if found >= 0 and not away < near[found]:
                found = -1
        partners[i] = found


def _covariance(points: FloatArray, grain: FloatArray, motion: FloatArray) -> FloatArray:
    """(3, 3) of a motion of x, y, yaw by least squares, from the weights of its points."""
    x, y = (moved(points, motion) - motion[:2]).T
    weights = 1.0 / grain**2
    total, wx, wy = weights.sum(), weights @ x, weights @ y
    information = np.array([[total, 0.0, -wy], [0.0, total, wx], [-wy, wx, weights @ (x**2 + y**2)]])
    information[2, 2] += 1.0 / TURN_SIGMA**2
    covariance = np.linalg.inv(information + 1e-6 * np.eye(3))
    return np.asarray(0.5 * (covariance + covariance.T))
