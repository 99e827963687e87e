"""Odometry: follows one sensor from scan to scan or cloud to cloud (sections 2.5 and 4.3 of Paper A).

One object follows one sensor and takes either planar scans or spatial clouds, never both. Poses are those
of the sensor relative to where it stood at the first call.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from estimation.checks import FloatArray, as_floats, as_stamp
from estimation.errors import InputError
from registration.laser.own_body import OwnBody
from registration.laser.scan import Scan
from registration.odometry.kiss import KissTracker
from registration.odometry.odometry_config import OdometryConfig
from registration.odometry.odometry_step import Step, accumulate, matrix_to_planar, planar_to_matrix
from registration.odometry.scan_odometry import ScanTracker
from registration.placement.align import as_guess


class Odometry:
    """Pose of a moving range sensor from its scans or clouds.

    Attributes (after a call of `register`)
    ----------
    pose : (3,) x, y, yaw for scans, (4, 4) for clouds; of the sensor, from where it stood at the first call.
    covariance : (3, 3) | (6, 6) of `pose`, accumulated since the first call. Consecutive increments share the noise
        of the scan between them, so this grows less than the sum of `increment_covariance`.
    increment : motion since the previous call, in the previous sensor frame; same form as `pose`.
    increment_covariance : (3, 3) | (6, 6) of `increment`.
    converged : False where `pose` was only predicted or contradicts the data; unsure : its opposite.
    reason : one sentence saying why it is unsure, empty otherwise.
    fitness : 0 to 1, share of the points that agree with the map.
    static_points : (M, 2 | 3) metres, points of the last scan judged static, sensor frame.

    Covariances of spatial poses are of (x, y, z, rotation about x, y, z) in the frame of the pose.
    """

    def __init__(self, config: OdometryConfig | None = None) -> None:
        self.config = config or OdometryConfig()
        self.reset()

    def reset(self) -> None:
        """Forget map, pose and the kind of data: the next call starts a new run."""
        self._scans = ScanTracker(self.config)
        self._clouds: KissTracker | None = None
        self._planar: bool | None = None  # the kind of data, once there was some
        self._own = OwnBody()
        self.pose: FloatArray = np.zeros(3)
        self.covariance: FloatArray = np.zeros((3, 3))
        self._lasting: FloatArray = np.zeros((3, 3))
        self._take(Step(np.zeros(3), np.zeros((3, 3)), True, "", 1.0, np.zeros((0, 2))))

    @property
    def unsure(self) -> bool:
        return not self.converged

    def register(
        self,
        scan_or_cloud: Scan | ArrayLike,
        stamp: float,
        guess: ArrayLike | None = None,
        times: ArrayLike | None = None,
        sweep: ArrayLike | None = None,
    ) -> FloatArray:
        """Register the next scan or cloud and return the sensor's pose.

        Parameters
        ----------
        scan_or_cloud : `Scan`, or cloud (N, 3) metres; points that are not finite are dropped.
        stamp : seconds, time of the measurement.
        guess : motion since the previous call from elsewhere (wheels), in the previous sensor frame,
            (3,) for scans and (4, 4) for clouds; without it the sensor is taken to go on as before.
        times : (N,) seconds of each cloud point relative to the first, to undo the motion during the sweep.
        sweep : (3,) motion of a scanner from its first beam to its last, as `guess`; without it, it is taken to have
            gone on in the sweep as it did before.

        Returns
        -------
        (3,) x, y, yaw for a scan, (4, 4) for a cloud. A scan too poor to register yields the predicted pose;
        `converged` and `reason` say so.

        Raises
        ------
        InputError : wrong shape, guess not finite, or a change between scans and clouds without `reset`.
        """
        planar = isinstance(scan_or_cloud, Scan)
        shape = (3,) if planar else (4, 4)
        motion = None if guess is None else as_guess(guess, shape, np.zeros(shape))
        stamp = as_stamp("stamp", stamp)
        if isinstance(scan_or_cloud, Scan) and self.config.scan_method == "local_map":
            within = None if sweep is None else as_guess(sweep, shape, np.zeros(shape))
            self._go_on_with(planar)
            scan = self._own.without(scan_or_cloud, self.pose)
            step = self._scans.step(scan, stamp, motion, within)
        else:
            step = self._by_kiss(scan_or_cloud, motion, times)
        self._take(step)
        self.pose, self._lasting = accumulate(self.pose, self._lasting, step)
        for array in (self.pose, self._lasting):
            array.flags.writeable = False  # the next pose follows from it
        self.covariance = self._lasting if step.noise is None else self._lasting + step.noise
        return self.pose.copy()

    def _by_kiss(
        self, measurement: Scan | ArrayLike, motion: FloatArray | None, times: ArrayLike | None
    ) -> Step:
        planar = isinstance(measurement, Scan)
        cloud, phases = _as_cloud(measurement, times)
        self._go_on_with(planar)
        if self._clouds is None:
            config = self.config
            voxel_size = config.scan_voxel_size if planar else config.cloud_voxel_size
            self._clouds = KissTracker(
                config.max_range, voxel_size, config.cloud_noise, config.static_distance
            )
        if not planar:
            return self._clouds.step(cloud, motion, phases)
        lifted = None if motion is None else planar_to_matrix(motion)
        return _in_plane(self._clouds.step(cloud, lifted, phases))

    def _go_on_with(self, planar: bool) -> None:
        """The next measurement is a scan, or a cloud."""
        if self._planar is None and not planar:
            self.pose, self._lasting = np.eye(4), np.zeros((6, 6))
        if self._planar not in (None, planar):
            raise InputError("scan_or_cloud: scans and clouds cannot be mixed; call reset() first")
        self._planar = planar

    def _take(self, step: Step) -> None:
        self.increment = step.increment
        self.increment_covariance = step.covariance
        self.converged, self.reason = step.converged, step.reason
        self.fitness = step.fitness
        self.static_points = step.static_points


def _as_cloud(measurement: Scan | ArrayLike, times: ArrayLike | None) -> tuple[FloatArray, FloatArray | None]:
    """Finite points (N, 3) and, where known, their phase in [0, 1] of the sweep."""
    if isinstance(measurement, Scan):
        flat = measurement.points()
        phase = None
        if measurement.time_increment > 0.0 and len(measurement) > 1:
            phase = (np.arange(len(measurement)) / (len(measurement) - 1))[measurement.valid]
        return np.column_stack((flat, np.zeros(len(flat)))), phase
    cloud = as_floats("scan_or_cloud", measurement)
    if cloud.ndim != 2 or cloud.shape[1] != 3:
        raise InputError(f"scan_or_cloud: Scan or array (N, 3) expected, got shape {cloud.shape}")
    # The sum of a row is finite where all of it is, and takes a tenth of the time to test.
    finite = np.isfinite(cloud @ np.ones(3))
    if times is None:
        return cloud[finite], None
    seconds = as_floats("times", times)
    if seconds.shape != (len(cloud),):
        raise InputError(f"times: one per point, ({len(cloud)},) expected, got shape {seconds.shape}")
    finite &= np.isfinite(seconds)
    seconds = seconds[finite]
    span = np.ptp(seconds) if len(seconds) else 0.0
    return cloud[finite], (seconds - seconds.min()) / span if span > 0.0 else None


def _in_plane(step: Step) -> Step:
    """A step of KISS-ICP on a scan lifted to z = 0, back in the plane."""
    keep = np.ix_([0, 1, 5], [0, 1, 5])
    drift, noise = (None if part is None else part[keep] for part in (step.drift, step.noise))
    return Step(
        matrix_to_planar(step.increment),
        step.covariance[keep],
        step.converged,
        step.reason,
        step.fitness,
        step.static_points[:, :2],
        drift,
        noise,
    )
