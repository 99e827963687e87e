"""What the joint model is compared with (section V): the same tasks one after the other.

ICP with K-means; CRF-Matching with K-means; CRF-Matching with CRF-Clustering, which is the joint model with the links
between its chains removed; and free-space violation, which says what moved but neither whose it is nor whereto.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from registration.align import align
from registration.crf.beams import AGREES, FREE, Beams, beams_of
from registration.crf.estimate import UNKNOWN, JointEstimate
from registration.crf.exact import map_states
from registration.crf.learning import (
    Labels,
    Likelihood,
    NodeFeatures,
    learn_boosting,
    learn_weights,
    node_features,
)
from registration.crf.max_product import beliefs
from registration.crf.model import JointModel
from registration.crf.potentials import Problem
from registration.crf.rigid import rigid_motion
from registration.crf.setup import Start, boosting_features, problem_of, start
from registration.crf.training import Example
from registration.motion import Array
from registration.scan import Scan

CLUSTERS = 4  # of K-means, the most there are in the truth, background and outliers with them
GATE = 0.25  # metres within which ICP's nearest point is taken to be the same


def icp_kmeans(scan_a: Scan, scan_b: Scan) -> JointEstimate:
    """ICP for the associations, K-means on their displacements for the clusters."""
    a, b = beams_of(scan_a), beams_of(scan_b)
    motion = align(scan_a, scan_b, method="icp").transform
    away, nearest = cKDTree(b.points).query(_moved(a.points, motion))
    partners = np.where(away < GATE, nearest, -1)
    return _by_kmeans(a, b, partners, motion)


def free_space(scan_a: Scan, scan_b: Scan) -> JointEstimate:
    """Background registration; what stands where scan b saw through has moved, each run of such points an object."""
    begun = start(scan_a, scan_b)
    motion = begun.registration.transform
    _, nearest = cKDTree(begun.b.points).query(_moved(begun.a.points, motion))
    clusters = np.where(begun.sight == AGREES, 0, -1)
    free = begun.sight == FREE
    fresh = np.flatnonzero(free & np.insert(~free[:-1], 0, True))
    clusters[free] = np.searchsorted(fresh, np.flatnonzero(free), side="right")
    partners = np.where(clusters == 0, nearest, -1)
    motions = np.repeat(motion[None], 1 + int(clusters.max(initial=0)), axis=0)
    return _estimate(begun.a, begun.b, partners, clusters, motions)


@dataclass(eq=False)
class Matching:
    """CRF-Matching: the association chain alone, with the candidates of the background's motion."""

    model: JointModel

    @classmethod
    def train(cls, examples: list[Example]) -> Matching:
        """From labelled pairs made ready."""
        rows = []
        for example in examples:
            motions, starts = _alone(example.begun)
            plain = problem_of(example.begun, motions, starts, None, None)
            features, hints = boosting_features(example.begun, motions, starts, plain.states)
            rows.append((features, plain.states, hints, example.labels(plain.states).associations))
        data, outlier = learn_boosting(rows)
        cases: list[tuple[Problem, Labels]] = []
        for example in examples:
            problem = problem_of(example.begun, *_alone(example.begun), data, outlier)
            problem.linked = False
            truth = example.labels(problem.states).associations
            cases.append((problem, Labels(truth, np.zeros(len(truth), dtype=np.int64))))
        weights = learn_weights([node_features(*case)[0] for case in cases])
        return cls(JointModel(Likelihood(cases).learn(weights), data, outlier))

    def match(self, begun: Start) -> tuple[Problem, NDArray[np.int64]]:
        """The problem and its associations as states (n,)."""
        problem = problem_of(begun, *_alone(begun), self.model.data, self.model.outlier)
        problem.linked = False
        return problem, map_states(problem.potentials(self.model.weights))[0]

    def infer(self, scan_a: Scan, scan_b: Scan) -> JointEstimate:
        """With K-means for the clusters."""
        begun = start(scan_a, scan_b)
        problem, states = self.match(begun)
        return _by_kmeans(begun.a, begun.b, _partners(problem, states), begun.registration.transform)


@dataclass(eq=False)
class Clustering:
    """CRF-Clustering after CRF-Matching: the clustering chain alone, its associations given.

    Motions begin with those of K-means' clusters and are recomputed from the clusters, as in the joint model.
    """

    matching: Matching
    weights: Array

    @classmethod
    def train(cls, examples: list[Example], matching: Matching) -> Clustering:
        """From labelled pairs made ready; the motions it learns with are those it will begin with."""
        nodes: list[NodeFeatures] = []
        for example in examples:
            problem, partners = cls._begin(matching, example.begun)
            k = problem.states.shape[1]
            truth = np.full(len(partners), len(problem.motions))
            truth[example.clusters == 0] = 0
            for number in np.unique(example.clusters[(example.clusters > 0)]):
                members = (example.clusters == number) & (example.partners >= 0)
                shares = [(members & problem.starts[:, d]).sum() for d in range(1, len(problem.motions))]
                if shares and 2 * max(shares) > members.sum():
                    truth[members] = 1 + int(np.argmax(shares))
            given = _states_of(problem, partners)
            nodes.append(node_features(problem, Labels(np.where(given < k, given, k), truth))[1])
        return cls(matching, learn_weights(nodes))

    @staticmethod
    def _begin(matching: Matching, begun: Start) -> tuple[Problem, NDArray[np.int64]]:
        """The problem with the motions of K-means' clusters, and the associations it is given."""
        matched, states = matching.match(begun)
        partners = _partners(matched, states)
        a, b = begun.a, begun.b
        first = _kmeans(b.points[np.maximum(partners, 0)] - a.points, partners >= 0)
        motions, starts = [], []
        for number in range(int(first.max(initial=0)) + 1):
            members = first == number
            if members.sum() >= 3:
                motions.append(rigid_motion(a.points[members], b.points[partners[members]]))
                starts.append(members)
        if not motions:
            motions, starts = [begun.registration.transform], [np.zeros(len(a), dtype=bool)]
        model = matching.model
        problem = problem_of(begun, np.array(motions), np.column_stack(starts), model.data, model.outlier)
        problem.active[:] = True
        problem.look()
        return problem, partners

    def infer(self, scan_a: Scan, scan_b: Scan) -> JointEstimate:
        """Its own motions, recomputed from its clusters until those do not change."""
        begun = start(scan_a, scan_b)
        problem, partners = self._begin(self.matching, begun)
        a, b = begun.a, begun.b
        clusters = np.zeros(len(a), dtype=np.int64)
        given = _states_of(problem, partners)
        for _ in range(8):
            made = problem.potentials(self.weights)
            local = made.clustering + made.links[np.arange(len(a)), :, given]
            now = beliefs(local, made.clustering_edges).argmax(axis=1)
            settled, clusters = np.array_equal(now, clusters), now
            for d in range(len(problem.motions)):
                members = (clusters == d) & (partners >= 0)
                if members.sum() >= 3:
                    problem.motions[d] = rigid_motion(a.points[members], b.points[partners[members]])
            if settled:
                break
            problem.look()
        clusters = np.where(clusters < len(problem.motions), clusters, -1)
        return _estimate(a, b, partners, clusters, problem.motions)


def _alone(begun: Start) -> tuple[Array, NDArray[np.bool_]]:
    """The background's motion only."""
    return begun.motions[:1], np.zeros((len(begun.a), 1), dtype=bool)


def _partners(problem: Problem, states: NDArray[np.int64]) -> NDArray[np.int64]:
    """Points of b by states of a, -1 for outliers."""
    most = problem.states.shape[1]
    chosen = problem.states[np.arange(len(states)), np.minimum(states, most - 1)]
    return np.where(states < most, chosen, -1)


def _states_of(problem: Problem, partners: NDArray[np.int64]) -> NDArray[np.int64]:
    """States of a problem for given points of b; what is no candidate is an outlier."""
    hit = (problem.states == partners[:, None]) & (partners >= 0)[:, None]
    return np.where(hit.any(axis=1), hit.argmax(axis=1), problem.states.shape[1])


def _by_kmeans(a: Beams, b: Beams, partners: NDArray[np.int64], background: Array) -> JointEstimate:
    told = partners >= 0
    clusters = _kmeans(b.points[np.maximum(partners, 0)] - a.points, told)
    motions = [background]
    for number in range(int(clusters.max(initial=0)) + 1):
        members = clusters == number
        motion = background
        if members.sum() >= 2:
            motion = rigid_motion(a.points[members], b.points[partners[members]])
        if number == 0:
            motions = [motion]
        else:
            motions.append(motion)
    return _estimate(a, b, partners, clusters, np.array(motions))


def _kmeans(displacements: Array, told: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Clusters (n,) by displacement, the largest is 0, -1 where there is none; centres begin farthest apart."""
    clusters = np.full(len(displacements), -1, dtype=np.int64)
    points = displacements[told]
    if not len(points):
        return clusters
    centres = [np.median(points, axis=0)]
    for _ in range(min(CLUSTERS, len(points)) - 1):
        away = np.min([np.hypot(*(points - centre).T) for centre in centres], axis=0)
        centres.append(points[int(away.argmax())])
    middle = np.array(centres)
    for _ in range(50):
        near = np.hypot(*(points[:, None] - middle[None]).transpose(2, 0, 1)).argmin(axis=1)
        again = np.array(
            [points[near == k].mean(axis=0) if (near == k).any() else middle[k] for k in range(len(middle))]
        )
        if np.allclose(again, middle):
            break
        middle = again
    order = np.argsort(-np.bincount(near, minlength=len(middle)), kind="stable")
    clusters[told] = np.argsort(order)[near]
    return clusters


def _estimate(
    a: Beams, b: Beams, partners: NDArray[np.int64], clusters: NDArray[np.int64], motions: Array
) -> JointEstimate:
    count = len(a.ranges)
    associations, labels = np.full(count, -1, dtype=np.int64), np.full(count, -1, dtype=np.int64)
    associations[a.beams] = np.where(partners >= 0, b.beams[np.maximum(partners, 0)], -1)
    labels[a.beams] = clusters
    covariances = np.repeat(UNKNOWN[None], len(motions), axis=0)
    return JointEstimate(associations, labels, motions, 0.0, covariances, np.full(count, np.nan))


def _moved(points: Array, motion: Array) -> Array:
    c, s = np.cos(motion[2]), np.sin(motion[2])
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + motion[:2])
