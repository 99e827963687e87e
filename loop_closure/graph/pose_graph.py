"""The trajectory as a pose graph, smoothed by gtsam: what the filter in `esdf` does, without linearising for good.

Nodes are keyframes in the order they were taken; every node but the first hangs on the one before it by odometry.
"""

from __future__ import annotations

from contextlib import suppress
from typing import Any, Protocol

import numpy as np
from scipy.spatial.transform import Rotation

from estimation.checks import FloatArray
from estimation.errors import InputError
from loop_closure.graph.edges import Edge
from loop_closure.graph.smoother import News, Smoother
from loop_closure.graph.smoother_process import RemoteSmoother, SmootherProcess
from loop_closure.growing_array import GrowingArray
from loop_closure.motions import compose, motion, planar, rotation
from loop_closure.work import Steps, at_once

SMOOTHING, TELLING = 0.01, 0.04  # ms per node of one round of smoothing; per edge that is told
ROUNDS = 3  # of smoothing after each closure
# Nodes for each of which one scan more is taken in before a process of its own is asked for its answer.
PER_SCAN = 500


class PoseGraph(Protocol):
    """What `Slam` asks of a back end."""

    edges: list[Edge]

    @property
    def poses(self) -> FloatArray:
        """(N, 3) or (N, 4, 4) of all nodes."""

    def begin(self, pose: FloatArray) -> None:
        """The first node; it stays where it is."""

    def restore(self, poses: FloatArray, edges: list[Edge]) -> None:
        """Nodes and edges as they were saved."""

    def extend(self, step: FloatArray, covariance: FloatArray) -> int:
        """A node at `step` from the last; returns its number."""

    def close(self, edges: list[Edge]) -> None:
        """Take closures and estimate anew."""

    def settle(self, without: set[int] | None = None) -> None:
        """The best estimate from everything; `without` are numbers of edges to forget."""


class SmoothedGraph:
    """Incremental smoothing (iSAM2), and Levenberg-Marquardt over everything in `settle`.

    Closures have a Cauchy kernel once all is settled, and none before: one that was accepted as part of a large
    correction must be able to pull.

    Parameters
    ----------
    aside : a process that smooths; None for this one.
    """

    def __init__(self, aside: SmootherProcess | None = None) -> None:
        self.edges: list[Edge] = []
        self.aside = aside
        self._poses = GrowingArray((3,))
        self._smoother: Smoother | RemoteSmoother = Smoother()
        self._keys: list[int] = []  # of the nodes the smoother knows, ascending
        self._slots: dict[Edge, int] = {}  # of the edges it knows, in the order they were told
        self._forgotten: list[int] = []  # slots it has to forget
        self._keys_made = self._slots_made = 0

    def __getstate__(self) -> dict[str, Any]:
        """For copies: gtsam's part cannot be copied, and the process that smooths is not shared."""
        return self.__dict__ | {"aside": None, "_smoother": None}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__dict__.update(state)
        self._smoother = Smoother()
        if len(self._poses):
            self._begin_again()

    @property
    def poses(self) -> FloatArray:
        return self._poses.rows

    def begin(self, pose: FloatArray) -> None:
        self.edges = []
        self._set(pose[None])
        self._start(pose)

    def restore(self, poses: FloatArray, edges: list[Edge]) -> None:
        self.edges = list(edges)
        self._set(poses)
        try:
            self._restart()
            self._smoother.estimate()
        except RuntimeError as error:
            raise InputError(f"the edges of the pose graph do not determine its poses: {error}") from None

    def _start(self, pose: FloatArray) -> None:
        if self.aside is not None:
            self._smoother = self.aside.smoother(pose)
        else:
            self._smoother = Smoother()
            self._smoother.begin(pose)
        self._keys, self._keys_made, self._slots_made = [0], 1, 0
        self._slots, self._forgotten = {}, []

    def extend(self, step: FloatArray, covariance: FloatArray) -> int:
        node = len(self._poses)
        self.edges.append(Edge(node - 1, node, step, covariance))
        self._poses.append(compose(self.poses[-1], step))
        return node

    def _set(self, poses: FloatArray) -> None:
        """Other poses of all nodes, in memory of their own: who asked for them before keeps what was told."""
        self._poses = GrowingArray.of(poses)

    def close(self, edges: list[Edge]) -> None:
        """Closures without a kernel; they were decided on."""
        at_once(self.closing(edges))

    def closing(self, edges: list[Edge]) -> Steps[None]:
        """`close`, in steps. Nodes may be added meanwhile, nothing else."""
        self.edges += edges
        try:
            # Nodes wait until a closure needs them: alone they change nothing.
            yield from self._telling()
            for _ in range(1, ROUNDS):
                yield SMOOTHING * len(self._keys)
                self._smoother.smooth()
            # A process of its own has until then.
            for _ in range(1 + len(self._keys) // PER_SCAN):
                yield SMOOTHING * len(self._keys)
            self._take(self._smoother.estimate())
        except RuntimeError:
            # Rounding made the increment singular; everything at once is slower and sound.
            self.settle()

    def take_out(self, number: FloatArray, edges: list[Edge], renumbered: list[Edge]) -> None:
        """Keep the nodes with a new number, in order; `number` (N,) is -1 of the others.

        edges : of what is left, those that were there before being the same objects. renumbered : the same by the new
        numbers. The smoother learns of it with the next closure: it forgets edges, and nodes without any.
        """
        known = {
            new: self._slots.pop(old)
            for old, new in zip(edges, renumbered, strict=True)
            if old in self._slots
        }
        self._forgotten += self._slots.values()
        self._slots = known
        self._keys = [key for node, key in enumerate(self._keys) if number[node] >= 0]
        self._set(self.poses[number >= 0])
        self.edges = renumbered

    def _telling(self) -> Steps[None]:
        """Tell the smoother of nodes and edges it does not know, and of those that are gone."""
        poses = list(self.poses[len(self._keys) :])
        keys = list(range(self._keys_made, self._keys_made + len(poses)))
        self._keys += keys
        self._keys_made += len(keys)
        edges = [edge for edge in self.edges if edge not in self._slots]
        for edge in edges:
            self._slots[edge] = self._slots_made
            self._slots_made += 1
        ends = [(self._keys[edge.a], self._keys[edge.b]) for edge in edges]
        forgotten, self._forgotten = self._forgotten, []
        yield TELLING * len(edges) + SMOOTHING * len(self._keys)
        self._smoother.learn(News(keys, poses, ends, edges, forgotten))

    def settle(self, without: set[int] | None = None) -> None:
        if without:
            self.edges = [edge for number, edge in enumerate(self.edges) if number not in without]
        self._set(self._settled())
        self._begin_again()

    def _begin_again(self) -> None:
        try:
            self._restart()
        except RuntimeError:
            # So badly determined that steps fail from here as well: with the next closure it is told everything again.
            self._start(self.poses[0])

    def _settled(self) -> FloatArray:
        if isinstance(self._smoother, RemoteSmoother):
            with suppress(RuntimeError):
                return self._smoother.settled(self.poses, self.edges)
        return Smoother().settled(self.poses, self.edges)

    def _restart(self) -> None:
        """Hand the smoother everything afresh, from where the poses are now."""
        self._start(self.poses[0])
        try:
            at_once(self._telling())
        except RuntimeError:
            if not isinstance(self._smoother, RemoteSmoother):
                raise
            # The process that smooths has ended: then in this one.
            self._start(self.poses[0])
            at_once(self._telling())

    def _take(self, known: FloatArray) -> None:
        """The poses of the first nodes; those that came since hang on the last of them."""
        poses = self.poses.copy()
        poses[: len(known)] = known
        for node in range(len(known), len(poses)):
            poses[node] = compose(poses[node - 1], motion(self.poses[node - 1], self.poses[node]))
        self._set(poses)


def residuals(edges: list[Edge], poses: FloatArray) -> FloatArray:
    """Mahalanobis distance squared of each edge, (M,)."""
    squares = np.empty(len(edges))
    for k, edge in enumerate(edges):
        off = motion(edge.motion, motion(poses[edge.a], poses[edge.b]))
        error = off
        if not planar(off):
            error = np.concatenate((off[:3, 3], Rotation.from_matrix(off[:3, :3]).as_rotvec()))
        B = rotation(edge.motion)
        squares[k] = error @ np.linalg.solve(B.T @ edge.covariance @ B, error)
    return squares
