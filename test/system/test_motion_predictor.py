"""The node motion_predictor over real DDS: people are replayed, learned, predicted, saved and loaded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import TransformStamped
from harness import START, Graph
from nav_msgs.msg import OccupancyGrid
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from whereabouts.nodes.messages.conversions import points_from_message
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, seconds, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.ros.qos import LATCHED, TF_QOS, TF_STATIC_QOS
from whereabouts_msgs.msg import PredictedPathArray, Processed, Target, TargetArray
from whereabouts_msgs.srv import LoadState, Reset, SaveState

NODE = "motion_predictor"
EXITS = {"right": (10.0, 0.0), "up": (5.0, 6.0)}


def along(goal: str, seconds_: float) -> tuple[float, float] | None:
    """Where a person is after a time on the way from the origin to (5, 0) and then right or up, at 1.2 m/s."""
    corners = np.array([[0.0, 0.0], [5.0, 0.0], EXITS[goal]])
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
    if not 0.0 <= 1.2 * seconds_ <= way[-1]:
        return None
    x, y = (float(np.interp(1.2 * seconds_, way, corners[:, k])) for k in (0, 1))
    return x, y


class People:
    """Publishes targets as a tracker does, and holds what the node says about them."""

    def __init__(self, graph: Graph, frame: str = "map") -> None:
        self.graph, self.frame = graph, frame
        self.clock = 0.0
        self.label = 0
        self.processed: list[Processed] = graph.collect(Processed, f"{NODE}/processed")
        self.paths: list[PredictedPathArray] = graph.collect(PredictedPathArray, "predicted_paths")
        self.markers: list[MarkerArray] = graph.collect(MarkerArray, f"{NODE}/markers")
        self.occupancy: list[PointCloud2] = graph.collect(PointCloud2, "predicted_occupancy")
        self.diagnostics: list[DiagnosticArray] = graph.collect(DiagnosticArray, "/diagnostics")

    def send(self, positions: dict[int, tuple[float, float]], **fields: Any) -> TargetArray:
        """One message at the present clock, and wait until the node is done with it."""
        message = TargetArray()
        message.header.frame_id = self.frame
        message.header.stamp = time_message(START + round(self.clock * NANOSECONDS))
        for label, (x, y) in positions.items():
            target = Target(label=label, weight=1.0, **fields)
            target.position.x, target.position.y = x, y
            message.targets.append(target)
        self.sent = message
        before = len(self.processed)
        self.graph.publish("targets", message)
        self.graph.until(
            lambda: any(a.stamp == message.header.stamp for a in self.processed[before:]), "targets processed"
        )
        return message

    def walk(
        self, goal: str, until: float = 60.0, others: dict[int, tuple[float, float]] | None = None
    ) -> None:
        """One person goes to an exit, or as far as it gets in `until` s; five observations a second."""
        self.label += 1
        started = self.clock
        while (place := along(goal, self.clock - started)) and self.clock - started < until:
            self.send({self.label: place} | (others or {}))
            self.clock += 0.2

    def leave(self) -> None:
        """Nobody is there for longer than the timeout."""
        self.clock += 3.0
        self.send({})
        self.clock += 60.0

    def robot(self, x: float, y: float, yaw: float) -> None:
        """Where tf has the robot at the present clock."""
        stamp = START + round(self.clock * NANOSECONDS)
        turned = (0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2)))
        transform = transform_message("map", "base_link", stamp, (x, y, 0.0, *turned))
        self.graph.publish("tf", TFMessage(transforms=[transform]), TF_QOS)

    def figures(self) -> dict[str, str]:
        return (
            {item.key: item.value for item in self.diagnostics[-1].status[0].values}
            if self.diagnostics
            else {}
        )

    def learned(self, count: int) -> None:
        self.graph.until(lambda: self.figures().get("learned") == str(count), f"{count} walks are learned")

    def latest(self) -> PredictedPathArray:
        """The prediction for the message sent last."""
        self.graph.until(
            lambda: self.paths and self.paths[-1].header.stamp == self.sent.header.stamp, "a prediction"
        )
        return self.paths[-1]


def first_goal(array: PredictedPathArray) -> np.ndarray:
    goal = array.paths[0].goals[0]
    return np.array([goal.x, goal.y])


def teach(people: People, up: int = 3, right: int = 2) -> None:
    for goal, count in (("up", up), ("right", right)):
        for _ in range(count):
            people.walk(goal)
            people.leave()


def test_people_are_learned_predicted_saved_and_loaded(graph: Graph, tmp_path: Path) -> None:
    people = People(graph)
    first = graph.start(NODE, map_id="hall", allowed_folders=[str(tmp_path)])
    teach(people)
    people.learned(5)
    people.walk("up", until=6.5)
    array = people.latest()
    assert array.header.frame_id == "map"
    assert seconds(array.horizon) == pytest.approx(5.0)
    path = array.paths[0]
    assert path.label == people.label
    assert np.hypot(*(first_goal(array) - EXITS["up"])) < 0.75
    # Of five walks learned the first ones ended where nobody had gone before.
    assert 0.5 < sum(path.goal_probabilities) < 0.95
    assert path.goal_probabilities[0] > 0.6 * sum(path.goal_probabilities)
    times = [seconds(p.time_from_start) for p in path.points]
    np.testing.assert_allclose(times, np.arange(0.0, 5.01, 0.5), atol=1e-6)
    place = along("up", 6.4)
    assert place is not None
    np.testing.assert_allclose([path.points[0].position.x, path.points[0].position.y], place, atol=0.15)
    later = along("up", 8.4)
    assert later is not None
    np.testing.assert_allclose([path.points[4].position.x, path.points[4].position.y], later, atol=0.5)
    variances = [p.covariance[0] + p.covariance[3] for p in path.points]
    assert (np.diff(variances) > 0.0).all()

    graph.until(lambda: people.markers and people.occupancy, "markers and occupancy")
    assert len(people.markers[-1].markers) >= 4
    points, _ = points_from_message(people.occupancy[-1])
    assert np.hypot(*(points[:, :2] - place).T).min() < 0.3
    np.testing.assert_allclose(points[:, 2], 0.5)

    saved = tmp_path / "hall.npz"
    answer = graph.call(SaveState, f"{NODE}/save", SaveState.Request(path=str(saved)))
    assert (answer.code, answer.path) == (answer.SUCCESS, str(saved)), answer.message
    answer = graph.call(Reset, f"{NODE}/reset", Reset.Request(reason="test"))
    assert answer.code == answer.SUCCESS
    people.learned(0)
    answer = graph.call(LoadState, f"{NODE}/load", LoadState.Request(path=str(saved)))
    assert answer.code == answer.SUCCESS, answer.message
    people.learned(5)
    people.leave()
    people.walk("up", until=6.5)
    array = people.latest()
    assert array.paths[0].label == people.label
    assert np.hypot(*(first_goal(array) - EXITS["up"])) < 0.75

    for path_, expected in ((tmp_path / "absent.npz", "no such file"), (Path(), "names a file")):
        request = LoadState.Request(path="" if path_ == Path() else str(path_))
        answer = graph.call(LoadState, f"{NODE}/load", request)
        assert answer.code == answer.REFUSED
        assert expected in answer.message
    keys = tmp_path / "authorized_keys"
    keys.write_text("ssh-ed25519 AAAA")
    answer = graph.call(SaveState, f"{NODE}/save", SaveState.Request(path=str(keys)))
    assert (answer.code, "not overwritten" in answer.message) == (answer.REFUSED, True)
    assert keys.read_text() == "ssh-ed25519 AAAA"
    graph.kill(first)

    # A restarted node reads its file; one for another map refuses it and does not start.
    graph.start(NODE, namespace="/again", map_id="hall", model_path=str(saved))
    answer = graph.call(SaveState, f"/again/{NODE}/save", SaveState.Request())
    assert "5 trajectories" in answer.message
    other = graph.start(NODE, namespace="/other", map_id="office", state_dir=str(tmp_path))
    answer = graph.call(LoadState, f"/other/{NODE}/load", LoadState.Request(path="hall.npz"))
    assert answer.code == answer.REFUSED
    assert "'hall', not 'office'" in answer.message
    assert other is not None


def test_targets_in_another_frame_walls_and_bad_messages(graph: Graph) -> None:
    people = People(graph, frame="odom")
    spec = graph.start(NODE)
    transform = TransformStamped()
    transform.header.frame_id, transform.child_frame_id = "map", "odom"
    transform.transform.translation.x = 100.0
    transform.transform.rotation.w = 1.0
    graph.publish("tf_static", TFMessage(transforms=[transform]), TF_STATIC_QOS)
    # A wall across the way at x = 104 m.
    grid = OccupancyGrid()
    grid.header.frame_id = "map"
    grid.info.resolution = 0.1
    grid.info.width, grid.info.height = 2, 40
    grid.info.origin.position.x, grid.info.origin.position.y = 104.0, -2.0
    grid.info.origin.orientation.w = 1.0
    grid.data = [100] * 80
    graph.publish("map", grid, LATCHED)
    graph.until(lambda: int(people.figures().get("obstacle points", "0")) > 0, "the map is there")
    people.walk("right", until=2.1)
    xs = [p.position.x for p in people.latest().paths[0].points]
    assert xs[0] == pytest.approx(102.4, abs=0.2)
    assert max(xs) < 104.0

    people.send({7: (float("nan"), 0.0)})
    graph.until(
        lambda: people.figures().get("/targets dropped, refused") == "1", "the bad message is counted"
    )
    assert "targets[0] (7).position.x" in graph.log(spec)
    count = len(people.paths)
    people.clock += 0.2
    people.send({people.label: (2.9, 0.0)})
    graph.until(lambda: len(people.paths) > count, "it goes on")

    # Hidden for longer than the timeout, but still tracked: predicted on, and not learned.
    people.clock += 0.2
    for _ in range(4):
        people.clock += 1.0
        people.send({people.label: (0.0, 0.0)}, occluded=True)
    assert [path.label for path in people.latest().paths] == [people.label]
    people.learned(0)

    # Time jumps back: who was there is forgotten, what was learned stays.
    people.leave()
    people.learned(1)
    people.clock = 0.0
    people.walk("up", until=1.0)
    people.learned(1)
    graph.until(lambda: people.figures().get("present") == "1", "only the new person is there")


def marked(cloud: PointCloud2, robots: dict[int, tuple[float, float, float]], most: float) -> np.ndarray:
    """Points (N, 2) of the map that nav2's obstacle layer marks: those within `most` m of the origin of the cloud.

    robots : pose (3,) of base_link in the map by stamp, ns.
    """
    points, _ = points_from_message(cloud)
    if cloud.header.frame_id == "map":
        origin, turn = np.zeros(2), 0.0
    else:
        assert cloud.header.frame_id == "base_link"
        x, y, turn = robots[nanoseconds(cloud.header.stamp)]
        origin = np.array([x, y])
    c, s = np.cos(turn), np.sin(turn)
    there = points[:, :2] @ np.array([[c, -s], [s, c]]).T + origin
    return there[np.hypot(*(there - origin).T) <= most]


def test_a_costmap_marks_people_near_the_robot_wherever_it_is_in_the_map(graph: Graph) -> None:
    people = People(graph)
    graph.start(NODE)
    robots: dict[int, tuple[float, float, float]] = {}
    person = np.array([20.0, 10.0])
    for k in range(12):
        people.clock += 0.2
        here = (18.5 + 0.01 * k, 9.0, 0.5 + 0.1 * k)
        robots[START + round(people.clock * NANOSECONDS)] = here
        people.robot(*here)
        people.send({1: (float(person[0]), float(person[1]))})

    def seen() -> bool:
        """The newest cloud is one with the robot in it; tf may come after the people of its moment."""
        return bool(people.occupancy) and people.occupancy[-1].header.frame_id == "base_link"

    graph.until(seen, "a cloud around the robot")
    near = marked(people.occupancy[-1], robots, 2.5)
    assert len(near)
    assert np.hypot(*(near - person).T).min() < 0.3
    # The person is 1.6 m from the robot and 22 m from the map's origin.
    assert len(near) == len(points_from_message(people.occupancy[-1])[0])


def test_a_costmap_is_served_in_the_maps_frame_where_the_robot_is_unknown(graph: Graph) -> None:
    people = People(graph)
    graph.start(NODE)
    for _ in range(6):
        people.clock += 0.2
        people.send({1: (1.0, 1.0)})
    graph.until(lambda: people.occupancy, "a cloud")
    assert people.occupancy[-1].header.frame_id == "map"
    assert len(marked(people.occupancy[-1], {}, 2.5))
