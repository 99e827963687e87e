"""Looking for an object by what is usually found with it (chapter 5).

Two rules choose among the objects in view. "chain" is the text's: expected utility (5.3) over the target and, one
after the other, intermediate targets (steps 1 to 4 of section 5.3). "belief", the default, differs in three ways that
shorten the path: an object is worth visiting by how exclusively it goes with the target, sqrt(p'(o|T) p(T|o)) with p'
what exceeds p(o)², or through one intermediate object; worth is weighed against the drive by division, and near a dead
end it is discounted, for the target would have been seen; and where nothing in view has much to do with the target,
the robot goes to the middle of the room, where most can be seen, and on to where it has not been, instead of trying
whatever is near. A room is worth how probable it is times how much of its floor nobody has looked at.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import NoneType

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_own, require_kind, require_within, require_word
from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.places import Place, Places
from estimation.settings import check_settings, setting
from world_model.tasks.coverage import Coverage, middle_of, where_more_is_seen
from world_model.tasks.relations import IntArray, Relations
from world_model.tasks.ways import Entrances

METHODS = ("belief", "chain")
LINKS = 40  # names that a chain may lead through
# Least share of p(o | T) that counts, whatever is in view everywhere: without it paths double where relations were
# learned by a camera that sees far (`experiment search`).
FLOOR = 0.1
RELEVANT = 0.3  # share of the best relation to the target below which objects are ignored
CHAINED = 0.7  # weight of a relation through a third object
# m around a dead end, and around an object on floor that was looked at, in which no target is expected.
AROUND = 1.5
SAME_OBJECT = 1.0  # metres that one object may seem to move between two looks
LIKELY = 0.2  # probability of a place from which on the search goes there first
LEAST = 0.1  # share of a room's floor that may stay unseen: corners, and what stands in front of them


@dataclass(frozen=True)
class SearchConfig:
    """Settings of `ObjectSearch`; each field's metadata has its unit, meaning and allowed range."""

    method: str = setting("belief", "", "how the next goal is chosen", choices=METHODS)
    weight: float = setting(0.1, "", "weight of the travel cost in the chain rule (ω)", 0.0, 100.0)
    threshold: float = setting(
        0.25, "", "the chain rule drives to an object with at least this utility", 0.0, 100.0
    )
    view: float = setting(2.0, "m", "distance from which the target can be recognised", 0.1, 50.0)

    def __post_init__(self) -> None:
        check_settings(self)


@dataclass(frozen=True)
class SearchStep:
    """Where to go next and why.

    kind : "target", "place" (where it probably is by now), "intermediate", "room", "random", or "none" where nothing is
    left to try. goal : (2,) m, None for "none". object : the name the step is about, "" where it is about none. reason
    : one sentence. probability : of finding the target by it, as far as the relations tell.
    """

    kind: str
    goal: FloatArray | None
    object: str
    reason: str
    probability: float = 0.0


class Worths:
    """How exclusively each known name goes with the target, directly or through one other; in [0, 1].

    Of p(o | T) only what exceeds p(o)² counts: that a sofa is in view where the target is says little where sofas are
    always in view, as they are for a camera that sees far.
    """

    def __init__(self, relations: Relations, target: str) -> None:
        self._relations, self._target = relations, target
        self._known: dict[str, dict[str, float]] = {}  # by type of room

    def of(self, name: str, room: Place | None) -> float:
        """Of a name in a room, or anywhere."""
        return self._in(room).get(self._relations.unified(name), 0.0)

    def most(self, room: Place | None) -> float:
        """Of the best name in a room, or anywhere."""
        return max(self._in(room).values(), default=0.0)

    def _in(self, room: Place | None) -> dict[str, float]:
        kind = "" if room is None else room.type
        if kind not in self._known:
            self._known[kind] = self._made(kind) if self._target in self._relations else {}
        return self._known[kind]

    def _made(self, room: str) -> dict[str, float]:
        relations, names = self._relations, self._relations.names
        every, at = np.arange(len(names)), names.index(self._target)
        everywhere = relations.ubiquity(room)[:, None] ** 2

        def both_ways(others: IntArray) -> tuple[FloatArray, FloatArray]:
            """(N, M) of what counts of p(name | other), and of sqrt(p(name | other) p(other | name))."""
            there, back = relations.block(every, others, room), relations.block(others, every, room).T
            telling = np.maximum((there - everywhere) / np.maximum(1.0 - everywhere, 1e-9), FLOOR * there)
            return np.sqrt(telling * back), np.sqrt(there * back)

        # What a chain leads through is not in view yet: it may be common where it is.
        through, onward = (each[:, 0] for each in both_ways(np.array([at])))
        through[at] = onward[at] = 0.0
        # Chains through a name that has little to do with the target are worth little themselves.
        over = np.argsort(-onward, kind="stable")[:LINKS]
        chained = both_ways(over)[0] * onward[None, over]
        chained[over, np.arange(len(over))] = 0.0
        chained[at] = 0.0
        worth = np.maximum(through, CHAINED * chained.max(axis=1, initial=0.0))
        return dict(zip(names, worth.tolist(), strict=True))


class Chain:
    """Intermediate targets of a search (section 5.3), the target itself first."""

    def __init__(self, relations: Relations, config: SearchConfig, target: str) -> None:
        self._relations, self._config, self._target = relations, config, target
        self._targets = [target]

    def best(
        self, able: Mapping[str, FloatArray], dead: Iterable[str], place: FloatArray
    ) -> tuple[str, float]:
        """Steps 1 to 3: the best of objects in view to go to, (5.3), (5.4), and its probability; dead : dead ends."""
        cost = {name: 1.0 / max(math.atan(math.dist(spot, place)), 1e-3) for name, spot in able.items()}
        while True:
            given = [self._given(goal, able) for goal in self._targets]
            chance = {name: max(one[name] for one in given) for name in able}
            best = max(able, key=lambda name: chance[name] + self._config.weight * cost[name])
            added = None
            if chance[best] + self._config.weight * cost[best] < self._config.threshold:
                added = self._intermediate(dead)
            if added is None:
                return best, chance[best]
            self._targets.append(added)

    def _given(self, goal: str, observed: Iterable[str]) -> dict[str, float]:
        """(5.2): p(o_j | o_T) over what is in view; an intermediate target that is in view itself is certain."""
        chance = self._relations.posterior(goal, list(observed))
        return {
            name: 1.0 if self._relations.unified(name) == goal else chance.get(name, 0.0) for name in observed
        }

    def _intermediate(self, dead: Iterable[str]) -> str | None:
        """The name with the strongest relation to any intermediate target that is neither one nor a dead end (o_s)."""
        taken = {*self._targets, *(self._relations.unified(name) for name in dead)}
        options = [name for name in self._relations.names if name not in taken]
        if not options or self._target not in self._relations:
            return None
        index = {name: k for k, name in enumerate(self._relations.names)}
        columns = np.array([index[goal] for goal in self._targets if goal in index], dtype=np.int64)
        strength = self._relations.block(np.arange(len(index)), columns).max(axis=1)
        return max(options, key=lambda name: strength[index[name]])


class ObjectSearch:
    """Chooses goals until somebody sees the target.

    relations : what goes with what. places : rooms with their types, to choose the room first. grid : free space, for
    the middle of the room and for coverage as the last resort.
    """

    chain_type: type[Chain] = Chain

    def __init__(
        self,
        relations: Relations,
        config: SearchConfig | None = None,
        places: Places | None = None,
        grid: OccupancyGrid | None = None,
    ) -> None:
        self.relations = relations
        self.config = config or SearchConfig()
        self.places = places
        require_kind("places", places, Places, NoneType)
        self._furniture = {place.name for place in (places.furniture if places else ())}
        self.grid = grid
        self.reset()

    def reset(self) -> None:
        """Forget dead ends, intermediate targets and what has been covered: a new search begins."""
        # By name, where objects were and where the robot looked from.
        self._dead: dict[str, list[tuple[FloatArray, FloatArray]]] = {}
        self._aim("")
        self._rooms_left: set[str] = set()
        self._room_ahead = ""
        self._driven_to: set[str] = set()
        self._entrances = Entrances(self.places or Places())
        self._middles: list[FloatArray] = []
        self._coverage: Coverage | None = None
        self._looks: list[FloatArray] = []  # where the robot looked from, and goals that it could not reach
        self._track: list[FloatArray] = []
        self._expected: dict[str, float] = {}
        self._looked: set[str] = set()
        self._step: SearchStep | None = None

    def tried(self, name: str, spot: npt.ArrayLike) -> bool:
        """Whether the object of this name at a place (2,) or (3,) is a dead end; one elsewhere is another."""
        place = as_own("spot", spot, (2,), (3,))[:2]
        return any(math.dist(place, spot) <= SAME_OBJECT for spot, _ in self._dead.get(name, ()))

    def reached(self, goal: npt.ArrayLike | None = None) -> None:
        """The robot is at the goal of the last step and the target was not seen: the object is a dead end.

        goal : (2,) where it stopped; that of the step by default.
        """
        step = self._step
        if step is None or step.goal is None:
            return
        where = step.goal if goal is None else as_own("goal", goal, (2,), (3,))[:2]
        if step.kind == "place":
            self._looked.add(step.object)
        elif step.kind == "room":
            self._middles.append(step.goal)
            self._driven_to |= {self._room_ahead} - {""}
        elif step.object:
            self._dead.setdefault(step.object, []).append((step.goal, np.array(where, dtype=np.float64)))
        self._look(np.array(where, dtype=np.float64))
        self._step = None

    def expect(self, places: Mapping[str, float]) -> None:
        """Where the target probably is by its routines: {place: probability}; the search begins there."""
        require_kind("places", places, Mapping)
        self._expected = {
            require_word("place", name): require_within(f"probability of {name!r}", p, 0.0, 1.0)
            for name, p in places.items()
        }

    def next_goal(
        self, observed: Mapping[str, npt.ArrayLike], target: str, robot_pose: npt.ArrayLike
    ) -> SearchStep:
        """What to do next.

        observed : {name: position (2,) or (3,) m} of all objects seen so far. target : name to look for; another one
        than before begins a new search. robot_pose : (3,) x, y, yaw.

        Raises InputError: a pose or a position that is not finite, an empty target.
        """
        place = as_own("robot_pose", robot_pose, (2,), (3,))[:2]
        require_kind("observed", observed, Mapping)
        known = {
            require_word("name in observed", name): as_own(f"position of {name!r}", spot, (2,), (3,))[:2]
            for name, spot in observed.items()
        }
        wanted = self.relations.unified(target)
        if not wanted:
            raise InputError("target: a name to look for is needed")
        if wanted != self._target:
            expected = self._expected
            self.reset()
            self._expected = expected
            self._begin(wanted)
        self._follow(place)
        if self._coverage is not None and self._coverage.grid is not self.grid:
            # The map has grown, or shows other walls.
            self._coverage = self._floor(known)
        self._room_ahead = ""
        self._step = self._choose(known, place)
        # What is kept to tell dead ends by is not the caller's to change.
        return replace(self._step, goal=None if self._step.goal is None else self._step.goal.copy())

    def _aim(self, target: str) -> None:
        self._target = target
        self._worths = Worths(self.relations, target)
        self._chain = self.chain_type(self.relations, self.config, target)

    def _begin(self, target: str) -> None:
        self._aim(target)
        if self.places is not None and len(self.places.rooms):
            self._rooms_left = {room.name for room in self.places.rooms}
            self._coverage = self._floor({})

    def _follow(self, place: FloatArray) -> None:
        if not self._track or math.dist(self._track[-1], place) > 0.2:
            self._track.append(place)
            self._look(place)

    def _look(self, place: FloatArray) -> None:
        self._looks.append(place)
        if self._coverage is not None:
            self._coverage.look(place)

    def _choose(self, known: dict[str, FloatArray], place: FloatArray) -> SearchStep:
        for name, spot in known.items():
            if self.relations.unified(name) == self._target:
                return SearchStep("target", spot, name, f"{name} is in view.", 1.0)
        likely = self._likely(place)
        if likely is not None:
            return likely
        room = self._room(place)
        if room is not None and not room.contains(place):
            said = f"The best room for {self._target} is {room.name}: drive there."
            self._room_ahead = room.name
            return SearchStep("room", self._entrances.seen_from(place, self.grid)[room.name][0], "", said)
        able = {
            name: spot
            for name, spot in known.items()
            if not self.tried(name, spot) and (room is None or bool(room.contains(spot)))
        }
        step = None
        if self.config.method != "chain":
            step = self._by_belief(able, known, place, room)
        elif able:
            best, chance = self._chain.best(able, self._dead, place)
            step = self._towards(best, able[best], chance)
        if step is None and room is not None:
            # The text's rule is done with a room once no object of it is left.
            step = self._rest_of(room, place) if self.config.method != "chain" else None
            if step is None:
                self._rooms_left.discard(room.name)
                return self._choose(known, place)
        return step or self._anywhere(known, place)

    def _rest_of(self, room: Place, place: FloatArray) -> SearchStep | None:
        """On to what of a room's floor nobody has looked at; None where it cannot be reached."""
        assert self._coverage is not None
        goal = self._coverage.next_place(place, room)
        if goal is None:
            return None
        said = self._said(
            f"Nothing in view is usually found with {self._target}", f"look at the rest of {room.name}."
        )
        return SearchStep("room", goal, "", said)

    def _likely(self, place: FloatArray) -> SearchStep | None:
        """The place where the target probably is by now, of those nobody has looked at yet: probable, and near."""
        left = self._furniture - self._looked
        able = {name: p for name, p in self._expected.items() if p >= LIKELY and name in left}
        if self.places is None or not able:
            return None
        centres = {name: np.asarray(self.places[name].center) for name in able}
        best = max(able, key=lambda name: able[name] / (math.dist(centres[name], place) + 3.0))
        said = (
            f"{self._target} is probably {self.places[best].spoken} by now, p = {able[best]:.2f}: look there."
        )
        return SearchStep("place", centres[best], best, said, able[best])

    def _room(self, place: FloatArray) -> Place | None:
        """The best room that is left: probable by its type, and near. A room that cannot be entered is none."""
        if self.places is None or not self._rooms_left:
            return None
        rooms = [room for room in self.places.rooms if room.name in self._rooms_left]
        here = {room.name for room in rooms if room.contains(place)}
        # A drive to it has ended, and the robot is not in it.
        self._rooms_left -= self._driven_to - here
        self._driven_to -= here
        share = self.relations.rooms(self._target, sorted({room.type for room in rooms}))
        ways = self._entrances.seen_from(place, self.grid)
        worth: dict[str, float] = {}
        for room in rooms:
            length = 0.0 if room.name in here else ways[room.name][1]
            if room.name in self._rooms_left and math.isfinite(length):
                worth[room.name] = share.get(room.type, 0.0) * self._unseen(room) / (length + 3.0)
        best = max(worth, key=lambda name: worth[name], default=None)
        return self.places[best] if best is not None and worth[best] > 0.0 else None

    def _unseen(self, room: Place) -> float:
        """Share of a room's floor that is worth looking at."""
        if self._coverage is None or self.config.method == "chain":
            return 1.0
        left = self._coverage.unseen(room)
        return left if left >= LEAST else 0.0

    def _by_belief(
        self,
        able: dict[str, FloatArray],
        known: dict[str, FloatArray],
        place: FloatArray,
        room: Place | None,
    ) -> SearchStep | None:
        worth = {
            name: self._worths.of(name, room) * self._freshness(spot, room) for name, spot in able.items()
        }
        most = self._worths.most(room)
        related = {name: value for name, value in worth.items() if value > 0.0 and value >= RELEVANT * most}
        if not related:
            why = f"Nothing in view is usually found with {self._target}"
            middle = self._middle(place, room)
            if middle is not None and math.dist(middle, place) <= 1.0:
                # It is there: going on must not lead back to it.
                self._middles.append(middle)
            elif middle is not None:
                return SearchStep("room", middle, "", self._said(why, "drive to where more can be seen."))
            if self.grid is None and not (self.places and self.places.rooms):  # nobody knows the floor
                spot = where_more_is_seen(list(known.values()), self._track, place, self._middles)
                if spot is not None:
                    return SearchStep("room", spot, "", self._said(why, "drive to unseen floor."))
            related = worth
        if not related:
            return None
        best = max(related, key=lambda name: (related[name] + 1e-9) / max(math.dist(able[name], place), 1e-3))
        return self._towards(best, able[best], related[best], room)

    def _said(self, why: str, then: str) -> str:
        """A sentence about a step that no object hints at; of a word that nobody knows nothing else is to be said."""
        unknown = self._target not in self.relations
        return f"{f'{self._target} is an unknown word' if unknown else why}: {then}"

    def _freshness(self, spot: FloatArray, room: Place | None) -> float:
        """Falls to zero where the target would have been seen: on floor that was looked at, or near dead ends."""
        if room is not None and self._coverage is not None:
            return self._coverage.unseen(room, spot, AROUND)
        stops = (stop for looks in self._dead.values() for _, stop in looks)
        return math.prod(1.0 - math.exp(-((math.dist(spot, stop) / AROUND) ** 2)) for stop in stops)

    def _middle(self, place: FloatArray, room: Place | None) -> FloatArray | None:
        """The middle of the room, or of what the map shows, once; None where nobody knows it."""
        middle = None
        if room is not None:
            middle = self._entrances.seen_from(place, self.grid)[room.name][0]
        elif self.grid is not None:
            middle = middle_of(self.grid)
        if middle is None or any(math.dist(middle, been) < 1.0 for been in self._middles):
            return None
        return middle

    def _towards(self, name: str, spot: FloatArray, chance: float, room: Place | None = None) -> SearchStep:
        said = f"{self._target} is not in view. It is often found with {name} (p = {chance:.2f}): look there."
        if self._worths.of(name, room) <= 0.0:
            said = f"{self._target} is not in view, and neither is anything it is usually found with: look at {name}."
        return SearchStep("intermediate", spot, name, said, chance)

    def _anywhere(self, known: Mapping[str, FloatArray], place: FloatArray) -> SearchStep:
        """The last resort: cover the floor."""
        if self._coverage is None:
            self._coverage = self._floor(known)
        goal = self._coverage.next_place(place)
        if goal is None:
            said = f"{self._target} was not found: the whole floor that can be reached has been seen."
            return SearchStep("none", None, "", said)
        why = f"No object hints at {self._target} any more"
        said = self._said(why, f"search the whole floor ({self._coverage.share:.0%} seen).")
        return SearchStep("random", goal, "", said)

    def _floor(self, known: Mapping[str, FloatArray]) -> Coverage:
        """What there is to look at, and what the robot has looked at so far."""
        every = np.array([*known.values(), *self._track])
        floor = Coverage(self.config.view, self.grid, self.places, every)
        for place in self._looks:
            floor.look(place)
        return floor
