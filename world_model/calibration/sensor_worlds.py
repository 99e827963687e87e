"""Which object each detection of a moving sensor is of, when its errors are as large as the gaps between objects.

Hypotheses, each with a filter of the sensor's errors and all places (`sensor_filter`): a turn that a look shares moves
all its detections, and of two ways to explain them the next looks say which it was. A look's detections are weighed
together.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from estimation.filters.assignment import cheapest
from world_model.anchoring.loops.leaves import IntArray
from world_model.calibration.sensor_bias import JITTER, STEPS
from world_model.calibration.sensor_filter import ERRORS, LOG_2PI, SHARED, SensorFilter

MOST = 8  # Hypotheses that are kept
THRESHOLD = 25.0  # -2 log of the odds to the best from which one is dropped
MEMORY = 30  # SensorDetections that two hypotheses explain alike before they are taken for one
TRIED = 20  # Shared errors for which the best owners are tried
NEAR = 1.0  # m: objects this far from all detections are not asked
WIDE = 25.0  # Variance of a detection that is worse than it says, times that said
SELDOM = 5.0  # -2 log of how often that is
RANGES = np.linspace(-1.5, 1.5, 5)  # Shared errors of range that are tried, in standard deviations
GRID = np.stack(np.meshgrid(RANGES, STEPS), -1).reshape(-1, 2)
COSTS = (GRID**2).sum(1)


@dataclass
class Hypothesis:
    """cost : -2 log of the odds to the best; last : owners of the last detections."""

    cost: float
    filter: SensorFilter
    last: tuple[int, ...] = ()


@dataclass
class SensorDetections:
    """M detections as they came: z (M, 2), R (M, 2, 2), J (M, 2, 10); new (M,) : -2 log density of being of nothing
    known that rests. unlike (M,) by number of an object : -2 log of how well its attributes and height fit.
    turning : yaw rate of the sensor, rad/s."""

    z: FloatArray
    R: FloatArray
    J: FloatArray
    new: FloatArray
    unlike: dict[int, FloatArray]
    turning: float = 0.0


def candidates(filter: SensorFilter, seen: SensorDetections) -> list[tuple[IntArray, FloatArray]]:
    """Ways to explain a look: index of each detection's object, -1 for none, and what its variance is multiplied by."""
    M = len(seen.z)
    nothing = [(np.full(M, -1), np.ones(M))]
    flat = seen.z - np.einsum("mij,j->mi", seen.J, filter.x[:ERRORS])
    near = np.flatnonzero((np.abs(flat[:, None] - filter.places) < NEAR).all(2).any(0))
    if len(near) == 0:
        return nothing
    places, own = filter.places[near], filter.own(near)
    unlike = np.stack([seen.unlike.get(filter.numbers[k], np.zeros(M)) for k in near.tolist()], 1)
    sigma = np.sqrt(filter.prior.diagonal()[SHARED] + np.array([0.0, (JITTER * seen.turning) ** 2]))
    shifts = np.einsum("mij,sj->smi", seen.J[:, :, SHARED], sigma * GRID)
    off = (flat[:, None] - places)[None] - shifts[:, :, None]
    narrow = _costs(off, own[None] + seen.R[:, None]) + unlike
    broad = _costs(off, own[None] + WIDE * seen.R[:, None]) + unlike + SELDOM
    cost = np.minimum(narrow, broad)
    wider = np.where(broad < narrow, WIDE, 1.0)
    order = np.argsort(np.minimum(cost.min(2), seen.new).sum(1) + COSTS, kind="stable")
    found: dict[tuple[int, ...], FloatArray] = {}
    for s in order[:TRIED].tolist():
        owner = _owners(cost[s], seen.new)
        scale = np.where(owner >= 0, wider[s, np.arange(M), owner], 1.0)
        found.setdefault(tuple(owner.tolist()), scale)
    if M == 1:
        middle = int(COSTS.argmin())
        for k in range(len(near)):
            found.setdefault((k,), wider[middle, :, k])
        found.setdefault((-1,), np.ones(1))
    else:
        for owner_ in list(found)[:2]:
            for j in range(M):
                if owner_[j] >= 0:
                    scale = found[owner_].copy()
                    scale[j] = 1.0
                    found.setdefault((*owner_[:j], -1, *owner_[j + 1 :]), scale)
    index = np.append(near, -1)
    return [(index[np.array(owner)], scale) for owner, scale in found.items()]


def _costs(off: FloatArray, S: FloatArray) -> FloatArray:
    """-2 log densities (S, M, K) of displacements (S, M, K, 2) with covariances (M, K, 2, 2)."""
    a, b, c = S[..., 0, 0], S[..., 0, 1], S[..., 1, 1]
    det = a * c - b * b
    x, y = off[..., 0], off[..., 1]
    result: FloatArray = (c * x * x - 2.0 * b * x * y + a * y * y) / det + np.log(det) + 2.0 * LOG_2PI
    return result


def _owners(cost: FloatArray, new: FloatArray) -> IntArray:
    """The best objects (M,) for costs (M, K), each at most once, -1 where none is better than `new` (M,)."""
    M, K = cost.shape
    owner = np.where(cost.min(1) < new, cost.argmin(1), -1)
    some = owner[owner >= 0]
    if len(np.unique(some)) == len(some):
        return owner
    alone = np.full((M, M), 1e9)
    alone[range(M), range(M)] = new
    _, columns = cheapest(np.concatenate([cost, alone], 1))
    return np.where(columns < K, columns, -1)


class SensorWorlds:
    """Hypotheses, the best first. Objects go by numbers of their own."""

    def __init__(self, known: FloatArray) -> None:
        self.known = known
        self.reset()

    def reset(self) -> None:
        """Nothing is known but the calibration."""
        self.hypotheses = [Hypothesis(0.0, SensorFilter(self.known))]
        self._next = 0

    @property
    def best(self) -> SensorFilter:
        """The filter of the most probable hypothesis."""
        return self.hypotheses[0].filter

    def number(self) -> int:
        """One that no object has."""
        self._next += 1
        return self._next

    def predict(self, stamp: float) -> None:
        """All to a later stamp, s."""
        for hypothesis in self.hypotheses:
            hypothesis.filter.predict(stamp)

    def look(self, seen: SensorDetections) -> list[int]:
        """Take a look in: the object (M,) of each detection as the most probable hypothesis has it."""
        fresh = [self.number() for _ in seen.z]
        children: list[tuple[float, Hypothesis, IntArray, FloatArray]] = []
        for parent in self.hypotheses:
            for owner, scale in candidates(parent.filter, seen):
                children.append(
                    (parent.cost + self._cost(parent.filter, seen, owner, scale), parent, owner, scale)
                )
        children.sort(key=lambda child: child[0])
        kept: dict[tuple[int, ...], Hypothesis] = {}
        said: list[int] = []
        for cost, parent, owner, scale in children:
            if cost > children[0][0] + THRESHOLD or len(kept) >= MOST:
                break
            numbers = [parent.filter.numbers[k] if k >= 0 else fresh[j] for j, k in enumerate(owner.tolist())]
            last = (*parent.last, *numbers)[-MEMORY:]
            said = said or numbers
            if last in kept:
                continue
            filter = copy(parent.filter)
            R = seen.R * scale[:, None, None]
            old, new = np.flatnonzero(owner >= 0), np.flatnonzero(owner < 0)
            if len(old):
                filter.correct(owner[old], seen.z[old], R[old], seen.J[old])
            for j in new.tolist():
                filter.begin(fresh[j], seen.z[j], R[j], seen.J[j])
            kept[last] = Hypothesis(cost - children[0][0], filter, last)
        self.hypotheses = list(kept.values())
        return said

    @staticmethod
    def _cost(filter: SensorFilter, seen: SensorDetections, owner: IntArray, scale: FloatArray) -> float:
        old = np.flatnonzero(owner >= 0)
        cost = float(seen.new[owner < 0].sum() + SELDOM * (scale > 1.0).sum())
        if len(old) == 0:
            return cost
        for j in old.tolist():
            unlike = seen.unlike.get(filter.numbers[owner[j]])
            cost += 0.0 if unlike is None else float(unlike[j])
        return cost + filter.misfit(
            owner[old], seen.z[old], seen.R[old] * scale[old, None, None], seen.J[old]
        )

    def drop(self, numbers: set[int]) -> None:
        """Objects that are gone, or are no resting objects, leave all hypotheses."""
        if numbers:
            for hypothesis in self.hypotheses:
                hypothesis.filter.drop(numbers)
