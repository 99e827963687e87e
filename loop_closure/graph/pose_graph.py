"""The trajectory as a pose graph, smoothed by gtsam: what the filter in `esdf` does, without linearising for good.

Nodes are keyframes in the order they were taken; every node but the first hangs on the one before it by odometry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from loop_closure.growing_array import GrowingArray
from loop_closure.motions import compose, motion, planar, rotation
from loop_closure.work import Steps, at_once

ROBUST = 3.0  # deviations at which a closure counts half
SMOOTHING = 0.006  # ms per node of one round of smoothing
ROUNDS = 3  # of them after each closure
FACTOR, HANDED = 0.04, 100  # ms that handing over an edge takes; edges that are one step


@dataclass(frozen=True, eq=False)
class Edge:
    """A measured motion between two nodes.

    a, b : nodes, a < b. motion : pose of b in the frame of a, (3,) or (4, 4). covariance : (3, 3) or (6, 6) of it, in
    the frame of a. closure : whether it closes a loop, and may be wrong.
    """

    a: int
    b: int
    motion: FloatArray
    covariance: FloatArray
    closure: bool = False


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
    """

    def __init__(self) -> None:
        self.edges: list[Edge] = []
        self._poses = GrowingArray((3,))
        self._isam: Any = None
        self._keys: list[int] = []  # of the nodes the smoother knows, ascending
        self._slots: dict[Edge, int] = {}  # of the edges it knows, by number of their factor
        self._dropped: list[int] = []  # factors it has to forget
        self._keys_made = self._factors_made = 0

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
        except RuntimeError as error:
            raise InputError(f"the edges of the pose graph do not determine its poses: {error}") from None

    def _start(self, pose: FloatArray) -> None:
        import gtsam

        self._isam = gtsam.ISAM2(_isam_parameters())
        size = 3 if planar(pose) else 6
        prior = gtsam.noiseModel.Isotropic.Sigma(size, 1e-6)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        kind = gtsam.PriorFactorPose2 if planar(pose) else gtsam.PriorFactorPose3
        graph.add(kind(0, as_gtsam(pose), prior))
        values.insert(0, as_gtsam(pose))
        self._isam.update(graph, values)
        self._keys, self._keys_made, self._factors_made = [0], 1, 1
        self._slots, self._dropped = {}, []

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
            for number in range(ROUNDS):
                if number == 0:
                    # Nodes wait until a closure needs them: alone they change nothing.
                    yield from self._handing_over()
                else:
                    yield SMOOTHING * len(self._keys)
                    self._isam.update()
            self._take(self._isam.calculateEstimate(), self._keys)
        except RuntimeError:
            # Rounding made the increment singular; everything at once is slower and sound.
            self.settle()

    def take_out(self, number: FloatArray, edges: list[Edge], renumbered: list[Edge]) -> None:
        """Keep the nodes with a new number, in order; `number` (N,) is -1 of the others.

        edges : of what is left, those that were there before being the same objects. renumbered : the same by the new
        numbers. The smoother learns of it with the next closure: it forgets factors, and nodes without any.
        """
        known = {
            new: self._slots.pop(old)
            for old, new in zip(edges, renumbered, strict=True)
            if old in self._slots
        }
        self._dropped += self._slots.values()
        self._slots = known
        self._keys = [key for node, key in enumerate(self._keys) if number[node] >= 0]
        self._set(self.poses[number >= 0])
        self.edges = renumbered

    def _handing_over(self) -> Steps[None]:
        """Tell the smoother of nodes and edges it does not know, and of those that are gone."""
        import gtsam

        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for pose in self.poses[len(self._keys) :]:
            values.insert(self._keys_made, as_gtsam(pose))
            self._keys.append(self._keys_made)
            self._keys_made += 1
        new = [edge for edge in self.edges if edge not in self._slots]
        for number, edge in enumerate(new):
            if number % HANDED == 0:
                yield FACTOR * HANDED
            graph.add(factor(edge, False, self._keys))
            self._slots[edge] = self._factors_made
            self._factors_made += 1
        yield SMOOTHING * len(self._keys)
        dropped, self._dropped = self._dropped, []
        self._isam.update(graph, values, dropped)

    def settle(self, without: set[int] | None = None) -> None:
        import gtsam

        if without:
            self.edges = [edge for number, edge in enumerate(self.edges) if number not in without]
        for robust in (False, True):
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            first = self.poses[0]
            kind = gtsam.PriorFactorPose2 if planar(first) else gtsam.PriorFactorPose3
            prior = gtsam.noiseModel.Isotropic.Sigma(3 if planar(first) else 6, 1e-6)
            graph.add(kind(0, as_gtsam(first), prior))
            for edge in self.edges:
                graph.add(factor(edge, robust and edge.closure))
            for node, pose in enumerate(self.poses):
                values.insert(node, as_gtsam(pose))
            parameters = gtsam.LevenbergMarquardtParams()
            parameters.setMaxIterations(30)
            optimizer = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters)
            self._take(optimizer.optimize(), range(len(self._poses)))
        self._restart()

    def _restart(self) -> None:
        """Hand the smoother everything afresh, from where the poses are now."""
        self._start(self.poses[0])
        at_once(self._handing_over())

    def _take(self, values: Any, keys: Sequence[int]) -> None:
        """The poses of the first nodes, by their keys; those that came since hang on the last of them."""
        import gtsam

        poses = self.poses.copy()
        if planar(poses):
            poses[: len(keys)] = gtsam.utilities.extractPose2(values)
        else:
            poses[: len(keys)] = [values.atPose3(key).matrix() for key in keys]
        for node in range(len(keys), len(poses)):
            poses[node] = compose(poses[node - 1], motion(self.poses[node - 1], self.poses[node]))
        self._set(poses)


def residuals(edges: list[Edge], poses: FloatArray) -> FloatArray:
    """Mahalanobis distance squared of each edge, (M,)."""
    squares = np.empty(len(edges))
    for k, edge in enumerate(edges):
        off = motion(edge.motion, motion(poses[edge.a], poses[edge.b]))
        error = off.copy() if planar(off) else np.concatenate((off[:3, 3], _rotation_vector(off)))
        B = rotation(edge.motion)
        squares[k] = error @ np.linalg.solve(B.T @ edge.covariance @ B, error)
    return squares


def as_gtsam(pose: FloatArray) -> Any:
    import gtsam

    if planar(pose):
        return gtsam.Pose2(float(pose[0]), float(pose[1]), float(pose[2]))
    return gtsam.Pose3(gtsam.Rot3(pose[:3, :3]), pose[:3, 3])


def factor(edge: Edge, robust: bool, keys: Sequence[int] | None = None) -> Any:
    """gtsam's factor of an edge; `keys` : of its nodes, their numbers if None.

    Its errors are in the frame the motion ends in, rotation first in space.
    """
    import gtsam

    B = rotation(edge.motion)
    covariance = B.T @ edge.covariance @ B
    if not planar(edge.motion):
        order = [3, 4, 5, 0, 1, 2]
        covariance = covariance[np.ix_(order, order)]
    noise: Any = gtsam.noiseModel.Gaussian.Covariance(0.5 * (covariance + covariance.T))
    if robust:
        noise = gtsam.noiseModel.Robust.Create(gtsam.noiseModel.mEstimator.Cauchy.Create(ROBUST), noise)
    kind = gtsam.BetweenFactorPose2 if planar(edge.motion) else gtsam.BetweenFactorPose3
    a, b = (edge.a, edge.b) if keys is None else (keys[edge.a], keys[edge.b])
    return kind(a, b, as_gtsam(edge.motion), noise)


def _isam_parameters() -> Any:
    import gtsam

    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(0.01)
    parameters.relinearizeSkip = 1
    return parameters


def _rotation_vector(pose: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(pose[:3, :3]).as_rotvec())
