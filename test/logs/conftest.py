"""Logs built on the spot: text by hand, bags by rosbags' own writers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from evaluation.datasets import recording

JAZZY = get_typestore(Stores.ROS2_JAZZY)
NOETIC = get_typestore(Stores.ROS1_NOETIC)
# rosbags' Noetic has no tf2_msgs, which bags of that time carry with its definition.
NOETIC.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
SECOND = 1_000_000_000


@pytest.fixture
def recorded() -> Callable[[str], Path]:
    """Path of a recording; the test is skipped where it is absent."""

    def find(relative: str) -> Path:
        path = recording(relative)
        if path is None:
            pytest.skip(f"recording {relative} is not on this machine")
        return path

    return find


def flaser(
    ranges: Sequence[float],
    laser: Sequence[float] = (1, 2, 0.5),
    robot: Sequence[float] = (1, 2, 0.5),
    stamp: float = 10.0,
    keyword: str = "FLASER",
) -> str:
    """A FLASER line."""
    numbers = " ".join(f"{value}" for value in ranges)
    poses = " ".join(f"{value}" for value in (*laser, *robot))
    return f"{keyword} {len(ranges)} {numbers} {poses} {stamp} host {stamp}\n"


def robotlaser(
    ranges: Sequence[float],
    laser: Sequence[float] = (1, 2, 0.5),
    robot: Sequence[float] = (1, 2, 0.5),
    stamp: float = 10.0,
    head: str = "0 -1.570796 3.141593 0.017453 50.0 0.01 0",
    keyword: str = "ROBOTLASER1",
    remissions: Sequence[float] = (),
) -> str:
    """A ROBOTLASER1 line."""
    numbers = " ".join(f"{value}" for value in ranges)
    extra = "".join(f"{value} " for value in remissions)
    poses = " ".join(f"{value}" for value in (*laser, *robot))
    return (
        f"{keyword} {head} {len(ranges)} {numbers} {len(remissions)} {extra}{poses} 0 0 0 0 0 "
        f"{stamp} host {stamp}\n"
    )


def odom(pose: Sequence[float], stamp: float = 10.0, speed: float = 0.5, turn: float = 0.1) -> str:
    """An ODOM line."""
    return f"ODOM {pose[0]} {pose[1]} {pose[2]} {speed} {turn} 0 {stamp} host {stamp}\n"


@pytest.fixture
def lines() -> Any:
    """Makers of log lines."""

    class CountedLines:
        pass

    made = CountedLines()
    made.flaser, made.robotlaser, made.odom = flaser, robotlaser, odom  # type: ignore[attr-defined]
    return made


class Messages:
    """Makers of ROS messages of one typestore."""

    def __init__(self, store: Any, ros1: bool = False) -> None:
        self.store = store
        self.ros1 = ros1

    def make(self, kind: str, /, **fields: Any) -> Any:
        return self.store.types[kind](**fields)

    def header(self, stamp_ns: int, frame: str) -> Any:
        time = self.make("builtin_interfaces/msg/Time", sec=stamp_ns // SECOND, nanosec=stamp_ns % SECOND)
        extra = {"seq": 7} if self.ros1 else {}
        return self.make("std_msgs/msg/Header", stamp=time, frame_id=frame, **extra)

    def scan(self, stamp_ns: int, ranges: Iterable[float], frame: str = "/laser", **other: Any) -> Any:
        values = {
            "angle_min": -1.0,
            "angle_max": 1.0,
            "angle_increment": 0.1,
            "time_increment": 0.0,
            "scan_time": 0.1,
            "range_min": 0.1,
            "range_max": 30.0,
        } | other
        return self.make(
            "sensor_msgs/msg/LaserScan",
            header=self.header(stamp_ns, frame),
            ranges=np.array(list(ranges), dtype=np.float32),
            intensities=np.zeros(0, dtype=np.float32),
            **values,
        )

    def point(self, x: float, y: float, z: float, name: str = "Vector3") -> Any:
        return self.make(f"geometry_msgs/msg/{name}", x=x, y=y, z=z)

    def quaternion(self, yaw: float) -> Any:
        return self.make(
            "geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=float(np.sin(yaw / 2)), w=float(np.cos(yaw / 2))
        )

    def odometry(self, stamp_ns: int, pose: Sequence[float], covariance: Any = None) -> Any:
        values = np.zeros(36) if covariance is None else np.asarray(covariance, dtype=np.float64)
        posed = self.make(
            "geometry_msgs/msg/Pose",
            position=self.point(pose[0], pose[1], 0.0, "Point"),
            orientation=self.quaternion(pose[2]),
        )
        twist = self.make(
            "geometry_msgs/msg/Twist", linear=self.point(0.4, 0.0, 0.0), angular=self.point(0.0, 0.0, 0.2)
        )
        return self.make(
            "nav_msgs/msg/Odometry",
            header=self.header(stamp_ns, "/odom"),
            child_frame_id="base_link",
            pose=self.make("geometry_msgs/msg/PoseWithCovariance", pose=posed, covariance=values),
            twist=self.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=np.zeros(36)),
        )

    def transform(self, stamp_ns: int, parent: str, child: str, pose: Sequence[float]) -> Any:
        return self.make(
            "geometry_msgs/msg/TransformStamped",
            header=self.header(stamp_ns, parent),
            child_frame_id=child,
            transform=self.make(
                "geometry_msgs/msg/Transform",
                translation=self.point(pose[0], pose[1], 0.0),
                rotation=self.quaternion(pose[2]),
            ),
        )

    def tf(self, *stamped: Any) -> Any:
        return self.make("tf2_msgs/msg/TFMessage", transforms=list(stamped))

    def string(self, text: str) -> Any:
        return self.make("std_msgs/msg/String", data=text)


@pytest.fixture
def jazzy() -> Messages:
    """Makers of ROS 2 messages."""
    return Messages(JAZZY)


@pytest.fixture
def noetic() -> Messages:
    """Makers of ROS 1 messages."""
    return Messages(NOETIC, ros1=True)


Entry = tuple[str, str, int, Any]


@pytest.fixture
def bag2() -> Callable[..., Path]:
    """Writes a rosbag2 directory from (topic, type, log time, message) with rosbags."""

    def write(
        path: Path,
        entries: Iterable[Entry],
        plugin: StoragePlugin = StoragePlugin.MCAP,
        mode: CompressionMode = CompressionMode.NONE,
        qos: Sequence[Any] = (),
    ) -> Path:
        writer = Writer2(path, version=9, storage_plugin=plugin)
        if mode != CompressionMode.NONE:
            writer.set_compression(mode, CompressionFormat.ZSTD)
        connections: dict[str, Any] = {}
        with writer:
            for topic, kind, time, message in entries:
                if topic not in connections:
                    connections[topic] = writer.add_connection(
                        topic, kind, typestore=JAZZY, offered_qos_profiles=list(qos)
                    )
                writer.write(connections[topic], time, JAZZY.serialize_cdr(message, kind))
        return path

    return write


@pytest.fixture
def bag1() -> Callable[..., Path]:
    """Writes a ROS 1 bag from (topic, type, log time, message) with rosbags."""

    def write(
        path: Path, entries: Iterable[Entry], compression: str | None = None, chunk: int = 4096
    ) -> Path:
        writer = Writer1(path)
        writer.chunk_threshold = chunk
        if compression:
            writer.set_compression(Writer1.CompressionFormat[compression.upper()])
        connections: dict[str, Any] = {}
        with writer:
            for topic, kind, time, message in entries:
                if topic not in connections:
                    connections[topic] = writer.add_connection(topic, kind, typestore=NOETIC)
                writer.write(connections[topic], time, NOETIC.serialize_ros1(message, kind))
        return path

    return write


@pytest.fixture
def entries() -> Callable[..., list[Entry]]:
    """A small drive: scans, odometry, tf and a topic of another type, every 0.1 s."""

    def make(messages: Messages, count: int = 30, beams: int = 21) -> list[Entry]:
        made: list[Entry] = []
        for number in range(count):
            time = 100 * SECOND + number * SECOND // 10
            ranges = 1.0 + 0.01 * np.arange(beams) + 0.1 * number
            pose = (0.1 * number, -0.05 * number, 0.01 * number)
            made.append(("/wheel_odom", "nav_msgs/msg/Odometry", time, messages.odometry(time, pose)))
            tf = messages.tf(messages.transform(time, "/odom", "/base_link", pose))
            made.append(("/tf", "tf2_msgs/msg/TFMessage", time + 1, tf))
            made.append(("/scan", "sensor_msgs/msg/LaserScan", time + 2, messages.scan(time, ranges)))
            made.append(("/chatter", "std_msgs/msg/String", time + 3, messages.string(f"n {number}")))
        return made

    return make
