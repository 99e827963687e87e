"""When to look at which object again: uncertainty-driven, semi-task-dependent maintenance (chapter 3).

The robot imagines driving to each object with each sensor, propagates and updates covariances on the way as it would
(3.6), and takes the action of the largest expected utility (3.9), (3.10). What an action is worth has two sides, which
the text adds up in one sum. Whether to go at all is decided by the gain over all objects seen on the way, as in the
text. Where to go is decided by the gain of the object one goes for, and what is seen in passing counts a tenth
(`company`): the plain sum prefers busy corners, and the lonely object grows ever more uncertain.

Once something is worth going for, whatever else would bring a good share of the threshold (`tour`) is looked at on the
same round, along the shortest way through all of them: one at a time, the robot crosses the room for each.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_own, as_stamp, require_kind, require_word
from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from world_model.state import OUTCOMES, WorldObject, WorldState
from world_model.tasks.looks import FARTHEST, Looks, Sensor, looks_at
from world_model.tasks.maintenance_kernels import single_gains
from world_model.tasks.maintenance_options import (
    TOUR,
    MaintenanceConfig,
    Option,
    View,
    looked_at_now,
    options,
    tour,
)
from world_model.tasks.ways import Ways

__all__ = ["Maintenance", "MaintenanceConfig", "Trigger", "VerificationTask"]

STANDS = 0.3  # m that the estimate of an object which stands may change by, however sure it was
INTERVAL = 1.96  # standard deviations to either side that hold 95 %


@dataclass(frozen=True)
class VerificationTask:
    """Look at one object again.

    object_id : of the object. goal : (3,) x, y, yaw to stand and look from, world frame. region : centre (3,) and
    size (3,) of the box that holds it with 95 % along each axis, m. sensor : name. gain : nat, expected over all
    objects seen on the way (3.6). utility : (3.9). reason : one sentence. trigger : who asked, "" where it pays by
    itself. distance : m to drive. class_name, attributes, quantities : what is known about it, for whoever looks.
    """

    object_id: str
    goal: FloatArray
    region: tuple[FloatArray, FloatArray]
    sensor: str
    gain: float
    utility: float
    reason: str
    trigger: str = ""
    distance: float = 0.0
    class_name: str = ""
    attributes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    quantities: Mapping[str, tuple[float, float]] = field(default_factory=dict)

    def covers(self, position: FloatArray) -> bool:
        """Whether an object at a position (3,) is where the task looks; one that has moved on needs another task."""
        centre, size = self.region
        return bool((np.abs(position - centre) <= np.maximum(0.5 * size, STANDS)).all())


@dataclass(frozen=True)
class Trigger:
    """A component asks for a look: Table 3.1. requester : who, for the reason in the task."""

    object_id: str
    requester: str = "a task"


class Maintenance:
    """Chooses what to verify next; at most one uncertainty-driven task is pending at a time.

    Raises InputError: wrong settings.
    """

    def __init__(self, config: MaintenanceConfig | None = None) -> None:
        self.config = config or MaintenanceConfig()
        self._pending: VerificationTask | None = None
        self._queue: deque[Trigger] = deque()
        self._in_vain: dict[str, tuple[str, float]] = {}  # Outcome of the last look and its stamp
        self._misses: dict[str, int] = {}
        self._tour: set[str] = set()
        self.idle_reason = ""

    @property
    def tour(self) -> frozenset[str]:
        """Objects that are still to be looked at on the present tour."""
        return frozenset(self._tour)

    @property
    def queue(self) -> tuple[Trigger, ...]:
        """Triggers still to be served, in order."""
        return tuple(self._queue)

    def trigger(self, object_id: str, requester: str = "a task") -> bool:
        """Queue a look at an object, first come first served; False where one is pending or queued already."""
        require_word("object_id", object_id)
        if self._pending is not None and self._pending.object_id == object_id:
            return False
        if any(waiting.object_id == object_id for waiting in self._queue):
            return False
        self._queue.append(Trigger(object_id, requester))
        return True

    def before(self, action: str, object_id: str) -> bool:
        """A component is about to act on an object: queue a look where Table 3.1 asks for one; whether it does."""
        wanted = action in self.config.verified_actions
        if wanted:
            self.trigger(object_id, action)
        return wanted

    def next_task(
        self,
        world_state: WorldState,
        robot_pose: npt.ArrayLike,
        sensors: Sequence[Sensor],
        field_of_view: View | None = None,
        triggers: Sequence[Trigger | str] = (),
        base_available: bool = True,
        grid: OccupancyGrid | None = None,
    ) -> VerificationTask | None:
        """What to look at next, None where nothing pays (`idle_reason` says why).

        world_state : its objects; lost ones are left to the search. robot_pose : (3,) x, y, yaw, world frame.
        sensors : at least one. field_of_view : full opening angle, rad, of every sensor; or {"angle": rad, "range":
        m}; or a function that says whether a position (3,) is in view. None is all around.
        triggers : object ids, or `Trigger`s, to be looked at first, in this order. A trigger for the object that is
        pending anyway is merged with it. base_available : False where another component moves the base: only what
        is in view may be looked at. grid : ways and goals avoid what it has occupied.

        Raises InputError: no sensors, a pose that is not finite, a sensor's covariance that fits no object.
        """
        pose = as_own("robot_pose", robot_pose, (3,))
        if (np.abs(pose[:2]) > FARTHEST).any():
            raise InputError(
                f"robot_pose: at most {FARTHEST:g} m from the origin expected, got {pose.tolist()}"
            )
        require_kind("sensors", sensors, Sequence)
        if not sensors:
            raise InputError("sensors: at least one is needed")
        for sensor in sensors:
            require_kind("sensors", sensor, Sensor)
        Looks.opening(field_of_view)
        for asked in _triggers(triggers):
            self.trigger(asked.object_id, asked.requester)
        looks = looks_at(world_state.objects, sensors, self.config.process_noise)
        if not looks.objects:
            self._pending = None
            self.idle_reason = self._nothing_known(world_state)
            return None
        ways = Ways(pose, grid)
        served = self._serve_trigger(looks, ways, field_of_view, base_available)
        if served is not None:
            return served
        kept = self._keep_pending(looks, pose, base_available, field_of_view)
        if kept is not None:
            return kept
        self._pending = self._most_useful(world_state, looks, ways, field_of_view, base_available)
        return self._pending

    def report(self, task: VerificationTask, outcome: str, stamp: float | None = None) -> None:
        """Tell how a task ended.

        outcome : "found"; "occluded", no evidence: the object rests for `retry_after`; "not_found": it rests until it
        has been seen somewhere (the world model makes it lost). stamp : s; that of the next world state by default.

        Raises InputError: another outcome.
        """
        if outcome not in OUTCOMES:
            raise InputError(f"outcome: one of {', '.join(OUTCOMES)} expected, got {outcome!r}")
        when = math.nan if stamp is None else as_stamp("stamp", stamp)
        if self._pending is not None and self._pending.object_id == task.object_id:
            self._pending = None
        if outcome == "found":
            self._in_vain.pop(task.object_id, None)
            self._misses.pop(task.object_id, None)
        else:
            self._in_vain[task.object_id] = outcome, when
            self._misses[task.object_id] = self._misses.get(task.object_id, 0) + 1

    def _nothing_known(self, state: WorldState) -> str:
        if not state.objects:
            return "The world model is empty."
        if all(item.lost for item in state.objects):
            return "All objects are lost. Finding them is a task for object_search."
        return "No object has a position, covariance and growth that can be used."

    def _rests(self, item: WorldObject, stamp: float) -> bool:
        """Whether a report keeps an object from being looked at; forgets reports that are over."""
        if item.id not in self._in_vain:
            return False
        outcome, since = self._in_vain[item.id]
        absent = outcome == "not_found"
        if math.isnan(since):
            self._in_vain[item.id] = outcome, item.last_seen if absent else stamp
            return True
        rests = item.last_seen <= since if absent else 0.0 <= stamp - since < self.config.retry_after
        if not rests:
            del self._in_vain[item.id]
        return rests

    def _serve_trigger(
        self, looks: Looks, ways: Ways, view: View | None, base_available: bool
    ) -> VerificationTask | None:
        """The first trigger that can be served; those for unknown or lost objects are dropped."""
        pending = self._pending
        if pending is not None and pending.trigger:
            index = looks.index(pending.object_id)
            if index is None:
                return None
            if pending.covers(looks.positions[index]):
                return pending
            self._queue.appendleft(Trigger(pending.object_id, pending.trigger))
            self._pending = None
        for trigger in list(self._queue):
            index = looks.index(trigger.object_id)
            if index is None:
                self._queue.remove(trigger)
                continue
            found = options(self.config, looks, ways, [index], view, base_available, self._misses)
            if not found:
                continue
            self._queue.remove(trigger)
            reason = f"{trigger.requester} asked for it."
            self._pending = replace(self._task(looks, found[0], reason), trigger=trigger.requester)
            return self._pending
        return None

    def _keep_pending(
        self, looks: Looks, pose: FloatArray, base_available: bool, view: View | None
    ) -> VerificationTask | None:
        """The pending task while it is worth it: not once its object was seen, moved, is gone or is out of bounds."""
        task = self._pending
        if task is None:
            return None
        index = looks.index(task.object_id)
        if index is None or not task.covers(looks.positions[index]):
            return None
        if not base_available and not looks.in_view(index, pose, view):
            return None
        sensor = looks.sensor_index(task.sensor)
        if sensor is None:
            return None
        now = single_gains(
            np.zeros(1), looks.P[[index]], looks.Q[[index]], looks.R[sensor][[index]], 1.0, 1.0
        )[0]
        return task if now > self._second_look(looks) else None

    def _most_useful(
        self, state: WorldState, looks: Looks, ways: Ways, view: View | None, base_available: bool
    ) -> VerificationTask | None:
        able = [k for k, item in enumerate(looks.objects) if not self._rests(item, state.stamp)]
        if not base_available:
            self._tour = set()
        going = self._next_on_tour(looks, ways, able, view)
        if going is not None:
            return going
        found = options(self.config, looks, ways, able, view, base_available, self._misses)
        if not found:
            self.idle_reason = "No object can be reached and seen."
            return None
        thresholds = self._thresholds(looks)
        best = next((option for option in found if option.gain > thresholds[option.item]), None)
        if best is None:
            most = max(option.gain for option in found)
            self.idle_reason = f"No action is worth it: {most:.1f} nat at most, below the threshold."
            return None
        self.idle_reason = ""
        if base_available and self.config.tour > 0.0:
            now, stops = looked_at_now(looks), self._worth_a_stop(looks, self.config.tour)
            along = [k for k in able if stops[k]]
            far = np.hypot(*(looks.positions[:, :2] - ways.pose[:2]).T) / self.config.cost_scale
            worth_along = now / self.config.information_gain_norm - self.config.weight * far
            along = sorted(along, key=lambda k: -worth_along[k])[:TOUR]
            if len(along) > 1:
                self._tour = {looks.objects[k].id for k in (*along, best.item)}
                going = self._next_on_tour(looks, ways, able, view)
                if going is not None:
                    return going
        others = f", the rest from {best.seen - 1} more on the way" if best.seen > 1 else ""
        reason = (
            f"Driving {best.length:.1f} m should gain {best.gain:.1f} nat: "
            f"{best.own:.1f} nat from {looks.objects[best.item].id}{others}."
        )
        return self._task(looks, best, reason)

    def _next_on_tour(
        self, looks: Looks, ways: Ways, able: Sequence[int], view: View | None
    ) -> VerificationTask | None:
        """The first look on the shortest way through what is left of the tour; drops what has been seen meanwhile."""
        if not self._tour:
            return None
        # What brings less by now was seen in passing.
        stops = self._worth_a_stop(looks, 0.5 * self.config.tour)
        left = [k for k in able if looks.objects[k].id in self._tour and stops[k]]
        self._tour = {looks.objects[k].id for k in left}
        for k in tour(looks, ways.pose, left):
            self._tour.discard(looks.objects[k].id)
            found = options(self.config, looks, ways, [k], view, True, self._misses)
            if not found:
                continue
            reason = (
                f"Driving {found[0].length:.1f} m should gain {found[0].own:.1f} nat from "
                f"{looks.objects[k].id}. {len(self._tour)} more follow on this tour."
            )
            self.idle_reason = ""
            return self._task(looks, found[0], reason)
        return None

    def _thresholds(self, looks: Looks) -> FloatArray:
        """(N,) nat, by class where stated."""
        own, default = self.config.class_thresholds, self.config.information_gain_threshold
        if not own:
            return np.full(len(looks.objects), default)
        return np.array([own.get(item.most_probable("class"), default) for item in looks.objects])

    def _worth_a_stop(self, looks: Looks, share: float) -> npt.NDArray[np.bool_]:
        """(N,) whether one look brings more than a share of the threshold, and than a second look in a row would."""
        return looked_at_now(looks) > np.maximum(share * self._thresholds(looks), self._second_look(looks))

    @staticmethod
    def _second_look(looks: Looks) -> float:
        """Two looks in a row bring at most the logarithm of two per axis; half of it each."""
        return 0.5 * looks.dimensions * math.log(2.0)

    def _task(self, looks: Looks, found: Option, reason: str) -> VerificationTask:
        item = looks.objects[found.item]
        sigma = np.sqrt(np.maximum(np.diag(as_finite("covariance", item.covariance)), 0.0))
        size = np.zeros(3)
        size[: len(sigma)] = 2.0 * INTERVAL * sigma
        return VerificationTask(
            item.id, found.goal, (looks.positions[found.item].copy(), size), looks.sensors[found.sensor].name,
            found.gain, found.utility, reason, distance=found.length, class_name=item.most_probable("class"),
            attributes=item.attributes, quantities=item.quantities,
        )  # fmt: skip


def _triggers(given: Sequence[Trigger | str]) -> list[Trigger]:
    """What is asked for; InputError where it is neither ids nor triggers."""
    if isinstance(given, str) or not isinstance(given, Iterable):  # one id would be taken letter by letter
        raise InputError(f"triggers: a list of object ids or triggers expected, got {given!r}")
    triggers = [Trigger(wanted) if isinstance(wanted, str) else wanted for wanted in given]
    for wanted in triggers:
        require_kind("triggers", wanted, Trigger)
    return triggers


@cache
def warm_up() -> None:
    """Compile what maintenance runs, once per process: a throw-away one plans without a map and around one."""
    objects = tuple(
        WorldObject(str(k), np.array([1.0 + k, 1.0, 0.0]), np.zeros(3), np.eye(3), {}, 1.0, False, 0.0)
        for k in range(3)
    )
    grid = OccupancyGrid.from_values(np.zeros((50, 50), dtype=np.int64), 0.1)
    for floor in (None, grid):
        maintenance = Maintenance(MaintenanceConfig(information_gain_threshold=0.0))
        pose, sensor = np.array([0.5, 1.0, 0.0]), Sensor("any", 0.1, 0.5, 0.01 * np.eye(3))
        maintenance.next_task(WorldState(objects, 1.0, 3.0, 0.0), pose, [sensor], grid=floor)
