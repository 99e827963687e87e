"""The joint CRF as the text prints it, on cases small enough to try everything, and on pairs of the protocol."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.optimize import approx_fprime, minimize

from estimation.errors import InputError
from evaluation.crf.crf_learning import (
    ASSOCIATION,
    PairTruth,
    learned_printed,
    negative_pseudo_likelihood,
    node_features,
)
from evaluation.crf.crf_metrics import scores
from evaluation.scenes.labelled_pairs import protocol, random_labelled_pairs
from registration.crf.as_printed import PrintedCrf, k_means
from registration.crf.as_printed_messages import FEATURES, Inferred, algorithm_1, log_score
from registration.crf.setup import start
from registration.laser.rigid import rigid_motion
from whereabouts.simulation.lidar import Lidar

N, M, D = 5, 3, 3


@pytest.fixture(scope="module")
def printed() -> PrintedCrf:
    return PrintedCrf.load()


def case(seed: int) -> tuple:
    """Weights, points, others, states, boosted scores and motions of a tiny problem."""
    rng = np.random.default_rng(seed)
    points = np.cumsum(rng.normal(0.0, 0.2, (N, 2)), axis=0)
    others = points[:M] + rng.normal(0.0, 0.1, (M, 2))
    states = np.tile(np.arange(M), (N, 1))
    stumps = np.array([[0.2, 1.0, 0.3], [0.5, -1.0, 0.1]])
    motions = np.array([[0.0, 0.0, 0.0], [0.1, -0.1, 0.2]])
    weights = rng.uniform(0.2, 2.0, len(FEATURES))
    return (
        weights,
        points,
        others,
        states,
        rng.uniform(0.0, 0.5, (N, M)),
        rng.uniform(-0.5, 0.5, N),
        stumps,
        motions,
    )


def best_of_chain(given: tuple, x_a: np.ndarray, x_c: np.ndarray, associate: bool) -> tuple[int, ...]:
    """States of one chain, the other's given, of the greatest sum of that chain's own features, by trying all."""
    own = given[0].copy()
    own[ASSOCIATION if associate else 0 : None if associate else ASSOCIATION] = 0.0
    score = {}
    for states in product(range(M + 1 if associate else D), repeat=N):
        both = (np.array(states), x_c) if associate else (x_a, np.array(states))
        score[states] = log_score(own, *given[1:], *both)
    return max(score, key=lambda states: score[states])


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("associate", [True, False])
def test_one_chain_alone_is_exact(seed: int, associate: bool) -> None:
    """A chain is a tree, on which belief propagation finds the maximum of equation (1)."""
    given = case(seed)
    rng = np.random.default_rng(seed)
    x_a, x_c = rng.integers(0, M + 1, N), rng.integers(0, D, N)
    best = best_of_chain(given, x_a, x_c, associate)
    one = Inferred(associate, not associate, False)
    algorithm_1(*given[:7], given[7].copy(), x_a, x_c, 2 * N, one)
    assert_array_equal(x_a if associate else x_c, best)


def test_together_each_chain_is_at_its_best_given_the_other_and_the_motions() -> None:
    settled = 0
    for seed in range(12):
        given = case(seed)
        motions, x_a, x_c = given[7].copy(), np.zeros(N, dtype=np.int64), np.zeros(N, dtype=np.int64)
        # Two chains that wait for each other may also go round in circles.
        if algorithm_1(*given[:7], motions, x_a, x_c, 200, Inferred(True, True, True)) > 200:
            continue
        settled += 1
        at = (*given[:7], motions)
        assert_array_equal(x_a, best_of_chain(at, x_a, x_c, True))
        assert_array_equal(x_c, best_of_chain(at, x_a, x_c, False))
        for d in range(D - 1):
            pairs = (x_c == d) & (x_a < M)
            if pairs.sum() >= 3:
                assert_allclose(motions[d], rigid_motion(given[1][pairs], given[2][x_a[pairs]]), atol=1e-6)
    assert settled >= 6


def test_equation_6_is_the_least_squares_motion() -> None:
    rng = np.random.default_rng(2)
    a, b = rng.normal(size=(8, 2)), rng.normal(size=(8, 2))

    def error(motion: np.ndarray) -> float:
        c, s = np.cos(motion[2]), np.sin(motion[2])
        return float(((a @ np.array([[c, s], [-s, c]]) + motion[:2] - b) ** 2).sum())

    best = min(minimize(error, [0.0, 0.0, yaw]).fun for yaw in np.linspace(-3.0, 3.0, 7))
    assert error(rigid_motion(a, b)) == pytest.approx(best, rel=1e-6)


def test_pseudo_likelihood_is_the_product_over_markov_blankets(printed: PrintedCrf) -> None:
    """Each node's probability given all the others, from equation (1) with that node's state varied."""
    truth = PairTruth.of(protocol(5)[2])
    few = slice(40, 49)
    a, b = truth.a, truth.b
    nodes = node_features(printed, truth)
    local = printed.boosted(a, b, np.tile(np.arange(len(b)), (len(a), 1)))
    states = np.tile(np.arange(len(b)), (len(a), 1))
    for features, told, first in nodes:
        # A chain's nodes have the features of that chain.
        weights = printed.weights.copy()
        weights[ASSOCIATION if first == 0 else 0 : None if first == 0 else ASSOCIATION] = 0.0
        for row in range(few.start // 3, few.stop // 3):
            i, every = 3 * row, []
            own = features[row] @ printed.weights[first : first + features.shape[2]]
            for state in range(features.shape[1]):
                x_a, x_c = truth.x_a.copy(), truth.x_c.copy()
                (x_a if first == 0 else x_c)[i] = state
                every.append(log_score(weights, a.points, b.points, states, *local, truth.motions, x_a, x_c))
            assert_allclose(own - own[told[row]], np.array(every) - every[told[row]], atol=1e-6)


def test_the_gradient_of_the_pseudo_likelihood(printed: PrintedCrf) -> None:
    nodes = node_features(printed, PairTruth.of(protocol(5)[2]))
    at = np.random.default_rng(0).uniform(0.1, 1.0, len(FEATURES))
    by_steps = approx_fprime(at, lambda w: negative_pseudo_likelihood(w, nodes)[0], 1e-6)
    assert_allclose(negative_pseudo_likelihood(at, nodes)[1], by_steps, atol=1e-5)


def test_k_means_puts_the_largest_first() -> None:
    rng = np.random.default_rng(3)
    displacements = np.concatenate((rng.normal(0.0, 0.01, (20, 2)), rng.normal(1.0, 0.01, (50, 2))))
    told = np.ones(70, dtype=bool)
    told[0] = False
    found = k_means(displacements, told, clusters=2)
    assert found[0] == -1
    assert (found[1:20] == 1).all()
    assert (found[20:] == 0).all()


def test_from_the_start_it_labels_the_protocol_and_with_few_states_as_well(printed: PrintedCrf) -> None:
    found = []
    for pair in protocol(11)[::6]:
        begun = start(pair.scan_a, pair.scan_b)
        found.append(
            [
                scores(pair, printed.infer(pair.scan_a, pair.scan_b, begun, joined, 10))
                for joined in (True, False)
            ]
        )
    for k in range(2):
        assert np.mean([each[k].clustering for each in found]) > 0.85
        assert np.mean([each[k].association for each in found]) > 0.6


def test_blind_and_with_all_states_it_answers_in_the_same_form(printed: PrintedCrf, tmp_path: Path) -> None:
    # Of a third of the beams: what tries all M states takes the third power of them.
    lidar = Lidar(121, np.pi, range_max=40.0)
    (pair,) = random_labelled_pairs(np.random.default_rng(12), "street", 1, lidar=lidar)
    estimate = printed.infer(pair.scan_a, pair.scan_b)
    assert estimate.clusters.shape == (len(pair.scan_a),)
    assert estimate.motions.shape == (1 + estimate.clusters.max(), 3)
    assert pair.scan_b.valid[estimate.associations[estimate.associations >= 0]].all()
    printed.save(tmp_path / "printed.json")
    again = PrintedCrf.load(tmp_path / "printed.json").infer(pair.scan_a, pair.scan_b)
    assert_array_equal(again.associations, estimate.associations)
    (tmp_path / "printed.json").write_text("{}")
    with pytest.raises(InputError, match="printed"):
        PrintedCrf.load(tmp_path / "printed.json")


def test_training_gives_weights_that_explain_the_truth_better_than_none() -> None:
    pairs = protocol(13)[:2]
    model = learned_printed(pairs)
    nodes = [group for pair in pairs for group in node_features(model, PairTruth.of(pair))]
    learned, without = (
        negative_pseudo_likelihood(weights, nodes)[0] for weights in (model.weights, np.zeros(len(FEATURES)))
    )
    assert learned < 0.5 * without


def test_what_begins_from_a_registration_that_failed_has_failed(printed: PrintedCrf) -> None:
    (pair,) = random_labelled_pairs(np.random.default_rng(3), "office", 1)
    rng = np.random.default_rng(4)
    scattered = replace(pair.scan_b, ranges=rng.uniform(0.5, 8.0, len(pair.scan_b)))
    begun = start(pair.scan_a, scattered)
    assert not begun.registration.converged
    found = printed.infer(pair.scan_a, scattered, begun, nearest=5)
    assert not found.converged
    assert found.reason == begun.registration.reason
    good = start(pair.scan_a, pair.scan_b)
    assert good.registration.converged
    assert printed.infer(pair.scan_a, pair.scan_b, good, nearest=5).converged


@pytest.mark.parametrize(
    "wrong", [{"scan_b": None}, {"nearest": 0}, {"nearest": 2.5}, {"nearest": "3"}, {"start": np.zeros(3)}]
)
def test_wrong_arguments_are_named(printed: PrintedCrf, wrong: dict) -> None:
    (pair,) = random_labelled_pairs(np.random.default_rng(3), "office", 1)
    with pytest.raises(InputError, match=next(iter(wrong))):
        printed.infer(**{"scan_a": pair.scan_a, "scan_b": pair.scan_b, **wrong})
