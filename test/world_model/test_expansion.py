"""Children of hypotheses against all associations of all parents, written down plainly."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from world_model.anchoring.loops.contacts import Movers
from world_model.anchoring.loops.expansion import expand
from world_model.anchoring.loops.look import Detections

THRESHOLD = 11.5


def best_child(
    row: np.ndarray, weight: float, matrix: np.ndarray, missing: np.ndarray, new: np.ndarray
) -> float:
    """Log weight of the best association of one parent: every detection has one track, or is new."""
    best = -np.inf
    leaves = row[row >= 0]
    for owners in product(range(-1, len(leaves)), repeat=len(new)):
        used = [owner for owner in owners if owner >= 0]
        if len(set(used)) < len(used):
            continue
        total = weight + sum(missing[leaf] for k, leaf in enumerate(leaves) if k not in used)
        total += sum(new[j] if k < 0 else matrix[leaves[k], j] for j, k in enumerate(owners))
        best = max(best, total)
    return best


@pytest.mark.parametrize("seed", range(30))
def test_of_every_parent_the_best_child_is_kept_where_it_is_near_the_best_of_all(seed: int) -> None:
    rng = np.random.default_rng(seed)
    parents, tracks, detections = 6, 4, int(rng.integers(1, 5))
    rows = rng.integers(-1, 3, (parents, tracks))
    rows += np.where(rows >= 0, 3 * np.arange(tracks), 0)
    leaves = 3 * tracks
    # What explains a detection does so well, as measurements of a centimetre do.
    matrix = np.where(
        rng.random((leaves, detections)) < 0.4, rng.uniform(4.0, 12.0, (leaves, detections)), -np.inf
    )
    missing, new = rng.uniform(-3.0, 0.0, leaves), rng.uniform(-5.0, -3.0, detections)
    weights = -np.sort(rng.uniform(0.0, 25.0, parents))
    none = np.zeros((leaves, 3, 3))
    seen = Detections(
        0.0, 0.0, np.arange(detections), np.zeros((detections, 3)), np.zeros((detections, 3, 3)),
        np.ones((detections, 1)), new, np.ones(detections),
    )  # fmt: skip
    movers = Movers(np.zeros(leaves), np.zeros((leaves, 3)), none, np.zeros(leaves, np.int64), 0.0)
    got, _, values, _ = expand(rows, weights, matrix, missing, seen, movers, 100, THRESHOLD)
    wanted = [best_child(row, w, matrix, missing, new) for row, w in zip(rows, weights, strict=True)]
    assert values[0] == pytest.approx(max(wanted))
    for parent, weight in enumerate(wanted):
        found = values[got == parent]
        if weight > max(wanted) - THRESHOLD + 1e-9:
            assert found.max() == pytest.approx(weight)
        else:
            assert found.size == 0
