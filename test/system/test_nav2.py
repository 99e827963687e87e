"""Search and maintenance drive by nav2's action: a server that accepts, gives up, makes way for others and cancels."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pytest
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import PoseStamped
from harness import Graph
from rclpy.action.client import ActionClient
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.task import Future
from std_msgs.msg import Bool
from test_search_and_maintenance import TABLE, House, figures, run_until, start_maintenance, the, trigger

from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.navigation.goals import Navigator
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts.recorded.evidence_messages import NOT_FOUND
from whereabouts_msgs.action import FindObject
from whereabouts_msgs.msg import ObjectEvidence, WorldEvidence
from whereabouts_msgs.srv import Reset

NavigateToPose = pytest.importorskip("nav2_msgs.action").NavigateToPose
NO_PATH = 208  # an error of nav2's planner
SAYS = hasattr(NavigateToPose.Result(), "error_msg")  # Jazzy's does, older ones do not


@dataclass
class NavigationJob:
    """A goal that nav2 works on. outcome : how it ended, "" until then."""

    place: np.ndarray
    outcome: str = ""
    moved: Future = field(default_factory=Future)


class Nav2:
    """As nav2's navigator: one goal at a time, the next one takes its place, which then ends without an error.

    where : (3,) pose of the robot. blocked : whether there is no path to a place (2,). jobs : all goals.
    """

    def __init__(self, graph: Graph, where: Callable[[], np.ndarray]) -> None:
        self._where = where
        self.blocked: Callable[[np.ndarray], bool] = lambda place: False
        self.jobs: list[NavigationJob] = []
        self.server = ActionServer(
            graph.node, NavigateToPose, "navigate_to_pose", self._run,
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip

    @property
    def goal(self) -> np.ndarray | None:
        """Where the robot is driven to, (2,)."""
        going = [job.place for job in self.jobs if not job.outcome]
        return going[-1] if going else None

    def tick(self) -> None:
        """The robot has moved."""
        for job in self.jobs:
            if not job.moved.done():
                job.moved.set_result(None)

    async def _run(self, handle: Any) -> Any:
        result, at = NavigateToPose.Result(), handle.request.pose.pose.position
        job = NavigationJob(np.array([at.x, at.y]))
        self.jobs.append(job)
        while not job.outcome:
            away = float(np.hypot(*(job.place - self._where()[:2])))
            if handle.is_cancel_requested:
                handle.canceled()
                job.outcome = "cancelled"
            elif self.jobs[-1] is not job:
                handle.abort()
                job.outcome = "replaced"
            elif self.blocked(job.place):
                result.error_code = NO_PATH
                if SAYS:
                    result.error_msg = "no valid path"
                handle.abort()
                job.outcome = "no path"
            elif away < 0.2:
                handle.succeed()
                job.outcome = "reached"
            else:
                handle.publish_feedback(NavigateToPose.Feedback(distance_remaining=away))
                job.moved = Future()
                await job.moved
        return result


def pose(x: float, y: float) -> PoseStamped:
    message = PoseStamped()
    message.header.frame_id = "map"
    message.pose.position.x, message.pose.position.y, message.pose.orientation.w = x, y, 1.0
    return message


def test_the_driver_follows_a_server_through_every_way_a_goal_can_end(graph: Graph) -> None:
    robot = np.zeros(3)
    ours, other = Navigator(graph.node), Navigator(graph.node)
    failures: list[str] = []
    assert not ours.go(pose(3.0, 4.0), lambda: failures.append(ours.reason)), "nav2 is not there yet"
    assert ours.reason == "no node offers navigate_to_pose"
    nav2 = Nav2(graph, lambda: robot)
    graph.until(lambda: ours.ready and other.ready, "the action is served")

    def go(x: float, y: float) -> None:
        assert ours.go(pose(x, y), lambda: failures.append(ours.reason))

    def ends(number: int, outcome: str) -> None:
        def ended() -> bool:
            nav2.tick()
            return len(nav2.jobs) > number and nav2.jobs[number].outcome == outcome

        graph.until(ended, f"goal {number} is {outcome}")

    ours.serve()
    graph.until(lambda: ours.remaining is not None, "nav2 says how far it is")
    assert ours.remaining == pytest.approx(5.0)
    robot[:2] = 3.0, 4.0
    ends(0, "reached")
    go(9.0, 4.0)
    graph.until(lambda: len(nav2.jobs) == 2, "the second goal is taken")
    ours.stop()
    ends(1, "cancelled")
    nav2.blocked = lambda place: bool(place[0] > 10.0)
    go(11.0, 0.0)
    graph.until(lambda: nav2.tick() or failures, "it is given up")
    assert [job.outcome for job in nav2.jobs[2:]] == ["no path", "no path"], "it was tried once more"
    assert failures == [f"nav2 gives up, error {NO_PATH}{': no valid path' if SAYS else ''}"]
    go(9.0, 9.0)
    graph.until(lambda: len(nav2.jobs) == 5 and ours.remaining is not None, "the goal is on its way")
    assert other.go(pose(0.0, 0.0), lambda: None)
    ends(4, "replaced")
    graph.until(lambda: len(failures) == 2, "we are told")
    assert failures[1] == "nav2 gives up, or another goal took its place"
    graph.until(lambda: ours.remaining is not None and other.remaining is not None, "the other one drives on")
    assert len(nav2.jobs) == 6, "nobody quarrels about the robot"
    ours.close()
    other.close()
    nav2.server.destroy()


class DrivenHouse(House):
    """A robot that goes where nav2 drives it, and nowhere else."""

    def __init__(self, graph: Graph, things: dict[str, tuple[str, float, float]]) -> None:
        super().__init__(graph, things)
        self.nav2 = Nav2(graph, lambda: self.pose)
        self.parked = False

    def _take_goal(self, message: PoseStamped) -> None:
        """Goals on topics move nothing here."""

    def step(self) -> None:
        self.goal = None if self.parked else self.nav2.goal
        super().step()
        self.nav2.tick()


@pytest.fixture
def house(graph: Graph) -> DrivenHouse:
    things = {
        "cup": ("cup", 1.0, 1.0), "bed": ("bed", -1.0, 4.0), "table": ("coffee table", 4.6, 3.6),
    }  # fmt: skip
    made = DrivenHouse(graph, things)
    graph.start("world_model", region=[-10.0, 10.0, -10.0, 10.0, -0.5, 3.0], rate_hz=10.0)
    return made


def test_a_search_drives_gives_up_what_is_blocked_and_cancels_with_itself(
    graph: Graph, house: DrivenHouse
) -> None:
    house.start("object_search", rate=10.0, view=1.2, navigate=True)
    run_until(graph, house, lambda: the(house.states, "bed"), "the bed is known")
    client = ActionClient(graph.node, FindObject, "find_object")
    graph.until(client.server_is_ready, "find_object is served")
    # There is no way to the place that is tried first.
    first: list[np.ndarray] = []

    def blocked(place: np.ndarray) -> bool:
        first.append(place)
        return bool(np.hypot(*(place - first[0])) < 0.5)

    house.nav2.blocked = blocked
    heard: list[Any] = []
    sent = client.send_goal_async(
        FindObject.Goal(class_name="unicorn"), feedback_callback=lambda m: heard.append(m.feedback)
    )
    run_until(graph, house, sent.done, "the goal is answered")
    jobs = house.nav2.jobs

    def elsewhere() -> bool:
        return any(np.hypot(*(job.place - first[0])) > 0.5 for job in jobs if first)

    run_until(graph, house, elsewhere, "another place is tried")
    assert [job.outcome for job in jobs[:2]] == ["no path", "no path"]
    house.nav2.blocked = lambda place: False
    run_until(
        graph,
        house,
        lambda: any(job.outcome == "reached" for job in jobs) or house.nav2.goal is not None,
        "it drives",
    )
    cancelled = sent.result().cancel_goal_async()
    run_until(graph, house, cancelled.done, "the cancel is answered")
    done = sent.result().get_result_async()
    run_until(graph, house, done.done, "the search ends")
    assert done.result().result.code == FindObject.Result.CANCELED
    run_until(graph, house, lambda: house.nav2.goal is None, "the robot is not driven on")
    client.destroy()


def test_maintenance_drives_and_looks(graph: Graph, house: DrivenHouse) -> None:
    start_maintenance(house, use_sim_time=False, navigate=True)
    bed = run_until(graph, house, lambda: the(house.states, "bed"), "the bed is known")
    run_until(graph, house, lambda: trigger(graph, bed.id), "maintenance takes the trigger")
    run_until(graph, house, lambda: bed.id in house.verified, "the robot has gone to look")
    assert house.nav2.jobs
    assert np.hypot(*(house.pose[:2] - np.array([-1.0, 4.0]))) < 2.0


def test_maintenance_that_begins_anew_does_not_let_the_robot_drive_on(
    graph: Graph, house: DrivenHouse
) -> None:
    start_maintenance(house, use_sim_time=False, navigate=True)
    bed = run_until(graph, house, lambda: the(house.states, "bed"), "the bed is known")
    house.parked = True
    run_until(graph, house, lambda: trigger(graph, bed.id), "maintenance takes the trigger")
    run_until(graph, house, lambda: house.nav2.goal is not None, "the robot is driven")
    graph.call(Reset, "world_maintenance/reset", Reset.Request(reason="a test"))
    run_until(graph, house, lambda: house.nav2.goal is None, "the robot is not driven on")
    assert house.nav2.jobs[-1].outcome == "cancelled"


def lose(house: DrivenHouse, object_id: str) -> None:
    """Say that an object is not where it is believed to be."""
    missing = ObjectEvidence(detection_id=NOT_FOUND, object_id=object_id)
    missing.pose.pose.orientation.w = 1.0
    message = WorldEvidence(sensor="arm", objects=[missing])
    message.header.stamp, message.header.frame_id = time_message(house.stamp), "map"
    house.graph.publish("evidence", message)


def test_one_at_a_time_has_the_base_a_person_first_then_what_is_lost_then_maintenance(
    graph: Graph, house: DrivenHouse
) -> None:
    start_maintenance(house, use_sim_time=False, navigate=True, search_for_lost=True)
    house.start("object_search", rate=10.0, view=1.2, navigate=True)
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    bases = graph.collect(Bool, "base_available", LATCHED)
    jobs = house.nav2.jobs
    cup = run_until(graph, house, lambda: the(house.states, "cup"), "the cup is known")
    client = ActionClient(graph.node, FindObject, "find_object")
    graph.until(client.server_is_ready, "find_object is served")

    def says(node: str, words: str) -> bool:
        said = [m.status[0].message for m in diagnostics[-50:] if m.status[0].name == node]
        return bool(said) and words in said[-1]

    # Somebody looks for what nobody has; meanwhile the cup, which is wanted, is lost.
    house.parked = True
    house.pose = np.array([-1.5, 0.5, 0.0])  # the cup is out of sight from here
    sent = client.send_goal_async(FindObject.Goal(class_name="unicorn"))
    run_until(graph, house, sent.done, "the goal is answered")
    persons = sent.result().get_result_async()
    run_until(graph, house, lambda: house.nav2.goal is not None, "the search drives")
    run_until(graph, house, lambda: trigger(graph, cup.id), "maintenance takes the trigger")
    house.things["cup"] = ("cup", *TABLE)
    lose(house, cup.id)

    def lost() -> bool:
        known = [item for item in house.states[-1].objects if item.id == cup.id]
        return all(item.lost for item in known)

    run_until(graph, house, lost, "the cup is lost")
    run_until(
        graph,
        house,
        lambda: says("world_maintenance", "waits until the base is free"),
        "the other search waits",
    )
    assert figures(diagnostics, "world_maintenance")["searches asked for"] == "0"
    assert not persons.done(), "a person's search is not ended"
    assert [message.data for message in bases] == [False]

    # The person has had enough: now it is the turn of what is lost.
    cancelled = sent.result().cancel_goal_async()
    run_until(graph, house, cancelled.done, "the cancel is answered")
    run_until(graph, house, lambda: says("object_search", "looking for cup"), "the cup is searched for")
    run_until(graph, house, lambda: house.nav2.goal is not None, "the search drives")
    run_until(graph, house, lambda: says("world_maintenance", "it is searched for"), "maintenance says so")
    # Somebody takes the base for something else: the search makes way at once, and goes on when it is free.
    graph.publish("base_available", Bool(data=False), LATCHED)
    run_until(graph, house, lambda: house.nav2.goal is None, "the robot is not driven on")
    run_until(
        graph,
        house,
        lambda: says("world_maintenance", "waits until the base is free"),
        "the search waits again",
    )
    count, heard = len(jobs), len(bases)
    until = house.stamp + 5 * NANOSECONDS
    run_until(graph, house, lambda: house.stamp > until, "some seconds pass")
    assert len(jobs) == count, "nobody drives meanwhile"
    assert not any(message.data for message in bases[heard:]), "nobody gives away what another has taken"
    house.parked = False
    graph.publish("base_available", Bool(data=True), LATCHED)
    run_until(
        graph, house, lambda: figures(diagnostics, "object_search").get("found") == "1", "the cup is found"
    )
    graph.until(lambda: bases[-1].data, "the base is free in the end")
    client.destroy()
