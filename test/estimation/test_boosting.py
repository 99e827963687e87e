"""AdaBoost against an enumeration of every stump and against scikit-learn's."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.errors import InputError
from estimation.learning.boosting import AdaBoost


def predict(stump, F):
    feature, polarity, threshold = stump
    return (polarity * F[:, feature] < polarity * threshold).astype(int)


def enumerate_best(F, y, weights):
    """The first stump of least weighted error among all features, midpoints and polarities."""
    found = []
    for feature in range(F.shape[1]):
        values = np.unique(F[:, feature])
        for threshold in (values[:-1] + values[1:]) / 2:
            for polarity in (-1, 1):
                stump = (feature, polarity, threshold)
                found.append((weights[predict(stump, F) != y].sum(), stump))
    least = min(error for error, _ in found)
    return next(pair for pair in found if pair[0] <= least + 1e-12)


def reference(F, y, rounds):
    """Algorithm 3 word for word: [(feature, polarity, threshold, alpha, error)] and the vote share (M,)."""
    weights = np.where(y == 1, 1 / (2 * (y == 1).sum()), 1 / (2 * (y == 0).sum()))
    chosen, share = [], np.zeros(len(y))
    for _ in range(rounds):
        weights = weights / weights.sum()
        error, stump = enumerate_best(F, y, weights)
        beta = error / (1 - error)
        wrong = predict(stump, F) != y
        weights = weights * beta ** (1 - wrong)
        chosen.append((*stump, np.log(1 / beta), error))
        share += chosen[-1][3] * predict(stump, F)
    return chosen, share / sum(entry[3] for entry in chosen)


def noisy(seed, samples=80, features=6, decimals=None):
    rng = np.random.default_rng(seed)
    F = rng.normal(size=(samples, features))
    if decimals is not None:
        F = F.round(decimals)
    y = (F[:, 1] + 0.7 * F[:, 3] ** 2 + rng.normal(size=samples) > 0.6).astype(int)
    return F, y


@pytest.mark.parametrize(("seed", "decimals"), [(0, None), (1, None), (2, 0), (3, 1)])
def test_every_round_is_the_best_stump(seed, decimals):
    F, y = noisy(seed, decimals=decimals)
    model = AdaBoost(12).fit(F, y)
    expected, share = reference(F, y, 12)
    got = [(s.feature, s.polarity, s.threshold, s.weight, s.error) for s in model.stumps]
    np.testing.assert_allclose(got, expected, rtol=1e-9, atol=1e-12)
    np.testing.assert_array_equal(model.chosen, [entry[0] for entry in expected])
    np.testing.assert_allclose(model.score(F), share, rtol=1e-9)


def test_agrees_with_scikit_learn_given_the_same_weak_learner():
    # Its own tree minimises impurity, not the weighted error of the text: the weak learner is the enumeration.
    from sklearn.base import BaseEstimator, ClassifierMixin
    from sklearn.ensemble import AdaBoostClassifier

    class Enumerated(ClassifierMixin, BaseEstimator):
        def fit(self, X, y, sample_weight=None):
            self.classes_ = np.array([0, 1])
            self.error_, self.stump_ = enumerate_best(X, y, sample_weight)
            return self

        def predict(self, X):
            return predict(self.stump_, X)

    F, y = noisy(5)
    start = np.where(y == 1, 1 / (2 * (y == 1).sum()), 1 / (2 * (y == 0).sum()))
    other = AdaBoostClassifier(Enumerated(), n_estimators=15).fit(F, y, sample_weight=start)
    model = AdaBoost(15).fit(F, y)
    assert [tree.stump_[0] for tree in other.estimators_] == model.chosen.tolist()
    np.testing.assert_allclose(other.estimator_weights_, [s.weight for s in model.stumps], rtol=1e-9)
    np.testing.assert_array_equal(other.predict(F), model.score(F) > 0.5)
    # Its decision is the difference of two votes of ±1, one per class; ours the share of the ones.
    np.testing.assert_allclose(other.decision_function(F), 2 * (2 * model.score(F) - 1), atol=1e-9)


def test_one_round_is_scikit_learns_stump_where_impurity_and_error_agree():
    from sklearn.ensemble import AdaBoostClassifier
    from sklearn.tree import DecisionTreeClassifier

    # One balanced feature with symmetric noise: the cut in the middle is best by both.
    F = np.array([[0.0], [1.0], [2.0], [3.0], [4.0], [5.0], [6.0], [7.0]])
    y = np.array([0, 0, 1, 0, 1, 0, 1, 1])
    tree = AdaBoostClassifier(DecisionTreeClassifier(max_depth=1), n_estimators=1).fit(F, y)
    inner = tree.estimators_[0].tree_
    model = AdaBoost(1).fit(F, y)
    stump = model.stumps[0]
    np.testing.assert_allclose(tree.estimator_errors_[0], stump.error)
    assert inner.threshold[0] == stump.threshold
    np.testing.assert_array_equal(tree.predict(F), model.score(F) > 0.5)


@given(
    st.lists(
        st.tuples(st.integers(-3, 3), st.integers(-3, 3), st.integers(0, 1)), min_size=2, max_size=25
    ).filter(lambda rows: 0 < sum(row[2] for row in rows) < len(rows))
)
@settings(max_examples=150)
def test_few_values_and_many_ties(rows):
    data = np.array(rows, dtype=float)
    F, y = data[:, :2], data[:, 2].astype(int)
    try:
        model = AdaBoost(4).fit(F, y)
    except InputError:
        # Nothing better than chance: the enumeration must agree.
        if np.any(F.min(0) < F.max(0)):
            start = np.where(y == 1, 0.5 / y.sum(), 0.5 / (1 - y).sum())
            assert enumerate_best(F, y, start)[0] >= 0.5 - 1e-9
        return
    start = np.where(y == 1, 0.5 / y.sum(), 0.5 / (1 - y).sum())
    assert model.stumps[0].error == pytest.approx(enumerate_best(F, y, start)[0], abs=1e-12)
    assert ((model.score(F) >= 0) & (model.score(F) <= 1)).all()


def test_unbalanced_classes_start_with_half_the_weight_each():
    F = np.array([[0.0], [1.0], [2.0], [3.0], [4.0], [2.5]])
    stump = AdaBoost(1).fit(F, [0, 0, 0, 0, 0, 1]).stumps[0]
    # Cutting at 2.25 loses two of five negatives: 2 / 5 of half the weight.
    assert (stump.polarity, stump.threshold) == (-1, 2.25)
    assert stump.error == pytest.approx(0.2)


@pytest.mark.parametrize(("labels", "polarity"), [([0, 1], -1), ([1, 0], 1)])
def test_neighbouring_floats_are_told_apart(labels, polarity):
    F = np.array([[1.0], [np.nextafter(1.0, 2.0)]])
    model = AdaBoost(5).fit(F, labels)
    assert [stump.polarity for stump in model.stumps] == [polarity]
    np.testing.assert_array_equal(model.score(F), labels)


def test_separable_data_need_one_stump():
    F, y = np.arange(10.0)[:, None], np.arange(10) >= 4
    model = AdaBoost(50).fit(F, y)
    assert len(model.stumps) == 1
    assert (model.stumps[0].weight, model.stumps[0].error) == (1.0, 0.0)
    np.testing.assert_array_equal(model.score(F), y)


def test_training_error_falls_with_rounds():
    F, y = noisy(7, samples=300)
    errors = [np.mean((AdaBoost(t).fit(F, y).score(F) > 0.5) != y) for t in (1, 10, 100)]
    assert errors[0] > errors[1] > errors[2]


def test_saved_and_loaded(tmp_path):
    F, y = noisy(9)
    model = AdaBoost(7).fit(F, y)
    path = tmp_path / "model.json"
    model.save(path)
    loaded = AdaBoost.load(path)
    assert loaded.stumps == model.stumps
    assert (loaded.rounds, loaded.feature_count) == (7, 6)
    np.testing.assert_array_equal(loaded.score(F), model.score(F))
    AdaBoost(7).fit(F, y).save(tmp_path / "again.json")
    assert (tmp_path / "again.json").read_bytes() == path.read_bytes()


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"version": 2}, "version"),
        ({"format": "other"}, "does not hold"),
        ({"stumps": []}, "no stumps"),
        ({"stumps": [{"feature": 0}]}, "not a complete model"),
        ({"feature_count": 1}, "not a complete model"),
    ],
)
def test_broken_files_are_named(tmp_path, change, match):
    F, y = noisy(9)
    path = tmp_path / "model.json"
    AdaBoost(7).fit(F, y).save(path)
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    with pytest.raises(InputError, match=match):
        AdaBoost.load(path)
    path.write_text("{")
    with pytest.raises(InputError, match="not a JSON file"):
        AdaBoost.load(path)


@pytest.mark.parametrize(
    ("F", "y", "match"),
    [
        ([[1.0], [np.nan]], [0, 1], "finite"),
        ([[1.0], [np.inf]], [0, 1], "finite"),
        ([[1.0], [2.0]], [1, 1], "both classes"),
        ([[1.0], [2.0]], [0, 2], "only 0 and 1"),
        ([[1.0], [2.0]], [0, 1, 1], "shape"),
        ([1.0, 2.0], [0, 1], "shape"),
        (np.zeros((0, 3)), [], "both classes"),
        ([[1.0], [1.0]], [0, 1], "better than chance"),
    ],
)
def test_what_cannot_be_learned_from(F, y, match):
    with pytest.raises(InputError, match=match):
        AdaBoost(3).fit(F, y)


def test_untrained_and_mismatched_models():
    with pytest.raises(InputError, match="rounds"):
        AdaBoost(0)
    with pytest.raises(InputError, match="not trained"):
        AdaBoost().score([[1.0]])
    model = AdaBoost(3).fit(*noisy(1))
    with pytest.raises(InputError, match="shape"):
        model.score(np.zeros((4, 5)))
    assert model.score(np.zeros((0, 6))).shape == (0,)
