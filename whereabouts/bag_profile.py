"""What a bag offers the suite: which topics are sensors, and in which frame the robot is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any

from whereabouts.log_errors import NothingRecognisedError
from whereabouts.logs import CloudRecord, ScanRecord, TransformRecord, open_log, open_raw

SCAN, CLOUD, ODOMETRY = "sensor_msgs/msg/LaserScan", "sensor_msgs/msg/PointCloud2", "nav_msgs/msg/Odometry"
# Transforms are repeated every few messages; a bag in which none of these is one has none.
LOOK_AT = 3000
WHEEL_TOPICS = ("/wheel_odom", "/odom", "/wheel_odometry")
BASE_FRAMES = ("base_link", "base_footprint")


@dataclass(frozen=True)
class BagProfile:
    """How to run `scan_registration` on a bag.

    parameters, remappings : for the node. notes : sentences about what was chosen and why.
    """

    parameters: Mapping[str, Any]
    remappings: Mapping[str, str]
    notes: tuple[str, ...]


def profile_of(bag: Path) -> BagProfile:
    """Look into a bag.

    Scans are preferred to clouds. Without a transform from the sensor to `base_link` in the bag the sensor's own frame
    stands for the robot's, so that recordings of a bare sensor can be replayed.

    Raises
    ------
    NothingRecognisedError : there are neither scans nor clouds.
    """
    with open_raw(bag) as log:
        topics = {topic.name: topic.type_name for topic in log.topics}
    scans = sorted(name for name, kind in topics.items() if kind == SCAN)
    clouds = sorted(name for name, kind in topics.items() if kind == CLOUD)
    # An Odometry topic may also be a mapper's result or ground truth, which must not be fed back.
    wheels = sorted(name for name, kind in topics.items() if kind == ODOMETRY and name in WHEEL_TOPICS)
    if not scans and not clouds:
        raise NothingRecognisedError(bag, "has neither LaserScan nor PointCloud2 messages")
    notes = []
    topic = scans[0] if scans else clouds[0]
    others = [name for name in (scans or clouds) if name != topic]
    if others:
        notes.append(f"following {topic}; there are also {', '.join(others)}")
    parameters: dict[str, Any] = {"scan_topics": [topic]} if scans else {"cloud_topics": [topic]}
    base, note = _base_frame(bag, topic)
    parameters["base_frame"] = base
    if note:
        notes.append(note)
    remappings = {"wheel_odom": wheels[0]} if wheels and "/wheel_odom" not in wheels else {}
    return BagProfile(parameters, remappings, tuple(notes))


def _base_frame(bag: Path, topic: str) -> tuple[str, str]:
    """The robot's frame, and a sentence where it is not `base_link`."""
    frames: set[str] = set()
    sensor = ""
    with open_log(bag) as log:
        for record in islice(log, LOOK_AT):
            if isinstance(record, TransformRecord):
                frames |= {record.frame_id, record.child_frame_id}
            elif isinstance(record, ScanRecord | CloudRecord) and record.topic.lstrip("/") == topic.lstrip(
                "/"
            ):
                sensor = sensor or record.frame_id
    for base in BASE_FRAMES:
        if base == sensor or {base, sensor} <= frames:
            return base, ""
    return (
        sensor,
        f"the bag has no transform from '{sensor}' to 'base_link': the sensor's frame stands for the robot's",
    )
