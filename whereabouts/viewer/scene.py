"""Messages of the suite as shapes: the part of the viewer that knows the messages, and no viewer."""

from __future__ import annotations

from collections import Counter, OrderedDict
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from whereabouts.messages.decode import UnusableMessageError, clouds, nanoseconds, odometry, scans
from whereabouts.messages.message_rotations import planar_matrix
from whereabouts.messages.records import MAP_FRAME, ODOM_FRAME, strip_slash
from whereabouts.viewer.drawable import Array, Color, Lines, Points, Shape, TextNote
from whereabouts.viewer.fields import matrix_of, rows, xyz
from whereabouts.viewer.frames import Frames
from whereabouts.viewer.object_shapes import TASK, evidence, hypotheses, task, world
from whereabouts.viewer.people_shapes import predictions, targets

STATIC, MOVING, UNKNOWN = (90, 90, 90), (230, 40, 40), (190, 170, 120)
TRAVELLED, WHEELS, MAP, SEARCH = (60, 110, 230), (170, 170, 170), (40, 40, 40), (20, 160, 80)
OCCUPIED = 50
SCANS_KEPT = 50
USUAL_NAMES = {"targets": "people", "world_state": "objects"}
MOST_POINTS, TRAVEL_STEP = 20_000, 0.05  # of a cloud or of a way; m between two of a way
ROBOT = np.array([[-0.2, -0.2, 0.05], [0.3, 0.0, 0.05], [-0.2, 0.2, 0.05], [-0.2, -0.2, 0.05]])
ARROW = np.array([[0.0, 0.0, 0.0], [0.5, 0.0, 0.0], [0.35, 0.1, 0.0], [0.5, 0.0, 0.0], [0.35, -0.1, 0.0]])


class Scene:
    """What the suite has said so far, as far as it is needed to draw the next message.

    taken : messages that were used. skipped : those of a known type that could not be, by topic and reason.
    """

    def __init__(self) -> None:
        self.frames = Frames()
        self.skipped: Counter[str] = Counter()
        self.taken = 0
        self._scans: OrderedDict[tuple[str, int], tuple[Array, NDArray[np.bool_]]] = OrderedDict()
        self._travelled: dict[str, list[tuple[float, float, float]]] = {}
        self._leader = ""
        self._keyframes: dict[int, tuple[float, float, float]] = {}
        self._closures: dict[tuple[int, int], bool] = {}
        self._handlers: dict[str, Callable[[Any, str], Iterable[Shape]]] = {
            "sensor_msgs/msg/LaserScan": self._scan,
            "sensor_msgs/msg/PointCloud2": self._cloud,
            "nav_msgs/msg/Odometry": self._odometry,
            "nav_msgs/msg/OccupancyGrid": self._map,
            "nav_msgs/msg/Path": self._path,
            "geometry_msgs/msg/PoseStamped": self._goal,
            "tf2_msgs/msg/TFMessage": lambda message, topic: self.frames.take(message, topic),
            "whereabouts_msgs/msg/ScanSegments": self._segments,
            "whereabouts_msgs/msg/LoopClosure": self._closure,
            "whereabouts_msgs/msg/TargetArray": lambda m, topic: targets(m, self._place(m), _name(topic)),
            "whereabouts_msgs/msg/PredictedPathArray": lambda m, _: predictions(m, self._place(m)),
            "whereabouts_msgs/msg/WorldEvidence": lambda m, topic: evidence(m, self._place(m), _name(topic)),
            "whereabouts_msgs/msg/WorldState": lambda m, topic: world(m, self._place(m), _name(topic)),
            "whereabouts_msgs/msg/WorldHypotheses": lambda m, _: hypotheses(m),
            "whereabouts_msgs/msg/VerificationTask": lambda m, _: task(m, self._place(m)),
        }

    @property
    def types(self) -> frozenset[str]:
        return frozenset(self._handlers)

    def take(self, type_name: str, topic: str, message: Any) -> list[Shape]:
        """What a message of one of `types` changes in the picture; nothing, counted, where it cannot be used."""
        try:
            shapes = list(self._handlers[type_name](message, strip_slash(topic)))
        except (UnusableMessageError, ValueError, AttributeError, IndexError, TypeError) as error:
            self.skipped[f"{topic}: {error}"] += 1
            return []
        self.taken += 1
        return shapes

    def _place(self, message: Any) -> str:
        """Path of the frame of a message that is about the world."""
        return self.frames.path(message.header.frame_id)

    def _scan(self, message: Any, topic: str) -> Iterable[Shape]:
        for record in scans(message, topic):
            valid = record.scan.valid
            points = np.column_stack((record.scan.points(), np.zeros(int(valid.sum()))))
            key = (strip_slash(message.header.frame_id), nanoseconds(message.header.stamp))
            self._scans[key] = points, valid
            if len(self._scans) > SCANS_KEPT:
                self._scans.popitem(last=False)
            yield Points(f"{self.frames.path(record.frame_id, sensor=True)}/scan", points, STATIC)

    def _segments(self, message: Any, _: str) -> Iterable[Shape]:
        """The scan again, its beams coloured by whether they move."""
        key = (strip_slash(message.header.frame_id), nanoseconds(message.header.stamp))
        points, valid = self._scans.get(key, (None, None))
        labels = np.asarray(message.labels)
        if points is None or valid is None or len(labels) != len(valid):
            return
        labels = labels[valid]
        colors = np.full((len(labels), 3), STATIC, dtype=np.uint8)
        colors[labels > 0], colors[labels < 0] = MOVING, UNKNOWN
        yield Points(f"{self.frames.path(message.header.frame_id, sensor=True)}/scan", points, colors)

    def _cloud(self, message: Any, topic: str) -> Iterable[Shape]:
        for record in clouds(message, topic):
            step = max(1, -(-len(record.points) // MOST_POINTS))
            name = _name(topic)
            sensor = name not in ("map_points", "predicted_occupancy")
            path = f"{self.frames.path(record.frame_id, sensor)}/{name}"
            yield Points(path, record.points[::step], MAP if name == "map_points" else STATIC, 0.02)

    def _odometry(self, message: Any, topic: str) -> Iterable[Shape]:
        for record in odometry(message, topic):
            ours = _name(topic) == "odometry"
            base = strip_slash(record.child_frame_id)
            if not self.frames.knows(base) and strip_slash(record.frame_id) != MAP_FRAME:
                if ours or not self._leader:
                    self._leader = topic
                if topic == self._leader:
                    matrix = planar_matrix(record.pose) if record.transform is None else record.transform
                    yield self.frames.put(base, record.frame_id, matrix)
            if ours or topic == self._leader:
                yield Lines(f"{self.frames.path(base)}/robot", (ROBOT,), TRAVELLED, 0.05)
            yield from self._travel(topic, record.frame_id or ODOM_FRAME, record.pose, ours)

    def _travel(self, topic: str, frame: str, pose: Array, ours: bool) -> Iterable[Shape]:
        way = self._travelled.setdefault(topic, [])
        here = (float(pose[0]), float(pose[1]), 0.0)
        if way and np.hypot(here[0] - way[-1][0], here[1] - way[-1][1]) < TRAVEL_STEP:
            return
        way.append(here)
        del way[:-MOST_POINTS]
        # Every step a line of all steps would be quadratic in what is stored.
        if len(way) < 20 or len(way) % 10 == 0:
            name = _name(topic)
            yield Lines(
                f"{self.frames.path(frame)}/{name}", (rows(way),), TRAVELLED if ours else WHEELS, 0.03
            )

    def _map(self, message: Any, topic: str) -> Iterable[Shape]:
        info = message.info
        cells = np.asarray(message.data, dtype=np.int8).reshape(int(info.height), int(info.width))
        row, column = np.nonzero(cells >= OCCUPIED)
        centers = np.column_stack((column + 0.5, row + 0.5)) * float(info.resolution)
        origin = matrix_of(info.origin)
        points = np.column_stack((centers, np.zeros(len(centers)))) @ origin[:3, :3].T + origin[:3, 3]
        name = _name(topic)
        yield Points(f"{self._place(message)}/{name}", points, MAP, 0.5 * float(info.resolution))

    def _path(self, message: Any, topic: str) -> Iterable[Shape]:
        points = [xyz(item.pose.position) for item in message.poses]
        path = self._place(message)
        yield Lines(f"{path}/{topic.rpartition('/')[2]}", (rows(points),), TRAVELLED, 0.04)
        if _name(topic) == "trajectory":
            stamps = [nanoseconds(item.header.stamp) for item in message.poses]
            self._keyframes = dict(zip(stamps, points, strict=True))
            yield self._closure_lines(path)

    def _closure(self, message: Any, _: str) -> Iterable[Shape]:
        ends = nanoseconds(message.earlier_stamp), nanoseconds(message.header.stamp)
        self._closures[ends] = bool(message.accepted)
        yield TextNote("log/closures", str(message.reason))
        yield self._closure_lines(self.frames.path("map"))

    def _closure_lines(self, path: str) -> Lines:
        """Accepted closures between keyframes whose place is known."""
        known = self._keyframes
        joined = [
            ends for ends, accepted in self._closures.items() if accepted and all(e in known for e in ends)
        ]
        return Lines(f"{path}/closures", tuple(rows([known[a], known[b]]) for a, b in joined), MOVING, 0.05)

    def _goal(self, message: Any, topic: str) -> Iterable[Shape]:
        name = _name(topic)
        color: Color = SEARCH if name == "search_goal" else TASK
        matrix = matrix_of(message.pose)
        yield Lines(
            f"{self._place(message)}/{name}",
            (ARROW @ matrix[:3, :3].T + matrix[:3, 3],),
            color,
            0.06,
            (name,),
        )


def _name(topic: str) -> str:
    """What a topic's shapes are called; those of the suite by what they show."""
    return USUAL_NAMES.get(topic, topic.replace("/", "."))


def stamp_of(message: Any, log_time: int) -> float:
    """Time of a message in seconds: of its header where it has one that is set, else of recording."""
    header = getattr(message, "header", None)
    if header is None and getattr(message, "transforms", None):
        header = message.transforms[0].header
    stamp = 0 if header is None else nanoseconds(header.stamp)
    return (stamp or log_time) / 1e9
