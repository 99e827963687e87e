"""What is remembered of a target for its class, and how the probabilities are calibrated."""

from __future__ import annotations

import json
from importlib import resources
from types import SimpleNamespace

import numpy as np
import pytest
from sklearn.linear_model import LogisticRegression

from estimation.geometry.poses import compound, inverse
from evaluation.people.people_class_training import ClassExamples, balanced, calibrated, folds
from tracking.mixture.target import Target
from tracking.people import people_shape
from tracking.people.legs import FEATURES
from tracking.people.person_class import AVERAGED, CARD, NAMES, ClassEvidence, ScanLook, class_model, rows_of


def target_at(x: float, y: float = 0.0) -> Target:
    return Target(0, np.array([x, y, 0.5, 0.0]), np.eye(4), 1.0, np.eye(2), 1.0)


def looks(
    count: int, dt: float, rng: np.random.Generator
) -> tuple[ClassEvidence, ScanLook, list[SimpleNamespace]]:
    """Evidence of a target that walks along x and shows two legs, and what it was made of."""
    evidence, seen = ClassEvidence(np.array([1.0, 0.0])), []
    for k in range(count):
        x = 1.0 + 0.8 * dt * k
        scan = SimpleNamespace(
            places=np.array([[x, 0.1], [x, -0.1]]) + 0.02 * rng.standard_normal((2, 2)),
            shape=rng.normal(1.0, 0.5, 2),
            widths=rng.uniform(0.08, 0.12, 2),
            free=rng.uniform(0.1, 0.9, 2),
            fresh=rng.uniform(0.0, 1.0, 2),
            old=rng.uniform(0.0, 0.2, 2),
            counts=np.array([7, 5]),
            index=np.array([3, 1]),
            clusters=SimpleNamespace(features=rng.uniform(0.0, 1.0, (5, len(FEATURES)))),
        )
        rows = rows_of(scan)  # type: ignore[arg-type]
        evidence.look(ScanLook(scan, rows, np.zeros(3), dt, dt * k, True), np.arange(2), target_at(x), 2)  # type: ignore[arg-type]
        seen.append(scan)
    return evidence, seen


def test_means_and_deviations_are_those_of_all_looks() -> None:
    evidence, seen = looks(40, 0.1, np.random.default_rng(0))
    values = dict(zip(NAMES, evidence.features(target_at(1.0 + 0.08 * 39)), strict=True))
    shapes = np.array([scan.shape.mean() for scan in seen])
    widths = np.array([scan.widths.sum() for scan in seen])
    gaps = np.array([np.linalg.norm(scan.places[0] - scan.places[1]) for scan in seen])
    middles = np.array([scan.places.mean(0) for scan in seen])
    bulges = np.array([scan.clusters.features[[3, 1], FEATURES.index("bulge")].mean() for scan in seen])
    assert values["shape"] == pytest.approx(shapes.mean())
    assert values["shape_deviation"] == pytest.approx(shapes.std())
    assert values["width"] == pytest.approx(widths.mean())
    assert values["width_deviation"] == pytest.approx(widths.std(), abs=1e-6)
    assert values["gap"] == pytest.approx(gaps.mean())
    assert values["gap_deviation"] == pytest.approx(gaps.std(), abs=1e-6)
    assert values["jitter"] == pytest.approx(np.sqrt(middles.var(axis=0).sum()))
    assert values["bulge"] == pytest.approx(bulges.mean())
    assert values["arrived"] == pytest.approx(np.mean([scan.fresh.mean() for scan in seen[:5]]), abs=0.1)
    assert values["looks"] == pytest.approx(4.0)
    assert values["moved"] == pytest.approx(0.08 * 39)
    assert values["pairs"] == values["pair_now"] == 1.0
    assert values["around"] == 2.0


def test_evidence_hardly_depends_on_the_rate_of_the_scanner() -> None:
    slow, fast = (
        np.array(looks(n, 4.0 / n, np.random.default_rng(1))[0].features(target_at(4.1))) for n in (40, 160)
    )
    chosen = [
        NAMES.index(name) for name in ("shape", "width", "fresh", "drift", "moved_fast", "walked", "moved")
    ]
    np.testing.assert_allclose(slow[chosen], fast[chosen], rtol=0.2, atol=0.05)


def test_who_is_not_seen_changes_nothing() -> None:
    evidence, _ = looks(10, 0.1, np.random.default_rng(2))
    before = evidence.features(target_at(2.0))
    none = np.zeros(0, dtype=np.int64)
    evidence.look(
        ScanLook(None, np.zeros((0, len(AVERAGED))), np.zeros(3), 0.1, 9.0, True), none, target_at(3.0), 0
    )  # type: ignore[arg-type]
    assert evidence.features(target_at(2.0)) == before
    assert evidence.last_seen == pytest.approx(0.9)


def test_who_looks_at_rest_carries_nothing_and_who_drives_carries_what_he_passes() -> None:
    """A thing 3 m ahead; the scanner drives 2 m around it, then its frame is turned and moved."""
    rng, evidence = np.random.default_rng(5), ClassEvidence(np.array([3.0, 0.0]))
    seen = looks(1, 0.1, rng)[1][0]
    seen.places[:] = 3.0, 0.0
    rows = rows_of(seen)  # type: ignore[arg-type]
    poses = [np.zeros(3)] * 3 + [np.array([1.0, 0.5, -0.2]), np.array([2.0, 1.0, -0.8])]
    carried = []
    for k, pose in enumerate(poses):
        evidence.look(ScanLook(seen, rows, pose, 0.1, 0.1 * k, True), np.arange(2), target_at(3.0), 0)  # type: ignore[arg-type]
        carried.append(evidence.features(target_at(3.0))[NAMES.index("carried")])
    assert carried[:3] == [0.0, 0.0, 0.0]
    in_scanner = [compound(inverse(pose), np.array([3.0, 0.0, 0.0]))[:2] for pose in poses]
    assert carried[-1] == pytest.approx(max(np.linalg.norm(place - in_scanner[0]) for place in in_scanner))
    evidence.shift(np.array([1.0, -2.0, 0.7]))
    moved = compound(np.array([1.0, -2.0, 0.7]), np.array([3.0, 0.0, 0.0]))
    pose = compound(np.array([1.0, -2.0, 0.7]), poses[-1])
    evidence.look(ScanLook(seen, rows, pose, 0.1, 0.5, True), np.arange(2), target_at(*moved[:2]), 0)  # type: ignore[arg-type]
    assert evidence.carried == pytest.approx(carried[-1])


def test_calibration_is_the_logistic_regression_of_the_log_odds() -> None:
    rng = np.random.default_rng(3)
    odds, weights = rng.normal(0.0, 3.0, 4000), rng.uniform(0.2, 2.0, 4000)
    positive = rng.random(4000) < 1.0 / (1.0 + np.exp(-(0.6 * odds - 0.8)))
    scale, prior = calibrated(odds, positive, weights)
    known = LogisticRegression(C=1e9, tol=1e-10).fit(odds[:, None], positive, weights)
    assert (scale, prior) == pytest.approx((known.coef_[0, 0], known.intercept_[0]), abs=1e-3)


def test_recordings_count_as_much_as_scenes_and_are_left_out_as_a_whole() -> None:
    def source(name: str, count: int, real: bool) -> ClassExamples:
        parts = np.zeros(count, dtype=np.int64) if real else np.arange(count) // 10
        return ClassExamples(
            name, np.zeros((count, len(NAMES))), np.arange(count) % 2 == 0, np.ones(count), parts, real
        )

    found = [
        source("scenes", 60, False),
        source("hall/left", 6, True),
        source("hall/right", 4, True),
        source("b", 8, True),
    ]
    weights, real = balanced(found), np.repeat([False, True], [60, 18])
    for kind in (0, 1):
        chosen = np.concatenate([item.positive for item in found]) == kind
        assert weights[chosen & real].sum() == pytest.approx(weights[chosen & ~real].sum())
    scenes, left, right, other = folds(found)
    assert set(scenes) == {0, 1, 2}
    assert len({*left, *right}) == 1
    assert set(other) != set(left)


def test_the_shipped_models_know_their_features() -> None:
    model = class_model()
    assert model.trees.feature_count == len(NAMES)
    for card, names in ((CARD, NAMES), (people_shape.CARD, FEATURES)):
        text = (resources.files("tracking.people") / "models" / card).read_text(encoding="utf-8")
        assert json.loads(text)["features"] == list(names)
    assert 0.0 < model.scale < 1.5
