"""Counts of partitions against the text's listing, run at every distance."""

import numpy as np

from estimation.checks import FloatArray
from evaluation.phd.phd_partitions import bell_exponent, distinct
from tracking.phd.partitioning import all_partitions


def algorithm_5(points: FloatArray, threshold: float) -> frozenset[tuple[int, ...]]:
    """The partition of (N, 2) at a distance threshold, m, by growing cells return by return, as the listing has it."""
    close = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1)) <= threshold
    cell = np.zeros(len(points), dtype=int)
    for i in range(len(points)):
        waiting = [] if cell[i] else [i]
        number = int(cell.max()) + 1
        while waiting:
            here = waiting.pop()
            if cell[here] == 0:
                cell[here] = number
                waiting += np.flatnonzero(close[here] & (cell == 0)).tolist()
    return frozenset(tuple(np.flatnonzero(cell == k).tolist()) for k in np.unique(cell))


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
