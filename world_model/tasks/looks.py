"""Objects and sensors, made ready for looking ahead."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_number, as_own, require_positive, require_word
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from estimation.geometry.rotations import wrap_scalar
from world_model.state import WorldObject

# Variance that stands for an axis nobody estimates: nothing is gained along it.
FLAT = 1e-12
BLIND = 1e12
FARTHEST = 1e6  # m from the origin; nothing that anybody drives to is farther away


@dataclass(frozen=True)
class Sensor:
    """What a sensor can see and how well.

    name : for the task. range_min, range_max : m. covariance : (2, 2) or (3, 3) m² of a measured position, world
    axes. cost : metres of driving that one look is worth (the text's cost of the measurement).
    """

    name: str
    range_min: float
    range_max: float
    covariance: npt.ArrayLike
    cost: float = 0.0

    def __post_init__(self) -> None:
        for name in ("range_min", "range_max", "cost"):
            as_number(f"sensor {self.name!r}: {name}", getattr(self, name))
        if not 0.0 <= self.range_min < self.range_max:
            raise InputError(
                f"sensor {self.name!r}: range_min and range_max must satisfy 0 <= min < max, "
                f"got {self.range_min!r}, {self.range_max!r}"
            )
        named = f"covariance of sensor {require_word('name', self.name)!r}"
        own = repair_covariance(as_own(named, self.covariance, (2, 2), (3, 3)), named)
        object.__setattr__(self, "covariance", own)
        if self.cost < 0.0:
            raise InputError(f"sensor {self.name!r}: cost must be at least 0, got {self.cost!r}")


@dataclass(frozen=True)
class Looks:
    """Objects with a position, as arrays.

    positions : (N, 3) m. P, Q : (N, 3, 3) covariance, m², and its growth, m²/s. R : per sensor (N, 3, 3) of one look,
    m². dimensions : axes that are estimated, 2 or 3.
    """

    objects: list[WorldObject]
    sensors: list[Sensor]
    positions: FloatArray
    P: FloatArray
    Q: FloatArray
    R: list[FloatArray]
    dimensions: int

    def index(self, object_id: str) -> int | None:
        """Index of an object, None where it is unknown, lost or without a position."""
        return next((k for k, item in enumerate(self.objects) if item.id == object_id), None)

    def sensor_index(self, name: str) -> int | None:
        """Index of a sensor."""
        return next((s for s, sensor in enumerate(self.sensors) if sensor.name == name), None)

    def reaches(self, k: int, s: int, pose: FloatArray) -> bool:
        """Whether object k is within range of sensor s from a pose (3,)."""
        away = math.hypot(*(self.positions[k, :2] - pose[:2]))
        return self.sensors[s].range_min <= away <= self.sensors[s].range_max

    def in_view(
        self, k: int, pose: FloatArray, view: float | Mapping[str, Any] | Callable[[FloatArray], bool] | None
    ) -> bool:
        """Whether object k is in the field of view from a pose (3,)."""
        if view is None:
            return True
        if callable(view):
            return bool(view(self.positions[k]))
        dx, dy = self.positions[k, :2] - pose[:2]
        if isinstance(view, Mapping) and math.hypot(dx, dy) > float(view.get("range", math.inf)):
            return False
        return abs(wrap_scalar(math.atan2(dy, dx) - pose[2])) <= 0.5 * self.opening(view)

    @staticmethod
    def opening(view: float | Mapping[str, Any] | Callable[[FloatArray], bool] | None) -> float:
        """Full angle of view, rad.

        Raises InputError: not an angle above 0, up to all around.
        """
        if view is None or callable(view):
            return 2.0 * math.pi
        if isinstance(view, Mapping) and "range" in view and view["range"] != math.inf:
            require_positive("field_of_view: range", view["range"])
        angle = view.get("angle", 2.0 * math.pi) if isinstance(view, Mapping) else view
        if require_positive("field_of_view: angle, rad,", angle) > 2.0 * math.pi + 1e-2:
            raise InputError(f"field_of_view: an angle of at most 2 pi rad expected, got {angle!r}")
        return float(angle)


def looks_at(objects: Sequence[WorldObject], sensors: Sequence[Sensor], process_noise: float) -> Looks:
    """All that can be looked at: not lost, with a finite position and covariance, and a growth that is none or more.

    process_noise : m²/s, growth of the variance where an object states none.
    """
    able = [item for item in objects if not getattr(item, "lost", False)]
    positions, P = _stacked(able)
    Q = _growths(able, process_noise)
    usable = np.asarray((np.abs(positions) < FARTHEST).all(axis=1) & np.isfinite(P).all(axis=(1, 2)))
    usable &= (Q.diagonal(axis1=1, axis2=2) >= 0.0).all(axis=1) & np.isfinite(Q).all(axis=(1, 2))
    if not usable.all():
        able = [item for item, good in zip(able, usable, strict=True) if good]
        positions, P, Q = positions[usable], P[usable], Q[usable]
    flat = _repair(P)
    Q[flat, 2, :], Q[flat, :, 2] = 0.0, 0.0
    R = []
    for sensor in sensors:
        given = np.asarray(sensor.covariance, dtype=np.float64)
        noise = np.zeros((len(able), 3, 3))
        noise[:, 2, 2] = BLIND
        noise[:, : len(given), : len(given)] = given
        noise[flat, 2, :], noise[flat, :, 2] = 0.0, 0.0
        noise[flat, 2, 2] = BLIND
        R.append(noise)
    dimensions = 2 if flat.all() else 3
    return Looks(able, list(sensors), positions, P, Q, R, dimensions)


def _stacked(objects: list[WorldObject]) -> tuple[FloatArray, FloatArray]:
    """Positions (N, 3) and covariances (N, 3, 3); planar ones are filled up, what has another shape becomes NaN."""
    try:
        positions = np.array([item.position for item in objects], dtype=np.float64)
        P = np.array([item.covariance for item in objects], dtype=np.float64)
    except ValueError:
        positions, P = np.zeros(0), np.zeros(0)
    if positions.shape == (len(objects), 3) and P.shape == (len(objects), 3, 3):
        return positions, P
    positions, P = np.zeros((len(objects), 3)), np.zeros((len(objects), 3, 3))
    for k, item in enumerate(objects):
        where, covariance = np.asarray(item.position), np.asarray(item.covariance)
        if where.shape not in ((2,), (3,)) or covariance.shape not in ((2, 2), (3, 3)):
            positions[k] = np.nan
            continue
        positions[k, : len(where)] = where
        P[k, : len(covariance), : len(covariance)] = covariance
    return positions, P


def _repair(P: FloatArray) -> npt.NDArray[np.bool_]:
    """Make covariances (N, 3, 3) symmetric and positive definite in place; which have a height that is simply known."""
    P += np.swapaxes(P, 1, 2).copy()
    P *= 0.5
    flat: npt.NDArray[np.bool_] = P[:, 2, 2] <= FLAT
    P[flat, 2, :], P[flat, :, 2] = 0.0, 0.0
    P[flat, 2, 2] = FLAT
    planar = P[:, 0, 0] * P[:, 1, 1] - P[:, 0, 1] ** 2
    sound = (P[:, 0, 0] > 0.0) & (planar > 0.0) & (np.linalg.det(P) > 0.0)
    if not sound.all():
        values, vectors = np.linalg.eigh(P[~sound])
        floor = np.maximum(FLAT, FLAT * np.maximum(values[:, -1:], 0.0))
        fixed = np.maximum(values, floor)
        P[~sound] = (vectors * fixed[:, None, :]) @ np.swapaxes(vectors, 1, 2)
    return flat


def _growths(objects: list[WorldObject], default: float) -> FloatArray:
    """(N, 3, 3) m²/s of process noises that may be numbers, vectors or matrices, or be missing; NaN of other shapes."""
    stated = [getattr(item, "process_noise", None) for item in objects]
    if all(type(value) is np.ndarray and value.shape == (3, 3) for value in stated):
        return np.array(stated, dtype=np.float64).reshape(-1, 3, 3)
    Q = np.zeros((len(objects), 3, 3))
    for k, value in enumerate(stated):
        given = np.asarray(default if value is None else value, dtype=np.float64)
        if given.shape not in ((), (2,), (3,), (2, 2), (3, 3)):
            Q[k] = np.nan
        elif given.ndim == 2:
            Q[k, : len(given), : len(given)] = given
        else:
            size = len(given) if given.ndim else 3
            Q[k, range(size), range(size)] = given
    return Q
