"""The mixture with the measurement model `clusters`: everything that stands free in laser scans, each with its class.

The core is `tracking.pmbm`, as for points. Which targets are people is a part of each target's state: a log-odds that a
learned model gives from all that was seen of it (`tracking.person_class`), no rule about speed, company or history.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite
from estimation.errors import InputError
from registration.scan import Scan
from tracking.background import Background
from tracking.cluster_model import ClusterScan, ScanDetection, StandingOrWalking
from tracking.people import PeopleHealth, Person
from tracking.people_config import PeopleConfig
from tracking.people_mask import OwnBody
from tracking.people_shape import shape_model
from tracking.people_sweep import Sweep
from tracking.person_class import ClassModel, Evidence, class_model
from tracking.phd_config import PhdConfig
from tracking.phd_models import Detection
from tracking.pmbm import PmbmRecursion
from tracking.target import Target

PERIOD = 0.1  # s, of a scan as the numbers below mean it
SIGMA = 0.14  # m from a leg to the middle between both
CLUSTERS = 1.5  # that a person gives on average, one leg hiding the other half of the time
ACCELERATION = 2.5  # m/s², constant over a scan: gait, and turns
BIRTHS, REACH = 0.02, 5.0  # new targets per scan, and deviation of where they come up about the scanner, m
SPEED = 0.7  # m/s, deviation of a new target's velocity
LIFE = 30.0  # s that somebody stays about on average
SEEN = 0.98  # probability of giving any cluster in plain view
LINK = 0.9995  # quantile of the distance of two legs up to which they are searched together
HYPOTHESES, MARGIN = 5, 5.0  # per group of targets, and how far below the likeliest, nat; set for speed
BELONGS = 0.45  # m from a target to the clusters that tell its class
WELL_LOCATED = 1.0  # m, deviation beyond which somebody hidden is no longer told of
# Two targets whose way from one to the other is on average shorter than that, m, over that many seconds are the legs of
# one: legs pass each other, people do not. Set on people who walk among pillars, seed 500.
LEGS, STRIDES = 0.3, 1.0
NEIGHBOURS = 1.0  # m between the legs of one person at most


class ClusterTracker:
    """The interface of `PeopleTracker`."""

    def __init__(self, config: PeopleConfig | None = None, classes: ClassModel | None = None) -> None:
        """Of the settings, the ranges, how returns are joined and `report` count; `classes` instead of the shipped."""
        self.config = config or PeopleConfig()
        self.shape, self.classes = shape_model(), classes or class_model()
        self.health = PeopleHealth()
        self._phd = PhdConfig(
            surveillance=((-REACH, REACH), (-REACH, REACH)),
            clutter_rate=1.0,
            detection_probability=SEEN,
            survival_probability=math.exp(-PERIOD / LIFE),
            measurement_noise=SIGMA,
            process_noise=ACCELERATION,
            measurement_rate=CLUSTERS,
            births=[],
            spawn=None,
            scan_period=PERIOD,
            distance_probabilities=(0.3, LINK),
            max_hypotheses=HYPOTHESES,
            hypothesis_margin=MARGIN,
        )
        self._sight = ScanDetection(SEEN, self.config.max_range)
        detection: Detection = self._sight
        self.recursion = PmbmRecursion(self._phd, detection)
        self.recursion.motion = StandingOrWalking(self._phd)
        self.reset()

    def reset(self) -> None:
        """Forgets all targets and the surroundings; labels go on counting."""
        self.recursion.reset()
        self.background = Background()
        self.evidence: dict[int, Evidence] = {}
        self.targets: list[Target] = []
        self._between: dict[tuple[int, int], tuple[float, FloatArray]] = {}
        self._own = OwnBody()
        self.stamp: float | None = None
        self._pose: FloatArray | None = None

    @property
    def expected_count(self) -> float:
        """Expected number of people."""
        return float(sum(t.weight * t.person for t in self.targets if isinstance(t, Person)))

    def step(
        self,
        scan: Scan,
        pose: npt.ArrayLike,
        stamp: float,
        labels: npt.ArrayLike | None = None,
        pose_covariance: npt.ArrayLike | None = None,
        pose_known: bool = True,
    ) -> list[Target]:
        """People after a scan, as `PeopleTracker.step`; labels, covariance and doubt of the pose are not used.

        pose : (3,) x, y, yaw of the scanner, m and rad; targets are in its frame. stamp : seconds. A scan that is late
        changes nothing. Raises InputError for other shapes and for a pose or stamp that is not finite.
        """
        place = as_finite("pose", pose)
        if place.shape != (3,):
            raise InputError(f"pose must have shape (3,), not {place.shape}")
        if not np.isfinite(stamp):
            raise InputError(f"stamp must be finite, not {stamp!r}")
        last = self.stamp
        if last is not None and -self.config.late_window <= stamp - last < 0.0:
            self.health.late += 1
            return self._people()
        if last is not None and not 0.0 <= stamp - last <= self.config.max_gap:
            self.health.restarts += 1
            self.reset()
            last = None
        dt = PERIOD if last is None else stamp - last
        sweep = Sweep.of(scan, place, self._pose, dt)
        own = self._own.mask(scan, place)
        join, reach = self.config.join_distance, self.config.max_range
        seen = ClusterScan.of(scan, sweep, self.background, self.shape, join, reach, own)
        self._sight.scan = scan
        spread = np.diag([REACH**2, REACH**2, SPEED**2, SPEED**2])
        self._phd.births = [(BIRTHS, np.array([*place[:2], 0.0, 0.0]), spread)]
        self.recursion.update(seen.places, dt, place, seen.log_clutter)
        self.stamp, self._pose = float(stamp), place
        found = self.recursion.targets()
        gone = self._unite(found, dt)
        self._classify([target for target in found if target.label not in gone], seen, place, dt)
        # What is followed as a target is no clutter, whatever its class.
        mine = np.zeros(len(seen.clusters) + 1, dtype=bool)
        mine[seen.index[self._of_targets(seen)]] = True
        self.background.add(sweep, stamp, own | mine[seen.clusters.labels])
        self.health.potential = len(self.targets)
        return self._people()

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
            tracks, public = self.recursion.hypotheses.tracks, self.recursion.extractor.labels.public
            inner = {name: label for label, name in public.items()}
            tracks.weights = np.where(
                np.isin(tracks.labels, [inner[name] for name in gone]), 0.0, tracks.weights
            )
            for name, way in moved.items():
                tracks.means[tracks.labels == inner[name]] += way
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
        for t, target in enumerate(found):
            evidence = self.evidence.setdefault(target.label, Evidence(target.mean[:2].copy()))
            whose = np.flatnonzero((nearest == t) & (gaps[t] < BELONGS))
            around = int(((gaps[t] < 1.5) & (nearest != t)).sum())
            evidence.look(seen, whose, target, pose, around, dt, stamp)
        present = {target.label for target in found}
        self.evidence = {label: item for label, item in self.evidence.items() if label in present}
        odds = self.classes.odds([self.evidence[target.label].features(target) for target in found])
        self.targets = []
        for target, value in zip(found, odds.tolist(), strict=True):
            last = self.evidence[target.label].last_seen
            deviation = math.sqrt(0.5 * (target.covariance[0, 0] + target.covariance[1, 1]))
            if deviation < WELL_LOCATED:
                person = 1.0 / (1.0 + math.exp(-min(max(value, -30.0), 30.0)))
                self.targets.append(
                    Person(**vars(target), person=person, occluded=last < stamp, last_seen=last)
                )

    def _people(self) -> list[Target]:
        return [t for t in self.targets if isinstance(t, Person) and t.person > self.config.report]
