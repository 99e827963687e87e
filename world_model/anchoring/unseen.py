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

MOST_CELLS = 96
SMALLEST_CELL = 0.25
SAMPLES = 4  # per axis, in cells that the edge of the view crosses
PADDING = 0.5  # m beyond the detections so far: what the detector may report
HEIGHTS = 3  # at which a camera's view of a cell is sampled
ENOUGH = 50  # detections that show where a detector reports anything at all


class Unseen:
    """Expected undetected objects per cell (2, nx, ny), of those from the beginning and of those that came later, as
    configured, and when each cell was last looked at (s).

    found, exposure (2,) : how many were found of each kind, and how many should have been as configured.
    """

    def __init__(self, config: WorldModelConfig) -> None:
        self.region = np.array(config.region, dtype=float)
        self.config = config
        extent = self.region[:2, 1] - self.region[:2, 0]
        counts = np.clip((extent / SMALLEST_CELL).astype(int), 1, MOST_CELLS)
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
        self.looked: FloatArray = np.full(shape, -np.inf)
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
        """Densities of undetected objects at detections (2, M) and of clutter, 1/m³, and for how long nobody had
        looked there (M,), s; then take the look in.

        spread (M,) m: standard deviation in z. view : what of the sensor's cone it could see.
        """
        config = self.config
        elapsed = 0.0 if self.stamp is None else max(stamp - self.stamp, 0.0)
        self.stamp = stamp if self.stamp is None else max(stamp, self.stamp)
        self._grow_box(positions, spread)
        cell_count = self.looked.size
        self.expected *= np.exp(-config.removed_per_second * elapsed)
        self.expected[1] += config.new_objects_per_second * elapsed / cell_count
        height = float(self.region[2, 1] - self.region[2, 0])
        area = float(np.prod(self.size))
        surface = area * cell_count
        if self.box is not None and self.count >= ENOUGH:
            extent = self.box[:, 1] - self.box[:, 0]
            height = min(height, float(extent[2])) if height > 0.0 else float(extent[2])
            surface = min(surface, float(extent[0] * extent[1]))
        shares = cells_in_view(self.centres, self.size, sensor) if known else np.ones(self.looked.shape)
        # False detections fall anywhere in the cone, also where a thing would be hidden or too small.
        seen = area * float(shares.sum())
        if view is not None and not silent:
            self._restrict(shares, view)
        volume = max(min(surface, seen) if seen > 0.0 else surface, area) * height
        cells = self.cells(positions)
        scale = self.scale
        density = scale[:, None] * self.expected[:, *cells] / (area * height)
        gap = np.maximum(stamp - self.looked[cells], elapsed)
        self.volume = area * cell_count * height
        awaited = config.detection_probability * (shares * self.expected).sum((1, 2))
        self.awaited = float(scale @ awaited)
        if not silent:
            self.exposure += awaited
            self.expected *= 1.0 - config.detection_probability * shares
            self.looked[shares > 0.5] = stamp
        return density, gap, config.clutter_per_frame / volume

    def _restrict(self, shares: FloatArray, view: CameraView) -> None:
        """Lower the shares (nx, ny) of the cells by what could be seen there, in place."""
        low, high = self.region[2] if self.box is None else self.box[2]
        heights = low + (np.arange(HEIGHTS) + 0.5) / HEIGHTS * (high - low)
        cells = np.nonzero(shares > 0.0)
        if len(cells[0]):
            shares[cells] *= view.cells(self.centres[cells], heights, self._small)

    @property
    def scale(self) -> FloatArray:
        """How many times more objects of each kind (2,) there are than configured."""
        return (1.0 + self.found) / (1.0 + self.exposure)

    def cells(self, positions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Indices of the cells of positions (M, 3), the nearest where outside."""
        at = ((positions[:, :2] - self.region[:2, 0]) / self.size).astype(np.int64)
        return np.clip(at[:, 0], 0, self.looked.shape[0] - 1), np.clip(at[:, 1], 0, self.looked.shape[1] - 1)


def sensor_array(sensor: SensorCone | None) -> FloatArray:
    """A sensor as `clearance` takes it, (8,)."""
    if sensor is None:
        return np.zeros(8)
    return np.array(
        [*sensor.pose, sensor.range_min, sensor.range_max, 0.5 * sensor.angle, 0.5 * sensor.vertical_angle]
    )


@numba.njit(cache=True)
def cells_in_view(centres, size, sensor):  # type: ignore[no-untyped-def]
    """Share (nx, ny) of each cell that a sensor sees, at its own height."""
    out = np.zeros(centres.shape[:2])
    reach = 0.5 * np.sqrt(size[0] ** 2 + size[1] ** 2)
    planar = np.bool_(True)
    point = np.empty(3)
    point[2] = sensor[2]
    for a in range(centres.shape[0]):
        for b in range(centres.shape[1]):
            point[0], point[1] = centres[a, b, 0], centres[a, b, 1]
            if max(abs(point[0] - sensor[0]), abs(point[1] - sensor[1])) > sensor[5] + reach:
                continue
            inside = clearance(point, sensor, planar)
            if abs(inside) >= reach:
                out[a, b] = 1.0 if inside > 0.0 else 0.0
                continue
            seen = 0
            for p in range(SAMPLES):
                for q in range(SAMPLES):
                    point[0] = centres[a, b, 0] + ((p + 0.5) / SAMPLES - 0.5) * size[0]
                    point[1] = centres[a, b, 1] + ((q + 0.5) / SAMPLES - 0.5) * size[1]
                    seen += clearance(point, sensor, planar) > 0.0
            out[a, b] = seen / SAMPLES**2
    return out
