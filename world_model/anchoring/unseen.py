"""How many objects nobody has seen yet, by place: what a first detection is weighed with (new against clutter).

New objects form a Poisson process in time and space. Where the sensor looks it finds them, so that few are left
undetected; where it has not looked for long more may have appeared. Cells over the region in x and y.

How many there are at first, and how often new ones come, is learned: what is configured is what each is expected to be
before anything was seen, a Gamma distribution of shape 1.
"""

from __future__ import annotations

import numba
import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.attributes import Quantities
from world_model.anchoring.loops.kernels import clearance
from world_model.camera.camera_view import CameraView
from world_model.config import WorldModelConfig
from world_model.evidence import SensorCone

BLOCK = 4  # cells along which one look at what hides things is enough
MOST_BLOCKS = 96
SMALLEST_CELL = 0.0625  # m: a sensor that turns sees little more of what is beside it from look to look
RETURN_SECONDS = 10.0  # Mean time for which a carried object is out of sight
PADDING = 0.5  # m beyond the detections so far: what the detector may report
HEIGHTS = 3  # at which a camera's view of a cell is sampled
ENOUGH = 50  # detections that show where a detector reports anything at all
_STEPS, _WEIGHTS = np.polynomial.hermite_e.hermegauss(5)
AROUND = np.stack(np.meshgrid(_STEPS, _STEPS, indexing="ij"), -1).reshape(-1, 2)
WEIGHTS = np.outer(_WEIGHTS, _WEIGHTS).ravel()
"""Deviations in x and y at which a Gaussian is averaged, and what each counts."""
# What a place out of view counts beside those in view: where a detector sees more than was said.
OUT_OF_VIEW = 1e-6


class Unseen:
    """Expected undetected objects per cell (2, nx, ny), of those from the beginning and of those that came later, as
    configured, and how probably something that is carried about and is in a cell has come there unseen (nx, ny).

    found, exposure (2,) : how many were found of each kind, and how many should have been as configured.
    """

    def __init__(self, config: WorldModelConfig) -> None:
        self.region = np.array(config.region, dtype=float)
        self.config = config
        extent = self.region[:2, 1] - self.region[:2, 0]
        counts = BLOCK * np.clip((extent / (BLOCK * SMALLEST_CELL)).astype(int), 1, MOST_BLOCKS)
        self.size = extent / counts
        xs, ys = (
            low + (np.arange(n) + 0.5) * s
            for low, n, s in zip(self.region[:2, 0], counts, self.size, strict=True)
        )
        self._small = Quantities(config.quantities).small("size")
        self.centres = np.stack(np.meshgrid(xs, ys, indexing="ij"), -1)
        self.reset()

    def reset(self) -> None:
        """As before the first look."""
        shape = self.centres.shape[:2]
        self.expected: FloatArray = np.zeros((2, *shape))
        self.expected[0] = self.config.initial_objects / (shape[0] * shape[1])
        self.returned: FloatArray = np.ones(shape)
        self.stamp: float | None = None
        self.box: FloatArray | None = None
        self.volume = 1.0
        self.count = 0
        self.found, self.exposure = np.zeros(2), np.zeros(2)
        self.awaited = 0.0

    def _grow_box(self, positions: FloatArray, spread: FloatArray) -> None:
        """Extent (3, 2) of all detections so far: false ones fall there too, the region may be stated too large."""
        if len(positions) == 0:
            return
        self.count += len(positions)
        padding = np.column_stack([np.full((len(spread), 2), PADDING), 2.0 * spread])
        low, high = (positions - padding).min(0), (positions + padding).max(0)
        if self.box is not None:
            low, high = np.minimum(low, self.box[:, 0]), np.maximum(high, self.box[:, 1])
        self.box = np.column_stack([low, high])

    def look(
        self,
        positions: FloatArray,
        spread: FloatArray,
        sensor: FloatArray,
        known: bool,
        silent: bool,
        stamp: float,
        view: CameraView | None = None,
    ) -> tuple[FloatArray, FloatArray, float]:
        """Densities of undetected objects at detections (2, M) and of clutter, 1/m³, and how probably what is carried
        about has come there unseen (M,); then take the look in.

        spread (M, 3) m: standard deviations. view : what of the sensor's cone it could see.
        """
        config = self.config
        elapsed = 0.0 if self.stamp is None else max(stamp - self.stamp, 0.0)
        self.stamp = stamp if self.stamp is None else max(stamp, self.stamp)
        self._grow_box(positions, spread[:, 2])
        cell_count = self.returned.size
        self.expected *= np.exp(-config.removed_per_second * elapsed)
        self.expected[1] += config.new_objects_per_second * elapsed / cell_count
        still_away = np.exp(-elapsed / RETURN_SECONDS)
        self.returned *= still_away
        self.returned += 1.0 - still_away
        height = float(self.region[2, 1] - self.region[2, 0])
        area = float(np.prod(self.size))
        surface = area * cell_count
        if self.box is not None and self.count >= ENOUGH:
            extent = self.box[:, 1] - self.box[:, 0]
            height = min(height, float(extent[2])) if height > 0.0 else float(extent[2])
            surface = min(surface, float(extent[0] * extent[1]))
        shares = cells_in_view(self.centres, self.size, sensor) if known else np.ones(self.returned.shape)
        # False detections fall anywhere in the cone, also where a thing would be hidden or too small.
        seen = area * float(shares.sum())
        if view is not None and not silent:
            self._restrict(shares, view)
        volume = max(min(surface, seen) if seen > 0.0 else surface, area) * height
        scale = self.scale
        cells, weights = self._near(positions, spread, shares)
        density = scale[:, None] * (weights * self.expected[:, *cells]).sum(2) / (area * height)
        returned = (weights * self.returned[cells]).sum(1)
        self.volume = area * cell_count * height
        awaited = config.detection_probability * (shares * self.expected).sum((1, 2))
        self.awaited = float(scale @ awaited)
        if not silent:
            self.exposure += awaited
            missed = 1.0 - config.detection_probability * shares
            self.expected *= missed
            self.returned *= missed
        return density, returned, config.clutter_per_frame / volume

    def _near(
        self, positions: FloatArray, spread: FloatArray, shares: FloatArray
    ) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
        """Cells (M, K) where what was detected may be, and what each counts: what is out of view was not detected."""
        around = positions[:, None, :2] + spread[:, None, :2] * AROUND
        cells = self.cells(around)
        weights = WEIGHTS * np.maximum(shares[cells], OUT_OF_VIEW)
        return cells, weights / weights.sum(1, keepdims=True)

    def _restrict(self, shares: FloatArray, view: CameraView) -> None:
        """Lower the shares (nx, ny) of the cells by what could be seen there, block by block, in place."""
        low, high = self.region[2] if self.box is None else self.box[2]
        heights = low + (np.arange(HEIGHTS) + 0.5) / HEIGHTS * (high - low)
        nx, ny = shares.shape
        blocks = shares.reshape(nx // BLOCK, BLOCK, ny // BLOCK, BLOCK)
        some = blocks.any((1, 3))
        if some.any():
            centres = self.centres.reshape(*blocks.shape, 2).mean((1, 3))
            seen = np.zeros(some.shape)
            seen[some] = view.cells(centres[some], heights, self._small)
            blocks *= seen[:, None, :, None]

    @property
    def scale(self) -> FloatArray:
        """How many times more objects of each kind (2,) there are than configured."""
        return (1.0 + self.found) / (1.0 + self.exposure)

    def cells(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Indices of the cells of positions (..., 2), the nearest where outside."""
        at = ((positions - self.region[:2, 0]) / self.size).astype(np.int64)
        xs, ys = np.moveaxis(np.clip(at, 0, np.array(self.returned.shape) - 1), -1, 0)
        return xs, ys


def sensor_array(sensor: SensorCone | None) -> FloatArray:
    """A sensor as `clearance` takes it, (8,)."""
    if sensor is None:
        return np.zeros(8)
    return np.array(
        [*sensor.pose, sensor.range_min, sensor.range_max, 0.5 * sensor.angle, 0.5 * sensor.vertical_angle]
    )


@numba.njit(cache=True)
def cells_in_view(centres, size, sensor):  # type: ignore[no-untyped-def]
    """1 for each cell (nx, ny) whose middle a sensor sees, at its own height, else 0."""
    out = np.zeros(centres.shape[:2])
    reach = 0.5 * BLOCK * np.sqrt(size[0] ** 2 + size[1] ** 2)
    point = np.empty(3)
    point[2] = sensor[2]
    for i in range(0, centres.shape[0], BLOCK):
        for j in range(0, centres.shape[1], BLOCK):
            point[:2] = 0.5 * (centres[i, j] + centres[i + BLOCK - 1, j + BLOCK - 1])
            if max(abs(point[0] - sensor[0]), abs(point[1] - sensor[1])) > sensor[5] + reach:
                continue
            inside = clearance(point, sensor, np.bool_(True))
            if abs(inside) >= reach:
                out[i : i + BLOCK, j : j + BLOCK] = inside > 0.0
                continue
            for a in range(i, i + BLOCK):
                for b in range(j, j + BLOCK):
                    point[:2] = centres[a, b]
                    out[a, b] = clearance(point, sensor, np.bool_(True)) > 0.0
    return out
