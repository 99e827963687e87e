"""What was seen of a robot, live or in a bag: topics, their rates and frames, transforms and clocks."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from estimation.checks import FloatArray as Array
from whereabouts.logs import Qos
from whereabouts.messages.type_names import CAMERA_INFO, COMPRESSED, IMAGE

# What scanners publish that no node takes, and what makes scans or clouds of it.
UNTAKEN = {
    "sensor_msgs/msg/MultiEchoLaserScan": "let the driver or laser_proc publish its first echo as LaserScan",
    "sensor_msgs/msg/PointCloud": "convert it with sensor_msgs' point_cloud_conversion to PointCloud2",
    "velodyne_msgs/msg/VelodyneScan": "run velodyne_pointcloud, which makes a PointCloud2 of it",
    "ouster_sensor_msgs/msg/PacketMsg": "run ouster_ros's os_cloud, which makes a PointCloud2 of it",
    "livox_ros_driver2/msg/CustomMsg": "set xfer_format: 0 in livox_ros_driver2, which then publishes PointCloud2",
    "sensor_msgs/msg/Range": "single beams are no scanner",
}
CAMERAS = (IMAGE, COMPRESSED, CAMERA_INFO)
# m that a transform leaps and leaps back by, from which on two publishers disagree.
LEAP = 0.02


@dataclass
class SeenTopic:
    """One topic.

    kind : type, such as "sensor_msgs/msg/LaserScan". publishers : names of nodes; empty where nobody can tell, as in a
    bag. qos : what they offer. count, frame, stamps : messages looked at, the frame of the last, and first and last
    stamp, s. lags : recorded or received time less stamp, s. range_max : of scans, m. empty : scans without a reading
    within their range, or refused. refused : messages that make no sense, by reason. child : child_frame_id of
    odometry. encoding : of images.
    """

    name: str
    kind: str
    publishers: tuple[str, ...] = ()
    qos: tuple[Qos, ...] = ()
    count: int = 0
    frame: str = ""
    child: str = ""
    encoding: str = ""
    stamps: tuple[float, float] | None = None
    lags: list[float] = field(default_factory=list)
    range_max: float | None = None
    empty: int = 0
    refused: Counter[str] = field(default_factory=Counter)

    def note(self, stamp: float, frame: str, received: float) -> None:
        self.count += 1
        self.frame = frame
        first = stamp if self.stamps is None else min(self.stamps[0], stamp)
        last = stamp if self.stamps is None else max(self.stamps[1], stamp)
        self.stamps = first, last
        self.lags.append(received - stamp)

    @property
    def blind(self) -> bool:
        return self.empty == self.count

    @property
    def unstamped(self) -> bool:
        """Whether all stamps are zero: nobody has set them."""
        return self.count > 1 and self.stamps == (0.0, 0.0)

    @property
    def rate(self) -> float:
        """Messages per second of stamps; 0 where one says nothing about it."""
        if self.stamps is None or self.count < 2 or self.stamps[1] <= self.stamps[0]:
            return 0.0
        return (self.count - 1) / (self.stamps[1] - self.stamps[0])

    @property
    def lag(self) -> float | None:
        """Median of the lags, s."""
        return float(np.median(self.lags)) if self.lags else None


@dataclass
class FrameEdge:
    """One transform: where `child` is in `parent`, as often as it was looked at.

    topics : it came on. stamps, places : of the moving one, s and (3,) m, in order of arrival. matrix : the last
    transform, (4, 4).
    """

    parent: str
    child: str
    static: bool
    topics: set[str] = field(default_factory=set)
    stamps: list[float] = field(default_factory=list)
    places: list[Array] = field(default_factory=list)
    matrix: Array = field(default_factory=lambda: np.eye(4))

    @property
    def disagreeing(self) -> bool:
        """Whether two publishers tell different places: it leaps there and back again and again, or is not static."""
        if self.static:
            return any(np.abs(place - self.places[0]).max() > LEAP for place in self.places[1:])
        places = np.array(self.places)
        if len(places) < 6:
            return False
        steps = np.linalg.norm(np.diff(places, axis=0), axis=1)
        over_two = np.linalg.norm(places[2:] - places[:-2], axis=1)
        smaller = np.minimum(steps[1:], steps[:-1])
        back = (smaller > LEAP) & (over_two < 0.5 * smaller)
        return bool(back.mean() > 0.2)


@dataclass
class Survey:
    """All that was seen.

    source : the bag, or "the running robot". live : whether it was running. seconds : that were looked at.
    left_out : what of a bag cannot be read, with the reason. troubles : what running nodes of the suite complain about.
    suite : their names.
    """

    source: str
    live: bool = False
    seconds: float = 0.0
    topics: dict[str, SeenTopic] = field(default_factory=dict)
    edges: dict[tuple[str, str], FrameEdge] = field(default_factory=dict)
    left_out: list[str] = field(default_factory=list)
    troubles: list[str] = field(default_factory=list)
    suite: frozenset[str] = frozenset()

    def of(self, *kinds: str) -> list[SeenTopic]:
        return [self.topics[name] for name in sorted(self.topics) if self.topics[name].kind in kinds]

    def add_transform(self, parent: str, child: str, matrix: Array, stamp: float, topic: str) -> None:
        """One transform that was heard; matrix (4, 4)."""
        static = topic.endswith("tf_static")
        edge = self.edges.setdefault((parent, child), FrameEdge(parent, child, static))
        edge.static = edge.static and static
        edge.topics.add(topic)
        edge.stamps.append(stamp)
        edge.matrix = np.asarray(matrix, dtype=np.float64)
        edge.places.append(edge.matrix[:3, 3])

    def tf_namespaces(self) -> list[str]:
        """Namespaces that tf came in, such as "/robot1"; "" where it is global."""
        topics = {topic for edge in self.edges.values() for topic in edge.topics}
        return sorted({f"/{topic.strip('/')}".rpartition("/")[0] for topic in topics})

    def parents(self, child: str) -> list[str]:
        return sorted({edge.parent for edge in self.edges.values() if edge.child == child})

    def chain(self, frame: str, known: frozenset[str] = frozenset()) -> list[str]:
        """A frame, its parent, and so on up to the root or to one that is known; of two parents the longer chain."""
        if frame in known:
            return []
        above = [self.chain(parent, known | {frame}) for parent in self.parents(frame)]
        return [frame, *max(above, key=len, default=[])]

    def mounting(self, sensor: str, base: str) -> Array | None:
        """Pose (4, 4) of a sensor on the robot; None where tf does not connect them."""
        chain = self.chain(sensor)
        if base not in chain:
            return None
        pose: Array = np.eye(4)
        for child, parent in pairwise(chain[: chain.index(base) + 1]):
            pose = self.edges[parent, child].matrix @ pose
        return pose

    def frames(self) -> set[str]:
        return {name for edge in self.edges for name in edge}


def names(items: Iterable[SeenTopic]) -> str:
    return ", ".join(item.name for item in items)
