"""From states to the answer: vacuous clusters dropped, what left without a partner added, motions refined."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from registration.crf.beams import AGREES, FREE
from registration.crf.estimate import UNKNOWN, JointEstimate
from registration.crf.inference import Labelling
from registration.crf.potentials import Problem
from registration.crf.setup import Start
from registration.motion import Array

LEAST_MEMBERS = 3
CLOSE = 0.3  # metres to an object within which what left its place is part of it


def finish(begun: Start, problem: Problem, labelling: Labelling) -> JointEstimate:
    """The estimate a labelling amounts to."""
    a = begun.a
    n, most = problem.states.shape
    outlier = len(problem.motions)
    i = np.arange(n)
    joined = np.where(labelling.associations < most, labelling.associations, 0)
    partners = np.where(labelling.associations < most, problem.states[i, joined], -1)
    clusters = np.where(labelling.clusters < outlier, labelling.clusters, -1)
    partners[clusters < 0] = -1
    clusters[(partners < 0)] = -1
    kept = [d for d in range(1, outlier) if np.sum(clusters == d) >= LEAST_MEMBERS]
    numbers = np.full(outlier + 1, -1)
    numbers[0] = 0
    for number, d in enumerate(kept, start=1):
        numbers[d] = number
    partners[(clusters > 0) & (numbers[clusters] < 0)] = -1
    clusters = np.where(clusters >= 0, numbers[clusters], -1)
    motions, covariances = [problem.motions[0]], [begun.registration.covariance]
    for number, d in enumerate(kept, start=1):
        motions.append(problem.motions[d])
        covariances.append(
            _covariance(a.points[clusters == number], problem.grain[clusters == number], problem.motions[d])
        )
    _add_members(problem.starts[:, kept], clusters)
    _add_parts(begun, clusters)
    for group in begun.gone:
        rest = group.members & (clusters < 0)
        if rest.sum() >= LEAST_MEMBERS:
            clusters[rest] = len(motions)
            motions.append(problem.motions[0])
            covariances.append(UNKNOWN)
    probability = _moving_probability(labelling.beliefs, outlier)
    probability[clusters > 0] = np.maximum(probability[clusters > 0], 0.5)
    return _per_beam(
        begun, partners, clusters, np.array(motions), np.array(covariances), probability, labelling.score
    )


def standing(begun: Start) -> JointEstimate:
    """The estimate where nothing left its place: what agrees is background, and nothing is known of the rest."""
    count = len(begun.a.ranges)
    labels, probabilities = np.full(count, -1, dtype=np.int64), np.full(count, np.nan)
    labels[begun.a.beams] = np.where(begun.sight == AGREES, 0, -1)
    probabilities[begun.a.beams] = np.where(begun.sight == AGREES, 0.0, np.nan)
    registration = begun.registration
    return JointEstimate(
        np.full(count, -1, dtype=np.int64),
        labels,
        registration.transform[None].copy(),
        0.0,
        registration.covariance[None].copy(),
        probabilities,
    )


def confirmed(begun: Start, members: NDArray[np.bool_], known: JointEstimate) -> JointEstimate:
    """The estimate where only what is `known` to move left its place, `members` (n,): one cluster of unknown motion."""
    estimate = standing(begun)
    beams = begun.a.beams[members]
    if not len(beams):
        return estimate
    estimate.clusters[beams] = 1
    estimate.probabilities[beams] = known.probabilities[beams]
    motions = np.repeat(estimate.motions, 2, axis=0)
    return replace(
        estimate, motions=motions, covariances=np.concatenate((estimate.covariances, UNKNOWN[None]))
    )


def _add_members(starts: NDArray[np.bool_], clusters: NDArray[np.int64]) -> None:
    """Points of the group an object was found by stay its own where they have no partner; starts (n, objects)."""
    for number in range(1, starts.shape[1] + 1):
        clusters[starts[:, number - 1] & (clusters < 0)] = number


def _add_parts(begun: Start, clusters: NDArray[np.int64]) -> None:
    """Outliers that left their place, on the piece of an object or next to it, are part of it."""
    a = begun.a
    single = np.bincount(a.pieces, minlength=1)[a.pieces] < 2
    loose = np.flatnonzero((clusters < 0) & (begun.sight == FREE) & ~single)
    objects = np.flatnonzero(clusters > 0)
    if not len(loose) or not len(objects):
        return
    away = np.hypot(*(a.points[loose, None] - a.points[None, objects]).transpose(2, 0, 1))
    nearest = away.argmin(axis=1)
    same = a.pieces[loose] == a.pieces[objects[nearest]]
    belongs = same | (away[np.arange(len(loose)), nearest] < CLOSE)
    clusters[loose[belongs]] = clusters[objects[nearest[belongs]]]


def _covariance(points: Array, grain: Array, motion: Array) -> Array:
    """(3, 3) of a motion by equation (6): of x, y, yaw, from the weights of its pairs."""
    c, s = np.cos(motion[2]), np.sin(motion[2])
    turned = points @ np.array([[c, s], [-s, c]])
    weights = 1.0 / grain**2
    x, y = turned.T
    total, wx, wy = weights.sum(), weights @ x, weights @ y
    information = np.array([[total, 0.0, -wy], [0.0, total, wx], [-wy, wx, weights @ (x**2 + y**2)]])
    information[2, 2] += 1.0 / 0.12**2
    covariance = np.linalg.inv(information + 1e-6 * np.eye(3))
    return np.asarray(0.5 * (covariance + covariance.T))


def _moving_probability(beliefs: Array, outlier: int) -> Array:
    """(n,) from the clusters' marginals."""
    return np.asarray(beliefs[:, 1:outlier].sum(axis=1) / np.maximum(beliefs[:, :outlier].sum(axis=1), 1e-12))


def _per_beam(
    begun: Start, partners: NDArray[np.int64], clusters: NDArray[np.int64], motions: Array, covariances: Array,
    probability: Array, score: float,
) -> JointEstimate:  # fmt: skip
    a, b = begun.a, begun.b
    count = len(a.ranges)
    associations, labels = np.full(count, -1, dtype=np.int64), np.full(count, -1, dtype=np.int64)
    probabilities = np.full(count, np.nan)
    associations[a.beams] = np.where(partners >= 0, b.beams[np.maximum(partners, 0)], -1)
    labels[a.beams] = clusters
    probabilities[a.beams] = probability
    return JointEstimate(associations, labels, motions, score, covariances, probabilities)
