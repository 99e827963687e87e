"""What a detector saw in one look: the measurements of section 2.4.1, with the sensor that made them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from types import NoneType
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_shape, require_kind
from estimation.errors import InputError
from estimation.filters.gaussians import repair_covariance
from world_model.camera.camera_view import CameraView

Distribution = Mapping[str, float]
SENSOR = {"pose", "range", "angle", "range_min", "vertical_angle"}
SUM_TOLERANCE = 0.01
SMALLEST_VARIANCE = 1e-8
"""m²; a detector that claims to be better than 0.1 mm in some direction is not believed."""


KINDS: Mapping[str, tuple[type, ...]] = {
    "attributes": (dict, Mapping),
    "object_id": (str, NoneType),
    "quantities": (dict, Mapping),
    "begins": (bool, np.bool_),
}
"""Of the fields of `ObjectEvidence` that are no numbers."""


@dataclass
class ObjectEvidence:
    """One detection of one object (z of section 2.4.1).

    position : (3,) m, world frame. covariance : (3, 3) m², or None where the detector does not say
    (`WorldModelConfig.measurement_sigma` then). attributes : {"class": {"cup": 0.8, ...}, "color": {...}}:
    distributions over named values that sum to one; other names for other attributes. object_id : id of a known
    object that this measurement verifies; it is associated with that object directly. quantities : {"size":
    (mean, variance), ...}: continuous attributes, SI units; names are those of `WorldModelConfig.quantities`.
    begins : whether it may be of an object that nobody knows yet, not only of a known one.
    """

    position: npt.ArrayLike
    covariance: npt.ArrayLike | None = None
    attributes: Mapping[str, Distribution] = field(default_factory=dict)
    object_id: str | None = None
    quantities: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    begins: bool = True


@dataclass
class WorldEvidence:
    """All detections of one look, also where there are none.

    sensor : {"pose": (x, y, z, yaw), "range": m, "angle": full opening in the plane, rad, and optionally
    "range_min": m, "vertical_angle": full opening in height, rad}. Objects inside must have been visible, so not
    seeing one there is evidence too. None: where the sensor looked is not known. Without detections such a
    look says nothing (blocked, failed); with detections it is taken as a look at everything, and what is not
    seen is kept in mind for long, in case it was out of view. blocked : the sensor failed or is covered; the
    absence of detections says nothing. view : what a camera could see, more exactly than a cone; takes the place of
    `sensor` where that is None.
    """

    objects: Sequence[ObjectEvidence]
    sensor: Mapping[str, Any] | None = None
    blocked: bool = False
    view: CameraView | None = None


@dataclass(frozen=True)
class SensorCone:
    """A checked `WorldEvidence.sensor`: pose (4,) x, y, z, yaw; lengths m, angles rad (full openings)."""

    pose: FloatArray
    range_max: float
    angle: float
    range_min: float = 0.0
    vertical_angle: float = 0.0

    @classmethod
    def checked(cls, given: Mapping[str, Any]) -> SensorCone:
        """Raises InputError naming what is missing or out of range."""
        try:
            pose, far, angle = given["pose"], float(given["range"]), float(given["angle"])
            near, vertical = float(given.get("range_min", 0.0)), float(given.get("vertical_angle", 0.0))
        except (LookupError, TypeError, ValueError, AttributeError) as error:
            raise InputError(
                f'sensor must be {{"pose": (x, y, z, yaw), "range": m, "angle": rad}}, not {given!r}'
            ) from error
        if unknown := set(given) - SENSOR:
            raise InputError(f"sensor has unknown fields {sorted(unknown)}; known are {sorted(SENSOR)}")
        pose = as_finite("sensor pose", pose)
        if pose.shape != (4,):
            raise InputError(f"sensor pose must be (x, y, z, yaw), not of shape {pose.shape}")
        if not 0.0 <= near < far:
            raise InputError(f"sensor range must be above range_min, at least 0; they are {far!r}, {near!r}")
        if not 0.0 < angle <= 2.0 * np.pi + 1e-6 or not 0.0 <= vertical <= np.pi + 1e-6:
            raise InputError(f"sensor angle must be in (0, 2 pi], not {angle!r} (height: {vertical!r})")
        return cls(pose, far, angle, near, vertical)


@dataclass(frozen=True)
class Measurements:
    """Checked evidence as arrays: positions (M, 3), covariances (M, 3, 3), ids and distributions per detection."""

    positions: FloatArray
    covariances: FloatArray
    attributes: tuple[Mapping[str, Distribution], ...]
    object_ids: tuple[str | None, ...]
    sensor: SensorCone | None
    silent: bool
    """Whether not being seen means nothing in this look."""
    quantities: tuple[Mapping[str, tuple[float, float]], ...]
    view: CameraView | None = None
    begins: tuple[bool, ...] = ()

    def only(self, which: list[int]) -> Measurements:
        """Some of the detections."""
        names = ("attributes", "object_ids", "quantities", "begins")
        some: Any = {name: tuple(getattr(self, name)[i] for i in which) for name in names}
        return replace(self, positions=self.positions[which], covariances=self.covariances[which], **some)


def detections(evidence: WorldEvidence) -> list[ObjectEvidence]:
    """The detections, each field of its kind; raises InputError naming detection and field."""
    require_kind("evidence", evidence, WorldEvidence)
    require_kind("objects", evidence.objects, Iterable)
    require_kind("blocked", evidence.blocked, bool, np.bool_)
    require_kind("view", evidence.view, CameraView, NoneType)
    objects = list(evidence.objects)
    for index, item in enumerate(objects):
        require_kind(f"objects[{index}]", item, ObjectEvidence)
        for name, kinds in KINDS.items():
            if not isinstance(getattr(item, name), kinds):  # a name is made for what is wrong only
                require_kind(f"objects[{index}].{name}", getattr(item, name), *kinds)
    return objects


def checked(evidence: WorldEvidence, sigma: float) -> Measurements:
    """Evidence as arrays; raises InputError naming detection and field before anything was changed."""
    objects = detections(evidence)
    cone = evidence.view.sensor if evidence.sensor is None and evidence.view is not None else evidence.sensor
    sensor = None if cone is None else SensorCone.checked(cone)
    positions, covariances = np.empty((len(objects), 3)), np.empty((len(objects), 3, 3))
    for index, item in enumerate(objects):
        positions[index] = as_shape(f"objects[{index}].position", item.position, (3,))
        given = sigma**2 * np.eye(3) if item.covariance is None else item.covariance
        covariances[index] = as_shape(f"objects[{index}].covariance", given, (3, 3))
        for name, distribution in item.attributes.items():
            _check_distribution(f"objects[{index}].attributes[{name!r}]", distribution)
    for name, values in (("position", positions), ("covariance", covariances.reshape(-1, 9))):
        bad = np.flatnonzero(~np.isfinite(values).all(1))
        if bad.size:
            raise InputError(f"objects[{bad[0]}].{name} must be finite; it holds NaN or infinity")
    return Measurements(
        positions,
        _definite(covariances),
        tuple(item.attributes for item in objects),
        tuple(item.object_id for item in objects),
        sensor,
        evidence.blocked or (sensor is None and not objects),
        tuple(item.quantities for item in objects),
        evidence.view,
        tuple(item.begins for item in objects),
    )


def _definite(covariances: FloatArray) -> FloatArray:
    """The covariances with no direction more certain than is credible; InputError for indefinite ones."""
    try:
        np.linalg.cholesky(covariances)
    except np.linalg.LinAlgError:
        for index, covariance in enumerate(covariances):
            repair_covariance(covariance, f"objects[{index}].covariance", definite=False)
    other = covariances.transpose(0, 2, 1)
    if (np.abs(covariances - other) > 1e-12 + 1e-6 * np.abs(other)).any():
        raise InputError("objects[].covariance must be symmetric")
    return covariances + SMALLEST_VARIANCE * np.eye(3)


def _check_distribution(name: str, distribution: Distribution) -> None:
    if not isinstance(distribution, Mapping) or not distribution:
        raise InputError(f"{name} must be a distribution {{value: probability}}, not {distribution!r}")
    total = 0.0
    for value, probability in distribution.items():
        # Asking for the exact type first is what takes the least time of what is nearly always so.
        number = type(probability) is float or isinstance(probability, (int, float, np.number))
        if not number or not 0.0 <= probability <= 1.0 + SUM_TOLERANCE:
            raise InputError(f"{name}[{value!r}] must be a probability in [0, 1], not {probability!r}")
        total += float(probability)
    if abs(total - 1.0) > SUM_TOLERANCE:
        raise InputError(f"{name} must sum to one, not {total:g}")
