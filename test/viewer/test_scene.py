"""Messages of the suite as shapes."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from whereabouts.viewer.drawable import Boxes, Lines, PlaceShape, Points, TextNote, Value
from whereabouts.viewer.fields import ellipse
from whereabouts.viewer.frames import Frames
from whereabouts.viewer.picture_sink import PictureSink
from whereabouts.viewer.scene import MOVING, STATIC, UNKNOWN, Scene, stamp_of


def by_path(shapes: list[Any]) -> dict[str, Any]:
    return {shape.path: shape for shape in shapes}


def take(scene: Scene, topic: str, kind: str, message: Any) -> dict[str, Any]:
    shapes = by_path(scene.take(kind.replace("/", "/msg/"), topic, message))
    assert not scene.skipped, scene.skipped
    return shapes


def scan(messages: Any, stamp: float, ranges: list[float], frame: str = "laser") -> Any:
    return messages.make(
        "sensor_msgs/LaserScan",
        header=messages.header(stamp, frame), angle_min=0.0, angle_increment=np.pi / 2, range_min=0.1, range_max=10.0,
        ranges=np.array(ranges, dtype=np.float32),
    )  # fmt: skip


def test_frames_follow_tf_and_rep_105_where_it_says_nothing(messages: Any) -> None:
    frames = Frames()
    assert frames.path("/laser", sensor=True) == "map/odom/base_link/laser"
    assert frames.path("odom", sensor=True) == "map/odom"
    assert frames.path("somewhere") == "map/somewhere"
    assert frames.path("") == "map"
    message = messages.transform("robot1/base", "robot1/front", 1.0, 0.3, 0.0, np.pi / 2)
    (place,) = frames.take(message, "tf_static")
    assert place.static
    assert place.path == "map/robot1.base/robot1.front"
    assert place.matrix @ (1.0, 0.0, 0.0, 1.0) == pytest.approx((0.3, 1.0, 0.0, 1.0))


def test_frames_in_a_circle_end(messages: Any) -> None:
    frames = Frames()
    for parent, child in (("a", "b"), ("b", "a")):
        list(frames.take(messages.transform(parent, child, 1.0, 0, 0, 0), "tf"))
    assert frames.path("a").endswith("a")


def test_moving_beams_are_coloured_and_beams_without_return_left_out(messages: Any) -> None:
    scene = Scene()
    path = "map/odom/base_link/laser/scan"
    plain = take(scene, "/scan", "sensor_msgs/LaserScan", scan(messages, 5.0, [1.0, np.inf, 2.0, 3.0]))[path]
    assert np.allclose(plain.positions, [(1, 0, 0), (-2, 0, 0), (0, -3, 0)], atol=1e-6)
    assert plain.colors == STATIC
    segments = messages.make(
        "whereabouts_msgs/ScanSegments",
        header=messages.header(5.0, "laser"), labels=np.array([0, 1, 2, -1], dtype=np.int32),
    )  # fmt: skip
    coloured = take(scene, "segments", "whereabouts_msgs/ScanSegments", segments)[path]
    assert coloured.colors.tolist() == [list(STATIC), list(MOVING), list(UNKNOWN)]
    assert np.array_equal(coloured.positions, plain.positions)
    segments.header = messages.header(6.0, "laser")
    assert not take(scene, "segments", "whereabouts_msgs/ScanSegments", segments), "of a scan nobody has seen"


def test_odometry_stands_in_for_tf_and_steps_back_for_it(messages: Any) -> None:
    def told(x: float) -> Any:
        pose = messages.make("geometry_msgs/PoseWithCovariance", pose=messages.pose(x, 0.0))
        return messages.make(
            "nav_msgs/Odometry", header=messages.header(1.0, "odom"), child_frame_id="base_link", pose=pose
        )

    scene = Scene()
    assert "map/odom/base_link" in take(scene, "wheel_odom", "nav_msgs/Odometry", told(1.0))
    assert "map/odom/base_link" in take(scene, "odometry", "nav_msgs/Odometry", told(2.0))
    assert "map/odom/base_link" not in take(scene, "wheel_odom", "nav_msgs/Odometry", told(3.0))
    take(scene, "tf", "tf2_msgs/TFMessage", messages.transform("odom", "base_link", 1.0, 2.0, 0.0, 0.0))
    later = take(scene, "odometry", "nav_msgs/Odometry", told(4.0))
    assert "map/odom/base_link" not in later
    assert later["map/odom/odometry"].strips[0][:, 0].tolist() == [2.0, 4.0]


def test_a_map_is_its_occupied_cells_where_its_origin_puts_them(messages: Any) -> None:
    info = messages.make(
        "nav_msgs/MapMetaData", resolution=0.5, width=3, height=2, origin=messages.pose(10, 20, np.pi / 2)
    )
    cells = np.array([0, 100, -1, 0, 0, 60], dtype=np.int8)
    message = messages.make(
        "nav_msgs/OccupancyGrid", header=messages.header(1.0, "map"), info=info, data=cells
    )
    shape = take(Scene(), "map", "nav_msgs/OccupancyGrid", message)["map/map"]
    assert shape.positions == pytest.approx(np.array([(9.75, 20.75, 0.0), (9.25, 21.25, 0.0)]))
    assert shape.radius == 0.25


def test_closures_join_keyframes_once_the_trajectory_has_both(messages: Any) -> None:
    def closure(earlier: float, later: float, accepted: bool) -> Any:
        return messages.make(
            "whereabouts_msgs/LoopClosure",
            header=messages.header(later, "base_link"), earlier_stamp=messages.header(earlier, "").stamp,
            accepted=accepted, reason="because",
        )  # fmt: skip

    scene = Scene()
    first = take(scene, "loop_closures", "whereabouts_msgs/LoopClosure", closure(1.0, 3.0, True))
    assert first["log/closures"] == TextNote("log/closures", "because")
    assert not first["map/closures"].strips
    take(scene, "loop_closures", "whereabouts_msgs/LoopClosure", closure(1.0, 2.0, False))
    poses = [
        messages.make(
            "geometry_msgs/PoseStamped", header=messages.header(t, "map"), pose=messages.pose(t, -t)
        )
        for t in (1.0, 2.0, 3.0)
    ]
    path = messages.make("nav_msgs/Path", header=messages.header(3.0, "map"), poses=poses)
    shapes = take(scene, "trajectory", "nav_msgs/Path", path)
    assert shapes["map/trajectory"].strips[0].tolist() == [[1, -1, 0], [2, -2, 0], [3, -3, 0]]
    (line,) = shapes["map/closures"].strips
    assert line.tolist() == [[1, -1, 0], [3, -3, 0]], "only the accepted one"


def test_people_keep_their_colour_and_pale_while_hidden(messages: Any) -> None:
    def person(label: int, hidden: bool) -> Any:
        return messages.make(
            "whereabouts_msgs/Target",
            label=label, position=messages.point(1.0, 2.0), velocity=messages.point(0.5, 0.0, kind="Vector3"),
            extent=np.array([0.04, 0.0, 0.0, 0.01]), occluded=hidden,
        )  # fmt: skip

    def at(*people: Any) -> dict[str, Any]:
        message = messages.make(
            "whereabouts_msgs/TargetArray",
            header=messages.header(1.0, "odom"), targets=list(people), expected_count=1.4,
        )  # fmt: skip
        return take(Scene(), "targets", "whereabouts_msgs/TargetArray", message)

    seen, hidden = at(person(3, False)), at(person(3, True))
    assert seen["map/odom/people"].labels == ("3",)
    assert hidden["map/odom/people"].labels == ("3, hidden",)
    assert (hidden["map/odom/people"].colors > seen["map/odom/people"].colors).any()
    assert seen["map/odom/people/velocity"].strips[0].tolist() == [[1, 2, 0], [1.5, 2, 0]]
    assert seen["plots/people"] == Value("plots/people", 1.4)
    nobody = at()
    assert nobody["map/odom/people"].positions.shape == (0, 3), "whoever has left is taken away"


def test_an_ellipse_has_the_covariance_it_is_drawn_from() -> None:
    covariance = np.array([[0.5, 0.2], [0.2, 0.3]])
    ring = ellipse((1.0, 2.0, 0.0), covariance, 2.0)[:, :2] - (1.0, 2.0)
    distances = np.einsum("ni,ij,nj->n", ring, np.linalg.inv(covariance), ring)
    assert distances == pytest.approx(np.full(len(ring), 4.0))


def test_objects_carry_their_symbols_and_lost_ones_cover_their_region(messages: Any) -> None:
    def thing(name: str, lost: bool) -> Any:
        region = messages.make(
            "whereabouts_msgs/Region",
            center=messages.pose(5.0, 5.0),
            size=messages.point(4.0, 2.0, 1.0, "Vector3"),
        )
        pose = messages.make("geometry_msgs/PoseWithCovariance", pose=messages.pose(1.0, 2.0))
        return messages.make(
            "whereabouts_msgs/WorldObject",
            id=name, predicates=["red"], place="desk", existence_probability=0.931, lost=lost, region=region, pose=pose,
        )  # fmt: skip

    message = messages.make(
        "whereabouts_msgs/WorldState",
        header=messages.header(1.0, "map"), objects=[thing("cup-1", False), thing("cup-2", True)], expected_count=2.5,
    )  # fmt: skip
    shapes = take(Scene(), "world_state", "whereabouts_msgs/WorldState", message)
    boxes = shapes["map/objects"]
    assert boxes.labels == ("cup-1, red; at desk, p = 0.93", "cup-2, red; at desk; lost, p = 0.93")
    assert boxes.centers.tolist() == [[1, 2, 0], [5, 5, 0]]
    assert boxes.sizes[1].tolist() == [4, 2, 1]
    assert (boxes.sizes[0] > 0).all(), "an object of unknown size is still to be seen"
    assert shapes["plots/objects, expected"].value == 2.5
    states = [messages.make("whereabouts_msgs/WorldState", probability=p) for p in (0.7, 0.2, 0.1)]
    several = messages.make("whereabouts_msgs/WorldHypotheses", hypotheses=states)
    values = take(Scene(), "world_hypotheses", "whereabouts_msgs/WorldHypotheses", several)
    assert values["plots/hypotheses"].value == 3
    assert values["plots/best hypothesis"].value == 0.7


def test_goals_tasks_paths_and_evidence_are_drawn_in_their_frames(messages: Any) -> None:
    scene = Scene()
    goal = messages.make(
        "geometry_msgs/PoseStamped", header=messages.header(1.0, "map"), pose=messages.pose(1.0, 2.0, np.pi)
    )
    assert take(scene, "search_goal", "geometry_msgs/PoseStamped", goal)["map/search_goal"].strips[0][
        1
    ] == pytest.approx((0.5, 2.0, 0.0))
    task = messages.make(
        "whereabouts_msgs/VerificationTask",
        header=messages.header(1.0, "map"),
        object_id="cup-1",
        reason="old",
    )
    assert (
        take(scene, "verification_tasks", "whereabouts_msgs/VerificationTask", task)["log/maintenance"].text
        == "old"
    )
    points = [
        messages.make("whereabouts_msgs/PredictedPoint", position=messages.point(x, 0.0)) for x in (0.0, 1.0)
    ]
    path = messages.make(
        "whereabouts_msgs/PredictedPath",
        label=2, goals=[messages.point(1.0, 0.0)], goal_probabilities=np.array([0.8]), points=points,
    )  # fmt: skip
    array = messages.make(
        "whereabouts_msgs/PredictedPathArray", header=messages.header(1.0, "map"), paths=[path]
    )
    shapes = take(scene, "predicted_paths", "whereabouts_msgs/PredictedPathArray", array)
    assert shapes["map/goals"].labels == ("2: 0.80",)
    view = messages.make(
        "whereabouts_msgs/FieldOfView", pose=messages.pose(1, 1), range_max=2.0, horizontal_angle=np.pi
    )
    evidence = messages.make(
        "whereabouts_msgs/WorldEvidence", header=messages.header(1.0, "map"), field_of_view=[view],
        objects=[messages.make("whereabouts_msgs/ObjectEvidence")],
    )  # fmt: skip
    shapes = take(scene, "evidence", "whereabouts_msgs/WorldEvidence", evidence)
    outline = shapes["map/evidence/view"].strips[0]
    assert outline.max(axis=0) == pytest.approx((3.0, 3.0, 0.0))


def test_what_cannot_be_used_is_counted_and_the_next_is_drawn(messages: Any) -> None:
    scene = Scene()
    bad = scan(messages, 1.0, [])
    assert scene.take("sensor_msgs/msg/LaserScan", "/scan", bad) == []
    assert scene.take("sensor_msgs/msg/LaserScan", "/scan", scan(messages, 1.0, [1.0]))
    assert scene.skipped.total() == 1
    assert scene.taken == 1


def test_the_time_of_a_message_is_its_stamp_or_when_it_was_recorded(messages: Any) -> None:
    assert stamp_of(scan(messages, 2.5, [1.0]), 9_000_000_000) == 2.5
    assert stamp_of(scan(messages, 0.0, [1.0]), 9_000_000_000) == 9.0
    assert stamp_of(messages.transform("a", "b", 3.5, 0, 0, 0), 9_000_000_000) == 3.5


def test_a_picture_puts_shapes_through_their_frames(tmp_path: Any) -> None:
    sink = PictureSink(tmp_path / "p.png")
    quarter = np.array([[0.0, -1, 0, 1], [1, 0, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]])
    sink.draw(0.0, [PlaceShape("map/odom", quarter), PlaceShape("map/odom/base_link", quarter)])
    assert sink.transform("map/odom/base_link/scan") @ (0, 0, 0, 1) == pytest.approx((-1, 3, 0, 1))
    one = np.zeros((1, 3))
    sink.draw(1.0, [Points("map/a", one, (1, 2, 3), labels=("x",)), Lines("map/b", (np.eye(3),), (1, 2, 3))])
    sink.draw(1.0, [Boxes("map/c", one, one + 1, ((1, 2, 3),), ("box",)), Value("plots/n", 3.0)])
    sink.write()
    assert (tmp_path / "p.png").stat().st_size > 5_000
