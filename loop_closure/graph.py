"""The trajectory as a pose graph, smoothed by gtsam: what the filter in `esdf` does, without linearising for good.

Nodes are keyframes in the order they were taken; every node but the first hangs on the one before it by odometry.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from loop_closure.motions import compose, motion, planar, rotation

ROBUST = 3.0  # deviations at which a closure counts half


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
        self._poses: list[FloatArray] = []
        self._isam: Any = None
        self._waiting: list[tuple[Any, Any]] = []  # new factors and initial values of a node
        self._stacked: FloatArray | None = None

    @property
    def poses(self) -> FloatArray:
        if self._stacked is None or len(self._stacked) != len(self._poses):
            self._stacked = np.array(self._poses)
        return self._stacked

    def begin(self, pose: FloatArray) -> None:
        self._poses, self.edges = [pose.copy()], []
        self._start(pose)

    def restore(self, poses: FloatArray, edges: list[Edge]) -> None:
        self._poses, self.edges, self._stacked = [pose.copy() for pose in poses], list(edges), None
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
        self._handed = 1  # nodes the smoother knows

    def extend(self, step: FloatArray, covariance: FloatArray) -> int:
        node = len(self._poses)
        self.edges.append(Edge(node - 1, node, step, covariance))
        self._poses.append(compose(self._poses[-1], step))
        self._stacked = None
        return node

    def close(self, edges: list[Edge]) -> None:
        """Closures without a kernel; they were decided on."""
        import gtsam

        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        # Nodes wait until a closure needs them: alone they change nothing.
        for edge in self.edges:
            if not edge.closure and edge.b >= self._handed:
                graph.add(factor(edge, False))
                values.insert(edge.b, as_gtsam(self._poses[edge.b]))
        self._handed = len(self._poses)
        for edge in edges:
            graph.add(factor(edge, False))
        self.edges += edges
        try:
            self._isam.update(graph, values)
            for _ in range(2):
                self._isam.update()
            self._take(self._isam.calculateEstimate())
        except RuntimeError:
            # Rounding made the increment singular; everything at once is slower and sound.
            self.settle()

    def settle(self, without: set[int] | None = None) -> None:
        import gtsam

        if without:
            self.edges = [edge for number, edge in enumerate(self.edges) if number not in without]
        for robust in (False, True):
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            first = self._poses[0]
            kind = gtsam.PriorFactorPose2 if planar(first) else gtsam.PriorFactorPose3
            prior = gtsam.noiseModel.Isotropic.Sigma(3 if planar(first) else 6, 1e-6)
            graph.add(kind(0, as_gtsam(first), prior))
            for edge in self.edges:
                graph.add(factor(edge, robust and edge.closure))
            for node, pose in enumerate(self._poses):
                values.insert(node, as_gtsam(pose))
            parameters = gtsam.LevenbergMarquardtParams()
            parameters.setMaxIterations(30)
            self._take(gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize())
        self._restart()

    def _restart(self) -> None:
        """Hand the smoother everything afresh, from where the poses are now."""
        import gtsam

        self._start(self._poses[0])
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for edge in self.edges:
            graph.add(factor(edge, False))
        for node, pose in enumerate(self._poses[1:], start=1):
            values.insert(node, as_gtsam(pose))
        self._isam.update(graph, values)
        self._handed = len(self._poses)

    def _take(self, values: Any) -> None:
        import gtsam

        count = values.size()
        if planar(self._poses[0]):
            found = np.asarray(gtsam.utilities.extractPose2(values))
            self._poses = list(found[:count])
        else:
            self._poses = [values.atPose3(node).matrix() for node in range(count)]
        self._stacked = None


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


def factor(edge: Edge, robust: bool) -> Any:
    """gtsam's factor of an edge. Its errors are in the frame the motion ends in, rotation first in space."""
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
    return kind(edge.a, edge.b, as_gtsam(edge.motion), noise)


def _isam_parameters() -> Any:
    import gtsam

    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(0.01)
    parameters.relinearizeSkip = 1
    return parameters


def _rotation_vector(pose: FloatArray) -> FloatArray:
    from scipy.spatial.transform import Rotation

    return np.asarray(Rotation.from_matrix(pose[:3, :3]).as_rotvec())
