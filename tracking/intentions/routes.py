"""Learned walks as hypotheses over intended positions.

A hidden Markov model whose places are as wide as a corridor cannot tell two walks that cross one place. Here every
learned walk is a manifold of its own: a partial walk is weighed under each by how far it is off that route now and
before, where it began and which way it goes; ends that lie together add up. A walk also tells, less surely, that
somebody may go the same way back, and where no walk explains what is seen, straight on is the better guess.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from tracking.intentions.groups import Company
from tracking.intentions.observations import directions, filled, heading, spaced
from tracking.intentions.route_kernels import gather, match

IntArray = NDArray[np.int64]
SPACING = 0.25
SPAN = 4
LOOK_BACK = (1.0, 2.0, 4.0, 8.0)
AIM_SPAN = 1.0
# The scales of RouteScales are for this many walks; with fewer than FEWEST no wider than with these.
TYPICAL, FEWEST = 50, 20


@dataclass(frozen=True)
class RouteScales:
    """What a partial walk may differ from a learned one: standard deviations in m, and of turns in 1 - cos.

    back : log odds of going a walk the other way; straight : log-likelihood of going straight on to nowhere known.
    off, start : for TYPICAL walks; they narrow with the number n of walks as n^(-1/6), Scott's rule for the width of a
    kernel in two dimensions: the more walks there are, the closer is the one that goes the same way.
    company, company_span : people who set out within about `company_span` s of each other are often together: such a
    walk weighs 1 + `company` times as much.
    beside, beside_span : those within about `beside_span` m of each other at the same times nearly always are: by
    `beside` more.
    """

    off: float = 0.5
    turn: float = 0.6
    start: float = 2.8
    past: float = 0.9
    aim: float = 1.5
    back: float = -0.9
    straight: float = -6.5
    company: float = 10.0
    company_span: float = 10.0
    beside: float = 10.0
    beside_span: float = 0.5


@dataclass(frozen=True)
class RouteBelief:
    """Hypotheses for one person: `goals` (G, 2) with `probabilities` (G,) that sum to one, the best first.

    novelty : in [0, 1], share of the hypothesis that no learned walk explains this one.
    leads : per goal the walk that explains it best, as (walk, reversed, point reached); None for straight on.
    """

    goals: FloatArray
    probabilities: FloatArray
    novelty: float
    leads: list[tuple[int, bool, int] | None]


class Routes:
    """The latest `capacity` walks, thinned to even spacing."""

    _points: FloatArray  # (P, 2), walk w being rows _bounds[w] to _bounds[w + 1]
    _directions: FloatArray  # (P, 2)
    _bounds: IntArray  # (W + 1,)
    _began: FloatArray  # (W,) s

    def __init__(self, capacity: int = 1000, scales: RouteScales | None = None) -> None:
        self.capacity = capacity
        self.scales = scales or RouteScales()
        self._company = Company()
        self._set(np.zeros((0, 2)), np.zeros(1, dtype=np.int64), np.zeros(0))

    def __len__(self) -> int:
        return len(self._began)

    def walk(self, index: int) -> FloatArray:
        """Points (n, 2) of one remembered walk."""
        return self._points[self._bounds[index] : self._bounds[index + 1]]

    def learn(self, rows: FloatArray) -> None:
        """Remember one finished walk (N, 3) x, y, t."""
        walk = filled(spaced(np.ascontiguousarray(rows[:, :2]), SPACING), 4.0 * SPACING)
        self._company.learn(rows)
        gone = max(0, len(self) + 1 - self.capacity)
        first = int(self._bounds[gone])
        self._points = np.concatenate((self._points[first:], walk))
        self._directions = np.concatenate((self._directions[first:], directions(walk, SPAN)))
        self._bounds = np.append(self._bounds[gone:] - first, len(self._points))
        self._began = np.append(self._began[gone:], rows[0, 2])

    def move(self, moved: Callable[[FloatArray], FloatArray]) -> None:
        """Take all walks to another frame."""
        self._set(moved(self._points), self._bounds, self._began)
        self._company.move(moved)

    def as_arrays(self) -> dict[str, NDArray[Any]]:
        """What is remembered, for storage."""
        walks = {"points": self._points, "bounds": self._bounds, "starts": self._began}
        return walks | self._company.as_arrays()

    def from_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Take over what `as_arrays` gave. Raises ValueError where the arrays do not fit together."""
        points, bounds = np.asarray(arrays["points"], dtype=np.float64), arrays["bounds"].astype(np.int64)
        starts = np.asarray(arrays["starts"], dtype=np.float64)
        ends = (int(bounds[0]), int(bounds[-1]))
        if points.shape != (ends[1], 2) or ends[0] != 0 or len(starts) != len(bounds) - 1:
            raise ValueError("routes do not fit together")
        if (np.diff(bounds) < 1).any() or not np.isfinite(points).all():
            raise ValueError("a route is empty or not finite")
        self._company.from_arrays(arrays)
        self._set(points, bounds, starts)

    def _set(self, points: FloatArray, bounds: IntArray, began: FloatArray) -> None:
        """All walks one after the other, as the compiled loop takes them."""
        turned = [directions(points[low:high], SPAN) for low, high in itertools.pairwise(bounds)]
        self._points, self._bounds, self._began = points, bounds, began
        self._directions = np.concatenate(turned) if turned else np.zeros((0, 2))

    def believe(self, rows: FloatArray, reach: float, radius: float, most: int) -> RouteBelief:
        """Where the partial walk (N, 3) x, y, t leads.

        reach : m, how far straight on goes where nothing is known. radius : m, ends this close to a goal are its.
        most : goals at most.
        """
        s = self.scales
        path = spaced(np.ascontiguousarray(rows[:, :2]), SPACING)
        here = path[-1]
        ahead, length = heading(path, AIM_SPAN)
        firmness = min(1.0, length / 0.5)
        straight = self._straight_on(here, ahead, reach)
        if not len(self):
            return RouteBelief(straight[None], np.ones(1), 1.0, [None])
        along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(path, axis=0).T))))
        behind = [along[-1] - b for b in LOOK_BACK if along[-1] >= b]
        backs = path[np.searchsorted(along, behind)].reshape(-1, 2)
        narrowed = (max(len(self), FEWEST) / TYPICAL) ** (-1.0 / 6.0)
        scales = np.array([narrowed * s.off, s.turn, narrowed * s.start, s.past, s.aim])
        walks, partial = (self._points, self._directions, self._bounds), (here, path[0], backs, ahead)
        logs, reached = [], []
        for reverse, odds in ((False, self._together(rows)), (True, s.back)):
            log, at = match(*walks, reverse, *partial, firmness, scales)
            logs.append(log + odds)
            reached.append(at)
        last, first = self._points[self._bounds[1:] - 1], self._points[self._bounds[:-1]]
        ends = np.concatenate((last, first, straight[None]))
        log_w = np.concatenate((*logs, [s.straight]))
        weights = np.exp(log_w - log_w.max())
        weights /= weights.sum()
        # What weighs next to nothing only costs time.
        few = np.argsort(-weights, kind="stable")[:150]
        goals, shares = gather(ends[few], weights[few] / weights[few].sum(), radius, most)
        order = np.argsort(-shares, kind="stable")
        goals, shares = goals[order], shares[order] / shares.sum()
        leads = [self._lead(goal, few, ends, weights, reached, radius) for goal in goals]
        return RouteBelief(goals, shares, float(weights[-1]), leads)

    def _together(self, rows: FloatArray) -> FloatArray:
        """Log odds (W,) that a partial walk ends where each learned one did because the two people were together."""
        s = self.scales
        together = 1.0 + s.company * np.exp(-np.abs(self._began - rows[0, 2]) / s.company_span)
        typical = together.mean()
        # Where most set out at the same time, as when times count from each start, times say nothing.
        if typical < 1.0 + 0.5 * s.company:
            apart = self._company.apart(rows, len(self))
            together += s.beside * np.exp(-0.5 * (apart / s.beside_span) ** 2)
        return np.asarray(np.log(together / typical))

    def _lead(
        self,
        goal: FloatArray,
        few: IntArray,
        ends: FloatArray,
        weights: FloatArray,
        reached: list[IntArray],
        radius: float,
    ) -> tuple[int, bool, int] | None:
        """The heaviest walk that ends at a goal."""
        near = few[np.square(ends[few] - goal).sum(axis=1) <= (1.5 * radius) ** 2]
        if not len(near):
            return None
        best = int(near[weights[near].argmax()])
        if best == 2 * len(self):
            return None
        walk, reverse = best % len(self), best >= len(self)
        return walk, reverse, int(reached[int(reverse)][walk] - self._bounds[walk])

    def _straight_on(self, here: FloatArray, ahead: FloatArray, reach: float) -> FloatArray:
        """Where straight on leaves the area of all learned walks, or `reach` m on."""
        if len(self):
            low, high = self._points.min(axis=0), self._points.max(axis=0)
            if (here >= low).all() and (here <= high).all():
                borders = np.where(ahead > 0.0, high, low)
                leave = [(borders[a] - here[a]) / ahead[a] for a in range(2) if abs(ahead[a]) > 1e-9]
                reach = max(0.0, min(leave, default=0.0))
        return np.asarray(here + ahead * reach)

    def rest(self, lead: tuple[int, bool, int]) -> FloatArray:
        """What is left of a walk from where it was reached, (n, 2)."""
        walk, reverse, at = lead
        points = self.walk(walk)
        return points[at::-1] if reverse else points[at:]
