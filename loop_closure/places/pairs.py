"""Pairs of places for training and judging: which two are one place, by the poses of a log (section 5.1 of Paper A).

    rule = PairRule(distance=2.0, path_gap=20.0, max_turn=math.radians(45))
    pairs = sample_pairs(poses, rule, negatives=10_000, seed=0)
    F = compare_pairs(places, pairs)          # (M, 44 | 41), pairs.same (M,) 0 or 1

Positive are pairs nearer than `distance`, negative is a random subset of all others. Pairs close along the path are
neither, unless the rule counts `neighbours`: that a robot is where it has just been is no discovery.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, require_count, require_positive
from estimation.errors import InputError
from loop_closure.places.comparison import PlaceDatabase
from loop_closure.places.features import PlaceFeatures

IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class PairRule:
    """What makes two poses of a log a positive or a negative pair.

    Parameters
    ----------
    distance : metres; nearer is the same place.
    path_gap : metres of path between the two at least; 0 lets neighbours in time be pairs.
    max_turn : radians; pairs of both classes whose headings differ by more are left out. π: all headings.
    apart : metres from which a pair is another place; between `distance` and this it is neither. 0: `distance`.
    index_gap : positions in the log between the two at least.
    neighbours : path_gap is asked of negative pairs only, so that positive ones may follow each other in the log.

    Raises
    ------
    InputError : a value out of its range.
    """

    distance: float = 1.0
    path_gap: float = 20.0
    max_turn: float = math.pi
    apart: float = 0.0
    index_gap: int = 1
    neighbours: bool = False

    def __post_init__(self) -> None:
        require_positive("distance", self.distance)
        require_positive("max_turn", self.max_turn)
        require_count("index_gap", self.index_gap)
        if not 0.0 <= self.path_gap < math.inf or not 0.0 <= self.apart < math.inf:
            raise InputError("path_gap and apart must be finite and not below 0")


@dataclass(frozen=True, eq=False)
class Pairs:
    """Pairs of places by index: first (M,), second (M,) and same (M,), 1 for one place and 0 for two."""

    first: IntArray
    second: IntArray
    same: npt.NDArray[np.int8]

    def __len__(self) -> int:
        return len(self.same)

    @property
    def positives(self) -> int:
        return int(self.same.sum())

    def take(self, rows: npt.NDArray[np.integer] | npt.NDArray[np.bool_]) -> Pairs:
        """The pairs of these rows."""
        return Pairs(self.first[rows], self.second[rows], self.same[rows])

    def by_first(self) -> Iterator[tuple[int, IntArray]]:
        """Each place that is first in a pair, with the rows of its pairs: one query against many."""
        order = np.argsort(self.first, kind="stable")
        starts = np.flatnonzero(np.diff(self.first[order], prepend=-1))
        for rows in np.split(order, starts[1:]):
            if len(rows):
                yield int(self.first[rows[0]]), rows


def path_lengths(positions: npt.ArrayLike) -> FloatArray:
    """Metres travelled up to each of the positions (N, 2 or more columns), (N,) from 0."""
    points = as_finite("positions", positions)
    if points.ndim != 2 or points.shape[1] < 2:
        raise InputError(f"positions must have shape (N, 2) or more columns, not {points.shape}")
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))))[: len(points)]


def sample_pairs(
    poses: npt.ArrayLike,
    rule: PairRule,
    negatives: int = 10_000,
    positives: int | None = None,
    seed: int = 0,
    path: npt.ArrayLike | None = None,
) -> Pairs:
    """All positive pairs of a log and a random subset of its negative ones, positives first, either in random order.

    Parameters
    ----------
    poses : (N, 3) [x, y, yaw] of planar places, or (N, 4) [x, y, z, yaw]; positions alone, (N, 2), where max_turn is π.
    negatives : how many at most. positives : at most so many, drawn at random; None for all.
    path : (N,) metres travelled up to each; None to take it from the poses.

    Raises
    ------
    InputError : wrong shapes, or fewer than two places.
    """
    poses = as_finite("poses", poses)
    if poses.ndim != 2 or poses.shape[1] not in (2, 3, 4) or len(poses) < 2:
        raise InputError(
            f"poses must have shape (N, 2), (N, 3) or (N, 4) with N at least 2, not {poses.shape}"
        )
    if poses.shape[1] == 2 and rule.max_turn < math.pi:
        raise InputError("poses: headings are needed where the rule limits them")
    where = poses[:, :3] if poses.shape[1] == 4 else poses[:, :2]
    travelled = path_lengths(where) if path is None else as_finite("path", path)
    if travelled.shape != (len(poses),):
        raise InputError(f"path must have shape ({len(poses)},), not {travelled.shape}")
    near, far = _candidates(where, poses[:, -1], travelled, rule)
    rng = np.random.default_rng(seed)
    near, far = _draw(near, positives, rng), _draw(far, negatives, rng)
    both = np.concatenate((near, far))
    same = np.concatenate((np.ones(len(near), dtype=np.int8), np.zeros(len(far), dtype=np.int8)))
    return Pairs(both // len(poses), both % len(poses), same)


def _candidates(
    where: FloatArray, yaw: FloatArray, travelled: FloatArray, rule: PairRule
) -> tuple[IntArray, IntArray]:
    """All positive and all negative pairs, each as i N + j with i < j; row by row, to spare memory."""
    count = len(where)
    near: list[IntArray] = []
    far: list[IntArray] = []
    for i in range(count - rule.index_gap):
        j = np.arange(i + rule.index_gap, count)
        apart = np.linalg.norm(where[j] - where[i], axis=1)
        revisit = np.abs(travelled[j] - travelled[i]) >= rule.path_gap
        turn = np.abs(np.mod(yaw[j] - yaw[i] + math.pi, 2.0 * math.pi) - math.pi)
        alike = turn <= rule.max_turn
        near.append(i * count + j[alike & (revisit | rule.neighbours) & (apart < rule.distance)])
        far.append(i * count + j[alike & revisit & (apart >= max(rule.distance, rule.apart))])
    nothing = np.zeros(0, dtype=np.int64)
    return np.concatenate([nothing, *near]), np.concatenate([nothing, *far])


def _draw(found: IntArray, most: int | None, rng: np.random.Generator) -> IntArray:
    """At most so many, in random order: who takes the first of them must not get the beginning of the path."""
    order = rng.permutation(len(found))
    return found[order if most is None else order[:most]]


def compare_pairs(places: Sequence[PlaceFeatures], pairs: Pairs) -> FloatArray:
    """Pair features of all pairs, (M, 44 | 41) in their order. InputError for places that do not match."""
    database = PlaceDatabase(places)
    width = len(places[0].values) + len(places[0].histograms)
    F = np.empty((len(pairs), width))
    for query, rows in pairs.by_first():
        F[rows] = database.compare(places[query], pairs.second[rows])
    return F
