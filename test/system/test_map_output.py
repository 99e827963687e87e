"""What is sent of a map: whole maps, and boxes that make the next whole map of the one before."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Time
from nav_msgs.msg import Path
from rclpy.serialization import deserialize_message
from std_msgs.msg import Header

from estimation.geometry.poses import pose_to_quaternion
from loop_closure.maps.map_grid import MapGrid
from whereabouts.nodes.mapping.map_publisher import MapOutput
from whereabouts.nodes.messages.map_messages import packed_path


class ListeningNode:
    """Puts maps together as nav2's static layer does."""

    def __init__(self) -> None:
        self.wanted = True
        self.whole = self.boxes = 0
        self.values = np.zeros((0, 0), dtype=np.int8)
        self.complaints: list[str] = []
        self.info: Any = None

    def add_output(self, kind: type, topic: str, *_: Any) -> Any:
        take = {"map": self._take, "map_updates": self._update}[topic]
        return SimpleNamespace(publish=take, wanted=True)

    def complain(self, text: str, key: Any = None) -> None:
        self.complaints.append(text)

    def _take(self, message: Any) -> None:
        self.info, self.whole = message.info, self.whole + 1
        self.values = np.array(message.data, dtype=np.int8).reshape(message.info.height, message.info.width)

    def _update(self, message: Any) -> None:
        self.boxes += 1
        assert len(message.data) == message.width * message.height
        box = self.values[message.y : message.y + message.height, message.x : message.x + message.width]
        box[:] = np.array(message.data, dtype=np.int8).reshape(box.shape)

    def at(self, place: np.ndarray) -> int:
        origin = np.array([self.info.origin.position.x, self.info.origin.position.y])
        i, j = np.floor((place - origin) / self.info.resolution).astype(int)
        return int(self.values[j, i])


class DrawnGrid(MapGrid):
    """A grid that a test draws into."""

    def add(self, pose: np.ndarray, points: np.ndarray) -> None:
        self._changed |= self.tiles.integrate(pose, points)


@pytest.fixture
def points() -> np.ndarray:
    rng = np.random.default_rng(0)
    angles = rng.uniform(-np.pi, np.pi, 200)
    return rng.uniform(2.0, 5.0, 200)[:, None] * np.column_stack((np.cos(angles), np.sin(angles)))


def test_boxes_lead_from_one_map_to_the_next(points: np.ndarray) -> None:
    listener, grid = ListeningNode(), DrawnGrid()
    output = MapOutput(listener, 10_000_000)  # type: ignore[arg-type]
    for x in (0.0, 30.0):
        for y in np.arange(0.0, 30.0, 3.0):
            grid.add(np.array([x, y, 0.0]), points)
            grid.add(np.array([y, x, 0.0]), points)
    assert not output.updates_wanted(grid), "no map was sent that could be changed"
    output.send(Header(), grid, np.zeros(2))
    sizes = [listener.values.size]
    for y in (10.0, 10.5, 22.0):
        before = listener.values.copy()
        grid.add(np.array([0.0, y, 0.5]), points)
        output.send_changes(Header(), grid, np.array([0.0, y]))
        assert (listener.values != before).any()
        np.testing.assert_array_equal(listener.values, grid.tiles.values(grid.tiles.view()))
    output.send_changes(Header(), grid, np.zeros(2))
    assert (listener.whole, listener.boxes) == (1, 3), "nothing has changed since"
    # Outside what was sent: a whole map, and a larger one.
    grid.add(np.array([-20.0, 0.0, 0.0]), points)
    output.send_changes(Header(), grid, np.zeros(2))
    assert (listener.whole, listener.boxes) == (2, 3)
    assert listener.values.size > sizes[0]
    np.testing.assert_array_equal(listener.values, grid.tiles.values(grid.tiles.view()))
    assert not listener.complaints


def test_the_part_around_the_robot_is_sent_and_the_rest_is_named(points: np.ndarray) -> None:
    listener, grid = ListeningNode(), DrawnGrid()
    output = MapOutput(listener, 1_000_000)  # type: ignore[arg-type]
    grid.add(np.zeros(3), points)
    output.send(Header(), grid, np.zeros(2))
    assert not listener.complaints
    there = np.array([1e5, -3e4])
    grid.add(np.array([*there, 0.0]), points)
    output.send_changes(Header(), grid, np.zeros(2))
    assert listener.at(points[0]) == 100
    assert listener.whole == 1, "what changed is not in the part that is shown"
    output.send(Header(), grid, there)
    assert listener.at(there + points[0]) == 100
    assert listener.values.size < 200_000
    assert "left out, up to 1044" in listener.complaints[0]
    # Back home without anything new: another part has to be shown.
    assert not output.outdated(grid, there)
    assert output.outdated(grid, np.zeros(2))


def test_a_grid_of_nothing_is_sent() -> None:
    listener = ListeningNode()
    MapOutput(listener, 1_000_000).send(Header(), MapGrid(), None)  # type: ignore[arg-type]
    assert listener.values.size == 0


@pytest.mark.parametrize("frame", ["", "m", "ma", "map", "odom", "maps1", "robot1/map", "küche"])
@pytest.mark.parametrize("count", [0, 1, 2, 5])
def test_a_path_made_as_bytes_is_the_path(frame: str, count: int) -> None:
    rng = np.random.default_rng(count)
    poses, stamps = rng.uniform(-3.0, 3.0, (count, 6)), [1.7e9 + 0.1 * k for k in range(count)]
    header = Header(frame_id=frame, stamp=Time(sec=5, nanosec=7))
    message = deserialize_message(packed_path(header, stamps, poses), Path)
    assert message.header == header
    assert len(message.poses) == count
    for item, pose, stamp in zip(message.poses, poses, stamps, strict=True):
        assert item.header.frame_id == frame
        assert item.header.stamp.sec * 10**9 + item.header.stamp.nanosec == round(stamp * 1e9)
        position, quaternion = pose_to_quaternion(pose)
        at, turn = item.pose.position, item.pose.orientation
        assert np.array_equal([at.x, at.y, at.z], position)
        assert np.allclose([turn.x, turn.y, turn.z, turn.w], quaternion, rtol=0.0, atol=1e-15)
