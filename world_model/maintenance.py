"""When to look at which object again: uncertainty-driven, semi-task-dependent maintenance (chapter 3).

The robot imagines driving to each object with each sensor, propagates and updates covariances on the way as it would
(3.6), and takes the action of the largest expected utility (3.9), (3.10). What an action is worth has two sides, which
the text adds up in one sum. Whether to go at all is decided by the gain over all objects seen on the way, as in the
text. Where to go is decided by the gain of the object one goes for, and what is seen in passing counts a tenth
(`company`): the plain sum prefers busy corners, and the lonely object grows ever more uncertain.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_finite, as_vectors
from estimation.errors import InputError
from estimation.grid import OccupancyGrid
from world_model.looks import Looks, Sensor, looks_at
from world_model.maintenance_kernels import path_gain, single_gains
from world_model.state import WorldObject, WorldState
from world_model.ways import Way, Ways

OUTCOMES = ("found", "occluded", "not_found")
INTERVAL = 1.96  # standard deviations to either side that hold 95 %
# Table 3.1: before grabbing or going to an object its position is refined; going to a place or letting go needs none.
VERIFIED_ACTIONS = ("grab", "navigate_to_object")
NEARER = 0.6  # of the stand-off after each look that was in vain
EXACT = 64  # actions that are looked ahead for; of more, those that promise most
View = float | Mapping[str, Any] | Callable[[FloatArray], bool]


def _setting(default: float, unit: str, text: str, low: float, high: float) -> float:
    metadata = {"unit": unit, "description": text, "low": low, "high": high}
    value: float = field(default=default, metadata=metadata)
    return value


@dataclass(frozen=True)
class MaintenanceConfig:
    """Settings of `Maintenance`; each field's metadata has its unit, meaning and allowed range.

    class_thresholds, class_weights : {class: value} that replace the threshold and multiply the gain.
    verified_actions : names of actions before which their object is looked at (Table 3.1).
    """

    information_gain_threshold: float = _setting(
        8.0, "nat", "an action whose expected gain is below is not taken", 0.0, 1e6
    )
    weight: float = _setting(0.75, "", "of the cost against the gain (ω)", 0.0, 1e6)
    information_gain_norm: float = _setting(5.0, "nat", "gain that is worth one (IG_norm)", 1e-6, 1e6)
    cost_scale: float = _setting(10.0, "m", "distance that costs one (C_scale), the room's length", 1e-3, 1e6)
    speed: float = _setting(0.5, "m/s", "of the robot", 1e-3, 100.0)
    time_step: float = _setting(0.5, "s", "between looks on the way", 1e-3, 3600.0)
    company: float = _setting(
        0.1, "", "share of the gain of objects seen on the way in an action's utility", 0.0, 1.0
    )
    anticipation: float = _setting(
        0.92, "", "share of entropy's growth until a look that counts as gained by it", 0.0, 1.0
    )
    standoff: float = _setting(0.9, "", "share of a sensor's range to stop at", 0.05, 1.0)
    retry_after: float = _setting(5.0, "s", "rest of an object that was occluded", 0.0, 1e6)
    process_noise: float = _setting(
        1e-4, "m²/s", "growth of the variance of objects that state none", 0.0, 1e3
    )
    verified_actions: tuple[str, ...] = VERIFIED_ACTIONS
    class_thresholds: Mapping[str, float] = field(default_factory=dict)
    class_weights: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        for name, described in self.__dataclass_fields__.items():
            low, high = described.metadata.get("low"), described.metadata.get("high")
            if low is None or high is None:
                continue
            value = getattr(self, name)
            if not (isinstance(value, (int, float)) and low <= value <= high):
                raise InputError(f"{name}: {low:g} to {high:g} expected, got {value!r}")
        for name in ("class_thresholds", "class_weights"):
            for label, value in getattr(self, name).items():
                if not (math.isfinite(value) and value >= 0.0):
                    raise InputError(f"{name}[{label!r}]: a number of at least 0 expected, got {value!r}")


@dataclass(frozen=True)
class VerificationTask:
    """Look at one object again.

    object_id : of the object. goal : (3,) x, y, yaw to stand and look from, world frame. region : centre (3,) and
    size (3,) of the box that holds it with 95 % along each axis, m. sensor : name. gain : nat, expected over all
    objects seen on the way (3.6). utility : (3.9). reason : one sentence. trigger : who asked, "" where it pays by
    itself. distance : m to drive. class_name, attributes : what is known about it, for whoever looks.
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


@dataclass(frozen=True)
class Trigger:
    """A component asks for a look: Table 3.1. requester : who, for the reason in the task."""

    object_id: str
    requester: str = "a task"


@dataclass(frozen=True)
class _Candidate:
    """One action: an object (index), a sensor (index), the way there and what it is expected to bring."""

    item: int
    sensor: int
    way: Way
    gain_own: float
    gain: float
    seen: int
    utility: float


class Maintenance:
    """Chooses what to verify next; at most one uncertainty-driven task is pending at a time.

    Raises
    ------
    InputError : wrong settings.
    """

    def __init__(self, config: MaintenanceConfig | None = None) -> None:
        self.config = config or MaintenanceConfig()
        self._pending: VerificationTask | None = None
        self._queue: deque[Trigger] = deque()
        self._resting: dict[str, float] = {}
        self._absent: dict[str, float] = {}
        self._misses: dict[str, int] = {}
        self.idle_reason = ""

    @property
    def pending(self) -> VerificationTask | None:
        """The task handed out last that nobody has reported on."""
        return self._pending

    @property
    def queue(self) -> tuple[Trigger, ...]:
        """Triggers still to be served, in order."""
        return tuple(self._queue)

    def trigger(self, object_id: str, requester: str = "a task") -> bool:
        """Queue a look at an object, first come first served; False where one is pending or queued already."""
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

        Parameters
        ----------
        world_state : its objects; lost ones are left to the search. robot_pose : (3,) x, y, yaw, world frame.
        sensors : at least one. field_of_view : full opening angle, rad, of every sensor; or {"angle": rad, "range":
        m}; or a function that says whether a position (3,) is in view. None is all around.
        triggers : object ids, or `Trigger`s, to be looked at first, in this order. A trigger for the object that is
        pending anyway is merged with it. base_available : False where another component moves the base: only what
        is in view may be looked at. grid : ways and goals avoid what it has occupied.

        Raises
        ------
        InputError : no sensors, a pose that is not finite, a sensor's covariance that fits no object.
        """
        pose = as_vectors("robot_pose", robot_pose, 3)
        if pose.shape != (3,):
            raise InputError(f"robot_pose must have shape (3,), not {pose.shape}")
        if not sensors:
            raise InputError("sensors: at least one is needed to look at anything")
        for wanted in triggers:
            asked = Trigger(wanted) if isinstance(wanted, str) else wanted
            self.trigger(asked.object_id, asked.requester)
        looks = looks_at(world_state.objects, sensors, self.config.process_noise)
        if not looks.objects:
            self._pending = None
            self.idle_reason = self._nothing_known(world_state)
            return None
        ways = Ways(pose, grid)
        served = self._serve_trigger(world_state, looks, ways, field_of_view, base_available)
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

        Raises
        ------
        InputError : another outcome.
        """
        if outcome not in OUTCOMES:
            raise InputError(f"outcome: one of {', '.join(OUTCOMES)} expected, got {outcome!r}")
        if self._pending is not None and self._pending.object_id == task.object_id:
            self._pending = None
        when = math.nan if stamp is None else float(stamp)
        self._resting.pop(task.object_id, None)
        self._absent.pop(task.object_id, None)
        if outcome == "found":
            self._misses.pop(task.object_id, None)
        else:
            self._misses[task.object_id] = self._misses.get(task.object_id, 0) + 1
        if outcome == "occluded":
            self._resting[task.object_id] = when
        elif outcome == "not_found":
            self._absent[task.object_id] = when

    def _nothing_known(self, state: WorldState) -> str:
        if not state.objects:
            return "the world model is empty"
        if all(item.lost for item in state.objects):
            return "all objects are lost: looking for them is up to the search"
        return "no object has a usable position"

    def _rests(self, item: WorldObject, stamp: float) -> bool:
        """Whether a report keeps an object from being looked at; forgets reports that are over."""
        if item.id in self._absent:
            since = self._absent[item.id]
            if math.isnan(since):
                self._absent[item.id] = item.last_seen
                return True
            if item.last_seen <= since:
                return True
            del self._absent[item.id]
        if item.id in self._resting:
            since = self._resting[item.id]
            if math.isnan(since):
                self._resting[item.id] = stamp
                return True
            if 0.0 <= stamp - since < self.config.retry_after:
                return True
            del self._resting[item.id]
        return False

    def _serve_trigger(
        self, state: WorldState, looks: Looks, ways: Ways, view: View | None, base_available: bool
    ) -> VerificationTask | None:
        """The first trigger that can be served; those for unknown or lost objects are dropped."""
        if self._pending is not None and self._pending.trigger:
            return self._pending if looks.index(self._pending.object_id) is not None else None
        for trigger in list(self._queue):
            index = looks.index(trigger.object_id)
            if index is None:
                self._queue.remove(trigger)
                continue
            options = self._options(looks, ways, [index], view, base_available)
            if not options:
                continue
            self._queue.remove(trigger)
            best = max(options, key=lambda option: option.utility)
            reason = f"{trigger.requester} asked for it"
            self._pending = replace(self._task(looks, best, reason), trigger=trigger.requester)
            return self._pending
        return None

    def _keep_pending(
        self, looks: Looks, pose: FloatArray, base_available: bool, view: View | None
    ) -> VerificationTask | None:
        """The pending task while it is worth it: not once its object has been seen, is gone or is out of bounds."""
        task = self._pending
        if task is None:
            return None
        index = looks.index(task.object_id)
        if index is None or (not base_available and not looks.in_view(index, pose, view)):
            return None
        sensor = looks.sensor_index(task.sensor)
        if sensor is None:
            return None
        now = single_gains(
            np.zeros(1), looks.P[[index]], looks.Q[[index]], looks.R[sensor][[index]], 1.0, 1.0
        )[0]
        # Two looks in a row bring at most the logarithm of two per axis.
        return task if now > 0.5 * looks.dimensions * math.log(2.0) + 0.1 else None

    def _most_useful(
        self, state: WorldState, looks: Looks, ways: Ways, view: View | None, base_available: bool
    ) -> VerificationTask | None:
        able = list(range(len(looks.objects)))
        if self._absent or self._resting:
            able = [k for k in able if not self._rests(looks.objects[k], state.stamp)]
        options = self._options(looks, ways, able, view, base_available)
        worth = [option for option in options if option.gain > self._threshold(looks.objects[option.item])]
        if not worth:
            most = max((option.gain for option in options), default=0.0)
            self.idle_reason = (
                f"the largest expected gain, {most:.1f} nat, is below the threshold"
                if options
                else "no object can be reached and seen"
            )
            return None
        self.idle_reason = ""
        best = max(worth, key=lambda option: option.utility)
        others = f" and {best.seen - 1} on the way" if best.seen > 1 else ""
        reason = (
            f"{best.gain:.1f} nat expected for {best.way.length:.1f} m: "
            f"{best.gain_own:.1f} from {looks.objects[best.item].id}{others}"
        )
        return self._task(looks, best, reason)

    def _threshold(self, item: WorldObject) -> float:
        return self.config.class_thresholds.get(
            item.most_probable("class"), self.config.information_gain_threshold
        )

    def _options(
        self, looks: Looks, ways: Ways, able: Sequence[int], view: View | None, base_available: bool
    ) -> list[_Candidate]:
        """Actions with what they are expected to bring; of very many only those that promise most."""
        config, pose = self.config, ways.pose
        pairs = [(k, s) for k in able for s in range(len(looks.sensors))]
        if not base_available:
            pairs = [(k, s) for k, s in pairs if looks.reaches(k, s, pose) and looks.in_view(k, pose, view)]
        if len(pairs) > EXACT:
            pairs = self._promising(looks, ways, pairs)
        found = []
        opening = looks.opening(view)
        for k, s in pairs:
            low, high = looks.sensors[s].range_min, looks.sensors[s].range_max
            # From where it could not be seen, it is looked at from nearer and another side the next time.
            misses = self._misses.get(looks.objects[k].id, 0)
            share = NEARER**misses * config.standoff
            spot = looks.positions[k, :2]
            way = ways.to_see(spot, low, high, share, misses > 0) if base_available else ways.stay()
            if way is None:
                continue
            points = way.sampled(config.speed * config.time_step)
            own, gain, seen = path_gain(
                k, points, looks.positions, looks.P, looks.Q, looks.R[s], low, high, opening,
                config.time_step, config.anticipation,
            )  # fmt: skip
            if own <= 0.0:
                continue
            cost = (way.length + looks.sensors[s].cost) / config.cost_scale
            worth = own * config.class_weights.get(looks.objects[k].most_probable("class"), 1.0)
            utility = (
                -config.weight * cost + (worth + config.company * (gain - own)) / config.information_gain_norm
            )
            found.append(_Candidate(k, s, way, own, gain, seen, utility))
        return found

    def _promising(self, looks: Looks, ways: Ways, pairs: list[tuple[int, int]]) -> list[tuple[int, int]]:
        """The `EXACT` pairs of largest utility by a single look after a straight drive."""
        config = self.config
        away = np.hypot(*(looks.positions[:, :2] - ways.pose[:2]).T)
        utility = np.empty((len(looks.objects), len(looks.sensors)))
        for s, sensor in enumerate(looks.sensors):
            drive = np.maximum(away - config.standoff * sensor.range_max, 0.0)
            own = single_gains(drive, looks.P, looks.Q, looks.R[s], config.speed, config.anticipation)
            cost = (drive + sensor.cost) / config.cost_scale
            utility[:, s] = own / config.information_gain_norm - config.weight * cost
        index = np.array(pairs)
        best = np.argsort(-utility[index[:, 0], index[:, 1]], kind="stable")[:EXACT]
        return [pairs[i] for i in best]

    def _task(self, looks: Looks, option: _Candidate, reason: str) -> VerificationTask:
        item = looks.objects[option.item]
        sigma = np.sqrt(np.maximum(np.diag(as_finite("covariance", item.covariance)), 0.0))
        size = np.zeros(3)
        size[: len(sigma)] = 2.0 * INTERVAL * sigma
        return VerificationTask(
            item.id, option.way.goal, (looks.positions[option.item].copy(), size),
            looks.sensors[option.sensor].name, option.gain, option.utility, reason,
            distance=option.way.length, class_name=item.most_probable("class"), attributes=item.attributes,
        )  # fmt: skip
