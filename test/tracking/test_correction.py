"""The correction against the stacked form of (9d) and (10) and against the sum over all partitions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from tracking import PhdConfig, PointTargetPhd
from tracking.mixture.components import Components
from tracking.mixture.phd_models import (
    ConstantVelocityMotion,
    Labels,
    OneReturn,
    PoissonCount,
    PositionMeasurement,
    Sight,
)
from tracking.phd.correction import CellStatistics, Corrector, cell_log_factor, centroid_log_likelihood
from tracking.phd.partitioning import Distances, Exhaustive, Singletons, all_partitions
from tracking.phd.partitions import PartitionBuilder, PredictedTargets

CONFIG = PhdConfig(measurement_noise=2.0, measurement_rate=3.0, clutter_rate=4.0, prune_weight=0.0)


def mixture(rng: np.random.Generator, count: int) -> Components:
    """Random components around the origin."""
    root = rng.normal(size=(count, 4, 4))
    covariances = root @ np.swapaxes(root, 1, 2) + np.eye(4)
    return ConstantVelocityMotion(CONFIG).fresh(
        rng.uniform(0.2, 1.2, count), rng.normal(0, 4, (count, 4)), covariances, Labels()
    )


def stacked(m: np.ndarray, P: np.ndarray, z: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
    """(9d) and (10) as printed, with 2n × 2n matrices: likelihood, mean, covariance."""
    n = len(z)
    H = np.tile(np.eye(2, 4), (n, 1))
    R = CONFIG.measurement_noise**2 * np.eye(2 * n)
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    innovation = z.ravel() - H @ m
    return (
        multivariate_normal(H @ m, S).pdf(z.ravel()),
        m + K @ innovation,
        (np.eye(4) - K @ H) @ P,
    )


@pytest.mark.parametrize("n", [1, 2, 7])
def test_cell_likelihood_factorises_exactly(n: int) -> None:
    rng = np.random.default_rng(n)
    components, z = mixture(rng, 3), rng.normal(0, 4, (n, 2))
    builder = PartitionBuilder()
    builder.group([((builder.cell(np.arange(n)),), 0.0)])
    cells = CellStatistics.of(z, builder.build())
    measurement = PositionMeasurement(CONFIG)
    H, R = measurement.H, measurement.R
    logs = cell_log_factor(cells, R)[:, None] + centroid_log_likelihood(
        cells.means, cells.counts, components.means @ H.T, H @ components.covariances @ H.T, R
    )
    expected = [stacked(m, P, z)[0] for m, P in zip(components.means, components.covariances, strict=True)]
    np.testing.assert_allclose(np.exp(logs[0]), expected, rtol=1e-9)


def brute_force(predicted: Components, z: np.ndarray, p_d: float) -> dict[tuple, tuple]:
    """(7) to (10) as printed, over all partitions: {(cell, component): (weight, mean, covariance)}."""
    gamma, density = CONFIG.measurement_rate, CONFIG.clutter_rate / CONFIG.area
    terms: dict[tuple, tuple] = {}
    partitions = [[tuple(sorted(cell)) for cell in partition] for partition in all_partitions(len(z))]
    for cell in {cell for partition in partitions for cell in partition}:
        for j in range(len(predicted)):
            phi, m, P = stacked(predicted.means[j], predicted.covariances[j], z[list(cell)])
            numerator = np.exp(-gamma) * gamma ** len(cell) * p_d * phi / density ** len(cell)
            terms[cell, j] = (numerator * predicted.weights[j], m, P)
    cells = {cell for cell, _ in terms}
    d = {c: (len(c) == 1) + sum(terms[c, j][0] for j in range(len(predicted))) for c in cells}
    products = np.array([np.prod([d[c] for c in partition]) for partition in partitions])
    omega = products / products.sum()
    inside = {c: sum(w for w, p in zip(omega, partitions, strict=True) if c in p) for c in cells}
    return {key: (inside[key[0]] * w / d[key[0]], m, P) for key, (w, m, P) in terms.items()}


def test_correction_equals_brute_force_over_all_partitions() -> None:
    rng = np.random.default_rng(3)
    predicted, z, p_d = mixture(rng, 2), rng.normal(0, 4, (4, 2)), 0.8
    corrector = Corrector(CONFIG, PositionMeasurement(CONFIG), PoissonCount(CONFIG))
    corrector.log_floor = -np.inf
    partitions = Exhaustive().partition(z, PredictedTargets.none())
    assert len(partitions.group) == 15
    corrected = corrector.correct(predicted, Sight.plain(np.full(2, p_d), predicted), z, partitions)
    missed = predicted.weights * (1 - (1 - np.exp(-CONFIG.measurement_rate)) * p_d)
    np.testing.assert_allclose(corrected.weights[:2], missed)
    expected = brute_force(predicted, z, p_d)
    assert len(corrected) == 2 + len(expected)
    keys = [(cell, j) for cell in partitions.cells() for j in range(2)]
    for i, key in enumerate(keys, start=2):
        weight, mean, covariance = expected[key]
        np.testing.assert_allclose(corrected.weights[i], weight, rtol=1e-8)
        np.testing.assert_allclose(corrected.means[i], mean, rtol=1e-8, atol=1e-10)
        np.testing.assert_allclose(corrected.covariances[i], covariance, rtol=1e-7, atol=1e-10)


def test_independent_groups_weigh_like_their_product() -> None:
    """Two far-apart pairs: partitions by group against the product of the groups spelled out as one."""
    rng = np.random.default_rng(5)
    predicted = mixture(rng, 2)
    predicted.means[:, :2] = [[0.0, 0.0], [100.0, 0.0]]
    z = np.array([[0.0, 1.0], [2.0, 0.0], [99.0, 0.0], [101.0, 2.0]])
    apart, joint = PartitionBuilder(), PartitionBuilder()
    choices = {}
    for builder in (apart, joint):
        a, b, ab = (builder.cell(np.array(c)) for c in ([0], [1], [0, 1]))
        c, d, cd = (builder.cell(np.array(c)) for c in ([2], [3], [2, 3]))
        choices[builder] = [((a, b), 0.0), ((ab,), 0.0)], [((c, d), 0.0), ((cd,), 0.0)]
    for choice in choices[apart]:
        apart.group(choice)
    joint.group([(p + q, 0.0) for p, _ in choices[joint][0] for q, _ in choices[joint][1]])
    corrector = Corrector(CONFIG, PositionMeasurement(CONFIG), PoissonCount(CONFIG))
    corrector.log_floor = -np.inf
    results = [
        corrector.correct(predicted, Sight.plain(np.full(2, 0.9), predicted), z, b.build())
        for b in (apart, joint)
    ]
    np.testing.assert_allclose(results[0].weights, results[1].weights, rtol=1e-9)


def test_distance_partitions_weigh_in_proportion_to_the_exhaustive_ones() -> None:
    """Restricting the sum to the distance partitions keeps their weights in the same proportions."""
    from tracking.phd.correction import partition_log_weights

    rng = np.random.default_rng(11)
    z = rng.normal(0, 2, (6, 2))
    config = PhdConfig(measurement_noise=2.0, subpartitions=False)
    some = Distances(config, (0.0, 1e3)).partition(z, PredictedTargets.none())
    every = Exhaustive().partition(z, PredictedTargets.none())
    value = {cell: float(i % 7) - 0.3 * len(cell) for i, cell in enumerate(every.cells())}
    weights = []
    for partitions in (some, every):
        log_d = np.array([value[cell] for cell in partitions.cells()])
        log_omega, _ = partition_log_weights(log_d, partitions)
        assert np.exp(log_omega).sum() == pytest.approx(1.0)
        weights.append(dict(zip(partitions.as_sets(), log_omega, strict=True)))
    assert len(weights[0]) == 6
    offsets = [weights[0][p] - weights[1][p] for p in weights[0]]
    np.testing.assert_allclose(offsets, offsets[0])
    assert offsets[0] > 0.1


def test_point_filter_is_that_of_vo_and_ma() -> None:
    """Weights p_D w q(z) / (κ + Σ p_D w q(z)) of every return, and 1 - p_D of what is missed."""
    rng = np.random.default_rng(7)
    predicted, z, p_d = mixture(rng, 3), rng.normal(0, 5, (5, 2)), 0.9
    corrector = Corrector(CONFIG, PositionMeasurement(CONFIG), OneReturn())
    corrector.log_floor = -np.inf
    partitions = Singletons().partition(z, PredictedTargets.none())
    corrected = corrector.correct(predicted, Sight.plain(np.full(3, p_d), predicted), z, partitions)
    q = np.array(
        [
            [
                stacked(m, P, point[None])[0]
                for m, P in zip(predicted.means, predicted.covariances, strict=True)
            ]
            for point in z
        ]
    )
    top = p_d * predicted.weights * q
    expected = top / (CONFIG.clutter_rate / CONFIG.area + top.sum(1, keepdims=True))
    np.testing.assert_allclose(corrected.weights[:3], predicted.weights * (1 - p_d))
    np.testing.assert_allclose(corrected.weights[3:], expected.ravel(), rtol=1e-9)
    assert isinstance(PointTargetPhd().recursion.partitioner, Singletons)
