"""Node `world_maintenance`: decides which object to look at again, and has it done."""

from __future__ import annotations

import math
import time
from functools import partial
from typing import Any

import numpy as np
from action_msgs.msg import GoalStatus
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid as GridMessage
from std_msgs.msg import Bool, Header

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.rotations import wrap_scalar
from whereabouts.nodes.messages.packed import Packed
from whereabouts.nodes.messages.stamps import NANOSECONDS, duration_message, time_message
from whereabouts.nodes.messages.transforms import frame_name
from whereabouts.nodes.messages.world_reading import (
    LatestState,
    attribute_messages,
    box_region,
    distribution_message,
    grid_from_message,
    planar_pose,
    pose_stamped,
)
from whereabouts.nodes.navigation.errands import Errands
from whereabouts.nodes.navigation.goals import Navigator
from whereabouts.nodes.ros.base import SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.nodes.ros.qos import HEARD_LATCHED, LATCHED
from whereabouts.parameters.world_maintenance import WorldMaintenanceParameters
from whereabouts.recorded.evidence_messages import NOT_FOUND
from whereabouts_msgs.action import VerifyObject
from whereabouts_msgs.msg import ObjectEvidence, WorldEvidence
from whereabouts_msgs.msg import VerificationTask as TaskMessage
from whereabouts_msgs.msg import WorldState as StateMessage
from whereabouts_msgs.srv import TriggerVerification
from world_model import Maintenance, VerificationTask, WorldState
from world_model.describing import named
from world_model.tasks.growth import Growth
from world_model.tasks.maintenance import warm_up

# Sizes that are added to the 95 % region of a position, as objects are no points.
BODY = np.array([0.3, 0.3, 0.3])
LOOKS_BEFORE_LOST = 2  # observations in vain, each from nearer, after which an object is lost
TURNED = 0.3  # rad by which a robot may miss a heading, about as nav2 allows, however narrow its view is
ANSWER_MARGIN = 5.0  # s that the verifier's answer may take beyond the time it has to decide


class WorldMaintenanceNode(SuiteNode):
    """One task at a time: drive, look, report."""

    parameters_model = WorldMaintenanceParameters
    node_name = "world_maintenance"
    settings: WorldMaintenanceParameters

    def setup(self) -> None:
        settings = self.settings
        warm_up()
        self._map_frame, self._base = frame_name(settings.map_frame), frame_name(settings.base_frame)
        self._sensors = settings.sensor_models
        self._grid: OccupancyGrid | None = None
        self._available = True
        self.listen_to_transforms(on_demand=True)
        self.add_latched_input(GridMessage, "map", self._take_map)
        states = self.add_input(StateMessage, "world_state", self._take_state, packed=True, qos=HEARD_LATCHED)
        self._latest = LatestState(states.refuse, self._map_frame, lambda state: self._growth.observe(state))
        self.add_latched_input(Bool, "base_available", self._take_available)
        self._task_output = self.add_output(TaskMessage, "verification_tasks")
        self._goal_output = self.add_output(PoseStamped, "maintenance_goal", LATCHED)
        self._evidence_output = self.add_output(WorldEvidence, "evidence")
        self.add_service(TriggerVerification, "~/trigger", self._trigger)
        self._verifier = self.add_caller(VerifyObject, "verify_object")
        self._finder = (
            Errands(self, partial(self.complain, key="search")) if settings.search_for_lost else None
        )
        self._navigator = Navigator(self, settings.navigate)
        self.created.callback(self._navigator.close)
        self.add_timer(1.0 / settings.rate, self._tick)

    def start_run(self) -> None:
        self._maintenance = Maintenance(self.settings.maintenance)
        self._navigator.stop()
        self._latest.forget()
        self._growth = Growth(self._maintenance.config.process_noise)
        self._task: VerificationTask | None = None
        self._since = 0.0
        self._moves = False  # whether the task takes the base
        self._verifying, self._asked = False, (0.0, 0.0)
        self._outcomes = dict.fromkeys(("found", "occluded", "not_found"), 0)
        self._vain: dict[str, int] = {}
        self._wanted: dict[str, str] = {}
        self._tasks = 0
        if self._finder is not None:
            self._finder.forget()

    def health(self) -> Health:
        figures: dict[str, object] = {"tasks": self._tasks, **self._outcomes}
        figures["triggers waiting"] = len(self._maintenance.queue)
        figures["searches asked for"] = 0 if self._finder is None else self._finder.sent
        figures |= self._navigator.figures
        if self._finder is not None and self._finder.busy:
            return Health(self._finder.said, figures=figures)
        if self._task is not None:
            return Health(f"{self._task.object_id}: {self._task.reason}", figures=figures)
        return Health(self._maintenance.idle_reason or "waiting for a world state", figures=figures)

    # Inputs.

    def _take_state(self, message: Packed, stamp: int) -> None:
        self._latest.take(message)

    def _take_map(self, message: GridMessage, stamp: int) -> None:
        self._grid = grid_from_message(message, self._map_frame)

    def _take_available(self, message: Bool, stamp: int) -> None:
        self._available = bool(message.data)
        if not self._available and self._task is not None and self._moves and not self._verifying:
            self._finish(self._task, "occluded")

    def _trigger(self, request: TriggerVerification.Request, response: TriggerVerification.Response) -> str:
        name = request.object_id
        state = self._latest.state
        known = () if state is None else state.objects
        if not name:
            if not request.class_name:
                raise InputError("object_id and class_name are both empty: name what to look at")
            meant = [item for item in known if item.most_probable("class") == request.class_name]
            if not meant:
                raise InputError(f"no object of class '{request.class_name}' is known")
        else:
            meant = [item for item in known if item.id == name]
            if not meant:
                raise InputError(f"object '{name}' is unknown")
        best = max(meant, key=lambda item: (not item.lost, item.existence))
        if best.lost:
            raise InputError(f"{named(best)} is lost: it was not at its place. Use find_object")
        self._want(best.id)
        response.merged = not self._maintenance.trigger(best.id, request.requester or "a task")
        response.object_id = best.id
        return f"{named(best)} is next to be observed"

    # Decisions.

    def _tick(self) -> None:
        pose, now = planar_pose(self.transforms, self._map_frame, self._base), self._now()
        self._notice_losses()
        self._navigator.serve()
        if self._verifying and self._task is not None and self._unanswered():
            self.complain(f"{self._task.object_id}: the verifier does not answer", key="verifier")
            self._verified(self._task, None)
        if pose is None or self._verifying:
            return
        state = self._latest.state
        if state is None:
            return
        if self._task is not None and self._has_moved(self._task, state):
            self._task = None
            self._navigator.stop()
        if self._task is not None:
            self._look_after(self._task, pose, now)
            return
        # What is lost is searched for before anything else is driven to.
        free = not self._search_goes_first(state) and self._available
        # A look in passing is for what the world model itself is unsure of.
        world = self._growth.ahead(state, now, carried=free)
        view = None if self.settings.opening > 6.28 else self.settings.opening
        task = self._maintenance.next_task(
            world, pose, self._sensors, view, base_available=free, grid=self._grid
        )
        if task is None:
            return
        self._task, self._since = task, now
        self._moves = task.distance > 0.0 or not self._in_place(task, pose)
        self._tasks += 1
        self._want(task.object_id)
        self._publish(task)
        self._look_after(task, pose, now)

    def _look_after(self, task: VerificationTask, pose: Array, now: float) -> None:
        """Verify once the robot is where it should look from; give up on what is never reached."""
        if self._in_place(task, pose):
            self._verify(task)
        elif now - self._since > self.settings.task_timeout:
            self.complain(f"{task.object_id}: the robot did not reach the goal in time", key="goal")
            self._finish(task, "occluded")

    def _has_moved(self, task: VerificationTask, state: WorldState) -> bool:
        """Whether the object is known to be elsewhere by now: an empty region would tell nothing of it."""
        item = state.find(task.object_id)
        return item is not None and not item.lost and not task.covers(item.position)

    def _in_place(self, task: VerificationTask, pose: Array) -> bool:
        """Whether the robot is at the goal, and the object in its field of view."""
        ahead = task.region[0][:2] - pose[:2]
        off = abs(wrap_scalar(math.atan2(ahead[1], ahead[0]) - pose[2]))
        away = np.hypot(*(task.goal[:2] - pose[:2]))
        return bool(
            away <= self.settings.arrival_distance and off <= max(0.5 * self.settings.opening, TURNED)
        )

    def _publish(self, task: VerificationTask) -> None:
        header = self._header()
        goal = pose_stamped(header, task.goal)
        message = TaskMessage(
            header=header, object_id=task.object_id, region=box_region(task.region[0], task.region[1] + BODY),
            goal=goal, sensor=task.sensor, gain=task.gain, utility=task.utility, reason=task.reason,
            class_distribution=distribution_message(task.attributes.get("class", {})),
            attributes=attribute_messages(task.attributes, task.quantities),
            trigger=TaskMessage.TRIGGER_TASK if task.trigger else TaskMessage.TRIGGER_UNCERTAINTY,
        )  # fmt: skip
        self._task_output.publish(message)
        if self._moves:
            self._goal_output.publish(goal)
            if not self._navigator.go(goal, lambda: self._unreachable(task)):
                self.complain(self._navigator.reason, key="nav2")

    def _unreachable(self, task: VerificationTask) -> None:
        """nav2 cannot get there: another task, this one from another side later."""
        if self._task is task and not self._verifying:
            why = self._navigator.reason
            self.complain(f"{task.object_id}: the goal cannot be reached: {why}", key="goal")
            self._finish(task, "occluded")

    # Verification.

    def _verify(self, task: VerificationTask) -> None:
        if not self._verifier.ready:
            # It may not have been found yet, or be on its way back.
            self.complain("no node offers the action verify_object", key="verifier")
            if self._now() - self._since > self.settings.task_timeout:
                self._finish(task, "occluded")
            return
        goal = VerifyObject.Goal(
            header=self._header(), object_id=task.object_id, class_name=task.class_name, sensor=task.sensor,
            region=box_region(task.region[0], task.region[1] + BODY),
            attributes=attribute_messages(task.attributes, task.quantities),
            timeout=duration_message(self.settings.verify_timeout),
        )  # fmt: skip
        self._verifying, self._asked = True, (self._now(), time.monotonic())
        self._verifier.send(goal, lambda answer: self._verified(task, answer))

    def _unanswered(self) -> bool:
        """Whether the verifier has let its time pass: it died, or what it said got lost."""
        ros, steady = self._asked
        limit = self.settings.verify_timeout + ANSWER_MARGIN
        return self._now() - ros > limit and (self.turns.on or time.monotonic() - steady > limit)

    def _verified(self, task: VerificationTask, answer: Any) -> None:
        if task is not self._task or not self._verifying:
            return
        self._verifying = False
        if answer is None or answer.status not in (GoalStatus.STATUS_SUCCEEDED, GoalStatus.STATUS_ABORTED):
            self._finish(task, "occluded")
            return
        result = answer.result
        if result.code == result.FOUND:
            self._vain.pop(task.object_id, None)
            self._wanted.pop(task.object_id, None)
            if result.evidence.objects:
                self._evidence_output.publish(result.evidence)
            self._finish(task, "found")
        elif result.code == result.NOT_FOUND:
            self._missed(task)
        else:
            self._finish(task, "occluded")

    def _missed(self, task: VerificationTask) -> None:
        """A look in vain: once more from nearer, then the object is lost."""
        self._vain[task.object_id] = self._vain.get(task.object_id, 0) + 1
        if self._vain[task.object_id] < LOOKS_BEFORE_LOST:
            self._finish(task, "occluded")
            self._maintenance.trigger(task.object_id, task.trigger or "a failed observation")
            return
        del self._vain[task.object_id]
        missing = ObjectEvidence(detection_id=NOT_FOUND, object_id=task.object_id)
        missing.pose.pose.orientation.w = 1.0
        self._evidence_output.publish(
            WorldEvidence(header=self._header(), sensor=task.sensor, objects=[missing])
        )
        self._finish(task, "not_found")

    # Losses.

    def _want(self, object_id: str) -> None:
        """Somebody wants to know where an object is: itself, or by its class once it is lost."""
        state = self._latest.state
        for item in () if state is None else state.objects:
            if item.id == object_id and not item.lost:
                self._wanted[object_id] = item.most_probable("class")

    def _notice_losses(self) -> None:
        """Hand what is wanted, and no longer believed to be anywhere, to the search."""
        state = self._latest.state if self._wanted else None
        if state is None:
            return
        here = {item.id for item in state.objects if not item.lost}
        for name in [name for name in self._wanted if name not in here]:
            kind = self._wanted.pop(name)
            if self._finder is not None:
                self._finder.add(name, kind)

    def _search_goes_first(self, state: WorldState) -> bool:
        """Whether something lost is searched for, or waits until it can be."""
        if self._finder is None:
            return False
        if self._finder.broken_off(self._now()):
            # It was the search that had taken the base, and cannot give it back.
            self._available = True
        return self._finder.look(state, self._available, self._now())

    def _finish(self, task: VerificationTask, outcome: str) -> None:
        self._outcomes[outcome] += 1
        self._maintenance.report(task, outcome, self._now())
        self._task = None
        self._navigator.stop()

    # Helpers.

    def _now(self) -> float:
        """s of the node's clock."""
        return self.now / NANOSECONDS

    def _header(self) -> Header:
        now = self.now
        newest = self.transforms.newest(self._map_frame, self._base) or 0
        # Evidence has to be placed by tf at its stamp.
        stamp = min(now, newest) if newest else now
        return Header(stamp=time_message(stamp), frame_id=self._map_frame)


def main() -> None:
    exit_with(WorldMaintenanceNode)


if __name__ == "__main__":
    main()
