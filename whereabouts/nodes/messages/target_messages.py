"""Messages of `target_tracker`: tracked people out as targets and markers; nothing here decides anything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from estimation.checks import FloatArray as Array
from tracking.people.people_tracker import Person
from whereabouts.nodes.messages.markers import COLOURS, colour, marker, point, vector
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts_msgs.msg import DiscreteDistribution, TargetArray
from whereabouts_msgs.msg import Target as TargetMessage


def targets_message(header: Header, people: Sequence[Person], expected_count: float) -> TargetArray:
    return TargetArray(
        header=header, targets=[_target(person) for person in people], expected_count=float(expected_count)
    )


def _target(person: Person) -> TargetMessage:
    return TargetMessage(
        label=person.label,
        label_probability=person.label_probability,
        position=point(person.mean[:2]),
        velocity=vector((*person.mean[2:], 0.0)),
        state_covariance=person.covariance.reshape(16),
        weight=float(person.weight),
        extent=person.extent.reshape(4),
        measurement_rate=float(person.rate),
        class_distribution=DiscreteDistribution(
            values=["person", "other"], probabilities=[person.person, 1.0 - person.person]
        ),
        last_seen=time_message(round(person.last_seen * NANOSECONDS)),
        occluded=person.occluded,
    )


def people_markers(
    header: Header, people: Sequence[Person], trails: Mapping[int, Sequence[Array]]
) -> MarkerArray:
    """Per person an ellipse of its extent, a velocity arrow, its number, and where it has been."""
    markers = [Marker(header=header, action=Marker.DELETEALL)]
    for person in people:
        paint = colour(COLOURS[person.label % len(COLOURS)], 0.35 if person.occluded else 0.9)
        position = point(person.mean[:2])
        markers.append(_body(header, person, position, paint))
        markers.append(_arrow(header, person, position, paint))
        text = marker(header, "label", Marker.TEXT_VIEW_FACING, paint, 0.25, person.label)
        text.pose.position = point(person.mean[:2], 1.9)
        text.text = f"{person.label}{' (hidden)' if person.occluded else ''}"
        markers.append(text)
        trail = trails.get(person.label, ())
        if len(trail) >= 2:
            line = marker(header, "trail", Marker.LINE_STRIP, paint, 0.04, person.label)
            line.points = [point(spot) for spot in trail]
            markers.append(line)
    return MarkerArray(markers=markers)


def _body(header: Header, person: Person, position: Point, paint: ColorRGBA) -> Marker:
    """A cylinder as wide as two standard deviations of what is seen of the person."""
    values, vectors = np.linalg.eigh(person.extent)
    widths = 4.0 * np.sqrt(np.maximum(values, 0.05**2))
    turn = float(np.arctan2(vectors[1, 1], vectors[0, 1]))
    body = marker(header, "extent", Marker.CYLINDER, paint, number=person.label)
    body.pose.position = Point(x=position.x, y=position.y, z=0.8)
    body.pose.orientation.z, body.pose.orientation.w = float(np.sin(0.5 * turn)), float(np.cos(0.5 * turn))
    body.scale = Vector3(x=float(widths[1]), y=float(widths[0]), z=1.6)
    return body


def _arrow(header: Header, person: Person, position: Point, paint: ColorRGBA) -> Marker:
    """Where the person will be in a second."""
    arrow = marker(header, "velocity", Marker.ARROW, paint, number=person.label)
    arrow.scale = Vector3(x=0.05, y=0.1, z=0.1)
    arrow.points = [position, point(person.mean[:2] + person.mean[2:])]
    return arrow
