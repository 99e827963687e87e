"""Gradient boosting against scikit-learn's and against a brute-force search of one split."""

from __future__ import annotations

import json

import numpy as np
import pytest
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import roc_auc_score

from estimation.errors import InputError
from estimation.learning.gradient_boosting import GradientBoosting


def problem(count: int = 3000, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    F = rng.normal(size=(count, 6))
    signal = F[:, 0] * F[:, 1] + F[:, 2] ** 2 - 1.0 + 0.5 * rng.normal(size=count)
    return F, (signal > 0.0).astype(int)


def test_it_orders_unseen_examples_as_well_as_scikit_learn() -> None:
    F, y = problem(6000)
    ours = GradientBoosting(100, depth=3, rows=1.0, columns=1.0).fit(F[:4000], y[:4000])
    theirs = HistGradientBoostingClassifier(max_iter=100, max_depth=3, learning_rate=0.1, random_state=0)
    theirs.fit(
        F[:4000], y[:4000], sample_weight=np.where(y[:4000] == 1, 1 / (y == 1).mean(), 1 / (y == 0).mean())
    )
    a = roc_auc_score(y[4000:], ours.score(F[4000:]))
    b = roc_auc_score(y[4000:], theirs.predict_proba(F[4000:])[:, 1])
    assert a > b - 0.01 > 0.85


def test_one_split_is_the_best_of_all() -> None:
    F, y = problem(120)
    model = GradientBoosting(1, depth=1, learning_rate=1.0, rows=1.0, columns=1.0, l2=1e-9).fit(F, y)
    weight = np.where(y == 1, 0.5 / y.sum(), 0.5 / (y == 0).sum()) * 2
    gradient, curvature = weight * (0.5 - y), 0.25 * weight

    def gain(left: np.ndarray) -> float:
        return sum(gradient[rows].sum() ** 2 / curvature[rows].sum() for rows in (left, ~left))

    best = max(gain(F[:, k] <= cut) for k in range(F.shape[1]) for cut in np.sort(F[:, k])[:-1])
    split = model.to_dict()["trees"][0]
    assert gain(F[:, split["features"][0]] <= split["thresholds"][0]) == pytest.approx(best, rel=1e-9)


def test_classes_weigh_the_same_however_many_there_are() -> None:
    F, y = problem(2000)
    few = np.concatenate((np.flatnonzero(y == 1)[:60], np.flatnonzero(y == 0)))
    scores = GradientBoosting(30, depth=2).fit(F[few], y[few]).score(F[few])
    assert scores[:60].mean() > 0.5 > scores[60:].mean()


def test_the_same_seed_gives_the_same_model_and_a_saved_model_scores_alike(tmp_path) -> None:
    F, y = problem(800)
    model = GradientBoosting(20, depth=3).fit(F, y)
    assert model.to_dict() == GradientBoosting(20, depth=3).fit(F, y).to_dict()
    assert model.to_dict() != GradientBoosting(20, depth=3, seed=1).fit(F, y).to_dict()
    model.save(tmp_path / "model.json")
    np.testing.assert_array_equal(
        GradientBoosting.load(tmp_path / "model.json").decision(F), model.decision(F)
    )


def test_the_decision_is_the_sum_of_walks_down_the_trees() -> None:
    F, y = problem(400)
    for depth in (1, 3, 5):
        model = GradientBoosting(7, depth=depth).fit(F, y)
        for row, decision in zip(F[:50], model.decision(F[:50]), strict=True):
            total = 0.0
            for tree in model.to_dict()["trees"]:
                k = 0
                while k < len(tree["features"]):
                    cut = tree["thresholds"][k]
                    k = 2 * k + (1 if cut is None or row[tree["features"][k]] <= cut else 2)
                total += tree["leaves"][k - len(tree["features"])]
            assert decision == pytest.approx(total, abs=1e-6)


def test_a_constant_column_and_a_flat_end_do_no_harm() -> None:
    F, y = problem(300)
    F[:, 3] = 7.0
    scores = GradientBoosting(20, depth=4).fit(F, y).score(F)
    assert np.isfinite(scores).all()
    assert 0.0 <= scores.min() <= scores.max() <= 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"depth": 9}, "depth"),
        ({"learning_rate": 0.0}, "learning_rate"),
        ({"rows": 1.5}, "rows"),
        ({"rounds": 0}, "rounds"),
    ],
)
def test_settings_out_of_range_are_refused(change: dict, message: str) -> None:
    with pytest.raises(InputError, match=message):
        GradientBoosting(**change)


def test_wrong_input_is_refused(tmp_path) -> None:
    F, y = problem(100)
    with pytest.raises(InputError, match="not trained"):
        GradientBoosting().score(F)
    with pytest.raises(InputError, match="both classes"):
        GradientBoosting().fit(F, np.ones(100))
    with pytest.raises(InputError, match="weights"):
        GradientBoosting().fit(F, y, np.zeros(100))
    model = GradientBoosting(3, depth=2).fit(F, y)
    with pytest.raises(InputError, match="shape"):
        model.score(F[:, :5])
    content = model.to_dict()
    for broken in (
        {**content, "version": 2},
        {**content, "format": "other"},
        {**content, "depth": 3},
        {**content, "feature_count": 1},
        {**content, "trees": [{**tree, "features": [-1, 0, 0]} for tree in content["trees"]]},
        {key: value for key, value in content.items() if key != "trees"},
    ):
        with pytest.raises(InputError, match="content"):
            GradientBoosting.from_dict(broken)
    (tmp_path / "no.json").write_text("{")
    with pytest.raises(InputError, match="JSON"):
        GradientBoosting.load(tmp_path / "no.json")
    json.dumps(content)
