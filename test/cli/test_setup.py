"""`whereabouts setup` and `doctor` on recordings of robots that differ in frames, topics, clocks and publishers."""

from __future__ import annotations

import json
import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.writer import Writer
from typer.testing import CliRunner, Result

from estimation.geometry.poses import pose_to_matrix
from evaluation.scenes.small_robot import Naming, record
from registration import Scan
from whereabouts.cli.main import app
from whereabouts.logs import (
    CloudRecord,
    LogError,
    McapWriter,
    OdometryRecord,
    Qos,
    ScanRecord,
    Topic,
    TransformRecord,
)
from whereabouts.logs.bags.encode import header, scan_message, transform_message
from whereabouts.logs.bags.ros_types import standard_types
from whereabouts.logs.writer import LATCHED
from whereabouts.messages.type_names import BOXES, CAMERA_INFO, COMPRESSED, DETECTIONS, IMAGE
from whereabouts.parameter_file import problems_of_file, settings_for
from whereabouts.robot.choice import choose
from whereabouts.robot.findings import findings
from whereabouts.robot.preset import preset, preset_names
from whereabouts.robot.robot_file import as_text
from whereabouts.robot.survey import Survey
from whereabouts.simulation.world_bag import SuiteMessages
from whereabouts.suite_config import SuiteConfigError, read_config

runner = CliRunner()
SCAN = Scan(np.full(40, 2.0), -1.0, 0.05, 0.1, 8.0, 1.0)
TF = "tf2_msgs/msg/TFMessage"


def set_up(bag: Path, tmp_path: Path, *options: str) -> tuple[Result, Any]:
    out, figures = tmp_path / "robot.yaml", tmp_path / "found.json"
    result = runner.invoke(app, ["setup", str(bag), "--out", str(out), "--json", str(figures), *options])
    return result, json.loads(figures.read_text())["parameters"] if figures.exists() else None


class RobotRecording:
    """A bag with ten moments of a robot; what is wrong with it is added by the test."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __enter__(self) -> RobotRecording:
        self.writer = McapWriter(self.path)
        self.writer.__enter__()
        return self

    def __exit__(self, *error: Any) -> None:
        self.writer.__exit__(*error)

    def fixed(self, parent: str, child: str, x: float = 0.0) -> None:
        pose = pose_to_matrix(np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0]))
        self.writer.write_transforms([TransformRecord(pose, 1.0, parent, child, "tf_static")])

    def moving(self, parent: str, child: str, places: list[float], stamp: float = 1.0) -> None:
        for k, x in enumerate(places):
            pose = pose_to_matrix(np.array([x, 0.0, 0.0, 0.0, 0.0, 0.0]))
            self.writer.write_transforms([TransformRecord(pose, stamp + 0.1 * k, parent, child, "tf")])

    def scans(self, topic: str = "scan", frame: str = "laser", behind: float = 0.0) -> None:
        for k in range(10):
            stamp = 101.0 + 0.1 * k
            scan = Scan(SCAN.ranges, SCAN.angle_min, SCAN.angle_increment, 0.1, 8.0, stamp - behind)
            self.writer.write_scan(ScanRecord(scan, stamp - behind, topic, frame), round(1e9 * stamp))

    def wheels(self, topic: str, child: str = "base_link", frame: str = "odom") -> None:
        for k in range(10):
            stamp = 101.0 + 0.1 * k
            record_ = OdometryRecord(np.array([0.01 * k, 0.0, 0.0]), stamp, topic, frame, child)
            self.writer.write_odometry(record_, round(1e9 * stamp))

    def camera(self, kind: str, frame: str = "eye", image: str = "eye", packed: str = "") -> None:
        """A lens, pictures and depth images, and a detector of a kind in a frame; images : frame of the depth, which
        is compressed under a topic that ends in `packed`."""
        messages = SuiteMessages(BOXES, DETECTIONS)
        told: list[tuple[str, str, dict[str, Any]]] = [
            ("/eye/lens", CAMERA_INFO, {"header": header(101 * 10**9, "eye"), "width": 160, "height": 120}),
            ("/eye/color", IMAGE, {"header": header(101 * 10**9, "eye"), "encoding": "rgb8"}),
            ("/eye/aligned", IMAGE, {"header": header(101 * 10**9, image), "encoding": "16UC1"}),
            (
                "/eye/color/compressed",
                COMPRESSED,
                {"header": header(101 * 10**9, "eye"), "format": "rgb8; jpeg"},
            ),
            *((("/found", kind, {"header": header((202 + k) * 10**9 // 2, frame)})) for k in range(5)),
            ("/world/objects", DETECTIONS, {"header": header(101 * 10**9, "map")}),
        ]
        if packed:
            depth = {"header": header(101 * 10**9, image), "format": "16UC1; compressedDepth png"}
            told[2] = f"/eye/aligned{packed}", COMPRESSED, depth
        for topic, name, fields in told:
            where = messages.topic(topic, name) if name in (BOXES, DETECTIONS) else Topic(topic, name)
            data = messages.serialized(messages.make(name, **fields), name)
            self.writer.write_raw(where, data, 101 * 10**9)


def camera_of(tmp_path: Path, *camera: str) -> tuple[Result, Any]:
    """What is said, and given to world_model, of a robot with a scanner and such a camera."""
    bag = tmp_path / "camera.mcap"
    with RobotRecording(bag) as robot:
        robot.fixed("base_link", "laser")
        robot.scans()
        robot.camera(*camera)
    result, given = set_up(bag, tmp_path)
    assert result.exit_code == 0, result.output
    assert problems_of_file(tmp_path / "robot.yaml") == []
    return result, given.get("world_model")


@pytest.mark.parametrize(
    ("kind", "frame", "topic"),
    [
        (BOXES, "eye", "detections_2d_topic"),
        (DETECTIONS, "eye", "detections_topic"),
        (DETECTIONS, "base_link", "detections_topic"),
    ],
)
def test_a_detector_and_its_camera_are_connected(kind: str, frame: str, topic: str, tmp_path: Path) -> None:
    result, given = camera_of(tmp_path, kind, frame)
    assert given == {
        topic: "/found", "rate_hz": 2.0, "camera_info_topic": "/eye/lens", "depth_topic": "/eye/aligned"
    }  # fmt: skip
    assert "note: objects: /found, /eye/lens, /eye/aligned" in result.output
    assert "note: not used: /eye/color" in result.output


@pytest.mark.parametrize(("packed", "taken"), [("/compressedDepth", True), ("/squeezed", False)])
def test_depth_images_may_be_compressed(packed: str, taken: bool, tmp_path: Path) -> None:
    _, given = camera_of(tmp_path, BOXES, "eye", "eye", packed)
    assert given.get("depth_topic", "") == ("/eye/aligned/compressedDepth" if taken else "")
    assert given.get("depth_from_scan", False) != taken


def test_boxes_without_a_depth_image_of_their_frame_are_placed_by_the_scanner(tmp_path: Path) -> None:
    _, given = camera_of(tmp_path, BOXES, "eye", "infrared")
    assert (given["depth_from_scan"], given["scan_topic"]) == (True, "/scan")


def test_boxes_in_an_image_that_no_lens_is_of_are_warned_of(tmp_path: Path) -> None:
    result, given = camera_of(tmp_path, BOXES, "other")
    assert "warning: /found: no CameraInfo has its frame 'other'" in result.output
    assert given == {"detections_2d_topic": "/found", "rate_hz": 2.0}


def test_a_base_that_places_its_footprint_keeps_it(tmp_path: Path) -> None:
    bag = tmp_path / "tb3.mcap"
    record(bag, duration=3.0)
    result, given = set_up(bag, tmp_path)
    assert result.exit_code == 0, result.output
    assert given["/**"] == {"base_frame": "base_footprint", "odom_frame": "odom", "map_frame": "map"}
    assert given["scan_registration"] == {
        "publish_tf": False, "scan_topics": ["/scan"], "wheel_topic": "/odom"
    }  # fmt: skip
    path = tmp_path / "robot.yaml"
    assert problems_of_file(path) == []
    assert settings_for(path, "loop_closure").base_frame == "base_footprint"
    assert settings_for(path, "target_tracker").scan_topic == "/scan"
    config = read_config(path, {})
    assert config.params_file == path
    assert len(config.nodes) == 8, "all nodes run with it"


def test_scans_that_are_all_refused_stand_in_the_way(tmp_path: Path) -> None:
    bag = tmp_path / "degrees.mcap"
    in_degrees = scan_message(ScanRecord(SCAN, 101.0))
    in_degrees.angle_increment = 1.0
    with RobotRecording(bag) as robot:
        robot.fixed("base_link", "laser")
        for k in range(3):
            robot.writer.write_message(
                "scan", "sensor_msgs/msg/LaserScan", in_degrees, round(1e9 * (101 + k))
            )
    result, _ = set_up(bag, tmp_path)
    assert result.exit_code == 1
    assert "error: /scan: scan refused: angle_increment: radians expected" in result.output
    assert "(3 messages refused)" in result.output
    assert "between range_min and range_max" not in result.output
    assert not (tmp_path / "robot.yaml").exists()


def test_ranges_in_millimetres_are_asked_about(tmp_path: Path) -> None:
    bag = tmp_path / "millimetres.mcap"
    with RobotRecording(bag) as robot:
        robot.fixed("base_link", "laser")
        scan = Scan(1e3 * SCAN.ranges, SCAN.angle_min, SCAN.angle_increment, 100.0, 8000.0, 101.0)
        robot.writer.write_scan(ScanRecord(scan, 101.0))
    result, _ = set_up(bag, tmp_path)
    assert "are its ranges in millimetres?" in result.output


def test_what_is_to_know_of_a_cut_bag_is_one_note(tmp_path: Path) -> None:
    bag = tmp_path / "cut.mcap"
    record(bag, duration=3.0)
    whole = bag.read_bytes()
    bag.write_bytes(whole[: len(whole) // 2])
    result, _ = set_up(bag, tmp_path)
    assert "note: 1 × cut.mcap: not finished by its recorder" in result.output
    assert "note: note:" not in result.output


def test_a_base_without_tf_is_placed_by_the_suite(tmp_path: Path) -> None:
    bag = tmp_path / "husky.mcap"
    naming = Naming("front/scan", "odometry/filtered", "front_laser", "base_link", broadcast=False)
    record(bag, naming, duration=2.0)
    result, given = set_up(bag, tmp_path)
    assert result.exit_code == 0, result.output
    assert given["/**"]["base_frame"] == "base_link"
    assert given["scan_registration"] == {
        "publish_tf": True, "scan_topics": ["/front/scan"], "wheel_topic": "/odometry/filtered"
    }  # fmt: skip
    assert given["loop_closure"]["scan_topic"] == "/front/scan"


def test_frames_with_a_prefix(tmp_path: Path) -> None:
    bag = tmp_path / "prefixed.mcap"
    with RobotRecording(bag) as robot:
        robot.fixed("rob/chassis", "rob/laser")
        robot.moving("rob/odom", "rob/chassis", [0.01 * k for k in range(10)], 101.0)
        robot.moving("map", "rob/odom", [0.0] * 10, 101.0)
        robot.scans(frame="rob/laser")
    result, given = set_up(bag, tmp_path)
    assert result.exit_code == 0, result.output
    assert given["/**"] == {"base_frame": "rob/chassis", "odom_frame": "rob/odom", "map_frame": "map"}
    assert given["scan_registration"]["publish_tf"] is False
    assert given["loop_closure"]["publish_tf"] is False, "somebody places odom in the map already"
    assert "is published already, by a mapper or localiser" in result.output


def test_tf_in_a_namespace_says_where_the_nodes_have_to_run(tmp_path: Path) -> None:
    bag = tmp_path / "robot.mcap"
    with McapWriter(bag) as writer:
        for parent, child, name in (("odom", "base_link", "tf"), ("base_link", "laser", "tf_static")):
            sent = TransformRecord(np.eye(4), 101.0, parent, child, name)
            writer.write_message(f"/robot1/{name}", TF, transform_message([sent]), 101_000_000_000, LATCHED)
        for k in range(5):
            stamp = 101.0 + 0.1 * k
            scan = Scan(SCAN.ranges, SCAN.angle_min, SCAN.angle_increment, 0.1, 8.0, stamp)
            writer.write_scan(ScanRecord(scan, stamp, "robot1/scan", "laser"))
    result, given = set_up(bag, tmp_path)
    assert "--namespace /robot1 --bag" in result.stdout
    assert (given["/**"]["base_frame"], given["/**"]["odom_frame"]) == ("base_link", "odom")
    head = (tmp_path / "robot.yaml").read_text().splitlines()[1:3]
    assert ["--namespace /robot1" in head[0], head[1].endswith("namespace:=robot1")] == [True, True]


@pytest.mark.parametrize("other", ["scan_filtered", "a_scan"])
def test_a_scanner_is_followed_once_and_without_what_a_filter_took_out(other: str, tmp_path: Path) -> None:
    bag = tmp_path / "robot.mcap"
    with RobotRecording(bag) as recording:
        recording.fixed("base_link", "laser")
        recording.fixed("base_link", "rear")
        recording.scans("scan")
        recording.scans(other)
        recording.scans("rear_scan", "rear")
    result, given = set_up(bag, tmp_path)
    first = "/scan_filtered" if "filtered" in other else "/a_scan"
    assert set(given["scan_registration"]["scan_topics"]) == {first, "/rear_scan"}
    assert ", joined with /" in result.output
    assert "not used: /scan: of the same scanner" in result.stdout


def test_a_scanner_that_sees_something_goes_before_one_that_does_not(tmp_path: Path) -> None:
    bag = tmp_path / "robot.mcap"
    with RobotRecording(bag) as recording:
        recording.fixed("base_link", "laser")
        recording.scans("scan")
        nothing = Scan(np.full(40, np.nan), -1.0, 0.05, 0.1, 8.0, 101.0)
        recording.writer.write_scan(ScanRecord(nothing, 101.0, "a_scan", "laser"))
    result, given = set_up(bag, tmp_path)
    assert given["scan_registration"]["scan_topics"] == ["/scan"]
    assert "warning: /a_scan: none of 1 scans has a reading" in result.stdout


@pytest.mark.parametrize(
    ("roll", "pitch", "sentence"),
    [(np.pi, 0.0, "mounted upside down"), (0.0, 0.3, "'laser' is tilted by 17°"), (0.0, 0.0, "")],
)
def test_how_a_scanner_is_mounted_is_said(roll: float, pitch: float, sentence: str, tmp_path: Path) -> None:
    bag = tmp_path / "robot.mcap"
    with RobotRecording(bag) as recording:
        pose = pose_to_matrix(np.array([0.0, 0.0, 0.5, roll, pitch, 0.0]))
        recording.writer.write_transforms([TransformRecord(pose, 1.0, "plate", "laser", "tf_static")])
        recording.fixed("base_link", "plate")
        recording.scans()
    result, given = set_up(bag, tmp_path)
    assert given["/**"]["base_frame"] == "base_link"
    assert sentence in result.stdout
    assert sentence or not {"upside", "tilted"} & set(result.stdout.split())


def test_the_next_command_can_be_copied_whatever_the_folder_is_called(tmp_path: Path) -> None:
    folder = tmp_path / "Büro neu"
    folder.mkdir()
    bag = folder / "tb3.mcap"
    record(bag, duration=1.0)
    result, _ = set_up(bag, folder)
    words = shlex.split(result.stdout.partition("Next: ")[2])
    assert words == ["whereabouts", "run", "--config", str(folder / "robot.yaml"), "--bag", str(bag)]


def test_a_recording_without_tf_static_is_told_so(tmp_path: Path) -> None:
    bag = tmp_path / "robot.mcap"
    with RobotRecording(bag) as recording:
        recording.moving("odom", "base_footprint", [0.0, 0.1, 0.2])
        recording.scans("scan")
    result, given = set_up(bag, tmp_path)
    assert "No tf_static was seen" in result.stdout
    assert given["/**"]["base_frame"] == "laser"


def test_a_scanner_or_a_cloud_alone(tmp_path: Path) -> None:
    bag = tmp_path / "scanner.mcap"
    with RobotRecording(bag) as robot:
        robot.scans()
    result, given = set_up(bag, tmp_path)
    assert result.exit_code == 0, result.output
    assert given["/**"]["base_frame"] == "laser"
    assert "nobody says on tf how 'laser' is mounted" in result.output
    bag = tmp_path / "cloud.mcap"
    with McapWriter(bag) as writer:
        writer.write_cloud(CloudRecord(np.ones((5, 3)), 1.0, "velodyne", "lidar"))
    _, given = set_up(bag, tmp_path, "--overwrite")
    assert given["scan_registration"]["cloud_topics"] == ["/velodyne"]
    assert given["loop_closure"]["cloud_topic"] == "/velodyne"
    assert given["verifier"] == {"cloud_topic": "/velodyne"}


def test_a_log_that_is_no_bag(tmp_path: Path) -> None:
    log = tmp_path / "old.clf"
    line = "FLASER 5 2.0 2.0 2.0 2.0 2.0 {x:.2f} 0.0 0.0 {x:.2f} 0.0 0.0 {t:.2f} host {t:.2f}\n"
    log.write_text("".join(line.format(x=0.1 * k, t=100.0 + 0.1 * k) for k in range(5)))
    result, given = set_up(log, tmp_path)
    assert result.exit_code == 0, result.output
    assert given["scan_registration"]["scan_topics"] == ["/scan"]
    assert given["scan_registration"]["wheel_topic"] == "/wheel_odom"


@pytest.mark.parametrize("topic", ["ground_truth/odom", "lidar_odom", "mapper"])
def test_odometry_that_is_none_of_the_wheels_is_not_taken(topic: str, tmp_path: Path) -> None:
    bag = tmp_path / "truth.mcap"
    with RobotRecording(bag) as robot:
        robot.fixed("base_link", "laser")
        robot.wheels(topic)
        robot.scans()
    result, given = set_up(bag, tmp_path)
    assert "wheel_topic" not in given["scan_registration"]
    assert "is taken for wheel odometry" in result.output


def two_parents(robot: RobotRecording) -> None:
    robot.fixed("base_footprint", "base_link")
    robot.fixed("base_link", "laser")
    robot.moving("odom", "base_link", [0.01 * k for k in range(10)], 101.0)
    robot.scans()


def two_publishers(robot: RobotRecording) -> None:
    robot.fixed("base_link", "laser")
    robot.moving("odom", "base_link", [k % 2 + 0.01 * k for k in range(20)], 101.0)
    robot.scans()


def two_mountings(robot: RobotRecording) -> None:
    robot.fixed("base_link", "laser", 0.1)
    robot.fixed("base_link", "laser", 0.3)
    robot.scans()


def clocks_apart(robot: RobotRecording) -> None:
    robot.fixed("base_link", "laser")
    robot.wheels("odom")
    robot.wheels("imu_odom")
    robot.scans(behind=40.0)


def not_connected(robot: RobotRecording) -> None:
    robot.fixed("base_link", "camera")
    robot.moving("odom", "base_link", [0.0] * 10, 101.0)
    robot.scans(frame="")


def never_stamped(robot: RobotRecording) -> None:
    robot.fixed("base_link", "laser")
    for k in range(5):
        scan = Scan(SCAN.ranges, SCAN.angle_min, SCAN.angle_increment, 0.1, 8.0, 0.0)
        robot.writer.write_scan(ScanRecord(scan, 0.0, "scan", "laser"), (101 + k) * 10**9)


def several_echoes(robot: RobotRecording) -> None:
    types = standard_types().types
    header = types["std_msgs/msg/Header"](types["builtin_interfaces/msg/Time"](101, 0), "laser")
    echo = types["sensor_msgs/msg/LaserEcho"](np.array([2.0, 2.5], dtype=np.float32))
    kind = "sensor_msgs/msg/MultiEchoLaserScan"
    message = types[kind](header, -1.0, 1.0, 0.1, 0.0, 0.0, 0.1, 8.0, [echo] * 21, [echo] * 21)
    robot.writer.write_message("echoes", kind, message, 101 * 10**9)


def best_effort_tf(robot: RobotRecording) -> None:
    robot.scans()
    topic = Topic("/tf_static", TF, qos=(Qos(reliability="best_effort", durability="volatile"),))
    mount = transform_message([TransformRecord(np.eye(4), 1.0, "base_link", "laser", "tf_static")])
    robot.writer.write_raw(topic, bytes(standard_types().serialize_cdr(mount, TF)), 101_000_000_000)


@pytest.mark.parametrize(
    ("spoil", "sentence"),
    [
        (two_parents, "frame 'base_link' has two parents: 'base_footprint' and 'odom'"),
        (two_publishers, "two publishers place 'base_link' in 'odom' and disagree"),
        (two_mountings, "two publishers place 'laser' in 'base_link' and disagree"),
        (clocks_apart, "/scan: its clock is 40.0 s behind the others"),
        (not_connected, "/scan: its frame_id is empty"),
        (best_effort_tf, "/tf_static is published volatile"),
        (never_stamped, "/scan: its stamps are all 0"),
        (
            several_echoes,
            "/echoes is a MultiEchoLaserScan: let the driver or laser_proc publish its first echo",
        ),
    ],
)
def test_what_stands_in_the_way_is_said_and_nothing_is_written(
    spoil: Any, sentence: str, tmp_path: Path
) -> None:
    bag = tmp_path / "bad.mcap"
    with RobotRecording(bag) as robot:
        spoil(robot)
    result, _ = set_up(bag, tmp_path)
    assert sentence in result.output
    assert result.exception is not None
    assert "was not written" in str(result.exception)
    assert not (tmp_path / "robot.yaml").exists()
    examined = runner.invoke(app, ["doctor", str(bag)])
    assert examined.exit_code == 1
    assert f"error: {sentence}" in examined.output


def test_a_scanner_that_never_spoke_is_no_robot_to_set_up(tmp_path: Path) -> None:
    bag = tmp_path / "silent.mcap"
    with bag.open("wb") as stream:
        writer = Writer(stream)
        writer.start("ros2")
        schema = writer.register_schema("sensor_msgs/msg/LaserScan", "ros2msg", b"float32 range_min")
        writer.register_channel("/scan", "cdr", schema)
        writer.finish()
    result, _ = set_up(bag, tmp_path)
    assert "/scan: no message came" in result.output
    assert "was not written" in str(result.exception)
    assert runner.invoke(app, ["doctor", str(bag)]).exit_code == 1


def test_doctor_says_where_packages_come_from(tmp_path: Path) -> None:
    bag = tmp_path / "tb3.mcap"
    record(bag, duration=2.0)
    result = runner.invoke(app, ["doctor", str(bag)])
    assert result.exit_code == 0, result.output
    folder = Path(__file__).resolve().parents[2]
    assert f"tracking: {folder / 'tracking'}" in result.output
    assert "0 errors, 0 warnings" in result.output


def test_doctor_says_nothing_before_an_error(tmp_path: Path) -> None:
    result = runner.invoke(app, ["doctor", str(tmp_path / "none.mcap")])
    assert isinstance(result.exception, LogError)
    assert not result.output


@pytest.mark.parametrize("name", preset_names())
def test_a_preset_is_a_file_that_nodes_take(name: str, tmp_path: Path) -> None:
    out = tmp_path / "robot.yaml"
    result = runner.invoke(app, ["setup", "--no-look", "--preset", name, "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert problems_of_file(out) == []
    wanted = preset(name)
    settings = settings_for(out, "scan_registration")
    assert settings.base_frame == wanted.base_frame
    assert settings.publish_tf is not wanted.base_publishes_tf
    assert settings.scan_topics == wanted.scan_topics


def test_a_file_that_exists_is_kept_unless_it_is_to_be_replaced(tmp_path: Path) -> None:
    out = tmp_path / "robot.yaml"
    out.write_text("# tuned by hand\n")
    asked = ["setup", "--no-look", "--preset", "turtlebot3", "--out", str(out)]
    refused = runner.invoke(app, asked)
    assert isinstance(refused.exception, LogError)
    assert str(refused.exception).startswith(f"{out}: exists and was kept; --overwrite")
    assert out.read_text() == "# tuned by hand\n"
    assert runner.invoke(app, [*asked, "--overwrite"]).exit_code == 0
    assert problems_of_file(out) == []


def test_an_unknown_preset_names_the_others() -> None:
    result = runner.invoke(app, ["setup", "--no-look", "--preset", "turtlebot5"])
    assert "turtlebot3" in str(result.exception)


def test_a_robot_where_nothing_runs_is_an_error() -> None:
    survey = Survey("the running robot", live=True)
    said = findings(survey, choose(survey))
    assert [str(item) for item in said if item.level == "error"] == [
        "error: the running robot has neither LaserScan nor PointCloud2 messages"
    ]


def test_the_file_is_yaml_whatever_the_sentences_are(tmp_path: Path) -> None:
    bag = tmp_path / "tb3.mcap"
    record(bag, duration=2.0)
    from whereabouts.robot.bags import survey_bag

    survey = survey_bag(bag)
    choice = choose(survey)
    text = as_text(choice, findings(survey, choice), "a:\n b", "found.yaml")
    assert "run --config found.yaml" in text
    content = yaml.safe_load(text)
    assert content["/**"]["ros__parameters"]["base_frame"] == "base_footprint"


def test_mistakes_in_a_parameter_file_are_named(tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    content = {
        "/**": {"ros__parameters": {"base_farme": "x"}},
        "/**/loop_closure": {"ros__parameters": {"resolution": 99.0, "scan_topics": ["a"]}},
        "/**/target_traker": {"ros__parameters": {"prior": -3.5}},
        "controller_server": {"ros__parameters": {"controller_frequency": 20.0}},
    }
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(SuiteConfigError) as error:
        read_config(path, {})
    assert "base_farme: no node has such a parameter; did you mean 'base_frame'?" in str(error.value)
    assert "/target_traker: there is no such node; did you mean 'target_tracker'?" in str(error.value)
    assert "controller_server" not in str(error.value)
    assert "resolution: float from 0.01 to 1 m expected, got 99.0" in str(error.value)
    assert "scan_topics: there is no such parameter; did you mean 'scan_topic'?" in str(error.value)
