"""The topological map: each of its four steps on hand-made points, and a comparison with a plain rewrite."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from tracking.prediction.topological_map import TopologicalMap


def line(count: int, step: float = 0.5) -> np.ndarray:
    return np.column_stack((np.arange(count) * step, np.zeros(count)))


def test_points_far_from_all_nodes_found_new_ones() -> None:
    places = TopologicalMap(1.0)
    places.insert([[0.0, 0.0], [3.0, 0.0], [6.0, 0.0]])
    assert len(places) == 3
    assert places.edges == [(0, 1), (1, 2)]


def test_points_close_to_a_node_move_it_to_their_mean() -> None:
    places = TopologicalMap(1.0)
    places.insert([[0.0, 0.0], [3.0, 0.0], [0.3, 0.3], [-0.3, 0.3]])
    assert len(places) == 2
    np.testing.assert_allclose(places.positions[0], [0.0, 0.2])


def test_edge_whose_thales_sphere_holds_the_second_node_is_removed() -> None:
    places = TopologicalMap(1.0)
    places.insert([[0.0, 0.0], [4.0, 0.0]])
    # Between the two: the long edge gives way to two short ones.
    places.insert([[0.1, 0.0], [-2.0, 0.0], [0.0, 0.0], [2.05, 1.5]])
    for i, j in places.edges:
        a, b = places.positions[i], places.positions[j]
        assert np.hypot(*(a - b)) < 4.5


def test_nodes_that_come_close_are_merged() -> None:
    places = TopologicalMap(1.0, window=3)
    places.insert([[0.0, 0.0], [1.1, 0.0]])
    changes = places.insert([[0.6, 0.0]] * 3 + [[0.25, 0.0]] * 3)
    assert changes.merged
    gone, kept = changes.merged[0]
    assert gone not in places.neighbours
    assert kept in places.neighbours
    assert np.isinf(places.positions[gone]).all()


def test_only_the_latest_points_of_a_node_count() -> None:
    places = TopologicalMap(2.0, window=4)
    places.insert([[0.0, 0.0], [5.0, 0.0], *([[0.4, 0.0]] * 4)])
    np.testing.assert_allclose(places.positions[0], [0.4, 0.0])
    assert len(places.points(0)) == 4


def test_map_is_consistent_after_random_walks() -> None:
    rng = np.random.default_rng(3)
    places = TopologicalMap(0.8, window=20)
    for _ in range(40):
        places.insert(rng.uniform(0, 10, 2) + np.cumsum(rng.normal(0, 0.25, (60, 2)), axis=0))
    alive = set(places.nodes.tolist())
    assert set(places.neighbours) == alive
    for node, linked in places.neighbours.items():
        assert linked <= alive - {node}
        assert all(node in places.neighbours[other] for other in linked)
        np.testing.assert_allclose(places.positions[node], places.points(node).mean(axis=0))
    asked = rng.uniform(0, 10, (50, 2))
    away = np.linalg.norm(asked[:, None] - places.positions[places.nodes][None], axis=2)
    np.testing.assert_array_equal(places.nearest(asked), places.nodes[away.argmin(axis=1)])


def test_size_does_not_depend_on_how_often_a_way_is_walked() -> None:
    places = TopologicalMap(0.7)
    for k in range(30):
        places.insert(line(40, 0.3) + np.array([0.0, 0.02 * (k % 3)]))
    assert len(places) <= 12.0 / 0.35


def test_covariance_is_scaled_and_has_a_floor() -> None:
    places = TopologicalMap(1.0)
    rng = np.random.default_rng(0)
    places.insert([[0.0, 0.0], [9.0, 0.0]])
    places.insert(rng.normal(0, [0.2, 0.001], (90, 2)))
    covariance = places.covariance(0, 1.0, 0.15**2)
    assert covariance[0, 0] == pytest.approx(0.04, rel=0.4)
    assert np.linalg.eigvalsh(covariance).min() >= 0.15**2 - 1e-12
    np.testing.assert_allclose(places.covariance(0, 4.0, 1e-9), 4.0 * places.covariance(0, 1.0, 1e-9))


def test_bad_input_is_named() -> None:
    with pytest.raises(InputError, match="resolution"):
        TopologicalMap(0.0)
    with pytest.raises(InputError, match="points"):
        TopologicalMap(1.0).insert([[np.nan, 0.0]])
    with pytest.raises(InputError, match="empty"):
        TopologicalMap(1.0).nearest([[0.0, 0.0]])
