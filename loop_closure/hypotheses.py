"""Closures that wait: what cannot be decided alone is decided by what comes after (pairwise consistency).

While the robot does not know well where it is, one fitting placement proves little: corridors repeat. Several, from
different keyframes along metres of path, that all say the same about how the new path lies on the old one, and no
comparable group that says otherwise, are believed together. The less is known, the longer the path has to be.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from loop_closure.graph import Edge
from loop_closure.motions import compose, invert, length, motion, turn

LEAST = 4  # keyframes that have to agree
PATH = (5.0, 15.0)  # metres of path along which they have to, at least and at most
FAR = (8, 20.0)  # keyframes and metres where nothing but looks led there
PER_SIGMA = 2.0  # metres of path per metre of standard deviation
RIVALRY = 0.6  # share of the best group's merit at which another group is a rival
NEARER_RIVALRY = 0.25  # the same for a rival that needs less than half of the best group's correction
MEMORY = 60.0  # metres of path after which an undecided closure is dropped
MOST = 250  # that wait
LEAST_FITNESS = 0.93  # mean of a group: different places agree by halves, one place nearly wholly

MOST_SPREAD = 0.6  # metres, standard deviation between keyframes up to which they can agree on anything

Spread = Callable[[int, int], tuple[float, float]]


@dataclass(frozen=True, eq=False)
class Guess:
    """A closure that is not decided: the edge, how much outline speaks for it (m), fitness and likelihood.

    sigma : metres, standard deviation of the place before. expected : whether the estimate allows it; otherwise it
    can only be a rival. missed : metres by which the estimate would move.
    """

    edge: Edge
    merit: float
    fitness: float
    likelihood: float
    sigma: float = 0.0
    expected: bool = True
    missed: float = 0.0


class Hypotheses:
    """Undecided closures, and which of them agree with which."""

    def __init__(self) -> None:
        self.waiting: list[Guess] = []
        self._agree: npt.NDArray[np.bool_] = np.zeros((0, 0), dtype=bool)

    def clear(self) -> None:
        """Nothing waits any more."""
        self._keep(np.zeros(len(self.waiting), dtype=bool))

    def forget(self, paths: FloatArray, here: int) -> None:
        """Drop what has waited for too long."""
        keep = np.array([paths[here] - paths[guess.edge.b] <= MEMORY for guess in self.waiting], dtype=bool)
        keep[: max(len(keep) - MOST, 0)] = False
        self._keep(keep)

    def _keep(self, keep: npt.NDArray[np.bool_]) -> None:
        if not keep.all():
            self.waiting = [guess for guess, stays in zip(self.waiting, keep, strict=True) if stays]
            self._agree = self._agree[np.ix_(keep, keep)]

    def add(self, guess: Guess, poses: FloatArray, spread: Spread) -> None:
        """One more that waits.

        spread : standard deviations of position (m) and heading (rad) between two nodes near along the path.
        """
        row = [consistent(guess.edge, other.edge, poses, spread) for other in self.waiting]
        count = len(row)
        grown = np.ones((count + 1, count + 1), dtype=bool)
        grown[:count, :count] = self._agree
        grown[count, :count] = grown[:count, count] = row
        self._agree = grown
        self.waiting.append(guess)

    def decide(self, paths: FloatArray, farthest: float = np.inf) -> list[Guess]:
        """The group that has won, or nothing; after a decision nothing waits.

        farthest : metres of standard deviation beyond which the place says nothing.
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
        if any(self._rival(group, best) for group in groups if not group & best):
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

    def _merit(self, group: set[int]) -> float:
        """Outline that speaks for a group; of several closures of one keyframe the best counts."""
        best: dict[int, float] = {}
        for k in group:
            guess = self.waiting[k]
            best[guess.edge.b] = max(best.get(guess.edge.b, 0.0), guess.merit)
        return sum(best.values())

    def _groups(self) -> list[set[int]]:
        """For each closure a group around it that agrees pairwise, the weightiest taken in first."""
        order = np.argsort([-guess.merit for guess in self.waiting], kind="stable")
        groups: list[set[int]] = []
        for seed in range(len(self.waiting)):
            allowed = self._agree[seed].copy()
            group = [seed]
            allowed[seed] = False
            for k in order:
                if allowed[k]:
                    group.append(int(k))
                    allowed &= self._agree[k]
                    allowed[k] = False
            groups.append(set(group))
        return groups


def consistent(first: Edge, second: Edge, poses: FloatArray, spread: Spread) -> bool:
    """Whether going round by both closures ends where it began, given how well the two paths are known."""
    along = motion(poses[first.b], poses[second.b])
    back = compose(compose(first.motion, along), invert(second.motion))
    off = motion(motion(poses[first.a], poses[second.a]), back)
    away_b, turn_b = spread(first.b, second.b)
    away_a, turn_a = spread(first.a, second.a)
    if max(away_a, away_b) > MOST_SPREAD:
        return False
    loose = 0.2 + 2.5 * np.hypot(away_a, away_b) + 0.02 * length(along)
    return bool(length(off) < loose and turn(off) < 0.06 + 2.5 * np.hypot(turn_a, turn_b))
