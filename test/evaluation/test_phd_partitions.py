"""Counts of partitions against the text's listing, run at every distance."""

import numpy as np

from evaluation.phd.phd_partitions import algorithm_5, bell_exponent, distinct
from tracking.phd.partitioning import all_partitions


def test_distinct_partitions_are_those_of_algorithm_5():
    rng = np.random.default_rng(0)
    for count in (2, 5, 12):
        points = np.concatenate([rng.normal(0, 1, (count, 2)), rng.uniform(-20, 20, (count, 2))])
        pairs = [np.hypot(*(a - b)) for k, a in enumerate(points) for b in points[:k]]
        for low, high in ((0.0, np.inf), (0.8, 6.0)):
            within = [d for d in pairs if low < d < high] + ([0.0] if low == 0.0 else [])
            made = {algorithm_5(points, d + 1e-9) for d in within}
            assert distinct(points, low, high) == len(made)


def test_bell_numbers():
    for count in (1, 4, 7):
        assert round(10 ** bell_exponent(count)) == sum(1 for _ in all_partitions(count))
