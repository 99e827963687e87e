"""Gaussian-mixture PHD filters: for extended targets (Paper B) and for point targets (Vo and Ma 2006).

A filter is put together from parts that can be replaced one by one: motion, measurement, detection, partitioner,
corrector, reducer, extractor.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_floats
from estimation.errors import InputError
from tracking.components import Components
from tracking.correction import Corrector
from tracking.partitioning import Partitioner, Singletons, make_partitioner
from tracking.partitions import PredictedTargets
from tracking.phd_config import PhdConfig
from tracking.phd_models import (
    ConstantDetection,
    ConstantVelocityMotion,
    Detection,
    Labels,
    OneReturn,
    PoissonCount,
    PositionMeasurement,
)
from tracking.reduction import Reducer
from tracking.target import Extractor, Target

# Label weight from which a target is expected to show: below extraction, so that a weak one can recover.
EXPECTED = 0.3


@dataclass
class PhdHealth:
    """What the filter has had to put up with since its creation; numbers that grow belong in diagnostics.

    dropped : returns that were NaN or infinite; thinned_scans : scans of more than `max_measurements` returns;
    thinned_partitions : groups with more partitions than `max_partitions`; late : scans skipped for their stamp;
    restarts : new runs; repaired : times covariances lost definiteness.
    """

    dropped: int = 0
    thinned_scans: int = 0
    thinned_partitions: int = 0
    late: int = 0
    restarts: int = 0
    repaired: int = 0


class ExtendedTargetPhd:
    """The extended-target GM-PHD filter of Paper B."""

    def __init__(self, config: PhdConfig | None = None, detection: Detection | None = None) -> None:
        """`detection` replaces the constant probability of the configuration."""
        self.config = config or PhdConfig()
        self.motion = ConstantVelocityMotion(self.config)
        self.measurement = PositionMeasurement(self.config)
        self.detection: Detection = detection or ConstantDetection(self.config)
        self.partitioner = self._partitioner()
        self.corrector = Corrector(self.config, self.measurement, self._returns())
        self.labels = Labels()
        self.reducer = Reducer(self.config, self.labels)
        self.extractor = Extractor(self.config)
        self.health = PhdHealth()
        self.components = Components.empty()
        self.stamp: float | None = None

    def _partitioner(self) -> Partitioner:
        return make_partitioner(self.config)

    def _returns(self) -> PoissonCount | OneReturn:
        return PoissonCount(self.config)

    @property
    def expected_count(self) -> float:
        """Expected number of targets: the integral of the intensity."""
        return float(self.components.weights.sum())

    def reset(self) -> None:
        """Forgets all targets; labels go on counting."""
        self.components = Components.empty()
        self.stamp = None

    def step(
        self, measurements: npt.ArrayLike, stamp: float, sensor_pose: npt.ArrayLike | None = None
    ) -> list[Target]:
        """Targets after the scan: returns (N, 2), m, taken at `stamp`, s, from `sensor_pose` (3,) x, y, yaw.

        Returns that are not finite are dropped and counted in `health`, as is all else that is wrong but can be
        lived with. A scan at most `late_window` late is skipped. Raises InputError for other shapes and stamps that
        are not finite.
        """
        points = self._points(measurements)
        pose = None if sensor_pose is None else as_finite("sensor_pose", sensor_pose)
        if pose is not None and pose.shape != (3,):
            raise InputError(f"sensor_pose must have shape (3,), not {pose.shape}")
        dt = self._interval(stamp)
        if dt is None:
            return self.extractor.extract(self.components)
        predicted = self.motion.predict(self.components, dt, self.labels)
        partitions = self.partitioner.partition(points, self._expected(predicted))
        corrected = self.corrector.correct(
            predicted, self.detection(predicted.means, pose), points, partitions
        )
        self.components = self.reducer.reduce(corrected)
        self.health.repaired = self.reducer.repaired
        self.health.thinned_partitions = self.partitioner.thinned
        return self.extractor.extract(self.components)

    def _points(self, measurements: npt.ArrayLike) -> FloatArray:
        """Finite returns, at most `max_measurements`."""
        points = as_floats("measurements", measurements)
        if points.size == 0:
            return np.zeros((0, 2))
        if points.ndim != 2 or points.shape[1] != 2:
            raise InputError(f"measurements must have shape (N, 2), not {points.shape}")
        finite = np.isfinite(points).all(1)
        self.health.dropped += int((~finite).sum())
        points = np.ascontiguousarray(points[finite])
        most = self.config.max_measurements
        if len(points) > most:
            self.health.thinned_scans += 1
            warnings.warn(f"{len(points)} returns in one scan; {most} of them are used", stacklevel=3)
            points = points[np.linspace(0, len(points) - 1, most).astype(int)]
        return points

    def _interval(self, stamp: float) -> float | None:
        """Seconds to predict over; None for a late scan."""
        stamp = float(stamp)
        if not np.isfinite(stamp):
            raise InputError(f"stamp must be finite, not {stamp!r}")
        if self.stamp is not None:
            dt = stamp - self.stamp
            if -self.config.late_window <= dt < 0:
                self.health.late += 1
                return None
            if 0 <= dt <= self.config.max_gap:
                self.stamp = stamp
                return dt
            self.health.restarts += 1
            self.reset()
        self.stamp = stamp
        # A first scan is one scan's worth of births after nothing.
        return self.config.scan_period

    def _expected(self, predicted: Components) -> PredictedTargets:
        """The heaviest component of every label worth expecting."""
        names, name = np.unique(predicted.labels, return_inverse=True)
        if len(names) == 0:
            return PredictedTargets.none()
        totals = np.bincount(name, predicted.weights)
        order = np.lexsort((-predicted.weights, name))
        best = order[np.unique(name[order], return_index=True)[1]][totals >= EXPECTED]
        H = self.measurement.H
        return PredictedTargets(predicted.means[best] @ H.T, H @ predicted.covariances[best] @ H.T)


class PointTargetPhd(ExtendedTargetPhd):
    """The GM-PHD filter of Vo and Ma (2006): at most one return per target. Same interface and configuration."""

    def _partitioner(self) -> Partitioner:
        return Singletons()

    def _returns(self) -> PoissonCount | OneReturn:
        return OneReturn()
