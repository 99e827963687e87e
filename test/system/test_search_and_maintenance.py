"""World model, maintenance and search as nodes, with a simulated robot that goes where it is told."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import Point, PoseStamped
from harness import START, Graph
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer
from rclpy.task import Future
from std_msgs.msg import Bool
from tf2_msgs.msg import TFMessage

from whereabouts.nodes.messages.conversions import spatial_covariance
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, time_message
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.navigation.errands import LONGEST, Errands
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts.nodes.runtime.supervisor import NodeSpec
from whereabouts_msgs.action import FindObject, VerifyObject
from whereabouts_msgs.msg import (
    Attribute,
    DiscreteDistribution,
    FieldOfView,
    ObjectEvidence,
    Processed,
    WorldEvidence,
    WorldState,
)
from whereabouts_msgs.msg import VerificationTask as TaskMessage
from whereabouts_msgs.srv import RelabelObject, Reset, TriggerVerification
from world_model.state import WorldState as LibraryState

# How far each kind of thing is recognised from.
REACH = {"cup": 1.6, "coffee table": 5.5, "bed": 6.0}
# nat: nothing is worth a look but what somebody asks for.
ONLY_ASKED = 1000.0
# Where the cup is put.
TABLE = (4.7, 3.3)
SIGMA = 0.03
STEP = 0.1


class House:
    """Things in a room, and a robot whose camera looks all around; every step publishes tf and evidence."""

    def __init__(self, graph: Graph, things: dict[str, tuple[str, float, float]]) -> None:
        self.graph, self.things = graph, things
        self.pose = np.array([0.0, 0.0, 0.0])
        self.stamp = START
        self.goal: np.ndarray | None = None
        self.states = graph.collect(WorldState, "world_state")
        self.rng = np.random.default_rng(3)
        for topic in ("search_goal", "maintenance_goal"):
            graph.node.create_subscription(PoseStamped, topic, self._take_goal, LATCHED)
        self.verified: list[str] = []
        self.silence: Future | None = None  # what the verifier waits for before it answers
        self._reports: dict[str, tuple[int, list[Processed]]] = {}
        self.server = ActionServer(graph.node, VerifyObject, "verify_object", self._verify)

    def start(self, name: str, **parameters: Any) -> NodeSpec:
        """Start a node that follows the world; the robot waits for it from now on."""
        spec = self.graph.start(name, **parameters)
        self._reports[name] = self.stamp, self.graph.collect(Processed, f"{name}/processed")
        return spec

    def kill(self, name: str, spec: NodeSpec) -> None:
        """Kill a node, which is not waited for any more."""
        del self._reports[name]
        self.graph.kill(spec)

    def behind(self) -> int:
        """How old the world is that the slowest of the nodes has heard of, ns."""
        heard = [nanoseconds(self.states[-1].header.stamp) if self.states else START]
        for begun, reports in self._reports.values():
            stamps = [nanoseconds(item.stamp) for item in reports[-50:] if item.topic == "/world_state"]
            heard.append(max([begun, *stamps]))
        return self.stamp - min(heard)

    def _take_goal(self, message: PoseStamped) -> None:
        at = message.pose.position
        self.goal = np.array([at.x, at.y])

    def step(self) -> None:
        """One camera frame: drive a little, look, tell."""
        self.stamp += round(STEP * NANOSECONDS)
        if self.goal is not None:
            offset = self.goal - self.pose[:2]
            away = float(np.hypot(*offset))
            if away > 1e-6:
                heading = math.atan2(offset[1], offset[0])
                self.pose = np.array([*(self.pose[:2] + offset * min(1.0, 0.15 / away)), heading])
        half = 0.5 * self.pose[2]
        where = (self.pose[0], self.pose[1], 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
        self.graph.publish(
            "/tf", TFMessage(transforms=[transform_message("map", "base_link", self.stamp, where)])
        )
        self.graph.publish("evidence", self._evidence())

    def visible(self) -> list[str]:
        return [
            name
            for name, (kind, x, y) in self.things.items()
            if math.hypot(x - self.pose[0], y - self.pose[1]) <= REACH[kind]
        ]

    def _evidence(self) -> WorldEvidence:
        message = WorldEvidence(sensor="camera")
        message.header.stamp, message.header.frame_id = time_message(self.stamp), "map"
        view = FieldOfView(range_min=0.0, range_max=1.5, horizontal_angle=2.0 * math.pi, vertical_angle=0.0)
        view.pose.position = Point(x=float(self.pose[0]), y=float(self.pose[1]), z=0.7)
        view.pose.orientation.w = 1.0
        message.field_of_view = [view]
        message.objects = [self._detection(name) for name in self.visible()]
        return message

    def _detection(self, name: str, object_id: str = "") -> ObjectEvidence:
        kind, x, y = self.things[name]
        item = ObjectEvidence(object_id=object_id)
        at = item.pose.pose.position
        at.x, at.y = (float(value) for value in np.array([x, y]) + SIGMA * self.rng.standard_normal(2))
        at.z = 0.7
        item.pose.pose.orientation.w = 1.0
        full = spatial_covariance(np.zeros((3, 3))).reshape(6, 6)
        full[:3, :3] = SIGMA**2 * np.eye(3)
        item.pose.covariance = full.reshape(36)
        classes = DiscreteDistribution(values=[kind], probabilities=[0.95])
        item.attributes = [Attribute(name="class", discrete=classes)]
        return item

    async def _verify(self, handle: Any) -> VerifyObject.Result:
        """What the camera sees inside the region, if it is near enough to see anything there."""
        request, result = handle.request, VerifyObject.Result()
        self.verified.append(request.object_id)
        if self.silence is not None:
            await self.silence
        centre = np.array([request.region.center.position.x, request.region.center.position.y])
        size = np.array([request.region.size.x, request.region.size.y])
        found = [
            name
            for name in self.visible()
            if self.things[name][0] == request.class_name
            and (np.abs(np.array(self.things[name][1:]) - centre) <= 0.5 * size + 0.1).all()
        ]
        result.code = result.FOUND if found else result.NOT_FOUND
        if found:
            result.evidence.header.stamp = time_message(self.stamp)
            result.evidence.header.frame_id = "map"
            result.evidence.objects = [self._detection(found[0], request.object_id)]
        handle.succeed()
        return result


@pytest.fixture
def started(graph: Graph) -> tuple[Graph, House, list[WorldState], list[TaskMessage]]:
    house = House(
        graph,
        {
            "cup": ("cup", 1.0, 1.0),
            "bed": ("bed", -1.0, 4.0),
            "table": ("coffee table", 4.6, 3.6),
        },
    )
    tasks = graph.collect(TaskMessage, "verification_tasks")
    graph.start("world_model", region=[-10.0, 10.0, -10.0, 10.0, -0.5, 3.0], rate_hz=10.0)
    return graph, house, house.states, tasks


def run_until(graph: Graph, house: House, condition: Any, what: str) -> Any:
    """Steps of the robot until something holds."""

    def look() -> Any:
        # No faster than the nodes keep up.
        if house.behind() < NANOSECONDS:
            house.step()
        return condition()

    return graph.until(look, what)


def the(states: list[WorldState], kind: str) -> Any:
    """The object of a class in the newest state, None where there is none."""
    for item in states[-1].objects if states else ():
        values = dict(zip(item.class_distribution.values, item.class_distribution.probabilities, strict=True))
        if values.get(kind, 0.0) > 0.5:
            return item
    return None


def start_maintenance(house: House, **parameters: Any) -> None:
    """Maintenance that looks at nothing but what it is asked for."""
    house.start(
        "world_maintenance",
        rate=5.0,
        sensor_range_max=[1.5],
        information_gain_threshold=ONLY_ASKED,
        **parameters,
    )


def figures(diagnostics: list[DiagnosticArray], node: str) -> dict[str, str]:
    """The newest figures of a node."""
    mine = [message.status[0] for message in diagnostics[-50:] if message.status[0].name == node]
    return {item.key: item.value for item in mine[-1].values} if mine else {}


def trigger(graph: Graph, object_id: str) -> Any:
    """The answer once maintenance takes the trigger: it refuses until it has heard of the object."""
    request = TriggerVerification.Request(object_id=object_id, requester="grasping")
    answer = graph.call(TriggerVerification, "world_maintenance/trigger", request)
    return answer if answer.code == answer.SUCCESS else None


def test_an_object_that_was_moved_gets_lost_is_searched_for_and_found(
    started: tuple[Graph, House, list[WorldState], list[TaskMessage]],
) -> None:
    graph, house, states, tasks = started
    start_maintenance(house, use_sim_time=False)
    house.start("object_search", rate=10.0, view=1.2)
    bases = graph.collect(Bool, "base_available", LATCHED)
    cup = run_until(graph, house, lambda: the(states, "cup"), "the cup is known")
    first = cup.id
    # Carried to the coffee table while the robot looks elsewhere; the table is out of sight from here, and the cup from
    # wherever one may look at its old place.
    house.goal = np.array([-1.5, 0.5])
    run_until(
        graph, house, lambda: "cup" not in house.visible() and the(states, "bed"), "the robot has turned away"
    )
    house.things["cup"] = ("cup", *TABLE)

    before = len(states)
    taken = run_until(graph, house, lambda: trigger(graph, first), "maintenance takes the trigger")
    run_until(graph, house, lambda: first in house.verified, "the robot has gone to look")

    def gone() -> bool:
        """In some state: seen again, it would soon be there under another name."""
        return any(all(item.id != first or item.lost for item in state.objects) for state in states[before:])

    def said() -> bool:
        return any(task.object_id == first and "grasping" in task.reason for task in tasks)

    # Unless it was about to look for its own reasons.
    run_until(graph, house, lambda: taken.merged or said() or gone(), "the task says for whom")
    run_until(graph, house, gone, "the cup is lost, or given up")
    # The search hears of it too, later perhaps than this test.
    count = len(states)
    run_until(graph, house, lambda: len(states) >= count + 20, "the news has spread")
    client = ActionClient(graph.node, FindObject, "find_object")
    graph.until(client.server_is_ready, "find_object is served")
    heard: list[Any] = []
    sent = client.send_goal_async(
        FindObject.Goal(class_name="cup"), feedback_callback=lambda message: heard.append(message.feedback)
    )
    run_until(graph, house, sent.done, "the goal is answered")
    assert sent.result().accepted
    done = sent.result().get_result_async()
    run_until(graph, house, done.done, "the search ends")
    result = done.result().result
    assert result.code == result.FOUND, result.message
    assert np.hypot(result.pose.pose.position.x - TABLE[0], result.pose.pose.position.y - TABLE[1]) < 0.3
    reasons = [(step.kind, step.object_id, step.reason) for step in heard]
    assert any(kind == "intermediate" and name == "coffee table" for kind, name, _ in reasons), reasons
    assert all(step.reason for step in heard)
    assert result.distance > 0.3
    # The base was the search's own as long as it took.
    graph.until(lambda: bases and bases[-1].data, "the base is free again")
    assert [message.data for message in bases] == [False, True]
    client.destroy()


def test_what_was_looked_for_in_vain_is_handed_to_the_search(
    started: tuple[Graph, House, list[WorldState], list[TaskMessage]],
) -> None:
    graph, house, states, _ = started
    start_maintenance(house, use_sim_time=False, search_for_lost=True)
    house.start("object_search", rate=10.0, view=1.2)
    cup = run_until(graph, house, lambda: the(states, "cup"), "the cup is known")
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    house.goal = np.array([-1.5, 0.5])
    run_until(graph, house, lambda: "cup" not in house.visible(), "the robot has turned away")
    house.things["cup"] = ("cup", *TABLE)
    run_until(graph, house, lambda: trigger(graph, cup.id), "maintenance takes the trigger")
    for node, figure, what in (
        ("world_maintenance", "searches asked for", "maintenance asks for a search"),
        ("object_search", "found", "the search has found the cup"),
    ):
        # More than once where the first search was given up.
        run_until(graph, house, lambda: int(figures(diagnostics, node).get(figure, 0)) > 0, what)  # noqa: B023


def test_maintenance_goes_on_when_the_search_dies(
    started: tuple[Graph, House, list[WorldState], list[TaskMessage]],
) -> None:
    graph, house, states, _ = started
    bases = graph.collect(Bool, "base_available", LATCHED)
    start_maintenance(house, use_sim_time=False, search_for_lost=True)
    search = house.start("object_search", rate=10.0, view=1.2)
    far = run_until(graph, house, lambda: the(states, "bed"), "the bed is known")
    cup = run_until(graph, house, lambda: the(states, "cup"), "the cup is known")
    house.goal = np.array([-1.5, 0.5])
    run_until(graph, house, lambda: "cup" not in house.visible(), "the robot has turned away")
    del house.things["cup"]
    run_until(graph, house, lambda: trigger(graph, cup.id), "maintenance takes the trigger")
    run_until(graph, house, lambda: bases and not bases[-1].data, "the search has the base")
    house.kill("object_search", search)
    house.verified.clear()
    run_until(graph, house, lambda: trigger(graph, far.id), "maintenance takes another trigger")
    run_until(graph, house, lambda: far.id in house.verified, "the robot drives to the bed")


def test_a_search_that_was_forgotten_by_a_node_started_anew_is_over_when_its_time_is() -> None:
    sent: list[Any] = []
    caller = SimpleNamespace(ready=True, send=lambda goal, ended: sent.append(goal))
    errands = Errands(SimpleNamespace(add_caller=lambda *_: caller), print)  # type: ignore[arg-type]
    state = LibraryState((), 1.0, 0.0, 500.0)
    errands.add("cup-1", "cup")
    assert errands.look(state, True, 500.0)
    assert not errands.broken_off(500.0 + LONGEST)
    assert errands.broken_off(503.0 + LONGEST)
    assert errands.look(state, True, 503.0 + LONGEST)
    assert len(sent) == 2


def test_maintenance_goes_on_when_the_verifier_does_not_answer(
    started: tuple[Graph, House, list[WorldState], list[TaskMessage]],
) -> None:
    graph, house, states, _ = started
    start_maintenance(house, use_sim_time=False, verify_timeout=0.1)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")

    def outcomes() -> tuple[str, str]:
        said = figures(diagnostics, "world_maintenance")
        return said.get("occluded", ""), said.get("found", "")

    cup = run_until(graph, house, lambda: the(states, "cup"), "the cup is known")
    house.silence = Future()
    run_until(graph, house, lambda: trigger(graph, cup.id), "maintenance takes the trigger")
    run_until(graph, house, lambda: house.verified, "the verifier is asked")
    run_until(graph, house, lambda: outcomes() == ("1", "0"), "maintenance no longer waits for the answer")
    # What the verifier says in the end is not what is waited for.
    house.silence.set_result(None)
    house.silence = None
    run_until(graph, house, lambda: trigger(graph, cup.id), "maintenance takes another trigger")
    run_until(graph, house, lambda: len(house.verified) == 2, "the verifier is asked again")
    run_until(graph, house, lambda: outcomes() == ("1", "1"), "the cup is found")


def test_a_robot_that_looks_ahead_turns_before_it_looks(
    started: tuple[Graph, House, list[WorldState], list[TaskMessage]],
) -> None:
    graph, house, states, _ = started
    start_maintenance(house, use_sim_time=False, opening=1.0)
    goals = graph.collect(PoseStamped, "maintenance_goal", LATCHED)
    house.pose = np.array([1.0, 0.2, -1.0])  # near enough to the cup, which is to the left
    cup = run_until(graph, house, lambda: the(states, "cup"), "the cup is known")
    run_until(graph, house, lambda: trigger(graph, cup.id), "maintenance takes the trigger")
    run_until(graph, house, lambda: goals, "the robot is told to turn")
    heading = 2.0 * math.atan2(goals[0].pose.orientation.z, goals[0].pose.orientation.w)
    assert heading == pytest.approx(0.5 * math.pi, abs=0.3)
    count = len(states)
    run_until(graph, house, lambda: len(states) >= count + 20, "it has time to")
    assert not house.verified
    house.pose[2] = heading
    run_until(graph, house, lambda: house.verified == [cup.id], "the cup is looked at")


def test_while_another_moves_the_base_only_what_is_in_view_is_looked_at(
    started: tuple[Graph, House, list[WorldState], list[TaskMessage]],
) -> None:
    graph, house, states, tasks = started
    far = run_until(graph, house, lambda: the(states, "bed"), "the bed is known")
    near = run_until(graph, house, lambda: the(states, "cup"), "the cup is known")
    start_maintenance(house)
    graph.publish("base_available", Bool(data=False), LATCHED)
    # What comes next waits until this is known.
    house.step()
    # The bed's turn is first, but it is too far from here, and the base is not to be moved.
    for item in (far, near):
        run_until(graph, house, lambda item=item: trigger(graph, item.id), "maintenance takes the trigger")
    run_until(graph, house, lambda: house.verified, "something has been looked at")
    assert set(house.verified) == {near.id}
    assert {task.object_id for task in tasks} == {near.id}
    assert house.goal is None
    graph.publish("base_available", Bool(data=True), LATCHED)
    run_until(graph, house, lambda: far.id in house.verified, "the bed is driven to once the base is free")
    assert house.goal is not None


def test_a_search_can_be_cancelled_and_senseless_goals_are_refused(
    started: tuple[Graph, House, list[WorldState], list[TaskMessage]],
) -> None:
    graph, house, states, _ = started
    house.start("object_search", rate=10.0, view=1.2)
    run_until(graph, house, lambda: the(states, "bed"), "the bed is known")
    client = ActionClient(graph.node, FindObject, "find_object")
    graph.until(client.server_is_ready, "find_object is served")

    def ended(goal: FindObject.Goal) -> FindObject.Result:
        sent = client.send_goal_async(goal)
        run_until(graph, house, sent.done, "the goal is answered")
        answer = sent.result().get_result_async()
        run_until(graph, house, answer.done, "the search ends")
        return answer.result().result

    assert ended(FindObject.Goal()).code == FindObject.Result.REFUSED
    bed = the(states, "bed")
    for goal in (FindObject.Goal(class_name="bed"), FindObject.Goal(object_id=bed.id)):
        found = ended(goal)
        assert found.code == FindObject.Result.FOUND, found.message
        assert found.object[0].id == bed.id
    # The one that is known is not pink: another is looked for, half a metre far. What it is called says nothing.
    renamed = RelabelObject.Request(object_id=bed.id, new_object_id="mine-1")
    assert graph.call(RelabelObject, "world_model/relabel", renamed).code == RelabelObject.Response.SUCCESS
    run_until(graph, house, lambda: the(states, "bed").id == "mine-1", "its name is known")
    count = len(states)
    run_until(graph, house, lambda: len(states) >= count + 20, "the news has spread")
    for goal in (FindObject.Goal(class_name="bed"), FindObject.Goal(object_id="mine-1")):
        goal.predicates, goal.max_distance = ["pink"], 0.5
        pink = ended(goal)
        assert pink.code == FindObject.Result.GAVE_UP
        assert "Gave up" in pink.message
        assert "mine" not in pink.message
    sent = client.send_goal_async(FindObject.Goal(class_name="unicorn"))
    run_until(graph, house, sent.done, "the goal is answered")
    goals = graph.collect(PoseStamped, "search_goal", LATCHED)
    run_until(graph, house, lambda: goals, "a goal is set although nobody knows the class")
    cancelled = sent.result().cancel_goal_async()
    run_until(graph, house, cancelled.done, "the cancel is answered")
    answer = sent.result().get_result_async()
    run_until(graph, house, answer.done, "the search ends")
    assert answer.result().result.code == FindObject.Result.CANCELED
    assert nanoseconds(goals[-1].header.stamp) > 0
    client.destroy()


def test_a_search_says_what_it_waits_for_and_ends_with_the_run(graph: Graph) -> None:
    graph.start("object_search", rate=10.0)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    bases = graph.collect(Bool, "base_available", LATCHED)
    client = ActionClient(graph.node, FindObject, "find_object")
    graph.until(client.server_is_ready, "find_object is served")
    sent = client.send_goal_async(FindObject.Goal(object_id="cup-7"))
    graph.until(sent.done, "the goal is answered")

    def says(words: str) -> bool:
        return any(words in message.status[0].message for message in diagnostics[-20:])

    graph.until(lambda: says("no transform"), "it waits for tf")

    def waits() -> bool:
        where = transform_message("map", "base_link", START, (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))
        graph.publish("/tf", TFMessage(transforms=[where]))
        return says("no world_state has arrived")

    graph.until(waits, "it waits for a world")
    graph.call(Reset, "object_search/reset", Reset.Request(reason="a test"))
    done = sent.result().get_result_async()
    graph.until(done.done, "the search ends")
    assert done.result().result.code == FindObject.Result.CANCELED
    assert done.result().result.message == "a new run began"
    graph.until(lambda: [message.data for message in bases] == [False, True], "the base is free again")
    client.destroy()
