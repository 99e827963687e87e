"""Max-product message passing on the two chains (section III.C, Algorithm 1), log domain.

`sweep` passes messages along each whole chain in turn, exact on a chain alone; `flood` lets every node send to all its
neighbours at once, as the text does, and takes as many rounds as the chain is long to carry news from end to end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from registration.crf.potentials import Potentials
from registration.motion import Array


@njit(cache=True)
def _forward(local, edges, messages):  # type: ignore[no-untyped-def]
    """Messages to each node from the one before it, (n, S)."""
    n, states = local.shape
    for i in range(1, n):
        top = -np.inf
        for t in range(states):
            best = -np.inf
            for s in range(states):
                value = local[i - 1, s] + messages[i - 1, s] + edges[i - 1, s, t]
                if value > best:
                    best = value
            messages[i, t] = best
            top = max(top, best)
        for t in range(states):
            messages[i, t] -= top


@njit(cache=True)
def _backward(local, edges, messages):  # type: ignore[no-untyped-def]
    """Messages to each node from the one after it, (n, S)."""
    n, states = local.shape
    for i in range(n - 2, -1, -1):
        top = -np.inf
        for s in range(states):
            best = -np.inf
            for t in range(states):
                value = local[i + 1, t] + messages[i + 1, t] + edges[i, s, t]
                if value > best:
                    best = value
            messages[i, s] = best
            top = max(top, best)
        for s in range(states):
            messages[i, s] -= top


@njit(cache=True)
def beliefs(local, edges):  # type: ignore[no-untyped-def]
    """Max-marginals (n, S) of one chain up to a constant per node, exact."""
    ahead, back = np.zeros_like(local), np.zeros_like(local)
    _forward(local, edges, ahead)
    _backward(local, edges, back)
    return local + ahead + back


@njit(cache=True)
def _across(beliefs, incoming, links, to_association, messages):  # type: ignore[no-untyped-def]
    """Messages between the two nodes of each point; what came from there is taken out of the belief."""
    n, clusters, associations = links.shape
    for i in range(n):
        top = -np.inf
        if to_association:
            for k in range(associations):
                best = -np.inf
                for d in range(clusters):
                    best = max(best, beliefs[i, d] - incoming[i, d] + links[i, d, k])
                messages[i, k] = best
                top = max(top, best)
        else:
            for d in range(clusters):
                best = -np.inf
                for k in range(associations):
                    if beliefs[i, k] > -np.inf:
                        best = max(best, beliefs[i, k] - incoming[i, k] + links[i, d, k])
                messages[i, d] = best
                top = max(top, best)
        messages[i] -= top


@dataclass(eq=False)
class Messages:
    """What the two nodes of each point last told each other: (n, K + 1) and (n, D + 1)."""

    to_association: Array
    to_clustering: Array


def no_messages(potentials: Potentials) -> Messages:
    return Messages(np.zeros_like(potentials.association), np.zeros_like(potentials.clustering))


def sweep(potentials: Potentials, messages: Messages) -> tuple[Array, Array]:
    """One pass over both chains; updates `messages`, returns the beliefs (n, K + 1) and (n, D + 1)."""
    p = potentials
    clustering = beliefs(p.clustering + messages.to_clustering, p.clustering_edges)
    _across(clustering, messages.to_clustering, p.links, True, messages.to_association)
    association = beliefs(p.association + messages.to_association, p.association_edges)
    _across(association, messages.to_association, p.links, False, messages.to_clustering)
    clustering = beliefs(p.clustering + messages.to_clustering, p.clustering_edges)
    return association, clustering


def states_of(association: Array, clustering: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Equation (3): the best state of each node."""
    return association.argmax(axis=1), clustering.argmax(axis=1)


@njit(cache=True)
def _flood_chain(local, edges, ahead, back, new_ahead, new_back):  # type: ignore[no-untyped-def]
    """One synchronous round along a chain: every message from the last round's."""
    n, states = local.shape
    change = 0.0
    for i in range(n - 1):
        top_ahead, top_back = -np.inf, -np.inf
        for t in range(states):
            forward, backward = -np.inf, -np.inf
            for s in range(states):
                forward = max(forward, local[i, s] + ahead[i, s] + edges[i, s, t])
                backward = max(backward, local[i + 1, s] + back[i + 1, s] + edges[i, t, s])
            new_ahead[i + 1, t], new_back[i, t] = forward, backward
            top_ahead, top_back = max(top_ahead, forward), max(top_back, backward)
        for t in range(states):
            new_ahead[i + 1, t] -= top_ahead
            new_back[i, t] -= top_back
            change = max(change, abs(new_ahead[i + 1, t] - ahead[i + 1, t]), abs(new_back[i, t] - back[i, t]))
    return change


@njit(cache=True)
def _flood(association, clustering, links, association_edges, clustering_edges, most, tolerance):  # type: ignore[no-untyped-def]
    a_ahead, a_back = np.zeros_like(association), np.zeros_like(association)
    c_ahead, c_back = np.zeros_like(clustering), np.zeros_like(clustering)
    to_a, to_c = np.zeros_like(association), np.zeros_like(clustering)
    new_a, new_c = np.zeros_like(association), np.zeros_like(clustering)
    rounds = 0
    for _ in range(most):
        rounds += 1
        local_a, local_c = association + to_a, clustering + to_c
        _across(local_c + c_ahead + c_back, to_c, links, True, new_a)
        _across(local_a + a_ahead + a_back, to_a, links, False, new_c)
        ahead, back = np.zeros_like(a_ahead), np.zeros_like(a_back)
        change = _flood_chain(local_a, association_edges, a_ahead, a_back, ahead, back)
        a_ahead, a_back = ahead, back
        ahead, back = np.zeros_like(c_ahead), np.zeros_like(c_back)
        change = max(change, _flood_chain(local_c, clustering_edges, c_ahead, c_back, ahead, back))
        c_ahead, c_back = ahead, back
        change = max(change, np.abs(new_a - to_a).max(), np.abs(new_c - to_c).max())
        to_a[:], to_c[:] = new_a, new_c
        if change < tolerance:
            break
    return association + to_a + a_ahead + a_back, clustering + to_c + c_ahead + c_back, rounds


def flood(potentials: Potentials, most: int = 200, tolerance: float = 1e-6) -> tuple[Array, Array, int]:
    """The flooding schedule until no message changes: beliefs (n, K + 1), (n, D + 1), and rounds taken."""
    p = potentials
    association = np.where(np.isfinite(p.association), p.association, -1e9)
    found: tuple[Array, Array, int] = _flood(
        association, p.clustering, p.links, p.association_edges, p.clustering_edges, most, tolerance
    )
    return found
