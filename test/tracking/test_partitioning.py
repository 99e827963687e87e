"""Distance partitions, sub-partitions, K-means and exhaustive enumeration."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.stats import chi2

from estimation.errors import InputError
from tracking import PhdConfig
from tracking.phd.partitioning import Distances, Exhaustive, KMeans, Singletons, all_partitions
from tracking.phd.partitions import PredictedTargets

NONE = PredictedTargets.none()
PLAIN = PhdConfig(subpartitions=False)


def as_cells(labels: np.ndarray) -> frozenset[tuple[int, ...]]:
    """A clustering as a set of cells."""
    return frozenset(tuple(np.flatnonzero(labels == k).tolist()) for k in np.unique(labels))


def test_all_partitions_count_as_bell_numbers() -> None:
    for count, bell in enumerate([1, 1, 2, 5, 15, 52, 203]):
        found = {frozenset(tuple(sorted(cell)) for cell in p) for p in all_partitions(count)}
        assert len(found) == bell


@pytest.mark.parametrize("seed", range(5))
def test_distance_partitions_are_the_single_linkage_cuts(seed: int) -> None:
    """All thresholds of (12), against scipy's hierarchical clustering; a subset of all partitions."""
    points = np.random.default_rng(seed).normal(0, 10, (7, 2))
    found = Distances(PLAIN, (0.0, 1e4)).partition(points, NONE).as_sets()
    tree = linkage(points, "single")
    thresholds = [0.0, *tree[:, 2] + 1e-9]
    expected = {as_cells(fcluster(tree, t, "distance")) for t in thresholds}
    assert len(found) == len(set(found)) == 7
    assert set(found) == expected
    assert set(found) < set(Exhaustive().partition(points, NONE).as_sets())


def test_thresholds_lie_between_the_quantiles() -> None:
    """Only σ√δ_0.30 to σ√δ_0.80: pairs nearer are always together, pairs farther never."""
    low, high = 20.0 * np.sqrt(chi2.ppf([0.3, 0.8], 2))
    near = Distances(PLAIN).partition(np.array([[0.0, 0.0], [low - 0.1, 0.0]]), NONE)
    between = Distances(PLAIN).partition(np.array([[0.0, 0.0], [low + 0.1, 0.0]]), NONE)
    far = Distances(PLAIN).partition(np.array([[0.0, 0.0], [high + 0.1, 0.0]]), NONE)
    assert near.as_sets() == [{(0, 1)}]
    assert between.as_sets() == [{(0,), (1,)}, {(0, 1)}]
    assert far.as_sets() == [{(0,)}, {(1,)}]
    assert len(np.unique(far.group)) == 2


def test_equal_distances_are_one_threshold() -> None:
    points = 25.0 * np.array([[0, 0], [1, 0], [2, 0], [3, 0]])
    found = Distances(PLAIN).partition(points, NONE).as_sets()
    assert found == [{(0,), (1,), (2,), (3,)}, {(0, 1, 2, 3)}]


def test_duplicate_points_share_a_cell() -> None:
    assert Distances(PLAIN).partition(np.zeros((3, 2)), NONE).as_sets() == [{(0, 1, 2)}]


def two_targets(gap: float) -> tuple[np.ndarray, PredictedTargets]:
    """Returns of two targets `gap` apart, ten each, and their predictions."""
    rng = np.random.default_rng(1)
    centres = np.array([[0.0, 0.0], [gap, 0.0]])
    points = np.repeat(centres, 10, axis=0) + rng.normal(0, 10, (20, 2))
    return points, PredictedTargets(centres, np.tile(25.0 * np.eye(2), (2, 1, 1)))


def two_rings() -> tuple[np.ndarray, PredictedTargets]:
    """Ten returns around each of two centres, bridged below the smallest threshold."""
    angles = 2 * np.pi * np.arange(10) / 10
    ring = 15.0 * np.column_stack([np.cos(angles), np.sin(angles)])
    centres = np.array([[0.0, 0.0], [46.0, 0.0]])
    return np.vstack([ring, ring + centres[1]]), PredictedTargets(
        centres, np.tile(25.0 * np.eye(2), (2, 1, 1))
    )


def test_predicted_targets_divide_a_cell() -> None:
    points, targets = two_rings()
    truth = {tuple(range(10)), tuple(range(10, 20))}
    plain = Distances(PLAIN).partition(points, NONE).as_sets()
    divided = Distances(PhdConfig()).partition(points, targets).as_sets()
    assert truth not in plain
    assert truth in divided
    assert set(plain) <= set(divided)


def test_likely_counts_divide_a_cell_without_prediction() -> None:
    points, _ = two_rings()
    truth = {tuple(range(10)), tuple(range(10, 20))}
    assert truth not in Distances(PLAIN).partition(points, NONE).as_sets()
    assert truth in Distances(PhdConfig()).partition(points, NONE).as_sets()


def test_partitions_cover_every_group_once() -> None:
    points, targets = two_targets(40.0)
    points = np.vstack([points, np.random.default_rng(2).uniform(-500, 500, (15, 2))])
    found = Distances(PhdConfig()).partition(points, targets)
    covered = [sorted(i for cell in p for i in cell) for p in found.as_sets()]
    by_group = {g: covered[p] for p, g in enumerate(found.group.tolist())}
    assert all(covered[p] == by_group[g] for p, g in enumerate(found.group.tolist()))
    assert sorted(i for members in by_group.values() for i in members) == list(range(35))
    assert len({(g, s) for g, s in zip(found.group.tolist(), found.as_sets(), strict=True)}) == len(
        found.group
    )


def test_reassignments_count_only_where_targets_overlap() -> None:
    apart, together = (Distances(PhdConfig()).partition(*two_targets(gap)).multiplicity for gap in (300, 1))
    assert apart.max() < 0.1
    # Twenty returns, each as likely from either target: 2^20 assignments, less what the samples tell apart.
    assert 6.0 < together.max() <= 20 * np.log(3)


def test_k_means_has_a_partition_per_number() -> None:
    points = np.random.default_rng(4).normal(0, 10, (6, 2))
    found = KMeans(PLAIN).partition(points, NONE).as_sets()
    assert sorted(len(p) for p in found) == [1, 2, 3, 4, 5, 6]


def test_thinning_is_bounded_and_counted() -> None:
    partitioner = Distances(PhdConfig(max_partitions=5, subpartitions=False), (0.0, 1e4))
    found = partitioner.partition(np.random.default_rng(6).normal(0, 10, (40, 2)), NONE)
    assert len(found.group) == 5
    assert partitioner.thinned == 1


def test_no_returns_have_no_partition() -> None:
    for partitioner in (Distances(PhdConfig()), Singletons(), Exhaustive(), KMeans(PLAIN)):
        assert len(partitioner.partition(np.zeros((0, 2)), NONE).group) == 0


def test_exhaustive_refuses_large_scans() -> None:
    with pytest.raises(InputError, match="at most 10"):
        Exhaustive().partition(np.zeros((11, 2)), NONE)
