"""Writes evidence as a bag that `whereabouts world` and the node world_model take, without ROS."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from estimation.errors import InputError
from estimation.geometry.rotations import quaternion_from_euler
from whereabouts.logs import McapWriter, Topic
from whereabouts.logs.bags.encode import header, made, xyz, xyzw
from whereabouts.messages.type_names import EVIDENCE
from whereabouts.nodes.messages.message_types import definition
from whereabouts.system.clocks import NANOSECONDS
from world_model import ObjectEvidence, WorldEvidence


class SuiteMessages:
    """Messages of the suite's own types, made and serialised without ROS.

    types : names of those that are needed. Raises InputError where one of them is not installed.
    """

    def __init__(self, *types: str) -> None:
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._definitions: dict[str, str] = {}
        for name in types:
            text = definition(name)
            if not text:
                raise InputError(f"{name} is not installed: its definition is part of every bag")
            self._definitions[name] = text
            self._store.register(
                {k: v for k, v in get_types_from_msg(text, name).items() if k not in self._store.fielddefs}
            )

    def make(self, type_name: str, **fields: Any) -> Any:
        """A message, as `made` takes its fields."""
        return made(self._store, type_name, fields)

    def topic(self, name: str, type_name: str) -> Topic:
        """A topic with the definition of its type."""
        return Topic(name, type_name, self._definitions[type_name])

    def serialized(self, message: Any, type_name: str) -> bytes:
        """CDR bytes."""
        return bytes(self._store.serialize_cdr(message, type_name))

    def evidence(self, evidence: WorldEvidence, stamp: float, frame: str) -> Any:
        """whereabouts_msgs/WorldEvidence."""
        return self.make(
            EVIDENCE,
            header=header(round(stamp * NANOSECONDS), frame),
            field_of_view=[] if evidence.sensor is None else [_view(evidence.sensor)],
            blocked=evidence.blocked,
            objects=[_object(item) for item in evidence.objects],
        )


def pose(position: Any, yaw: float = 0.0) -> dict[str, Any]:
    """geometry_msgs/Pose of position (3,) and yaw."""
    return {"position": xyz(position), "orientation": xyzw(quaternion_from_euler([0.0, 0.0, yaw]))}


def distribution(values: Mapping[str, float]) -> dict[str, Any]:
    """whereabouts_msgs/DiscreteDistribution."""
    return {"values": list(values), "probabilities": list(values.values())}


def _object(item: ObjectEvidence) -> dict[str, Any]:
    covariance = np.zeros((6, 6))
    if item.covariance is not None:
        covariance[:3, :3] = item.covariance
    words = [{"name": name, "discrete": distribution(values)} for name, values in item.attributes.items()]
    numbers = [
        {"name": name, "continuous": {"mean": [mean], "covariance": [variance]}}
        for name, (mean, variance) in item.quantities.items()
    ]
    return {
        "object_id": item.object_id or "",
        "pose": {"pose": pose(item.position), "covariance": covariance.reshape(36)},
        "attributes": words + numbers,
    }


def _view(sensor: Any) -> dict[str, Any]:
    x, y, z, yaw = sensor["pose"]
    return {
        "pose": pose((x, y, z), float(yaw)),
        "range_min": float(sensor.get("range_min", 0.0)),
        "range_max": float(sensor["range"]),
        "horizontal_angle": min(float(sensor["angle"]), 2.0 * math.pi),
        "vertical_angle": float(sensor.get("vertical_angle", 0.0)),
    }


class EvidenceWriter(McapWriter):
    """A bag with evidence on the topic /evidence.

    Positions are in the map. Raises InputError where the suite's messages are not installed.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._messages = SuiteMessages(EVIDENCE)
        self._topic = self._messages.topic("/evidence", EVIDENCE)

    def write(self, evidence: WorldEvidence, stamp: float) -> None:
        """One message, stamped and recorded at `stamp` seconds."""
        message = self._messages.evidence(evidence, stamp, "map")
        self.write_raw(self._topic, self._messages.serialized(message, EVIDENCE), round(stamp * NANOSECONDS))
