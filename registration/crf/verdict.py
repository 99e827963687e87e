"""The last word on what moves: boosted trees over the evidence of each point, its piece and what explains it.

The chains decide by what neighbours say; what a whole piece says, with its shape and what hides it, they cannot see.
What is said to move beyond them joins the object of its piece or the one beside it, or becomes one whose motion nobody
knows; what is said to stand goes back to the background.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.gradient_boosting import GradientBoosting
from registration.crf.beams import AGREES
from registration.crf.estimate import UNKNOWN, JointEstimate
from registration.crf.evidence import evidence
from registration.crf.finish import LEAST_MEMBERS
from registration.crf.potentials import Problem
from registration.crf.setup import Start
from registration.motion import Array

MOVES = 2.1  # log odds, both equally likely beforehand, from which a point moves
JOINS = 0.3  # metres to an object within which what moves is part of it
LINK = 0.45  # metres between parts of one thing: two legs
FIRST = 20  # trees that every point is shown to
STANDS, GOES = -1.0, 2.5  # log odds by those beyond which the others are not asked: they would only be surer
AT_A_TIME = 16  # points shown to a tree together
SURER = 2.7  # times what the first trees say: what all would


class Verdict:
    """Boosted trees in two parts; most points of a scan are settled by the first.

    trees : all of them.
    """

    def __init__(self, trees: GradientBoosting) -> None:
        self.trees = trees
        content = trees.to_dict()
        self._depth = int(content["depth"])
        features = np.array([tree["features"] for tree in content["trees"]], dtype=np.int64)
        # In single precision, as a model is kept.
        thresholds, leaves = (
            np.array([tree[name] for tree in content["trees"]], dtype=np.float32).astype(np.float64)
            for name in ("thresholds", "leaves")
        )
        # Where there is no split everything is below.
        thresholds = np.where(np.isnan(thresholds), np.inf, thresholds)
        self._first = (features[:FIRST], thresholds[:FIRST], leaves[:FIRST])
        self._rest = (features[FIRST:], thresholds[FIRST:], leaves[FIRST:])

    def odds(self, rows: Array) -> Array:
        """Log odds (n,) that the points with evidence `rows` (n, len(NAMES)) move."""
        odds = self._said(rows, self._first)
        if not len(self._rest[0]):
            return odds
        doubtful = (odds > STANDS) & (odds < GOES)
        odds[~doubtful] *= SURER
        odds[doubtful] += self._said(rows[doubtful], self._rest)
        return odds

    def _said(self, rows: Array, trees: tuple[NDArray[np.int64], Array, Array]) -> Array:
        features, thresholds, leaves = trees
        return np.asarray(_sum_of(rows, features, thresholds, leaves, self._depth))


@njit(cache=True)
def _sum_of(rows, features, thresholds, leaves, depth):  # type: ignore[no-untyped-def]
    """What the trees, features and thresholds (T, 2^D - 1) and leaves (T, 2^D), say of rows (n, F) in sum, (n,).

    As `GradientBoosting.decision`, several rows at a time: down one tree each step has to wait for the one before.
    """
    n, inner = len(rows), features.shape[1]
    sums = np.zeros(n)
    node = np.empty(AT_A_TIME, dtype=np.int64)
    for low in range(0, n, AT_A_TIME):
        count = min(AT_A_TIME, n - low)
        for t in range(len(features)):
            node[:] = 0
            for _ in range(depth):
                for i in range(count):
                    k = node[i]
                    node[i] = 2 * k + 2 - (rows[low + i, features[t, k]] <= thresholds[t, k])
            for i in range(count):
                sums[low + i] += leaves[t, node[i] - inner]
    return sums


def overruled(estimate: JointEstimate, begun: Start, problem: Problem, verdict: Verdict) -> JointEstimate:
    """The estimate with what moves decided anew."""
    beams = begun.a.beams
    said = estimate.clusters[beams]
    odds = verdict.odds(evidence(begun, problem, said, estimate.probabilities[beams]))
    clusters = decided(begun, said, odds > MOVES)
    associations = estimate.associations[beams]
    associations[(clusters != said) & (clusters != 0)] = -1
    back = (clusters != said) & (clusters == 0)
    associations[back] = _background_partners(begun, problem)[back]
    return _renumbered(estimate, begun, clusters, associations, 1.0 / (1.0 + np.exp(MOVES - odds)))


def decided(begun: Start, said: NDArray[np.int64], moves: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Clusters (n,) where only what `moves` (n,) is in one above 0; new ones come after those `said` (n,)."""
    a = begun.a
    clusters = np.where(moves, said, np.where(begun.sight == AGREES, 0, -1))
    clusters = np.where(~moves & (said <= 0), said, clusters)
    objects, loose = np.flatnonzero(moves & (said > 0)), np.flatnonzero(moves & (said <= 0))
    if not len(loose):
        return clusters
    if len(objects):
        away, nearest = cKDTree(a.points[objects]).query(a.points[loose])
        of_piece = np.zeros(int(a.pieces.max()) + 1, dtype=np.int64)
        of_piece[a.pieces[objects]] = said[objects]
        beside = np.where(away < JOINS, said[objects[nearest]], 0)
        clusters[loose] = np.where(of_piece[a.pieces[loose]] > 0, of_piece[a.pieces[loose]], beside)
        loose = loose[clusters[loose] <= 0]
    number = 1 + max(int(said.max(initial=0)), 0)
    while len(loose):
        group = _linked(a.points, a.pieces, loose)
        clusters[group] = number
        number += 1
        loose = np.setdiff1d(loose, group)
    return clusters


def _linked(points: Array, pieces: NDArray[np.int64], loose: NDArray[np.int64]) -> NDArray[np.int64]:
    """Those of the points `loose` that are one thing with the first: of its piece, or next to it."""
    first = loose[pieces[loose] == pieces[loose[0]]]
    away = cKDTree(points[first]).query(points[loose])[0]
    return loose[away < LINK]


def _background_partners(begun: Start, problem: Problem) -> NDArray[np.int64]:
    """(n,) beam of b that each point is if it stands, -1 where none is near: of its states the first."""
    c, s = np.cos(problem.motions[0, 2]), np.sin(problem.motions[0, 2])
    there = begun.a.points @ np.array([[c, s], [-s, c]]) + problem.motions[0, :2]
    nearest = problem.states[:, 0]
    away = np.hypot(*(there - begun.b.points[nearest]).T)
    return np.where((nearest >= 0) & (away < problem.grain), begun.b.beams[nearest], -1)


def _renumbered(
    estimate: JointEstimate, begun: Start, clusters: NDArray[np.int64], associations: NDArray[np.int64],
    probability: Array,
) -> JointEstimate:  # fmt: skip
    """The estimate with clusters (n,) of enough points numbered from 1, each with its motion if it has one."""
    old = len(estimate.motions)
    size = np.bincount(np.maximum(clusters, 0), minlength=old)
    kept = [k for k in range(1, len(size)) if size[k] >= LEAST_MEMBERS]
    numbers = np.full(len(size), -1)
    numbers[0] = 0
    numbers[kept] = np.arange(1, len(kept) + 1)
    clusters = np.where(clusters >= 0, numbers[np.maximum(clusters, 0)], -1)
    associations = np.where(clusters >= 0, associations, -1)
    labels, partners = estimate.clusters.copy(), estimate.associations.copy()
    labels[begun.a.beams], partners[begun.a.beams] = clusters, associations
    probabilities = estimate.probabilities.copy()
    probabilities[begun.a.beams] = probability
    known = [0, *(k for k in kept if k < old)]
    new = len(kept) + 1 - len(known)
    motions = np.concatenate((estimate.motions[known], np.repeat(estimate.motions[:1], new, axis=0)))
    covariances = np.concatenate((estimate.covariances[known], np.repeat(UNKNOWN[None], new, axis=0)))
    return replace(
        estimate, clusters=labels, associations=partners, motions=motions, covariances=covariances,
        probabilities=probabilities,
    )  # fmt: skip
