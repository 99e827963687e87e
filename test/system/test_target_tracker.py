"""People in a simulated room, over DDS through scan_registration and target_tracker."""

from __future__ import annotations

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseWithCovarianceStamped
from harness import START, Graph, room, scan_message
from sensor_msgs.msg import LaserScan
from visualization_msgs.msg import MarkerArray

from estimation.geometry.poses import between, compound
from estimation.metrics.statistics import ospa
from whereabouts.nodes.messages.conversions import PLANAR, stated_covariance
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.simulation import Drive, Lidar, joined
from whereabouts.simulation.movers import outlines
from whereabouts.simulation.walkers import Build, SimulatedWalker, positions
from whereabouts_msgs.msg import Processed, TargetArray
from whereabouts_msgs.srv import Reset

LIDAR = Lidar(beams=361, opening=1.5 * np.pi, range_max=25.0)


class TrackedScene:
    """A robot that drives past two people who walk, and what the nodes say about them."""

    def __init__(self, graph: Graph) -> None:
        self.graph = graph
        self.world = room()
        self.drive = Drive([(-3.0, -1.5), (2.5, -1.5)], speed=0.3)
        self.people = [
            SimulatedWalker(np.array([(0.5, 2.0), (0.5, -0.9), (3.0, -0.6)]), 1.0, Build(), 0.5),
            SimulatedWalker(
                np.array([(3.5, -1.0), (1.0, -2.2), (0.0, -2.4)]),
                0.8,
                Build(leg_radius=0.075),
                0.2,
                phase=1.0,
            ),
        ]
        self.rng = np.random.default_rng(3)
        self.targets: list[TargetArray] = graph.collect(TargetArray, "targets")
        self.processed: list[Processed] = graph.collect(Processed, "target_tracker/processed")
        self.registered: list[Processed] = graph.collect(Processed, "scan_registration/processed")

    def go(self, start: float, end: float) -> None:
        for time in np.arange(start, end, 0.1):
            shapes = joined([self.world, outlines(self.people, float(time))])
            scan = LIDAR.scan(shapes, self.drive(float(time)), self.rng, float(time)).scan
            message = scan_message(scan)
            before = len(self.registered)
            self.send(message)
            self.graph.until(
                lambda: any(answer.stamp == message.header.stamp for answer in self.registered[before:]),  # noqa: B023
                f"the scan at {message.header.stamp} is registered",
            )

    def send(self, message: LaserScan) -> None:
        before = len(self.processed)
        self.graph.publish("scan", message)
        self.graph.until(
            lambda: any(answer.stamp == message.header.stamp for answer in self.processed[before:]),
            f"the scan at {message.header.stamp} is processed",
        )

    def truth(self, message: TargetArray) -> np.ndarray:
        """Where people are, (P, 2), in the frame of the robot's start."""
        time = (nanoseconds(message.header.stamp) - START) / NANOSECONDS
        origin = between(self.drive(0.0), np.zeros(3))
        return np.array(
            [compound(origin, np.array([*spot, 0.0]))[:2] for spot in positions(self.people, time)]
        )


def found(message: TargetArray) -> np.ndarray:
    return np.array([(target.position.x, target.position.y) for target in message.targets]).reshape(-1, 2)


def test_people_are_tracked_through_both_nodes(graph: Graph) -> None:
    scene = TrackedScene(graph)
    markers = graph.collect(MarkerArray, "target_tracker/markers")
    graph.start("scan_registration")
    graph.start("target_tracker")
    graph.mount()
    first = LIDAR.scan(joined([scene.world, outlines(scene.people, 0.0)]), scene.drive(0.0), scene.rng).scan
    graph.introduce(scan_message(first), lambda: scene.targets, "scan_registration", "target_tracker")
    scene.targets.clear()
    scene.go(0.0, 7.0)
    graph.until(lambda: len(scene.targets) >= 70, "one message per scan")
    stamps = [round((nanoseconds(m.header.stamp) - START) / NANOSECONDS, 3) for m in scene.targets]
    assert stamps == [round(0.1 * k, 3) for k in range(70)]
    assert scene.targets[-1].header.frame_id == "odom"
    # Who has walked two seconds is known, where he is and as himself; one of them is behind a box in between.
    known = scene.targets[30:]
    distances = [ospa(found(message), scene.truth(message), c=1.0, p=1) for message in known]
    assert np.mean(distances) < 0.12
    for person in range(2):
        labels = set()
        for message in known:
            gaps = np.linalg.norm(found(message) - scene.truth(message)[person], axis=1)
            if len(gaps) and gaps.min() < 0.5:
                labels.add(message.targets[int(gaps.argmin())].label)
                assert 0.0 < message.targets[int(gaps.argmin())].label_probability <= 1.0
        assert len(labels) == 1
    target = scene.targets[-1].targets[0]
    classes = dict(
        zip(target.class_distribution.values, target.class_distribution.probabilities, strict=True)
    )
    assert classes["person"] > 0.9
    assert abs(sum(classes.values()) - 1.0) < 1e-9
    assert (np.linalg.eigvalsh(np.array(target.state_covariance).reshape(4, 4)) > 0.0).all()
    graph.until(lambda: any(m.ns == "velocity" for a in markers[-5:] for m in a.markers), "markers")


def test_reset_forgets_and_bad_input_is_survived(graph: Graph) -> None:
    scene = TrackedScene(graph)
    diagnostics: list[DiagnosticArray] = graph.collect(DiagnosticArray, "/diagnostics")
    graph.start("target_tracker")
    graph.mount()
    graph.mount("elsewhere", (0.0, 0.0, 0.2, 0.0, 0.7, 0.0, 0.7141428))
    for start, reset in ((0.0, True), (4.0, False)):
        for time in np.arange(start, start + 3.9, 0.1):
            # The robot stands, and says so itself: tracking needs no scan_registration.
            still_there(graph, float(time))
            shapes = joined([scene.world, outlines(scene.people, float(time))])
            scan = LIDAR.scan(shapes, scene.drive(0.0), scene.rng, float(time)).scan
            scene.send(scan_message(scan))
        graph.until(lambda: scene.targets and scene.targets[-1].targets, "people are found")
        if reset:
            assert graph.call(Reset, "target_tracker/reset", Reset.Request()).code == 0
            tilted = scan_message(scan, "elsewhere")
            tilted.header.stamp = time_message(START + round(3.95 * NANOSECONDS))
            still_there(graph, 3.95)
            scene.send(tilted)

    def told() -> bool:
        figures = {v.key: v.value for v in diagnostics[-1].status[0].values} if diagnostics else {}
        return "tracking ms" in figures and int(figures["people"]) >= 1

    graph.until(told, "count and latency in diagnostics")
    # Localisation says how uncertain the robot is in the frame of the tracks: so are the people.
    pose = PoseWithCovarianceStamped()
    pose.header.frame_id, pose.header.stamp = "odom", time_message(START + round(7.9 * NANOSECONDS))
    pose.pose.pose.orientation.w = 1.0
    pose.pose.covariance = np.diag([0.5, 0.3, 0.0, 0.0, 0.0, 0.01]).ravel()
    graph.publish("robot_pose", pose)
    graph.until(
        lambda: any(
            p.topic.endswith("robot_pose") and p.stamp == pose.header.stamp for p in scene.processed[-50:]
        ),
        "the pose is taken",
    )
    still_there(graph, 7.9)
    shapes = joined([scene.world, outlines(scene.people, 7.9)])
    scene.send(scan_message(LIDAR.scan(shapes, scene.drive(0.0), scene.rng, 7.9).scan))
    graph.until(lambda: scene.targets[-1].header.stamp == pose.header.stamp, "people after the pose")
    for target in scene.targets[-1].targets:
        position = np.array(target.state_covariance).reshape(4, 4)[:2, :2]
        assert np.linalg.eigvalsh(position - np.diag([0.5, 0.3])).min() > 0.0


def still_there(graph: Graph, time: float) -> None:
    """tf of a robot that does not move."""
    from tf2_msgs.msg import TFMessage

    from whereabouts.nodes.messages.transforms import transform_message
    from whereabouts.nodes.ros.qos import TF_QOS

    stamp = START + round(time * NANOSECONDS)
    transform = transform_message("odom", "base_link", stamp, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
    graph.publish("tf", TFMessage(transforms=[transform]), TF_QOS)


def test_a_covariance_that_is_none_is_one_that_nobody_knows() -> None:
    known = np.diag([0.04, 0.04, -1.0, -1.0, -1.0, 0.01])
    np.testing.assert_array_equal(stated_covariance(known.ravel(), PLANAR), np.diag([0.04, 0.04, 0.01]))
    unknown = [np.zeros(36), -np.eye(6), np.full(36, np.nan), np.triu(np.ones((6, 6))), known]
    assert [stated_covariance(values) for values in unknown] == [None] * 5
