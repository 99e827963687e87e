"""Writes evidence as a bag that `whereabouts world` and the node world_model take, without ROS."""

from __future__ import annotations

import math
from pathlib import Path
from types import TracebackType
from typing import Any

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from estimation.errors import InputError
from estimation.rotations import quaternion_from_euler
from whereabouts.logs import McapWriter, Topic
from whereabouts.nodes.interfaces import definition
from whereabouts.world_log import EVIDENCE, NANOSECONDS
from world_model import ObjectEvidence, WorldEvidence


class EvidenceWriter:
    """A bag with evidence on the topic /evidence; a context manager.

    frame : that of all positions. Raises InputError where the suite's messages are not installed.
    """

    def __init__(self, path: Path, frame: str = "map") -> None:
        text = definition(EVIDENCE)
        if not text:
            raise InputError(f"{EVIDENCE} is not installed: its definition is part of every bag")
        self._frame = frame
        self._store = get_typestore(Stores.ROS2_JAZZY)
        self._store.register(
            {k: v for k, v in get_types_from_msg(text, EVIDENCE).items() if k not in self._store.fielddefs}
        )
        self._topic = Topic("/evidence", EVIDENCE, text)
        self._writer = McapWriter(path)

    def __enter__(self) -> EvidenceWriter:
        self._writer.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._writer.__exit__(kind, error, trace)

    def write(self, evidence: WorldEvidence, stamp: float) -> None:
        """One message, stamped and recorded at `stamp` seconds."""
        total = round(stamp * NANOSECONDS)
        time = self._make(
            "builtin_interfaces/msg/Time", sec=total // NANOSECONDS, nanosec=total % NANOSECONDS
        )
        header = self._make("std_msgs/msg/Header", stamp=time, frame_id=self._frame)
        view = [] if evidence.sensor is None else [self._view(evidence.sensor)]
        message = self._make(
            EVIDENCE,
            header=header,
            sensor="",
            field_of_view=view,
            blocked=evidence.blocked,
            objects=[self._object(item) for item in evidence.objects],
        )
        self._writer.write_raw(self._topic, bytes(self._store.serialize_cdr(message, EVIDENCE)), total)

    def _object(self, item: ObjectEvidence) -> Any:
        covariance = np.zeros((6, 6))
        if item.covariance is not None:
            covariance[:3, :3] = item.covariance
        attributes = [
            self._make(
                "whereabouts_msgs/msg/Attribute",
                name=name,
                discrete=self._make(
                    "whereabouts_msgs/msg/DiscreteDistribution",
                    values=list(values),
                    probabilities=np.array(list(values.values()), dtype=np.float64),
                ),
                continuous=self._make(
                    "whereabouts_msgs/msg/GaussianDistribution", mean=np.zeros(0), covariance=np.zeros(0)
                ),
            )
            for name, values in item.attributes.items()
        ]
        return self._make(
            "whereabouts_msgs/msg/ObjectEvidence",
            detection_id="",
            object_id=item.object_id or "",
            pose=self._make(
                "geometry_msgs/msg/PoseWithCovariance",
                pose=self._pose(np.asarray(item.position, dtype=np.float64), 0.0),
                covariance=covariance.reshape(36),
            ),
            has_orientation=False,
            size=self._make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0),
            attributes=attributes,
            existence_probability=0.0,
        )

    def _view(self, sensor: Any) -> Any:
        x, y, z, yaw = sensor["pose"]
        return self._make(
            "whereabouts_msgs/msg/FieldOfView",
            pose=self._pose(np.array([x, y, z]), float(yaw)),
            range_min=float(sensor.get("range_min", 0.0)),
            range_max=float(sensor["range"]),
            horizontal_angle=min(float(sensor["angle"]), 2.0 * math.pi),
            vertical_angle=float(sensor.get("vertical_angle", 0.0)),
        )

    def _pose(self, position: np.ndarray, yaw: float) -> Any:
        x, y, z, w = (float(value) for value in quaternion_from_euler([0.0, 0.0, yaw]))
        return self._make(
            "geometry_msgs/msg/Pose",
            position=self._make(
                "geometry_msgs/msg/Point", **dict(zip("xyz", map(float, position), strict=True))
            ),
            orientation=self._make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w),
        )

    def _make(self, type_name: str, **fields: Any) -> Any:
        return self._store.types[type_name](**fields)
