"""Where targets can be seen: p_D from what stands nearer to the sensor, walls, range and field of view (Section 5.3).

The text lowers p_D behind a target by its weight and bearing spread. Here a target's returns are spread over its own
bearings; what of them nearer bodies cover is not returned. The expected visible share thins its rate, and p_D is the
chance of any return at all, averaged over how uncertain its bearing is: smooth in all positions, 1 in the open. A
target that gives no return is rather where it cannot be seen, and its state is corrected by that.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite
from estimation.errors import InputError
from tracking.mixture.components import Components
from tracking.mixture.phd_config import PhdConfig
from tracking.mixture.phd_models import Sight
from tracking.mixture.visibility_kernels import PlacedBodies, Returns, SightSensor, visible

# Others of less weight hide nothing.
LEAST = 0.05
# The text's p_D is a probability behind any number of targets; 0 would let nothing be found again.
LEAST_DETECTION = 0.01


class OcclusionDetection:
    """p_D and visible share of every component, from the pose of the sensor."""

    def __init__(self, config: PhdConfig, walls: npt.ArrayLike | None = None) -> None:
        """walls (M, 2, 2) : segments nothing is seen behind, m, in the frame of the measurements. Raises InputError."""
        self.config = config
        self.walls = np.zeros((0, 2, 2)) if walls is None else as_finite("walls", walls)
        if self.walls.ndim != 3 or self.walls.shape[1:] != (2, 2):
            raise InputError(f"walls must have shape (M, 2, 2), not {self.walls.shape}")

    def __call__(self, means: FloatArray, sensor_pose: FloatArray | None) -> FloatArray:
        """Probabilities (J,) for means (J, 4) with nothing in between."""
        return np.full(len(means), self.config.detection_probability)

    def in_scene(
        self, components: Components, weights: FloatArray, tracks: int, sensor_pose: FloatArray | None
    ) -> Sight:
        """What can be seen of the components, and where they are if they are not.

        The first `tracks` components are targets that hide others, by `weights` (tracks,); those of one label are
        one target. Without a pose nothing is hidden.
        """
        p = np.full(len(components), self.config.detection_probability)
        if sensor_pose is None or len(components) == 0:
            return Sight.plain(p, components)
        hiding, totals = _heaviest(components.labels[:tracks], weights)
        extents = components.spread / np.maximum(components.freedom, 1e-6)[:, None, None]
        labels = components.labels.copy()
        # What is not a target yet has a label of no other's.
        labels[tracks:] = -1
        config = self.config
        means, P = components.means[:, :2], components.covariances[:, :2, :2]
        targets = PlacedBodies(means.copy(), P.copy(), extents, labels, components.weights)
        others = PlacedBodies(means[hiding], P[hiding], extents[hiding], labels[hiding], totals)
        sensor = SightSensor(sensor_pose, self.walls, float(config.sensor_range), float(config.field_of_view))
        # A PHD filter's count jumps the more the lower p_D is.
        returns = Returns(
            float(config.occluder_width),
            float(config.measurement_rate),
            float(config.detection_probability),
            config.filter == "mixture",
        )
        chance, share, unseen = visible(targets, others, sensor, returns)
        means, covariances = _moved(components, sensor_pose, unseen)
        return Sight(p * chance, share, means, covariances, p * chance)


class BearingDetection:
    """p_D as the text describes it: lower at larger range, by weight and bearing deviation (Section 5.3, Figure 4f).

    Each component i takes w_i (b_i / s_i) exp(-½ (φ - φ_i)² / s_i²) off p_D behind it, s_i² = b_i² + its variance of
    bearing. The text omits its expression; b_i makes the shadow of a well-known target half as deep at the edge of a
    body `occluder_width` standard deviations of its returns wide to either side. Neither rate nor state is changed.
    """

    def __init__(self, config: PhdConfig) -> None:
        self.config = config
        self.half = config.occluder_width * config.measurement_noise / np.sqrt(2.0 * np.log(2.0))

    def __call__(self, means: FloatArray, sensor_pose: FloatArray | None) -> FloatArray:
        """Probabilities (J,) for means (J, 4) with nothing in between."""
        return np.full(len(means), self.config.detection_probability)

    def in_scene(
        self, components: Components, weights: FloatArray, tracks: int, sensor_pose: FloatArray | None
    ) -> Sight:
        """p_D (J,) of the components behind the first `tracks`, which have `weights` (tracks,)."""
        p = self(components.means, sensor_pose)
        if sensor_pose is None or len(components) == 0:
            return Sight.plain(p, components)
        x, y = (components.means[:, :2] - sensor_pose[:2]).T
        ranges, bearings = np.maximum(np.hypot(x, y), 1e-9), np.arctan2(y, x)
        P = components.covariances
        across = (y * y * P[:, 0, 0] - 2.0 * x * y * P[:, 0, 1] + x * x * P[:, 1, 1]) / ranges**4
        hiding = np.flatnonzero(weights > LEAST)
        body = self.half / ranges[hiding]
        deviation = np.sqrt(body**2 + np.maximum(across[hiding], 0.0))
        turn = (bearings[:, None] - bearings[hiding] + np.pi) % (2.0 * np.pi) - np.pi
        depth = weights[hiding] * body / deviation * np.exp(-0.5 * (turn / deviation) ** 2)
        # What is nearer behind than two bodies can be is the same target: it would never be missed, and pile up.
        behind = ranges[:, None] > ranges[hiding] + 2.0 * self.half
        return Sight.plain(np.maximum(p - (depth * behind).sum(1), LEAST_DETECTION), components)


def _moved(
    components: Components, sensor_pose: FloatArray, unseen: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Means (J, 4) and covariances (J, 4, 4) with the position across the line of sight as in `unseen` (J, 2)."""
    offsets = components.means[:, :2] - sensor_pose[:2]
    left = np.column_stack([-offsets[:, 1], offsets[:, 0]])
    left /= np.maximum(np.linalg.norm(left, axis=1, keepdims=True), 1e-9)
    P = components.covariances
    reach = (P[:, :, :2] @ left[:, :, None])[:, :, 0]
    variance = np.maximum((reach[:, :2] * left).sum(1), 1e-18)
    gain = reach / variance[:, None]
    less = np.clip(variance - unseen[:, 1], 0.0, variance)
    return (
        components.means + gain * unseen[:, :1],
        P - less[:, None, None] * gain[:, :, None] * gain[:, None, :],
    )


def _heaviest(labels: npt.NDArray[np.int64], weights: FloatArray) -> tuple[npt.NDArray[np.int64], FloatArray]:
    """The heaviest component of every label, and the label's total weight where that is not negligible."""
    names, name = np.unique(labels, return_inverse=True)
    totals: FloatArray = np.bincount(name, weights, len(names)).astype(np.float64)
    order = np.lexsort((-weights, name))
    first = order[np.unique(name[order], return_index=True)[1]]
    keep = totals > LEAST
    return first[keep], totals[keep]
