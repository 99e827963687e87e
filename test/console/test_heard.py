"""What the console makes of messages, against positions worked out with matrices and pictures read back."""

from __future__ import annotations

import io
import math
from types import SimpleNamespace as Message
from typing import Any

import numpy as np
import pytest
from PIL import Image

from whereabouts.console.heard import TASKS, Heard
from whereabouts.console.shown import MOST_CELLS, map_picture


def header(frame: str, stamp: float) -> Any:
    whole = int(stamp)
    return Message(frame_id=frame, stamp=Message(sec=whole, nanosec=round(1e9 * (stamp - whole))))


def point(x: float, y: float, z: float = 0.0) -> Any:
    return Message(x=x, y=y, z=z)


def turned(yaw: float) -> Any:
    return Message(x=0.0, y=0.0, z=math.sin(yaw / 2), w=math.cos(yaw / 2))


def transform(parent: str, child: str, x: float, y: float, yaw: float, stamp: float = 1.0) -> Any:
    return Message(
        transforms=[
            Message(
                header=header(parent, stamp),
                child_frame_id=child,
                transform=Message(translation=point(x, y), rotation=turned(yaw)),
            )
        ]
    )


def matrix(x: float, y: float, yaw: float) -> np.ndarray:
    c, s = math.cos(yaw), math.sin(yaw)
    return np.array([[c, -s, x], [s, c, y], [0.0, 0.0, 1.0]])


def target(label: int, x: float, y: float, vx: float, vy: float) -> Any:
    return Message(label=label, position=point(x, y), velocity=point(vx, vy), occluded=False)


def test_people_and_robot_are_where_the_transforms_say() -> None:
    heard = Heard()
    correction, wheels = (1.0, -2.0, 0.7), (3.0, 0.5, -0.4)
    heard.take("tf", transform("map", "odom", *correction))
    heard.take(
        "odometry",
        Message(
            header=header("odom", 2.0),
            child_frame_id="base_link",
            pose=Message(pose=Message(position=point(*wheels[:2]), orientation=turned(wheels[2]))),
        ),
    )
    heard.take("targets", Message(header=header("odom", 2.0), targets=[target(7, 2.0, 1.0, 0.5, 0.0)]))
    path = Message(
        label=7, points=[Message(position=point(4.0, 1.0))], goals=[point(5.0, 1.0)], goal_probabilities=[0.8]
    )
    heard.take("predicted_paths", Message(header=header("map", 2.0), paths=[path]))
    world = heard.world()
    robot = matrix(*correction) @ matrix(*wheels)
    assert world["robot"] == pytest.approx([robot[0, 2], robot[1, 2], 0.3], abs=1e-3)
    person = world["people"][0]
    expected = matrix(*correction) @ [2.0, 1.0, 1.0]
    velocity = matrix(*correction)[:2, :2] @ [0.5, 0.0]
    assert [person["x"], person["y"]] == pytest.approx(expected[:2], abs=1e-3)
    assert [person["vx"], person["vy"]] == pytest.approx(velocity, abs=1e-3)
    assert (person["path"], person["goals"]) == ([(4.0, 1.0)], [[5.0, 1.0, 0.8]])
    assert world["stamp"] == 2.0


def test_people_whom_nobody_tells_of_any_more_are_not_shown() -> None:
    heard = Heard()
    heard.take("targets", Message(header=header("map", 2.0), targets=[target(7, 2.0, 1.0, 0.5, 0.0)]))
    assert len(heard.world()["people"]) == 1
    heard.take("tf", transform("map", "odom", 0.0, 0.0, 0.0, stamp=9.0))
    assert heard.world()["people"] == []


def test_transforms_in_a_circle_are_survived() -> None:
    heard = Heard()
    heard.take("tf", transform("a", "b", 1.0, 0.0, 0.0))
    heard.take("tf", transform("b", "a", 1.0, 0.0, 0.0))
    heard.take("targets", Message(header=header("a", 1.0), targets=[target(1, 0.0, 0.0, 0.0, 0.0)]))
    assert len(heard.world()["people"]) == 1


def test_the_map_and_its_updates_are_one_picture() -> None:
    heard = Heard()
    cells = np.full((30, 40), -1, dtype=np.int8)
    cells[5:20, 5:30] = 0
    cells[5, 5:30] = 100
    info = Message(
        height=30,
        width=40,
        resolution=0.1,
        origin=Message(position=point(-1.0, 2.0), orientation=turned(0.0)),
    )
    heard.take("map", Message(header=header("map", 1.0), info=info, data=cells.ravel()))
    first = heard.world()["map"]
    assert first["box"] == pytest.approx([-1.0, 3.0, 2.0, 5.0])
    patch = np.full((2, 3), 100, dtype=np.int8)
    update = Message(header=header("map", 2.0), x=10, y=12, width=3, height=2, data=patch.ravel())
    heard.take("map_updates", update)
    cells[12:14, 10:13] = 100
    assert heard.world()["map"]["number"] == first["number"] + 1
    assert heard.picture is not None
    seen = np.asarray(Image.open(io.BytesIO(heard.picture)))[::-1]
    assert ((seen[..., 3] == 255) == (cells == 100)).all()
    assert ((seen[..., 3] == 0) == (cells == -1)).all()


def test_a_huge_map_is_thinned_out_and_keeps_its_walls() -> None:
    cells = np.zeros((3000, 4001), dtype=np.int8)
    cells[1501, :] = 100
    picture, box = map_picture(cells, 0.05, 0.0, 0.0)
    seen = np.asarray(Image.open(io.BytesIO(picture)))
    assert seen.shape[0] * seen.shape[1] <= MOST_CELLS
    assert (seen[..., 3] == 255).any(axis=0).all()
    assert box[1] >= 4001 * 0.05
    assert box[3] >= 3000 * 0.05


def test_only_the_last_tasks_are_kept_and_health_is_by_node() -> None:
    heard = Heard()
    for number in range(TASKS + 5):
        task = Message(header=header("map", float(number)), object_id=f"cup-{number}", reason="not seen")
        heard.take("verification_tasks", task)
    for level in (b"\0", b"\2"):
        status = Message(name="loop_closure", level=level, message="told", hardware_id="whereabouts")
        # What other nodes of the graph say, and another robot's suite, comes on the same topic.
        others = [
            Message(name="motors", level=b"\2", message="hot", hardware_id="base"),
            Message(name="robot2/verifier", level=b"\2", message="told", hardware_id="whereabouts"),
        ]
        heard.take("/diagnostics", Message(header=header("", 1.0), status=[status, *others]))
    world = heard.world()
    assert [len(world["tasks"]), world["tasks"][-1]["object"]] == [TASKS, f"cup-{TASKS + 4}"]
    assert world["health"] == [{"node": "loop_closure", "level": "error", "message": "told"}]
