"""The Poisson multi-Bernoulli mixture: what it counts, how hypotheses are kept, and what it reaches."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage

from estimation.checks import FloatArray
from evaluation.datasets import recording
from evaluation.phd.phd_monte_carlo import crossing_kept, scored
from evaluation.phd.phd_recorded import config_of
from evaluation.phd.target_scores import Score, labels_kept
from evaluation.scenes.targets import TargetSensor, cross_and_spawn, joined_tracks, straight
from tracking import ExtendedTargetPhd, PhdConfig
from tracking.mixture.birth_seeds import ReturnLooks
from tracking.mixture.components import Components, IntArray
from tracking.mixture.global_hypotheses import Hypotheses
from tracking.mixture.hypothesis_kernels import single_linkage
from tracking.mixture.phd_models import ConstantVelocityMotion, Labels
from tracking.mixture.pmbm import PmbmRecursion

BIRTHS = [(0.1, [0.0, 0.0, 0.0, 0.0], np.diag([400.0, 400.0, 25.0, 25.0]))]


def tracks(means: np.ndarray, existence: np.ndarray, labels: list[int]) -> Components:
    """Tracks with unit covariances."""
    count = len(means)
    made = ConstantVelocityMotion(PhdConfig()).fresh(
        existence, means, np.tile(np.eye(4), (count, 1, 1)), Labels()
    )
    made.labels = np.array(labels, dtype=np.int64)
    return made


def test_a_detection_counts_once_however_improbable_it_was() -> None:
    """1 + P_E (1 - p_D) targets is what a PHD filter makes of one detection (Section 5.3); one is right."""
    rng = np.random.default_rng(0)
    counts = {}
    for name in ("mixture", "phd"):
        config = PhdConfig(
            births=BIRTHS, spawn=None, detection_probability=0.3, filter=name, clutter_rate=0.01
        )
        filter_ = ExtendedTargetPhd(config)
        for k in range(6):
            filter_.step(rng.normal(0, 20, (10, 2)), float(k))
        counts[name] = filter_.expected_count
    # What may be there unseen is counted by both.
    unseen = 0.1 * 0.7 / (1 - 0.7)
    assert counts["mixture"] == pytest.approx(1.0 + unseen, abs=0.05)
    assert counts["phd"] > counts["mixture"] + 0.3


def test_existence_after_a_miss_is_bayes() -> None:
    filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS, spawn=None, detection_probability=0.9))
    rng = np.random.default_rng(1)
    for k in range(40):
        filter_.step(rng.normal((12.0 * k, 0.0), 20, (12, 2)), float(k))
    (target,) = filter_.step(np.zeros((0, 2)), 40.0)
    miss = 1.0 - 0.9 * (1.0 - np.exp(-10.0))
    assert target.weight == pytest.approx(0.99 * miss / (1.0 - 0.99 + 0.99 * miss), rel=1e-6)


def test_far_targets_do_not_know_of_each_other() -> None:
    """Two targets in one filter are followed exactly as each in a filter of its own."""
    rng = np.random.default_rng(2)
    places = [-600.0, 600.0]
    births = [(0.1, [x, 0.0, 0.0, 0.0], np.diag([400.0, 400.0, 25.0, 25.0])) for x in places]
    both = ExtendedTargetPhd(PhdConfig(births=births))
    single = [ExtendedTargetPhd(PhdConfig(births=[birth])) for birth in births]
    for k in range(15):
        z = [np.array([x, 4.0 * k]) + rng.normal(0, 20, (rng.poisson(10), 2)) for x in places]
        together = both.step(np.vstack(z), float(k))
        apart = [filter_.step(part, float(k)) for filter_, part in zip(single, z, strict=True)]
    assert len(together) == 2
    assert isinstance(both.recursion, PmbmRecursion)
    assert len(set(both.recursion.hypotheses.group.tolist())) == 2
    for target, (own,) in zip(sorted(together, key=lambda t: t.mean[0]), apart, strict=True):
        np.testing.assert_allclose(target.mean, own.mean, rtol=1e-9)
        np.testing.assert_allclose(target.covariance, own.covariance, rtol=1e-9)
    assert both.expected_count == pytest.approx(sum(filter_.expected_count for filter_ in single))


def test_hypotheses_that_agree_are_merged_with_their_moments() -> None:
    means = np.array([[0.0, 0, 0, 0], [50, 0, 0, 0], [0.5, 0, 0, 0], [50.2, 0, 0, 0], [0.0, 0, 0, 0]])
    made = tracks(means, np.array([1.0, 1.0, 1.0, 0.5, 1.0]), [7, 8, 7, 8, 7])
    group = [(np.log(0.6), (0, 1)), (np.log(0.3), (2, 3)), (np.log(0.1), (4,))]
    reduced = Hypotheses.of(made, [group]).reduced(1.0, 20.0, 10, 1e-3)
    assert len(reduced) == 1
    assert reduced.log_weights[0] == pytest.approx(0.0)
    assert reduced.tracks.labels.tolist() == [7, 8]
    np.testing.assert_allclose(reduced.tracks.weights, [1.0, 0.6 + 0.3 * 0.5])
    assert reduced.tracks.means[0, 0] == pytest.approx(0.3 * 0.5)
    spread = 0.7 * 0.15**2 + 0.3 * 0.35**2
    assert reduced.tracks.covariances[0, 0, 0] == pytest.approx(1.0 + spread)


def test_hypotheses_that_differ_stay_and_are_capped() -> None:
    means = np.array(
        [[0.0, 0, 0, 0], [50, 0, 0, 0], [50.0, 0, 0, 0], [20, 0, 0, 0], [9, 0, 0, 0], [90, 0, 0, 0]]
    )
    made = tracks(means, np.ones(6), [7, 8, 7, 8, 7, 8])
    group = [(np.log(0.6), (0, 1)), (np.log(0.39), (2, 3)), (np.log(0.01), (4, 5))]
    hypotheses = Hypotheses.of(made, [group])
    assert len(hypotheses.reduced(1.0, 20.0, 10, 1e-3)) == 3
    assert len(hypotheses.reduced(1.0, 20.0, 2, 1e-3)) == 2
    assert len(hypotheses.reduced(1.0, 1.0, 10, 1e-3)) == 2
    assert np.exp(hypotheses.reduced(1.0, 1.0, 10, 1e-3).log_weights).sum() == pytest.approx(1.0)


def test_the_same_target_under_two_labels_is_one() -> None:
    # Somebody at 0 m is 7 by one hypothesis and 8 by the other, and each has a ghost of the other label elsewhere.
    means = np.array([[0.0, 0, 0, 0], [9.0, 0, 0, 0], [0.1, 0, 0, 0], [-9.0, 0, 0, 0]])
    made = tracks(means, np.array([1.0, 0.2, 1.0, 0.2]), [7, 8, 8, 7])
    group = [(np.log(0.52), (0, 1)), (np.log(0.48), (2, 3))]
    reduced = Hypotheses.of(made, [group]).reduced(1.0, 20.0, 10, 1e-3)
    assert len(reduced) == 1
    assert reduced.tracks.labels.tolist() == [7, 8]
    np.testing.assert_allclose(reduced.tracks.weights, [1.0, 0.52 * 0.2])


def test_hypotheses_that_put_one_target_at_two_places_are_two() -> None:
    means = np.array([[0.0, 0, 0, 0], [9.0, 0, 0, 0], [0.1, 0, 0, 0], [-9.0, 0, 0, 0]])
    made = tracks(means, np.array([1.0, 0.9, 1.0, 0.9]), [7, 8, 8, 7])
    group = [(np.log(0.52), (0, 1)), (np.log(0.48), (2, 3))]
    assert len(Hypotheses.of(made, [group]).reduced(1.0, 20.0, 10, 1e-3)) == 2


def test_a_target_of_the_less_likely_hypothesis_goes_by_the_names_of_the_likelier() -> None:
    # 7 and 8 have changed places in the second, which alone has a third target; there it is called 8.
    means = np.array([[0.0, 0, 0, 0], [0.1, 0, 0, 0], [5.0, 0, 0, 0]])
    made = tracks(means, np.array([1.0, 1.0, 0.5]), [7, 9, 7])
    group = [(np.log(0.6), (0,)), (np.log(0.4), (1, 2))]
    reduced = Hypotheses.of(made, [group]).reduced(1.0, 20.0, 10, 1e-3)
    assert reduced.tracks.labels.tolist() == [7, 9]
    np.testing.assert_allclose(reduced.tracks.weights, [1.0, 0.4 * 0.5])


def test_groups_divide_by_marginals_and_join_by_products() -> None:
    means = np.arange(16.0).reshape(4, 4) * 100
    made = tracks(means, np.ones(4), [7, 8, 7, 9])
    hypotheses = Hypotheses.of(made, [[(np.log(0.7), (0, 1)), (np.log(0.3), (2,))], [(0.0, (3,))]])
    divided = hypotheses.arranged([0, 1, 0, 2], 10)
    assert {len(value) for value in divided.values()} == {1, 2}
    weights = sorted(np.exp(value) for value, _ in divided[1])
    np.testing.assert_allclose(weights, [0.3, 0.7])
    assert (pytest.approx(np.log(0.3)), ()) in divided[1]
    joined = hypotheses.arranged([0, 0, 0, 0], 10)
    assert [rows for _, rows in joined[0]] == [(0, 1, 3), (2, 3)]


def test_rates_are_learnt_and_used() -> None:
    """A target of 25 returns where 10 are configured is one target once rates may differ."""
    sensor = TargetSensor(rate=25.0)
    found = {}
    for spread in (0.0, 0.5):
        rng = np.random.default_rng(3)
        filter_ = ExtendedTargetPhd(PhdConfig(births=BIRTHS, rate_spread=spread))
        counts = []
        for k in range(25):
            targets = filter_.step(sensor.returns(np.array([[6.0 * k, 3.0 * k]]), rng), float(k))
            counts.append(len(targets))
        found[spread] = float(np.mean(counts[5:]))
    assert found[0.5] == pytest.approx(1.0, abs=0.1)
    assert found[0.0] > 1.5
    assert 21.0 < targets[0].rate < 29.0


def test_many_targets_from_a_wide_place_of_birth() -> None:
    """Targets appear anywhere: one birth component over the whole area."""
    births = [(0.5, [0.0, 0.0, 0.0, 0.0], np.diag([1e6, 1e6, 100.0, 100.0]))]
    rng = np.random.default_rng(4)
    places = np.array([[-500.0, 300.0], [0.0, 0.0], [400.0, -700.0], [120.0, 40.0]])
    scene = joined_tracks([(0, straight(place, [5.0, -3.0], 25)) for place in places], 25)
    filter_ = ExtendedTargetPhd(PhdConfig(births=births, spawn=None))
    score = Score(60.0)
    for k, there in enumerate(scene.positions):
        score.add(filter_.step(TargetSensor().returns(there, rng), float(k)), there, filter_.expected_count)
    assert score.count[5:] == [4] * 20
    assert np.mean(score.ospa[5:]) < 12.0


def test_crossings_keep_their_labels() -> None:
    """At least 95 % must (`whereabouts experiment phd` takes 500)."""
    assert np.mean([crossing_kept({}, seed) for seed in range(40)]) >= 0.95


def clear_mot(
    score: Score, truth: list[FloatArray], identities: list[IntArray], gate: float
) -> dict[str, float]:
    """CLEAR MOT and IDF1 of a scored run: mota, motp (m), idf1, num_switches, num_misses, num_false_positives.

    truth, identities : positions (n, 2) and numbers (n,) per scan; gate : m within which a report may be a target.
    Needs `motmetrics` (requirements/evaluation.txt).
    """
    import motmetrics

    events = motmetrics.MOTAccumulator(auto_id=True)
    for found, labels, true, names in zip(score.found, score.labels, truth, identities, strict=True):
        squares = (
            ((true[:, None] - found[None]) ** 2).sum(-1)
            if len(true) and len(found)
            else np.zeros((len(true), 0))
        )
        distances = np.sqrt(squares)
        distances[distances > gate] = np.nan
        events.update(names.tolist(), labels if distances.shape[1] else [], distances)
        if len(true) == 0 and labels:
            events.update([], labels, [])
    wanted = ["mota", "motp", "idf1", "num_switches", "num_misses", "num_false_positives"]
    row = motmetrics.metrics.create().compute(events, metrics=wanted, name="run").iloc[0]
    return {name: float(row[name]) for name in wanted}


def test_evaluation_agrees_with_itself() -> None:
    """CLEAR MOT, GOSPA's parts, cardinality and labels of one run."""
    pytest.importorskip("motmetrics")
    scene = cross_and_spawn(60)
    score = scored(scene, {}, 5)
    found = clear_mot(score, scene.positions, scene.identities, 60.0)
    assert found["mota"] > 0.9
    assert found["num_switches"] == 0
    assert found["motp"] < 15.0
    assert score.count_bias == pytest.approx(0.0, abs=0.1)
    assert labels_kept(score, scene.positions, 40, 59)


@pytest.mark.parametrize(
    ("name", "limit"), [("cross_spawn", 10.5), ("parallel", 6.2), ("six", 7.0), ("six_pd09", 9.5)]
)
def test_recorded_scans(name: str, limit: float) -> None:
    """OSPA and cardinality on the scans of `extended_targets`."""
    path = recording(f"extended_targets/{name}.npz")
    if path is None:
        pytest.skip("the benchmark scans are not here")
    with np.load(path) as data:
        truth, rows, given = data["truth"], data["meas"], json.loads(str(data["params"]))
    scores = []
    for realisation in np.unique(rows[:, 0]):
        filter_, score = ExtendedTargetPhd(config_of(given)), Score(60.0)
        mine = rows[rows[:, 0] == realisation]
        for k in range(1, given["K"] + 1):
            targets = filter_.step(mine[mine[:, 1] == k, 2:4], float(k))
            score.add(targets, truth[truth[:, 0] == k, 2:4], filter_.expected_count)
        scores.append(score)
    assert np.mean([score.mean_ospa for score in scores]) <= limit
    assert abs(np.mean([score.count_bias for score in scores])) <= 0.1
    assert abs(np.mean([np.mean(score.expected) - np.mean(score.true_count) for score in scores])) <= 0.1


def test_single_linkage_is_that_of_scipy() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        points, distance = rng.uniform(0.0, 3.0, (rng.integers(2, 30), 2)), rng.uniform(0.05, 1.0)
        found, expected = single_linkage(points, distance), fcluster(linkage(points), distance, "distance")
        np.testing.assert_array_equal(found[:, None] == found, expected[:, None] == expected)
        assert sorted(set(found.tolist())) == list(range(found.max() + 1))


@pytest.mark.parametrize("correlation", [0.0, -0.5, -0.8])
def test_returns_to_either_side_of_the_middle_tell_it_better(correlation: float) -> None:
    """Against the deviation of the mean of drawn pairs whose offsets are correlated like that."""
    config = PhdConfig(
        births=[], spawn=None, detection_probability=0.99, measurement_noise=0.2, measurement_rate=2.0
    )
    recursion = PmbmRecursion(config, _Always())
    recursion.correlation = correlation
    known = tracks(np.array([[0.0, 0.0, 0.0, 0.0]]), np.array([1.0]), [0])
    recursion.hypotheses = Hypotheses.of(known, [[(0.0, (0,))]])
    nothing = np.zeros(2)
    looks = ReturnLooks(np.full(2, -30.0), np.full(2, -30.0), nothing, nothing, np.ones(2))
    recursion.update(np.array([[0.0, 0.15], [0.0, -0.15]]), 0.0, None, looks)
    X = 0.2**2 * np.array([[1.0, correlation], [correlation, 1.0]])
    drawn = np.random.default_rng(1).multivariate_normal([0.0, 0.0], X, 200_000).mean(1)
    expected = 1.0 / (1.0 + 1.0 / drawn.var())
    assert recursion.hypotheses.tracks.covariances[0, 0, 0] == pytest.approx(expected, rel=0.03)


class _Always:
    """Everything is seen."""

    def __call__(self, means: np.ndarray, sensor_pose: np.ndarray | None) -> np.ndarray:
        return np.full(len(means), 0.99)


@pytest.mark.parametrize("exactness", [1.0, 4.0])
def test_a_return_that_is_known_better_tells_more(exactness: float) -> None:
    config = PhdConfig(
        births=[], spawn=None, detection_probability=0.99, measurement_noise=0.2, measurement_rate=1.0
    )
    recursion = PmbmRecursion(config, _Always())
    recursion.hypotheses = Hypotheses.of(tracks(np.zeros((1, 4)), np.array([1.0]), [0]), [[(0.0, (0,))]])
    nothing = np.zeros(1)
    looks = ReturnLooks(nothing - 30.0, nothing - 30.0, nothing, nothing, np.array([exactness]))
    recursion.update(np.array([[0.1, 0.0]]), 0.0, None, looks)
    P = recursion.hypotheses.tracks.covariances[0]
    assert P[0, 0] == pytest.approx(1.0 / (1.0 + exactness / 0.2**2), rel=1e-3)
