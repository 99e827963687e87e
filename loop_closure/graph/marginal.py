"""Nodes taken out of a pose graph: what they said of their neighbours stays, as edges between these.

The edges of a node that goes are a star. It is drawn together on the neighbour the node is tied to best: each of the
others gets an edge to that one, by way of the node (exact where there are two neighbours, and in the means; that the
edges share the way to the hub is left out). Edges between the same two nodes become one. As in reduced pose graphs, the
rounds through a known place go on sharpening it, and the graph grows with the place and not with the time.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable

import numpy as np
from scipy.sparse import csr_matrix
from scipy.sparse.csgraph import minimum_spanning_tree
from scipy.spatial.transform import Rotation

from estimation.checks import FloatArray
from loop_closure.graph.edges import Edge
from loop_closure.motions import compose, invert, lever, planar, positions, rotation

FLOOR = (0.005, 0.001)  # metres and radians: what no number of looks takes away
DISAGREE = 25.0  # squared deviations at which two edges of the same nodes are not averaged
DEGREE = 6  # edges per node that are kept


def turned_round(edge: Edge) -> Edge:
    """The same measurement seen from its other end; a and b change places."""
    back = invert(edge.motion)
    J = rotation(edge.motion).T @ lever(-positions(edge.motion))
    return Edge(edge.b, edge.a, back, J @ edge.covariance @ J.T, edge.closure)


def joined(first: Edge, second: Edge) -> Edge:
    """One edge by way of `first.b`, which is `second.a`; it is no closure any more."""
    B = rotation(first.motion)
    J = lever(B[: len(positions(first.motion)), : len(positions(first.motion))] @ positions(second.motion))
    covariance = J @ first.covariance @ J.T + B @ second.covariance @ B.T
    return Edge(first.a, second.b, compose(first.motion, second.motion), covariance)


def averaged(first: Edge, second: Edge) -> Edge:
    """Two measurements of the same motion as one; where they contradict each other, the tighter of the two."""
    off = _difference(first.motion, second.motion)
    whole = first.covariance + second.covariance
    if off @ np.linalg.solve(whole, off) > DISAGREE:
        return min(first, second, key=looseness)
    gain = np.linalg.solve(whole, first.covariance).T
    covariance = first.covariance - gain @ first.covariance
    return Edge(first.a, first.b, _moved(first.motion, gain @ off), _floored(covariance))


def looseness(edge: Edge) -> float:
    """Metres squared, how little an edge says."""
    size = 2 if planar(edge.motion) else 3
    return float(np.trace(edge.covariance[:size, :size]) + 25.0 * np.trace(edge.covariance[size:, size:]))


def without(edges: Iterable[Edge], gone: Iterable[int], count: int) -> list[Edge]:
    """Edges of a graph of `count` nodes once the nodes `gone` are marginalised; the numbers stay as they are.

    Closures between nodes that stay are left alone. The others become edges that are taken for granted: what may be
    false has to be taken out before.
    """
    closures: list[Edge] = []
    derived: dict[tuple[int, int], Edge] = {}
    around: dict[int, dict[int, Edge]] = defaultdict(dict)
    leaving = set(gone)

    def add(edge: Edge) -> None:
        if edge.a == edge.b:
            return
        forward = edge if edge.a < edge.b else turned_round(edge)
        pair = forward.a, forward.b
        one = Edge(*pair, forward.motion, 0.5 * (forward.covariance + forward.covariance.T))
        if pair in derived:
            one = averaged(derived[pair], one)
        derived[pair] = around[pair[0]][pair[1]] = around[pair[1]][pair[0]] = one

    for edge in edges:
        touched = edge.a in leaving or edge.b in leaving
        if edge.closure and not touched:
            closures.append(edge)
        elif touched or edge.a > edge.b or (edge.a, edge.b) in derived:
            add(edge)
        else:
            derived[edge.a, edge.b] = around[edge.a][edge.b] = around[edge.b][edge.a] = edge
    for node in sorted(leaving):
        star = [
            (other, edge if edge.a == node else turned_round(edge)) for other, edge in around[node].items()
        ]
        for other, _ in star:
            del around[other][node]
            del derived[min(node, other), max(node, other)]
        del around[node]
        if len(star) < 2:
            continue
        hub, spoke = min(star, key=lambda item: looseness(item[1]))
        inward = turned_round(spoke)
        for other, edge in star:
            if other != hub:
                add(joined(inward, edge))
    return _sparse(closures, list(derived.values()), count, count - len(leaving))


def _sparse(closures: list[Edge], derived: list[Edge], count: int, left: int) -> list[Edge]:
    """All closures, and of the derived edges the tightest: those that hold the graph together always, and steps."""
    spare = len(closures) + len(derived) - DEGREE * left
    if spare > 0:
        ends = np.array([(edge.a, edge.b) for edge in derived])
        loose = np.array([looseness(edge) for edge in derived])
        tree = minimum_spanning_tree(csr_matrix((loose, (ends[:, 0], ends[:, 1])), shape=(count, count)))
        held = set(zip(*(axis.tolist() for axis in tree.nonzero()), strict=True))
        order = [n for n in np.argsort(-loose) if tuple(ends[n]) not in held and ends[n, 1] - ends[n, 0] > 1]
        dropped = {int(n) for n in order[:spare]}
        derived = [edge for n, edge in enumerate(derived) if n not in dropped]
    derived.sort(key=lambda edge: (edge.b, edge.a))
    return [*derived, *closures]


def renumbered(edges: Iterable[Edge], number: FloatArray) -> list[Edge]:
    """Edges of the nodes that stay, by their new numbers; `number` (N,) is -1 of those that went."""
    return [
        Edge(int(number[e.a]), int(number[e.b]), e.motion, e.covariance, e.closure)
        for e in edges
        if number[e.a] >= 0 and number[e.b] >= 0
    ]


def _difference(a: FloatArray, b: FloatArray) -> FloatArray:
    """How b is off a, in the frame both start from: (3,) or (6,)."""
    if planar(a):
        return np.array([*(b[:2] - a[:2]), np.arctan2(np.sin(b[2] - a[2]), np.cos(b[2] - a[2]))])
    turn = Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()
    return np.concatenate((b[:3, 3] - a[:3, 3], turn))


def _moved(pose: FloatArray, by: FloatArray) -> FloatArray:
    if planar(pose):
        moved = pose + by
        moved[2] = np.arctan2(np.sin(moved[2]), np.cos(moved[2]))
        return np.asarray(moved)
    out = pose.copy()
    out[:3, :3] = Rotation.from_rotvec(by[3:]).as_matrix() @ pose[:3, :3]
    out[:3, 3] += by[:3]
    return out


def _floored(covariance: FloatArray) -> FloatArray:
    """No direction known better than FLOOR."""
    size = 2 if len(covariance) == 3 else 3
    unit = np.array([FLOOR[0]] * size + [FLOOR[1]] * (len(covariance) - size))
    values, vectors = np.linalg.eigh(covariance / np.outer(unit, unit))
    scaled = (vectors * np.maximum(values, 1.0)) @ vectors.T
    return np.asarray(scaled * np.outer(unit, unit))
