"""Ordinary detectors and cameras: hidden close behind, depth of another moment, two boxes for one thing, odd words."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest
from depth_camera import looking
from scipy.spatial.transform import Rotation

from whereabouts.recorded.camera_messages import Cameras
from whereabouts.recorded.evidence_messages import Reader, SeenFrame
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig
from world_model.camera import CameraModel, CameraView, DepthImage, ImageBox, located, overlap

CAMERA = CameraModel(160, 120, 140.0, 140.0, 79.5, 59.5)
FORWARD = looking(np.array([0.0, 0.0, 1.0]), np.array([2.0, 0.0, 1.0]))
THING = np.array([[2.0, 0.0, 1.0]])
SIGMA, SIZE = np.array([0.02]), np.array([0.12])


def filled(metres: float) -> DepthImage:
    return DepthImage(np.full((120, 160), metres, np.float32))


@pytest.mark.parametrize("before", [0.17, 0.3, 1.0])
def test_what_stands_close_before_a_thing_hides_it(before: float) -> None:
    assert CameraView(CAMERA, FORWARD, filled(2.0 - before)).visible(THING, SIGMA, SIZE) == [0.0]


@pytest.mark.parametrize("met", [1.95, 2.0, 2.1, 4.0])
def test_a_thing_does_not_hide_itself(met: float) -> None:
    assert CameraView(CAMERA, FORWARD, filled(met)).visible(THING, SIGMA, SIZE) == [1.0]


def test_a_box_that_could_not_be_placed_may_be_of_what_its_frame_is_around() -> None:
    pixel = CAMERA.project((THING - FORWARD[:3, 3]) @ FORWARD[:3, :3])[0]
    beside = ImageBox(pixel[0] + 30.0, pixel[1], 9.0, 9.0)
    around = ImageBox(pixel[0] + 2.0, pixel[1], 9.0, 9.0)
    for box, clear in ((beside, 1.0), (around, 0.0)):
        assert CameraView(CAMERA, FORWARD, filled(4.0), taken=(box,)).visible(THING, SIGMA, SIZE) == [clear]


@pytest.mark.parametrize("angle", [-0.06, 0.1])
def test_depth_of_another_moment_is_looked_up_where_the_camera_looked_then(angle: float) -> None:
    """The camera turned in between: in the depth image a thing 2 m ahead, before a wall at 4 m, is elsewhere."""
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_rotvec([0.0, angle, 0.0]).as_matrix()
    there = CAMERA.project([turned[:3, :3] @ (0.0, 0.0, 2.0)])[0]
    metres = np.full((120, 160), 4.0, np.float32)
    metres[55:65, round(there[0]) - 4 : round(there[0]) + 5] = 2.0
    box = ImageBox(79.5, 59.5, 9.0, 9.0)
    assert located(box, CAMERA, DepthImage(metres), turned).position == pytest.approx(
        [0.0, 0.0, 2.06], abs=0.02
    )
    assert located(box, CAMERA, DepthImage(metres)).position[2] > 3.5
    # What is hidden goes by it as well.
    near = DepthImage(np.where(metres < 3.0, np.float32(1.0), metres))
    view = CameraView(CAMERA, FORWARD, near, turned=turned)
    assert view.visible(THING, SIGMA, np.array([0.05])) == [0.0]
    assert CameraView(CAMERA, FORWARD, near).visible(THING, SIGMA, np.array([0.05])) == [1.0]


def test_overlap_is_what_counting_pixels_says() -> None:
    rng = np.random.default_rng(4)
    y, x = np.mgrid[0:400, 0:400] + 0.5
    for _ in range(20):
        boxes = [ImageBox(*rng.uniform(100, 300, 2), *rng.uniform(20, 180, 2)) for _ in range(2)]
        first, second = ((abs(x - b.x) < 0.5 * b.width) & (abs(y - b.y) < 0.5 * b.height) for b in boxes)
        assert overlap(*boxes) == pytest.approx((first & second).sum() / (first | second).sum(), abs=0.03)


def framed(x: float, width: float, **scores: float) -> SimpleNamespace:
    results = [SimpleNamespace(hypothesis=SimpleNamespace(class_id=n, score=s)) for n, s in scores.items()]
    centre = SimpleNamespace(position=SimpleNamespace(x=x, y=60.0))
    return SimpleNamespace(results=results, bbox=SimpleNamespace(center=centre, size_x=width, size_y=width))


def test_two_boxes_around_one_thing_are_one_detection() -> None:
    metres = np.full((120, 160), 2.0, np.float32)
    metres[:, 100:] = 3.0
    reader = Reader({"class": ["cup", "vase"]}, ("class",), 0.03)
    message = SimpleNamespace(
        detections=[
            framed(40.0, 20.0, cup=0.8),
            framed(41.0, 22.0, vase=0.4),  # the same again, under another name
            framed(52.0, 20.0, cup=0.9),  # its neighbour
            framed(98.0, 20.0, cup=0.9),
            framed(102.0, 20.0, cup=0.9),  # a metre behind
        ]
    )
    depth = DepthImage(metres)
    view = CameraView(CAMERA, np.eye(4), depth)
    evidence, refused = reader.boxes(
        message, SeenFrame(), view, lambda box, others: located(box, CAMERA, depth, None, others)
    )
    assert not refused
    assert len(evidence.objects) == 4
    first = evidence.objects[0].attributes["class"]
    assert first["cup"] > first["vase"] > 0.25
    assert sum(first.values()) == pytest.approx(1.0)


def test_what_is_called_by_an_unknown_word_confirms_what_is_known_and_begins_nothing() -> None:
    model = WorldModel(WorldModelConfig(classes=["cup", "bowl"], region=((-5.0, 5.0),) * 2 + ((0.0, 2.0),)))
    sensor = {"pose": (-1.5, 0.0, 1.0, 0.0), "range": 4.0, "angle": 1.5}
    cup, odd = {"class": {"cup": 1.0}}, {"class": {"wine glass": 1.0}}
    covariance = 0.02**2 * np.eye(3)
    for k in range(10):
        model.update(WorldEvidence([ObjectEvidence((0, 0, 1), covariance, cup)], sensor), 0.2 * k)
    for k in range(10, 60):
        objects = [ObjectEvidence(place, covariance, odd) for place in ((0, 0, 1), (0.5, 0.5, 1))]
        evidence, refused = model.usable(WorldEvidence(objects, sensor), wordless=True)
        assert sorted(refused) == [0, 1]
        state = model.update(evidence, 0.2 * k)
    assert [item.id for item in state.objects] == ["cup-1"]
    assert not state.objects[0].lost
    assert state.objects[0].last_seen == pytest.approx(0.2 * 59)
    assert state.objects[0].most_probable("class") == "cup"


def test_cameras_do_not_speak_for_each_other() -> None:
    cameras = Cameras()
    assert not cameras.repeats("left", 10**9)
    assert not cameras.repeats("right", 10**9)
    assert cameras.repeats("left", 10**9 + 10**8)
    assert not cameras.repeats("left", 10**9 + 3 * 10**8)
    cameras.keep(5, "left image", "left")
    cameras.keep(5, "right image", "right")
    assert cameras.nearest(5, "left") == (5, "left image")
    assert cameras.nearest(6, "right") == (5, "right image")
    cameras.replace(5, "read", "right")
    assert cameras.nearest(5, "right") == (5, "read")
    assert cameras.nearest(5, "left") == (5, "left image")


def test_a_thing_that_another_covers_in_part_is_placed_at_itself() -> None:
    metres = np.full((120, 160), 4.0, np.float32)
    metres[50:70, 60:100] = 2.0
    metres[45:75, 60:78] = 1.6  # stands before its left half
    thing, cover = ImageBox(79.5, 59.5, 40.0, 20.0), ImageBox(68.5, 59.5, 18.0, 30.0)
    alone, told = (located(thing, CAMERA, DepthImage(metres), None, others) for others in ((), (cover,)))
    assert alone.position[2] < 1.8
    assert told.position[2] == pytest.approx(2.0 + 0.5 * told.height, abs=0.02)
    # Of what is wholly within another box all counts.
    table = ImageBox(79.5, 59.5, 120.0, 60.0)
    assert located(cover, CAMERA, DepthImage(metres), None, [table]).position[2] == pytest.approx(
        1.7, abs=0.05
    )
