"""The node scan_registration labels what moves: over DDS, on a replayed bag of a drive among people and things."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from harness import START, Graph, Robot, room, scan_message

from estimation.geometry.poses import between
from whereabouts.logs import McapWriter, MessageRecord, OdometryRecord, ScanRecord, TransformRecord, open_log
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.runtime.suite_run import SuiteRun, replay_spec, run_suite
from whereabouts.simulation import Drive, Lidar, Mover, joined, outlines
from whereabouts_msgs.msg import ScanSegments

RATE, SCANS = 20.0, 120
SEEING = 14  # scans until the node has one half a second older to compare with
MOVERS = [
    Mover("person", np.array([0.5, -2.6, np.pi]), np.array([-0.6, 0.1]), size=0.6),
    Mover("box", np.array([1.5, 0.8, np.pi]), np.array([-0.7, 0.0]), size=0.9),
    Mover("cylinder", np.array([3.0, -0.3, 0.0]), np.array([-0.4, -0.25]), size=0.5),
]
DRIVE = Drive([(-3.5, -1.2), (2.5, -1.2)], speed=0.4)
LIDAR = Lidar(beams=361, opening=1.5 * np.pi, range_max=25.0)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[int, np.ndarray]]:
    """A bag, and for each of its scans whose beams are whose."""
    path = tmp_path_factory.mktemp("bag") / "movers.mcap"
    rng, start, owners = np.random.default_rng(5), START / NANOSECONDS, {}
    with McapWriter(path) as writer:
        writer.write_transforms([TransformRecord(np.eye(4), start, "base_link", "laser", "tf_static")])
        for k in range(SCANS):
            time = k / RATE
            world = joined([room(), outlines(MOVERS, time)])
            seen = LIDAR.scan(world, DRIVE(time), rng, start + time)
            owners[round(seen.scan.stamp * 1000)] = seen.owners
            writer.write_scan(ScanRecord(seen.scan, seen.scan.stamp))
    return path, owners


def test_segments_and_odometry_of_a_bag_with_movers(
    recorded: tuple[Path, dict[int, np.ndarray]], tmp_path: Path
) -> None:
    bag, owners = recorded
    output = tmp_path / "out.mcap"
    record = [("odometry", "nav_msgs/msg/Odometry"), ("segments", "whereabouts_msgs/msg/ScanSegments")]
    account = run_suite(
        SuiteRun(bag, [replay_spec("scan_registration")], tmp_path / "logs", record=record, output=output)
    )
    assert account.unanswered.total() == 0
    with open_log(output, topics=("odometry", "segments")) as log:
        records = list(log)
    odometry = [each for each in records if isinstance(each, OdometryRecord)]
    segments = [each for each in records if isinstance(each, MessageRecord)]
    assert len(odometry) == len(segments) == SCANS
    assert np.diff([each.stamp for each in segments]) == pytest.approx(1.0 / RATE, abs=1e-3)
    counts = np.zeros(3)
    for each in segments[SEEING:]:
        truth, said = owners[round(each.stamp * 1000)] > 0, np.asarray(each.message.labels) > 0
        counts += [np.sum(truth & said), np.sum(~truth & said), np.sum(truth & ~said)]
    hits, wrong, missed = counts
    assert 2.0 * hits / (2.0 * hits + wrong + missed) > 0.85
    assert hits / (hits + wrong) > 0.9
    start = odometry[0].pose
    for each in odometry:
        truth_pose = between(DRIVE(0.0), DRIVE(each.stamp - START / NANOSECONDS))
        assert np.hypot(*(between(start, each.pose) - truth_pose)[:2]) < 0.05


def test_motion_of_a_segment_is_that_of_the_body(graph: Graph) -> None:
    robot = Robot(graph)
    messages: list[ScanSegments] = graph.collect(ScanSegments, "segments")
    graph.start("scan_registration", segment_scans=True)
    graph.mount()
    mover = Mover("box", np.array([0.8, -0.6, 0.3]), np.array([0.5, 0.3]), size=0.8)
    pose, rng = np.array([-3.0, -1.5, 0.0]), np.random.default_rng(2)
    for time in np.arange(0.0, 1.2, 0.1):
        world = joined([room(), outlines([mover], float(time))])
        robot.send(scan_message(robot.lidar.scan(world, pose, rng, float(time)).scan))
    graph.until(lambda: len(messages) == 12, "segments for every scan")
    last = messages[-1]
    assert len(last.labels) == len(last.probabilities) == 361
    assert last.segments[0].label == 0
    assert np.abs(last.segments[0].motion).max() < 0.02
    (moving,) = last.segments[1:]
    seconds = moving.interval.sec + 1e-9 * moving.interval.nanosec
    assert seconds == pytest.approx(0.5, abs=0.01)
    covariance = np.array(moving.covariance).reshape(3, 3)
    assert (np.linalg.eigvalsh(covariance) > 0.0).all()
    # Where the body's middle was half a second ago, in the sensor's frame, and where it is now.
    before, now = (mover.pose(t)[:2] - pose[:2] for t in (1.1 - seconds, 1.1))
    x, y, yaw = moving.motion
    c, s = np.cos(yaw), np.sin(yaw)
    moved = np.array([c * before[0] - s * before[1] + x, s * before[0] + c * before[1] + y])
    assert np.hypot(*(moved - now)) < 0.12
    assert moving.probability > 0.5


def test_labels_may_be_switched_off(graph: Graph) -> None:
    robot = Robot(graph)
    messages: list[ScanSegments] = graph.collect(ScanSegments, "segments")
    graph.start("scan_registration", segment_scans=False)
    graph.mount()
    robot.go(0.0, 1.0)
    graph.until(lambda: len(robot.odometry) == 10, "odometry for every scan")
    graph.until(lambda: "registered" in robot.figures(), "diagnostics")
    assert "scans labelled" not in robot.figures()
    assert not messages


def test_a_deadline_that_cannot_be_kept_is_counted_and_the_robot_followed(graph: Graph) -> None:
    robot = Robot(graph)
    graph.start("scan_registration", segment_deadline=0.0, report_processed=False)
    graph.mount()
    for k in range(12):
        graph.publish("scan", scan_message(robot.scan(0.1 * k)))
        graph.until(lambda count=k + 1: len(robot.odometry) >= count, "odometry")
    graph.until(lambda: int(robot.figures().get("labels skipped", 0)) > 0, "skipped labels in diagnostics")
    assert np.hypot(*(robot.poses()[1.1] - robot.truth(1.1))[:2]) < 0.05
