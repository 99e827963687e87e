"""What may have moved, and how: the start of the joint inference (InitialiseRT, line 1 of Algorithm 1).

Points that the background's motion does not explain are gathered in groups; each group votes for the displacement
that lays it on what is new in the second scan (a Hough transform over pairs of points), and the best few are refined.
A motion is kept where it explains clearly more of both scans than standing still does.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from registration.crf.beams import AGREES, CLEAR, FREE, Beams, nearness, sightings
from registration.crf.displacement import best_motion, explained
from registration.crf.grouping import groups_of
from registration.motion import Array

LINK = 0.45  # metres between parts of one thing: two legs
SMALL = 0.3  # metres, extent of a leg
LARGEST = 7.0  # metres, extent of what moves
TURN_SIGMA = 0.12  # radians a thing may be expected to turn between the scans
ROUND = 0.6  # metres; what is smaller shows no rotation
ROUND_SIGMA = 0.02  # radians it is then taken to turn
MOST = 8  # objects


@dataclass(frozen=True, eq=False)
class Hypothesis:
    """A group of points of scan a and how it may have moved.

    members : (n,) which points of a belong. motion : (3,) takes points of a to b. gain : points that it explains
    better than standing still. matched : False where b has nothing that fits: its motion is then the background's.
    """

    members: NDArray[np.bool_]
    motion: Array
    gain: float
    matched: bool


def hypotheses(
    a: Beams,
    b: Beams,
    background: Array,
    seen: tuple[NDArray[np.int64], Array],
    fresh: NDArray[np.int64],
    reach: float,
    noise: float,
) -> list[Hypothesis]:
    """Groups of a that may have moved, the best explained first.

    background : (3,) motion of what stands. seen : how b sees the points of a under it (`seen_by`).
    fresh : (m,) how a sees the points of b under its inverse. reach : metres a thing may have gone.
    """
    labels, _ = seen
    groups = groups_of(a.points, a.pieces, labels, a.spacing, a.ranges[a.beams], LINK, SMALL, LARGEST)
    new = fresh == FREE
    # What agrees with the background may be a mover in the place of another, or in its own.
    weights = np.where(new, 1.0, np.where(fresh == AGREES, 0.25, 0.5))
    near = np.maximum(2.0 * nearness(a, noise), 0.5 * a.spacing)
    found: list[Hypothesis] = []
    taken = np.zeros(len(b), dtype=bool)
    numbers, counts = np.unique(groups[groups >= 0], return_counts=True)
    free = np.array(
        [
            np.sum((labels[groups == number] == FREE) | (labels[groups == number] == CLEAR))
            for number in numbers
        ],
        dtype=np.int64,
    )
    for number in numbers[np.lexsort((-counts, -free))] if len(numbers) else []:
        members = groups == number
        for _ in range(2):
            hypothesis = None
            # With and without what agrees with the background: it may be a wall beside the mover, or its flank.
            for part in _parts(members, labels):
                other = _of_group(a, b, background, labels, part, new, weights, taken, near, reach)
                if other is not None and (hypothesis is None or other.gain > hypothesis.gain + 1.0):
                    hypothesis = other
            if hypothesis is None:
                break
            hypothesis = _with_flanks(a, b, hypothesis, near, labels)
            _take(a, b, hypothesis, near, new, taken)
            found.append(hypothesis)
            rest = members & ~hypothesis.members
            if not hypothesis.matched or rest.sum() < 4:
                break
            members = rest
    found = _merged(a, found)
    found.sort(key=lambda hypothesis: -hypothesis.gain)
    return found[:MOST]


def _merged(a: Beams, found: list[Hypothesis]) -> list[Hypothesis]:
    """Neighbouring parts that move alike, legs of one person, and lost parts of what was found, become one."""
    rest = sorted(found, key=lambda hypothesis: -int(hypothesis.members.sum()) * hypothesis.matched)
    merged: list[Hypothesis] = []
    for part in rest:
        for k, whole in enumerate(merged):
            if _belongs(a.points[part.members], part, a.points[whole.members], whole):
                members = whole.members | part.members
                merged[k] = replace(whole, members=members, gain=whole.gain + part.gain)
                break
        else:
            merged.append(part)
    return merged


def _belongs(points: Array, part: Hypothesis, others: Array, whole: Hypothesis) -> bool:
    if not len(points) or not len(others):
        return False
    apart = float(np.min(np.hypot(*(points[:, None] - others[None]).transpose(2, 0, 1))))
    if apart > 0.8:
        return False
    if not part.matched:
        return apart < LINK
    both = np.concatenate((points, others))
    extent = float(np.hypot(*np.ptp(both, axis=0)))
    shift = np.hypot(*(_moved(both, part.motion) - _moved(both, whole.motion)).T).max()
    legs = extent < 1.0 and max(np.hypot(*np.ptp(x, axis=0)) for x in (points, others)) < SMALL
    return bool(legs or (shift < 0.2 and extent < LARGEST))


def _parts(members: NDArray[np.bool_], labels: NDArray[np.int64]) -> list[NDArray[np.bool_]]:
    changed = members & (labels != AGREES)
    if changed.sum() < 3:
        return [members]
    return [changed] if changed.sum() == members.sum() else [changed, members]


def _with_flanks(
    a: Beams, b: Beams, hypothesis: Hypothesis, near: Array, labels: NDArray[np.int64]
) -> Hypothesis:
    """With the rest of the pieces that its motion explains as a whole: flanks that slide along themselves."""
    if not hypothesis.matched:
        return hypothesis
    rooted = np.zeros(int(a.pieces.max()) + 1, dtype=bool)
    rooted[a.pieces[hypothesis.members]] = True
    on = _on_outline(a.points, near, rooted[a.pieces], hypothesis.motion, b)
    count = np.bincount(a.pieces)
    out = _out_of_view(a.points, hypothesis.motion, b) & rooted[a.pieces]
    fits = on | (out & (labels == AGREES))
    share = np.bincount(a.pieces, fits) / count
    enough = np.bincount(a.pieces, hypothesis.members) >= np.maximum(2.0, 0.06 * count)
    standing = np.bincount(a.pieces, labels == AGREES) / count
    whole = enough & (share > 0.8) & ((share >= standing) | (share > 0.9))
    return replace(hypothesis, members=hypothesis.members | ((fits | out) & whole[a.pieces]))


def _take(
    a: Beams, b: Beams, hypothesis: Hypothesis, near: Array, new: NDArray[np.bool_], taken: NDArray[np.bool_]
) -> None:
    """Mark what is new in b and explained by a hypothesis: nothing else can have become it."""
    if not hypothesis.matched:
        return
    free = np.flatnonzero(new & ~taken)
    claimed = np.zeros(len(free), dtype=bool)
    members = hypothesis.members
    explained(
        a.points[members], near[members], np.zeros(int(members.sum()), dtype=bool), hypothesis.motion,
        np.ascontiguousarray(b.points[free]), claimed,
        b.xy, b.ranges, b.clear, b.angle_min, b.step,
    )  # fmt: skip
    taken[free[claimed]] = True


def _of_group(
    a: Beams, b: Beams, background: Array, labels: NDArray[np.int64], members: NDArray[np.bool_],
    new: NDArray[np.bool_], weights: Array, taken: NDArray[np.bool_], near: Array, reach: float,
) -> Hypothesis | None:  # fmt: skip
    """The best motion of one group, None where it stands."""
    count = int(members.sum())
    sure = int(np.sum(labels[members] == FREE))
    free = sure + int(np.sum(labels[members] == CLEAR))
    if count < 3:
        return None
    points = np.ascontiguousarray(a.points[members])
    extent = float(np.hypot(*np.ptp(points, axis=0)))
    sigma = ROUND_SIGMA if extent < ROUND else TURN_SIGMA
    centre = _moved(points.mean(axis=0, keepdims=True), background)[0]
    around = np.hypot(*(b.points - centre).T) < reach + extent
    usable = around & ~taken
    fresh = np.ascontiguousarray(b.points[usable & new])
    targets = np.ascontiguousarray(b.points[usable])
    stay = int(np.sum(labels[members] == AGREES)) - free
    motion = background.copy()
    best = -np.inf
    if len(targets) >= 3:
        best = best_motion(
            points, near[members], labels[members] == AGREES, a.spacing[members], background, targets,
            weights[usable], fresh, reach, sigma, b.xy, b.ranges, b.clear, b.angle_min, b.step, motion,
        )  # fmt: skip
    gain = best - stay
    shift = float(np.hypot(*(_moved(points, motion) - _moved(points, background)).mean(axis=0)))
    changed = int(np.sum(labels[members] != AGREES))
    enough = best >= max(3.0, 0.4 * count) and gain >= max(3.0, min(0.25 * count, 0.6 * changed))
    if enough and (free >= 2 or best > 0.7 * count):
        if shift < 0.04:
            return None
        on = _on_outline(a.points, near, members, motion, b) & members
        return Hypothesis(on, motion, gain, True)
    if sure >= 3 and sure >= 0.5 * count:
        return Hypothesis(members, background.copy(), float(free), False)
    return None


def _on_outline(
    points: Array, near: Array, wanted: NDArray[np.bool_], motion: Array, b: Beams
) -> NDArray[np.bool_]:
    labels, _ = sightings(points, near, wanted, motion, b.xy, b.ranges, b.clear, b.angle_min, b.step)
    return np.asarray(labels == AGREES)


def _out_of_view(points: Array, motion: Array, b: Beams) -> NDArray[np.bool_]:
    """(n,) which points have left the opening of scan b under `motion`."""
    moved = _moved(points, motion)
    beam = (np.arctan2(moved[:, 1], moved[:, 0]) - b.angle_min) / b.step
    around = 2.0 * np.pi / abs(b.step)
    beam = np.floor(beam - np.floor((beam + 0.5) / around) * around + 0.5)
    return np.asarray(beam >= len(b.ranges))


def _moved(points: Array, motion: Array) -> Array:
    c, s = np.cos(motion[2]), np.sin(motion[2])
    return np.asarray(points @ np.array([[c, s], [-s, c]]) + motion[:2])
