"""The camera's door over real DDS: stock messages of a detector, a camera and its depth, and what absence says."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth_camera import DepthCamera, Framed, compressed, looking
from geometry_msgs.msg import Point
from harness import Graph, mounting
from lifecycle_msgs.msg import Transition
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from std_msgs.msg import Header
from test_world_model import World, stamp
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import (
    BoundingBox2D,
    Detection2D,
    Detection2DArray,
    Detection3D,
    Detection3DArray,
    ObjectHypothesis,
    ObjectHypothesisWithPose,
    Point2D,
    Pose2D,
)

from whereabouts.nodes.messages.stamps import time_message
from whereabouts.nodes.ros.qos import TF_STATIC_QOS
from whereabouts.nodes.runtime.supervisor import NodeSpec
from whereabouts.simulation.home.apartment_camera import Item
from whereabouts.simulation.home.floor_plan import apartment, places_file
from world_model.camera import ImageBox
from world_model.warm_up import warm_up

CUP = ("cup", Item("cup", "red", (0.05, 0.05, 0.06)), np.array([0.0, 3.5, 0.76]))
BOWL = ("bowl", Item("bowl", "green", (0.09, 0.09, 0.05)), np.array([0.4, 3.8, 0.75]))
SOMEBODY = np.array([[-0.4, 2.2, 0.0, 0.8, 2.6, 1.75]])
# An optical frame that looks along y, level: x is to the right, z ahead.
EYE, ORIGIN = (-np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)), (0.15, 1.6, 0.9)


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    """Nodes are waited for as if everything was compiled already."""
    warm_up()


class CameraRobot:
    """A robot before the kitchen table, with a camera whose messages are those of any driver and detector."""

    def __init__(self, graph: Graph, **parameters: Any) -> None:
        settings = {
            "classes": ["cup", "bowl"],
            "places_file": str(places_file()),
            "region": [-2.0, 9.0, -6.0, 6.0, -0.5, 2.5],
        }
        self.world = World(graph, **{**settings, **parameters})
        self.graph = graph
        self.camera = DepthCamera()
        self.rng = np.random.default_rng(4)
        self.home = apartment()
        self.now = 0.0
        self.depth = "depth"
        static = TFMessage(transforms=[mounting("eye", (*ORIGIN, *EYE))])
        static.transforms[0].header.frame_id = "map"
        graph.publish("tf_static", static, TF_STATIC_QOS)
        lens = self.camera.camera
        info = CameraInfo(header=self.header("eye"), width=lens.width, height=lens.height)
        info.k = [lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0]
        info.distortion_model, info.d = "plumb_bob", [0.0] * 5
        self.world.send(info, "camera_info")

    def header(self, frame: str) -> Header:
        return Header(stamp=time_message(stamp(self.now)), frame_id=frame)

    def seen(self, metres: np.ndarray) -> Image | CompressedImage:
        """A depth image as `depth` has it."""
        if self.depth == "depth":
            return self.image(metres)
        packed = compressed(metres)
        return CompressedImage(header=self.header("eye"), format="16UC1; compressedDepth png", data=packed)

    def image(self, metres: np.ndarray, frame: str = "eye") -> Image:
        height, width = metres.shape
        data = np.round(1000.0 * metres).astype("<u2").tobytes()
        return Image(
            header=self.header(frame), height=height, width=width, encoding="16UC1", step=2 * width, data=data
        )

    def look(
        self,
        things: list[Any],
        count: int,
        told: Callable[[list[Framed]], None],
        more: Any = None,
        late: bool = False,
    ) -> None:
        """Pictures of things, every one told of by a depth image and then by detections."""
        blocks = self.home.blocks if more is None else np.vstack([self.home.blocks, more])
        pose = looking(np.array(ORIGIN), np.array(ORIGIN) + np.array([0.0, 1.0, 0.0]))
        scene = self.camera.scene(pose, blocks, {name: (item, at) for name, item, at in things})
        for _ in range(count):
            self.now = round(self.now + 0.25, 3)
            steps = [
                lambda: self.world.send(self.seen(scene.depth(self.rng)), self.depth),
                lambda: told(scene.detections(self.rng)),
            ]
            for step in reversed(steps) if late else steps:
                step()

    def boxes(self, found: list[Framed], frame: str = "eye") -> None:
        message = Detection2DArray(header=self.header(frame))
        for item in found:
            box = item.box
            centre = Pose2D(position=Point2D(x=box.x, y=box.y))
            made = Detection2D(
                header=message.header, bbox=BoundingBox2D(center=centre, size_x=box.width, size_y=box.height)
            )
            made.results = self.results(item)
            message.detections.append(made)
        self.world.send(message, "detections_2d")

    @staticmethod
    def results(item: Framed) -> list[ObjectHypothesisWithPose]:
        return [
            ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=score))
            for name, score in item.scores.items()
        ]

    def places(self) -> list[tuple[float, float]]:
        state = self.world.at(self.now)
        found = [o.pose.pose.position for o in state.objects if not o.lost and o.existence_probability > 0.5]
        return sorted((round(p.x, 1), round(p.y, 1)) for p in found)


AT_CUP, AT_BOWL = (0.0, 3.5), (0.4, 3.8)


def test_boxes_in_an_image_tell_what_is_there_what_is_hidden_and_what_has_gone(graph: Graph) -> None:
    robot = CameraRobot(graph)
    robot.look([CUP, BOWL], 30, robot.boxes)
    assert robot.places() == [AT_CUP, AT_BOWL]
    robot.look([CUP, BOWL], 20, robot.boxes, SOMEBODY)
    assert robot.places() == [AT_CUP, AT_BOWL]
    # A depth image that takes longer than the detector is waited for.
    robot.look([BOWL], 10, robot.boxes, late=True)
    assert robot.places() == [AT_BOWL]

    def told() -> bool:
        return any(key.startswith("found at") for key in robot.world.figures())

    graph.until(told, "the rates of detection")


@dataclass(frozen=True)
class PackedDepth(NodeSpec):
    """A node whose depth images come compressed."""

    remappings: Mapping[str, str] = field(default_factory=lambda: {"depth": "depth/compressedDepth"})


def test_depth_images_may_come_compressed(graph: Graph) -> None:
    robot = CameraRobot(graph, kind=PackedDepth)
    robot.depth = "depth/compressedDepth"
    robot.look([CUP, BOWL], 30, robot.boxes)
    assert robot.places() == [AT_CUP, AT_BOWL]


def test_detections_in_space_need_no_field_of_view_of_their_own(graph: Graph) -> None:
    robot = CameraRobot(graph)

    def told(found: list[Framed]) -> None:
        message = Detection3DArray(header=robot.header("map"))
        for item in found:
            kind = next(iter(item.scores))
            # The box says which thing it is, even where the class is wrong.
            at = CUP[2] if abs(item.box.x - cup_column) < 8 else BOWL[2]
            made = Detection3D(results=robot.results(Framed(item.box, {kind: 0.9})))
            made.bbox.center.position = Point(**dict(zip("xyz", map(float, at), strict=True)))
            message.detections.append(made)
        robot.world.send(message, "detections")

    local = (CUP[2] - ORIGIN)[[0, 2, 1]] * (1.0, -1.0, 1.0)
    cup_column = robot.camera.camera.project(local[None])[0, 0]
    robot.look([CUP, BOWL], 20, told)
    assert robot.places() == [AT_CUP, AT_BOWL]
    robot.look([], 8, told, SOMEBODY)
    assert robot.places() == [AT_CUP, AT_BOWL]
    robot.look([CUP], 10, told)
    assert robot.places() == [AT_CUP]


def test_what_makes_no_sense_is_said_and_counted_and_the_node_goes_on(graph: Graph) -> None:
    robot = CameraRobot(graph, transform_timeout=0.5)

    def refused(topic: str, count: int) -> None:
        key = f"/{topic} dropped, refused"
        graph.until(lambda: robot.world.figures().get(key) == str(count), f"{count} refused on {topic}")

    robot.now = 1.0
    box = [Framed(ImageBox(80.0, 60.0, 10.0, 10.0), {"cup": 0.9})]
    robot.boxes(box)
    refused("detections_2d", 1)
    robot.now = 2.0
    robot.world.send(robot.image(np.full((60, 80), 2.0)), "depth")
    robot.boxes(box)
    refused("depth", 1)
    robot.now = 3.0
    robot.world.send(robot.image(np.full((120, 160), 2.0), "depth_eye"), "depth")
    robot.boxes(box)
    refused("depth", 2)
    robot.now = 4.0
    wrong = robot.image(np.full((120, 160), 2.0))
    wrong.encoding = "rgb8"
    robot.world.send(wrong, "depth")
    robot.boxes(box)
    refused("depth", 3)
    refused("detections_2d", 4)
    robot.now = 5.0
    robot.world.send(robot.image(np.full((120, 160), 2.0)), "depth")
    robot.boxes(box, "nose")
    robot.look([CUP, BOWL], 30, robot.boxes)
    assert robot.places() == [AT_CUP, AT_BOWL]
    said = graph.log(robot.world.spec)
    assert "no transform from 'nose' to 'map'" in said
    assert "no usable message on /depth within 0.05 s" in said
    assert "the depth image has 80 x 60 pixels, camera_info tells of 160 x 120" in said


def test_what_was_learned_of_the_detector_survives_a_restart(graph: Graph, tmp_path: Path) -> None:
    robot = CameraRobot(graph, store_path=str(tmp_path / "home.sqlite"))
    robot.look([CUP, BOWL], 30, robot.boxes)

    def told() -> dict[str, str]:
        return {key: value for key, value in robot.world.figures().items() if key.startswith("found at")}

    before = graph.until(told, "the rates of detection")
    graph.change(robot.world.spec, Transition.TRANSITION_DEACTIVATE, Transition.TRANSITION_CLEANUP)
    graph.kill(robot.world.spec)
    now, robot = robot.now, CameraRobot(graph, store_path=str(tmp_path / "home.sqlite"))
    robot.now = now
    robot.look([CUP, BOWL], 1, robot.boxes)
    after = graph.until(told, "the rates of before")
    # Of one look alone nothing would be told.
    assert after.keys() >= before.keys()
    count = [int(next(iter(rates.values())).split()[-1]) for rates in (before, after)]
    assert count[0] <= count[1]
