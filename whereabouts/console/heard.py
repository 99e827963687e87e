"""What the suite has published, put together to one world. Messages come as objects: no ROS here."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import compound
from whereabouts.console.shown import Shown, empty, map_picture, moved, person, thing
from whereabouts.messages.decode import seconds
from whereabouts.messages.message_rotations import pose_in_plane
from whereabouts.messages.records import MAP_FRAME, strip_slash
from whereabouts.messages.world_objects import object_from_message

TASKS = 20
"""Decisions to look again that are kept."""
PEOPLE_AGE = 2.0
"""s after which a list of people that nobody renews is no longer shown."""
MOVERS = ("person", "other")
LEVELS = ("ok", "warning", "error", "stale")
TOPICS = {
    "map": "nav_msgs/msg/OccupancyGrid",
    "map_updates": "map_msgs/msg/OccupancyGridUpdate",
    "tf": "tf2_msgs/msg/TFMessage",
    "tf_static": "tf2_msgs/msg/TFMessage",
    "odometry": "nav_msgs/msg/Odometry",
    "targets": "whereabouts_msgs/msg/TargetArray",
    "predicted_paths": "whereabouts_msgs/msg/PredictedPathArray",
    "world_state": "whereabouts_msgs/msg/WorldState",
    "verification_tasks": "whereabouts_msgs/msg/VerificationTask",
    "search_goal": "geometry_msgs/msg/PoseStamped",
    "maintenance_goal": "geometry_msgs/msg/PoseStamped",
    "/diagnostics": "diagnostic_msgs/msg/DiagnosticArray",
}
"""What is listened to, relative to the suite's namespace."""
EVERY_ONE = frozenset({"tf", "tf_static", "map_updates", "verification_tasks", "/diagnostics"})
"""Of these each message counts, of the others the newest."""


class Heard:
    """Takes messages and tells the world they make. Not for several threads at once.

    namespace : of the suite, "" or "/robot1"; the health of other nodes on the graph is left out.
    """

    def __init__(self, namespace: str = "") -> None:
        self._namespace = namespace.strip("/")
        self.picture: bytes | None = None
        self._parents: dict[str, tuple[str, FloatArray]] = {}
        self._moving: set[str] = set()
        self._wheels: tuple[str, str] = ("", "")
        self._cells: Any = None
        self._grid: tuple[float, float, float] = (0.05, 0.0, 0.0)
        self._drawn = True
        self._map: Shown | None = None
        self._newest: dict[str, Any] = {}
        self._things: list[Shown] = []
        self._tasks: deque[Shown] = deque(maxlen=TASKS)
        self._goals: dict[str, Shown] = {}
        self._health: dict[str, Shown] = {}
        self._stamp = 0.0
        self._takers: dict[str, Callable[[Any], None]] = {
            "map": self._take_map,
            "map_updates": self._take_update,
            "tf": self._take_transforms,
            "tf_static": self._take_transforms,
            "odometry": self._take_odometry,
            "targets": lambda message: self._newest.update(targets=message),
            "predicted_paths": lambda message: self._newest.update(paths=message),
            "world_state": self._take_world,
            "verification_tasks": self._take_task,
            "search_goal": lambda message: self._take_goal("search", message),
            "maintenance_goal": lambda message: self._take_goal("maintenance", message),
            "/diagnostics": self._take_diagnostics,
        }

    def take(self, topic: str, message: Any) -> None:
        """One message of one of `TOPICS`. Raises ValueError or AttributeError where it cannot be used."""
        self._takers[topic](message)
        header = getattr(message, "header", None)
        if header is not None and topic != "/diagnostics":
            self._stamp = max(self._stamp, seconds(header.stamp))

    def world(self) -> Shown:
        """All of it. Where nothing says where the map is, positions are those of the odometry's frame."""
        self._draw()
        return {
            **empty(),
            "stamp": self._stamp or None,
            "robot": self._robot(),
            "people": self._people(),
            "things": self._things,
            "tasks": list(self._tasks),
            "goals": list(self._goals.values()),
            "health": [self._health[name] for name in sorted(self._health)],
            "map": self._map,
        }

    def _take_transforms(self, message: Any) -> None:
        for item in message.transforms:
            child = strip_slash(item.child_frame_id)
            self._parents[child] = (strip_slash(item.header.frame_id), pose_in_plane(item.transform))
            self._stamp = max(self._stamp, seconds(item.header.stamp))

    def _take_odometry(self, message: Any) -> None:
        child, frame = strip_slash(message.child_frame_id), strip_slash(message.header.frame_id)
        self._wheels = (child, frame)
        # A transform of this frame, where there is one, says the same.
        if child not in self._parents or child in self._moving:
            self._moving.add(child)
            self._parents[child] = (frame, pose_in_plane(message.pose.pose))

    def _pose(self, frame: str) -> FloatArray:
        """Where a frame is in the map, (3,), as far up as the transforms reach."""
        pose, seen = np.zeros(3), set()
        while frame != MAP_FRAME and frame in self._parents and frame not in seen:
            seen.add(frame)
            frame, step = self._parents[frame]
            pose = compound(step, pose)
        return pose

    def _robot(self) -> list[float] | None:
        if not self._wheels[0]:
            return None
        return [round(float(value), 3) for value in self._pose(self._wheels[0])]

    def _people(self) -> list[Shown]:
        fresh = {
            name: (message, self._pose(strip_slash(message.header.frame_id)))
            for name, message in self._newest.items()
            if self._stamp - seconds(message.header.stamp) <= PEOPLE_AGE
        }
        if "targets" not in fresh:
            return []
        message, pose = fresh["targets"]
        found = {int(target.label): person(target, pose) for target in message.targets}
        if "paths" in fresh:
            message, pose = fresh["paths"]
            for path in message.paths:
                if shown := found.get(int(path.label)):
                    shown["path"] = [moved(pose, point.position.x, point.position.y) for point in path.points]
                    shown["goals"] = [
                        [*moved(pose, goal.x, goal.y), round(float(probability), 3)]
                        for goal, probability in zip(path.goals, path.goal_probabilities, strict=False)
                    ]
        return list(found.values())

    def _take_world(self, message: Any) -> None:
        pose = self._pose(strip_slash(message.header.frame_id))
        # Who moves by itself is shown by the tracker.
        things = [thing(object_from_message(item)) for item in message.objects]
        things = [item for item in things if item["class"] not in MOVERS]
        for item in things:
            item["x"], item["y"] = moved(pose, item["x"], item["y"])
        self._things = things

    def _take_task(self, message: Any) -> None:
        self._tasks.append(
            {
                "object": str(message.object_id),
                "reason": str(message.reason),
                "stamp": seconds(message.header.stamp),
            }
        )

    def _take_goal(self, kind: str, message: Any) -> None:
        pose = compound(self._pose(strip_slash(message.header.frame_id)), pose_in_plane(message.pose))
        self._goals[kind] = {"kind": kind, "x": round(float(pose[0]), 3), "y": round(float(pose[1]), 3)}

    def _take_diagnostics(self, message: Any) -> None:
        for status in message.status:
            own = str(status.name).rpartition("/")[0] == self._namespace
            if not own or status.hardware_id != "whereabouts":
                continue
            level = status.level[0] if isinstance(status.level, bytes) else int(status.level)
            self._health[str(status.name)] = {
                "node": str(status.name),
                "level": LEVELS[min(level, 3)],
                "message": str(status.message),
            }

    def _take_map(self, message: Any) -> None:
        info = message.info
        height, width = int(info.height), int(info.width)
        self._cells = np.array(message.data, dtype=np.int8).reshape(height, width)
        corner = compound(self._pose(strip_slash(message.header.frame_id)), pose_in_plane(info.origin))
        self._grid = (float(info.resolution), float(corner[0]), float(corner[1]))
        self._drawn = False

    def _take_update(self, message: Any) -> None:
        if self._cells is None:
            return
        height, width = int(message.height), int(message.width)
        box = self._cells[message.y : message.y + height, message.x : message.x + width]
        box[:] = np.asarray(message.data, dtype=np.int8).reshape(height, width)
        self._drawn = False

    def _draw(self) -> None:
        if self._drawn or self._cells is None or not self._cells.size:
            return
        self.picture, box = map_picture(self._cells, *self._grid)
        number = 1 if self._map is None else self._map["number"] + 1
        self._map = {"box": [round(value, 3) for value in box], "number": number}
        self._drawn = True
