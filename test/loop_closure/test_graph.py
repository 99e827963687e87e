"""Back ends against a full-covariance EKF, against each other, and uncertainty along paths against first order."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse.csgraph import dijkstra

from estimation.geometry.poses import (
    between,
    between_jacobians,
    compound,
    compound_covariance,
    compound_jacobians,
    pose_to_matrix,
)
from loop_closure.graph.edges import Edge
from loop_closure.graph.esdf import EsdfGraph
from loop_closure.graph.pose_graph import SmoothedGraph, residuals
from loop_closure.graph.smoother import News, Smoother
from loop_closure.graph.uncertainty import Uncertainty


class FullEkf:
    """Delayed-state EKF with a dense covariance: what the information filter has to equal."""

    def __init__(self, start: np.ndarray) -> None:
        self.mean, self.P = start.copy(), 1e-8 * np.eye(3)

    def extend(self, u: np.ndarray, Q: np.ndarray) -> None:
        last, n = self.mean[-3:], len(self.mean)
        J1, J2 = compound_jacobians(last, u)
        F = np.zeros((3, n))
        F[:, -3:] = J1
        made = compound(last, u)
        made[2] = last[2] + u[2]
        self.P = np.block([[self.P, self.P @ F.T], [F @ self.P, F @ self.P @ F.T + J2 @ Q @ J2.T]])
        self.mean = np.concatenate((self.mean, made))

    def measure(self, i: int, j: int, z: np.ndarray, R: np.ndarray) -> None:
        H = np.zeros((3, len(self.mean)))
        a, b = self.mean[3 * i : 3 * i + 3], self.mean[3 * j : 3 * j + 3]
        H[:, 3 * i : 3 * i + 3], H[:, 3 * j : 3 * j + 3] = between_jacobians(a, b)
        v = z - between(a, b)
        v[2] = np.arctan2(np.sin(v[2]), np.cos(v[2]))
        K = self.P @ H.T @ np.linalg.inv(H @ self.P @ H.T + R)
        self.mean = self.mean + K @ v
        self.P = (np.eye(len(self.mean)) - K @ H) @ self.P


def circle(rng: np.random.Generator, count: int) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray]]]:
    """True poses twice around a circle, and noisy steps with their covariance."""
    step = np.array([1.0, 0.0, 4.0 * np.pi / count])
    truth = [np.array([0.5, -1.0, 3.0])]
    steps = []
    for _ in range(count - 1):
        truth.append(compound(truth[-1], step))
        A = 0.01 * rng.standard_normal((3, 3))
        Q = A @ A.T + np.diag([1e-4, 1e-4, 1e-5])
        steps.append((step + rng.multivariate_normal(np.zeros(3), Q), Q))
    return np.array(truth), steps


def test_the_information_filter_equals_the_dense_filter() -> None:
    rng = np.random.default_rng(4)
    truth, steps = circle(rng, 24)
    esdf, ekf = EsdfGraph(), FullEkf(truth[0])
    esdf.begin(truth[0])
    for k, (u, Q) in enumerate(steps, start=1):
        esdf.extend(u, Q)
        ekf.extend(u, Q)
        if k >= 12:
            R = np.diag([2e-4, 3e-4, 5e-5])
            z = between(truth[k - 12], truth[k]) + rng.multivariate_normal(np.zeros(3), R)
            esdf.close([Edge(k - 12, k, z, R, True)])
            ekf.measure(k - 12, k, z, R)
    np.testing.assert_allclose(esdf.mean.ravel(), ekf.mean, atol=1e-6)
    np.testing.assert_allclose(np.linalg.inv(esdf.information.toarray()), ekf.P, atol=1e-7)


def test_the_information_matrix_is_exactly_sparse() -> None:
    rng = np.random.default_rng(5)
    truth, steps = circle(rng, 40)
    esdf = EsdfGraph()
    esdf.begin(truth[0])
    for u, Q in steps:
        esdf.extend(u, Q)
    esdf.close([Edge(3, 30, between(truth[3], truth[30]), 1e-4 * np.eye(3), True)])
    blocks = np.abs(esdf.information.toarray()).reshape(40, 3, 40, 3).max(axis=(1, 3)) > 0.0
    expected = np.abs(np.subtract.outer(np.arange(40), np.arange(40))) <= 1
    expected[3, 30] = expected[30, 3] = True
    np.testing.assert_array_equal(blocks, expected)


def spatial_problem(rng: np.random.Generator) -> tuple[np.ndarray, list[np.ndarray]]:
    step = pose_to_matrix(np.array([1.0, 0.0, 0.02, 0.01, -0.01, 0.3]))
    truth = [np.eye(4)]
    noisy = []
    for _ in range(30):
        truth.append(truth[-1] @ step)
        noisy.append(step @ pose_to_matrix(rng.normal(0.0, [0.02, 0.02, 0.02, 0.004, 0.004, 0.004])))
    return np.array(truth), noisy


@pytest.mark.parametrize("kind", [SmoothedGraph, EsdfGraph])
@pytest.mark.parametrize("spatial", [False, True])
def test_a_closed_loop_removes_drift(kind: type, spatial: bool) -> None:
    rng = np.random.default_rng(6)
    if spatial:
        truth, steps = spatial_problem(rng)
        Q, R = np.diag([4e-4] * 3 + [1.6e-5] * 3), 1e-6 * np.eye(6)
        where = truth[:, :3, 3]
        closures = [Edge(0, 21, np.linalg.inv(truth[0]) @ truth[21], R, True)]
    else:
        truth, drawn = circle(rng, 40)
        steps, Q, R = [u for u, _ in drawn], np.diag([3e-4, 3e-4, 3e-5]), 1e-6 * np.eye(3)
        where = truth[:, :2]
        closures = [Edge(0, 20, between(truth[0], truth[20]), R, True)]
    graph = kind()
    graph.begin(truth[0])
    for u in steps:
        graph.extend(u, Q)
    size = where.shape[1]
    place = (lambda p: p[:, :2]) if size == 2 else (lambda p: p[:, :3, 3])
    before = np.linalg.norm(place(graph.poses) - where, axis=1)[closures[0].b]
    graph.close(closures)
    graph.settle()
    after = np.linalg.norm(place(graph.poses) - where, axis=1)[closures[0].b]
    assert before > 0.02
    assert after < 0.01
    assert residuals(closures, graph.poses)[0] < 25.0


def test_filter_and_smoother_agree_where_little_is_nonlinear() -> None:
    rng = np.random.default_rng(7)
    truth, steps = circle(rng, 40)
    graphs = [SmoothedGraph(), EsdfGraph()]
    for graph in graphs:
        graph.begin(truth[0])
        for u, Q in steps:
            graph.extend(u, Q)
        graph.close([Edge(0, 20, between(truth[0], truth[20]), 1e-4 * np.eye(3), True)])
        graph.settle()
    np.testing.assert_allclose(graphs[0].poses[:, :2], graphs[1].poses[:, :2], atol=0.02)


def test_edges_that_are_left_out_have_no_effect() -> None:
    rng = np.random.default_rng(8)
    truth, steps = circle(rng, 30)
    good = Edge(0, 15, between(truth[0], truth[15]), 1e-4 * np.eye(3), True)
    wrong = Edge(2, 20, np.array([3.0, 1.0, 0.5]), 1e-4 * np.eye(3), True)
    for kind in (SmoothedGraph, EsdfGraph):
        outcomes = []
        for closures, without in (([good], None), ([good, wrong], {len(steps) + 1})):
            graph = kind()
            graph.begin(truth[0])
            for u, Q in steps:
                graph.extend(u, Q)
            graph.close(closures)
            graph.settle(without)
            outcomes.append(graph.poses)
        np.testing.assert_allclose(outcomes[0], outcomes[1], atol=0.01)


def test_uncertainty_along_a_chain_is_that_of_compounding() -> None:
    rng = np.random.default_rng(9)
    poses, edges = [np.zeros(3)], []
    Q = np.diag([1e-4, 1e-4, 4e-6])
    for k in range(30):
        step = np.array([rng.uniform(0.3, 1.0), 0.0, rng.uniform(-0.4, 0.4)])
        poses.append(compound(poses[-1], step))
        edges.append(Edge(k, k + 1, step, Q))
    uncertainty = Uncertainty()
    uncertainty.learn(edges)
    sigma, turn = uncertainty.around(np.array(poses), 0)
    P = np.zeros((3, 3))
    at = np.zeros(3)
    for edge in edges:
        P = compound_covariance(at, P, edge.motion, edge.covariance)
        at = compound(at, edge.motion)
    # Both axes' position noise counts in full, and a step's own length beyond its turn is neglected.
    assert turn[-1] == pytest.approx(np.sqrt(P[2, 2]), rel=1e-6)
    assert 0.5 * np.sqrt(np.trace(P[:2, :2])) < sigma[-1] < 1.2 * np.sqrt(np.trace(P[:2, :2]))
    assert sigma[0] == 0.0


def test_uncertainty_goes_by_the_shortest_path_and_by_the_better_of_two_edges() -> None:
    """Turn errors aside, the variance of a place is the length of the shortest path, as scipy finds it."""
    rng = np.random.default_rng(4)
    count = 40
    pairs = {(k, k + 1) for k in range(count - 1)}
    pairs |= {(int(a), int(b)) for a, b in np.sort(rng.integers(0, count, (60, 2)), axis=1) if a < b}
    edges, weights = [], np.zeros((count, count))
    for a, b in sorted(pairs, key=lambda pair: (pair[1], pair[0])):
        variances = rng.uniform(0.01, 1.0, 2)
        weights[a, b] = variances.min()
        edges += [Edge(a, b, np.zeros(3), np.diag([v, v, 1e-12]), b > a + 1) for v in variances]
    uncertainty = Uncertainty()
    uncertainty.learn(edges, 30)
    uncertainty.learn(edges)
    for node in (0, 17, count - 1):
        sigma, _ = uncertainty.around(np.zeros((count, 3)), node)
        np.testing.assert_allclose(sigma**2, dijkstra(weights, directed=False, indices=node), rtol=1e-6)
    sigma, turn = uncertainty.around(np.zeros((count + 1, 3)), 0)
    assert np.isinf(sigma[count])
    assert np.isinf(turn[count])


def test_what_cannot_be_smoothed_in_steps_is_settled_and_smoothed_with_the_next_closure(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    truth, steps = circle(np.random.default_rng(5), 40)
    failing, sound = SmoothedGraph(), SmoothedGraph()
    learn, failures = Smoother.learn, []

    def fails_twice(smoother: Smoother, news: News) -> None:
        if failing._smoother is smoother and len(failures) < 2:
            failures.append(len(news.edges))
            raise RuntimeError("Indeterminate linear system")
        learn(smoother, news)

    monkeypatch.setattr(Smoother, "learn", fails_twice)
    for graph in (failing, sound):
        graph.begin(truth[0])
        for k, (step, covariance) in enumerate(steps, start=1):
            graph.extend(step, covariance)
            if k >= 20 and k % 10 == 0:
                relative = between(truth[k - 20], truth[k])
                graph.close([Edge(k - 20, k, relative, 1e-4 * np.eye(3), True)])
        graph.settle()
    assert len(failures) == 2
    np.testing.assert_allclose(failing.poses, sound.poses, atol=1e-3)
