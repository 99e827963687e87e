"""The simulated robot of the live demo in the graph: it drives where `navigate_to_pose` is told to.

`maintenance_goal` reaches it from world_maintenance itself (`navigate: true`), `search_goal` is handed on from here.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid as GridMessage
from numpy.typing import NDArray
from rclpy.action.server import ActionServer, CancelResponse
from rclpy.task import Future
from std_msgs.msg import Bool, Header

from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from whereabouts.messages.world_objects import state_from_message
from whereabouts.nodes.live.searching import ACTION, Searches
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.world_reading import grid_from_message, pose_stamped
from whereabouts.nodes.navigation.goals import ACTION as NAVIGATE
from whereabouts.nodes.navigation.goals import Navigator, navigate_type
from whereabouts.nodes.ros.executor import private_node
from whereabouts.nodes.ros.qos import EVENTS, HEARD_LATCHED, LATCHED
from whereabouts.nodes.ros.turns import goals_name
from whereabouts.recorded.evidence_messages import NOT_FOUND
from whereabouts.simulation.home.apartment_bag import START
from whereabouts.simulation.home.apartment_day import TICKS
from whereabouts.simulation.home.live_apartment import ARM, LiveDay
from whereabouts_msgs.action import FindObject
from whereabouts_msgs.msg import ObjectEvidence, VerificationTask, WorldEvidence, WorldState
from world_model import WorldState as State

Array = NDArray[np.float64]
DISCOVERY = 30.0
"""s of this machine until the nodes and the robot have found each other."""
PAUSE = 0.002


@dataclass
class DriveGoal:
    """Where the robot was sent.

    stamp : s of the day. kind : who sent it. place : (2,) m. outcome : "" while it drives.
    """

    stamp: float
    kind: str
    place: Array
    reason: str = ""
    outcome: str = ""


@dataclass
class SearchRequest:
    """One search. steps : (s of the day, what the robot does next). result : None until it has ended."""

    steps: list[tuple[float, str]] = field(default_factory=list)
    result: Any = None


class LiveRobot:
    """The robot's side of the graph; a context manager.

    goals : all it was sent to. tasks : (s, object, reason) of maintenance. world, map : the newest, None before it.
    note : as of `Replayer`.
    """

    def __init__(self, day: LiveDay) -> None:
        self.day = day
        self.goals: list[DriveGoal] = []
        self.tasks: list[tuple[float, str, str]] = []
        self.world: State | None = None
        self.map: OccupancyGrid | None = None
        self.note: Callable[[str], None] = lambda name: None
        self._reasons: dict[tuple[float, float], tuple[str, str]] = {}
        self._current: tuple[Any, Future, DriveGoal] | None = None

    def __enter__(self) -> LiveRobot:
        self.node, self._executor = private_node("whereabouts_live")
        kind = navigate_type()
        self._server = ActionServer(
            self.node, kind, NAVIGATE, partial(self._navigate, kind.Result),
            cancel_callback=lambda _: CancelResponse.ACCEPT,
        )  # fmt: skip
        self._navigator = Navigator(self.node)
        self._base = self.node.create_publisher(Bool, "base_available", LATCHED)
        self._evidence = self.node.create_publisher(WorldEvidence, "evidence", EVENTS)
        self._searches = Searches(self.node)
        for message, topic, take, qos in (
            (PoseStamped, "search_goal", self._search_goal, LATCHED),
            (Bool, "base_available", self._base_available, LATCHED),
            (VerificationTask, "verification_tasks", self._task, 10),
            (WorldState, "world_state", self._take_world, HEARD_LATCHED),
            (GridMessage, "map", self._take_map, LATCHED),
        ):
            self.node.create_subscription(message, topic, take, qos)
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(Exception):
            self._server.destroy()
            self._navigator.close()
            self._searches.destroy()
            self.node.destroy_node()
        self.node.context.try_shutdown()

    # Time.

    def look(self) -> None:
        """Take in what there is to hear, and tell what has become of the goal; call it once a moment."""
        self._report()
        until = time.monotonic() + PAUSE
        while time.monotonic() < until:
            self._executor.spin_once(timeout_sec=0.0)

    def until(self, done: Callable[[], bool], seconds: float = DISCOVERY) -> bool:
        """Let the graph go on while the day stands still; whether it is done."""
        end = time.monotonic() + seconds
        while not done() and time.monotonic() < end:
            self._executor.spin_once(timeout_sec=0.01)
        return done()

    # Driving.

    def take_base(self, taken: bool) -> None:
        """Say whether somebody else than maintenance moves the robot."""
        self.note(self._base.topic_name)
        self._base.publish(Bool(data=not taken))

    def send(self, kind: str, goal: Array, reason: str = "") -> bool:
        """Send the robot to (3,) through the action, like anybody; False where it does not answer in time.

        A yaw that is nan is the one towards the goal.
        """
        here = self.day.robot.pose
        yaw = math.atan2(*(goal[:2] - here[:2])[::-1]) if math.isnan(goal[2]) else goal[2]
        pose = pose_stamped(Header(frame_id="map"), np.array([*goal[:2], yaw]))
        self._reasons[_key(pose)] = (kind, reason)
        known = len(self.goals)
        if not self.until(lambda: self._navigator.ready):
            return False
        self._navigator.go(pose)
        return self.until(lambda: len(self.goals) > known)

    def stop(self) -> None:
        """Whoever has sent it: stay here."""
        self._navigator.stop()
        self._finish("cancelled")

    @property
    def driving(self) -> bool:
        """Whether it is on its way."""
        return self._current is not None

    async def _navigate(self, result: Any, handle: Any) -> Any:
        """Drive for whoever asks; who asks last is obeyed."""
        self._finish("replaced")
        at, turn = handle.request.pose.pose.position, handle.request.pose.pose.orientation
        kind, reason = self._reasons.pop(_key(handle.request.pose), ("maintenance", ""))
        goal = DriveGoal(self.day.time, kind, np.array([at.x, at.y]), reason)
        if kind == "maintenance" and self.tasks:
            goal.reason = f"{self.tasks[-1][1]}: {self.tasks[-1][2]}"
        self.goals.append(goal)
        heading = 2.0 * math.atan2(turn.z, turn.w)
        apart = ARM if kind == "fetch" else 0.0
        if not self.day.robot.go(np.array([at.x, at.y, heading]), apart=apart):
            goal.outcome = "no way"
            handle.abort()
            return result()
        ended: Future = Future()
        self._current = (handle, ended, goal)
        goal.outcome = await ended
        if goal.outcome == "reached":
            handle.succeed()
        elif goal.outcome == "cancelled" and handle.is_cancel_requested:
            handle.canceled()
        else:
            handle.abort()
        return result()

    def _report(self) -> None:
        if self._current is None:
            return
        if self._current[0].is_cancel_requested:
            self._finish("cancelled")
        elif self.day.robot.status in ("reached", "failed"):
            self._finish(self.day.robot.status, stop=False)

    def _finish(self, outcome: str, stop: bool = True) -> None:
        current, self._current = self._current, None
        if stop:
            self.day.robot.stop()
        if current is not None:
            current[1].set_result(outcome)

    # What the nodes say.

    def _search_goal(self, pose: PoseStamped) -> None:
        self._reasons[_key(pose)] = ("search", "")
        self._navigator.go(pose)

    def _base_available(self, message: Bool) -> None:
        searching = self._current is not None and self._current[2].kind == "search"
        if message.data and searching:
            self.stop()

    def _task(self, message: VerificationTask) -> None:
        self.tasks.append((self.day.time, message.object_id, message.reason))

    def _take_world(self, message: WorldState) -> None:
        with suppress(InputError):
            self.world = state_from_message(message)

    def _take_map(self, message: GridMessage) -> None:
        self.map = grid_from_message(message, "map")

    def miss(self, object_id: str) -> None:
        """The arm has found nothing where an object should be: tell the world model."""
        # The moment that was measured last: nothing is known of a later one.
        stamp = time_message(round((START + self.day.time - 1.0 / TICKS) * NANOSECONDS))
        missing = ObjectEvidence(detection_id=NOT_FOUND, object_id=object_id)
        missing.pose.pose.orientation.w = 1.0
        header = Header(stamp=stamp, frame_id="map")
        self.note(self._evidence.topic_name)
        self._evidence.publish(WorldEvidence(header=header, sensor="arm", objects=[missing]))

    # Asking.

    def find(self, kind: str, predicates: tuple[str, ...], timeout: float) -> SearchRequest | None:
        """Have an object searched for; None where nobody does. timeout : s of the day."""
        if not self.until(lambda: self._searches.ready):
            return None
        search = SearchRequest()
        goal = FindObject.Goal(class_name=kind, predicates=list(predicates))
        goal.timeout.sec = int(timeout)
        self.note(goals_name(self.node.resolve_topic_name(ACTION)))

        def told(step: FindObject.Feedback) -> None:
            search.steps.append((self.day.time, step.reason))

        def ended(result: FindObject.Result) -> None:
            search.result = result

        self._searches.ask(goal, told, ended)
        return search


def _key(pose: PoseStamped) -> tuple[float, float]:
    return round(pose.pose.position.x, 3), round(pose.pose.position.y, 3)
