"""Learning of the weights: gradients against differences, and what was learned against what was not."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from registration.crf.learning import Likelihood, negative_pseudo_likelihood, node_features
from registration.crf.potentials import WEIGHTS
from registration.crf.setup import problem_of
from registration.crf.training import Example, train_examples
from whereabouts.simulation.labelled_pairs import random_labelled_pairs


@pytest.fixture(scope="module")
def examples() -> list[Example]:
    pairs = random_labelled_pairs(np.random.default_rng(41), "street", 2, 2)
    return [Example(pair) for pair in pairs]


def numeric(function, weights: np.ndarray, step: float = 1e-5) -> np.ndarray:
    gradient = np.zeros(len(weights))
    for k in range(len(weights)):
        ends = []
        for sign in (1.0, -1.0):
            moved = weights.copy()
            moved[k] += sign * step
            ends.append(function(moved)[0])
        gradient[k] = (ends[0] - ends[1]) / (2.0 * step)
    return gradient


def test_gradients_agree_with_differences(examples: list[Example]) -> None:
    example = examples[0]
    problem = problem_of(example.begun, example.motions, example.starts, None, None)
    rng = np.random.default_rng(2)
    problem.data[:] = rng.uniform(-0.5, 0.5, problem.data.shape)
    problem.outlier[:] = rng.uniform(-0.5, 0.5, problem.outlier.shape)
    labels = example.labels(problem.states)
    weights = rng.uniform(0.2, 1.5, len(WEIGHTS))
    nodes = node_features(problem, labels)
    by_nodes = negative_pseudo_likelihood(weights, nodes, 1e-3)[1]
    assert_allclose(
        by_nodes, numeric(lambda w: negative_pseudo_likelihood(w, nodes, 1e-3), weights), atol=1e-7
    )
    likelihood = Likelihood([(problem, labels)])
    exact = likelihood.negative(weights, 1e-3)[1]
    assert np.abs(exact).max() > 1e-3
    assert_allclose(exact, numeric(lambda w: likelihood.negative(w, 1e-3), weights), atol=1e-6)


def test_training_learns_and_says_how(examples: list[Example], tmp_path) -> None:
    from registration.crf import JointModel

    model = train_examples(examples, {"pairs": len(examples)})
    flat = JointModel(np.full(len(WEIGHTS), 1.0), model.data, model.outlier)
    cases = []
    for example in examples:
        problem = problem_of(example.begun, example.motions, example.starts, model.data, model.outlier)
        cases.append((problem, example.labels(problem.states)))
    likelihood = Likelihood(cases)
    assert likelihood.negative(model.weights)[0] < 0.5 * likelihood.negative(flat.weights)[0]
    model.save(tmp_path / "model.json")
    again = JointModel.load(tmp_path / "model.json")
    assert_allclose(again.weights, model.weights)
    assert again.card == {"pairs": len(examples)}


def test_a_file_that_is_no_model_is_refused(tmp_path) -> None:
    from estimation.errors import InputError
    from registration.crf import JointModel

    path = tmp_path / "other.json"
    for text in ("{}", "[1]", "no json", '{"format": "whereabouts.joint_crf", "version": 9}'):
        path.write_text(text)
        with pytest.raises(InputError, match=r"other\.json"):
            JointModel.load(path)
