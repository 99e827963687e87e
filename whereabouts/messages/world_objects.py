"""Worlds and objects from messages of `whereabouts_msgs`, by their fields."""

from __future__ import annotations

from typing import Any

import numpy as np

from estimation.errors import InputError
from whereabouts.messages.decode import pose_matrix, seconds
from world_model import WorldObject, WorldState


def state_from_message(message: Any) -> WorldState:
    """A WorldState; frames are the message's.

    Raises InputError: an object with a pose or a covariance that is not finite; names it.
    """
    objects = tuple(object_from_message(item) for item in message.objects)
    stamp = seconds(message.header.stamp)
    return WorldState(objects, message.probability, message.expected_count, stamp, int(message.epoch))


def object_from_message(message: Any) -> WorldObject:
    """One object.

    Raises InputError: a pose or a covariance that is not finite.
    """
    try:
        pose = pose_matrix(message.pose.pose.position, message.pose.pose.orientation)
    except InputError as error:
        raise InputError(f"object '{message.id}': {error}") from error
    covariance = np.array(message.pose.covariance).reshape(6, 6)[:3, :3]
    for name, values in (("pose", pose), ("covariance", covariance)):
        if not np.isfinite(values).all():
            raise InputError(f"object '{message.id}': its {name} is not finite")
    linear = message.velocity.twist.linear
    attributes = {"class": _distribution(message.class_distribution)}
    attributes |= {
        item.name: _distribution(item.discrete) for item in message.properties if len(item.discrete.values)
    }
    return WorldObject(
        message.id, pose[:3, 3], np.array([linear.x, linear.y, linear.z]), covariance, attributes,
        message.existence_probability, message.lost, seconds(message.last_seen), seconds(message.first_seen),
        place=message.place, place_probability=message.place_probability,
        predicates=tuple(message.predicates), alternatives=tuple(message.alternatives),
        quantities={
            item.name: (float(item.continuous.mean[0]), float(item.continuous.covariance[0]))
            for item in message.properties
            if len(item.continuous.mean) == 1 and len(item.continuous.covariance) == 1
        },
    )  # fmt: skip


def _distribution(message: Any) -> dict[str, float]:
    return dict(zip(message.values, map(float, message.probabilities), strict=False))
