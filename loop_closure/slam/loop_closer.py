"""Closing loops: what is looked at for a keyframe and when again, what waits, and what the graph is told.

A keyframe is looked at when it is made, and again once its place is known better: with the path on both sides of it,
and where it was left undecided, in hindsight.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError
from loop_closure.graph.edges import Edge
from loop_closure.graph.pose_graph import PoseGraph, SmoothedGraph, residuals
from loop_closure.graph.uncertainty import SLACK, WHOLE, Uncertainty, apart
from loop_closure.keyframes import Keyframes
from loop_closure.motions import planar
from loop_closure.slam.closing import COMMON, Gate, Search, agree, looking, lost, off
from loop_closure.slam.closure_hypotheses import ClosureHypotheses, Guess
from loop_closure.slam.editing import Refused, same_revisit
from loop_closure.slam.likeness import PlaceLikeness
from loop_closure.slam_config import Proposals, SlamConfig
from loop_closure.work import Steps, at_once

PER_KEYFRAME = 2  # keyframes looked at again with each new one
WRONG = 0.3  # metres by which a closure misses the whole that cannot be true
# Costs of steps, ms: of LEARNT edges, the uncertainty of each node, a decision for each that waits.
LEARNT, LEARNING, AROUND, DECIDING = 500, 2.0, 0.001, 0.02


@dataclass(frozen=True, eq=False)
class Closure:
    """Two places of the trajectory found to be one.

    earlier, later : numbers of the keyframes; stamps in seconds. relative : pose of the later in the frame of the
    earlier, (3,) or (4, 4); covariance (3, 3) or (6, 6), in that frame. likelihood : of the classifier, 0 where the
    place alone led there. fitness : agreeing share of what both saw. reason : why it was accepted.
    """

    earlier: int
    later: int
    earlier_stamp: float
    later_stamp: float
    relative: FloatArray
    covariance: FloatArray
    likelihood: float
    fitness: float
    reason: str


class LoopCloser:
    """Finds where the path meets itself, decides on it, and tells the graph.

    graph, keyframes : of the map; they grow elsewhere. proposals : what says where a loop may close, see `Slam`.
    """

    def __init__(
        self, graph: PoseGraph, keyframes: Keyframes, config: SlamConfig, proposals: Proposals
    ) -> None:
        self.graph, self.keyframes = graph, keyframes
        self.closures: list[Closure] = []
        self.accepted: list[Closure] = []  # since the last scan
        self._farthest, self._proposals = config.farthest, proposals
        self._search = Search(config.loop_path, config.certain, config.farthest, proposals == "places")
        self._hypotheses = ClosureHypotheses()
        self._hindsight = ClosureHypotheses()  # of keyframes that were left undecided, seen from both sides
        self._uncertainty = Uncertainty()
        self._likeness = PlaceLikeness()
        self._refused = Refused()
        self._again: set[int] = set()  # keyframes worth another look, their place being better known now
        self._queue: list[int] = []  # of those, what is to be looked at next
        self._undecided: list[int] = []  # keyframes to look at in hindsight
        self._dirty = False

    @property
    def waiting(self) -> int:
        """How many closures are not decided yet."""
        return len(self._hypotheses.waiting)

    @property
    def needed(self) -> set[int]:
        """Keyframes that something waits for, or that are to be looked at again."""
        return self._hypotheses.needed | self._hindsight.needed | {*self._queue, *self._undecided}

    def gate(self, k: int) -> Gate:
        """Where keyframe `k` may be; `learning` comes before."""
        return Gate(*self._uncertainty.around(self.graph.poses, k))

    def closing(self, k: int) -> Steps[None]:
        """All that keyframe `k`, the newest or not, leads to. Numbers of keyframes stay as they are meanwhile."""
        paths = self.keyframes.paths
        if paths[k] - paths[0] < self._search.apart:
            return
        fits = yield from self._look(k)
        self._undecided += sorted(self._hypotheses.forget(paths, k))
        accepted = yield from self._take(fits, self._hypotheses)
        accepted += yield from self._decide(self._hypotheses)
        late = [self._undecided.pop(0) for _ in range(min(PER_KEYFRAME, len(self._undecided)))]
        accepted += yield from self._look_back(late, self._hindsight)
        if accepted:
            self._queue = sorted(self._again - {k})
        # A few at a time, so that no keyframe waits long; the latest first.
        turns = [self._queue.pop() for _ in range(min(PER_KEYFRAME, len(self._queue)))]
        accepted += yield from self._second_look(turns)
        if accepted or fits:
            self._dirty = True

    def finish(self) -> None:
        """Look again at what was passed before its place was known, and settle the estimate."""
        if not self._dirty:
            return
        self._dirty = False
        self._again |= {*self._undecided, *self._hypotheses.keys, *self._hindsight.keys}
        for _ in range(3):
            again, self._again = sorted(self._again), set()
            if not at_once(self._second_look(again)) and not at_once(
                self._look_back(again, ClosureHypotheses())
            ):
                break
        self.accepted.clear()
        self.graph.settle()
        self._drop_outliers()

    def remove(self, closure: Edge) -> int:
        """See `Slam.remove_closure`."""
        edges = self.graph.edges
        number = next((k for k, edge in enumerate(edges) if edge is closure and edge.closure), None)
        if number is None:
            raise InputError("closure: that is none of the graph's closures")
        paths = self.keyframes.paths
        wrong = same_revisit(edges, number, paths)
        for index in wrong:
            self._refused.add(edges[index], paths)
        self._forget_closures(wrong)
        return len(wrong)

    def take_out(self, number: npt.NDArray[np.int64]) -> None:
        """Keyframes have new numbers (N,), those that went -1; none of the `needed` went."""
        stay = number >= 0
        self.closures = [
            replace(c, earlier=int(number[c.earlier]), later=int(number[c.later]))
            for c in self.closures
            if stay[c.earlier] and stay[c.later]
        ]
        self._hypotheses.renumber(number)
        self._hindsight.renumber(number)
        self._undecided = [int(number[k]) for k in self._undecided if stay[k]]
        self._again = {int(number[k]) for k in self._again if stay[k]}
        self._queue = [int(number[k]) for k in self._queue if stay[k]]
        self._uncertainty.reset()
        self._likeness.take_out(number)

    def learning(self) -> Steps[None]:
        """Take in new edges, and be ready for a question about the uncertainty of all nodes."""
        while self._uncertainty.behind(self.graph.edges):
            yield LEARNING
            self._uncertainty.learn(self.graph.edges, LEARNT)
        yield AROUND * len(self.keyframes)

    def _look(self, k: int, both: bool = False, only_certain: bool = True) -> Steps[list[Guess]]:
        yield from self.learning()
        poses = self.graph.poses
        gate = self.gate(k)
        search = replace(self._search, only_certain=True) if both and only_certain else self._search
        likely: dict[int, float] = {}
        asks = not both and self._proposals == "both" and lost(k, self.keyframes, poses, gate, search)
        if planar(poses) and (asks or self._proposals == "places"):
            likely = yield from self._likeness.asking(k, self.keyframes, self._search.apart)
        fits = yield from looking(k, self.keyframes, poses, gate, search, likely, both)
        if not fits:
            self._again.add(k)
        return fits

    def _take(self, fits: list[Guess], waiting: ClosureHypotheses) -> Steps[list[Closure]]:
        """Accept what is certain, let the rest wait."""
        poses = self.graph.poses
        certain = [fit for fit in fits if fit.certain and fit.alone]
        if certain and agree(certain, poses):
            return (yield from self._accept(certain, "at the expected place"))
        for fit in fits:
            yield 2.0 * AROUND * len(self.keyframes)
            waiting.add(fit, self.graph.poses, self._spread)
        return []

    def _decide(self, waiting: ClosureHypotheses) -> Steps[list[Closure]]:
        waited = waiting.keys
        yield DECIDING * len(waiting.waiting)
        paths = self.keyframes.paths
        won = waiting.decide(paths, self._farthest, self.keyframes.parts(SLACK), self.graph.poses)
        if not won:
            return []
        recent = {guess.edge.b for guess in won}
        self._again |= waited - recent
        accepted = yield from self._accept(won, f"{len(won)} closures along the path agree")
        accepted += yield from self._second_look(
            [k for k in sorted(self._again) if paths[k] >= paths[min(recent)] - WHOLE]
        )
        # The group lies on one earlier pass; others through the same place are found now as well.
        self._again |= recent
        return accepted

    def _second_look(self, keys: list[int]) -> Steps[list[Closure]]:
        """Keyframes passed before their place was known well enough."""
        accepted: list[Closure] = []
        paths = self.keyframes.paths
        earlier: dict[int, list[int]] = {k: [] for k in keys}
        for closure in self.closures:
            if closure.later in earlier:
                earlier[closure.later].append(closure.earlier)
        for k in keys:
            self._again.discard(k)
            found = yield from self._look(k, True)
            # Not again what lies about where it was closed already, along the path.
            fits = [
                fit
                for fit in found
                if fit.certain
                and fit.alone
                and all(abs(paths[fit.edge.a] - paths[other]) >= COMMON for other in earlier[k])
            ]
            if fits and agree(fits, self.graph.poses):
                accepted += yield from self._accept(fits, "at the expected place, found on a second look")
        return accepted

    def _look_back(self, keys: list[int], waiting: ClosureHypotheses) -> Steps[list[Closure]]:
        """What stayed undecided, with the path on both sides of each keyframe; placements have to agree as before."""
        accepted: list[Closure] = []
        for k in keys:
            self._again.discard(k)
            self._again |= waiting.forget(self.keyframes.paths, k)
            fits = yield from self._look(k, True, False)
            accepted += yield from self._take(fits, waiting)
            accepted += yield from self._decide(waiting)
        return accepted

    def _accept(self, fits: Sequence[Guess], reason: str) -> Steps[list[Closure]]:
        fits = [fit for fit in fits if not self._refused.holds(fit.edge, self.keyframes.paths)]
        if not fits:
            return []
        closures = [fit.edge for fit in fits]
        if isinstance(self.graph, SmoothedGraph):
            yield from self.graph.closing(closures)
        else:
            self.graph.close(closures)
        made = [
            Closure(
                edge.a, edge.b, self.keyframes[edge.a].stamp, self.keyframes[edge.b].stamp,
                edge.motion.copy(), edge.covariance.copy(), fit.likelihood, fit.fitness, reason,
            )
            for edge, fit in zip(closures, fits, strict=True)
        ]  # fmt: skip
        self.closures += made
        self.accepted += made
        return made

    def _spread(self, i: int, j: npt.NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        return apart(self.keyframes, self._uncertainty, self.graph.poses, i, j)

    def _drop_outliers(self) -> None:
        """Take out closures that the whole contradicts."""
        squares = residuals(self.graph.edges, self.graph.poses)
        wrong = {
            number
            for number, edge in enumerate(self.graph.edges)
            if edge.closure and squares[number] > 60.0 and off(edge, self.graph.poses)[0] > WRONG
        }
        if wrong:
            self._forget_closures(wrong)

    def _forget_closures(self, wrong: set[int]) -> None:
        """Estimate anew without some closures, by the numbers of their edges."""
        gone = {(self.graph.edges[number].a, self.graph.edges[number].b) for number in wrong}
        self.graph.settle(wrong)
        self._uncertainty.reset()
        self.closures = [c for c in self.closures if (c.earlier, c.later) not in gone]
