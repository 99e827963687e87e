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
from whereabouts.messages.decode import NANOSECONDS
from whereabouts.nodes.messages.message_types import definition
from whereabouts.recorded.world_log import EVIDENCE
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
        """A message."""
        return self._store.types[type_name](**fields)

    def topic(self, name: str, type_name: str) -> Topic:
        """A topic with the definition of its type."""
        return Topic(name, type_name, self._definitions[type_name])

    def serialized(self, message: Any, type_name: str) -> bytes:
        """CDR bytes."""
        return bytes(self._store.serialize_cdr(message, type_name))

    def time(self, stamp: float) -> Any:
        """builtin_interfaces/Time of seconds."""
        total = round(stamp * NANOSECONDS)
        return self.make("builtin_interfaces/msg/Time", sec=total // NANOSECONDS, nanosec=total % NANOSECONDS)

    def header(self, stamp: float, frame: str) -> Any:
        """std_msgs/Header."""
        return self.make("std_msgs/msg/Header", stamp=self.time(stamp), frame_id=frame)

    def distribution(self, values: Mapping[str, float]) -> Any:
        """whereabouts_msgs/DiscreteDistribution."""
        return self.make(
            "whereabouts_msgs/msg/DiscreteDistribution",
            values=list(values),
            probabilities=np.array(list(values.values()), dtype=np.float64),
        )

    def vector(self, kind: str, values: Any) -> Any:
        """geometry_msgs/Point or Vector3 of (3,)."""
        return self.make(f"geometry_msgs/msg/{kind}", **dict(zip("xyz", map(float, values), strict=True)))

    def pose(self, position: Any, yaw: float = 0.0) -> Any:
        """geometry_msgs/Pose of position (3,) and yaw."""
        x, y, z, w = (float(value) for value in quaternion_from_euler([0.0, 0.0, yaw]))
        turn = self.make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)
        return self.make("geometry_msgs/msg/Pose", position=self.vector("Point", position), orientation=turn)

    def evidence(self, evidence: WorldEvidence, stamp: float, frame: str) -> Any:
        """whereabouts_msgs/WorldEvidence."""
        view = [] if evidence.sensor is None else [self._view(evidence.sensor)]
        return self.make(
            EVIDENCE,
            header=self.header(stamp, frame),
            sensor="",
            field_of_view=view,
            blocked=evidence.blocked,
            objects=[self._object(item) for item in evidence.objects],
        )

    def _object(self, item: ObjectEvidence) -> Any:
        covariance = np.zeros((6, 6))
        if item.covariance is not None:
            covariance[:3, :3] = item.covariance
        attributes = [self._attribute(name, values) for name, values in item.attributes.items()]
        attributes += [self._attribute(name, {}, *pair) for name, pair in item.quantities.items()]
        return self.make(
            "whereabouts_msgs/msg/ObjectEvidence",
            detection_id="",
            object_id=item.object_id or "",
            pose=self.make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self.pose(np.asarray(item.position, dtype=np.float64)),
                covariance=covariance.reshape(36),
            ),
            has_orientation=False,
            size=self.vector("Vector3", np.zeros(3)),
            attributes=attributes,
            existence_probability=0.0,
        )

    def _attribute(self, name: str, discrete: Mapping[str, float], *gaussian: float) -> Any:
        """Of named values, or of a number: its mean and variance."""
        continuous = self.make(
            "whereabouts_msgs/msg/GaussianDistribution",
            mean=np.array(gaussian[:1]),
            covariance=np.array(gaussian[1:]),
        )
        return self.make(
            "whereabouts_msgs/msg/Attribute",
            name=name,
            discrete=self.distribution(discrete),
            continuous=continuous,
        )

    def _view(self, sensor: Any) -> Any:
        x, y, z, yaw = sensor["pose"]
        return self.make(
            "whereabouts_msgs/msg/FieldOfView",
            pose=self.pose(np.array([x, y, z]), float(yaw)),
            range_min=float(sensor.get("range_min", 0.0)),
            range_max=float(sensor["range"]),
            horizontal_angle=min(float(sensor["angle"]), 2.0 * math.pi),
            vertical_angle=float(sensor.get("vertical_angle", 0.0)),
        )


class EvidenceWriter(McapWriter):
    """A bag with evidence on the topic /evidence.

    frame : that of all positions. Raises InputError where the suite's messages are not installed.
    """

    def __init__(self, path: Path, frame: str = "map") -> None:
        super().__init__(path)
        self._messages = SuiteMessages(EVIDENCE)
        self._frame = frame
        self._topic = self._messages.topic("/evidence", EVIDENCE)

    def write(self, evidence: WorldEvidence, stamp: float) -> None:
        """One message, stamped and recorded at `stamp` seconds."""
        message = self._messages.evidence(evidence, stamp, self._frame)
        self.write_raw(self._topic, self._messages.serialized(message, EVIDENCE), round(stamp * NANOSECONDS))
