"""The node scan_registration over real DDS: it follows, and survives what robots send it."""

from __future__ import annotations

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import TransformStamped
from harness import START, Graph, Robot, planar, scan_message, wheel_message
from lifecycle_msgs.msg import State, Transition
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import DescribeParameters, SetParameters
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from registration import Scan
from whereabouts.nodes.messages.conversions import cloud_message, points_from_message
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.nodes.runtime.supervisor import SuiteError
from whereabouts_msgs.srv import Reset

NODE = "scan_registration"


def position_error(robot: Robot, time: float) -> float:
    pose = robot.poses()[time]
    return float(np.hypot(*(pose - robot.truth(time))[:2]))


def settled(robot: Robot, count: int) -> None:
    robot.graph.until(lambda: len(robot.odometry) >= count, f"{count} odometry messages")


def test_follows_a_drive_with_one_pose_per_scan(graph: Graph) -> None:
    robot = Robot(graph)
    transforms = graph.collect(TFMessage, "tf")
    clouds = graph.collect(PointCloud2, "static_points")
    graph.start(NODE)
    graph.mount()
    robot.go(0.0, 6.0)
    settled(robot, 60)
    stamps = [round(t, 3) for t in robot.poses()]
    assert stamps == [round(0.1 * k, 3) for k in range(60)]
    assert position_error(robot, max(robot.poses())) < 0.05
    last = robot.odometry[-1]
    assert (last.header.frame_id, last.child_frame_id) == ("odom", "base_link")
    covariance = np.array(last.pose.covariance).reshape(6, 6)[np.ix_([0, 1, 5], [0, 1, 5])]
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    assert last.twist.twist.linear.x == pytest.approx(0.5, abs=0.1)

    def same_transform() -> list[TransformStamped]:
        return [t for m in transforms for t in m.transforms if t.header.stamp == last.header.stamp]

    transform = graph.until(same_transform, "tf for the last scan")[0]
    assert transform.transform.translation.x == pytest.approx(last.pose.pose.position.x)
    graph.until(lambda: len(clouds) >= 60, "static points for every scan")
    assert clouds[-1].width > 250


@pytest.mark.parametrize(
    ("kind", "expected"),
    [
        ("empty", "without readings"),
        ("zero increment", "angle_increment"),
        ("infinite angle", "angle_min"),
        ("bad bounds", "range_max"),
    ],
)
def test_malformed_scan_is_refused_named_and_counted(graph: Graph, kind: str, expected: str) -> None:
    robot = Robot(graph)
    spec = graph.start(NODE)
    graph.mount()
    robot.go(0.0, 0.3)
    bad = scan_message(robot.scan(0.35))
    if kind == "empty":
        bad.ranges = []
    elif kind == "zero increment":
        bad.angle_increment = 0.0
    elif kind == "infinite angle":
        bad.angle_min = float("inf")
    else:
        bad.range_max = -1.0
    robot.send(bad)
    robot.go(0.4, 0.6)
    settled(robot, 5)
    assert position_error(robot, max(robot.poses())) < 0.05
    graph.until(lambda: robot.figures().get("/scan dropped, refused") == "1", "the drop in diagnostics")
    assert "/scan: refused" in graph.log(spec)
    assert expected in graph.log(spec)


@pytest.mark.parametrize("value", [np.nan, np.inf, 0.0, 1e9])
def test_scan_without_any_return_keeps_the_pose_and_says_so(graph: Graph, value: float) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    graph.mount()
    robot.go(0.0, 0.5)
    scan = robot.scan(0.5)
    blind = Scan(np.full(len(scan), value), scan.angle_min, scan.angle_increment, 0.05, 25.0, scan.stamp)
    robot.send(scan_message(blind))
    robot.go(0.6, 1.0)
    settled(robot, 10)
    graph.until(lambda: int(robot.figures().get("unsure", "0")) >= 1, "it says that it was unsure")
    assert position_error(robot, 0.5) < 0.2
    assert position_error(robot, max(robot.poses())) < 0.05


def test_beam_count_may_change_while_running(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    graph.mount()
    robot.go(0.0, 1.0)
    robot.lidar = type(robot.lidar)(beams=181, opening=np.pi, range_max=25.0)
    robot.go(1.0, 2.0)
    settled(robot, 20)
    assert position_error(robot, max(robot.poses())) < 0.05


def test_missing_transform_is_named_and_later_scans_are_used(graph: Graph) -> None:
    robot = Robot(graph)
    spec = graph.start(NODE, transform_timeout=0.2)
    # By message time: the stamps that follow are beyond it.
    robot.go(0.0, 0.45)
    graph.until(lambda: robot.figures().get("/scan dropped, no transform") == "1", "the drop in diagnostics")
    assert "no transform from 'laser' to 'base_link'" in graph.log(spec)
    graph.mount()
    robot.go(0.5, 0.75)
    settled(robot, 7)


def test_scan_waits_for_its_transform(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    robot.send(scan_message(robot.scan(0.0)))
    robot.send(scan_message(robot.scan(0.1)))
    assert not robot.odometry
    graph.mount()
    settled(robot, 2)
    assert list(robot.poses()) == [0.0, 0.1]


def test_time_going_back_starts_a_new_run_and_says_it_once(graph: Graph) -> None:
    robot = Robot(graph)
    spec = graph.start(NODE)
    graph.mount()
    robot.go(5.0, 6.0)
    settled(robot, 10)
    robot.odometry.clear()
    robot.go(0.0, 1.0)
    settled(robot, 10)
    assert np.allclose(robot.poses()[0.0], 0.0, atol=1e-6)
    assert position_error(robot, max(robot.poses())) < 0.05
    assert graph.log(spec).count("a new run begins") == 1
    graph.until(lambda: robot.figures().get("new runs") == "1", "the new run in diagnostics")


def test_late_scan_within_the_window_is_handled(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    graph.mount()
    robot.go(0.0, 0.5)
    robot.send(scan_message(robot.scan(0.25)))
    settled(robot, 6)
    graph.until(lambda: robot.figures().get("/scan late") == "1", "the late scan in diagnostics")
    assert robot.figures()["new runs"] == "0"


def test_killed_node_comes_back_alone(graph: Graph) -> None:
    robot = Robot(graph)
    spec = graph.start(NODE)
    graph.mount()
    robot.go(0.0, 0.5)
    graph.kill(spec)
    graph.start(NODE)
    robot.odometry.clear()
    robot.go(0.5, 1.5)
    settled(robot, 10)
    moved = robot.poses()[max(robot.poses())]
    assert np.hypot(*moved[:2]) == pytest.approx(0.45, abs=0.05)


def test_two_robots_in_two_namespaces_do_not_meet(graph: Graph) -> None:
    first, second = Robot(graph, "/one/"), Robot(graph, "/two/")
    second.drive = type(second.drive)([(2.5, 1.5), (2.5, -1.5), (-3.0, -1.5)], speed=1.0)
    for name in ("one", "two"):
        graph.start(NODE, namespace=f"/{name}")
        transform = TransformStamped()
        transform.header.frame_id, transform.child_frame_id = "base_link", "laser"
        transform.transform.rotation.w = 1.0
        from whereabouts.nodes.ros.qos import TF_STATIC_QOS

        graph.publish(f"/{name}/tf_static", TFMessage(transforms=[transform]), TF_STATIC_QOS)
    for time in np.arange(0.0, 1.5, 0.1):
        first.send(scan_message(first.scan(float(time))))
        second.send(scan_message(second.scan(float(time))))
    settled(first, 15)
    settled(second, 15)
    assert len(first.odometry) == len(second.odometry) == 15
    assert position_error(first, max(first.poses())) < 0.05
    assert position_error(second, max(second.poses())) < 0.05


def test_scanner_mounted_upside_down_and_off_centre(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    # Turned by half a turn about its x axis, which points 30 degrees to the left of the robot's.
    half = np.radians(15.0)
    graph.mount(pose=(0.3, 0.1, 0.4, np.cos(half), np.sin(half), 0.0, 0.0))
    for time in np.arange(0.0, 8.0, 0.1):
        scan = robot.scan(float(time), (0.3, 0.1, np.radians(30.0)))
        mirrored = Scan(scan.ranges[::-1], scan.angle_min, scan.angle_increment, 0.05, 25.0, scan.stamp)
        robot.send(scan_message(mirrored))
    settled(robot, 80)
    assert position_error(robot, max(robot.poses())) < 0.06


def test_two_scanners_are_joined(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE, scan_topics=["front", "rear"])
    graph.mount("front_laser", (0.2, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0))
    graph.mount("rear_laser", (-0.2, 0.0, 0.2, 0.0, 0.0, 1.0, 0.0))
    clouds = graph.collect(PointCloud2, "static_points")
    for time in np.arange(0.0, 4.0, 0.1):
        earlier = max(0.0, float(time) - 0.05)
        robot.send(scan_message(robot.scan(earlier, (-0.2, 0.0, np.pi)), "rear_laser"), "rear")
        robot.send(scan_message(robot.scan(float(time), (0.2, 0.0, 0.0)), "front_laser"), "front")
    settled(robot, 40)
    assert position_error(robot, max(robot.poses())) < 0.05
    graph.until(lambda: len(clouds) >= 40, "static points for every scan")
    behind = points_from_message(clouds[-1])[0][:, 0] < -0.5
    assert behind.sum() > 100


def test_wheel_odometry_bridges_a_blind_stretch(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    graph.mount()
    for time in np.arange(0.0, 3.0, 0.1):
        graph.publish("wheel_odom", wheel_message(robot.truth(float(time)), float(time)))
        scan = robot.scan(float(time))
        if 1.0 <= time < 2.0:
            scan = Scan(
                np.full(len(scan), 25.0), scan.angle_min, scan.angle_increment, 0.05, 25.0, scan.stamp
            )
        robot.send(scan_message(scan))
    settled(robot, 30)
    blind_end = max(t for t in robot.poses() if t < 2.0)
    assert position_error(robot, blind_end) < 0.06
    assert position_error(robot, max(robot.poses())) < 0.06


def test_follows_clouds(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE, cloud_topics=["points"], cloud_voxel_size=0.2)
    graph.mount()
    rng = np.random.default_rng(3)
    heights = np.linspace(0.0, 2.0, 12)
    robot.lidar = type(robot.lidar)(beams=720, opening=2.0 * np.pi, range_max=25.0)
    for time in np.arange(0.0, 2.0, 0.1):
        flat = robot.scan(float(time)).points()
        cloud = np.concatenate([np.column_stack((flat, np.full(len(flat), z))) for z in heights])
        floor = rng.uniform(-4.0, 4.0, (2000, 3)) * [1.0, 1.0, 0.0]
        header = Header(stamp=time_message(START + round(time * NANOSECONDS)), frame_id="laser")
        robot.send(cloud_message(header, np.concatenate((cloud, floor))), "points")  # type: ignore[arg-type]
    settled(robot, 20)
    assert position_error(robot, max(robot.poses())) < 0.1


def test_malformed_cloud_is_refused(graph: Graph) -> None:
    robot = Robot(graph)
    spec = graph.start(NODE, cloud_topics=["points"])
    graph.mount()
    header = Header(stamp=time_message(START), frame_id="laser")
    bad = cloud_message(header, np.ones((10, 3)))
    bad.width = 1000
    robot.send(bad, "points")  # type: ignore[arg-type]
    assert "less data than its size" in graph.log(spec)


def test_reset_service_starts_afresh(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    graph.mount()
    robot.go(0.0, 1.0)
    answer = graph.call(Reset, f"{NODE}/reset", Reset.Request(reason="test"))
    assert answer.code == Reset.Response.SUCCESS
    robot.send(scan_message(robot.scan(1.0)))
    settled(robot, 11)
    assert np.allclose(robot.poses()[1.0], 0.0, atol=1e-6)


def test_lifecycle_manager_may_drive_it(graph: Graph) -> None:
    robot = Robot(graph)
    spec = graph.start(NODE, wait=False, autostart=False)
    graph.until(lambda: graph.state(spec) == State.PRIMARY_STATE_UNCONFIGURED, "unconfigured")
    graph.change(spec, Transition.TRANSITION_CONFIGURE, Transition.TRANSITION_ACTIVATE)
    graph.mount()
    robot.go(0.0, 0.3)
    settled(robot, 3)
    graph.change(spec, Transition.TRANSITION_DEACTIVATE)
    robot.send(scan_message(robot.scan(0.4)))
    graph.until(lambda: robot.figures().get("/scan while inactive") == "1", "the scan counted as inactive")
    graph.change(
        spec,
        Transition.TRANSITION_CLEANUP,
        Transition.TRANSITION_CONFIGURE,
        Transition.TRANSITION_ACTIVATE,
    )
    graph.mount()
    robot.send(scan_message(robot.scan(0.5)))
    settled(robot, 4)


def test_wrong_parameter_ends_the_node_with_a_sentence(graph: Graph) -> None:
    spec = graph.start(NODE, wait=False, transform_timeout=-3.0)
    process = graph.supervisor.nodes[spec.full_name].process
    assert process.wait(60) == 2
    log = graph.log(spec)
    assert "transform_timeout" in log
    assert "from 0 to 10 s" in log
    assert "-3.0" in log
    with pytest.raises(SuiteError, match="transform_timeout"):
        graph.supervisor.check()


def test_parameters_are_described_and_checked_at_run_time(graph: Graph) -> None:
    graph.start(NODE)
    request = DescribeParameters.Request(names=["transform_timeout", "scan_topics", "autostart"])
    described = graph.call(DescribeParameters, f"{NODE}/describe_parameters", request).descriptors
    assert described[0].floating_point_range[0].to_value == 10.0
    assert described[0].description.endswith("[s]")
    assert [item.read_only for item in described] == [False, False, True]

    def set_to(name: str, value: float) -> object:
        parameter = Parameter(
            name=name, value=ParameterValue(type=ParameterType.PARAMETER_DOUBLE, double_value=value)
        )
        answer = graph.call(
            SetParameters, f"{NODE}/set_parameters", SetParameters.Request(parameters=[parameter])
        )
        return answer.results[0]

    assert set_to("transform_timeout", 2.0).successful
    refused = set_to("transform_timeout", 50.0)
    assert not refused.successful
    assert "transform_timeout" in refused.reason


def test_bad_transforms_are_refused_and_good_ones_of_the_same_message_kept(graph: Graph) -> None:
    robot = Robot(graph)
    spec = graph.start(NODE)
    from harness import mounting

    from whereabouts.nodes.ros.qos import TF_STATIC_QOS

    broken = mounting("broken", (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    good = mounting("laser", (0.0, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0))
    graph.publish("tf_static", TFMessage(transforms=[broken, good]), TF_STATIC_QOS)
    robot.go(0.0, 0.3)
    settled(robot, 3)
    assert "quaternion of length 1 expected" in graph.log(spec)


def test_bytes_that_are_no_scan_leave_the_node_alive(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    graph.mount()
    robot.go(0.0, 0.2)
    publisher = graph.node.create_publisher(LaserScan, "scan", 10)
    graph.until(publisher.get_subscription_count, "somebody listens")
    # A header and then nothing: fields that are not there.
    publisher.publish(b"\x00\x01\x00\x00" + b"\x01" * 6)
    robot.go(0.2, 0.5)
    settled(robot, 5)
    assert position_error(robot, max(robot.poses())) < 0.05


def test_stamps_are_kept_to_the_nanosecond(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start(NODE)
    graph.mount()
    message = scan_message(robot.scan(0.0))
    message.header.stamp = time_message(1_700_000_000_123_456_789)
    robot.send(message)
    settled(robot, 1)
    assert nanoseconds(robot.odometry[0].header.stamp) == 1_700_000_000_123_456_789
    assert np.allclose(planar(robot.odometry[0].pose.pose), 0.0)


def test_a_scanner_that_stops_is_told_of_until_it_goes_on(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start("scan_registration", segment_scans=False)
    graph.mount()
    robot.go(0.0, 1.5)

    def said() -> str:
        return str(robot.diagnostics[-1].status[0].message) if robot.diagnostics else ""

    graph.until(lambda: "nothing has come on /scan for" in said(), "it says that the scanner has stopped")
    assert robot.diagnostics[-1].status[0].level == DiagnosticStatus.WARN
    robot.go(1.5, 1.7)
    graph.until(lambda: said() == "following", "it follows again")


def test_stamps_that_nobody_sets_are_told_of(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start("scan_registration", segment_scans=False)
    graph.mount()
    message = scan_message(robot.scan(0.0))
    message.header.stamp = time_message(0)
    for _ in range(15):
        robot.send(message)

    def said() -> list[str]:
        return [str(status) for told in robot.diagnostics for status in told.status]

    graph.until(
        lambda: any("stamps stand still at 0.000" in text for text in said()), "what is wrong is said"
    )
    figures = {item.key: item.value for item in robot.diagnostics[-1].status[0].values}
    assert int(figures["/scan repeated stamps"]) >= 10
