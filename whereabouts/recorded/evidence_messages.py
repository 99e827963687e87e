"""Evidence of recorded or received messages as the world model takes it: frames, covariances, distributions.

Messages are taken by their fields only, so that those of a live graph and those read from a bag are treated alike.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from estimation.checks import FloatArray as Array
from estimation.conversion.uncertain_frame import through_uncertain_pose
from estimation.errors import InputError
from estimation.geometry.frame_tree import TransformError
from estimation.geometry.rotations import rotation_from_quaternion
from registration.laser.scan import FARTHEST
from whereabouts.recorded.camera_messages import box_from_message
from world_model import ObjectEvidence, WorldEvidence
from world_model.camera import CameraModel, CameraView, ImageBox, LocatedBox, SightRates, overlap
from world_model.symbols import Gaussian, Symbols, default_symbols

SUM_TOLERANCE = 0.01
SIZE_SIGMA = 0.1
"""Standard deviation of a detected extent, as a share of it."""
FLOOR_SIGMA = 1.0
"""m: height of a tracked target is not known."""
NOT_FOUND = "not_found"
"""`detection_id` of an object that was looked for, by its `object_id`, and is not there."""
PERSON = "person"
SHORTEST = 1e-6
"""m: an extent below it was not measured."""
DOUBLE = 0.5
"""Overlap (intersection over union) from which on two boxes at one distance are of one thing."""
SUREST, WIDEST = 1e-12, 1e15
"""m²: a variance below is taken as this one; above it says nothing."""


@dataclass(frozen=True)
class SeenFrame:
    """How to get from the frame of a message to the world: matrix (4, 4), and what is uncertain about it: the robot's
    origin (2,) and the covariance (3, 3) of its x, y, yaw; None where the message is in the world frame."""

    matrix: Array = field(default_factory=lambda: np.eye(4))
    origin: Array | None = None
    pose_covariance: Array | None = None

    @classmethod
    def placed(
        cls, transforms: Any, frames: tuple[str, str], frame: str, stamp: int, pose_covariance: Array | None
    ) -> SeenFrame:
        """A frame on the robot at a stamp, ns, by tf. frames : of map and robot. Raises TransformError."""
        matrix = transforms.lookup(frames[0], frame, stamp)
        origin = matrix[:2, 3]
        with suppress(TransformError):  # a camera may stand by itself
            origin = transforms.lookup(*frames, stamp)[:2, 3]
        return cls(matrix, origin, pose_covariance)

    def view(self, camera: CameraModel, rates: SightRates, name: str, **hiding: Any) -> CameraView:
        """What a camera in this frame saw; hiding : depth, scan and turned of `CameraView`."""
        doubt, origin = self.pose_covariance, self.origin
        return CameraView(
            camera, self.matrix, pose_covariance=doubt, origin=origin, rates=rates, name=name, **hiding
        )

    def position(self, position: Array, covariance: Array) -> tuple[Array, Array]:
        """Position (3,) and covariance (3, 3) in the world; the covariance is turned, the robot's is added."""
        turn = self.matrix[:3, :3]
        moved = turn @ position + self.matrix[:3, 3]
        turned = turn @ covariance @ turn.T
        if self.origin is None or self.pose_covariance is None:
            return moved, turned
        return through_uncertain_pose(moved, turned, self.origin, self.pose_covariance)


@dataclass(frozen=True)
class Reader:
    """What a deployment knows of its detectors' words.

    known : values of the attributes that are limited, {"class": [...]}. attributes : names of all that are taken in.
    sigma : m, of detections that come without covariance. quantities : names of those that stay numbers; others become
    symbols of the attributes.
    """

    known: Mapping[str, Sequence[str]]
    attributes: Sequence[str]
    sigma: float
    symbols: Symbols = field(default_factory=default_symbols)
    quantities: Sequence[str] = ()

    def evidence(self, message: Any, frame: SeenFrame) -> tuple[WorldEvidence, list[str]]:
        """A whereabouts_msgs/WorldEvidence, and the ids of objects that were looked for and not found.

        Raises InputError naming detection and field.
        """
        objects, missing = [], []
        for index, item in enumerate(message.objects):
            if item.detection_id == NOT_FOUND and item.object_id:
                missing.append(str(item.object_id))
                continue
            with _named(f"objects[{index}]"):
                objects.append(self._object(item, frame))
        sensor = None
        if len(message.field_of_view):
            with _named("field_of_view"):
                sensor = _sensor(message.field_of_view[0], frame)
        # Where nobody says what was in view, what is not seen may have been out of it.
        return WorldEvidence(objects, sensor, bool(message.blocked) or sensor is None), missing

    def detections(self, message: Any, frame: SeenFrame) -> WorldEvidence:
        """A vision_msgs/Detection3DArray; where the detector looked is not known. Raises InputError."""
        objects = []
        for index, item in enumerate(message.detections):
            with _named(f"detections[{index}]"):
                objects.append(self._detection(item, frame))
        return WorldEvidence(objects)

    def boxes(
        self,
        message: Any,
        frame: SeenFrame,
        view: CameraView,
        place: Callable[[ImageBox, Sequence[ImageBox]], LocatedBox],
    ) -> tuple[WorldEvidence, list[str]]:
        """A vision_msgs/Detection2DArray of a view, and why detections could not be placed.

        frame : of the camera. place : where in it the object in a box is, among the other boxes.

        Raises InputError for words and numbers that make no sense.
        """
        objects, refused, taken = [], [], []
        framed: list[tuple[ImageBox, LocatedBox, dict[str, dict[str, float]]]] = []
        boxes = [box_from_message(item.bbox) for item in message.detections]
        for index, (box, item) in enumerate(zip(boxes, message.detections, strict=True)):
            with _named(f"detections[{index}]"):
                attributes = self._classified(item.results)
                others = boxes[:index] + boxes[index + 1 :]
                try:
                    framed.append((box, place(box, others), attributes))
                except InputError as error:
                    refused.append(f"detections[{index}]: {error}")
                    taken.append(box)
        for found, attributes in _things(framed):
            position, turned = frame.position(found.position, found.covariance)
            # Seen from one side it is taken to be as deep as it is wide.
            extent = _measured(np.array([found.width, found.width, found.height]))
            words, numbers = self._with_symbols(attributes, extent)
            objects.append(ObjectEvidence(position, turned, words, quantities=numbers))
        evidence = WorldEvidence(objects)
        evidence.view = replace(view, taken=tuple(taken))
        return evidence, refused

    def targets(
        self, message: Any, frame: SeenFrame, ids: Mapping[int, str]
    ) -> tuple[WorldEvidence, list[int]]:
        """A whereabouts_msgs/TargetArray, and the labels of those that are taken in: what is hidden is no measurement.

        ids : which object each label was last. Says nothing about things that are no targets. Raises InputError.
        """
        objects, labels = [], []
        for index, item in enumerate(message.targets):
            if item.occluded:
                continue
            with _named(f"targets[{index}]"):
                state = np.asarray(item.state_covariance, dtype=np.float64).reshape(4, 4)
                covariance = np.zeros((3, 3))
                covariance[:2, :2], covariance[2, 2] = state[:2, :2], FLOOR_SIGMA**2
                position, covariance_there = frame.position(_vector(item.position), covariance)
                words = _distribution("class_distribution", item.class_distribution)
                kind = self._complete("class", words or {PERSON: 1.0})
                label = int(item.label)
                objects.append(ObjectEvidence(position, covariance_there, {"class": kind}, ids.get(label)))
                labels.append(label)
        return WorldEvidence(objects, blocked=True), labels

    def _object(self, item: Any, frame: SeenFrame) -> ObjectEvidence:
        covariance = _covariance("pose.covariance", item.pose.covariance, self.sigma)
        position, turned = frame.position(_vector(item.pose.pose.position), covariance)
        attributes: dict[str, dict[str, float]] = {}
        quantities = _measured(_vector(item.size))
        for given in item.attributes:
            name = str(given.name)
            discrete = _distribution(f"attributes[{name!r}]", given.discrete)
            if discrete:
                attributes[name] = self._complete(name, discrete)
            elif len(given.continuous.mean):
                mean, spread = given.continuous.mean, given.continuous.covariance
                size = len(mean)
                quantities |= self.symbols.unpacked(
                    name, mean, spread if len(spread) else np.zeros(size * size)
                )
            else:
                raise InputError(f"attributes[{name!r}]: neither discrete nor continuous is filled")
        words, numbers = self._with_symbols(attributes, quantities)
        return ObjectEvidence(position, turned, words, item.object_id or None, numbers)

    def _detection(self, item: Any, frame: SeenFrame) -> ObjectEvidence:
        best = max(item.results, key=lambda result: result.hypothesis.score, default=None)
        position, covariance = _vector(item.bbox.center.position), self.sigma**2 * np.eye(3)
        if best is not None:
            at = _vector(best.pose.pose.position)
            position = at if at.any() else position
            covariance = _covariance("results[].pose.covariance", best.pose.covariance, self.sigma)
        position, turned = frame.position(position, covariance)
        attributes = self._classified(item.results)
        words, numbers = self._with_symbols(attributes, _measured(_vector(item.bbox.size)))
        return ObjectEvidence(position, turned, words, quantities=numbers)

    def _classified(self, results: Iterable[Any]) -> dict[str, dict[str, float]]:
        """The class by the scores of vision_msgs/ObjectHypothesisWithPose; {} where there are none."""
        scores: dict[str, float] = {}
        for result in results:
            name, score = str(result.hypothesis.class_id), float(result.hypothesis.score)
            if not 0.0 <= score <= 1.0 + SUM_TOLERANCE:
                raise InputError(
                    f"results: a score from 0 to 1 expected of {name!r}, got {score!r}; is it in percent?"
                )
            if name:
                scores[name] = scores.get(name, 0.0) + score
        if not scores:
            return {}
        if not any(scores.values()):  # nobody filled them in
            scores = dict.fromkeys(scores, 1.0)
        # Scores of independent classifiers may add up to more than one.
        total = max(sum(scores.values()), 1.0)
        return {"class": self._complete("class", {n: s / total for n, s in scores.items()})}

    def _complete(self, attribute: str, given: Mapping[str, float]) -> dict[str, float]:
        """A distribution that sums to one: what is missing belongs to known values that were not named."""
        total = sum(given.values())
        if total <= 0.0:
            raise InputError(f"attributes[{attribute!r}]: probabilities sum to {total:g}")
        others = [value for value in self.known.get(attribute, ()) if value not in given]
        rest = max(1.0 - total, 0.0)
        if rest <= 1e-9 or not others:
            return {value: p / total for value, p in given.items()}
        return {**given, **{value: rest / len(others) for value in others}}

    def _with_symbols(
        self, attributes: dict[str, dict[str, float]], quantities: Mapping[str, Gaussian]
    ) -> tuple[dict[str, dict[str, float]], dict[str, Gaussian]]:
        """Measured numbers become symbols of the attributes that were not given in words, or stay numbers."""
        numbers = {name: value for name, value in quantities.items() if name in self.quantities}
        others = {name: value for name, value in quantities.items() if name not in self.quantities}
        if others:
            for name, values in self.symbols.perceived(others, self.known).items():
                if name in self.attributes:
                    attributes.setdefault(name, values)
        return attributes, numbers


def _things(
    framed: Sequence[tuple[ImageBox, LocatedBox, dict[str, dict[str, float]]]],
) -> list[tuple[LocatedBox, dict[str, dict[str, float]]]]:
    """Things with their attributes; boxes around one thing are one, called by the mean of what they call it.

    Detectors that keep the best box of each class frame a thing twice.
    """
    groups: list[list[int]] = []
    for index, (box, found, _) in enumerate(framed):
        for group in groups:
            other, there, _ = framed[group[0]]
            reach = max(found.width, found.height, there.width, there.height)
            if overlap(box, other) > DOUBLE and np.linalg.norm(found.position - there.position) <= reach:
                group.append(index)
                break
        else:
            groups.append([index])
    out = []
    for group in groups:
        attributes = framed[group[0]][2]
        said = [framed[index][2]["class"] for index in group if "class" in framed[index][2]]
        if len(said) > 1:
            names = dict.fromkeys(name for given in said for name in given)
            attributes = {"class": {n: sum(given.get(n, 0.0) for given in said) / len(said) for n in names}}
        out.append((framed[group[0]][1], attributes))
    return out


@contextmanager
def _named(place: str) -> Iterator[None]:
    """Puts the place in front of an InputError raised within."""
    try:
        yield
    except InputError as error:
        raise InputError(f"{place}: {error}") from None


def most_probably(item: ObjectEvidence, class_name: str) -> bool:
    """Whether a detection is more probably of this class than not."""
    return float(item.attributes.get("class", {}).get(class_name, 0.0)) > 0.5


def _vector(point: Any) -> Array:
    """(3,) metres, none farther than anything is. Raises InputError."""
    found = np.array([point.x, point.y, point.z], dtype=np.float64)
    if not (np.abs(found) <= FARTHEST).all():
        raise InputError(f"coordinates within {FARTHEST:g} m expected, got {found.tolist()}")
    return found


def _covariance(name: str, values: Iterable[float], unknown: float) -> Array:
    """Position block (3, 3) of a 6x6 covariance; of a deviation `unknown`, m, along axes of which it says 0 or less."""
    block = np.array(values, dtype=np.float64).reshape(6, 6)[:3, :3]
    if not (np.abs(block) <= WIDEST).all():
        raise InputError(f"{name} must be finite and below {WIDEST:g}; it holds NaN, infinity or more")
    unsaid = np.diag(block) <= 0.0
    block[unsaid], block[:, unsaid] = 0.0, 0.0
    block[unsaid, unsaid] = unknown**2
    # A measurement is never surer than this, and what divides by its variance can.
    places = np.arange(3)
    block[places, places] = np.maximum(block[places, places], SUREST)
    return block


def _distribution(name: str, given: Any) -> dict[str, float]:
    """A DiscreteDistribution as a mapping; {} where it is empty."""
    values, probabilities = [str(value) for value in given.values], [float(p) for p in given.probabilities]
    if len(values) != len(probabilities):
        raise InputError(f"{name}: {len(values)} values but {len(probabilities)} probabilities")
    if len(set(values)) != len(values) or "" in values:
        raise InputError(f"{name}: values must be names, each given once, got {values}")
    if (
        not all(0.0 <= p <= 1.0 + SUM_TOLERANCE for p in probabilities)
        or sum(probabilities) > 1.0 + SUM_TOLERANCE
    ):
        raise InputError(
            f"{name}: probabilities in [0, 1] that sum to at most one expected, got {probabilities}"
        )
    return dict(zip(values, probabilities, strict=True))


def _measured(extent: Array) -> dict[str, Gaussian]:
    """Size (the diagonal) and ratio (height by width) of a detected extent (3,), m; {} where it is not known."""
    if (extent < 0.0).any():
        raise InputError(f"size: lengths of at least 0 m expected, got {extent.tolist()}")
    if not (extent >= SHORTEST).any():
        return {}
    diagonal = float(np.linalg.norm(extent))
    found = {"size": (diagonal, (SIZE_SIGMA * diagonal) ** 2)}
    width = float(extent[:2].max())
    if min(width, extent[2]) >= SHORTEST:
        ratio = float(extent[2]) / width
        found["ratio"] = (ratio, 2.0 * (SIZE_SIGMA * ratio) ** 2)
    return found


def _sensor(view: Any, frame: SeenFrame) -> dict[str, Any]:
    q = view.pose.orientation
    x, y, z = frame.matrix[:3, :3] @ _vector(view.pose.position) + frame.matrix[:3, 3]
    ahead = frame.matrix[:3, :3] @ rotation_from_quaternion([q.x, q.y, q.z, q.w])[:, 0]
    return {
        "pose": (float(x), float(y), float(z), float(np.arctan2(ahead[1], ahead[0]))),
        "range": float(view.range_max),
        "range_min": float(view.range_min),
        "angle": float(view.horizontal_angle),
        "vertical_angle": float(view.vertical_angle),
    }
