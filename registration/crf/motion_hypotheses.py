"""What may have moved, and how.

Points that the background's motion does not explain are gathered in groups; each group votes for the displacement
that lays it on what is new in the second scan (a Hough transform over pairs of points), and the best few are refined.
A motion is kept where it explains clearly more of both scans than standing still does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from estimation.geometry.poses import inverse
from estimation.geometry.sight import AGREES, HIDDEN, THROUGH
from registration.crf.beams import Beams, ends_of, moved, nearest_point, nearness, seen, shifted, sighted
from registration.crf.displacement import Goals, Group, Views, best_motion, claim
from registration.laser.outline import CLEAR, length

LARGEST = 7.0  # metres, extent of what moves
TURN_SIGMA = 0.12  # radians a thing may be expected to turn between the scans
ROUND = 0.6  # metres; what is smaller shows no rotation
ROUND_SIGMA = 0.02  # radians it is then taken to turn
MOST = 8  # objects
BUSY = 0.25  # of a point, one that lies where something else stands
OWNED = 0.6  # metres to the nearest point of an outline that another scan agrees with
WHOLE = 0.6  # of a piece, from which all that a motion explains of it moves with it


@dataclass(frozen=True, eq=False)
class MotionHypothesis:
    """A group of points of scan a and how it may have moved.

    members : (n,) which points of a belong. motion : (3,) takes points of a to b. gain : points that it explains
    better than standing still. matched : False where b has nothing that fits: its motion is then the background's.
    """

    members: NDArray[np.bool_]
    motion: FloatArray
    gain: float
    matched: bool


def hypotheses(
    a: Beams, b: Beams, background: FloatArray, labels: NDArray[np.int64], fresh: NDArray[np.int64], reach: float,
    noise: float,
) -> tuple[list[MotionHypothesis], NDArray[np.bool_], NDArray[np.bool_]]:  # fmt: skip
    """Groups of a that may have moved, the best explained first; which points (n,), (m,) of a and b these explain.

    background : (3,) motion of what stands. labels : (n,) how b sees the points of a under it (`seen_by`).
    fresh : (m,) how a sees the points of b under its inverse. reach : metres a thing may have gone.
    """
    here = np.zeros(len(a), dtype=bool)
    there = np.zeros(len(b), dtype=bool)
    found = _Search(a, b, background, labels, fresh, reach, noise).found(here, there)
    # What comes nearer hides what was behind it: a sees nothing of that, but b sees something new.
    if np.sum((fresh == THROUGH) & ~there) >= 3:
        back = _Search(b, a, inverse(background), fresh, labels, reach, noise)
        for group in back.found(there, here):
            came = _came_from(a, b, group, labels, nearness(a, noise)) if group.matched else None
            if came is not None:
                found.append(came)
    found.sort(key=lambda hypothesis: -hypothesis.gain)
    found = [one for one in found if one.matched][:MOST] + [one for one in found if not one.matched]
    return found, here, there


def left_their_place(a: Beams, labels: NDArray[np.int64]) -> NDArray[np.int64]:
    """(n,) number of the group that may have moved each point of a is in, -1 for none; labels (n,) by `seen_by`."""
    return np.asarray(_groups(a.points, a.pieces, labels, a.ranges[a.beams], LARGEST), dtype=np.int64)


@njit(cache=True)
def _groups(points, pieces, labels, ranges, largest):  # type: ignore[no-untyped-def]
    """Number of the group of each point, -1 for the background.

    A piece may have moved where part of it stands in what the other scan saw through, or where it is hidden from
    it and stands before what is beside it: what is behind its neighbours is what a mover hides.
    """
    n = len(points)
    groups = np.full(n, -1, dtype=np.int64)
    if n == 0:
        return groups
    size = np.bincount(pieces)
    through = (labels == THROUGH) | (labels == CLEAR)
    ends = ends_of(pieces, size)
    for p in range(len(size)):
        f, l, before, beyond = ends[p]
        # A single reading between others is more often false than it is a thing.
        if size[p] < 2:
            continue
        free = hidden = 0
        for k in range(f, l + 1):
            free += pieces[k] == p and through[k]
            hidden += pieces[k] == p and labels[k] == HIDDEN
        stands_out = (before < 0 or ranges[before] > ranges[f]) and (
            beyond >= n or ranges[beyond] > ranges[l]
        )
        least = max(2.0, 0.06 * size[p])
        across = length(points[l, 0] - points[f, 0], points[l, 1] - points[f, 1])
        whole = across < largest and (free >= least or (stands_out and free + hidden >= least))
        for k in range(f, l + 1):
            if pieces[k] == p and (whole or through[k]):
                groups[k] = f
    return groups


@njit(cache=True)
def _owners(points, fresh, motion, there):  # type: ignore[no-untyped-def]
    """Point of the other scan that each of `points` (m, 2) is that agrees with it, moved there by `motion`, else -1."""
    owners = np.full(len(points), -1)
    moved_there = shifted(points, motion)
    for i in range(len(points)):
        if fresh[i] == AGREES:
            owners[i], _ = nearest_point(moved_there[i, 0], moved_there[i, 1], OWNED, there)
    return owners


@dataclass(frozen=True, eq=False)
class _Tried:
    """A group of points (n,), where it seems to have gone, and what is new in b, (m,), that this explains."""

    members: NDArray[np.bool_]
    hypothesis: MotionHypothesis
    claims: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class _Search:
    """The search for motions of groups of a; its fields are arguments of `hypotheses`."""

    a: Beams
    b: Beams
    background: FloatArray
    labels: NDArray[np.int64]
    fresh: NDArray[np.int64]
    reach: float
    noise: float

    @cached_property
    def new(self) -> NDArray[np.bool_]:
        """(m,) what is new in b."""
        return np.asarray(self.fresh == THROUGH)

    @cached_property
    def weights(self) -> FloatArray:
        """(m,) what each point of b is worth to a motion.

        What agrees with the background may be a mover in the place of another, or in its own.
        """
        return np.where(self.new, 1.0, np.where(self.fresh == AGREES, 0.25, 0.5))

    @cached_property
    def near(self) -> FloatArray:
        """(n,) metres off the outline of b up to which a point of a that moved may be noise."""
        return np.maximum(2.0 * nearness(self.a, self.noise), 0.5 * self.a.spacing)

    @cached_property
    def owners(self) -> NDArray[np.int64]:
        """(m,) point of a that each point of b is where it agrees with the background, else -1."""
        return np.asarray(
            _owners(self.b.points, self.fresh, inverse(self.background), seen(self.a)), dtype=np.int64
        )

    def found(self, explained_here: NDArray[np.bool_], taken: NDArray[np.bool_]) -> list[MotionHypothesis]:
        """Groups of a and where they went in b, the best explained first: what is near another's goal may not take it.

        explained_here : (n,) points of a that are explained already; those found are added. taken : (m,) likewise of b.
        """
        groups = left_their_place(self.a, self.labels)
        groups[explained_here] = -1
        waiting = [groups == number for number in np.unique(groups[groups >= 0])]
        tried = [one for members in waiting if (one := self._tried(members, taken)) is not None]
        found: list[MotionHypothesis] = []
        while tried:
            best = tried.pop(int(np.argmax([one.hypothesis.gain for one in tried])))
            if (best.claims & taken).any():
                again = self._tried(best.members, taken)
                tried += [] if again is None else [again]
                continue
            taken |= best.claims
            found.append(best.hypothesis)
            if best.hypothesis.matched:
                explained_here |= best.hypothesis.members
        return found

    def _tried(self, members: NDArray[np.bool_], taken: NDArray[np.bool_]) -> _Tried | None:
        """The best motion of a group (n,) to what is not `taken` (m,); None where it stands."""
        group = np.flatnonzero(members)
        count = len(group)
        if count < 3:
            return None
        a, b, points, kinds = self.a, self.b, self.a.points[group], self.labels[group]
        agrees = kinds == AGREES
        sure, stood = int(np.sum(kinds == THROUGH)), int(np.sum(agrees))
        free = sure + int(np.sum(kinds == CLEAR))
        extent = float(np.hypot(*np.ptp(points, axis=0)))
        sigma = ROUND_SIGMA if extent < ROUND else TURN_SIGMA
        middle = points.sum(axis=0) / count
        centre = moved(middle, self.background)
        around = ~taken & (((b.points - centre) ** 2).sum(axis=1) < (self.reach + extent) ** 2)
        changed, motion, best = count - stood, self.background.copy(), -np.inf
        least = max(3.0, 0.4 * count, stood - free + max(3.0, min(0.25 * count, 0.6 * changed)))
        if around.sum() >= 3:
            best = best_motion(
                Group(points, self.near[group], a.spacing[group], agrees),
                Goals(b.points[around], self.weights[around], b.points[around & self.new]),
                Views(b.xy, b.ranges, b.clear, self._worth(members), b.angle_min, b.step),
                self.background, self.reach, sigma, least, motion,
            )  # fmt: skip
        claims = np.zeros(len(b), dtype=bool)
        if best >= least and (free >= 2 or best > 0.7 * count):
            if np.hypot(*(moved(middle, motion) - centre)) < 0.04:
                return None
            there = members & (sighted(a, b, motion, self.near, members)[0] == AGREES)
            hypothesis = MotionHypothesis(there, motion, best - (stood - free), True)
            self._claim(hypothesis, ~taken & self.new, claims)
        elif sure >= 3 and sure >= 0.5 * count:
            hypothesis = MotionHypothesis(members, self.background.copy(), float(free), False)
        else:
            return None
        return _Tried(members, hypothesis, claims)

    def _worth(self, members: NDArray[np.bool_]) -> FloatArray:
        """(B,) what it says for a motion of the members (n,) that it takes one to where each beam of b ended.

        Little where that is something else that stands.
        """
        worth = np.ones(len(self.b.ranges))
        busy = (self.owners >= 0) & ~members[np.maximum(self.owners, 0)]
        worth[self.b.beams] = np.where(busy, BUSY, 1.0)
        return worth

    def _claim(self, hypothesis: MotionHypothesis, new: NDArray[np.bool_], claims: NDArray[np.bool_]) -> None:
        """Mark in `claims` what is `new` in b, (m,), and explained: nothing else can have become it."""
        free = np.flatnonzero(new)
        free = free[np.argsort(self.b.points[free, 0])]
        claimed = np.zeros(len(free), dtype=bool)
        members, targets = hypothesis.members, np.ascontiguousarray(self.b.points[free])
        claim(self.a.points[members], self.near[members], hypothesis.motion, targets, claimed)
        claims[free[claimed]] = True


def _came_from(
    a: Beams, b: Beams, group: MotionHypothesis, labels: NDArray[np.int64], near: FloatArray
) -> MotionHypothesis | None:
    """A group of b that was found in a, as one of a; None where too little of a belongs to it.

    Of a piece that is not of it as a whole only what left its place is: the rest is what the mover hides now.
    """
    motion = inverse(group.motion)
    on = sighted(a, b, motion, near)[0] == AGREES
    members = on.copy()
    away, _ = cKDTree(b.points[group.members]).query(moved(a.points[on], motion))
    members[on] = away < (near + a.spacing)[on]
    whole = np.bincount(a.pieces, members) > WHOLE * np.bincount(a.pieces)
    members &= whole[a.pieces] | (labels == THROUGH) | (labels == CLEAR)
    return replace(group, members=members, motion=motion) if members.sum() >= 3 else None
