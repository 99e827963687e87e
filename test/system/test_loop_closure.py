"""scan_registration and loop_closure over DDS: loops close, none is wrong, and a killed node goes on in its map."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from harness import START, Graph, Robot, planar, scan_message
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid as GridMessage
from rclpy.serialization import deserialize_message
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.poses import (
    between,
    compound,
    pose_from_matrix,
    pose_from_quaternion,
    pose_to_matrix,
    pose_to_quaternion,
)
from estimation.metrics.statistics import absolute_trajectory_error
from evaluation.scenes.outdoor import SpinningLidar, random_neighbourhood
from evaluation.scenes.outdoor import round_trip as street_round
from whereabouts.logs import McapWriter, OdometryRecord, ScanRecord, TransformRecord, open_raw
from whereabouts.nodes.messages.conversions import cloud_message, fill_pose, spatial
from whereabouts.nodes.messages.message_types import message_class
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts.nodes.runtime.suite_run import SuiteRun, replay_spec, run_suite
from whereabouts.nodes.runtime.supervisor import NodeSpec
from whereabouts.simulation import Drive, Lidar, Shapes, Wheels, box, joined
from whereabouts_msgs.msg import LoopClosure, Processed
from whereabouts_msgs.srv import LoadMap, SaveMap

RECORDED = [
    ("loop_closures", "whereabouts_msgs/msg/LoopClosure"),
    ("trajectory", "nav_msgs/msg/Path"),
    ("map", "nav_msgs/msg/OccupancyGrid"),
]


def ring() -> Shapes:
    """A round of 44 m through a furnished building."""
    rng = np.random.default_rng(3)
    furniture = [
        box(rng.uniform(0.3, 1.2), rng.uniform(0.2, 0.5), (x, y, rng.uniform(0.0, 3.0)))
        for x, y in (
            (-7.5, 5.4), (-3.0, 5.5), (1.2, 5.3), (6.0, 5.4), (7.6, 0.8), (7.4, -3.0), (4.2, -5.5), (0.3, -5.4),
            (-4.4, -5.5), (-7.6, -1.2), (-7.4, 2.2), (2.5, 2.9), (-4.0, -2.9),
        )
    ]  # fmt: skip
    return joined([box(16.0, 12.0), box(11.0, 7.0), *furniture])


def round_trip(laps: float) -> Drive:
    corners = [(-6.8, -4.7), (6.8, -4.7), (6.8, 4.7), (-6.8, 4.7)]
    count = int(4 * laps) + 1
    return Drive([corners[k % 4] for k in range(count)], speed=0.7, turn_rate=0.8)


@pytest.fixture(scope="module")
def bag(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[float, np.ndarray]]:
    """Nearly two laps, with wheels that drift; and the true poses by stamp."""
    path = tmp_path_factory.mktemp("bag") / "ring.mcap"
    drive, lidar, rng, world = round_trip(1.75), Lidar(181), np.random.default_rng(5), ring()
    start, truth, wheels, reported = START / NANOSECONDS, {}, Wheels(), np.zeros(3)
    before = drive(0.0)
    with McapWriter(path) as writer:
        writer.write_transforms([TransformRecord(np.eye(4), start, "base_link", "laser", "tf_static")])
        for k in range(int(drive.duration / 0.2)):
            stamp = start + 0.2 * k
            pose = drive(0.2 * k)
            reported = compound(reported, wheels.motion(before, pose, rng))
            before = pose
            scan = lidar.scan(world, pose, rng, stamp).scan
            writer.write_odometry(OdometryRecord(reported, stamp))
            writer.write_scan(ScanRecord(scan, scan.stamp))
            truth[round(stamp, 3)] = between(drive(0.0), pose)
    return path, truth


def nearest(truth: dict[float, np.ndarray], stamp: int) -> np.ndarray:
    seconds = stamp / NANOSECONDS
    return truth[min(truth, key=lambda known: abs(known - seconds))]


def test_a_bag_with_a_loop(bag: tuple[Path, dict[float, np.ndarray]], tmp_path: Path) -> None:
    path, truth = bag
    out = tmp_path / "out.mcap"
    nodes = [replay_spec("scan_registration"), replay_spec("loop_closure")]
    nodes[1].parameters["map_period"] = 0.05
    account = run_suite(SuiteRun(path, nodes, tmp_path / "logs", record=RECORDED, output=out))
    assert account.total_lost == 0
    closures: list[LoopClosure] = []
    trajectory = grid = None
    with open_raw(out, [name for name, _ in RECORDED]) as log:
        for raw in log:
            message = deserialize_message(raw.data, message_class(raw.type_name))
            if isinstance(message, LoopClosure):
                closures.append(message)
            elif isinstance(message, GridMessage):
                grid = message
            else:
                trajectory = message
    assert len(closures) >= 20
    for closure in closures:
        a = nearest(truth, nanoseconds(closure.earlier_stamp))
        b = nearest(truth, nanoseconds(closure.header.stamp))
        miss = between(between(a, b), planar(closure.relative.pose))
        assert np.hypot(*miss[:2]) < 0.25, "a false closure"
        assert abs(miss[2]) < 0.1
        assert closure.accepted
        assert closure.reason
    assert trajectory is not None
    estimate = np.array([planar(item.pose)[:2] for item in trajectory.poses])
    expected = np.array([nearest(truth, nanoseconds(item.header.stamp))[:2] for item in trajectory.poses])
    assert len(estimate) >= 60
    assert absolute_trajectory_error(estimate, expected).rmse < 0.06
    assert grid is not None
    values = np.array(grid.data, dtype=np.int8).reshape(grid.info.height, grid.info.width)
    assert set(np.unique(values)) == {-1, 0, 100}


class Mapper(Robot):
    """The robot in the ring, with the two nodes that keep it in the map."""

    def __init__(self, graph: Graph) -> None:
        super().__init__(graph)
        self.world, self.drive, self.lidar = ring(), round_trip(3), Lidar(181)
        self.transforms = graph.collect(TFMessage, "tf")
        self.mapped: list[Processed] = graph.collect(Processed, "loop_closure/processed")

    def send(self, message: LaserScan, topic: str = "scan") -> None:
        """Publish a scan and wait for both nodes, so that none runs ahead of the other."""
        before, self.sent = len(self.mapped), message.header.stamp
        super().send(message, topic)
        self.graph.until(
            lambda: any(answer.stamp == message.header.stamp for answer in self.mapped[before:]),
            f"loop_closure has the scan at {message.header.stamp.sec}",
        )

    def introduce(self) -> None:
        """Both nodes know each other, and start afresh."""
        scan = scan_message(self.scan(0.0))
        self.graph.introduce(scan, lambda: "map" in self.frames(), "scan_registration", "loop_closure")
        self.transforms.clear()

    def frames(self) -> set[str]:
        """Parents of the transforms that were heard."""
        return {item.header.frame_id for message in self.transforms for item in message.transforms}

    @property
    def used(self) -> int:
        """How many scans loop_closure has used since it was started."""
        last = next(answer for answer in reversed(self.mapped) if answer.topic.endswith("scan"))
        return int(last.received - last.dropped)

    def in_map(self) -> list[np.ndarray]:
        """Pose of the robot in the map at the last scan, as tf has it; [] until tf has it."""
        found: dict[str, np.ndarray] = {}
        at = None
        for message in self.transforms:
            for item in message.transforms:
                t, q = item.transform.translation, item.transform.rotation
                found[item.header.frame_id] = np.array([t.x, t.y, 2.0 * np.arctan2(q.z, q.w)])
                at = item.header.stamp if item.header.frame_id == "odom" else at
        return [compound(found["map"], found["odom"])] if "map" in found and at == self.sent else []


def test_a_killed_node_goes_on_in_its_saved_map(graph: Graph, tmp_path: Path) -> None:
    robot = Mapper(graph)
    graph.start("scan_registration")
    spec = graph.start("loop_closure", map_file=str(tmp_path / "ring"), map_period=0.1)
    maps = graph.collect(GridMessage, "map", LATCHED)
    graph.mount()
    robot.introduce()
    # The whole round: a side that is in no map looks like the one across.
    robot.go(0.0, 74.0, 0.25)
    answer = graph.call(SaveMap, "loop_closure/save_map", SaveMap.Request())
    assert answer.code == SaveMap.Response.SUCCESS, answer.message
    assert (tmp_path / "ring.npz").exists()
    graph.until(lambda: maps, "a map")
    saved = OccupancyGrid.load(tmp_path / "ring.yaml")
    assert saved.occupied.sum() > 200
    graph.kill(spec)
    robot.transforms.clear()
    spec = graph.start("loop_closure", map_file=str(tmp_path / "ring"), map_period=0.1)
    now = 74.0

    def goes_on(seconds: float, step: float) -> bool:
        nonlocal now
        robot.go(now, now + seconds, step)
        now += seconds
        return robot.used > 0

    # Scans without transforms are left out until the node has met who sends these, however long that takes.
    graph.until(lambda: goes_on(0.1, 0.1), "the node that was started again uses scans")
    while "the robot was found in the map" not in graph.log(spec):
        assert robot.used < 80, "twenty seconds of scans were used, and the robot was not found in the map"
        assert goes_on(1.0, 0.25)
    robot.go(now, now + 1.0, 0.25)
    pose = graph.until(robot.in_map, "tf has the robot in the map")[0]
    miss = between(robot.truth(now + 0.75), pose)
    assert np.hypot(*miss[:2]) < 0.25
    assert abs(miss[2]) < 0.06


def test_changes_of_a_map_are_sent_to_who_listens(graph: Graph) -> None:
    robot = Mapper(graph)
    graph.start("scan_registration")
    graph.start("loop_closure", map_period=1.0)
    maps = graph.collect(GridMessage, "map", LATCHED)
    updates = graph.collect(OccupancyGridUpdate, "map_updates")
    graph.mount()
    robot.introduce()
    robot.go(0.0, 1.0, 0.25)
    graph.until(lambda: maps, "a whole map, of which changes can be told")
    # Maps and their changes go out by the wall clock, the robot drives as fast as its scans are answered: after each
    # second of driving it waits until a map's time has passed, which a dozen reports of the nodes tell.
    said = graph.collect(DiagnosticArray, "/diagnostics")
    now = 1.0
    while not updates:
        assert now < 74.0, "the robot has been round, and no change of its map was sent"
        robot.go(now, now + 1.0, 0.25)
        now += 1.0
        heard = len(said)
        graph.until(lambda: updates or len(said) >= heard + 12, "the time of a map has passed")  # noqa: B023
    update = updates[0]
    assert update.header.frame_id == "map"
    assert len(update.data) == update.width * update.height > 0
    assert {-1, 0, 100} >= set(update.data)
    assert any(
        0 <= update.x <= whole.info.width - update.width
        and 0 <= update.y <= whole.info.height - update.height
        for whole in maps
    )


def test_localises_only_from_an_initial_pose(graph: Graph, tmp_path: Path) -> None:
    robot = Mapper(graph)
    graph.start("scan_registration")
    spec = graph.start("loop_closure", allowed_folders=[str(tmp_path)])
    graph.mount()
    robot.introduce()
    robot.go(0.0, 20.0, 0.25)
    stem = str(tmp_path / "ring")
    (tmp_path / "mine.yaml").write_text("port: 22")
    for foreign in (str(tmp_path / "mine"), "/etc/ring", str(tmp_path / ".." / "ring")):
        refused = graph.call(SaveMap, "loop_closure/save_map", SaveMap.Request(path=foreign))
        assert refused.code == SaveMap.Response.REFUSED, refused.message
    assert (tmp_path / "mine.yaml").read_text() == "port: 22"
    refused = graph.call(SaveMap, "loop_closure/save_map", SaveMap.Request())
    assert refused.code == SaveMap.Response.REFUSED
    assert graph.call(SaveMap, "loop_closure/save_map", SaveMap.Request(path=stem)).code == 0
    missing = graph.call(LoadMap, "loop_closure/load_map", LoadMap.Request(path=str(tmp_path / "none")))
    assert missing.code == LoadMap.Response.REFUSED
    answer = graph.call(LoadMap, "loop_closure/load_map", LoadMap.Request(path=stem, localization_only=True))
    assert answer.code == LoadMap.Response.SUCCESS, answer.message
    before = (tmp_path / "ring.npz").read_bytes()
    said = PoseWithCovarianceStamped()
    said.header.frame_id = "map"
    fill_pose(said.pose.pose, spatial(robot.truth(19.75) + np.array([0.3, -0.2, 0.1])))
    robot.transforms.clear()
    graph.publish("initialpose", said)
    graph.until(lambda: graph.heard(spec, "/initialpose"), "the node has been told where the robot is")
    robot.go(20.0, 23.0, 0.25)
    pose = graph.until(robot.in_map, "a pose in the map")[0]
    assert np.hypot(*between(robot.truth(22.75), pose)[:2]) < 0.2
    assert (tmp_path / "ring.npz").read_bytes() == before
    assert "defect" not in graph.log(spec)


class Street:
    """A robot with a spinning lidar in a street, and the map that loop_closure makes of it; odometry is the test's."""

    def __init__(self, graph: Graph) -> None:
        self.graph, self.rng, self.lidar = graph, np.random.default_rng(12), SpinningLidar()
        self.world, self.way = random_neighbourhood(np.random.default_rng(31)), street_round(200)
        self.processed: list[Processed] = graph.collect(Processed, "loop_closure/processed")
        self.transforms: list[TFMessage] = graph.collect(TFMessage, "tf")
        self.sent = 0

    def truth(self, k: int) -> np.ndarray:
        """Pose (4, 4) in the frame of the first."""
        return np.asarray(np.linalg.inv(self.way[0]) @ self.way[k])

    def go(self, first: int, last: int, origin: np.ndarray) -> None:
        """Drive on, a cloud a metre, the odometry frame lying at `origin` in the true one."""
        for k in range(first, last):
            self.sent += 1
            stamp = START + self.sent * NANOSECONDS // 2
            self.place(k, stamp, origin)
            cloud = self.lidar.cloud(self.world, self.way[k], self.rng)
            header = Header(stamp=time_message(stamp), frame_id="base_link")
            self.graph.publish("points", cloud_message(header, cloud))
            self.graph.until(
                lambda header=header: any(answer.stamp == header.stamp for answer in self.processed),
                f"cloud {k} is processed",
            )

    def place(self, k: int, stamp: int, origin: np.ndarray) -> None:
        """Say where the robot is."""
        position, quaternion = pose_to_quaternion(pose_from_matrix(np.linalg.inv(origin) @ self.truth(k)))
        base = transform_message("odom", "base_link", stamp, (*position, *quaternion))
        self.graph.publish("tf", TFMessage(transforms=[base]))

    def introduce(self, spec: NodeSpec, k: int, origin: np.ndarray) -> None:
        """A node that has just begun may miss the first transforms: tell them until it hears one."""

        def again() -> bool:
            self.place(k, START + self.sent * NANOSECONDS // 2, origin)
            return self.graph.heard(spec, "/tf") > 0

        self.graph.until(again, "transforms are heard")

    def correction(self) -> np.ndarray:
        """Latest pose (4, 4) of odom in map."""
        told = [item for m in self.transforms for item in m.transforms if item.header.frame_id == "map"]
        if not told:
            return np.zeros((0, 0))
        t, q = told[-1].transform.translation, told[-1].transform.rotation
        return pose_to_matrix(pose_from_quaternion([t.x, t.y, t.z], [q.x, q.y, q.z, q.w]))


@pytest.mark.usefixtures("kiss_matcher")
def test_a_map_of_clouds_is_saved_and_the_robot_found_in_it_again(graph: Graph, tmp_path: Path) -> None:
    """Killed, started again in mid-run with odometry that begins anew; and localising only, from RViz's pose."""
    robot, stem = Street(graph), str(tmp_path / "street")
    spec = graph.start("loop_closure", cloud_topic="points", map_file=stem)
    robot.go(0, 14, np.eye(4))
    answer = graph.call(SaveMap, "loop_closure/save_map", SaveMap.Request())
    assert answer.code == SaveMap.Response.SUCCESS, answer.message
    before = (tmp_path / "street.npz").read_bytes()
    graph.kill(spec)
    robot.transforms.clear()
    spec = graph.start("loop_closure", cloud_topic="points", map_file=stem)
    origin = pose_to_matrix(np.array([30.0, -8.0, 0.5, 0.01, 0.0, 0.9]))
    robot.introduce(spec, 6, origin)
    robot.go(6, 14, origin)
    graph.until(lambda: len(robot.correction()), "the robot is found in the map")
    found = robot.correction()
    assert np.linalg.norm((np.linalg.inv(origin) @ found)[:3, 3]) < 0.5
    assert np.linalg.norm((found @ np.linalg.inv(origin) @ robot.truth(13) - robot.truth(13))[:3, 3]) < 0.2
    assert "extended" in graph.log(spec)

    load = LoadMap.Request(path=stem, localization_only=True)
    assert graph.call(LoadMap, "loop_closure/load_map", load).code == LoadMap.Response.SUCCESS
    robot.transforms.clear()
    said = PoseWithCovarianceStamped()
    said.header.frame_id = "map"
    start = pose_from_matrix(robot.truth(4)) + np.array([0.5, -0.3, 0.0, 0.0, 0.0, 0.15])
    fill_pose(said.pose.pose, spatial(start[[0, 1, 5]]))
    graph.publish("initialpose", said)
    graph.until(lambda: graph.heard(spec, "/initialpose"), "the node has been told where the robot is")
    robot.go(4, 9, origin)

    def close() -> bool:
        found = robot.correction() @ np.linalg.inv(origin) @ robot.truth(8)
        return bool(np.linalg.norm((found - robot.truth(8))[:3, 3]) < 0.2)

    graph.until(lambda: len(robot.correction()) and close(), "the robot is where it was said to be")
    assert (tmp_path / "street.npz").read_bytes() == before
    assert "defect" not in graph.log(spec)
