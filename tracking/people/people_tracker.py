"""People and whatever else stands free in laser scans: the mixture with the measurement model `clusters`.

The core is `tracking.mixture.pmbm`, as for points. Which targets are people is a part of each target's state:
a log-odds that a learned model gives from all that was seen of it (`tracking.people.person_class`), no rule
about speed, company or history.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy.special import expit

from estimation.checks import FloatArray, as_floats, as_number, as_own, as_shape, require_kind
from estimation.conversion.uncertain_frame import state_through_uncertain_pose
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from estimation.geometry.poses import compound, inverse, transform_points
from registration.laser.own_body import OwnBody
from registration.laser.range_noise import RangeNoise
from registration.laser.scan import Scan
from tracking.mixture.birth_seeds import ReturnLooks
from tracking.mixture.components import IntArray
from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.phd_models import Detection
from tracking.mixture.pmbm import PmbmRecursion
from tracking.mixture.target import Target, shown
from tracking.people.cluster_model import KINDS, SHAPE, ClusterScan, ScanDetection, StandingOrWalking
from tracking.people.free_space import DELAY, Background
from tracking.people.identity import ReturningPeople
from tracking.people.legs import clusters_of
from tracking.people.people_config import PeopleConfig
from tracking.people.people_shape import shape_model
from tracking.people.people_sweep import Sweep
from tracking.people.person_class import SHORT, ClassEvidence, ClassModel, ScanLook, class_model, rows_of

PERIOD = 0.1  # s, of a scan as the settings mean it
OPPOSITE = -0.8  # correlation of where both legs are about the middle
WIDE = 0.25  # m, a cluster wider than that is both legs or a trunk
EXACTER = 4.0  # by which the variance of its place is smaller than that of a leg
CLUSTERS = 1.5  # that a person gives on average, one leg hiding the other half of the time
SPEED = 0.7  # m/s, deviation of a new target's velocity
LINK = 0.9995  # quantile of the distance of two legs up to which they are searched together
HYPOTHESES, MARGIN = 5, 5.0  # per group of targets, and how far below the likeliest, nat; set for speed
# Deviations of a range by which neighbouring returns of one thing may lie apart: four of the difference of two.
NOISES = 6.0
BELONGS = 0.45  # m from a target to the clusters that tell its class
# Two targets whose way from one to the other is on average shorter than that, m, over that many seconds are the legs of
# one: legs pass each other, people do not. Set on people who walk among pillars, seed 500.
LEGS, STRIDES = 0.3, 1.0
NEIGHBOURS = 1.0  # m between the legs of one person at most
# How probably a frame jumps, learned over s from how often it did; and how far from where a target should be its
# cluster is, m, but for a share that is not found at all.
JUMPS, LEARNED = 0.001, 30.0
FOUND, UNFOUND = 0.15, 0.0001
GAP = 0.5  # s after a scan, or twice the time before it, from which the stamp of the next may be wrong
UNSEEN = KINDS.index("unseen")


@dataclass(frozen=True)
class Person(Target):
    """A tracked target with its class.

    person : probability that it is one. occluded : hidden now, kept by prediction. last_seen : stamp, s.
    label_probability : that it is who had the label before he was out of sight.
    """

    person: float = 1.0
    label_probability: float = 1.0
    occluded: bool = False
    last_seen: float = 0.0


@dataclass
class PeopleHealth:
    """late : scans skipped for their stamp. restarts : new runs. thinned : scans of more clusters than are looked at.
    jumps : poses that jumped. potential : targets of any class after the last scan."""

    late: int = 0
    restarts: int = 0
    thinned: int = 0
    jumps: int = 0
    potential: int = 0


class PeopleTracker:
    """Tracks people, and all else that stands free, from scans and the robot's pose; see the module."""

    def __init__(self, config: PeopleConfig | None = None, classes: ClassModel | None = None) -> None:
        """classes : instead of the shipped ones."""
        self.config = PeopleConfig() if config is None else config
        require_kind("config", self.config, PeopleConfig)
        self.shape, self.classes = shape_model(), classes or class_model()
        self.health = PeopleHealth()
        self._phd = PhdConfig(
            detection_probability=self.config.detection_probability,
            survival_probability=math.exp(-PERIOD / self.config.memory),
            measurement_noise=self.config.leg_noise,
            process_noise=self.config.acceleration,
            measurement_rate=CLUSTERS,
            births=[],
            spawn=None,
            scan_period=PERIOD,
            distance_probabilities=(0.0, LINK),
            max_hypotheses=HYPOTHESES,
            hypothesis_margin=MARGIN,
        )
        self._sight = self._detection()
        detection: Detection = self._sight
        self.recursion = PmbmRecursion(self._phd, detection)
        self.recursion.motion = StandingOrWalking(self._phd)
        self.recursion.correlation = OPPOSITE
        self.reset()

    def _detection(self) -> ScanDetection:
        """Where p_D comes from."""
        return ScanDetection(self.config.detection_probability, self.config.max_range)

    def reset(self) -> None:
        """Forgets all targets and the surroundings; labels go on counting."""
        self.recursion.reset()
        self.background = Background()
        self.evidence: dict[int, ClassEvidence] = {}
        self.identities = ReturningPeople()
        self.targets: list[Person] = []
        self.seen: ClusterScan | None = None
        self._between: dict[tuple[int, int], tuple[float, FloatArray]] = {}
        self._own, self._noise = OwnBody(), RangeNoise()
        self.stamp: float | None = None
        self._doubt: float | None = None  # stamp of the scan before, if it may be wrong
        self._usual = PERIOD  # s from one scan to the next, as it was last
        self._pose: FloatArray | None = None
        self._uncertain: FloatArray | None = None
        self._held = math.inf  # s for which the pose has been known
        self._jumps = JUMPS  # probability that the frame jumps from one scan to the next

    @property
    def expected_count(self) -> float:
        """Expected number of people."""
        return float(sum(target.weight * target.person for target in self.targets))

    def step(
        self,
        scan: Scan,
        pose: npt.ArrayLike,
        stamp: float,
        labels: npt.ArrayLike | None = None,
        pose_covariance: npt.ArrayLike | None = None,
        pose_known: bool = True,
    ) -> list[Person]:
        """People after a scan; `targets` has everything, of any class.

        pose : (3,) x, y, yaw of the scanner, metres and radians; targets are in its frame. stamp : seconds.
        labels : (N,) per beam, > 0 moving, 0 static, < 0 unknown, by scan registration; None without.
        pose_covariance : (3, 3) of `pose`, m and rad; None takes the pose for exact. Targets are followed relative to
        the robot, as its error is the same for all of them and from scan to scan; it is in what is reported.
        pose_known : False where `pose` is a guess: what was seen empty in its frame then says nothing.

        Raises InputError for other shapes, for a pose or stamp that is not finite and an indefinite covariance.
        """
        place, moving = _checked(scan, pose, stamp, labels)
        self._uncertain = None if pose_covariance is None else _checked_covariance(pose_covariance)
        dt = self._interval(float(stamp))
        if dt is None:
            return self._people()
        self._held = self._held + dt if pose_known else 0.0
        if self._held < DELAY:
            self.background.clear()
        sweep = Sweep.of(scan, place, self._pose, dt)
        own = self._own.mask(scan, place)
        self._noise.learn(scan)
        join = self.config.join_distance
        # Where hardly anything is smooth, as among leaves, it is no noise.
        join = min(max(join, NOISES * self._noise.value), 2.0 * join)
        clusters = clusters_of(scan, join, self.config.max_range, own)
        seen = ClusterScan.of(scan, sweep, clusters, self.background, self.shape, moving)
        if self._jumped(seen, place, dt):
            self.background.clear()
            seen = ClusterScan.of(scan, sweep, clusters, self.background, self.shape, moving)
        self.seen = seen
        self.health.thinned += seen.thinned
        self._sight.scan = scan
        # All in reach may be new; where it is how likely comes with the measurements.
        reach = self.config.max_range
        spread = np.diag([reach**2, reach**2, SPEED**2, SPEED**2])
        self._phd.births = [(1.0, np.array([*place[:2], 0.0, 0.0]), spread)]
        self.recursion.update(seen.places, dt, place, _looks(seen, dt))
        self.stamp, self._pose = float(stamp), place
        found = self.recursion.targets()
        gone = self._unite(found, dt)
        self._classify([target for target in found if target.label not in gone], seen, place, dt)
        # What is followed as a target is no clutter, whatever its class.
        mine = np.zeros(len(seen.clusters) + 1, dtype=bool)
        mine[seen.index[self._of_targets(seen)]] = True
        people = np.array([person.mean[:2] for person in self._people()]).reshape(-1, 2)
        self.background.add(sweep, stamp, own | mine[seen.clusters.labels], people, BELONGS)
        self.health.potential = len(self.targets)
        self._name(found)
        return self._people()

    def _name(self, found: list[Target]) -> None:
        """Whoever comes back has the label that he had; where he was still awaited elsewhere is forgotten."""
        living = {target.label for target in found}
        seen = {target.label for target in self.targets if not target.occluded}
        stamp, labels = float(self.stamp or 0.0), self.recursion.extractor.labels
        unseen = {target.label: self.evidence[target.label].unseen for target in self.targets}
        looked = {target.label: self._person_alone(target.label) for target in self.targets}
        left = self.identities.update(self._people(), seen, unseen, living, stamp, labels, looked)
        self.recursion.forget(left - {target.label for target in self.targets}, {})
        for k, target in enumerate(self.targets):
            name = self.identities.names.get(target.label)
            if name is not None:
                self.targets[k] = replace(target, label=name.label, label_probability=name.probability)
        self.targets.sort(key=lambda target: target.label)

    def _interval(self, stamp: float) -> float | None:
        """Seconds to predict over; None for a scan that is late or after a gap, which changes nothing.

        Its stamp may be wrong, and people in plain view would not be where they had been long ago. Where the next scan
        agrees with it, it was right: that of the scan before them was wrong, or there was a gap, or time is another.
        """
        last, doubt, config = self.stamp, self._doubt, self.config
        self._doubt = None
        if last is None:
            return PERIOD
        dt = stamp - last
        if not 0.0 <= dt <= max(GAP, 2.0 * self._usual):
            if doubt is None or not 0.0 < stamp - doubt <= config.max_gap:
                self.health.late += 1
                self._doubt = stamp
                return None
            if -config.late_window <= dt < 0.0:
                dt = stamp - doubt
            if not 0.0 <= dt <= config.max_gap:
                self.health.restarts += 1
                self.reset()
                return PERIOD
        self._usual = dt
        return dt

    def _jumped(self, seen: ClusterScan, pose: FloatArray, dt: float) -> bool:
        """Whether the frame jumped, as odometry does that lost its way: everybody is then taken along.

        The odds that it did: how much better all that was in view before, of any class, is found where it was as seen
        from the scanner than where it was by the poses, times how often this frame jumps.
        """
        before = self._pose
        if before is None:
            return False
        sure = [target for target in self.targets if target.last_seen == self.stamp]
        self._jumps += min(dt / LEARNED, 1.0) * (JUMPS - self._jumps)
        if not sure:
            return False
        shift = compound(pose, inverse(before))
        spots = np.array([target.mean[:2] + dt * target.mean[2:] for target in sure])
        better = _fit(transform_points(shift, spots), seen) - _fit(spots, seen)
        if better + math.log(self._jumps / (1.0 - self._jumps)) <= 0.0:
            return False
        self._jumps += min(dt / LEARNED, 0.5) * (1.0 - self._jumps)
        self.recursion.shift(shift)
        for evidence in self.evidence.values():
            evidence.shift(shift)
        self.identities.shift(shift)
        for key, (seconds, way) in self._between.items():
            self._between[key] = seconds, transform_points([0.0, 0.0, shift[2]], way)
        self.health.jumps += 1
        return True

    def _unite(self, found: list[Target], dt: float) -> set[int]:
        """Of two targets that are the legs of one person, the younger goes, and its label is returned; see `LEGS`."""
        means = np.array([target.mean for target in found]).reshape(-1, 4)
        ways = means[None] - means[:, None]
        near = np.argwhere(np.triu(np.hypot(ways[..., 0], ways[..., 1]) < NEIGHBOURS, 1))
        share = min(dt / STRIDES, 1.0)
        between: dict[tuple[int, int], tuple[float, FloatArray]] = {}
        moved: dict[int, FloatArray] = {}
        gone: set[int] = set()
        # Targets come by label, the elder first.
        for a, b in near.tolist():
            elder, younger = found[a].label, found[b].label
            seconds, mean = self._between.get((elder, younger), (0.0, ways[a, b, :2]))
            mean = mean + share * (ways[a, b, :2] - mean)
            between[elder, younger] = seconds + dt, mean
            if seconds + dt > STRIDES and math.hypot(*mean) < LEGS and elder not in gone:
                gone.add(younger)
                moved[elder] = 0.5 * ways[a, b]
        self._between = between
        if gone:
            self.recursion.forget(gone, moved)
        return gone

    def _of_targets(self, seen: ClusterScan) -> npt.NDArray[np.bool_]:
        """Which clusters (K,) are of a target."""
        spots = np.array([target.mean[:2] for target in self.targets]).reshape(-1, 2)
        gaps = np.linalg.norm(seen.places[:, None] - spots[None], axis=2)
        return np.asarray(gaps.min(axis=1, initial=np.inf) < BELONGS)

    def _classify(self, found: list[Target], seen: ClusterScan, pose: FloatArray, dt: float) -> None:
        """What this scan says of the class of each target, and all targets with it."""
        spots = np.array([target.mean[:2] for target in found]).reshape(-1, 2)
        gaps = np.linalg.norm(spots[:, None] - seen.places[None], axis=2).reshape(
            len(found), len(seen.places)
        )
        nearest = gaps.argmin(0) if len(found) else np.zeros(len(seen.places), dtype=int)
        stamp = float(self.stamp or 0.0)
        view = ScanLook(seen, rows_of(seen), pose, dt, stamp, self._held >= DELAY)
        nearer = nearest == np.arange(len(found))[:, None]
        around = ((gaps < 1.5) & ~nearer).sum(1).tolist()
        mine = [row.nonzero()[0] for row in nearer & (gaps < BELONGS)]
        living = {target.label for target in found}
        for target, whose, others in zip(found, mine, around, strict=True):
            evidence = self.evidence.get(target.label)
            if evidence is None:
                evidence = self.evidence[target.label] = self._newcomer(target.mean[:2], whose, seen)
            evidence.look(view, whose, target, others)
        self.evidence = {label: item for label, item in self.evidence.items() if label in living}
        odds = self.classes.odds([self.evidence[target.label].features(target) for target in found])
        for target, own in zip(found, expit(odds).tolist(), strict=True):
            if self.evidence[target.label].looks > SHORT:
                self.evidence[target.label].own = own
        odds += self._known_before(found)
        people = expit(odds).tolist()
        self.recursion.classify({target.label: p for target, p in zip(found, people, strict=True)})
        persons = [self._person(target, p) for target, p in zip(found, people, strict=True)]
        self.targets = [person for person in persons if person is not None]

    def _person(self, target: Target, person: float) -> Person | None:
        """A target with its class; None where nobody knows any more where it is."""
        evidence = self.evidence[target.label]
        if math.sqrt(0.5 * (target.covariance[0, 0] + target.covariance[1, 1])) >= self.config.located:
            return None
        known = vars(target) | self._located(target) | {"rate": evidence.returns}
        last = evidence.last_seen
        occluded = last < float(self.stamp or 0.0)
        return Person(**known, person=person, occluded=occluded, last_seen=last)

    def _newcomer(self, place: FloatArray, whose: IntArray, seen: ClusterScan) -> ClassEvidence:
        """What is known of a target before it is looked at: where it is (2,), and who it may be."""
        unseen = float(seen.kinds[whose, UNSEEN].max(initial=0.0))
        birth_class = float(seen.birth_class[whose].max(initial=0.0))
        before = self.identities.origin(place, unseen, birth_class, float(self.stamp or 0.0))
        return ClassEvidence(place.copy(), unseen, before, birth_class)

    def _person_alone(self, label: int) -> float:
        """Probability that a target is a person by its own looks; before it has shown any, of who it seems to be."""
        evidence, known = self.evidence[label], self.identities.people.get(self.identities.name(label).label)
        return evidence.own if known is None or evidence.looks > SHORT else known.person

    def _known_before(self, found: list[Target]) -> list[float]:
        """Log-odds (T,) from who each target may be that was known, but for those whom others are told of as."""
        told = {person.label for person in self._people()}
        names = [self.identities.name(target.label).label for target in found]
        told &= set(names)
        origins = [self.evidence[target.label].before for target in found]
        return [
            0.0 if origin is None else origin.log_odds(told - {name})
            for origin, name in zip(origins, names, strict=True)
        ]

    def _located(self, target: Target) -> dict[str, FloatArray]:
        """Mean and covariance of a target in the frame of the poses, with the error of the robot's own."""
        if self._uncertain is None or self._pose is None:
            return {}
        mean, P = state_through_uncertain_pose(
            target.mean, target.covariance, self._pose[:2], self._uncertain
        )
        return {"mean": shown(mean), "covariance": shown(P)}

    def _people(self) -> list[Person]:
        return [target for target in self.targets if target.person > self.config.report]


def _looks(seen: ClusterScan, dt: float) -> ReturnLooks:
    """What is known of the clusters of a scan, `dt` seconds after the last, beside their places."""
    return ReturnLooks(
        seen.log_clutter,
        seen.log_births + math.log(max(dt, 1e-3) / PERIOD),
        seen.birth_class,
        np.clip(seen.shape, -SHAPE, SHAPE),
        np.where(seen.widths > WIDE, EXACTER, 1.0),
    )


def _fit(spots: FloatArray, seen: ClusterScan) -> float:
    """Log-likelihood of targets at the places (T, 2), by how far the nearest cluster is from each."""
    gaps = np.linalg.norm(spots[:, None] - seen.places[None], axis=2).min(axis=1, initial=np.inf)
    return float(np.log(np.exp(-0.5 * (gaps / FOUND) ** 2) + UNFOUND).sum())


def _checked(
    scan: Scan, pose: npt.ArrayLike, stamp: float, labels: npt.ArrayLike | None
) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """The pose (3,), and which beams (N,) are known to move."""
    place = as_own("pose", pose, (3,))
    as_number("stamp", stamp)
    require_kind("scan", scan, Scan)
    beams = np.zeros(len(scan)) if labels is None else as_floats("labels", labels)
    if beams.shape != (len(scan),):
        raise InputError(f"labels must have shape ({len(scan)},), one per beam, not {beams.shape}")
    return place, np.asarray(beams > 0)


def _checked_covariance(pose_covariance: npt.ArrayLike) -> FloatArray:
    P = as_shape("pose_covariance", pose_covariance, (3, 3))
    return repair_covariance(P, "pose_covariance", definite=False)
