"""Nodes taken out of a graph: what is left says the same of the others, against gtsam's marginals of the whole."""

from __future__ import annotations

import gtsam
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimation.geometry.poses import between, compound
from loop_closure.graph.edges import Edge
from loop_closure.graph.marginal import DEGREE, averaged, joined, renumbered, turned_round, without
from loop_closure.graph.smoother import as_gtsam, factor
from loop_closure.motions import compose, invert, motion


def solved(edges: list[Edge], start: dict[int, np.ndarray]) -> tuple[dict[int, np.ndarray], gtsam.Marginals]:
    """Estimate with the first node held, and its marginals, by gtsam."""
    graph, values = gtsam.NonlinearFactorGraph(), gtsam.Values()
    graph.add(gtsam.PriorFactorPose2(0, as_gtsam(start[0]), gtsam.noiseModel.Isotropic.Sigma(3, 1e-6)))
    for edge in edges:
        graph.add(factor(edge, False))
    for node, pose in start.items():
        values.insert(node, as_gtsam(pose))
    found = gtsam.LevenbergMarquardtOptimizer(graph, values).optimize()
    poses = {node: np.array([(p := found.atPose2(node)).x(), p.y(), p.theta()]) for node in start}
    return poses, gtsam.Marginals(graph, found)


def walk(count: int, seed: int) -> tuple[np.ndarray, list[Edge]]:
    """A path of nodes and its noisy steps."""
    rng = np.random.default_rng(seed)
    poses, edges = [np.zeros(3)], []
    for k in range(1, count):
        poses.append(compound(poses[-1], np.array([0.5, 0.0, 0.3])))
        edges.append(measured(np.array(poses), k - 1, k, rng, False))
    return np.array(poses), edges


def measured(poses: np.ndarray, a: int, b: int, rng: np.random.Generator, closure: bool) -> Edge:
    root = np.diag([0.01, 0.02, 0.005]) @ (np.eye(3) + 0.2 * rng.standard_normal((3, 3)))
    step = between(poses[a], poses[b])
    return Edge(a, b, step + 0.3 * root @ rng.standard_normal(3), root @ root.T, closure)


def test_a_node_between_two_leaves_exactly_what_it_said() -> None:
    poses, edges = walk(12, 0)
    edges.append(measured(poses, 0, 11, np.random.default_rng(1), True))
    gone = [3, 4, 8]
    less = without(edges, gone, len(poses))
    assert len(less) == len(edges) - 3
    whole, wide = solved(edges, dict(enumerate(poses)))
    left = {k: pose for k, pose in enumerate(poses) if k not in gone}
    part, narrow = solved(less, left)
    for k in list(left)[1:]:
        np.testing.assert_allclose(part[k], whole[k], atol=2e-4)
        np.testing.assert_allclose(
            narrow.marginalCovariance(k), wide.marginalCovariance(k), rtol=0.03, atol=1e-9
        )


def test_rounds_through_a_known_place_go_on_sharpening_it() -> None:
    rng = np.random.default_rng(2)
    first, edges = walk(20, 3)
    poses = np.vstack([first, first, first])
    for lap in (1, 2):
        start = 20 * lap
        edges.append(measured(poses, start - 1, start, rng, False))
        edges += [measured(poses, k - 1, k, rng, False) for k in range(start + 1, start + 20)]
        edges += [measured(poses, k, start + k, rng, True) for k in range(0, 20, 2)]
    less = without(edges, range(20, 60), 60)
    assert {node for edge in less for node in (edge.a, edge.b)} == set(range(20))
    assert len(less) <= DEGREE * 20
    whole, wide = solved(edges, dict(enumerate(poses)))
    part, narrow = solved(less, dict(enumerate(first)))
    _, alone = solved(edges[:19], dict(enumerate(first)))
    for k in range(1, 20):
        np.testing.assert_allclose(part[k], whole[k], atol=0.012)
        ratio = np.trace(narrow.marginalCovariance(k)) / np.trace(wide.marginalCovariance(k))
        assert 0.4 < ratio < 2.5
    assert np.trace(narrow.marginalCovariance(19)) < 0.5 * np.trace(alone.marginalCovariance(19))


def spatial_edge(a: int, b: int, rng: np.random.Generator) -> tuple[Edge, np.ndarray]:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec(rng.normal(0.0, 0.8, 3)).as_matrix()
    pose[:3, 3] = rng.normal(0.0, 2.0, 3)
    root = 1e-3 * rng.standard_normal((6, 6))
    return Edge(a, b, pose, root @ root.T), root


def shaken(pose: np.ndarray, by: np.ndarray) -> np.ndarray:
    """A motion that is off by `by` (6,), in the frame it starts from."""
    out = pose.copy()
    out[:3, :3] = Rotation.from_rotvec(by[3:]).as_matrix() @ pose[:3, :3]
    out[:3, 3] += by[:3]
    return out


def off(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    turn = Rotation.from_matrix(b[:3, :3] @ a[:3, :3].T).as_rotvec()
    return np.concatenate((b[:3, 3] - a[:3, 3], turn))


def test_covariances_of_edges_there_back_and_joined_are_those_of_samples() -> None:
    rng = np.random.default_rng(4)
    (one, first), (two, second) = spatial_edge(0, 1, rng), spatial_edge(1, 2, rng)
    back, way = turned_round(one), joined(one, two)
    returns, ways = [], []
    for _ in range(4000):
        a, b = (
            shaken(one.motion, first @ rng.standard_normal(6)),
            shaken(two.motion, second @ rng.standard_normal(6)),
        )
        returns.append(off(back.motion, invert(a)))
        ways.append(off(way.motion, compose(a, b)))
    for edge, samples in ((back, returns), (way, ways)):
        scale = np.sqrt(np.outer(*[np.diag(edge.covariance)] * 2))
        np.testing.assert_allclose(np.cov(np.array(samples).T) / scale, edge.covariance / scale, atol=0.08)
    np.testing.assert_allclose(motion(way.motion, compose(one.motion, two.motion)), np.eye(4), atol=1e-12)
    again = turned_round(back)
    np.testing.assert_allclose(again.covariance, one.covariance, atol=1e-12)


def test_two_looks_are_averaged_by_their_weight_and_contradictions_are_not() -> None:
    tight, loose = np.diag([0.01, 0.01, 0.002]) ** 2, np.diag([0.02, 0.02, 0.004]) ** 2
    one = Edge(0, 1, np.array([1.0, 0.0, np.pi - 0.001]), tight)
    two = Edge(0, 1, np.array([1.02, 0.0, -np.pi + 0.001]), loose)
    mean = averaged(one, two)
    np.testing.assert_allclose(mean.motion, [1.004, 0.0, np.pi - 0.0006], atol=1e-9)
    np.testing.assert_allclose(mean.covariance, np.linalg.inv(np.linalg.inv(tight) + np.linalg.inv(loose)))
    far = Edge(0, 1, np.array([2.0, 0.0, 0.0]), loose)
    assert averaged(far, one) is one
    for _ in range(50):
        one = averaged(one, two)
    # Looks at the same thing share their errors: they never add up to certainty.
    assert np.sqrt(np.diag(one.covariance)) == pytest.approx([0.005, 0.005, 0.001], rel=0.2)


def test_new_numbers() -> None:
    edges = [Edge(0, 2, np.zeros(3), np.eye(3)), Edge(1, 2, np.zeros(3), np.eye(3), True)]
    kept = renumbered(edges, np.array([0, -1, 1]))
    assert [(edge.a, edge.b, edge.closure) for edge in kept] == [(0, 1, False)]
