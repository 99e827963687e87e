"""gtsam's part of smoothing: iSAM2 over nodes and edges by key, and Levenberg-Marquardt over everything at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from loop_closure.graph.edges import Edge
from loop_closure.motions import planar, rotation

ROBUST = 3.0  # deviations at which a closure counts half


@dataclass(frozen=True, eq=False)
class News:
    """What a smoother does not know yet.

    keys : of new nodes, with their poses. ends : keys of the two nodes of each new edge. forgotten : numbers of edges,
    in the order they were told, to be forgotten.
    """

    keys: list[int]
    poses: list[FloatArray]
    ends: list[tuple[int, int]]
    edges: list[Edge]
    forgotten: list[int]


class Smoother:
    """Incremental smoothing in this process. Raises RuntimeError where rounding makes a step singular."""

    def __init__(self) -> None:
        self._isam: Any = None
        self._spatial = False

    def begin(self, pose: FloatArray) -> None:
        """Forget everything; node 0 stays at `pose`."""
        import gtsam

        self._isam = gtsam.ISAM2(_isam_parameters())
        self._spatial = not planar(pose)
        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        graph.add(_prior(pose))
        values.insert(0, as_gtsam(pose))
        self._isam.update(graph, values)

    def learn(self, news: News) -> None:
        """Take in nodes and edges, and smooth once."""
        import gtsam

        graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
        for key, pose in zip(news.keys, news.poses, strict=True):
            values.insert(key, as_gtsam(pose))
        for ends, edge in zip(news.ends, news.edges, strict=True):
            graph.add(factor(edge, False, ends))
        # The prior of node 0 is the first factor.
        self._isam.update(graph, values, [number + 1 for number in news.forgotten])

    def smooth(self) -> None:
        """Once more."""
        self._isam.update()

    def estimate(self) -> FloatArray:
        """Poses (N, 3) or (N, 4, 4) of the nodes that are left, by ascending key."""
        return _poses(self._isam.calculateEstimate(), self._spatial)

    def settled(self, poses: FloatArray, edges: Sequence[Edge]) -> FloatArray:
        """The best estimate of all `poses` from `edges`: first without kernels, then with those of closures."""
        import gtsam

        for robust in (False, True):
            graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
            graph.add(_prior(poses[0]))
            for edge in edges:
                graph.add(factor(edge, robust and edge.closure))
            for node, pose in enumerate(poses):
                values.insert(node, as_gtsam(pose))
            parameters = gtsam.LevenbergMarquardtParams()
            parameters.setMaxIterations(30)
            found = gtsam.LevenbergMarquardtOptimizer(graph, values, parameters).optimize()
            poses = _poses(found, not planar(poses))
        return poses


def _prior(pose: FloatArray) -> Any:
    import gtsam

    kind, size = (gtsam.PriorFactorPose2, 3) if planar(pose) else (gtsam.PriorFactorPose3, 6)
    return kind(0, as_gtsam(pose), gtsam.noiseModel.Isotropic.Sigma(size, 1e-6))


def _poses(values: Any, spatial: bool) -> FloatArray:
    import gtsam

    if spatial:
        keys = values.keys()
        return np.array([values.atPose3(key).matrix() for key in keys])
    return np.asarray(gtsam.utilities.extractPose2(values))


def as_gtsam(pose: FloatArray) -> Any:
    """gtsam's pose of (3,) or (4, 4)."""
    import gtsam

    if planar(pose):
        return gtsam.Pose2(float(pose[0]), float(pose[1]), float(pose[2]))
    return gtsam.Pose3(gtsam.Rot3(pose[:3, :3]), pose[:3, 3])


def factor(edge: Edge, robust: bool, ends: tuple[int, int] | None = None) -> Any:
    """gtsam's factor of an edge. ends : keys of its nodes, their numbers if None.

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
    a, b = (edge.a, edge.b) if ends is None else ends
    return kind(a, b, as_gtsam(edge.motion), noise)


def _isam_parameters() -> Any:
    import gtsam

    parameters = gtsam.ISAM2Params()
    parameters.setRelinearizeThreshold(0.01)
    parameters.relinearizeSkip = 1
    return parameters
