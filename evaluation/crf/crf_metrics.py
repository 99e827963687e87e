"""Metrics of the tables of `crf`: accuracy, string edit distance, outliers found, errors of motions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from estimation.geometry.poses import wrap_angle
from evaluation.scenes.labelled_pairs import LabelledPair
from registration.crf.estimate import JointEstimate

RIGHT = 0.5  # of an object's beams, and of its cluster's, from which it is correctly clustered


@dataclass(frozen=True)
class Scores:
    """One pair: shares, edit distances, and errors (rotation rad, translation m) of correctly clustered objects.

    association, clustering : accuracy. outliers_*: share said to be outliers; found_*: share of the true ones found.
    translation is that of the object's middle. objects : by the number of the true one. all_objects : the same of every
        true object, where those not found are taken to stand with the background.
    counts : true positive, false positive, false negative moving beams.
    """

    association: float
    association_sed: float
    outliers_association: float
    found_association: float
    clustering: float
    clustering_sed: float
    outliers_clustering: float
    found_clustering: float
    true_outliers: float
    objects: dict[int, tuple[float, float]]
    all_objects: list[tuple[float, float]]
    background: tuple[float, float]
    counts: tuple[int, int, int]


@njit(cache=True)
def _edit_distance(a, b):  # type: ignore[no-untyped-def]
    row = np.arange(len(b) + 1)
    for i in range(len(a)):
        left, diagonal = i + 1, row[0]
        row[0] = i + 1
        for j in range(len(b)):
            value = min(row[j + 1] + 1, left + 1, diagonal + (a[i] != b[j]))
            diagonal = row[j + 1]
            row[j + 1] = left = value
    return row[len(b)]


def edit_distance(a: NDArray[np.int64], b: NDArray[np.int64]) -> int:
    """Levenshtein distance of two strings of numbers (n,), (m,)."""
    return int(_edit_distance(np.asarray(a), np.asarray(b)))


def renumbered(
    truth: NDArray[np.int64], found: NDArray[np.int64]
) -> tuple[NDArray[np.int64], dict[int, int]]:
    """`found` with its objects numbered as the true ones they overlap most, and which became which."""
    mine, theirs = np.unique(found[found > 0]), np.unique(truth[truth > 0])
    mapping: dict[int, int] = {}
    if len(mine) and len(theirs):
        overlap = np.array([[np.sum((found == e) & (truth == t)) for t in theirs] for e in mine])
        rows, columns = linear_sum_assignment(-overlap)
        mapping = {int(mine[r]): int(theirs[c]) for r, c in zip(rows, columns, strict=True) if overlap[r, c]}
    out = found.copy()
    for e in mine:
        out[found == e] = mapping.get(int(e), 1000 + int(e))
    return out, mapping


def scores(pair: LabelledPair, estimate: JointEstimate) -> Scores:
    """How right an estimate is about a labelled pair, over the beams that returned."""
    valid = pair.valid
    truth, found = pair.associations[valid], estimate.associations[valid]
    true_clusters = pair.clusters[valid]
    clusters, mapping = renumbered(true_clusters, estimate.clusters[valid])
    outlier = truth < 0
    right, missed = _object_errors(pair, estimate, mapping)
    moving, said = pair.moving[valid], estimate.clusters[valid] > 0
    return Scores(
        float(np.mean(truth == found)),
        edit_distance(truth, found),
        float(np.mean(found < 0)),
        _share(found < 0, outlier),
        float(np.mean(true_clusters == clusters)),
        edit_distance(true_clusters, clusters),
        float(np.mean(clusters < 0)),
        _share(clusters < 0, outlier),
        float(np.mean(outlier)),
        right,
        [right.get(k, missed[k]) for k in range(1, len(pair.motions))],
        _error(np.zeros(2), estimate.motions[0], pair.motions[0]),
        (int(np.sum(moving & said)), int(np.sum(~moving & said)), int(np.sum(moving & ~said))),
    )


def _share(found: NDArray[np.bool_], among: NDArray[np.bool_]) -> float:
    return float(np.mean(found[among])) if among.any() else float("nan")


def _object_errors(
    pair: LabelledPair, estimate: JointEstimate, mapping: dict[int, int]
) -> tuple[dict[int, tuple[float, float]], dict[int, tuple[float, float]]]:
    """Errors of correctly clustered true objects, and of every one if it stood with the background."""
    xy = np.zeros((len(pair.scan_a), 2))
    xy[pair.valid] = pair.scan_a.points()
    middles = {k: xy[pair.clusters == k].mean(axis=0) for k in range(1, len(pair.motions))}
    right = {}
    for mine, theirs in mapping.items():
        a, b = estimate.clusters == mine, pair.clusters == theirs
        both = np.sum(a & b)
        if both >= RIGHT * a.sum() and both >= RIGHT * b.sum():
            right[theirs] = _error(middles[theirs], estimate.motions[mine], pair.motions[theirs])
    missed = {k: _error(middle, estimate.motions[0], pair.motions[k]) for k, middle in middles.items()}
    return right, missed


def _error(
    point: NDArray[np.float64], motion: NDArray[np.float64], truth: NDArray[np.float64]
) -> tuple[float, float]:
    """(rotation, distance between where the two motions take a point)."""
    ends = []
    for x, y, yaw in (motion, truth):
        c, s = np.cos(yaw), np.sin(yaw)
        ends.append(np.array([x + c * point[0] - s * point[1], y + s * point[0] + c * point[1]]))
    return abs(float(wrap_angle(motion[2] - truth[2]))), float(np.hypot(*(ends[0] - ends[1])))


def f1_of(counts: Sequence[tuple[float, ...]]) -> tuple[float, float, float]:
    """F1, precision, recall of summed (true positives, false positives, false negatives)."""
    hits, wrong, missed = np.sum(counts, axis=0)
    f1 = 2.0 * hits / max(2.0 * hits + wrong + missed, 1)
    return float(f1), float(hits / max(hits + wrong, 1)), float(hits / max(hits + missed, 1))
