"""People in planar laser scans (item 5 of the tracker): clusters, what is behind them, and who they belong to.

Every cluster of returns may be a leg, both legs or a trunk. Potential people are Bernoulli components with a label:
an existence probability that knows about occlusion, a constant-velocity state, and two kinds of evidence that it is a
person: the shape of its clusters, averaged, and that it walked to where the laser had seen nothing before. A person
who once walked stays one while standing. All clusters and potential people are associated jointly.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_shape
from estimation.errors import InputError
from estimation.gaussians import repair_covariance
from estimation.poses import between, compound, inverse
from estimation.uncertain_frame import state_through_uncertain_pose
from registration.scan import Scan
from tracking.background import Background
from tracking.legs import FEATURES, Clusters, clusters_of
from tracking.occlusion import seen_shares
from tracking.people_association import WIDE, Seen, associate
from tracking.people_changes import Changes, Past
from tracking.people_company import Company
from tracking.people_config import PeopleConfig
from tracking.people_mask import OwnBody
from tracking.people_middle import CUT, depths
from tracking.people_parts import parts_of_people
from tracking.people_returns import come_back
from tracking.people_shape import shape_model
from tracking.people_sweep import Sweep
from tracking.people_tracks import SURE, BoolArray, IntArray, Tracks
from tracking.people_update import Moment, learn, update
from tracking.people_walking import Walking
from tracking.target import Target

LARGEST = 0.9  # metres, a cluster wider than that is no person
LEAST_JUMP = 0.05  # metres, or twice the radians, that a pose must change by to have jumped
DOUBLE, DOUBLED = 0.55, 0.5  # metres and seconds for which two with a leg each are taken for two
APART = 0.5  # how much less a scan in which they may be two tells: legs that pass each other have different speeds
STRIDE, ABREAST = 0.9, 0.3  # metres between the legs of a long stride, and off the way they walk
SAME = 0.4  # metres, two potential people closer than that are one
WELL_LOCATED = 1.0  # m; an estimate farther off says no more than that there is somebody
GONE = 0.25  # probability of being there below which somebody reported no longer is
HELD = (
    1.0  # seconds without a guessed pose after which the surroundings are known: as late as they are entered
)
MOST_CLUSTERS = 400
LEAST_JUMP_COLUMN = FEATURES.index("jump_least")
JUMP_COLUMNS = [FEATURES.index("jump_left"), FEATURES.index("jump_right")]


@dataclass(frozen=True)
class Person(Target):
    """A tracked person.

    person : probability that it is one. occluded : hidden now, kept by prediction. last_seen : stamp, s.
    """

    person: float = 1.0
    occluded: bool = False
    last_seen: float = 0.0


@dataclass
class PeopleHealth:
    """late : scans skipped for their stamp. restarts : new runs. thinned : scans of more clusters than are looked at.
    jumps : poses that jumped. potential : potential people after the last scan."""

    late: int = 0
    restarts: int = 0
    thinned: int = 0
    jumps: int = 0
    potential: int = 0


class PeopleTracker:
    """Tracks people from scans and the robot's pose; see the module."""

    def __init__(self, config: PeopleConfig | None = None) -> None:
        self.config = config or PeopleConfig()
        self.health = PeopleHealth()
        self._shape = shape_model()
        self._given = 0
        self._named = 0
        self._numbers: dict[int, int] = {}
        self.reset()

    def reset(self) -> None:
        """Forget everybody and the surroundings; labels go on counting."""
        self.tracks = Tracks.none()
        self.background = Background()
        self._own = OwnBody()
        self._walking = Walking()
        self._changes = Changes()
        self.stamp: float | None = None
        self._late: float | None = None  # stamp of the scan before, if it was late
        self._pose: FloatArray | None = None
        self._uncertain: FloatArray | None = None
        self._held = math.inf
        self.company = Company()

    @property
    def _steady(self) -> bool:
        """Whether the frame has held for so long that the surroundings are known in it."""
        return self._held >= HELD

    @property
    def expected_count(self) -> float:
        """Expected number of people, counting undecided ones."""
        return float(self.tracks.exists @ self._person(self.tracks))

    def _person(self, tracks: Tracks) -> FloatArray:
        """Probability of each being a person, (T,)."""
        return tracks.person(self.company.prior(tracks, self.config.prior))

    def step(
        self,
        scan: Scan,
        pose: npt.ArrayLike,
        stamp: float,
        labels: npt.ArrayLike | None = None,
        pose_covariance: npt.ArrayLike | None = None,
        pose_known: bool = True,
    ) -> list[Target]:
        """People after a scan.

        pose : (3,) x, y, yaw of the scanner, metres and radians; people are in its frame. stamp : seconds.
        labels : (N,) per beam, > 0 moving, 0 static, < 0 unknown, by scan registration; None without.
        pose_covariance : (3, 3) of `pose`, m and rad; None takes the pose for exact. People are followed relative to
        the robot, as its error is the same for all of them and from scan to scan; it is in what is reported.
        pose_known : False where `pose` is a guess: what moves in its frame then need not walk.

        Raises InputError for other shapes, for a pose or stamp that is not finite and an indefinite covariance.
        """
        place, beams = _checked(scan, pose, stamp, labels)
        self._uncertain = None if pose_covariance is None else _checked_covariance(pose_covariance)
        dt = self._interval(float(stamp))
        if dt is None:
            return self._reported()
        self.tracks.predict(dt, self.config.acceleration, self.config.memory)
        before, self._pose = self._pose, place
        self._walking.drive(place, before, dt, pose_known)
        sweep = Sweep.of(scan, place, before, dt)
        own = self._own.mask(scan, place)
        clusters, seen = self._look(scan, sweep, own, beams)
        self._held = self._held + dt if pose_known else 0.0
        owners, scores = self._associate(seen, place, before)
        shares, places = self._shares(scan, place)
        names = self.tracks.names
        moment = Moment(float(stamp), dt, self._steady, self._walking.times)
        update(self.tracks, seen, owners, scores, shares, places, moment, self.config)
        now = Past.of(scan, sweep, place, float(stamp))
        self._walk(now, clusters, seen, owners, dt)
        self._find_doubles(seen, owners, dt)
        whose = self._start(seen, owners, moment)
        self.company.meet(self.tracks, dt)
        self._tidy()
        self._remember(scan, sweep, float(stamp), clusters, seen, owners, names, own)
        self._changes.remember(now.given(clusters, seen, whose))
        return self._reported()

    def _associate(
        self, seen: Seen, pose: FloatArray, before: FloatArray | None
    ) -> tuple[IntArray, FloatArray]:
        """Owners and scores of the clusters.

        Odometry that lost its way jumps. If those who were in view are not found where they should be by the pose, but
        are as seen from the scanner, it was the frame that jumped, and everybody is taken along.
        """
        tracks = self.tracks
        owners, scores = associate(tracks, seen, self.config, self._steady)
        sure = np.flatnonzero(tracks.shown & (tracks.hidden == 0.0))
        if before is None or not len(sure):
            return owners, scores
        step = between(before, pose)
        lost = np.setdiff1d(sure, owners)
        if 2 * len(lost) <= len(sure) or np.hypot(step[0], step[1]) + 2.0 * abs(step[2]) < LEAST_JUMP:
            return owners, scores
        moved = tracks.select(np.arange(len(tracks)))
        moved.shift(compound(pose, inverse(before)))
        others, other_scores = associate(moved, seen, self.config, self._steady)
        if len(np.setdiff1d(sure, others)) >= len(lost):
            return owners, scores
        self.tracks = moved
        self.health.jumps += 1
        return others, other_scores

    def _interval(self, stamp: float) -> float | None:
        """Seconds to predict over; None for a late scan.

        Two late ones that follow each other are not late: the stamp of the one before them was wrong.
        """
        last, config = self.stamp, self.config
        before, self._late = self._late, None
        if last is not None and -config.late_window <= stamp - last < 0.0:
            self.health.late += 1
            if before is None or not 0.0 < stamp - before <= config.max_gap:
                self._late = stamp
                return None
            last = before
        if last is not None and not 0.0 <= stamp - last <= config.max_gap:
            self.health.restarts += 1
            self.reset()
            last = None
        self.stamp = stamp
        return 0.1 if last is None else stamp - last

    def _look(
        self, scan: Scan, sweep: Sweep, own: BoolArray, labels: IntArray | None
    ) -> tuple[Clusters, Seen]:
        """Clusters of the scan, and those that may be of people in the frame of the tracks."""
        fresh, old = self._against_background(scan, sweep)
        clusters = clusters_of(scan, self.config.join_distance, self.config.max_range, own)
        parts = parts_of_people(self.tracks, sweep, clusters, old)
        if parts is not None:
            clusters = clusters_of(scan, self.config.join_distance, self.config.max_range, own, parts)
        if labels is not None:
            fresh = np.maximum(fresh, np.where(labels > 0, 0.8, 0.0))
        names = clusters.labels[clusters.labels >= 0]
        inside = clusters.labels >= 0
        counts = np.maximum(clusters.counts, 1)
        cluster_fresh = np.bincount(names, fresh[inside], len(clusters)) / counts
        cluster_old = np.bincount(names, old[inside], len(clusters)) / counts
        spacing = clusters.ranges * abs(scan.angle_increment)
        enough = (clusters.counts >= 3) | ((clusters.counts == 2) & (spacing > 0.03)) | (spacing > 0.08)
        chosen = np.flatnonzero(enough & (clusters.widths < LARGEST))
        if len(chosen) > MOST_CLUSTERS:
            self.health.thinned += 1
            chosen = chosen[np.argsort(clusters.ranges[chosen], kind="stable")[:MOST_CLUSTERS]]
        evidence = self._shape.evidence(clusters)[chosen]
        ranges, widths = clusters.ranges[chosen], clusters.widths[chosen]
        behind = depths(clusters, clusters.features[:, LEAST_JUMP_COLUMN] > 0.0, spacing)[chosen]
        places = clusters.centres[chosen] * (1.0 + behind / np.maximum(ranges, 0.1))[:, None]
        middles = (clusters.first[chosen] + clusters.last[chosen]) // 2
        placed = sweep.placed(places, middles)
        sights = placed - sweep.origins[middles]
        return clusters, Seen(
            placed,
            widths,
            ranges,
            evidence,
            cluster_fresh[chosen],
            cluster_old[chosen],
            clusters.counts[chosen],
            clusters.features[chosen, LEAST_JUMP_COLUMN],
            behind,
            sights / np.maximum(np.linalg.norm(sights, axis=1), 0.05)[:, None],
            clusters.features[chosen][:, JUMP_COLUMNS] < CUT,
            1.0 if scan.angle_increment > 0.0 else -1.0,
            chosen,
        )

    def _against_background(self, scan: Scan, sweep: Sweep) -> tuple[FloatArray, FloatArray]:
        """Per beam (N,): how surely its return lies where it was empty, and where something stood."""
        valid = scan.valid & (np.where(scan.valid, scan.ranges, np.inf) < self.config.max_range)
        fresh, old = np.zeros(len(scan)), np.zeros(len(scan))
        ranges = scan.ranges[valid]
        fresh[valid], old[valid] = self.background.evidence(sweep.points(valid), 0.05 + 0.02 * ranges)
        return fresh, old

    def _shares(self, scan: Scan, pose: FloatArray) -> tuple[FloatArray, FloatArray]:
        """How much of each track the scan could show (T, S) at places (T, S, 2) about where it is expected."""
        tracks = self.tracks
        c, s = math.cos(pose[2]), math.sin(pose[2])
        turn = np.array([[c, s], [-s, c]])
        centres = (tracks.means[:, :2] - pose[:2]) @ turn.T
        spreads = turn @ tracks.covariances[:, :2, :2] @ turn.T
        shares, places = seen_shares(scan, centres, spreads, self.config.max_range)
        return shares, places @ turn

    def _walk(self, now: Past, clusters: Clusters, seen: Seen, owners: IntArray, dt: float) -> None:
        """What those seen now say about walking."""
        tracks = self.tracks
        moved = np.zeros(len(tracks))
        if self._walking.due(dt) and math.isfinite(self._walking.robot):
            wall = np.append(clusters.widths > LARGEST, False)[clusters.labels]
            given = now.given(clusters, seen, _names_of(tracks, owners))
            unsure = (tracks.hidden == 0.0) & ~(tracks.shown & (tracks.motion >= SURE))
            moved[unsure] = self._changes.walking(tracks.names[unsure], given, wall, self._walking.robot)
            # A leg of somebody who is known walks, too.
            gaps = np.linalg.norm(tracks.means[:, None, :2] - tracks.means[None, tracks.shown, :2], axis=2)
            moved[~tracks.shown & (gaps < STRIDE).any(1)] = 0.0
        free, old = _of_owners(seen, owners, len(tracks))
        self._walking.learn(tracks, free, old, len(seen), now.stamp, dt, moved)

    def _find_doubles(self, seen: Seen, owners: IntArray, dt: float) -> None:
        """Two that walk together with one leg each are one person; of two people one now and then shows both legs."""
        tracks = self.tracks
        legs = np.bincount(owners[owners >= 0], np.where(seen.widths > WIDE, 2, 1)[owners >= 0], len(tracks))
        lone = np.flatnonzero(legs == 1).tolist()
        alone = np.ones(len(tracks), dtype=bool)
        for k, a in enumerate(lone):
            for b in lone[k + 1 :]:
                if _one_leg_each(tracks, a, b):
                    younger = b if _older(tracks, a) > _older(tracks, b) else a
                    tracks.doubled[younger] += dt
                    alone[younger] = False
        tracks.doubled[alone & (legs > 0)] = np.maximum(tracks.doubled[alone & (legs > 0)] - APART * dt, 0.0)

    def _start(self, seen: Seen, owners: IntArray, moment: Moment) -> IntArray:
        """New potential people from clusters that are nobody's, two near ones being one person; whose each is now."""
        whose = _names_of(self.tracks, owners)
        free = np.flatnonzero((owners < 0) & (seen.shape > -3.0) & (seen.old < 0.7))
        taken = np.zeros(len(seen), dtype=bool)
        groups = []
        if len(free):
            gaps = np.linalg.norm(seen.places[free][:, None] - seen.places[free][None], axis=2)
            gaps[np.tril_indices(len(free))] = np.inf
            gaps[seen.widths[free] > WIDE] = np.inf
            gaps[:, seen.widths[free] > WIDE] = np.inf
            near = np.argwhere(gaps < 0.7)
            for a, b in near[np.argsort(gaps[near[:, 0], near[:, 1]], kind="stable")].tolist():
                if not taken[free[a]] and not taken[free[b]]:
                    taken[free[a]] = taken[free[b]] = True
                    groups.append([int(free[a]), int(free[b])])
            groups += [[int(k)] for k in free if not taken[k]]
        # Close to somebody who is known, an odd cluster is a part of him, or of what is next to him.
        places = np.array([seen.places[group].mean(0) for group in groups]).reshape(-1, 2)
        sure = self.tracks.means[self.tracks.shown, :2]
        if len(sure) and len(places):
            clear = np.linalg.norm(places[:, None] - sure[None], axis=2).min(1) > SAME
            places = places[clear]
            groups = [group for group, keep in zip(groups, clear, strict=True) if keep]
        if not groups:
            return whose
        n = len(groups)
        means = np.hstack((places, np.zeros((n, 2))))
        variances = np.array([0.1 if len(group) == 2 else self.config.leg_noise for group in groups]) ** 2
        covariances = np.zeros((n, 4, 4))
        covariances[:, 0, 0] = covariances[:, 1, 1] = variances
        covariances[:, 2, 2] = covariances[:, 3, 3] = 0.7**2
        born = Tracks.born(np.arange(self._named, self._named + n), means, covariances, moment.stamp)
        self._named += n
        first = len(self.tracks)
        self.tracks = self.tracks.joined(born)
        for k, group in enumerate(groups):
            learn(self.tracks, first + k, seen, np.array(group), replace(moment, dt=0.1))
            self.tracks.oldness[first + k] = seen.old[group].mean()
            whose[group] = born.names[k]
        return whose

    def _tidy(self) -> None:
        """Drop what is not there, join what is one person, and decide who is reported."""
        tracks = self.tracks.select(~come_back(self.tracks))
        person = self._person(tracks)
        keep = tracks.existence > np.where(tracks.public >= 0, -3.0, -1.5)
        keep &= tracks.doubled < DOUBLED
        order = np.lexsort((tracks.names, -tracks.existence * person, ~tracks.shown))
        for rank, a in enumerate(order):
            if not keep[a]:
                continue
            for b in order[rank + 1 :]:
                if not keep[b] or tracks.shown[b]:
                    continue
                apart = tracks.means[a] - tracks.means[b]
                if np.hypot(*apart[:2]) < SAME and np.hypot(*apart[2:]) < 0.8 and tracks.hidden[a] < 0.3:
                    keep[b] = False
        self.tracks = tracks = tracks.select(keep)
        exists, person = tracks.exists, self._person(tracks)
        tracks.shown = np.where(
            tracks.shown,
            (exists > GONE) & (person > self.config.keep),
            (exists > self.config.report) & (person > self.config.report) & (tracks.doubled == 0.0),
        )
        for t in np.flatnonzero(tracks.shown & (tracks.public < 0)):
            tracks.public[t] = self._number(int(tracks.names[t]))
        present = set(tracks.names.tolist())
        self._numbers = {name: number for name, number in self._numbers.items() if name in present}
        self.health.potential = len(tracks)

    def _remember(
        self,
        scan: Scan,
        sweep: Sweep,
        stamp: float,
        clusters: Clusters,
        seen: Seen,
        owners: IntArray,
        names: IntArray,
        own: BoolArray,
    ) -> None:
        """Enter the scan into the background, without people and the robot itself."""
        people = np.zeros(len(clusters) + 1, dtype=bool)
        ours = owners >= 0
        maybe = self.company.maybe(self.tracks, self.config.prior)
        people[seen.index[ours][np.isin(names[owners[ours]], self.tracks.names[maybe])]] = True
        ignore = own | people[clusters.labels]
        self.background.add(sweep, stamp, ignore)

    def _number(self, name: int) -> int:
        """The label of a track, given when it is first told of, as a person or as anything."""
        if name not in self._numbers:
            self._numbers[name] = self._given
            self._given += 1
        return self._numbers[name]

    @property
    def targets(self) -> list[Target]:
        """Everything that stands free or moves, people among it, after the last scan; `person` says which.

        States and units as of what `step` returns, which are those of these that are told of as people. What begins to
        look like a person keeps its label.
        """
        tracks = self.tracks
        there = (tracks.exists > self.config.report) & (tracks.doubled == 0.0) & (tracks.hidden == 0.0)
        return self._told(np.flatnonzero(there | self._people()))

    def _people(self) -> BoolArray:
        """Who is told of as a person, (T,)."""
        tracks = self.tracks
        near = tracks.within(WELL_LOCATED)
        return np.asarray(tracks.shown & ((tracks.hidden == 0.0) | (near > self.config.located)))

    def _reported(self) -> list[Target]:
        return self._told(np.flatnonzero(self._people()))

    def _told(self, chosen: IntArray) -> list[Target]:
        """Tracks as targets, by label."""
        tracks = self.tracks
        weights = tracks.exists
        person = self._person(tracks)
        found: list[Target] = [
            Person(
                int(tracks.public[t]) if tracks.public[t] >= 0 else self._number(int(tracks.names[t])),
                *self._located(tracks.means[t], tracks.covariances[t]),
                float(weights[t]),
                tracks.extents[t].copy(),
                float(tracks.rates[t]),
                float(person[t]),
                bool(tracks.hidden[t] > 0.0),
                float(tracks.last_seen[t]),
            )
            for t in chosen.tolist()
        ]
        return sorted(found, key=lambda target: target.label)

    def _located(self, mean: FloatArray, covariance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean and covariance of a state in the frame of the poses, with the error of the robot's own."""
        if self._uncertain is None or self._pose is None:
            return mean.copy(), covariance.copy()
        return state_through_uncertain_pose(mean, covariance, self._pose[:2], self._uncertain)


def _older(tracks: Tracks, t: int) -> tuple[bool, int]:
    """For comparing: who was reported, or was first."""
    return bool(tracks.public[t] >= 0), -int(tracks.names[t])


def _one_leg_each(tracks: Tracks, a: int, b: int) -> bool:
    """Whether two that show one leg each may be one person: near each other, or a long stride apart as they walk."""
    apart = tracks.means[a] - tracks.means[b]
    gap, relative = math.hypot(apart[0], apart[1]), math.hypot(apart[2], apart[3])
    if gap < DOUBLE and relative < 1.2:
        return True
    if gap > STRIDE:
        return False
    way = 0.5 * (tracks.means[a, 2:] + tracks.means[b, 2:])
    speed = math.hypot(way[0], way[1])
    # Legs take turns: while one stands the other swings, at up to twice the speed of the person.
    if speed < 0.2 or relative > 3.0 * speed:
        return False
    return abs(apart[0] * way[1] - apart[1] * way[0]) < ABREAST * speed


def _names_of(tracks: Tracks, owners: IntArray) -> IntArray:
    """Names of the tracks that own clusters, (K,); -1 of those that are nobody's."""
    return np.where(owners >= 0, tracks.names[owners] if len(tracks) else -1, -1)


def _of_owners(seen: Seen, owners: IntArray, count: int) -> tuple[FloatArray, FloatArray]:
    """How free what is seen of each track stands, nan where nothing is, and how old it is; (T,) each."""
    free, old = np.full(count, np.nan), np.zeros(count)
    for k in np.flatnonzero(owners >= 0).tolist():
        t = owners[k]
        free[t] = np.fmin(free[t], seen.free[k])
        old[t] = max(old[t], seen.old[k])
    return free, old


def _checked(
    scan: Scan, pose: npt.ArrayLike, stamp: float, labels: npt.ArrayLike | None
) -> tuple[FloatArray, IntArray | None]:
    place = as_finite("pose", pose)
    if place.shape != (3,):
        raise InputError(f"pose must have shape (3,), not {place.shape}")
    if not np.isfinite(stamp):
        raise InputError(f"stamp must be finite, not {stamp!r}")
    if labels is None:
        return place, None
    beams = np.asarray(labels)
    if beams.shape != (len(scan),):
        raise InputError(f"labels must have shape ({len(scan)},), one per beam, not {beams.shape}")
    return place, beams.astype(np.int64)


def _checked_covariance(pose_covariance: npt.ArrayLike) -> FloatArray:
    P = as_shape("pose_covariance", pose_covariance, (3, 3))
    return repair_covariance(P, "pose_covariance", definite=False)
