"""SLAM on a trajectory of keyframes: recognise, verify, close, smooth (chapters 2 and 4, Paper A section 4.3).

Slam().process(scan, odometry) -> SlamUpdate(pose, closures)
Slam().trajectory() -> (N, 4) stamp, x, y, yaw
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, get_args

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_own, as_stamp, require_positive
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from loop_closure.graph.edges import Edge
from loop_closure.graph.marginal import renumbered, without
from loop_closure.graph.pose_graph import PoseGraph, SmoothedGraph
from loop_closure.graph.smoother_process import SmootherProcess
from loop_closure.graph.steps import StepDoubt
from loop_closure.graph.uncertainty import FOUND
from loop_closure.keyframes import Keyframes
from loop_closure.motions import as_pose, compose, doubt_of, identity, invert, motion, orthonormal, planar
from loop_closure.slam.closing import off
from loop_closure.slam.cloud_closing import LEAF, as_cloud, polished_step, thinned
from loop_closure.slam.loop_closer import AROUND, WRONG, Closure, LoopCloser
from loop_closure.slam.thinning import Thinning
from loop_closure.slam.visits import Visits
from loop_closure.slam_config import Proposals, SlamConfig
from loop_closure.work import Allowance, Job, Steps
from registration.laser.own_body import OwnBody
from registration.laser.scan import Scan
from registration.laser.sweep import at_first_beam

NEW_RUN = 1000.0  # metres of path that stand for a restart
EXAMINING = 2.0  # ms, a keyframe that may be taken out


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
        self.proposals, self._thins = proposals, thin
        self.pace = None if pace is None else require_positive("pace", pace)
        self._every_scan = not thin if every_scan is None else every_scan
        self._new_graph, self._aside = graph, aside
        self.reset()

    def __getstate__(self) -> dict[str, Any]:
        """For copies, which smooth in the process they are in; what is half done cannot be copied."""
        self._end_job()
        return self.__dict__ | {"_aside": None}

    def reset(self) -> None:
        """Forget everything: the next scan starts a new map."""
        self._begin(Keyframes())

    def _begin(self, keyframes: Keyframes) -> None:
        self.graph: PoseGraph = self._new_graph or SmoothedGraph(self._aside)
        self.keyframes = keyframes
        self._closer = LoopCloser(self.graph, keyframes, self.config, self.proposals)
        self._visits = Visits(self._every_scan)
        self._thinning = Thinning(self.config.key_distance, self.config.key_turn, len(keyframes))
        self._doubt = StepDoubt(self.config)
        self._coming: deque[int] = deque()  # keyframes that loops are still to be searched for
        self._job: Job | None = None  # the one that is worked on
        self._own = OwnBody()
        self._frame: FloatArray | None = None  # of the odometry of a resumed run, in the map
        self._new_run = False

    @property
    def closures(self) -> list[Closure]:
        """All that were accepted and not taken out again."""
        return list(self._closer.closures)

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
        when = float(len(self._visits)) if stamp is None else as_stamp("stamp", stamp)
        known = None if covariance is None else _covariance(covariance, 3 if planar(here) else 6)
        if isinstance(scan, Scan):
            when = scan.stamp if stamp is None else when
            scan = self._own.without(scan, here)
        else:
            scan = as_cloud(scan)
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
        pose, odometry = self.pose, self._visits.last.odometry
        if self._frame is not None:
            odometry = compose(invert(self._frame), odometry)
        return compose(pose, invert(odometry))

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
        self._closer.finish()

    def restore(
        self, keyframes: Keyframes, poses: FloatArray, edges: list[Edge], closures: Sequence[Closure] = ()
    ) -> None:
        """The state of a saved map; `resume` says where its next scan is."""
        self._begin(keyframes)
        if len(poses):
            self.graph.restore(poses, edges)
        self._visits.restore(keyframes)
        self._closer.closures = list(closures)

    def resume(self, correction: npt.ArrayLike) -> None:
        """Go on with the map in a new run, whose odometry frame lies at `correction`, (3,) or (4, 4), in the map.

        Raises
        ------
        InputError : no map to go on with, or a correction that does not go with it.
        """
        frame = as_pose("correction", correction)
        if not self._visits:
            raise InputError("resume: there is no map to go on with")
        if planar(frame) != planar(self.pose):
            raise InputError("correction: (3,) goes with a map of scans, (4, 4) with one of clouds")
        self._frame = frame
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
        self._end_job()  # what is begun goes by the edges as they are
        return self._closer.remove(closure)

    # One keyframe.

    def _keep(
        self, scan: Scan | FloatArray, here: FloatArray, covariance: FloatArray | None, when: float
    ) -> int:
        before = self.keyframes[-1].odometry if len(self.keyframes) else None
        if isinstance(scan, Scan):
            if self._visits and not self._new_run:
                last = self._visits.last
                scan = at_first_beam(scan, motion(last.odometry, here), when - last.stamp)
            self.keyframes.add_scan(scan, here, self.config.max_range)
        else:
            points = thinned(scan, 0.5 * LEAF)
            better = None if before is None or self._new_run else self._polished(points, before, here)
            if better is not None:
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
                doubt = doubt_of(here, *FOUND)
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
        accepted, self._closer.accepted = self._closer.accepted, []
        return SlamUpdate(self.pose, accepted, keyframe, self._closer.waiting, self.behind)

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

    def _end_job(self) -> None:
        while self._job is not None:
            self._work(Allowance(None), len(self._coming) - 1)

    def _keyframe(self, k: int) -> Steps[None]:
        """All that one keyframe leads to. Numbers of keyframes stay as they are meanwhile."""
        yield from self._closer.closing(k)
        if self._thins:
            yield from self._thin()

    def _polished(self, points: FloatArray, before: FloatArray, here: FloatArray) -> FloatArray | None:
        """Odometry of a cloud, laid on the clouds before it, if that helps; what it was off by stays taken off."""
        step = polished_step(self.keyframes, points, motion(before, here))
        if step is None:
            return None
        better = orthonormal(compose(before, step))
        raw = here if self._frame is None else compose(invert(self._frame), here)
        self._frame = orthonormal(compose(better, invert(raw)))
        return better

    # What is known twice.

    def _thin(self) -> Steps[None]:
        """Look at keyframes that the path has left behind, whether they are needed."""
        yield from self._closer.learning()
        needed = self._closer.needed | {*self._coming}
        for k in self._thinning.next(self.keyframes.paths):
            yield EXAMINING + AROUND * len(self.keyframes)
            gate = self._closer.gate(k)
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
        self._closer.take_out(number)
        self._coming = deque(int(number[k]) for k in self._coming)
        self._thinning.taken_out(number)


def _covariance(given: npt.ArrayLike, size: int) -> FloatArray:
    """The covariance (size, size) of odometry; InputError for another shape, or one that is none."""
    return repair_covariance(as_own("covariance", given, (size, size)), definite=False)
