"""What was true in the apartment and what the suite said about it, read from two bags."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import transform_points
from evaluation.demo.replayed import Replayed, read_replay
from whereabouts.logs import MessageRecord, OdometryRecord, open_log
from world_model import WorldObject

Array = NDArray[np.float64]


@dataclass
class Truth:
    """From the bag. All stamps are seconds.

    poses, wheels : (3,) by stamp, of the robot and what the wheels say. people : by stamp, (P, 2) m and beams (P,) of
    the scan on each.
    things : by stamp, position (3,) by name of what lies about. kinds : class and colour by name.
    """

    poses: dict[float, Array] = field(default_factory=dict)
    wheels: dict[float, Array] = field(default_factory=dict)
    people: dict[float, tuple[Array, NDArray[np.int64]]] = field(default_factory=dict)
    things: dict[float, dict[str, Array]] = field(default_factory=dict)
    kinds: dict[str, tuple[str, str]] = field(default_factory=dict)


@dataclass(frozen=True)
class Tracked:
    """One person of `targets`, in the map as it was then."""

    label: int
    position: Array
    velocity: Array
    hidden: bool


@dataclass(frozen=True)
class SaidPrediction:
    """One predicted path: label, points (T, 2) m with standard deviations (T,), goals (G, 2) and probabilities (G,)."""

    label: int
    points: Array
    sigmas: Array
    goals: Array
    probabilities: Array


@dataclass(frozen=True)
class Grid:
    """The last map: values (H, W) from 0 to 100, -1 unknown; extent x0, x1, y0, y1 in m."""

    values: NDArray[np.int8]
    extent: tuple[float, float, float, float]


@dataclass(frozen=True)
class Task:
    """A verification that was decided on, and how the world was told it ended ("" where it said nothing)."""

    stamp: float
    object_id: str
    reason: str
    region: Array
    outcome: str = ""
    ended: float = math.nan


@dataclass
class Said:
    """From the recording."""

    replayed: Replayed
    people: dict[float, list[Tracked]] = field(default_factory=dict)
    paths: dict[float, list[SaidPrediction]] = field(default_factory=dict)
    worlds: dict[float, tuple[WorldObject, ...]] = field(default_factory=dict)
    tasks: list[Task] = field(default_factory=list)
    grid: Grid | None = None


def read_truth(bag: Path) -> Truth:
    """`ground_truth/*` of a bag, and its wheels."""
    truth = Truth()
    names = ["pose", "people", "objects"]
    with open_log(bag, topics=["wheel_odom", *(f"ground_truth/{name}" for name in names)]) as log:
        for record in log:
            if isinstance(record, OdometryRecord) and record.topic.endswith("wheel_odom"):
                truth.wheels[_key(record.stamp)] = np.asarray(record.pose)
            elif isinstance(record, OdometryRecord):
                truth.poses[_key(record.stamp)] = np.asarray(record.pose)
            elif isinstance(record, MessageRecord) and record.topic.endswith("people"):
                targets = record.message.targets
                spots = np.array([[t.position.x, t.position.y] for t in targets]).reshape(-1, 2)
                returns = np.array([round(t.measurement_rate) for t in targets], dtype=np.int64)
                truth.people[_key(record.stamp)] = (spots, returns)
            elif isinstance(record, MessageRecord):
                truth.things[_key(record.stamp)] = {
                    item.id: _point(item.pose.pose.position) for item in record.message.objects
                }
                for item in record.message.objects:
                    truth.kinds[item.id] = (item.class_distribution.values[0], item.predicates[0])
    return truth


def read_said(recording: Path) -> Said:
    """A recording of the topics of `demo_suite.RECORDED`. Needs ROS, for the suite's messages."""
    from whereabouts.messages.world_objects import state_from_message

    said = Said(read_replay(recording))

    def take_world(worlds: dict[float, tuple[WorldObject, ...]], stamp: float, message: Any) -> None:
        worlds[stamp] = state_from_message(message).objects

    readers = {
        "targets": _take_targets,
        "predicted_paths": _take_paths,
        "world_state": lambda said, *news: take_world(said.worlds, *news),
        "verification_tasks": _take_task,
        "evidence": _take_evidence,
        "map": _take_map,
    }
    with open_log(recording, topics=list(readers)) as log:
        for record in log:
            if isinstance(record, MessageRecord):
                readers[record.topic.strip("/")](said, _key(record.stamp), record.message)
    return said


def _key(stamp: float) -> float:
    """Stamps of both bags meet in this."""
    return round(stamp, 4)


def _take_targets(said: Said, stamp: float, message: Any) -> None:
    frame = said.replayed.correction(stamp) if message.header.frame_id == "odom" else np.zeros(3)
    turn = np.array([[np.cos(frame[2]), -np.sin(frame[2])], [np.sin(frame[2]), np.cos(frame[2])]])
    said.people[stamp] = [
        Tracked(
            int(target.label),
            transform_points(frame, _point(target.position)[None, :2])[0],
            turn @ _point(target.velocity)[:2],
            bool(target.occluded),
        )
        for target in message.targets
    ]


def _take_paths(said: Said, stamp: float, message: Any) -> None:
    paths = []
    for path in message.paths:
        points = np.array([_point(point.position)[:2] for point in path.points]).reshape(-1, 2)
        spread = np.array([point.covariance for point in path.points]).reshape(-1, 2, 2)
        sigmas = np.sqrt(np.trace(spread, axis1=1, axis2=2) / 2.0)
        goals = np.array([_point(goal)[:2] for goal in path.goals]).reshape(-1, 2)
        paths.append(
            SaidPrediction(int(path.label), points, sigmas, goals, np.asarray(path.goal_probabilities))
        )
    said.paths[stamp] = paths


def _take_task(said: Said, stamp: float, message: Any) -> None:
    centre, size = _point(message.region.center.position), _point(message.region.size)
    said.tasks.append(Task(stamp, message.object_id, message.reason, np.array([*centre[:2], *size[:2]])))


def _take_evidence(said: Said, stamp: float, message: Any) -> None:
    """What maintenance says after a look is in the map's frame and about a certain object."""
    for item in message.objects:
        open_tasks = [k for k, task in enumerate(said.tasks) if task.object_id == item.object_id]
        if not item.object_id or not open_tasks:
            continue
        k = open_tasks[-1]
        outcome = "not found" if item.detection_id == "not_found" else "found"
        said.tasks[k] = replace(said.tasks[k], outcome=outcome, ended=stamp)


def _take_map(said: Said, stamp: float, message: Any) -> None:
    info = message.info
    x, y = info.origin.position.x, info.origin.position.y
    values = np.asarray(message.data, dtype=np.int8).reshape(info.height, info.width)
    extent = (x, x + info.width * info.resolution, y, y + info.height * info.resolution)
    said.grid = Grid(values, extent)


def _point(point: Any) -> Array:
    return np.array([point.x, point.y, point.z])
