"""The extended-target filters on laser scans: the measurement model `points`, and which tracker a name stands for.

Returns of what is narrow and has not always stood there are the measurements of Paper B, in the frame of the poses.
The values are those of its experiments (Table 1). Its places of birth, which it only draws, are spread over what the
scanner looks at. These filters know no classes: whatever stands free or moves is told of.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_number, as_own, require_kind
from estimation.errors import InputError
from registration.laser.scan import Scan
from tracking.mixture.phd_config import FILTERS, Birth, PhdConfig
from tracking.mixture.target import Target
from tracking.people.cluster_model import WIDEST
from tracking.people.free_space import DELAY, Background
from tracking.people.legs import clusters_of
from tracking.people.people_config import PeopleConfig
from tracking.people.people_sweep import Sweep
from tracking.people.people_tracker import PeopleHealth, PeopleTracker, Person
from tracking.phd.filters import ExtendedTargetPhd

# Table 1, experiments: T, σ of a return and of the acceleration, γ; weight and covariance of a target that splits off.
PERIOD, NOISE, ACCELERATION, RATE = 0.2, 0.1, 2.0, 12.0
SPAWN = 0.01, 0.01 * np.eye(4)
# Places of birth in half a turn and their weight in all, m and m/s of their deviations: Section 5.1, Figure 2.
PLACES, WEIGHT = 7, 0.1
SPREAD, SPEED = 1.5, 1.0
# Expected clutter returns of a scan; the text does not say. Set on its laser scene, where it is 1, and a margin.
CLUTTER = 2.0
STOOD = 0.5  # how surely something always stood where a return is that is no target's


class PointsTracker:
    """The interface of `PeopleTracker` over a filter of Paper B ("phd") or of Vo and Ma ("gmphd").

    The latter is given the middle of each cluster of returns, as its targets give one return each.
    """

    def __init__(self, name: str, config: PeopleConfig | None = None) -> None:
        """name : "phd" or "gmphd"; of the settings only the range and how returns are joined count."""
        if name not in FILTERS or name == "mixture":
            raise InputError(f"filter must be phd or gmphd, not {name!r}")
        self.config = PeopleConfig() if config is None else config
        require_kind("config", self.config, PeopleConfig)
        reach = self.config.max_range
        self.filter = ExtendedTargetPhd(
            PhdConfig.as_printed(
                filter=name,
                surveillance=((-reach, reach), (-reach, reach)),
                clutter_rate=CLUTTER,
                measurement_noise=NOISE,
                process_noise=ACCELERATION,
                measurement_rate=RATE if name == "phd" else 1.0,
                births=[],
                spawn=SPAWN,
                scan_period=PERIOD,
                sensor_range=reach,
                late_window=0.0,
                max_gap=self.config.max_gap,
            )
        )
        self._points = name == "gmphd"
        self.health = PeopleHealth()
        self.reset()

    def reset(self) -> None:
        """Forgets all targets and the surroundings; labels go on counting."""
        self.filter.reset()
        self.background = Background()
        self.targets: list[Target] = []
        self._stamp: float | None = None
        self._began: float | None = None
        self._pose: FloatArray | None = None

    @property
    def expected_count(self) -> float:
        """The integral of the intensity."""
        return self.filter.expected_count

    def step(
        self,
        scan: Scan,
        pose: npt.ArrayLike,
        stamp: float,
        labels: npt.ArrayLike | None = None,
        pose_covariance: npt.ArrayLike | None = None,
        pose_known: bool = True,
    ) -> list[Target]:
        """Targets after a scan, as `PeopleTracker.step`; what else that takes is not used.

        pose : (3,) x, y, yaw of the scanner, m and rad; targets are in its frame. stamp : seconds. A scan that is late
        changes nothing. Raises InputError for other shapes and for a pose or stamp that is not finite.
        """
        place, stamp = as_own("pose", pose, (3,)), as_number("stamp", stamp)
        require_kind("scan", scan, Scan)
        last = self._stamp
        if last is not None and -self.config.late_window <= stamp - last < 0.0:
            self.health.late += 1
            return list(self.targets)
        if last is not None and not 0.0 <= stamp - last <= self.config.max_gap:
            self.health.restarts += 1
            self.reset()
            last = None
        sweep = Sweep.of(scan, place, self._pose, PERIOD if last is None else stamp - last)
        points = self._measurements(scan, sweep)
        self._began = stamp if self._began is None else self._began
        self.background.add(sweep, stamp, self._of_targets(sweep))
        self._stamp, self._pose = float(stamp), place
        if stamp - self._began <= DELAY:
            # Until a scan has become background, all that stands would be a target.
            points = np.zeros((0, 2))
        self.filter.config.births = self._births(scan, place)
        self.targets = [
            Person(**vars(target), person=0.5, last_seen=self._stamp)
            for target in self.filter.step(points, self._stamp, place)
        ]
        self.health.potential = len(self.targets)
        self.health.thinned = self.filter.health.thinned_scans
        return list(self.targets)

    def _measurements(self, scan: Scan, sweep: Sweep) -> FloatArray:
        """Returns (N, 2), or middles of clusters, m in the frame of the poses."""
        clusters = clusters_of(scan, self.config.join_distance, self.config.max_range)
        narrow = np.append(clusters.widths < WIDEST, False)[clusters.labels]
        points = sweep.points(narrow)
        _, old, _ = self.background.evidence(points, scan.ranges[narrow])
        free, names = points[old < STOOD], clusters.labels[narrow][old < STOOD]
        if not self._points or not len(free):
            return free
        return np.array([free[names == name].mean(0) for name in np.unique(names)])

    def _of_targets(self, sweep: Sweep) -> npt.NDArray[np.bool_]:
        """Beams (N,) that hit a target told of; it does not become background while it stands."""
        spots = np.array([target.mean[:2] for target in self.targets]).reshape(-1, 2)
        seen = np.isfinite(sweep.ranges)
        hit = np.zeros(len(seen), dtype=bool)
        gaps = np.linalg.norm(sweep.points(seen)[:, None] - spots[None], axis=2)
        hit[seen] = gaps.min(axis=1, initial=np.inf) < self.filter.config.occluder_width * NOISE
        return hit

    def _births(self, scan: Scan, pose: FloatArray) -> list[Birth]:
        """Places of birth over what the scanner looks at, a nearer and a farther ring, in the frame of the poses."""
        opening = min(abs(scan.angle_increment) * len(scan), 2.0 * np.pi)
        count = max(round(PLACES * opening / np.pi), 2)
        middle = pose[2] + scan.angle_min + 0.5 * scan.angle_increment * len(scan)
        turns = middle + opening * ((np.arange(count) + 0.5) / count - 0.5)
        away = self.config.max_range * np.where(np.arange(count) % 2, 0.35, 0.75)
        places = pose[:2] + away[:, None] * np.column_stack((np.cos(turns), np.sin(turns)))
        covariance = np.diag([SPREAD**2, SPREAD**2, SPEED**2, SPEED**2])
        return [(WEIGHT / count, np.array([*place, 0.0, 0.0]), covariance) for place in places]


def tracker_of(name: str = "mixture", config: PeopleConfig | None = None) -> PeopleTracker | PointsTracker:
    """The tracker of a name: "mixture", "phd" or "gmphd"; raises InputError for another."""
    if name not in FILTERS:
        raise InputError(f"filter must be one of {FILTERS}, not {name!r}")
    return PeopleTracker(config) if name == "mixture" else PointsTracker(name, config)
