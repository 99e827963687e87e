"""Closures that wait: what cannot be decided alone is decided by what comes after (pairwise consistency).

While the robot does not know well where it is, one fitting placement proves little: corridors repeat. Several, from
different keyframes along metres of path, that all say the same about how the new path lies on the old one, and no
comparable group that says otherwise, are believed together. The less is known, the longer the path has to be.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from numba import njit

from estimation.checks import FloatArray
from loop_closure.graph.edges import Edge
from loop_closure.graph.uncertainty import DEVIATIONS
from loop_closure.motions import compose, invert, length, motion, positions, turn, turns
from registration.placement.align_submaps import APART

LEAST = 4  # keyframes that have to agree
PATH = (5.0, 15.0)  # metres of path along which they have to, at least and at most
TOGETHER = 3  # of them, along the least of those paths: a pair agrees with what lies far off too easily
FAR = (8, 20.0)  # keyframes and metres where nothing but looks led there
PER_SIGMA = 2.0  # metres of path per metre of standard deviation
RIVALRY = 0.6  # share of the best group's merit at which another group is a rival
NEARER_RIVALRY = 0.25  # the same for a rival that needs less than half of the best group's correction
MEMORY = 60.0  # metres of path after which an undecided closure is dropped
MOST = 250  # that wait
LEAST_FITNESS = 0.93  # mean of a group: different places agree by halves, one place nearly wholly

MOST_SPREAD = 0.6  # metres, standard deviation between keyframes up to which they can agree on anything

Spread = Callable[[int, npt.NDArray[np.int64]], tuple[npt.ArrayLike, npt.ArrayLike]]


@dataclass(frozen=True, eq=False)
class Guess:
    """A candidate for a closure that registration found to fit.

    merit : how much speaks for it, metres of outline. fitness : agreeing share of what both saw. likelihood : of the
    classifier. sigma : metres, standard deviation of the place beforehand. expected : whether the estimate allows it;
    otherwise it can only be a rival. missed : metres between the estimate and the placement. certain : whether the
    estimate was so good beforehand that nothing else could have been meant. alone : no other placement does nearly as
    well.
    """

    edge: Edge
    merit: float
    fitness: float
    likelihood: float
    sigma: float = 0.0
    expected: bool = True
    missed: float = 0.0
    certain: bool = False
    alone: bool = True


class ClosureHypotheses:
    """Undecided closures, and which of them agree with which."""

    def __init__(self) -> None:
        self.waiting: list[Guess] = []
        self._agree: npt.NDArray[np.bool_] = np.zeros((0, 0), dtype=bool)

    def clear(self) -> None:
        """Nothing waits any more."""
        self._keep(np.zeros(len(self.waiting), dtype=bool))

    def forget(self, paths: FloatArray, here: int) -> set[int]:
        """Drop what has waited for too long; returns the keyframes that nothing waits for any more."""
        before = self.keys
        keep = np.array([paths[here] - paths[guess.edge.b] <= MEMORY for guess in self.waiting], dtype=bool)
        self._keep(keep)
        if len(self.waiting) > MOST:
            # Where scans are kept on the spot many say the same; the path they cover must not shrink.
            self._keep(~self._said_better())
        self._keep(np.arange(len(self.waiting)) >= len(self.waiting) - MOST)
        return before - self.keys

    @property
    def keys(self) -> set[int]:
        """Keyframes that wait for a decision."""
        return {guess.edge.b for guess in self.waiting}

    @property
    def needed(self) -> set[int]:
        """Keyframes that something waits for."""
        return {node for guess in self.waiting for node in (guess.edge.a, guess.edge.b)}

    def renumber(self, number: npt.NDArray[np.int64]) -> None:
        """Keyframes have new numbers (N,); none of the `needed` went."""
        self.waiting = [
            replace(guess, edge=replace(guess.edge, a=int(number[guess.edge.a]), b=int(number[guess.edge.b])))
            for guess in self.waiting
        ]

    def _keep(self, keep: npt.NDArray[np.bool_]) -> None:
        if not keep.all():
            self.waiting = [guess for guess, stays in zip(self.waiting, keep, strict=True) if stays]
            self._agree = self._agree[np.ix_(keep, keep)]

    def add(self, guess: Guess, poses: FloatArray, spread: Spread) -> None:
        """One more that waits.

        spread : standard deviations of position (m) and heading (rad) between a node and others near along the path.
        """
        row = consistent(guess.edge, [other.edge for other in self.waiting], poses, spread)
        count = len(row)
        grown = np.ones((count + 1, count + 1), dtype=bool)
        grown[:count, :count] = self._agree
        grown[count, :count] = grown[:count, count] = row
        self._agree = grown
        self.waiting.append(guess)

    def decide(
        self,
        paths: FloatArray,
        farthest: float = np.inf,
        parts: npt.NDArray[np.int64] | None = None,
        poses: FloatArray | None = None,
    ) -> list[Guess]:
        """The group that has won, or nothing; after a decision nothing waits.

        farthest : metres of standard deviation beyond which the place says nothing. parts : (N,) numbers of the parts
        of the path that guessed steps leave: what lies across such a step agrees too easily to hold up a part.
        poses : (N, 3) or (N, 4, 4), the estimate; by it groups on earlier passes that are not tied together well
        enough to agree, yet put the path at one place, are no rivals.
        """
        if len(self.waiting) < LEAST:
            return []
        groups = self._groups()
        best = max(groups, key=self._merit)
        members = [self.waiting[k] for k in best]
        keys = {guess.edge.b for guess in members}
        span = float(np.ptp([paths[key] for key in keys]))
        sigma = float(np.median([guess.sigma for guess in members]))
        if not all(guess.expected for guess in members):
            return []
        least, path = FAR if sigma > farthest else (LEAST, float(np.clip(PER_SIGMA * sigma, *PATH)))
        if len(keys) < least or span < path:
            return []
        if float(np.mean([guess.fitness for guess in members])) < LEAST_FITNESS:
            return []
        rivals = [group for group in groups if not group & best and self._rival(group, best)]
        if any(poses is None or self._elsewhere(group, best, poses) for group in rivals):
            return []
        members = _supported(members, paths, np.zeros(len(paths), dtype=np.int64) if parts is None else parts)
        if not members:
            return []
        self.clear()
        return sorted(members, key=lambda guess: (guess.edge.b, guess.edge.a))

    def _rival(self, group: set[int], best: set[int]) -> bool:
        """Whether a group speaks against the best one; the less it contradicts odometry, the less it takes."""
        if len({self.waiting[k].edge.b for k in group}) < 2:
            share = RIVALRY
        else:
            missed = [float(np.median([self.waiting[k].missed for k in some])) for some in (group, best)]
            share = NEARER_RIVALRY if missed[0] < 0.5 * missed[1] - 0.3 else RIVALRY
        return self._merit(group) > share * self._merit(best)

    def _elsewhere(self, group: set[int], best: set[int], poses: FloatArray) -> bool:
        """Whether a group puts the path at another place than the best one does."""
        here = max(self.waiting[k].edge.b for k in best)
        away = motion(
            *(self._placed([self.waiting[k].edge for k in some], here, poses) for some in (group, best))
        )
        return length(away) > APART[0] or turn(away) > APART[1]

    def _placed(self, edges: list[Edge], here: int, poses: FloatArray) -> FloatArray:
        """Pose of keyframe `here` by closures around it: the one nearest to their median."""
        a, b = (np.array([getattr(edge, end) for edge in edges]) for end in ("a", "b"))
        motions = np.array([edge.motion for edge in edges])
        placed = compose(compose(poses[a], motions), motion(poses[b], poses[here]))
        where = positions(placed)
        return np.asarray(placed[np.argmin(np.linalg.norm(where - np.median(where, axis=0), axis=1))])

    def _merit(self, group: set[int]) -> float:
        """Outline that speaks for a group; of several closures of one keyframe the best counts."""
        best: dict[int, float] = {}
        for k in group:
            guess = self.waiting[k]
            best[guess.edge.b] = max(best.get(guess.edge.b, 0.0), guess.merit)
        return sum(best.values())

    def _groups(self) -> list[set[int]]:
        """For each closure a group around it that agrees pairwise, the weightiest taken in first; each group once."""
        order = np.argsort([-guess.merit for guess in self.waiting], kind="stable")
        groups = {tuple(np.flatnonzero(row).tolist()): None for row in _cliques(self._agree, order)}
        return [set(group) for group in groups]

    def _said_better(self) -> npt.NDArray[np.bool_]:
        """Which closures say what a weightier one of the same keyframe says too, (N,)."""
        keys = np.array([guess.edge.b for guess in self.waiting])
        merits = np.array([guess.merit for guess in self.waiting])
        rank = np.empty(len(merits), dtype=np.int64)
        rank[np.argsort(-merits, kind="stable")] = np.arange(len(merits))
        return np.asarray((self._agree & (keys[:, None] == keys) & (rank < rank[:, None])).any(axis=1))


def _supported(members: list[Guess], paths: FloatArray, parts: npt.NDArray[np.int64]) -> list[Guess]:
    """Those of a group in parts of the path that hold up alone: enough keyframes, none far from the others."""
    keys = np.array(sorted({guess.edge.b for guess in members}))
    held: set[int] = set()
    for part in np.unique(parts[keys]):
        some = keys[parts[keys] == part]
        near = np.abs(paths[some][:, None] - paths[some]) <= PATH[0]
        some = some[near.sum(axis=1) >= TOGETHER]
        if len(some) >= LEAST and np.ptp(paths[some]) >= PATH[0]:
            held |= set(some.tolist())
    return [guess for guess in members if guess.edge.b in held]


@njit(cache=True)
def _cliques(agree, order):  # type: ignore[no-untyped-def]
    """Row k: members (N,) of the group around k, filled up greedily in `order`."""
    count = len(order)
    members = np.zeros((count, count), dtype=np.bool_)
    for seed in range(count):
        allowed = agree[seed].copy()
        members[seed, seed] = True
        allowed[seed] = False
        for k in order:
            if allowed[k]:
                members[seed, k] = True
                allowed &= agree[k]
                allowed[k] = False
    return members


def consistent(
    first: Edge, others: Sequence[Edge], poses: FloatArray, spread: Spread
) -> npt.NDArray[np.bool_]:
    """Whether going round by `first` and each of M others ends where it began, (M,), as far as the paths are known."""
    if not others:
        return np.zeros(0, dtype=bool)
    a, b = (np.array([getattr(edge, end) for edge in others]) for end in ("a", "b"))
    motions = np.array([edge.motion for edge in others])
    along = motion(poses[first.b], poses[b])
    back = compose(compose(first.motion, along), invert(motions))
    off = motion(motion(poses[first.a], poses[a]), back)
    away_b, turn_b = spread(first.b, b)
    away_a, turn_a = spread(first.a, a)
    loose = 0.2 + DEVIATIONS * np.hypot(away_a, away_b) + 0.02 * np.linalg.norm(positions(along), axis=-1)
    near = np.linalg.norm(positions(off), axis=-1) < loose
    alike = turns(off) < 0.06 + DEVIATIONS * np.hypot(turn_a, turn_b)
    return np.asarray(near & alike & (np.maximum(away_a, away_b) <= MOST_SPREAD))
