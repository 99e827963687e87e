"""Messages of all types by their definitions, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from whereabouts.logs import McapWriter, Topic

ROOT = Path(__file__).resolve().parents[2]


class ShownMessages:
    """Makes messages, every field that is not given at its default, and writes them to bags."""

    def __init__(self) -> None:
        self.store = get_typestore(Stores.ROS2_JAZZY)
        for path in sorted((ROOT / "whereabouts_msgs/msg").glob("*.msg")):
            name = f"whereabouts_msgs/msg/{path.stem}"
            self.store.register(get_types_from_msg(path.read_text(encoding="utf-8"), name))

    def make(self, kind: str, **given: Any) -> Any:
        name = kind.replace("/", "/msg/")
        fields = dict(self.store.fielddefs[name][1])
        unknown = set(given) - set(fields)
        assert not unknown, f"{kind} has no {unknown}"
        values = {
            field: given[field] if field in given else self._default(of) for field, of in fields.items()
        }
        return self.store.types[name](**values)

    def _default(self, of: Any) -> Any:
        kind, detail = of
        if kind == Nodetype.BASE:
            return "" if detail[0] == "string" else (False if detail[0] == "bool" else 0)
        if kind == Nodetype.NAME:
            return self.make(detail.replace("/msg/", "/"))
        (inner, what), count = detail
        if inner == Nodetype.BASE and what[0] != "string":
            return np.zeros(count if kind == Nodetype.ARRAY else 0, dtype=what[0])
        return [self._default((inner, what)) for _ in range(count if kind == Nodetype.ARRAY else 0)]

    def header(self, stamp: float, frame: str) -> Any:
        nanoseconds = round(stamp * 1e9)
        time = self.make("builtin_interfaces/Time", sec=nanoseconds // 10**9, nanosec=nanoseconds % 10**9)
        return self.make("std_msgs/Header", stamp=time, frame_id=frame)

    def point(self, x: float, y: float, z: float = 0.0, kind: str = "Point") -> Any:
        return self.make(f"geometry_msgs/{kind}", x=x, y=y, z=z)

    def pose(self, x: float, y: float, yaw: float = 0.0) -> Any:
        turn = self.make("geometry_msgs/Quaternion", z=np.sin(yaw / 2), w=np.cos(yaw / 2))
        return self.make("geometry_msgs/Pose", position=self.point(x, y), orientation=turn)

    def transform(self, parent: str, child: str, stamp: float, x: float, y: float, yaw: float) -> Any:
        pose = self.pose(x, y, yaw)
        place = self.make(
            "geometry_msgs/Transform", translation=self.point(x, y, kind="Vector3"), rotation=pose.orientation
        )
        stamped = self.make(
            "geometry_msgs/TransformStamped",
            header=self.header(stamp, parent), child_frame_id=child, transform=place,
        )  # fmt: skip
        return self.make("tf2_msgs/TFMessage", transforms=[stamped])

    def write(self, writer: McapWriter, topic: str, kind: str, message: Any, stamp: float) -> None:
        name = kind.replace("/", "/msg/")
        text, _ = self.store.generate_msgdef(name, ros_version=2)
        data = bytes(self.store.serialize_cdr(message, name))
        writer.write_raw(Topic(f"/{topic}", name, text), data, round(stamp * 1e9))


@pytest.fixture(scope="session")
def messages() -> ShownMessages:
    return ShownMessages()
