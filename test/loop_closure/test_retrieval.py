"""Candidates of a long history: against brute force, and as the history grows."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from evaluation.loops.place_training import learn_embedding
from loop_closure.places.retrieval import Embedding, NearestPlaces


def along_a_walk(count: int, dimension: int = 8) -> np.ndarray:
    """Vectors that change slowly, as those of places along a path do."""
    rng = np.random.default_rng(0)
    return (np.cumsum(rng.normal(size=(count, dimension)), axis=0) / 6.0).astype(np.float32)


def test_few_vectors_are_found_exactly() -> None:
    vectors = along_a_walk(500)
    index = NearestPlaces(8, smallest=1000)
    assert [index.add(vector) for vector in vectors] == list(range(500))
    for query in vectors[::50] + 0.1:
        apart = np.linalg.norm(vectors - query, axis=1)
        np.testing.assert_array_equal(index.query(query, 20), np.argsort(apart, kind="stable")[:20])
    assert len(index.query(vectors[0], 10_000)) == 500


def test_nearly_all_of_the_nearest_of_many_are_found_from_a_part_of_them() -> None:
    vectors = along_a_walk(20_000)
    index = NearestPlaces(8, probed=24)
    for vector in vectors:
        index.add(vector)
    found = looked = 0
    for query in vectors[::400] + 0.1:
        exact = np.argsort(np.linalg.norm(vectors - query, axis=1), kind="stable")[:50]
        near = index._near(query, 50)
        looked += len(near)
        found += len(np.intersect1d(exact, index.query(query, 50)))
    assert found / (50 * 50) > 0.95
    assert looked / 50 < 0.35 * 20_000


def test_what_was_added_since_the_cells_were_made_is_found() -> None:
    vectors = along_a_walk(3000)
    index = NearestPlaces(8, smallest=2000)
    for vector in vectors:
        index.add(vector)
        if len(index) > 2000:
            assert index.query(vector, 1)[0] == len(index) - 1
    assert index.nbytes < 3000 * (4 * 8 + 8) + 10_000


def test_the_metric_ignores_what_varies_within_a_place() -> None:
    rng = np.random.default_rng(0)
    same = np.repeat([1, 0], 500)
    differences = rng.normal(size=(1000, 5)) * np.where(
        same[:, None] == 1, [0.1, 3, 3, 3, 3], [3, 3, 3, 3, 3]
    )
    embedding = learn_embedding(differences, same, 2)
    strength = np.abs(embedding.matrix)
    assert strength[0].argmax() == 0
    assert strength[0, 0] > 5 * strength[0, 1:].max()
    again = Embedding.from_dict(embedding.to_dict())
    np.testing.assert_allclose(again.matrix, embedding.matrix, rtol=1e-5)


def test_wrong_input_is_refused() -> None:
    with pytest.raises(InputError, match="shape"):
        NearestPlaces(4).add(np.zeros(3))
    with pytest.raises(InputError, match="both classes"):
        learn_embedding(np.ones((4, 3)), np.ones(4))
    with pytest.raises(InputError, match="dimension"):
        learn_embedding(np.ones((4, 3)), np.array([0, 1, 0, 1]), 4)
    with pytest.raises(InputError, match="embedding"):
        Embedding.from_dict({})
