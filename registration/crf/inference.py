"""MAP inference on the joint model: Algorithm 1 with messages along whole chains and motions recomputed in line."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.errors import InputError
from registration.crf.exact import map_states
from registration.crf.max_product import flood, no_messages, states_of, sweep
from registration.crf.potentials import Potentials, Problem
from registration.crf.rigid import SUMS, add_pair, motion_of
from registration.motion import Array

SWEEPS = 3
SETTLED = 1e-3  # metres and radians a motion may still change
TURN_SIGMA, ROUND_SIGMA, ROUND = 0.12, 0.02, 0.6  # rad, rad, m: see `hypotheses`
MOST_STEP = 0.15  # metres an object's motion may leave its start by in one recomputation
SCHEDULES = ("exact", "sweep", "flooding")


@dataclass(eq=False)
class Labelling:
    """States of all nodes: associations (n,), K outlier; clusters (n,), D outlier; beliefs (n, D + 1) in clusters."""

    associations: NDArray[np.int64]
    clusters: NDArray[np.int64]
    beliefs: Array
    score: float
    sweeps: int
    converged: bool


@njit(cache=True)
def _recompute(points, others, states, grain, associations, clusters, sigmas, motions):  # type: ignore[no-untyped-def]
    """Equation (6) for every object, weighted by the inverse square of what is noise; the background's is kept."""
    n, most = states.shape
    count = len(motions)
    sums = np.zeros((count, SUMS))
    for i in range(n):
        d, k = clusters[i], associations[i]
        if 0 < d < count and k < most and states[i, k] >= 0:
            j = states[i, k]
            weight = 1.0 / (grain[i] * grain[i])
            add_pair(sums[d], points[i, 0], points[i, 1], others[j, 0], others[j, 1], weight)
    for d in range(1, count):
        if sums[d, 8] >= 3.0:
            motion_of(sums[d], motions[0, 2], 1.0 / (sigmas[d] * sigmas[d]), motions[d])


def turn_sigmas(problem: Problem) -> Array:
    """(D,) radians each cluster may be expected to turn: what is small shows no rotation."""
    sigmas = np.full(len(problem.motions), TURN_SIGMA)
    for d in range(1, len(sigmas)):
        members = problem.a.points[problem.starts[:, d]]
        if len(members) and np.hypot(*np.ptp(members, axis=0)) < ROUND:
            sigmas[d] = ROUND_SIGMA
    return sigmas


def infer_labels(problem: Problem, weights: Array, schedule: str = "exact", most: int = SWEEPS) -> Labelling:
    """MAP labelling; `problem.motions` are updated in line.

    schedule : "exact" (both chains as one), "sweep" (messages along each chain and back, and across) or "flooding"
    (the text's: every node to all its neighbours at once).
    """
    if schedule not in SCHEDULES:
        raise InputError(f"schedule: one of {', '.join(SCHEDULES)} expected, got {schedule!r}")
    n, k = problem.states.shape
    sigmas = turn_sigmas(problem)
    associations = np.where((problem.states >= 0).any(axis=1), problem.data.argmax(axis=1), k)
    clusters = np.zeros(n, dtype=np.int64)
    messages, potentials = None, None
    settled, turn = False, 0
    for _ in range(most):
        turn += 1
        potentials = problem.potentials(weights, potentials)
        if messages is None:
            messages = no_messages(potentials)
        if schedule == "exact":
            now = map_states(potentials)
        elif schedule == "flooding":
            now = states_of(*flood(potentials, most=n)[:2])
        else:
            now = states_of(*sweep(potentials, messages))
        before = problem.motions.copy()
        _recompute(
            problem.a.points, problem.b.points, problem.states, problem.grain, *now, sigmas, problem.motions
        )
        settled = np.abs(problem.motions - before).max() < SETTLED
        settled = bool(settled and np.array_equal(now[0], associations) and np.array_equal(now[1], clusters))
        associations, clusters = now
        if settled:
            break
        problem.look(before)
    if not settled or potentials is None:
        potentials = problem.potentials(weights, potentials)
    beliefs = _conditionals(potentials, associations, clusters)
    return Labelling(associations, clusters, beliefs, potentials.score(associations, clusters), turn, settled)


def _conditionals(
    potentials: Potentials, associations: NDArray[np.int64], clusters: NDArray[np.int64]
) -> Array:
    """(n, D + 1) probability of each cluster, everything else being as labelled."""
    p, n = potentials, len(associations)
    scores = p.clustering + p.links[np.arange(n), :, associations]
    e = np.arange(n - 1)
    scores[1:] += p.clustering_edges[e, clusters[:-1], :]
    scores[:-1] += p.clustering_edges[e, :, clusters[1:]]
    share = np.exp(scores - scores.max(axis=1, keepdims=True))
    return np.asarray(share / share.sum(axis=1, keepdims=True))


def exhaustive(potentials: Potentials) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    """MAP of a tiny problem by trying every labelling: what the tests hold message passing against."""
    n, k = potentials.association.shape
    d = potentials.clustering.shape[1]
    best, found = -np.inf, None
    for code in range((k * d) ** n):
        digits = np.array([code // (k * d) ** i % (k * d) for i in range(n)])
        score = potentials.score(digits % k, digits // k)
        if score > best:
            best, found = score, digits
    assert found is not None
    return found % k, found // k, best
