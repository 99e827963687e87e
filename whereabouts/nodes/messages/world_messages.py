"""Messages of `world_model`: worlds, objects and answers out, requests in; nothing here decides anything."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseWithCovariance, Vector3
from std_msgs.msg import Header
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesis, ObjectHypothesisWithPose
from visualization_msgs.msg import Marker, MarkerArray

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.places import Place
from estimation.geometry.rotations import rotation_from_quaternion
from whereabouts.nodes.messages.conversions import FREE
from whereabouts.nodes.messages.markers import COLOURS, colour, marker, point, vector
from whereabouts.nodes.messages.stamps import NANOSECONDS, seconds, time_message
from whereabouts.nodes.messages.world_reading import attribute_messages, box_region, distribution_message
from whereabouts_msgs.msg import Region, WorldHypotheses
from whereabouts_msgs.msg import WorldObject as ObjectMessage
from whereabouts_msgs.msg import WorldState as StateMessage
from world_model import WorldObject, WorldState
from world_model.anchoring.attributes import extent
from world_model.queries import Words

IDENTITY = np.eye(4)
ABOVE = np.array([0.0, 0.0, 0.25])


@dataclass
class ObjectMessages:
    """Objects as messages, made once for each version of an object."""

    words: Words
    _made: dict[int, tuple[WorldObject, ObjectMessage]] = field(default_factory=dict)

    def message(self, item: WorldObject) -> ObjectMessage:
        """The message of an object in the world frame."""
        known = self._made.get(id(item))
        if known is not None and known[0] is item:
            return known[1]
        made = object_message(self.words.described(item), IDENTITY)
        self._made[id(item)] = (item, made)
        return made

    def keep(self, objects: Iterable[WorldObject]) -> None:
        wanted = {id(item) for item in objects}
        self._made = {number: made for number, made in self._made.items() if number in wanted}


def object_message(item: WorldObject, transform: Array) -> ObjectMessage:
    """A described object, in the frame that `transform` (4, 4) leads to."""
    message = ObjectMessage(
        id=item.id,
        class_distribution=distribution_message(item.attributes.get("class", {})),
        properties=attribute_messages(item.attributes, item.quantities),
        predicates=list(item.predicates),
        pose=pose_message(item, transform),
        behaviors=distribution_message(item.behaviors),
        existence_probability=_share(item.existence),
        lost=item.lost,
        place=item.place,
        place_probability=_share(item.place_probability),
        last_seen=stamp_message(item.last_seen),
        first_seen=stamp_message(item.first_seen),
        alternatives=list(item.alternatives),
    )
    known = extent(item.quantities)
    if known is not None:
        width, height = known
        message.size = Vector3(x=width, y=width, z=height)
    message.velocity.twist.linear = vector(transform[:3, :3] @ item.velocity)
    if item.lost and item.region is not None:
        low, high = np.array(item.region, dtype=np.float64).T
        message.region = box_region(0.5 * (low + high), high - low)
    return message


def pose_message(item: WorldObject, transform: Array) -> PoseWithCovariance:
    """Position and its covariance; the orientation is unknown."""
    message = PoseWithCovariance()
    turn = transform[:3, :3]
    message.pose.position = point(turn @ item.position + transform[:3, 3])
    covariance = np.diag(np.full(6, FREE))
    covariance[:3, :3] = turn @ item.covariance @ turn.T
    message.covariance = covariance.reshape(36)
    return message


def state_message(state: WorldState, header: Header, objects: Sequence[ObjectMessage]) -> StateMessage:
    """One hypothesis."""
    return StateMessage(
        header=header,
        objects=objects,
        probability=_share(state.probability),
        expected_count=float(state.expected_count),
        hypothesis=state.hypothesis,
        epoch=state.epoch,
    )


def hypotheses_message(
    states: Sequence[WorldState], header: Header, messages: ObjectMessages
) -> WorldHypotheses:
    """Hypotheses, whose probabilities are made to sum to one where some were left out."""
    total = sum(state.probability for state in states) or 1.0
    made = []
    for state in states:
        objects = [messages.message(item) for item in by_id(state.objects)]
        made.append(state_message(state, header, objects))
        made[-1].probability = state.probability / total
    return WorldHypotheses(header=header, hypotheses=made)


def detections_message(header: Header, objects: Sequence[ObjectMessage]) -> Detection3DArray:
    """What exists and is not lost, for software that knows vision_msgs only."""
    detections = []
    for item in objects:
        if item.lost:
            continue
        made = Detection3D(header=header, id=item.id)
        made.bbox.center = item.pose.pose
        made.bbox.size = item.size
        classes = item.class_distribution
        for name, probability in zip(classes.values, classes.probabilities, strict=True):
            hypothesis = ObjectHypothesis(class_id=name, score=probability * item.existence_probability)
            made.results.append(ObjectHypothesisWithPose(hypothesis=hypothesis, pose=item.pose))
        made.results.sort(key=lambda result: -result.hypothesis.score)
        detections.append(made)
    return Detection3DArray(header=header, detections=detections)


def marker_messages(header: Header, objects: Sequence[WorldObject], words: Words) -> MarkerArray:
    """An ellipsoid of one standard deviation and a sentence per object; lost ones only have the sentence."""
    stamp = seconds(header.stamp)
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for index, item in enumerate(objects):
        rgb = COLOURS[sum(map(ord, item.most_probable("class"))) % len(COLOURS)]
        white = colour((1.0, 1.0, 1.0), float(item.existence))
        label = marker(header, "symbols", Marker.TEXT_VIEW_FACING, white, 0.12, index)
        label.text = words.sentence(item, stamp)
        label.pose.position = point(item.position + ABOVE)
        markers.append(label)
        if item.lost:
            continue
        paint = colour(rgb, 0.3 + 0.6 * float(item.existence))
        body = marker(header, "objects", Marker.SPHERE, paint, number=index)
        spread = np.sqrt(np.maximum(item.covariance.diagonal(), 1e-4))
        body.scale = vector(np.maximum(2.0 * spread, 0.06))
        body.pose.position = point(item.position)
        markers.append(body)
    return MarkerArray(markers=markers)


def region_from_message(message: Region, transform: Array) -> Place | str | None:
    """A region of a request in the frame that `transform` leads to: a name, a polygon or a box; None where it is empty.

    Raises InputError: corners or sizes that make no sense.
    """
    if len(message.polygon):
        corners = np.array([[p.x, p.y, 0.0] for p in message.polygon])
    else:
        size = np.array([message.size.x, message.size.y, message.size.z])
        if not size.any():
            return message.name or None
        if not np.isfinite(size).all() or (size[:2] <= 0.0).any() or size[2] < 0.0:
            raise InputError(f"region.size: lengths above 0 m expected, got {size.tolist()}")
        p, q = message.center.position, message.center.orientation
        half = 0.5 * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) * size
        turn = rotation_from_quaternion([q.x, q.y, q.z, q.w])
        corners = half @ turn.T + [p.x, p.y, p.z]
    corners = corners @ transform[:3, :3].T + transform[:3, 3]
    given: dict[str, Any] = {"polygon": corners[:, :2]}
    if not len(message.polygon) and message.size.z > 0.0:
        z = float(corners[:, 2].mean())
        given["height"] = (z - 0.5 * message.size.z, z + 0.5 * message.size.z)
    return Place.checked(message.name or "region", given)


def by_id(objects: Iterable[WorldObject]) -> list[WorldObject]:
    """Objects in the order in which messages have them."""
    return sorted(objects, key=lambda item: item.id)


def stamp_message(seconds: float) -> Any:
    """Seconds as a message stamp; what is before time began is zero."""
    return time_message(max(round(seconds * NANOSECONDS), 0) if np.isfinite(seconds) else 0)


def _share(value: float) -> float:
    return min(max(float(value), 0.0), 1.0)
