"""The growing hidden Markov model against enumeration of all state sequences, and its structure."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from tracking.intentions import IntentionConfig
from tracking.intentions.ghmm import GrowingHmm
from tracking.intentions.ghmm_kernels import expected_counts, forward, log_observation


def small_model(seed: int, states: int = 4, nodes: int = 3, steps: int = 5) -> tuple[np.ndarray, ...]:
    """Random sparse model: prior, successors, transitions, log observations, node of each state."""
    rng = np.random.default_rng(seed)
    width = 3
    successors = np.full((states, width), -1)
    transitions = np.zeros((states, width))
    for s in range(states):
        count = rng.integers(1, width + 1)
        successors[s, :count] = rng.choice(states, count, replace=False)
        transitions[s, :count] = rng.dirichlet(np.ones(count))
    log_b = rng.normal(-2.0, 2.0, (steps, nodes))
    return rng.dirichlet(np.ones(states)), successors, transitions, log_b, rng.integers(0, nodes, states)


def enumerated(
    prior: np.ndarray, successors: np.ndarray, transitions: np.ndarray, log_b: np.ndarray, nodes: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """Posterior of states (T, S), expected transitions (S, S) and log-likelihood, summed over all state sequences."""
    steps, states = len(log_b), len(prior)
    full = np.zeros((states, states))
    for i, row in enumerate(successors):
        for j, a in zip(row, transitions[i], strict=True):
            if j >= 0:
                full[i, j] += a
    gamma, xi, total = np.zeros((steps, states)), np.zeros((states, states)), 0.0
    for sequence in itertools.product(range(states), repeat=steps):
        p = prior[sequence[0]]
        for k in range(1, steps):
            p *= full[sequence[k - 1], sequence[k]]
        p *= np.exp(sum(log_b[k, nodes[s]] for k, s in enumerate(sequence)))
        total += p
        for k, s in enumerate(sequence):
            gamma[k, s] += p
        for i, j in itertools.pairwise(sequence):
            xi[i, j] += p
    return gamma / total, xi / total, float(np.log(total))


@pytest.mark.parametrize("seed", range(6))
def test_forward_and_backward_agree_with_enumeration(seed: int) -> None:
    model = small_model(seed)
    _, successors, transitions, log_b, nodes = model
    gamma, xi, log_likelihood = enumerated(*model)
    alpha, scales = forward(*model)
    first, counts = expected_counts(alpha, scales, successors, transitions, log_b, nodes)
    assert scales.sum() == pytest.approx(log_likelihood)
    np.testing.assert_allclose(alpha[-1], gamma[-1], atol=1e-12)
    np.testing.assert_allclose(first, gamma[0], atol=1e-12)
    full = np.zeros_like(xi)
    for i, row in enumerate(successors):
        for e, j in enumerate(row):
            if j >= 0:
                full[i, j] += counts[i, e]
    np.testing.assert_allclose(full, xi, atol=1e-12)


def test_long_and_unlikely_trajectories_do_not_underflow() -> None:
    prior, successors, transitions, log_b, nodes = small_model(1, steps=20000)
    log_b -= 900.0
    alpha, scales = forward(prior, successors, transitions, log_b, nodes)
    first, counts = expected_counts(alpha, scales, successors, transitions, log_b, nodes)
    assert np.isfinite(scales).all()
    assert first.sum() == pytest.approx(1.0)
    assert counts.sum() == pytest.approx(len(log_b) - 1)


def test_observation_is_a_gaussian_density() -> None:
    from scipy.stats import multivariate_normal

    covariance = np.array([[0.3, 0.1], [0.1, 0.2]])
    inverse = np.linalg.inv(covariance)
    precision = [[inverse[0, 0], inverse[0, 1], inverse[1, 1], np.log(np.linalg.det(covariance))]]
    point = np.array([[0.4, -0.2]])
    expected = multivariate_normal.logpdf(point[0], [1.0, 0.5], covariance)
    assert log_observation(point, np.array([[1.0, 0.5]]), np.array(precision))[0, 0] == pytest.approx(
        expected
    )


def crossing() -> list[np.ndarray]:
    """Walks to the right and walks that turn up halfway."""
    right = np.column_stack((np.arange(0.0, 8.0, 0.4), np.zeros(20)))
    up = np.concatenate((right[:10], np.column_stack((np.full(10, 3.6), np.arange(0.4, 4.4, 0.4)))))
    return [right, up]


def learned(repeats: int = 6) -> GrowingHmm:
    model = GrowingHmm(IntentionConfig(resolution=0.8, noise=0.3))
    rng = np.random.default_rng(5)
    for _ in range(repeats):
        for walk in crossing():
            model.learn(walk + rng.normal(0, 0.05, walk.shape))
    return model


def test_belief_over_intentions_agrees_with_enumeration() -> None:
    model = GrowingHmm(IntentionConfig(resolution=1.5, noise=0.4))
    for walk in crossing():
        model.learn(walk[::3])
    model._normalise()
    points = np.array([[0.2, 0.1], [1.6, 0.0], [3.5, 0.3]])
    assert len(model) ** len(points) < 50000
    gamma, _, _ = enumerated(
        model.prior, model.successors, model.transitions, model.log_observations(points), model.node
    )
    belief = model.belief(points)
    np.testing.assert_allclose(belief, gamma[-1], atol=1e-10)
    goals, probabilities = model.intentions(belief)
    for goal, probability in zip(goals, probabilities, strict=True):
        assert probability == pytest.approx(gamma[-1][model.goal == goal].sum())


def test_parameters_stay_probabilities_and_manifolds_closed() -> None:
    model = learned()
    assert model.prior.sum() == pytest.approx(1.0)
    totals = model.transitions.sum(axis=1)
    np.testing.assert_allclose(totals, 1.0, atol=1e-9)
    linked = model.successors >= 0
    goals = np.where(linked, model.goal[model.successors], model.goal[:, None])
    assert (goals == model.goal[:, None]).all()
    assert ((model.transitions == 0.0) | linked).all()
    packed = np.sort(~linked, axis=1)
    assert (packed == ~linked).all()


def test_where_the_ways_part_the_belief_follows() -> None:
    model = learned()
    for walk, end in zip(crossing(), ([7.6, 0.0], [3.6, 4.0]), strict=True):
        goals, probabilities = model.intentions(model.belief(walk[:15]))
        assert np.hypot(*(model.places.positions[goals[0]] - end)) < 0.8
        assert probabilities[0] > 0.8


def test_re_estimation_raises_the_likelihood_of_what_is_repeated() -> None:
    model = GrowingHmm(IntentionConfig(resolution=0.8, noise=0.3, memory=2))
    walk = crossing()[1]
    likelihoods = [model.learn(walk) for _ in range(6)]
    assert likelihoods[-1] > likelihoods[1]


def test_person_in_a_place_no_transition_reaches_is_found_anew() -> None:
    model = learned()
    belief = model.belief(np.array([[0.0, 0.0], [0.4, 0.0], [3.6, 3.8]]))
    assert belief.sum() == pytest.approx(1.0)
    assert np.isfinite(belief).all()


def test_structure_follows_nodes_that_merge_or_vanish() -> None:
    rng = np.random.default_rng(11)
    model = GrowingHmm(IntentionConfig(resolution=0.8, window=4, noise=0.3))
    for _ in range(60):
        start = rng.uniform(0, 6, 2)
        model.learn(start + np.cumsum(rng.normal(0.05, 0.2, (50, 2)), axis=0))
        alive = set(model.places.nodes.tolist())
        assert set(model.node.tolist()) | set(model.goal.tolist()) <= alive
        pairs = set(zip(model.node.tolist(), model.goal.tolist(), strict=True))
        assert len(pairs) == len(model)
        for s in range(len(model)):
            for j in model.successors[s][model.successors[s] >= 0]:
                n, m = int(model.node[s]), int(model.node[j])
                assert n == m or m in model.places.neighbours[n]


def test_numbers_of_vanished_places_are_used_again_and_the_model_follows() -> None:
    rng = np.random.default_rng(11)
    config = IntentionConfig(resolution=0.8, window=4, noise=0.3)
    model, most = GrowingHmm(config), 0
    for _ in range(80):
        start = rng.uniform(0, 6, 2)
        model.learn(start + np.cumsum(rng.normal(0.05, 0.2, (50, 2)), axis=0))
        assert model.places.size == len(model.places)
        vanished, most = most > len(model.places), max(most, len(model.places))
    assert vanished
    again = GrowingHmm(config)
    again.places.from_arrays(model.places.as_arrays())
    again.from_arrays(model.as_arrays())
    points = np.array([[1.0, 1.0], [1.3, 1.2], [1.7, 1.4]])
    np.testing.assert_allclose(again.belief(points), model.belief(points), atol=1e-9)
