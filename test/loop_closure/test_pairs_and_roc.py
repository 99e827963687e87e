"""Pairs of a log against brute force, curves against scikit-learn."""

from __future__ import annotations

import math

import numpy as np
import pytest
from sklearn.metrics import average_precision_score, roc_auc_score

from estimation.errors import InputError
from evaluation.loops.roc import roc
from loop_closure.places.pairs import PairRule, path_lengths, sample_pairs


def round_trip(count: int = 120) -> np.ndarray:
    """A circle of 12 m radius, driven twice, the second time the other way, with a little noise: (N, 3)."""
    rng = np.random.default_rng(0)
    angle = np.concatenate((np.linspace(0, 2 * np.pi, count), np.linspace(2 * np.pi, 0, count)))
    heading = angle + np.where(np.arange(2 * count) < count, 0.5, -0.5) * np.pi
    return np.column_stack((12 * np.cos(angle), 12 * np.sin(angle), heading)) + 0.1 * rng.normal(
        size=(2 * count, 3)
    )


@pytest.mark.parametrize(
    "rule",
    [
        PairRule(1.0, 20.0),
        PairRule(2.0, 20.0, math.radians(45)),
        PairRule(3.0, 0.0, index_gap=20),
        PairRule(1.0, 5.0, apart=6.0),
        PairRule(2.0, 20.0, math.radians(45), apart=10.0, neighbours=True),
    ],
)
def test_pairs_are_those_a_double_loop_finds(rule: PairRule) -> None:
    poses = round_trip()
    path = path_lengths(poses[:, :2])
    near, far = set(), set()
    for i in range(len(poses)):
        for j in range(i + rule.index_gap, len(poses)):
            turn = abs(math.remainder(poses[i, 2] - poses[j, 2], 2 * math.pi))
            if turn > rule.max_turn:
                continue
            revisit = path[j] - path[i] >= rule.path_gap
            apart = math.dist(poses[i, :2], poses[j, :2])
            if apart < rule.distance and (revisit or rule.neighbours):
                near.add((i, j))
            elif revisit and apart >= max(rule.distance, rule.apart):
                far.add((i, j))
    pairs = sample_pairs(poses, rule, negatives=10**6)
    found = list(zip(pairs.first.tolist(), pairs.second.tolist(), strict=True))
    assert set(found[: pairs.positives]) == near
    assert set(found[pairs.positives :]) == far
    assert pairs.positives == len(near)
    assert len(pairs) == len(near) + len(far)


def test_a_subset_is_drawn_by_the_seed_and_without_repetition() -> None:
    poses, rule = round_trip(), PairRule(3.0)
    a, b, c = (sample_pairs(poses, rule, 50, 20, seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(a.first, b.first)
    assert (a.second != c.second).any()
    assert a.positives == 20
    assert len(a) == 70
    assert len(set(zip(a.first.tolist(), a.second.tolist(), strict=True))) == 70


def test_rows_by_first_are_all_rows_once() -> None:
    pairs = sample_pairs(round_trip(), PairRule(2.0), 200)
    rows = np.concatenate([rows for _, rows in pairs.by_first()])
    assert sorted(rows.tolist()) == list(range(len(pairs)))
    assert all((pairs.first[rows] == first).all() for first, rows in pairs.by_first())


def test_wrong_poses_and_rules_are_refused() -> None:
    with pytest.raises(InputError, match="poses"):
        sample_pairs(np.zeros((1, 3)), PairRule())
    with pytest.raises(InputError, match="headings"):
        sample_pairs(np.zeros((5, 2)), PairRule(max_turn=1.0))
    with pytest.raises(InputError, match="path"):
        sample_pairs(np.zeros((5, 3)), PairRule(), path=np.zeros(4))
    for change in ({"distance": 0.0}, {"path_gap": -1.0}, {"index_gap": 0}, {"max_turn": 0.0}):
        with pytest.raises(InputError):
            PairRule(**change)


def test_curve_against_scikit_learn_and_by_hand() -> None:
    rng = np.random.default_rng(0)
    same = (rng.random(2000) < 0.2).astype(int)
    scores = np.round(rng.normal(size=2000) + 1.5 * same, 1)
    curve = roc(scores, same)
    assert curve.area == pytest.approx(roc_auc_score(same, scores), abs=1e-12)
    assert curve.average_precision == pytest.approx(average_precision_score(same, scores), abs=1e-12)
    for rate in (0.0, 0.001, 0.01, 0.1):
        threshold = curve.threshold[np.searchsorted(curve.false_alarm, rate, side="right") - 1]
        assert np.mean(scores[same == 0] >= threshold) <= rate
        assert np.mean(scores[same == 1] >= threshold) == pytest.approx(curve.detection_at(rate))
        # The next looser threshold has too many false alarms.
        looser = np.unique(scores[scores < threshold])[-1]
        assert np.mean(scores[same == 0] >= looser) > rate


def test_equal_scores_cannot_be_told_apart() -> None:
    curve = roc(np.ones(10), np.array([1] * 5 + [0] * 5))
    assert curve.detection_at(0.0) == 0.0
    assert curve.detection_at(0.5) == 0.0
    assert curve.area == 0.5
    with pytest.raises(InputError, match="both classes"):
        roc(np.ones(3), np.ones(3))
    with pytest.raises(InputError, match="finite"):
        roc(np.array([np.nan, 1.0]), np.array([0, 1]))


def test_the_first_of_the_drawn_pairs_are_from_the_whole_path() -> None:
    poses = np.column_stack([np.linspace(0.0, 400.0, 401), np.zeros((401, 2))])
    pairs = sample_pairs(poses, PairRule(distance=30.0), 4000)
    negative = pairs.first[pairs.same == 0][:400]
    # Uniform over all pairs: the lesser of two numbers below 400, a third of the way on average.
    assert 90 < negative.mean() < 160
    assert pairs.first[: pairs.positives][:400].std() > 80
