"""Messages that are read when somebody looks at them."""

from __future__ import annotations

import numpy as np
import pytest
from nav_msgs.msg import OccupancyGrid
from rclpy.serialization import serialize_message
from std_msgs.msg import Header

from estimation.errors import InputError
from whereabouts.nodes.messages.packed import Packed
from whereabouts.nodes.messages.stamps import nanoseconds, time_message
from whereabouts.nodes.messages.world_reading import LatestState, grid_from_message
from whereabouts_msgs.msg import WorldObject, WorldState


def state(stamp: int, x: float = 1.0) -> WorldState:
    """A world of one cup."""
    item = WorldObject(id="cup-1", existence_probability=0.9)
    item.pose.pose.position.x = x
    item.pose.pose.orientation.w = 1.0
    return WorldState(header=Header(stamp=time_message(stamp), frame_id="map"), objects=[item])


def packed(message: WorldState) -> Packed:
    return Packed(WorldState, serialize_message(message))


@pytest.mark.parametrize("stamp", [0, 1, 999_999_999, 1_777_885_425_250_000_001, 2**31 * 10**9 - 1])
def test_the_stamp_is_read_without_unpacking(stamp: int) -> None:
    message = packed(state(stamp))
    assert message.stamp == stamp == nanoseconds(message.unpack().header.stamp)


def test_the_other_order_of_bytes_is_read_too() -> None:
    given = packed(state(1_777_885_425_250_000_001)).data
    numbers = np.frombuffer(given[4:12], dtype="<u4").astype(">u4").tobytes()
    assert Packed(WorldState, bytes([0, 0, 0, 0]) + numbers + bytes(4)).stamp == 1_777_885_425_250_000_001


def test_only_what_is_looked_at_is_read_and_nonsense_keeps_what_was_known() -> None:
    refused: list[str] = []
    read: list[float] = []
    latest = LatestState(refused.append, "map", lambda state: read.append(state.stamp))
    assert latest.state is None
    for second in (1, 2, 3):
        latest.take(packed(state(second * 10**9)))
    known = latest.state
    assert known is not None
    assert known.objects[0].id == "cup-1"
    assert read == [3.0]
    latest.take(packed(state(4 * 10**9, x=float("nan"))))
    assert latest.state is known
    assert len(refused) == 1
    assert "cup-1" in refused[0]
    assert latest.state is known
    assert len(refused) == 1
    elsewhere = state(5 * 10**9)
    elsewhere.header.frame_id = "odom"
    latest.take(packed(elsewhere))
    assert latest.state is known
    assert "odom" in refused[1]
    latest.forget()
    assert latest.state is None


def test_a_map_of_another_frame_is_none() -> None:
    message = OccupancyGrid()
    message.info.resolution, message.info.origin.orientation.w = 0.1, 1.0
    message.header.frame_id = "/map"
    assert grid_from_message(message, "map").shape == (0, 0)
    message.header.frame_id = "odom"
    with pytest.raises(InputError, match="odom"):
        grid_from_message(message, "map")
