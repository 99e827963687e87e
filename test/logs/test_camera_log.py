"""Boxes of a recorded bag, placed by its camera_info, depth images and tf, without ROS."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from depth_camera import DepthCamera, Framed, compressed, looking
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from scipy.spatial.transform import Rotation

from whereabouts.logs import McapWriter, Topic, open_raw
from whereabouts.logs.bags.encode import header, xyz, xyzw
from whereabouts.messages.type_names import BOXES, CAMERA_INFO, COMPRESSED, DETECTIONS, IMAGE, TF
from whereabouts.recorded.evidence_messages import Reader
from whereabouts.recorded.world_log import EvidenceLog
from whereabouts.simulation.home.apartment_camera import Item
from whereabouts.simulation.home.floor_plan import apartment
from whereabouts.simulation.world_bag import SuiteMessages, pose
from whereabouts.system.log_errors import NothingRecognisedError
from world_model import WorldModel, WorldModelConfig

CUP = (Item("cup", "red", (0.05, 0.05, 0.06)), np.array([0.0, 3.5, 0.76]))
BOWL = (Item("bowl", "green", (0.09, 0.09, 0.05)), np.array([0.4, 3.8, 0.75]))
# A robot at (0.5, 1.0), turned to the left, whose camera sees the kitchen table.
MOUNT = looking(np.array([0.6, 0.4, 1.25]), np.array([2.4, 0.35, 0.7]))
BASE = np.array([[0.0, -1.0, 0.0, 0.5], [1.0, 0.0, 0.0, 1.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])


def stamped(stamp: float, frame: str) -> dict[str, Any]:
    return header(round(stamp * 1e9), frame)


class CameraRecorder:
    """Writes the messages of a camera, a detector and tf, with a look four times a second."""

    def __init__(self, path: Path, world: str = "map", packed: bool = False) -> None:
        self.world, self.packed = world, packed
        self.messages = SuiteMessages(BOXES, DETECTIONS)
        self.make = self.messages.make
        self.writer = McapWriter(path)
        self.camera = DepthCamera()
        self.rng = np.random.default_rng(2)
        self.now = 10.0

    def write(self, topic: str, kind: str, message: Any, at: float) -> None:
        where = self.messages.topic(topic, kind) if kind in (BOXES, DETECTIONS) else Topic(topic, kind)
        self.writer.write_raw(where, self.messages.serialized(message, kind), round(at * 1e9))

    def transform(self, topic: str, parent: str, child: str, matrix: np.ndarray, stamp: float) -> None:
        turn = Rotation.from_matrix(matrix[:3, :3]).as_quat()
        both = {"translation": xyz(matrix[:3, 3]), "rotation": xyzw(turn)}
        one = {"header": stamped(stamp, parent), "child_frame_id": child, "transform": both}
        self.write(topic, TF, self.make(TF, transforms=[one]), stamp)

    def info(self) -> None:
        lens = self.camera.camera
        k = np.array([lens.fx, 0.0, lens.cx, 0.0, lens.fy, lens.cy, 0.0, 0.0, 1.0])
        message = self.make(
            CAMERA_INFO,
            header=stamped(self.now, "eye"),
            height=lens.height,
            width=lens.width,
            distortion_model="plumb_bob",
            d=np.zeros(5),
            k=k,
            r=np.eye(3).ravel(),
        )
        self.write("/camera_info", CAMERA_INFO, message, self.now)

    def look(self, things: dict[str, Any], count: int, depth: bool = True) -> None:
        scene = self.camera.scene(BASE @ MOUNT, apartment().blocks, things)
        for _ in range(count):
            self.now += 0.25
            boxes = [self._framed(found) for found in scene.detections(self.rng)]
            message = self.make(BOXES, header=stamped(self.now, "eye"), detections=boxes)
            # What belongs to the boxes comes after them.
            self.write("/found", BOXES, message, self.now + 0.01)
            self.transform("/tf", self.world, "base_link", BASE, self.now + 0.02)
            if depth:
                image = (self._packed if self.packed else self._image)(scene.depth(self.rng))
                self.write("/depth", COMPRESSED if self.packed else IMAGE, image, self.now + 0.05)

    def _packed(self, metres: np.ndarray) -> Any:
        data = np.frombuffer(compressed(metres), np.uint8)
        return self.make(
            COMPRESSED, header=stamped(self.now, "eye"), format="16UC1; compressedDepth png", data=data
        )

    def _image(self, metres: np.ndarray) -> Any:
        data = np.round(1000.0 * metres).astype("<u2").tobytes()
        height, width = metres.shape
        return self.make(
            IMAGE,
            header=stamped(self.now, "eye"),
            height=height,
            width=width,
            encoding="16UC1",
            step=2 * width,
            data=np.frombuffer(data, np.uint8),
        )

    def _framed(self, found: Framed) -> Any:
        box = found.box
        center = {"position": {"x": box.x, "y": box.y}}
        results = [{"hypothesis": {"class_id": k, "score": score}} for k, score in found.scores.items()]
        bbox = {"center": center, "size_x": box.width, "size_y": box.height}
        return {"header": stamped(self.now, "eye"), "results": results, "bbox": bbox}


def recorded(path: Path, depth: bool = True, packed: bool = False) -> Path:
    """A cup and a bowl on the table; then the cup has gone."""
    recorder = CameraRecorder(path, packed=packed)
    with recorder.writer:
        recorder.info()
        recorder.transform("/tf_static", "base_link", "eye", MOUNT, 10.0)
        recorder.transform("/tf", "map", "base_link", BASE, 10.0)
        recorder.look({"cup": CUP, "bowl": BOWL}, 30, depth)
        recorder.look({"bowl": BOWL}, 12, depth)
        recorder.transform("/tf", "map", "base_link", BASE, recorder.now + 1.0)
    return path


@pytest.mark.parametrize("packed", [False, True])
def test_boxes_are_placed_and_what_is_missing_has_gone(tmp_path: Path, packed: bool) -> None:
    log = EvidenceLog(
        recorded(tmp_path / "camera.mcap", packed=packed),
        Reader({"class": ["cup", "bowl"]}, ("class",), 0.03),
    )
    model = WorldModel(
        WorldModelConfig(classes=["cup", "bowl"], region=((-2.0, 9.0), (-6.0, 6.0), (-0.5, 2.5)))
    )
    told = []
    with log:
        for look in log.looks():
            state = model.update(look.evidence, look.stamp)
            told.append({item.most_probable("class"): item.position for item in state.objects})
    assert len(told) == 42
    assert not log.summary.lines()
    assert set(told[29]) == {"cup", "bowl"}
    for name, (_, place) in (("cup", CUP), ("bowl", BOWL)):
        assert np.linalg.norm(told[29][name] - place) < 0.1
    assert set(told[-1]) == {"bowl"}
    assert any(name.startswith("found at") for name in log.camera.rates.figures())


def test_every_reason_why_nothing_was_usable_is_said(tmp_path: Path) -> None:
    recorder = CameraRecorder(tmp_path / "camera.mcap")
    with recorder.writer:
        recorder.transform("/tf_static", "base_link", "eye", MOUNT, 10.0)
        recorder.info()
        recorder.look({"cup-1": CUP}, 5, depth=False)
    with (
        EvidenceLog(tmp_path / "camera.mcap", Reader({"class": ["cup", "bowl"]}, ("class",), 0.03)) as log,
        pytest.raises(
            NothingRecognisedError, match=r"(?s)older than the oldest transform.*no depth image of 'eye'"
        ),
    ):
        list(log.looks())


def test_boxes_that_have_no_place_are_counted(tmp_path: Path) -> None:
    recorder = CameraRecorder(tmp_path / "camera.mcap")
    found = recorder._framed

    def as_shares(one: Framed) -> Any:
        item = found(one)
        box = item["bbox"]
        box["size_x"], box["size_y"] = box["size_x"] / 160.0, box["size_y"] / 120.0
        return item

    recorder._framed = as_shares  # type: ignore[method-assign]
    with recorder.writer:
        recorder.transform("/tf_static", "base_link", "eye", MOUNT, 10.0)
        recorder.transform("/tf", "map", "base_link", BASE, 10.0)
        recorder.info()
        recorder.look({"cup-1": CUP}, 5)
    with EvidenceLog(tmp_path / "camera.mcap", Reader({"class": ["cup"]}, ("class",), 0.03)) as log:
        looks = list(log.looks())
    assert not any(look.evidence.objects for look in looks)
    (said,) = log.summary.lines()
    assert "sides of at least a pixel" in said


def test_boxes_without_depth_are_skipped_and_said(tmp_path: Path) -> None:
    path = recorded(tmp_path / "camera.mcap", depth=False)
    with (
        EvidenceLog(path, Reader({"class": ["cup", "bowl"]}, ("class",), 0.03)) as log,
        pytest.raises(NothingRecognisedError, match=r"no depth image of 'eye' within 0\.05 s"),
    ):
        list(log.looks())


def in_space(path: Path, mapped: bool) -> Path:
    """A cup, told of in the frame of the camera, while the robot drives; tf comes after what it is for."""
    recorder = CameraRecorder(path)
    make = recorder.make
    with recorder.writer:
        recorder.transform("/tf_static", "base_link", "eye", MOUNT, 10.0)
        for step in range(8):
            recorder.now = now = 10.0 + step
            base, later = BASE.copy(), BASE.copy()
            base[1, 3] += 0.1 * step
            later[1, 3] += 0.1 * (step + 0.2)
            spot = np.linalg.solve(base @ MOUNT, np.append(CUP[1], 1.0))[:3]
            found = {"hypothesis": {"class_id": "cup", "score": 0.9}, "pose": {"pose": pose(spot)}}
            at = stamped(now, "eye")
            box = {"center": pose(spot), "size": xyz(np.full(3, 0.1))}
            one = {"header": at, "results": [found], "bbox": box}
            recorder.write("/found", DETECTIONS, make(DETECTIONS, header=at, detections=[one]), now)
            if mapped:
                recorder.transform("/tf", "map", "base_link", later, now + 0.2)
    return path


def test_detections_in_the_frame_of_a_driving_camera_are_placed(tmp_path: Path) -> None:
    reader = Reader({"class": ["cup", "bowl"]}, ("class",), 0.03)
    with EvidenceLog(in_space(tmp_path / "driven.mcap", True), reader) as log:
        looks = list(log.looks())
    # Of the first there is no transform before it; each of the others waits for the one after it.
    assert [look.stamp for look in looks] == [11.0, 12.0, 13.0, 14.0, 15.0, 16.0, 17.0]
    assert {look.frame for look in looks} == {"map"}
    for look in looks:
        np.testing.assert_allclose(look.evidence.objects[0].position, CUP[1], atol=1e-6)


def test_a_bag_whose_messages_are_compressed_is_unpacked_once(tmp_path: Path) -> None:
    plain = open_raw(in_space(tmp_path / "driven.mcap", True))
    packed = Writer(tmp_path / "packed", version=9, storage_plugin=StoragePlugin.MCAP)
    packed.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    connections: dict[str, Any] = {}
    with packed:
        for raw in plain:
            if raw.name not in connections:
                known = raw.topic
                connections[raw.name] = packed.add_connection(
                    raw.name, raw.type_name, msgdef=known.definition, rihs01=known.type_hash or "unknown"
                )
            packed.write(connections[raw.name], raw.log_time, raw.data)
    with EvidenceLog(tmp_path / "packed", Reader({"class": ["cup"]}, ("class",), 0.03)) as log:
        assert len(list(log.looks())) == 7
    assert not any("do not fit" in line for line in log.summary.lines())


def test_without_a_map_in_tf_detections_are_in_their_own_frame(tmp_path: Path) -> None:
    reader = Reader({"class": ["cup", "bowl"]}, ("class",), 0.03)
    with EvidenceLog(in_space(tmp_path / "still.mcap", False), reader) as log:
        looks = list(log.looks())
    assert len(looks) == 8
    assert {look.frame for look in looks} == {"eye"}


def test_without_a_map_in_tf_things_are_where_all_frames_stand(tmp_path: Path) -> None:
    recorder = CameraRecorder(tmp_path / "driven.mcap", "odom")
    with recorder.writer:
        recorder.info()
        recorder.transform("/tf_static", "base_link", "eye", MOUNT, 10.0)
        recorder.transform("/tf", "odom", "base_link", BASE, 10.0)
        recorder.look({"cup": CUP}, 20)
        recorder.transform("/tf", "odom", "base_link", BASE, recorder.now + 1.0)
    with EvidenceLog(tmp_path / "driven.mcap", Reader({"class": ["cup"]}, ("class",), 0.03)) as log:
        looks = list(log.looks())
    assert {look.frame for look in looks} == {"odom"}
    assert len(looks) == 20
    places = [item.position for look in looks for item in look.evidence.objects]
    assert len(places) > 10
    assert np.linalg.norm(places - CUP[1], axis=1).max() < 0.1
    (said,) = log.summary.lines()
    assert "its tf has no 'map': things are placed in 'odom', and drift with it" in said
