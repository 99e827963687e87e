"""Trackers of extended targets (Paper B and beyond) and of point targets (Vo and Ma 2006).

One interface over two recursions: the text's Gaussian-mixture PHD filter, and a Poisson multi-Bernoulli mixture.
"""

from __future__ import annotations

import bisect
import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_floats, as_number, as_own, require_kind
from estimation.errors import InputError
from tracking.mixture.detection import BearingDetection, OcclusionDetection
from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.phd_models import ConstantDetection, Detection
from tracking.mixture.pmbm import PmbmRecursion
from tracking.mixture.target import Target
from tracking.phd.phd_recursion import PhdRecursion

FARTHEST = 1e12  # m; of places beyond, squares overflow and differences are rounded away


@dataclass
class PhdHealth:
    """What the filter has had to put up with since its creation; numbers that grow belong in diagnostics.

    dropped : returns that were NaN, infinite or beyond `FARTHEST`; thinned_scans : scans of more than
    `max_measurements` returns; thinned_partitions : groups of returns with more partitions, or structures, than are
    weighed; late : scans that came late and were worked in; skipped : scans that came too late for that; restarts : new
    runs; repaired : times covariances lost definiteness.
    """

    dropped: int = 0
    thinned_scans: int = 0
    thinned_partitions: int = 0
    late: int = 0
    skipped: int = 0
    restarts: int = 0
    repaired: int = 0


@dataclass
class _Scan:
    """A scan that may have to be taken up again, and the filter's state after it."""

    stamp: float
    points: FloatArray
    pose: FloatArray | None
    state: Any


class ExtendedTargetPhd:
    """Follows targets that give any number of returns per scan.

    `PhdConfig.filter` chooses the recursion: "mixture" (the default: on `extended_targets` it is better in everything
    measured), "phd", the ET-GM-PHD filter of Paper B, or "gmphd", Vo and Ma's for one return per target.
    """

    def __init__(self, config: PhdConfig | None = None, detection: Detection | None = None) -> None:
        """`detection` replaces p_D as configured: constant, and lower behind other targets where poses are given."""
        self.config = PhdConfig() if config is None else config
        require_kind("config", self.config, PhdConfig)
        self.detection: Detection = detection or self._detection()
        self.recursion = self._recursion()
        self.health = PhdHealth()
        self.stamp: float | None = None
        self._scans: list[_Scan] = []

    def _detection(self) -> Detection:
        if not self.config.occlusion:
            return ConstantDetection(self.config)
        if self.config.occluders == "bearings":
            return BearingDetection(self.config)
        return OcclusionDetection(self.config)

    def _recursion(self) -> PhdRecursion | PmbmRecursion:
        if self.config.filter == "mixture":
            return PmbmRecursion(self.config, self.detection)
        return PhdRecursion(self.config, self.detection, points=self.config.filter == "gmphd")

    @property
    def expected_count(self) -> float:
        """Expected number of targets, those not yet seen included."""
        return self.recursion.expected_count

    def reset(self) -> None:
        """Forgets all targets; labels go on counting."""
        self.recursion.reset()
        self.stamp = None
        self._scans.clear()

    def step(
        self, measurements: npt.ArrayLike, stamp: float, sensor_pose: npt.ArrayLike | None = None
    ) -> list[Target]:
        """Targets after the scan: returns (N, 2), m, taken at `stamp`, s, from `sensor_pose` (3,) x, y, yaw.

        Returns that are not finite or beyond `FARTHEST` are dropped and counted in `health`, as is all else that is
        wrong but can be lived with. A scan at most `late_window` late is worked in where it belongs and the later ones
        are taken up again; what is returned is always the state at the newest stamp. A stamp further back is a new run.
        Raises InputError for other shapes and stamps that are not finite.
        """
        points = self._points(measurements)
        pose = None if sensor_pose is None else as_own("sensor_pose", sensor_pose, (3,))
        stamp = as_number("stamp", stamp)
        if self.stamp is not None and -self.config.late_window <= stamp - self.stamp < 0:
            self._late(stamp, points, pose)
        else:
            if self.stamp is not None and not 0 <= stamp - self.stamp <= self.config.max_gap:
                self.health.restarts += 1
                self.reset()
            self._take(stamp, points, pose)
        self.health.repaired = self.recursion.repaired
        self.health.thinned_partitions = self.recursion.thinned
        return self.recursion.targets()

    def _take(self, stamp: float, points: FloatArray, pose: FloatArray | None) -> None:
        """The scan that follows the last."""
        # A first scan is one scan's worth of births after nothing.
        dt = self.config.scan_period if self.stamp is None else stamp - self.stamp
        self.recursion.update(points, dt, pose)
        self.stamp = stamp
        state = self.recursion.state(), self.recursion.extractor.state()
        self._scans.append(_Scan(stamp, points, pose, state))
        oldest = max(len(self._scans) - 1 - self.config.late_scans, 0)
        while self._scans[oldest].stamp < stamp - self.config.late_window and oldest < len(self._scans) - 1:
            oldest += 1
        # One before the window stays, to start from.
        del self._scans[: max(oldest - 1, 0)]

    def _late(self, stamp: float, points: FloatArray, pose: FloatArray | None) -> None:
        """Goes back to before the late scan and takes up the later ones again."""
        index = bisect.bisect_right([scan.stamp for scan in self._scans], stamp)
        if index == 0:
            self.health.skipped += 1
            return
        self.health.late += 1
        again = self._scans[index:]
        del self._scans[index:]
        state, labels = self._scans[-1].state
        self.recursion.restore(state)
        self.recursion.extractor.restore(labels)
        self.stamp = self._scans[-1].stamp
        self._take(stamp, points, pose)
        for scan in again:
            self.recursion.targets()  # numbers are given in the order of first report
            self._take(scan.stamp, scan.points, scan.pose)

    def _points(self, measurements: npt.ArrayLike) -> FloatArray:
        """Returns that are numbers within `FARTHEST`, at most `max_measurements`."""
        points = as_floats("measurements", measurements)
        if points.size == 0:
            return np.zeros((0, 2))
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"measurements must have shape (N, 2), not {points.shape}")
        finite = (np.abs(points) < FARTHEST).all(1)
        self.health.dropped += int((~finite).sum())
        points = np.ascontiguousarray(points[finite])
        most = self.config.max_measurements
        if len(points) > most:
            self.health.thinned_scans += 1
            warnings.warn(f"{len(points)} returns in one scan; {most} of them are used", stacklevel=3)
            points = points[np.linspace(0, len(points) - 1, most).astype(int)]
        return points


class PointTargetPhd(ExtendedTargetPhd):
    """The GM-PHD filter of Vo and Ma (2006): at most one return per target. Same interface and configuration."""

    def _recursion(self) -> PhdRecursion | PmbmRecursion:
        return PhdRecursion(self.config, self.detection, points=True)
