"""The transform buffer against chains of matrices computed here."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from estimation.errors import InputError
from estimation.geometry.frame_tree import TransformError
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.messages.transforms import FrameOwner, TransformBuffer, transform_message

SECOND = NANOSECONDS


def matrix(position: np.ndarray, rotation: Rotation) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3], result[:3, 3] = rotation.as_matrix(), position
    return result


def insert(
    buffer: TransformBuffer, parent: str, child: str, stamp: int, pose: np.ndarray, static: bool = False
) -> None:
    position, rotation = pose[:3, 3], Rotation.from_matrix(pose[:3, :3]).as_quat()
    buffer.insert(transform_message(parent, child, stamp, (*position, *rotation)), static)


def random_pose(rng: np.random.Generator) -> np.ndarray:
    return matrix(rng.normal(size=3), Rotation.random(random_state=rng))


def test_chain_over_static_and_moving_frames_both_ways() -> None:
    rng = np.random.default_rng(1)
    odom, base, laser = (random_pose(rng) for _ in range(3))
    buffer = TransformBuffer()
    insert(buffer, "map", "odom", 5 * SECOND, odom)
    insert(buffer, "odom", "base_link", 5 * SECOND, base)
    insert(buffer, "base_link", "laser", 0, laser, static=True)
    assert np.allclose(buffer.lookup("map", "laser", 5 * SECOND), odom @ base @ laser)
    assert np.allclose(buffer.lookup("laser", "map", 5 * SECOND), np.linalg.inv(odom @ base @ laser))


def test_interpolates_between_stamps_as_scipy_does() -> None:
    rng = np.random.default_rng(2)
    first, second = random_pose(rng), random_pose(rng)
    buffer = TransformBuffer()
    insert(buffer, "odom", "base_link", 10 * SECOND, first)
    insert(buffer, "odom", "base_link", 12 * SECOND, second)
    rotations = Slerp([10.0, 12.0], Rotation.from_matrix([first[:3, :3], second[:3, :3]]))
    for time in (10.0, 10.3, 11.9, 12.0):
        share = (time - 10.0) / 2.0
        expected = matrix((1 - share) * first[:3, 3] + share * second[:3, 3], rotations(time))
        assert np.allclose(buffer.lookup("odom", "base_link", round(time * SECOND)), expected)


def test_order_of_arrival_does_not_matter() -> None:
    rng = np.random.default_rng(3)
    poses = [random_pose(rng) for _ in range(5)]
    in_order, shuffled = TransformBuffer(), TransformBuffer()
    for k in range(5):
        insert(in_order, "odom", "base_link", k * SECOND // 5, poses[k])
    for k in (3, 0, 4, 1, 2):
        insert(shuffled, "odom", "base_link", k * SECOND // 5, poses[k])
    for time in np.linspace(0.0, 0.8, 9):
        stamp = round(time * SECOND)
        assert np.allclose(
            in_order.lookup("odom", "base_link", stamp), shuffled.lookup("odom", "base_link", stamp)
        )


def test_what_may_still_come_is_told_from_what_will_not() -> None:
    buffer = TransformBuffer()
    with pytest.raises(TransformError, match="'laser' is unknown") as unknown:
        buffer.lookup("base_link", "laser", 0)
    assert unknown.value.later
    insert(buffer, "odom", "base_link", 10 * SECOND, np.eye(4))
    with pytest.raises(TransformError, match="newer than the newest") as early:
        buffer.lookup("odom", "base_link", 11 * SECOND)
    assert early.value.later
    with pytest.raises(TransformError, match="older than the oldest") as late:
        buffer.lookup("odom", "base_link", 9 * SECOND)
    assert not late.value.later
    insert(buffer, "other", "laser", 0, np.eye(4), static=True)
    with pytest.raises(TransformError, match="not connected"):
        buffer.lookup("odom", "laser", 10 * SECOND)


def test_what_is_missing_comes_with_what_to_do() -> None:
    buffer = TransformBuffer()
    insert(buffer, "odom", "base_footprint", 10 * SECOND, np.eye(4))
    assert "is it on tf" in buffer.missing([("odom", "laser")], 10 * SECOND)
    assert "transform_timeout" in buffer.missing([("odom", "base_footprint")], 11 * SECOND)
    insert(buffer, "base_footprint", "base_plate", 0, np.eye(4), static=True)
    insert(buffer, "base_plate", "base_link", 0, np.eye(4), static=True)
    owner = FrameOwner("odom", "base_link")
    assert not owner.takes(10 * SECOND, buffer)
    assert "Set base_frame: base_footprint for all nodes" in owner.withheld


def test_history_is_bounded_and_a_jump_back_clears_it() -> None:
    buffer = TransformBuffer()
    for k in range(1000):
        insert(buffer, "odom", "base_link", k * SECOND // 10, np.eye(4))
    assert len(buffer._tree.moving["base_link"].history) <= 101
    with pytest.raises(TransformError, match="older"):
        buffer.lookup("odom", "base_link", 50 * SECOND)
    insert(buffer, "odom", "base_link", 1 * SECOND, np.eye(4))
    assert np.allclose(buffer.lookup("odom", "base_link", 1 * SECOND), np.eye(4))


@pytest.mark.parametrize("off", [-1000.0, -4.0, 4.0, 3e7])
def test_one_transform_of_another_time_costs_nothing(off: float) -> None:
    buffer = TransformBuffer()
    for k in range(100):
        insert(buffer, "odom", "base_link", 2000 * SECOND + k * SECOND // 10, np.eye(4))
        if k == 90:
            insert(buffer, "odom", "base_link", 2009 * SECOND + round(off * SECOND), np.eye(4))
    for k in range(100):
        buffer.lookup("odom", "base_link", 2000 * SECOND + k * SECOND // 10)
    with pytest.raises(TransformError, match=r"0\.050 s newer") as early:
        buffer.lookup("odom", "base_link", 2009 * SECOND + 950 * SECOND // 1000)
    assert early.value.later


def test_history_goes_on_where_a_second_transform_confirms_a_leap() -> None:
    buffer = TransformBuffer()
    for start in (100, 50, 4000):
        for k in range(20):
            insert(buffer, "odom", "base_link", start * SECOND + k * SECOND // 10, np.eye(4))
        assert buffer.newest("odom", "base_link") == start * SECOND + 19 * SECOND // 10
        buffer.lookup("odom", "base_link", start * SECOND + SECOND // 20)


def test_frame_may_get_another_parent() -> None:
    rng = np.random.default_rng(4)
    first, second = random_pose(rng), random_pose(rng)
    buffer = TransformBuffer()
    insert(buffer, "table", "cup", SECOND, first)
    insert(buffer, "gripper", "cup", 2 * SECOND, second)
    assert np.allclose(buffer.lookup("gripper", "cup", 2 * SECOND), second)
    with pytest.raises(TransformError):
        buffer.lookup("table", "cup", 2 * SECOND)


def test_slashes_in_front_do_not_matter() -> None:
    buffer = TransformBuffer()
    insert(buffer, "/base_link", "/laser", 0, np.eye(4), static=True)
    assert np.allclose(buffer.lookup("base_link", "laser", 0), np.eye(4))


@pytest.mark.parametrize(
    ("parent", "child", "pose", "expected"),
    [
        ("", "laser", (0, 0, 0, 0, 0, 0, 1), "two different frames"),
        ("laser", "laser", (0, 0, 0, 0, 0, 0, 1), "two different frames"),
        ("base", "laser", (0, 0, 0, 0, 0, 0, 0), "length 1"),
        ("base", "laser", (np.nan, 0, 0, 0, 0, 0, 1), "finite"),
    ],
)
def test_impossible_transforms_are_refused(
    parent: str, child: str, pose: tuple[float, ...], expected: str
) -> None:
    with pytest.raises(InputError, match=expected):
        TransformBuffer().insert(transform_message(parent, child, 0, pose))


def test_after_a_jump_back_only_what_is_newer_is_forgotten() -> None:
    rng = np.random.default_rng(5)
    mount, early = random_pose(rng), random_pose(rng)
    buffer = TransformBuffer()
    insert(buffer, "base_link", "laser", 0, mount, static=True)
    insert(buffer, "odom", "base_link", 100 * SECOND, random_pose(rng))
    insert(buffer, "map", "odom", 100 * SECOND, random_pose(rng))
    insert(buffer, "odom", "base_link", 20 * SECOND, early)
    buffer.back_to(20 * SECOND)
    assert np.allclose(buffer.lookup("odom", "laser", 20 * SECOND), early @ mount)
    with pytest.raises(TransformError, match=r"'map' is unknown|not connected"):
        buffer.lookup("map", "laser", 20 * SECOND)


def test_newest_common_stamp_is_that_of_the_slowest_transform_between() -> None:
    rng = np.random.default_rng(9)
    buffer = TransformBuffer()
    assert buffer.newest("map", "base_link") is None
    for child, parent, stamps in (
        ("odom", "map", (1, 5)),
        ("base_link", "odom", (1, 3)),
        ("arm", "base_link", (9,)),
    ):
        for stamp in stamps:
            insert(buffer, parent, child, stamp * SECOND, random_pose(rng))
    insert(buffer, "base_link", "laser", 0, random_pose(rng), static=True)
    assert buffer.newest("map", "laser") == 3 * SECOND
    assert buffer.newest("laser", "odom") == 3 * SECOND
    assert buffer.newest("base_link", "laser") == 0
    assert buffer.newest("map", "elsewhere") is None
    buffer.lookup("map", "laser", 3 * SECOND)


def test_a_second_parent_is_remembered_and_a_first_one_is_not() -> None:
    rng = np.random.default_rng(9)
    buffer = TransformBuffer()
    insert(buffer, "odom", "base_link", SECOND, random_pose(rng))
    insert(buffer, "base_link", "laser", 0, random_pose(rng), static=True)
    insert(buffer, "odom", "base_link", 2 * SECOND, random_pose(rng))
    assert buffer.contradictions() == []
    insert(buffer, "base_footprint", "base_link", 0, random_pose(rng), static=True)
    assert buffer.contradictions() == ["frame 'base_link' has two parents: 'base_footprint' and 'odom'"]
    assert buffer.parent("base_link") == "base_footprint"
