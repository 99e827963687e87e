"""Message passing against every labelling of tiny problems, and against exact inference on chains."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.testing import assert_allclose

from registration.crf.exact import map_states, marginals
from registration.crf.inference import exhaustive
from registration.crf.max_product import beliefs, flood, no_messages, states_of, sweep
from registration.crf.potentials import Potentials


def potentials(rng: np.random.Generator, n: int, k: int, d: int, link: float = 1.0) -> Potentials:
    """Random potentials of n points with k association and d clustering states, some of them missing."""
    association = rng.normal(size=(n, k))
    association[:, 0] = np.where(rng.random(n) < 0.3, -np.inf, association[:, 0])
    return Potentials(
        association,
        rng.normal(size=(n, d)),
        link * rng.normal(size=(n, d, k)),
        rng.normal(size=(n - 1, k, k)),
        rng.normal(size=(n - 1, d, d)),
    )


@pytest.mark.parametrize("seed", range(6))
def test_exact_schedule_finds_the_best_of_all_labellings(seed: int) -> None:
    made = potentials(np.random.default_rng(seed), 4, 3, 2)
    _, _, best = exhaustive(made)
    assert_allclose(made.score(*map_states(made)), best)


def test_marginals_are_those_of_all_labellings() -> None:
    made = potentials(np.random.default_rng(3), 3, 3, 2)
    nodes, totals = np.zeros((3, 2, 3)), 0.0
    pairs = np.zeros((2, 2, 2))
    for labels in itertools.product(range(6), repeat=3):
        associations, clusters = np.array(labels) % 3, np.array(labels) // 3
        weight = np.exp(made.score(associations, clusters))
        totals += weight
        nodes[np.arange(3), clusters, associations] += weight
        pairs[np.arange(2), clusters[:-1], clusters[1:]] += weight
    found, _, found_pairs, normaliser = marginals(made)
    assert_allclose(found, nodes / totals, atol=1e-9)
    assert_allclose(found_pairs, pairs / totals, atol=1e-9)
    assert_allclose(normaliser, np.log(totals))


def test_messages_are_exact_on_a_single_chain() -> None:
    rng = np.random.default_rng(5)
    local, edges = rng.normal(size=(7, 3)), rng.normal(size=(6, 3, 3))
    best = np.full((7, 3), -np.inf)
    for labels in itertools.product(range(3), repeat=7):
        chosen = np.array(labels)
        score = local[np.arange(7), chosen].sum() + edges[np.arange(6), chosen[:-1], chosen[1:]].sum()
        best[np.arange(7), chosen] = np.maximum(best[np.arange(7), chosen], score)
    found = beliefs(local, edges)
    assert_allclose(
        found - found.max(axis=1, keepdims=True), best - best.max(axis=1, keepdims=True), atol=1e-9
    )


@pytest.mark.parametrize("schedule", ["sweep", "flooding"])
def test_schedules_are_exact_where_the_chains_are_not_linked(schedule: str) -> None:
    made = potentials(np.random.default_rng(8), 12, 4, 3, link=0.0)
    pair = sweep(made, no_messages(made)) if schedule == "sweep" else flood(made)[:2]
    found = states_of(*pair)
    assert_allclose(made.score(*found), made.score(*map_states(made)))


def test_loopy_schedules_come_near_the_exact_map() -> None:
    gaps: dict[str, list[float]] = {"sweep": [], "flooding": []}
    for seed in range(20):
        made = potentials(np.random.default_rng(seed), 20, 4, 3, link=0.5)
        best = made.score(*map_states(made))
        messages = no_messages(made)
        for _ in range(20):
            swept = states_of(*sweep(made, messages))
        gaps["sweep"].append(best - made.score(*swept))
        gaps["flooding"].append(best - made.score(*states_of(*flood(made)[:2])))
    for every in gaps.values():
        assert min(every) > -1e-9
        assert np.median(every) < 0.5
