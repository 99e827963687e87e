"""Node `object_search`: finds an object by driving to where it can be seen."""

from __future__ import annotations

import math
import time
from collections.abc import Iterable
from typing import Any

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid as GridMessage
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from whereabouts.nodes.messages.markers import colour, marker, point
from whereabouts.nodes.messages.packed import Packed
from whereabouts.nodes.messages.stamps import NANOSECONDS, seconds, time_message
from whereabouts.nodes.messages.transforms import check_frame, frame_name
from whereabouts.nodes.messages.world_messages import object_message
from whereabouts.nodes.messages.world_reading import LatestState, grid_from_message, planar_pose, pose_stamped
from whereabouts.nodes.navigation.errands import BaseClaim, is_errand
from whereabouts.nodes.navigation.goals import PATIENCE, SAME, Approach, Navigator
from whereabouts.nodes.ros.base import SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.nodes.ros.qos import HEARD_LATCHED, LATCHED
from whereabouts.parameters.object_search import BELIEVED, ObjectSearchParameters
from whereabouts_msgs.action import FindObject
from whereabouts_msgs.msg import WorldState as StateMessage
from world_model import ObjectSearch, Relations, SearchStep, WorldObject, WorldState
from world_model.describing import named
from world_model.state import MOVED_ON

LEARN_PERIOD = NANOSECONDS  # what is first seen within a second was there at the same time
LOOK = 0.5  # s, by the stamps of the world, that a robot looks around at a goal before it is a dead end


class SeenTogether:
    """What has just been seen near each other counts as a frame of the relations, once for each object."""

    def __init__(self, relations: Relations) -> None:
        self._relations = relations
        self._seen_at: dict[str, float] = {}

    def learn(self, state: WorldState, distance: float) -> None:
        """Take in a world; distance : m up to which objects are near each other."""
        fresh = [item for item in state.objects if item.last_seen > self._seen_at.get(item.id, -math.inf)]
        for item in fresh:
            if item.id in self._seen_at:
                continue
            near = [
                other.most_probable("class")
                for other in fresh
                if np.hypot(*(other.position - item.position)[:2]) <= distance
            ]
            if len(near) > 1:
                self._relations.observe([name for name in near if name])
        self._seen_at |= {item.id: item.last_seen for item in fresh}


class ObjectSearchNode(SuiteNode):
    """One search at a time; a new goal replaces the one before, and an errand waits for people."""

    parameters_model = ObjectSearchParameters
    node_name = "object_search"
    settings: ObjectSearchParameters

    def setup(self) -> None:
        settings = self.settings
        self._map_frame, self._base = frame_name(settings.map_frame), frame_name(settings.base_frame)
        self._relations = settings.relations
        places = settings.places
        if places is not None:
            check_frame("places_file", places.frame, self._map_frame)
        self._search = ObjectSearch(self._relations, settings.search, places)
        self._serial = 0
        self.listen_to_transforms(on_demand=True)
        self.add_latched_input(GridMessage, "map", self._take_map)
        states = self.add_input(StateMessage, "world_state", self._take_state, packed=True, qos=HEARD_LATCHED)
        self._latest = LatestState(states.refuse, self._map_frame)
        self._goal_output = self.add_output(PoseStamped, "search_goal", LATCHED)
        self._base_claim = BaseClaim(self)
        self._markers_output = self.add_output(MarkerArray, "search_markers")
        self._navigator = Navigator(self, settings.navigate)
        self.created.callback(self._navigator.close)
        self.add_action(FindObject, "find_object", self._find)

    def start_run(self) -> None:
        self._latest.forget()
        self._learnt_at: int | None = None
        self._together = SeenTogether(self._relations)
        self._searching = ""
        self._reason = ""
        self._approach = Approach()
        self._arrived: tuple[float, float] | None = None
        self._out_of_reach: Array | None = None  # (2,) of a goal that nav2 cannot reach
        self._for_person = False
        self._found = self._failed = 0
        self._steps = 0

    def health(self) -> Health:
        figures: dict[str, object] = {"found": self._found, "not found": self._failed, "goals": self._steps}
        figures["known names"] = len(self._relations.names)
        figures |= self._navigator.figures
        if self._searching:
            return Health(f"looking for {self._searching}: {self._reason}", figures=figures)
        return Health("idle", figures=figures)

    def _take_state(self, message: Packed, stamp: int) -> None:
        self._latest.take(message)
        if self.settings.learn and (self._learnt_at is None or stamp - self._learnt_at >= LEARN_PERIOD):
            self._learnt_at = stamp
            state = self._latest.state
            if state is not None:
                self._together.learn(state, self.settings.together_distance)

    def _take_map(self, message: GridMessage, stamp: int) -> None:
        self._search.grid = grid_from_message(message, self._map_frame)

    # The action.

    async def _find(self, handle: Any) -> Any:
        request = handle.request
        wanted = request.class_name or self._class_of(request.object_id)
        result = FindObject.Result()
        if not wanted:
            raise InputError("class_name and object_id are both empty: name what to look for")
        errand = is_errand(self, handle)
        if errand and (first := self._goes_first()):
            handle.abort()
            result.code, result.message = result.CANCELED, first
            return result
        self._serial += 1
        serial = self._serial
        self._for_person = not errand
        self._search.reset()
        self._approach.forget()
        self._arrived = self._out_of_reach = None
        self._searching, self._reason = wanted, "starting"
        self._base_claim.take()
        try:
            await self._drive(handle, request, wanted, serial, result)
        finally:
            if serial == self._serial:
                self._searching = ""
                self._navigator.stop()
                self._base_claim.give_back()
        self._found += result.code == result.FOUND
        self._failed += result.code in (result.NOT_FOUND, result.GAVE_UP)
        return result

    def _class_of(self, object_id: str) -> str:
        """What an object is; of one that nobody knows, what its id says."""
        state = self._latest.state
        known = None if state is None else state.find(object_id)
        said = object_id.rpartition("-")[0] or object_id
        return said if known is None else known.most_probable("class") or said

    def _goes_first(self) -> str:
        """Who has the base, where that is more urgent than a search for what is lost; else ""."""
        if self._searching and self._for_person:
            return f"waits for the search for {self._searching}"
        return "waits for whoever else has the base" if self._base_claim.taken_by_others else ""

    async def _drive(self, handle: Any, request: Any, wanted: str, serial: int, result: Any) -> None:
        """Goals until the object is believed in, nothing is left to try, or somebody has had enough."""
        limit = seconds(request.timeout)
        begun, epoch = self.now, self.epoch
        place: Array | None = None
        said: tuple[Any, ...] = ()
        step: SearchStep | None = None
        while True:
            first = "" if self._for_person else self._goes_first()
            first = first if epoch == self.epoch else "a new run began"
            if handle.is_cancel_requested or serial != self._serial or first:
                cancelled = handle.is_cancel_requested
                handle.canceled() if cancelled else handle.abort()
                result.code = result.CANCELED
                result.message = "cancelled" if cancelled else first or "another search was started"
                return
            pose = self._pose()
            state = self._latest.state
            self._navigator.serve()
            if pose is not None and state is not None:
                if place is not None:
                    result.distance += float(np.hypot(*(pose[:2] - place[:2])))
                place = pose
                asked = [item for item in state.objects if self._is_asked(item, request, wanted)]
                found = next(filter(_is_believed, asked), None)
                if found is not None:
                    self._succeed(handle, found, result)
                    return
                self._search.expect(_expected(asked))
                step = self._next(step, state, pose, wanted)
                said = self._tell(handle, step, said)
                if step.goal is None:
                    handle.abort()
                    result.code, result.message = result.NOT_FOUND, step.reason
                    return
            elapsed = (self.now - begun) / NANOSECONDS
            tired = 0.0 < request.max_distance < result.distance
            if tired or 0.0 < limit < elapsed:
                handle.abort()
                result.code = result.GAVE_UP
                result.message = (
                    f"Gave up after {result.distance:.1f} m and {elapsed:.0f} s. Last reason: {self._reason}"
                )
                return
            if pose is None or state is None:
                self._reason = "no world_state has arrived"
                if pose is None:
                    self._reason = f"no transform from '{self._base}' to '{self._map_frame}'"
                self.complain(self._reason, key="pose")
            await self.pause(1.0 / self.settings.rate)

    def _next(self, step: SearchStep | None, state: WorldState, pose: Array, wanted: str) -> SearchStep:
        """The next step; what has been reached without seeing the target is a dead end, and what never is."""
        if step is not None and step.goal is not None and step.kind != "target":
            away = float(np.hypot(*(step.goal - pose[:2])))
            if away <= self.settings.arrival_distance:
                if self._looked_around(state):
                    self._search.reached(pose[:2])
                    self._arrived = None
            else:
                self._arrived = None
                if self._gone_wrong(step.goal):
                    why = self._navigator.reason
                    self.complain(f"a goal is out of reach: {why}. It was: {step.reason}", key="goal")
                    self._search.reached(step.goal)
                elif self._approach.stuck(step.goal, away, state.stamp):
                    self.complain(f"a goal was not reached. The next one: {step.reason}", key="goal")
                    self._search.reached(step.goal)
        return self._search.next_goal(self._observed(state, pose), wanted, pose)

    def _gone_wrong(self, goal: Array) -> bool:
        """Whether nav2 has given up a goal (2,); it is said once."""
        lost, self._out_of_reach = self._out_of_reach, None
        return lost is not None and float(np.hypot(*(lost - goal))) < 1e-6

    def _send(self, goal: PoseStamped, place: Array) -> None:
        """Have nav2 drive to a goal at `place` (2,), if it is to."""

        def failed() -> None:
            self._out_of_reach = place

        if not self._navigator.go(goal, failed):
            self.complain(self._navigator.reason, key="nav2")

    def _looked_around(self, state: WorldState) -> bool:
        """Whether the world model knows what there is to be seen from the goal; it may be behind the robot.

        Where no world state comes any more, PATIENCE has to do.
        """
        now = self.now / NANOSECONDS
        if self._arrived is None:
            newest = self.transforms.newest(self._map_frame, self._base) or 0
            self._arrived = (max(newest / NANOSECONDS, state.stamp), now)
        stamp, since = self._arrived
        return state.stamp >= stamp + LOOK or now - since > PATIENCE

    def _observed(self, state: WorldState, pose: Array) -> dict[str, Array]:
        """Positions by name of what is believed in; of several of a class the nearest one that has not been tried."""

        def rank(item: WorldObject) -> tuple[bool, float]:
            away = float(np.hypot(*(item.position[:2] - pose[:2])))
            return self._search.tried(item.most_probable("class"), item.position), away

        unified = self._relations.unified
        known: dict[str, list[WorldObject]] = {}
        for item in filter(_is_believed, state.objects):
            name = item.most_probable("class")
            if name and unified(name) != unified(self._searching):
                known.setdefault(name, []).append(item)
        return {name: min(items, key=rank).position for name, items in known.items()}

    def _is_asked(self, item: WorldObject, request: Any, wanted: str) -> bool:
        if request.object_id and item.id != request.object_id:
            return False
        kind = self._relations.unified(item.most_probable("class"))
        if not request.object_id and kind != self._relations.unified(wanted):
            return False
        return set(request.predicates) <= set(item.predicates)

    def _succeed(self, handle: Any, found: WorldObject, result: Any) -> None:
        handle.succeed()
        result.code = result.FOUND
        result.message = f"{named(found)} is at ({found.position[0]:.2f}, {found.position[1]:.2f})"
        result.object = [object_message(found, np.eye(4))]
        result.pose = pose_stamped(self._header(), np.array([*found.position[:2], 0.0]))

    def _tell(self, handle: Any, step: SearchStep, said: tuple[Any, ...]) -> tuple[Any, ...]:
        self._reason = step.reason
        # The same words may be about another place.
        spot = () if step.goal is None else tuple(np.round(step.goal / SAME).tolist())
        now = (step.kind, step.object, step.reason, spot)
        if now == said:
            return said
        self._steps += 1
        feedback = FindObject.Feedback(
            kind=step.kind,
            object_id=step.object,
            reason=step.reason,
            probability=min(max(step.probability, 0.0), 1.0),
        )
        if step.goal is not None:
            pose = self._pose()
            heading = 0.0 if pose is None else math.atan2(*(step.goal - pose[:2])[::-1])
            feedback.goal = pose_stamped(self._header(), np.array([*step.goal, heading]))
            self._goal_output.publish(feedback.goal)
            self._send(feedback.goal, step.goal)
            if self._markers_output.wanted:
                self._markers_output.publish(_markers(self._header(), step))
        handle.publish_feedback(feedback)
        return now

    def _pose(self) -> Array | None:
        return planar_pose(self.transforms, self._map_frame, self._base)

    def _header(self) -> Header:
        state = self._latest.state
        stamp = 0 if state is None else round(state.stamp * NANOSECONDS)
        return Header(stamp=time_message(stamp or time.time_ns()), frame_id=self._map_frame)


def _is_believed(item: WorldObject) -> bool:
    """Whether the world model believes in an object, and knows where it is."""
    return item.existence >= BELIEVED and not item.lost and MOVED_ON not in item.predicates


def _expected(asked: Iterable[WorldObject]) -> dict[str, float]:
    """Where objects probably are by now that are lost, or have probably moved on since they were seen."""
    places: dict[str, float] = {}
    for item in asked:
        if item.place and (item.lost or MOVED_ON in item.predicates):
            places[item.place] = max(places.get(item.place, 0.0), item.existence * item.place_probability)
    return places


def _markers(header: Header, step: SearchStep) -> MarkerArray:
    """Why the robot goes where it goes, written over the goal."""
    assert step.goal is not None
    words = marker(header, "search", Marker.TEXT_VIEW_FACING, colour((1.0, 0.0, 0.0)), 0.3)
    words.text, words.pose.position = step.reason, point(step.goal, 1.0)
    return MarkerArray(markers=[words])


def main() -> None:
    exit_with(ObjectSearchNode)


if __name__ == "__main__":
    main()
