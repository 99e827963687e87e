"""Protocols: what is trained on is never judged, and ratios and curves are what their definitions say."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.learning.boosting import AdaBoost
from evaluation.loops.place_evaluation import (
    balanced,
    cross_environment,
    first_features,
    k_fold,
    removal_errors,
    repetitiveness,
    round_curve,
)


class MemoryOfViews:
    """Scores 1 what it was trained on, 0 anything else."""

    def fit(self, F, y):
        self.seen = {tuple(row) for row in np.asarray(F)}
        return self

    def score(self, F):
        return np.array([float(tuple(row) in self.seen) for row in np.asarray(F)])


def examples(count: int = 300, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    y = np.repeat([1, 0], count // 2)
    return rng.normal(size=(count, 12)) + np.outer(y, [0, 0, 1.5, *[0] * 9]), y


def test_nothing_that_was_trained_on_is_judged() -> None:
    F, y = examples()
    # A classifier that knows its training data scores every judged pair 0: no detection below 100 % false alarms.
    found = k_fold(MemoryOfViews, F, y, folds=5, repetitions=3)
    assert len(found.curves) == 3
    assert found.spread(0.5).most == 0.0
    environments = {name: [examples(seed=k)] for k, name in enumerate("abc")}
    for curves in cross_environment(MemoryOfViews, environments).values():
        assert curves[0].detection_at(0.5) == 0.0


def test_k_fold_of_a_separable_feature_and_its_spread() -> None:
    F, y = examples()
    F[:, 5] = y + 0.1 * F[:, 5]
    found = k_fold(lambda: AdaBoost(5), F, y, folds=5, repetitions=2)
    assert found.spread(0.01).mean > 0.95
    assert found.spread(0.0).least <= found.spread(0.0).mean <= found.spread(0.0).most
    with pytest.raises(InputError, match="folds"):
        k_fold(MemoryOfViews, F, y, folds=1)


def test_error_by_rounds_is_that_of_models_with_as_many_rounds() -> None:
    train, validation = examples(200, 0), examples(200, 1)
    for rounds, error, unseen in round_curve((1, 3, 10), train, validation):
        model = AdaBoost(rounds).fit(*train)
        assert error == np.mean((model.score(train[0]) >= 0.5) != train[1])
        assert unseen == np.mean((model.score(validation[0]) >= 0.5) != validation[1])


def test_the_informative_feature_is_chosen_first_and_missed_most() -> None:
    F, y = examples()
    assert first_features(F, y)[0] == 3
    assert removal_errors(F, y, rounds=5, folds=3)[0][0] == 3


def test_ratios_of_repetitiveness() -> None:
    F = np.array([[1.0, 0.9], [3.0, 0.7], [8.0, 0.4], [12.0, 0.0]])
    means, deviations = repetitiveness(F, np.array([1, 1, 0, 0]), histograms=1)
    np.testing.assert_allclose(means, [0.2, 0.25])
    np.testing.assert_allclose(deviations, [0.5, 0.5])


def test_no_recording_outweighs_the_others() -> None:
    F, y = balanced([examples(1000), examples(40)], most=30)
    assert (y == 1).sum() == 50
    assert (y == 0).sum() == 50
    assert len(F) == 100
    with pytest.raises(InputError, match="two"):
        cross_environment(MemoryOfViews, {"a": [examples()]})
