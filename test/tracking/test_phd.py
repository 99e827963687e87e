"""The filters from scan to targets: simulated scenes, bad input, configuration, and the recorded benchmark scans."""

from __future__ import annotations

import json
import warnings

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.metrics.statistics import ospa
from evaluation.datasets import recording
from tracking import ExtendedTargetPhd, PhdConfig, PointTargetPhd, Target
from tracking.mixture.components import Components
from tracking.mixture.phd_models import ConstantDetection, Labels
from tracking.mixture.reduction import Reducer, distinct_labels
from tracking.phd.phd_recursion import PhdRecursion

BIRTHS = [(0.1, [0.0, 0.0, 0.0, 0.0], np.diag([400.0, 400.0, 25.0, 25.0]))]


def scan(rng: np.random.Generator, centres: list, clutter: float = 10.0, rate: float = 10.0) -> np.ndarray:
    """Returns of targets at `centres`, and clutter, in random order."""
    parts = [np.array(c) + rng.normal(0, 20, (rng.poisson(rate), 2)) for c in centres]
    parts.append(rng.uniform(-1000, 1000, (rng.poisson(clutter), 2)))
    return rng.permutation(np.vstack(parts))


def text_filter(config: PhdConfig) -> PhdRecursion:
    """The parts of the text's filter."""
    return PhdRecursion(config, ConstantDetection(config))


def positions(targets: list[Target]) -> np.ndarray:
    """Positions (N, 2)."""
    return np.array([target.mean[:2] for target in targets]).reshape(-1, 2)


def followed(filter_: ExtendedTargetPhd, steps: int = 20, seed: int = 0) -> list[Target]:
    """Targets after a scene of one target at constant velocity."""
    rng = np.random.default_rng(seed)
    targets: list[Target] = []
    for k in range(steps):
        targets = filter_.step(scan(rng, [[10.0 * k, -5.0 * k]]), float(k))
    return targets


def test_one_target_is_followed() -> None:
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS))
    (target,) = followed(filter_)
    assert np.linalg.norm(target.mean[:2] - [190.0, -95.0]) < 20.0
    assert np.linalg.norm(target.mean[2:] - [10.0, -5.0]) < 8.0
    assert target.weight == pytest.approx(1.0, abs=0.1)
    assert filter_.expected_count == pytest.approx(1.0, abs=0.15)
    assert target.covariance.shape == (4, 4)
    assert np.linalg.eigvalsh(target.covariance).min() > 0


@pytest.mark.parametrize(("name", "tolerance"), [("mixture", 0.2), ("phd", 0.25)])
def test_rate_and_extent_are_estimated(name: str, tolerance: float) -> None:
    """Configured for 10 returns of 20 m spread; the target gives 13, wider in x than in y.

    The text's filter also merges what comes of cells that are cut too large: 20.4 % off.
    """
    rng = np.random.default_rng(1)
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS, memory=30.0, filter=name))
    for k in range(60):
        z = [12.0 * k, 0.0] + rng.normal(0, 1, (rng.poisson(13), 2)) * [18.0, 7.0]
        targets = filter_.step(z, float(k))
    (target,) = targets
    assert 11.5 < target.rate < 14.5
    np.testing.assert_allclose(np.sqrt(np.diag(target.extent)), [18.0, 7.0], rtol=tolerance)


def test_labels_persist_and_differ() -> None:
    """Two separate targets keep their labels through missing scans."""
    rng = np.random.default_rng(2)
    births = [(0.1, [x, 0.0, 0.0, 0.0], np.diag([400.0, 400.0, 25.0, 25.0])) for x in (-300.0, 300.0)]
    filter_ = ExtendedTargetPhd(PhdConfig(births=births))
    seen: dict[int, set[bool]] = {}
    for k in range(40):
        targets = filter_.step(scan(rng, [[-300.0, 5.0 * k], [300.0, -5.0 * k]]), float(k))
        if k >= 3:
            assert len(targets) == 2
            for target in targets:
                seen.setdefault(target.label, set()).add(bool(target.mean[0] > 0))
    assert sorted(seen) == [0, 1]
    assert all(len(sides) == 1 for sides in seen.values())


def test_target_that_stops_being_seen_is_given_up() -> None:
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS))
    followed(filter_)
    for k in range(20, 25):
        targets = filter_.step(np.zeros((0, 2)), float(k))
    assert targets == []


def test_target_that_splits_is_counted_as_two() -> None:
    """A target splits in two far from every birth place; the first keeps its label."""
    rng = np.random.default_rng(3)
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS))
    before: list[Target] = []
    for k in range(45):
        y = max(0, k - 25) * 6.0
        centres = [[12.0 * k, y], [12.0 * k, -y]] if k > 25 else [[12.0 * k, 0.0]]
        targets = filter_.step(scan(rng, centres), float(k))
        before = targets if k == 25 else before
    assert filter_.expected_count == pytest.approx(2.0, abs=0.2)
    assert len(targets) == 2
    assert before[0].label in {target.label for target in targets}


def test_prediction_moves_bears_and_spawns() -> None:
    """Survivors by F P Fᵀ + Q, then births, then (18) around each survivor."""
    config = PhdConfig(births=BIRTHS, process_noise=3.0)
    filter_ = text_filter(config)
    m, P = np.array([1.0, 2.0, 3.0, 4.0]), np.diag([4.0, 5.0, 6.0, 7.0])
    old = filter_.motion.fresh(np.array([0.8]), m[None], P[None], filter_.labels)
    new = filter_.motion.predict(old, 2.0, filter_.labels)
    F = np.array([[1, 0, 2, 0], [0, 1, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]])
    G = np.array([[2, 0], [0, 2], [2, 0], [0, 2]])
    np.testing.assert_allclose(new.weights, [0.8 * 0.99**2, 0.2, 0.05 * 2 * 0.8 * 0.99**2])
    np.testing.assert_allclose(new.means, [F @ m, np.zeros(4), F @ m])
    np.testing.assert_allclose(new.covariances[0], F @ P @ F.T + 9.0 * G @ G.T)
    np.testing.assert_allclose(new.covariances[2], F @ P @ F.T + np.diag([100.0, 100.0, 400.0, 400.0]))
    assert len(set(new.labels.tolist())) == 3


def test_point_filter_follows_point_targets() -> None:
    rng = np.random.default_rng(4)
    filter_ = PointTargetPhd(PhdConfig(births=BIRTHS, spawn=None))
    for k in range(20):
        centre = np.array([10.0 * k, -5.0 * k])
        z = np.vstack([centre + rng.normal(0, 20, 2), rng.uniform(-1000, 1000, (10, 2))])
        targets = filter_.step(z, float(k))
    assert len(targets) == 1
    assert np.linalg.norm(targets[0].mean[:2] - [190.0, -95.0]) < 40.0
    # The point model takes the returns of an extended target for as many targets.
    crowd = PointTargetPhd(PhdConfig(births=BIRTHS))
    followed(crowd)
    assert crowd.expected_count > 3.0


def test_detection_model_is_replaceable() -> None:
    """A target while nothing can be seen is kept; `sensor_pose` reaches the model."""
    poses = []

    class Hidden:
        hidden = False

        def __call__(self, means: np.ndarray, sensor_pose: np.ndarray | None) -> np.ndarray:
            poses.append(sensor_pose)
            return np.full(len(means), 0.01 if self.hidden else 0.99)

    model = Hidden()
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS), detection=model)
    followed(filter_)
    model.hidden = True
    for k in range(20, 25):
        targets = filter_.step(np.zeros((0, 2)), float(k), sensor_pose=[1.0, 2.0, 0.0])
    assert len(targets) == 1
    np.testing.assert_array_equal(poses[-1], [1.0, 2.0, 0.0])


def test_broken_points_are_dropped_and_counted() -> None:
    clean, dirty = (ExtendedTargetPhd(PhdConfig(births=BIRTHS)) for _ in range(2))
    rng = np.random.default_rng(5)
    for k in range(5):
        z = scan(rng, [[0.0, 0.0]])
        expected = clean.step(z, float(k))
        bad = np.array([[np.nan, 0.0], [np.inf, 1.0], [2.0, -np.inf]])
        found = dirty.step(np.vstack([bad, z]), float(k))
        np.testing.assert_array_equal(positions(found), positions(expected))
    assert dirty.health.dropped == 15
    assert clean.health.dropped == 0


@pytest.mark.parametrize("name", ["mixture", "phd"])
def test_thousands_of_returns_are_thinned_with_a_warning(name: str) -> None:
    filter_ = ExtendedTargetPhd(PhdConfig(max_measurements=500, max_partitions=10, filter=name))
    z = np.random.default_rng(6).normal(0, 100, (5000, 2))
    with pytest.warns(UserWarning, match="5000 returns"):
        filter_.step(z, 0.0)
    assert filter_.health.thinned_scans == 1
    assert filter_.health.thinned_partitions >= (name == "phd")
    assert np.isfinite(filter_.expected_count)


def test_a_crowded_place_of_birth_costs_no_more_than_is_allowed() -> None:
    """1500 returns where 10 are a target: what is searched is cut, counted, and gives finite targets."""
    rng = np.random.default_rng(10)
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS))
    for k in range(7):
        targets = filter_.step(rng.normal(0, 25, (1500, 2)), float(k))
    assert filter_.health.thinned_partitions >= 1
    assert all(np.isfinite(target.mean).all() for target in targets)
    assert np.isfinite(filter_.expected_count)


def test_gmphd_is_the_filter_for_points() -> None:
    rng = np.random.default_rng(4)
    ours, theirs = ExtendedTargetPhd(PhdConfig(filter="gmphd")), PointTargetPhd(PhdConfig())
    for k in range(5):
        z = scan(rng, [[250.0, 250.0]], rate=1.0)
        np.testing.assert_array_equal(positions(ours.step(z, float(k))), positions(theirs.step(z, float(k))))
    assert ours.expected_count == theirs.expected_count


def test_as_printed_is_the_text_s_filter_with_the_scene_s_own_values() -> None:
    """Table 1 and (17), (18) for the simulations; no sub-partitions; the thresholds of Section 4.1."""
    config = PhdConfig.as_printed()
    assert (config.filter, config.subpartitions, config.occluders) == ("phd", False, "bearings")
    assert config.distance_probabilities == (0.30, 0.80)
    assert (config.measurement_rate, config.measurement_noise, config.process_noise) == (10.0, 20.0, 2.0)
    weight, mean, covariance = config.births[1]
    np.testing.assert_array_equal(mean, [-250.0, -250.0, 0.0, 0.0])
    np.testing.assert_array_equal(covariance, np.diag([100.0, 100.0, 25.0, 25.0]))
    assert (weight, config.spawn[0]) == (0.1, 0.05)
    assert PhdConfig.as_printed(clutter_rate=3.0, births=BIRTHS).clutter_rate == 3.0
    for name, value in {"occluders": "both", "filter": "pmbm", "merge_targets": 1}.items():
        with pytest.raises(InputError, match=name):
            PhdConfig.as_printed(**{name: value})


def test_stamps_equal_old_and_far_apart() -> None:
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS, late_window=1.0, max_gap=30.0))
    followed(filter_)
    same = filter_.step(np.zeros((0, 2)), 19.0)
    assert filter_.health.restarts == 0
    assert len(same) <= 1
    assert filter_.step(np.zeros((0, 2)), 10.0) == []
    assert filter_.health.restarts == 1
    filter_.step(np.zeros((0, 2)), 40.0)
    assert filter_.health.restarts == 1
    filter_.step(np.zeros((0, 2)), 71.0)
    assert filter_.health.restarts == 2


@pytest.mark.parametrize("name", ["mixture", "phd"])
def test_late_scans_end_where_punctual_ones_do(name: str) -> None:
    """Scans that arrive in another order within the window give the same targets under the same labels."""
    rng = np.random.default_rng(9)
    scans = [(0.1 * k, scan(rng, [[float(k), -0.5 * k]])) for k in range(40)]
    order = [int(k) for block in range(8) for k in 5 * block + rng.permutation(5)]
    order[order.index(0)], order[0] = order[0], 0
    config = PhdConfig(births=BIRTHS, filter=name, scan_period=0.1)
    punctual, shuffled = ExtendedTargetPhd(config), ExtendedTargetPhd(config)
    for stamp, points in scans:
        expected = punctual.step(points, stamp)
    for k in order:
        stamp, points = scans[k]
        found = shuffled.step(points, stamp)
    assert shuffled.health.late > 10
    assert shuffled.health.skipped == shuffled.health.restarts == 0
    assert [target.label for target in found] == [target.label for target in expected]
    np.testing.assert_allclose(positions(found), positions(expected))
    assert shuffled.expected_count == pytest.approx(punctual.expected_count)


def test_a_scan_later_than_remembered_is_skipped_and_counted() -> None:
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS, late_window=50.0, late_scans=3))
    (target,) = followed(filter_)
    (same,) = filter_.step(np.zeros((0, 2)), 2.5)
    assert filter_.health.skipped == 1
    assert filter_.health.late == 0
    np.testing.assert_array_equal(same.mean, target.mean)


def test_rates_do_not_depend_on_the_scan_interval() -> None:
    """Ten scans of 0.1 s without any sight bring as many births and deaths as one of 1 s."""
    blind = {"births": BIRTHS, "detection_probability": 1e-9, "spawn": None, "merge_distance": 1e3}
    counts = []
    for steps in (1, 10):
        filter_ = ExtendedTargetPhd(PhdConfig(**blind))
        filter_.step(np.zeros((0, 2)), 0.0)
        for k in range(steps):
            filter_.step(np.zeros((0, 2)), (k + 1) / steps)
        counts.append(filter_.expected_count)
    assert counts[0] == pytest.approx(0.1 * 0.99 + 0.1)
    assert counts[1] == pytest.approx(counts[0], rel=0.01)


def test_indefinite_covariances_are_repaired() -> None:
    whole = ExtendedTargetPhd(PhdConfig(births=BIRTHS, filter="phd"))
    followed(whole)
    filter_ = whole.recursion
    assert isinstance(filter_, PhdRecursion)
    broken = filter_.components
    broken.covariances[0] = np.diag([10.0, 10.0, 5.0, -1e-6])
    reduced = Reducer(whole.config, filter_.labels)
    fixed = reduced.reduce(broken)
    assert reduced.repaired == 1
    assert np.linalg.eigvalsh(fixed.covariances).min() > 0


def test_merging_keeps_weight_and_moments() -> None:
    filter_ = text_filter(PhdConfig(merge_distance=1e9))
    rng = np.random.default_rng(8)
    root = rng.normal(size=(5, 4, 4))
    P = root @ np.swapaxes(root, 1, 2) + np.eye(4)
    weights = np.array([0.3, 0.2, 0.15, 0.1, 0.05])
    mixture = filter_.motion.fresh(weights, rng.normal(size=(5, 4)), P, filter_.labels)
    merged = filter_.reducer.reduce(mixture)
    share = weights / weights.sum()
    mean = share @ mixture.means
    spread = mixture.means - mean
    assert len(merged) == 1
    assert merged.weights[0] == pytest.approx(weights.sum())
    np.testing.assert_allclose(merged.means[0], mean)
    expected = np.einsum("k,kij->ij", share, P + spread[:, :, None] * spread[:, None, :])
    np.testing.assert_allclose(merged.covariances[0], expected)


def test_capping_keeps_the_heaviest() -> None:
    filter_ = text_filter(PhdConfig(max_components=3, merge_distance=0.0))
    weights = np.array([0.1, 0.4, 0.2, 0.3, 0.0001])
    means = np.arange(20.0).reshape(5, 4) * 100
    kept = filter_.reducer.reduce(
        filter_.motion.fresh(weights, means, np.tile(np.eye(4), (5, 1, 1)), filter_.labels)
    )
    np.testing.assert_array_equal(kept.weights, [0.4, 0.3, 0.2])


def test_labels_go_where_most_of_their_weight_is() -> None:
    labels = Labels()
    labels.take(10)
    evidence = np.array([[0.9, 0.1], [0.54, 0.46], [0.7, 0.0], [0.05, 0.0]])
    found = distinct_labels(evidence.sum(1), evidence, np.array([3, 5]), labels)
    assert found.tolist() == [3, 5, 10, 3]


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("surveillance", ((0.0, 0.0), (0.0, 1.0))),
        ("surveillance", (0.0, 1.0)),
        ("clutter_rate", 0.0),
        ("clutter_rate", np.nan),
        ("detection_probability", 1.5),
        ("survival_probability", 0.0),
        ("measurement_noise", -1.0),
        ("process_noise", np.inf),
        ("measurement_rate", "ten"),
        ("births", [(-0.1, np.zeros(4), np.eye(4))]),
        ("births", [(0.1, np.zeros(3), np.eye(3))]),
        ("births", [(0.1, np.zeros(4), -np.eye(4))]),
        ("births", 3),
        ("spawn", (0.1, np.eye(2))),
        ("spawn", (np.nan, np.eye(4))),
        ("spawn", 0.1),
        ("partitioner", "best"),
        ("distance_probabilities", (0.8, 0.3)),
        ("max_components", 0),
        ("max_measurements", 2.5),
        ("extraction_weight", 1.0),
        ("memory", 0.5),
    ],
)
def test_nonsense_is_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(InputError, match=name):
        PhdConfig(**{name: value})


def test_every_field_has_a_default() -> None:
    assert PhdConfig().area == 4e6


@pytest.mark.parametrize("bad", [np.zeros((3, 3)), np.zeros(4), "points"])
def test_measurements_of_another_shape_are_refused(bad: object) -> None:
    with pytest.raises(InputError, match="measurements"):
        ExtendedTargetPhd().step(bad, 0.0)


@pytest.mark.parametrize("name", ["mixture", "phd", "gmphd"])
def test_returns_too_far_away_for_numbers_are_dropped_and_counted(name: str) -> None:
    filter_ = ExtendedTargetPhd(PhdConfig(filter=name))
    filter_.step([[1e200, 0.0], [-np.inf, 0.0], [1.0, np.nan], [1.0, 1.0], [1.1, 1.0]], 0.0)
    assert filter_.health.dropped == 3


def test_stamps_and_poses_are_checked() -> None:
    with pytest.raises(InputError, match="config"):
        ExtendedTargetPhd({"filter": "phd"})
    with pytest.raises(InputError, match="stamp"):
        ExtendedTargetPhd().step([], np.nan)
    with pytest.raises(InputError, match="sensor_pose"):
        ExtendedTargetPhd().step([], 0.0, sensor_pose=[0.0, 1.0])


def test_what_is_kept_is_not_the_caller_s() -> None:
    mean = np.zeros(4)
    config = PhdConfig(births=[(0.1, mean, np.eye(4))])
    mean[:] = 9.0
    np.testing.assert_array_equal(config.births[0][1], np.zeros(4))
    filter_ = ExtendedTargetPhd(PhdConfig(births=config.births))
    for k in range(5):
        targets = filter_.step(np.full((8, 2), 1.0), float(k))
    assert targets
    assert not any(array.flags.writeable for t in targets for array in (t.mean, t.covariance, t.extent))
    for bad in (None, "0", True):
        with pytest.raises(InputError, match="stamp"):
            ExtendedTargetPhd().step([], bad)


def test_empty_mixtures_join() -> None:
    assert len(Components.join([Components.empty(), Components.empty()])) == 0
    filter_ = ExtendedTargetPhd(PhdConfig(births=[], spawn=None))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert filter_.step([], 0.0) == []
        assert filter_.step([[1.0, 2.0]], 1.0) == []


def mean_ospa(name: str, realisations: int, **parameters: object) -> float:
    """Mean OSPA (p = 2, c = 60 m) over the first realisations of a benchmark scenario."""
    path = recording(f"extended_targets/{name}.npz")
    if path is None:
        pytest.skip("the benchmark scans are not here")
    with np.load(path) as data:
        truth, rows, given = data["truth"], data["meas"], json.loads(str(data["params"]))
    values = []
    for realisation in np.unique(rows[:, 0])[:realisations]:
        config = PhdConfig(clutter_rate=given["lam_c"], detection_probability=given["pD"], **parameters)
        filter_ = ExtendedTargetPhd(config)
        mine = rows[rows[:, 0] == realisation]
        for k in range(1, given["K"] + 1):
            targets = filter_.step(mine[mine[:, 1] == k, 2:4], float(k))
            values.append(ospa(positions(targets), truth[truth[:, 0] == k, 2:4], 60.0, 2.0))
    return float(np.mean(values))


@pytest.mark.parametrize(("name", "limit"), [("cross_spawn", 12.0), ("parallel", 10.5)])
def test_benchmark_scans(name: str, limit: float) -> None:
    """The text's method must reach 15.0 and 14.0; these limits hold what has been reached."""
    assert mean_ospa(name, 10, filter="phd") <= limit


def test_subpartitions_and_many_thresholds_help_targets_that_meet() -> None:
    best = mean_ospa("cross_spawn", 5, filter="phd")
    single = mean_ospa("cross_spawn", 5, filter="phd", partitioner="single", subpartitions=False)
    assert best < single - 2.0
