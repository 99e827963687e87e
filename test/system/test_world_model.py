"""The node world_model over real DDS: what it is told it believes, remembers, and says again after a crash."""

from __future__ import annotations

import signal
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from builtin_interfaces.msg import Duration
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PoseWithCovarianceStamped, TransformStamped
from harness import START, Graph
from pydantic import ValidationError
from tf2_msgs.msg import TFMessage
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesis, ObjectHypothesisWithPose
from visualization_msgs.msg import MarkerArray

from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.ros.qos import HEARD_LATCHED, TF_STATIC_QOS
from whereabouts.nodes.world.seen_frames import SeenFrames
from whereabouts.parameters.world_model import WorldModelParameters
from whereabouts_msgs.msg import (
    Attribute,
    DiscreteDistribution,
    FieldOfView,
    ObjectEvidence,
    PredictedPath,
    PredictedPathArray,
    PredictedPoint,
    Processed,
    Target,
    TargetArray,
    WorldEvidence,
    WorldHypotheses,
    WorldState,
)
from whereabouts_msgs.srv import ForgetObject, QueryWorld, RelabelObject, Reset, SaveState
from world_model.memory.store import Store
from world_model.warm_up import warm_up

NODE = "world_model"
HOME = str(files("world_model").joinpath("defaults/home.yaml"))
ON_TABLE, ON_COUNTER, ON_DESK = (2.0, 1.6, 0.8), (0.3, 2.0, 1.0), (1.0, 8.0, 0.9)


@pytest.fixture(scope="module", autouse=True)
def _compiled() -> None:
    """Nodes are waited for as if everything was compiled already."""
    warm_up()


def stamp(seconds: float) -> int:
    return START + round(seconds * NANOSECONDS)


def seen(position: tuple[float, ...], kind: str, color: str, object_id: str = "") -> ObjectEvidence:
    item = ObjectEvidence(object_id=object_id)
    item.pose.pose.position = Point(**dict(zip("xyz", map(float, position), strict=True)))
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = 4e-4 * np.eye(3)
    item.pose.covariance = covariance.reshape(36)
    item.attributes = [
        Attribute(name="class", discrete=DiscreteDistribution(values=[kind], probabilities=[0.9])),
        Attribute(name="color", discrete=DiscreteDistribution(values=[color], probabilities=[0.9])),
    ]
    return item


def evidence(
    seconds: float, *objects: ObjectEvidence, frame: str = "map", view: bool = True
) -> WorldEvidence:
    message = WorldEvidence(objects=list(objects))
    message.header.stamp, message.header.frame_id = time_message(stamp(seconds)), frame
    if view:
        here = FieldOfView(range_min=0.0, range_max=12.0, horizontal_angle=6.28, vertical_angle=0.0)
        here.pose.position = Point(x=4.0, y=4.0, z=1.2)
        message.field_of_view = [here]
    return message


class World:
    """The node under test, and what it says."""

    def __init__(self, graph: Graph, **parameters: Any) -> None:
        self.graph = graph
        self.states: list[WorldState] = graph.collect(WorldState, "world_state", HEARD_LATCHED)
        self.diagnostics: list[DiagnosticArray] = graph.collect(DiagnosticArray, "/diagnostics")
        self.processed: list[Processed] = graph.collect(Processed, "world_model/processed")
        settings = {
            "classes": ["cup", "bowl", "shoe", "person"],
            "colors": ["red", "green", "blue"],
            "region": [0.0, 9.5, 0.0, 8.5, -0.5, 2.5],
            "places_file": HOME,
            "clutter_per_frame": 0.01,
        }
        self.parameters = {**settings, **parameters}
        self.start()

    def start(self) -> None:
        self.spec = self.graph.start(NODE, **self.parameters)

    def send(self, message: Any, topic: str = "evidence") -> None:
        """Publish, and wait until the node is done with it, one way or another."""
        before = len(self.processed)
        self.graph.publish(topic, message)

        def done() -> bool:
            answers = self.processed[before:]
            return any(a.topic == f"/{topic}" and a.stamp == message.header.stamp for a in answers)

        self.graph.until(done, f"{topic} at {message.header.stamp.sec} is processed")

    def look(self, start: float, count: int, *objects: ObjectEvidence) -> float:
        for k in range(count):
            self.send(evidence(start + 0.1 * k, *objects))
        return start + 0.1 * count

    def at(self, seconds: float) -> WorldState:
        """The state published for a stamp."""
        wanted = time_message(stamp(seconds))
        found = self.graph.until(
            lambda: [state for state in self.states if state.header.stamp == wanted], f"a state at {seconds}"
        )
        return found[-1]

    def query(self, **request: Any) -> QueryWorld.Response:
        return self.graph.call(QueryWorld, "world_model/query", QueryWorld.Request(**request))

    def figures(self) -> dict[str, str]:
        if not self.diagnostics:
            return {}
        return {item.key: item.value for item in self.diagnostics[-1].status[0].values}

    def message(self) -> str:
        return self.diagnostics[-1].status[0].message if self.diagnostics else ""


def classes(item: Any) -> dict[str, float]:
    given = item.class_distribution
    return dict(zip(given.values, given.probabilities, strict=True))


def test_objects_with_symbols_places_and_answers(graph: Graph) -> None:
    world = World(graph)
    hypotheses = graph.collect(WorldHypotheses, "world_hypotheses")
    objects = graph.collect(Detection3DArray, "objects")
    markers = graph.collect(MarkerArray, "world_model/markers")
    world.look(0.0, 12, seen(ON_TABLE, "cup", "red"), seen(ON_COUNTER, "bowl", "green"))
    state = world.at(1.1)
    assert [item.id for item in state.objects] == ["bowl-1", "cup-1"]
    assert state.header.frame_id == "map"
    bowl, cup = state.objects
    assert (cup.place, bowl.place) == ("kitchen_table", "counter")
    assert "red" in cup.predicates
    assert classes(cup)["cup"] > 0.9
    assert (cup.pose.pose.position.x, cup.pose.pose.position.y) == pytest.approx(ON_TABLE[:2], abs=0.01)
    covariance = np.array(cup.pose.covariance).reshape(6, 6)[:3, :3]
    assert 0.0 < covariance[0, 0] < 4e-4
    assert cup.existence_probability > 0.95
    assert nanoseconds(cup.last_seen) == pytest.approx(stamp(1.1), abs=1000)
    graph.until(lambda: objects and markers and hypotheses, "objects, markers and hypotheses")
    graph.until(lambda: len(objects[-1].detections) == 2, "both as detections")
    kinds = {d.id: d.results[0].hypothesis.class_id for d in objects[-1].detections}
    assert kinds == {"cup-1": "cup", "bowl-1": "bowl"}
    assert any("on the kitchen table" in marker.text for marker in markers[-1].markers)
    assert sum(state.probability for state in hypotheses[-1].hypotheses) == pytest.approx(1.0)

    answer = world.query(class_name="cup", predicates=["red"], min_probability=0.5)
    assert (answer.code, [item.id for item in answer.world.objects]) == (answer.SUCCESS, ["cup-1"])
    assert answer.descriptions[0].startswith("the red cup (cup-1): on the kitchen table, p = ")
    request = QueryWorld.Request(min_probability=0.5)
    request.region.name = "kitchen"
    answer = graph.call(QueryWorld, "world_model/query", request)
    assert {item.id for item in answer.world.objects} == {"bowl-1", "cup-1"}
    request.region.name = ""
    request.region.size.x = request.region.size.y = 1.0
    request.region.center.position = Point(x=2.0, y=1.5, z=0.0)
    answer = graph.call(QueryWorld, "world_model/query", request)
    assert [item.id for item in answer.world.objects] == ["cup-1"]
    for wrong, words in (({"predicates": ["shiny"]}, "shiny"), ({"min_probability": 7.0}, "min_probability")):
        answer = world.query(**wrong)
        assert answer.code == answer.REFUSED
        assert words in answer.message
    graph.until(lambda: world.figures().get("objects") == "2", "both objects in diagnostics")


def test_killed_mid_run_it_finds_every_object_and_its_history_again(graph: Graph, tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    world = World(graph, store_path=str(path))
    cup, bowl = seen(ON_TABLE, "cup", "red"), seen(ON_COUNTER, "bowl", "green")
    now = world.look(0.0, 12, cup, bowl)
    moved = seen(ON_DESK, "cup", "red")
    now = world.look(now, 30, bowl)
    now = world.look(now, 12, moved, bowl)
    last = round(now - 0.1, 3)
    before = world.at(last)
    # More is on its way when the process dies.
    for k in range(20):
        graph.publish("evidence", evidence(now + 0.1 * k, moved, bowl))
    graph.kill(world.spec)
    world.states.clear()
    world.start()
    restored = graph.until(lambda: world.states, "the remembered world, before anything is seen")[0]
    assert nanoseconds(restored.header.stamp) >= stamp(last) - 1000
    assert (
        [item.id for item in restored.objects] == [item.id for item in before.objects] == ["bowl-1", "cup-1"]
    )
    for old, new in zip(before.objects, restored.objects, strict=True):
        assert new.place == old.place
        assert classes(new) == pytest.approx(classes(old), abs=0.05)
        assert new.pose.pose.position.x == pytest.approx(old.pose.pose.position.x, abs=0.02)
        assert nanoseconds(new.last_seen) >= nanoseconds(old.last_seen)
    then = world.query(object_id="cup-1", time=time_message(stamp(1.0)))
    assert then.world.objects[0].place == "kitchen_table"
    assert world.query(object_id="cup-1").world.objects[0].place == "desk"
    # It goes on with the same symbols.
    now += 4.0
    world.look(now, 5, moved, bowl, seen((5.0, 2.0, 0.0), "shoe", "blue"))
    state = world.at(now + 0.4)
    assert [item.id for item in state.objects] == ["bowl-1", "cup-1", "shoe-1"]
    graph.kill(world.spec)
    with Store(path) as store:
        assert store.set_aside is None
        events = [entry.event for entry in store.history("cup-1")]
        assert events[0] == "appeared"
        assert {entry.object.position.round(1).tolist()[0] for entry in store.history("cup-1")} >= {2.0, 1.0}
        assert store.history("shoe-1")[0].event == "appeared"


def test_time_that_goes_back_begins_a_new_run_and_keeps_the_stored_one(graph: Graph, tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    world = World(graph, store_path=str(path))
    world.look(20.0, 12, seen(ON_TABLE, "cup", "red"))
    assert [item.id for item in world.at(21.1).objects] == ["cup-1"]
    assert world.at(21.1).epoch == 0
    graph.until(lambda: world.message() == "1 object", "the one object in diagnostics")
    world.look(5.0, 12, seen(ON_COUNTER, "bowl", "green"))
    state = world.at(6.1)
    assert ([item.id for item in state.objects], state.epoch) == (["bowl-1"], 1)
    answer = graph.call(Reset, "world_model/reset", Reset.Request(reason="test"))
    assert answer.code == answer.SUCCESS
    world.look(30.0, 12, seen(ON_DESK, "shoe", "blue"))
    state = world.at(31.1)
    assert ([item.id for item in state.objects], state.epoch) == (["shoe-1"], 2)
    graph.kill(world.spec)
    with Store(path) as store:
        assert [run for run, *_ in store.epochs()] == [0, 1, 2]
        found = [store.history("cup-1", 0), store.history("bowl-1"), store.history("shoe-1")]
        assert [entries[0].epoch for entries in found] == [0, 1, 2]


def test_services_change_the_world_and_refuse_nonsense(graph: Graph, tmp_path: Path) -> None:
    world = World(graph, store_path=str(tmp_path / "world.sqlite"), state_dir=str(tmp_path / "state"))
    world.look(0.0, 12, seen(ON_TABLE, "cup", "red"), seen(ON_COUNTER, "bowl", "green"))
    relabel = RelabelObject.Request(object_id="cup-1", class_name="shoe", new_object_id="annas")
    answer = graph.call(RelabelObject, "world_model/relabel", relabel)
    assert answer.code == answer.SUCCESS
    answer = graph.call(RelabelObject, "world_model/relabel", relabel)
    assert (answer.code, "cup-1" in answer.message) == (answer.REFUSED, True)
    found = world.query(object_id="annas").world.objects[0]
    assert classes(found)["shoe"] > 0.99
    answer = graph.call(ForgetObject, "world_model/forget", ForgetObject.Request(class_name="bowl"))
    assert answer.message == "1 object forgotten"
    assert (answer.code, list(answer.object_ids)) == (answer.SUCCESS, ["bowl-1"])
    graph.until(lambda: [item.id for item in world.states[-1].objects] == ["annas"], "the world without bowl")
    answer = graph.call(ForgetObject, "world_model/forget", ForgetObject.Request())
    assert answer.code == answer.REFUSED
    copy = tmp_path / "state" / "copy.sqlite"
    for path in (str(tmp_path / "copy.sqlite"), "../copy.sqlite", str(tmp_path / "state" / "copy.sqlite")):
        answer = graph.call(SaveState, "world_model/save", SaveState.Request(path=path))
        assert (answer.code, "path: " in answer.message) == (answer.REFUSED, True)
    assert not copy.parent.exists()
    answer = graph.call(SaveState, "world_model/save", SaveState.Request(path="copy.sqlite"))
    assert (answer.code, answer.path) == (answer.SUCCESS, str(copy))
    with Store(copy) as store:
        memory = store.restore()
        assert memory is not None
        assert [item.id for item in memory.objects] == ["annas"]
    missing = seen(ON_TABLE, "shoe", "red", object_id="annas")
    missing.detection_id = "not_found"
    world.send(evidence(3.0, missing, view=False))
    graph.until(lambda: world.states[-1].objects and world.states[-1].objects[0].lost, "annas is lost")
    # As at the end of a replay: what was remembered is in the file itself, and nothing is beside it.
    process = graph.supervisor.nodes[world.spec.full_name].process
    process.send_signal(signal.SIGINT)
    process.wait(60)
    assert not (tmp_path / "world.sqlite-wal").exists()


def test_frames_are_taken_at_the_stamp_and_covariances_turned(graph: Graph) -> None:
    world = World(graph, position_sigma=0.1, heading_sigma=0.05)
    graph.publish(
        "tf_static",
        TFMessage(transforms=[transform_message("base_link", "camera", 0, (0.2, 0, 1.0, 0, 0, 0, 1))]),
        TF_STATIC_QOS,
    )

    def robot(seconds: float, x: float) -> TransformStamped:
        # Facing along y.
        return transform_message("map", "base_link", stamp(seconds), (x, 1.0, 0.0, 0, 0, 0.5**0.5, 0.5**0.5))

    item = seen((2.0, 0.0, 0.0), "cup", "red")
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = np.diag([0.04, 0.0001, 0.0004])
    item.pose.covariance = covariance.reshape(36)
    for k in range(6):
        graph.publish("tf", TFMessage(transforms=[robot(0.1 * k - 0.05, 3.0), robot(0.1 * k + 0.05, 3.0)]))
        world.send(evidence(0.1 * k, item, frame="camera", view=False))
    cup = world.at(0.5).objects[0]
    # 2.2 m ahead of a robot that faces y; its heading is uncertain across, the camera is so ahead.
    assert cup.pose.pose.position.x == pytest.approx(3.0, abs=0.05)
    assert cup.pose.pose.position.y == pytest.approx(3.2, abs=0.05)
    spread = np.array(cup.pose.covariance).reshape(6, 6)
    across, ahead = 0.0001 + 0.1**2 + (0.05 * 2.2) ** 2, 0.04 + 0.1**2
    assert spread[1, 1] / spread[0, 0] == pytest.approx(ahead / across, rel=0.1)
    pose = PoseWithCovarianceStamped()
    pose.header.stamp, pose.header.frame_id = time_message(stamp(0.55)), "odom"
    pose.pose.pose.orientation.w = 1.0
    world.send(pose, "robot_pose")
    assert "robot_pose is in frame 'odom', expected 'map'" in graph.log(world.spec)


def test_a_pose_without_a_covariance_is_as_uncertain_as_configured() -> None:
    settings = SimpleNamespace(position_sigma=0.1, heading_sigma=0.05)
    seen = SeenFrames(SimpleNamespace(add_input=lambda *given, **named: None, settings=settings), "map")  # type: ignore[arg-type]
    pose = PoseWithCovarianceStamped()
    pose.header.frame_id, pose.pose.pose.orientation.w = "map", 1.0
    for variance, used in ((0.04, [0.04] * 3), (0.0, [0.01, 0.01, 0.0025]), (-1.0, [0.01, 0.01, 0.0025])):
        pose.pose.covariance = (variance * np.eye(6)).ravel()
        seen._take_pose(pose, 0)
        np.testing.assert_allclose(np.diag(seen._pose_covariance(0)), used)


def detection(position: tuple[float, ...], scores: dict[str, float]) -> Detection3D:
    item = Detection3D()
    item.bbox.center.position = Point(**dict(zip("xyz", map(float, position), strict=True)))
    for name, score in scores.items():
        item.results.append(ObjectHypothesisWithPose(hypothesis=ObjectHypothesis(class_id=name, score=score)))
    return item


def test_detections_and_people_come_by_their_topics(graph: Graph) -> None:
    world = World(graph)
    for k in range(8):
        message = Detection3DArray(detections=[detection(ON_TABLE, {"cup": 0.7, "bowl": 0.2})])
        message.header.stamp, message.header.frame_id = time_message(stamp(0.1 * k)), "map"
        world.send(message, "detections")
    assert [item.id for item in world.at(0.7).objects] == ["cup-1"]
    for k in range(16):
        target = Target(label=7, position=Point(x=4.0 + 0.1 * k, y=2.0, z=0.0))
        target.class_distribution = DiscreteDistribution(values=["person"], probabilities=[0.95])
        target.state_covariance = np.diag([0.01, 0.01, 0.05, 0.05]).reshape(16)
        targets = TargetArray(targets=[target])
        targets.header.stamp, targets.header.frame_id = time_message(stamp(1.0 + 0.5 * k)), "map"
        world.send(targets, "targets")
        world.send(evidence(1.25 + 0.5 * k, seen((4.05 + 0.1 * k, 2.05, 0.9), "person", "blue"), view=False))
    state = world.at(8.5)
    people = [item for item in state.objects if max(classes(item), key=classes(item).__getitem__) == "person"]
    assert len(people) == 1
    assert people[0].pose.pose.position.x == pytest.approx(5.5, abs=0.2)
    assert [item.id for item in state.objects if item not in people] == ["cup-1"]
    graph.until(
        lambda: world.figures().get("people in other evidence, ignored") == "16", "the account of people"
    )
    message = Detection3DArray(detections=[detection([1000.0 * x for x in ON_TABLE], {"cup": 0.7})])
    message.header.stamp, message.header.frame_id = time_message(stamp(9.0)), "map"
    world.send(message, "detections")
    assert "at 2000.0, 1600.0, 800.0 m is far from the parameter region" in graph.log(world.spec)


def test_hidden_people_are_where_the_predictor_says(graph: Graph) -> None:
    world = World(graph)

    def send_target(t: float, occluded: bool) -> None:
        target = Target(label=7, position=Point(x=2.0 + t, y=2.0, z=0.0), occluded=occluded)
        target.class_distribution = DiscreteDistribution(values=["person"], probabilities=[0.95])
        target.state_covariance = np.diag([0.01, 0.01, 0.05, 0.05]).reshape(16)
        targets = TargetArray(targets=[target])
        targets.header.stamp, targets.header.frame_id = time_message(stamp(t)), "map"
        world.send(targets, "targets")

    for k in range(5):
        send_target(0.5 * k, False)
    # Round a corner: half a second straight on, then along y.
    path = PredictedPath(label=7)
    for k in range(11):
        after = 0.5 * k
        spot = Point(x=4.0 + min(after, 0.5), y=2.0 + max(after - 0.5, 0.0), z=0.0)
        covariance = [0.01 + 0.01 * k, 0.0, 0.0, 0.01 + 0.01 * k]
        took = Duration(sec=k // 2, nanosec=(k % 2) * 500_000_000)
        path.points.append(PredictedPoint(time_from_start=took, position=spot, covariance=covariance))
    paths = PredictedPathArray(paths=[path])
    paths.header.stamp, paths.header.frame_id = time_message(stamp(2.0)), "map"
    world.send(paths, "predicted_paths")
    for k in range(5, 12):
        send_target(0.5 * k, True)
    [person] = world.at(5.5).objects
    where = person.pose.pose.position
    assert (where.x, where.y) == pytest.approx((4.5, 5.0), abs=0.2)
    shares = dict(zip(person.behaviors.values, person.behaviors.probabilities, strict=True))
    assert shares["predicted"] > shares["constant_velocity"]
    graph.until(lambda: world.figures().get("predicted paths") == "1", "the prediction is accounted for")


def spread(message: Any, values: list[str], probabilities: list[float]) -> None:
    said = message.objects[0].attributes[0].discrete
    said.values, said.probabilities = values, probabilities


BAD: dict[str, tuple[str, Any]] = {
    "probability": (
        "probabilities: a finite number from",
        lambda m: spread(m, ["cup"], [1.4]),
    ),
    "sum": (
        "sum to at most one",
        lambda m: spread(m, ["cup", "bowl"], [0.7, 0.7]),
    ),
    "lengths": (
        "probabilities",
        lambda m: setattr(m.objects[0].attributes[0].discrete, "values", ["cup", "bowl"]),
    ),
    "attribute": ("unknown attribute 'mood'", lambda m: setattr(m.objects[0].attributes[0], "name", "mood")),
    "class": (
        "unknown value 'yeti'",
        lambda m: setattr(m.objects[0].attributes[0].discrete, "values", ["yeti"]),
    ),
    "covariance": (
        "covariance",
        lambda m: setattr(m.objects[0].pose, "covariance", np.diag([-1.0] * 6).ravel()),
    ),
    "nan": ("finite", lambda m: setattr(m.objects[0].pose.pose.position, "x", float("nan"))),
    "no frame": ("frame_id is empty", lambda m: setattr(m.header, "frame_id", "")),
    "unknown frame": ("no transform from 'moon' to 'map'", lambda m: setattr(m.header, "frame_id", "moon")),
    "view": ("range", lambda m: setattr(m.field_of_view[0], "range_max", -1.0)),
}


def test_bad_evidence_is_refused_by_name_and_the_world_goes_on(graph: Graph) -> None:
    world = World(graph, transform_timeout=0.1)
    cup = seen(ON_TABLE, "cup", "red")
    now = world.look(0.0, 8, cup)
    said = graph.collect(DiagnosticArray, "/diagnostics")
    for expected, spoil in BAD.values():
        message = evidence(now, seen(ON_TABLE, "cup", "red"))
        spoil(message)
        world.send(message)
        if "transform" in expected:
            # It waits for its transform by the time of messages, which has to go on.
            for _ in range(14):
                now += 0.5
                world.send(evidence(now, cup))
        graph.until(
            lambda expected=expected: any(expected in m.status[0].message for m in said),
            f"word of {expected}",
        )
        world.send(evidence(now + 0.05, cup))
        assert [item.id for item in world.at(now + 0.05).objects] == ["cup-1"]
        now += 0.1
    # A word that nobody knows costs its detection, not the message.
    refused = len(BAD) - 3
    graph.until(
        lambda: world.figures().get("/evidence dropped, refused") == str(refused), "the account of drops"
    )
    assert world.figures()["detections with unknown words, ignored"] == "2"
    graph.until(
        lambda: world.figures().get("/evidence dropped, no transform") == "1",
        "the missing transform in diagnostics",
    )


def test_wrong_parameters_are_named(graph: Graph) -> None:
    for parameters, expected in (
        ({"region": [1.0, 2.0]}, "six numbers"),
        ({"behaviors_file": "/nowhere.yaml"}, "/nowhere.yaml"),
        ({"classes": ["cup", "cup"]}, "must not repeat"),
    ):
        with pytest.raises(ValidationError, match=expected):
            WorldModelParameters(**parameters)
    spec = graph.start(NODE, wait=False, detection_probability=7.0)
    assert graph.supervisor.nodes[spec.full_name].process.wait(60) == 2
    assert "parameter detection_probability: float from 0.01 to 0.9999 expected, got 7.0" in graph.log(spec)


def test_a_store_that_cannot_be_used_is_named_and_left_alone(graph: Graph, tmp_path: Path) -> None:
    import sqlite3

    path = tmp_path / "world.sqlite"
    Store(path).close()
    connection = sqlite3.connect(path)
    connection.execute("PRAGMA user_version = 9")
    connection.close()
    content = path.read_bytes()
    spec = graph.start(NODE, wait=False, store_path=str(path))
    graph.until(lambda: "is of version 9" in graph.log(spec), "the reason in the log")
    assert path.read_bytes() == content
