"""SLAM on a trajectory of keyframes: recognise, verify, close, smooth (chapters 2 and 4, Paper A section 4.3).

Slam().process(scan, odometry) -> SlamUpdate(pose, closures)
Slam().trajectory() -> (N, 4) stamp, x, y, yaw
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError
from loop_closure.graph.marginal import renumbered, without
from loop_closure.graph.pose_graph import Edge, PoseGraph, SmoothedGraph, residuals
from loop_closure.graph.smoother_process import SmootherProcess
from loop_closure.graph.steps import StepDoubt
from loop_closure.graph.uncertainty import SLACK, Uncertainty, apart
from loop_closure.keyframes import Keyframes
from loop_closure.motions import (
    as_pose,
    compose,
    identity,
    invert,
    motion,
    orthonormal,
    planar,
)
from loop_closure.slam.closing import Gate, Search, agree, looking, lost, off
from loop_closure.slam.closure_hypotheses import ClosureHypotheses, Guess
from loop_closure.slam.cloud_closing import LEAF, as_cloud, polished_step, thinned
from loop_closure.slam.editing import Refused, same_revisit
from loop_closure.slam.likeness import PlaceLikeness
from loop_closure.slam.thinning import Thinning
from loop_closure.slam.visits import Visits
from loop_closure.slam_config import Proposals, SlamConfig
from loop_closure.work import Allowance, Job, Steps, at_once
from registration.laser.scan import Scan
from registration.laser.sweep import at_first_beam

PER_KEYFRAME = 2  # keyframes looked at again with each new one
NEW_RUN = 1000.0  # metres of path that stand for a restart
WRONG = 0.3  # metres by which a closure misses the whole that cannot be true
# Costs of steps, ms: of LEARNT edges, the uncertainty of each node, a decision for each that waits, thinning.
LEARNT, LEARNING, AROUND, DECIDING, EXAMINING = 500, 2.0, 0.001, 0.02, 2.0


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


@dataclass(frozen=True, eq=False)
class SlamUpdate:
    """What one scan led to.

    pose : (3,) or (4, 4) of the sensor in the map. closures : accepted with this scan, of this keyframe or of those
    before. keyframe : number of the keyframe the scan became, None if it was not kept. waiting : closures that are not
    decided yet. behind : keyframes that are still to be worked on.
    """

    pose: FloatArray
    closures: list[Closure]
    keyframe: int | None = None
    waiting: int = 0
    behind: int = 0


class Slam:
    """Consistent map of a moving range sensor from its scans or clouds and its odometry."""

    def __init__(
        self,
        config: SlamConfig | None = None,
        graph: PoseGraph | None = None,
        proposals: Proposals = "both",
        thin: bool = False,
        every_scan: bool | None = None,
        pace: float | None = None,
        aside: SmootherProcess | None = None,
    ) -> None:
        """`proposals` : what says where a loop may close. "path": the estimate, within its uncertainty. "places": the
        classifier alone, asked about every keyframe against all before it (Paper A, section 4.3). "both": the estimate,
        and the classifier where that is too wide to say where to look. Clouds are not classified: only "path" proposes.

        thin : for runs without an end; takes out keyframes of places that others show as well. Memory then grows
        with the place and not with the time. every_scan : remember where each scan was taken; not by default if `thin`.

        pace : what `process` may do with one scan, ms of one core of a desktop computer, about: loops are searched and
        closed in steps, keyframe by keyframe, and what is left over is done with the scans that follow, by `work`
        while none comes, and in `finish`. How much follows from the scans, not from a clock: the same scans give
        the same map. None: everything at once. aside : a process that smooths, where `graph` is not given.
        """
        self.config = config or SlamConfig()
        if thin and not isinstance(graph, SmoothedGraph | None):
            raise InputError("thin: nodes can be taken out of a SmoothedGraph only")
        if proposals not in get_args(Proposals):
            raise InputError(f"proposals: {' | '.join(get_args(Proposals))} expected, got {proposals!r}")
        if pace is not None and not pace > 0.0:
            raise InputError(f"pace: ms above 0 expected, got {pace}")
        self.proposals, self._thins, self.pace = proposals, thin, pace
        self._every_scan = not thin if every_scan is None else every_scan
        self._new_graph, self._aside = graph, aside
        self.reset()

    def reset(self) -> None:
        """Forget everything: the next scan starts a new map."""
        self.graph: PoseGraph = self._new_graph or SmoothedGraph(self._aside)
        self.keyframes = Keyframes()
        self.closures: list[Closure] = []
        self._hypotheses = ClosureHypotheses()
        self._hindsight = ClosureHypotheses()  # of keyframes that were left undecided, seen from both sides
        self._uncertainty = Uncertainty()
        self._likeness = PlaceLikeness()
        self._visits = Visits(self._every_scan)
        self._thinning = Thinning(self.config.key_distance, self.config.key_turn)
        self._doubt = StepDoubt(self.config)
        self._refused = Refused()
        self._queue: list[int] = []  # of those, what is to be looked at next
        self._undecided: list[int] = []  # keyframes to look at in hindsight
        self._coming: deque[int] = deque()  # keyframes that loops are still to be searched for
        self._job: Job | None = None  # the one that is worked on
        self._accepted: list[Closure] = []  # since the last scan
        self._again: set[int] = set()  # keyframes worth another look, their place being better known now
        self._frame: FloatArray | None = None  # of the odometry of a resumed run, in the map
        self._new_run = False
        self._dirty = False
        self._search = Search(
            apart=self.config.loop_path, certain=self.config.certain, farthest=self.config.farthest,
            anywhere=self.proposals == "places",
        )  # fmt: skip

    def process(
        self,
        scan: Scan | npt.ArrayLike,
        odometry: npt.ArrayLike,
        covariance: npt.ArrayLike | None = None,
        stamp: float | None = None,
    ) -> SlamUpdate:
        """Take the next scan.

        Parameters
        ----------
        scan : `Scan`, or cloud (N, 3) metres.
        odometry : pose of the sensor in the odometry frame, (3,) for scans and (4, 4) for clouds.
        covariance : (3, 3) or (6, 6) of `odometry` since its start, where it is known.
        stamp : seconds; a scan brings its own.

        Raises
        ------
        InputError : wrong shapes, numbers that are not finite, a change between scans and clouds, or clouds where the
            classifier alone is to propose.
        """
        here = as_pose("odometry", odometry)
        if isinstance(scan, Scan) != planar(here):
            raise InputError("odometry: (3,) goes with a Scan, (4, 4) with a cloud")
        if self.proposals == "places" and not planar(here):
            raise InputError("proposals: 'places' needs scans; clouds are not classified")
        if self._visits and planar(here) != planar(self._visits.last.odometry):
            raise InputError("scan: scans and clouds cannot be mixed; call reset() first")
        when = (
            stamp if stamp is not None else scan.stamp if isinstance(scan, Scan) else float(len(self._visits))
        )
        known = None if covariance is None else np.asarray(covariance, dtype=np.float64)
        if self._frame is not None:
            here = compose(self._frame, here)
        self._take_out_if_due()
        if self._visits and not self._new_run:
            self._doubt.watch(self._visits.last.odometry, here)
        if not self._new_run and not self.keyframes.wanted(
            here, self.config.key_distance, self.config.key_turn
        ):
            step = motion(self.keyframes[-1].odometry, here)
            self._visits.add(when, len(self.keyframes) - 1, step, here, False)
            return self._worked(None)
        return self._worked(self._keep(scan, here, known, when))

    @property
    def behind(self) -> int:
        """How many keyframes are still to be worked on."""
        return len(self._coming)

    def work(self) -> SlamUpdate:
        """Go on with what is left over, as much as with a scan, while none comes.

        Raises
        ------
        InputError : no scan was processed yet.
        """
        self._take_out_if_due()
        return self._worked(None)

    @property
    def pose(self) -> FloatArray:
        """Pose of the sensor in the map at the last scan."""
        if not self._visits:
            raise InputError("pose: no scan was processed yet")
        last = self._visits.last
        return compose(self.graph.poses[last.keyframe], last.step)

    @property
    def correction(self) -> FloatArray:
        """The odometry frame in the map frame, now."""
        odometry = self._visits.last.odometry
        if self._frame is not None:
            odometry = compose(invert(self._frame), odometry)
        return compose(self.pose, invert(odometry))

    def trajectory(self) -> FloatArray:
        """All processed scans: (N, 4) stamp, x, y, yaw, or of clouds (N, 7) stamp, x, y, z, roll, pitch, yaw.

        Where not every scan is remembered, the keyframes and the last.
        """
        self.finish()
        return self._visits.rows(self.graph.poses, self.keyframes)

    def visited(self) -> list[FloatArray]:
        """Pose of every processed scan by the current estimate; between keyframes corrections are blended."""
        return self._visits.poses(self.graph.poses, self.keyframes)

    def first_visits(self) -> dict[int, int]:
        """Number of the scan that each keyframe is."""
        return self._visits.first()

    def finish(self) -> None:
        """Look again at what was passed before its place was known, and settle the estimate."""
        while self._coming or self._job is not None:
            self._take_out_if_due()
            self._work(Allowance(None))
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
        self._accepted.clear()
        self.graph.settle()
        self._drop_outliers()

    def restore(self, keyframes: Keyframes, poses: FloatArray, edges: list[Edge]) -> None:
        """The state of a saved map; `resume` says where its next scan is."""
        self.reset()
        self.keyframes = keyframes
        if len(poses):
            self.graph.restore(poses, edges)
        self._visits.restore(keyframes)
        self._thinning = Thinning(self.config.key_distance, self.config.key_turn, len(keyframes))

    def resume(self, correction: FloatArray) -> None:
        """Go on with the map in a new run, whose odometry frame lies at `correction` in the map."""
        self._frame = correction
        self._doubt.begin()
        self.keyframes.gap(NEW_RUN)
        self._new_run = True

    def remove_closure(self, closure: Edge) -> int:
        """Take out a false closure with all others of the same revisit, and make none of it again.

        closure : one of `graph.edges`. Returns how many closures were taken out. The poses are estimated anew.

        Raises
        ------
        InputError : that is no closure in the graph. One that thinning has made part of the path is none any more.
        """
        while self._job is not None:  # what is begun goes by the edges as they are
            self._work(Allowance(None), len(self._coming) - 1)
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

    # One keyframe.

    def _keep(
        self, scan: Scan | npt.ArrayLike, here: FloatArray, covariance: FloatArray | None, when: float
    ) -> int:
        before = self.keyframes[-1].odometry if len(self.keyframes) else None
        if isinstance(scan, Scan):
            if self._visits and not self._new_run:
                last = self._visits.last
                scan = at_first_beam(scan, motion(last.odometry, here), when - last.stamp)
            self.keyframes.add_scan(scan, here, self.config.max_range)
        else:
            points = thinned(as_cloud(scan), 0.5 * LEAF)
            if before is not None and not self._new_run:
                better = self._polished(points, before, here)
                if better is not here:
                    # What odometry says of itself does not hold for a step that was measured anew.
                    here, covariance = better, None
            self.keyframes.add_cloud(points, when, here)
        k = len(self.keyframes) - 1
        if before is None:
            self.graph.begin(here)
        else:
            step = motion(before, here)
            if self._new_run:
                # What odometry does not say the map does: the pose that was found in it, loosely.
                step = motion(self.graph.poses[-1], here)
                doubt = np.diag(
                    [0.2**2] * (2 if planar(here) else 3) + [0.05**2] * (1 if planar(here) else 3)
                )
            else:
                doubt = self._doubt.of(step, before, covariance, self.keyframes)
            self._new_run = False
            self.graph.extend(step, doubt)
        self._visits.add(when, k, identity(here), here, True)
        self._doubt.arrived(covariance)
        self._coming.append(k)
        return k

    def _worked(self, keyframe: int | None) -> SlamUpdate:
        """Work as long as one scan may, and say what came of it."""
        self._work(Allowance(self.pace))
        accepted, self._accepted = self._accepted, []
        return SlamUpdate(self.pose, accepted, keyframe, len(self._hypotheses.waiting), self.behind)

    def _work(self, allowance: Allowance, left: int = 0) -> None:
        """Go on with the keyframe that is worked on, and with those that came after it, until `left` are left."""
        while len(self._coming) > left and (self._job is not None or not self._thinning.due):
            if self._job is None:
                self._job = Job(self._keyframe(self._coming[0]))
            self._job.go_on(allowance)
            if not self._job.done:
                return
            self._job = None
            self._coming.popleft()

    def _keyframe(self, k: int) -> Steps[None]:
        """All that one keyframe leads to. Numbers of keyframes stay as they are meanwhile."""
        yield from self._closing(k)
        if self._thins:
            yield from self._thin()

    def _polished(self, points: FloatArray, before: FloatArray, here: FloatArray) -> FloatArray:
        """Odometry of a cloud, laid on the clouds before it; what it was off by stays taken off."""
        step = polished_step(self.keyframes, points, motion(before, here))
        if step is None:
            return here
        better = orthonormal(compose(before, step))
        raw = here if self._frame is None else compose(invert(self._frame), here)
        self._frame = orthonormal(compose(better, invert(raw)))
        return better

    def _closing(self, k: int) -> Steps[None]:
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

    def _look(self, k: int, both: bool = False, only_certain: bool = True) -> Steps[list[Guess]]:
        yield from self._learning()
        poses = self.graph.poses
        gate = Gate(*self._uncertainty.around(poses, k))
        search = replace(self._search, only_certain=True) if both and only_certain else self._search
        likely: dict[int, float] = {}
        asks = not both and self.proposals == "both" and lost(k, self.keyframes, poses, gate, search)
        if planar(poses) and (asks or self.proposals == "places"):
            likely = yield from self._likeness.asking(k, self.keyframes, self._search.apart)
        fits = yield from looking(k, self.keyframes, poses, gate, search, likely, both)
        if not fits:
            self._again.add(k)
        return fits

    def _learning(self) -> Steps[None]:
        """Take in new edges, and be ready for a question about the uncertainty of all nodes."""
        while self._uncertainty.behind(self.graph.edges):
            yield LEARNING
            self._uncertainty.learn(self.graph.edges, LEARNT)
        yield AROUND * len(self.keyframes)

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
        won = waiting.decide(paths, self.config.farthest, self.keyframes.parts(SLACK), self.graph.poses)
        if not won:
            return []
        recent = {guess.edge.b for guess in won}
        self._again |= waited - recent
        accepted = yield from self._accept(won, f"{len(won)} closures along the path agree")
        accepted += yield from self._second_look(
            [k for k in sorted(self._again) if paths[k] >= paths[min(recent)] - 30.0]
        )
        # The group lies on one earlier pass; others through the same place are found now as well.
        self._again |= recent
        return accepted

    def _second_look(self, keys: list[int]) -> Steps[list[Closure]]:
        """Keyframes passed before their place was known well enough."""
        accepted: list[Closure] = []
        earlier: dict[int, list[int]] = {k: [] for k in keys}
        for closure in self.closures:
            if closure.later in earlier:
                earlier[closure.later].append(closure.earlier)
        for k in keys:
            self._again.discard(k)
            found = yield from self._look(k, True)
            fits = [
                fit
                for fit in found
                if fit.certain and fit.alone and not self._near_path(fit.edge.a, earlier[k])
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

    def _near_path(self, k: int, others: Sequence[int]) -> bool:
        """Whether one of `others` lies about where keyframe `k` does along the path."""
        paths = self.keyframes.paths
        return any(abs(paths[k] - paths[other]) < self._search.spread for other in others)

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
                edge.a, edge.b, self.keyframes[edge.a].stamp, self.keyframes[edge.b].stamp, edge.motion,
                edge.covariance, fit.likelihood, fit.fitness, reason,
            )
            for edge, fit in zip(closures, fits, strict=True)
        ]  # fmt: skip
        self.closures += made
        self._accepted += made
        return made

    def _spread(self, i: int, j: npt.NDArray[np.int64]) -> tuple[FloatArray, FloatArray]:
        return apart(self.keyframes, self._uncertainty, self.graph.poses, i, j)

    # What is known twice.

    def _thin(self) -> Steps[None]:
        """Look at keyframes that the path has left behind, whether they are needed."""
        yield from self._learning()
        needed = self._hypotheses.needed | self._hindsight.needed
        needed |= {*self._queue, *self._undecided, *self._coming}
        for k in self._thinning.next(self.keyframes.paths):
            yield EXAMINING + AROUND * len(self.keyframes)
            gate = Gate(*self._uncertainty.around(self.graph.poses, k))
            self._thinning.examine(k, self.keyframes, self.graph.poses, gate, needed)

    def _take_out_if_due(self) -> None:
        """Between keyframes, as what is under way knows them by their numbers."""
        if self._thinning.due and self._job is None:
            self._take_out()

    def _take_out(self) -> None:
        """Marginalise the keyframes that are not needed; everything else gets new numbers."""
        poses, gone = self.graph.poses, self._thinning.gone
        stay = np.ones(len(poses), dtype=bool)
        stay[list(gone)] = False
        number = np.where(stay, np.cumsum(stay) - 1, -1)
        # What contradicts the whole must not become part of what is taken for granted.
        edges = [
            edge
            for edge in self.graph.edges
            if not edge.closure or (stay[edge.a] and stay[edge.b]) or off(edge, poses)[0] <= WRONG
        ]
        self._visits.take_out(poses, self.keyframes, number, self._thinning.stands_for)
        self.keyframes.take_out(number)
        left = without(edges, gone, len(poses))
        assert isinstance(self.graph, SmoothedGraph)  # of others nothing is taken out
        self.graph.take_out(number, left, renumbered(left, number))
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
        self._coming = deque(int(number[k]) for k in self._coming)
        self._likeness.take_out(number)
        self._thinning.taken_out(number)

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
