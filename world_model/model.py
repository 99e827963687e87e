"""The world model: which objects exist and where they are, from detections (chapter 2 of the third text)."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import NoneType
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_stamp, as_vectors, require_kind, require_word
from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model.anchoring.anchoring import Anchoring
from world_model.calibration.corrections import FIRST_LOOKS, MOST_LOOKS
from world_model.config import WorldModelConfig
from world_model.evidence import WorldEvidence, checked, detections
from world_model.memory.household import SUFFIX, ByNow, Household
from world_model.memory.store import Store
from world_model.predictions import Behavior, checked_predictions
from world_model.queries import LAST_SEEN, QueryAnswer, Request, Words, World, ask, last_seen
from world_model.state import OUTCOMES, Box, WorldObject, WorldState
from world_model.warm_up import warm_up

# s that may have passed between two runs.
BETWEEN_RUNS = 60.0


def _moved(item: WorldObject, seconds: float) -> WorldObject:
    """The same at another time."""
    return replace(item, last_seen=seconds + item.last_seen, first_seen=seconds + item.first_seen)


class WorldModel:
    """Anchors, hypotheses and their probabilities.

    places : rooms and furniture, or None. store : memory, or the path of its file, or None; what it remembers is
    where the model starts from. looks_back : whether thousands of looks are kept for `look_back`. behaviors : how
    objects of a class go on, {class: behaviour}, see `world_model.predictions`.
    """

    def __init__(
        self,
        config: WorldModelConfig | None = None,
        places: Places | None = None,
        store: Store | str | Path | None = None,
        looks_back: bool = True,
        behaviors: Mapping[str, Behavior] | None = None,
    ) -> None:
        require_kind("config", config, WorldModelConfig, NoneType)
        require_kind("places", places, Places, NoneType)
        self.config = config or WorldModelConfig()
        self.places = places
        self.store = Store(store) if isinstance(store, (str, Path)) else store
        self.words = Words(places or Places())
        self.epoch = 0
        self.stamp = -np.inf
        self.begun = np.inf  # first stamp of this run
        self._earlier: tuple[Sequence[WorldObject], Mapping[str, int]] = ((), {})
        """What rested when a run ended, with stamps that count from then, and the highest numbers of symbols."""
        self.anchoring = Anchoring(self.config, MOST_LOOKS if looks_back else FIRST_LOOKS, behaviors)
        self._anchors = self.anchoring.anchors
        if self.store is not None and places:
            self.store.keep_places(places)
        beside = None if self.store is None or self.store.read_only else routines_path(self.store.path)
        self.household = Household(places or Places(), beside)
        self._by_now = ByNow(self.config, self._where, self.household)
        if places:
            self.anchoring.recall.usual = self.household
        warm_up()
        memory = None if self.store is None else self.store.restore()
        if self.store is not None:
            self.household.learn(self.store)
        if memory is not None:
            self.restore(memory.objects, memory.stamp, memory.epoch, memory.names)

    def update(self, evidence: WorldEvidence, stamp: float, predictions: Any = None) -> WorldState:
        """Take one look into account; returns the most probable world.

        A stamp up to `late_window` behind the newest is late: its detections count where objects were then, its
        absences where nothing was seen since. An older one starts a new epoch with an empty model. predictions : where
        movers go, {id: path} (or paths of the nearest movers), a path being (T, 3) x, y, t in m and s or anything with
        `path` and `covariances` (T, 2, 2) m², such as a `tracking.intentions.Prediction`; None withdraws one. It is the
        person behaviour until it ends; without it movers go straight on.

        Raises InputError, before anything has changed, naming what is wrong with the evidence.
        """
        stamp = as_stamp("stamp", stamp)
        measured = checked(evidence, self.config.measurement_sigma)
        if self.household.aliases and any(measured.object_ids):
            named = tuple(None if name is None else self._symbol(name) for name in measured.object_ids)
            measured = replace(measured, object_ids=named)
        paths = checked_predictions(predictions, self._anchors.shown.values(), stamp)
        fresh = self._anchors.vocabulary.check(measured.attributes)
        for index, given in enumerate(measured.quantities):
            self._anchors.quantities.check(f"objects[{index}]", given)
        if stamp < self.stamp - self.config.late_window:
            self.reset()
        for name, value in fresh:
            self._anchors.learn_value(name, value)
        lag = max(self.stamp - stamp, 0.0)
        self.stamp = max(stamp, self.stamp)
        self._take_up()
        self.anchoring.guidance.guide(paths)
        associations = self.anchoring.look(measured, self.stamp, lag)
        state = self._state(associations)
        if measured.view is not None and not measured.silent:
            said = [given.get("class", {}) for given in measured.attributes]
            measured.view.learn(state.objects, associations, said)
        return self._recorded(state)

    def look_back(self) -> list[tuple[float, tuple[str | None, ...]]]:
        """Correct earlier conclusions: stamp and object of each detection, per look, as all that was seen since says.

        With `learn_sensor_bias`, of the last looks in which a sensor with a pose had detections; all of them are
        explained together (`revision`), which takes as long as hundreds of updates. Places of resting objects and the
        errors of the sensor follow.
        """
        corrected = self.anchoring.calibration.look_back()
        if corrected:
            self._recorded(self._state())
        return corrected

    def usable(self, evidence: WorldEvidence, wordless: bool = False) -> tuple[WorldEvidence, dict[int, str]]:
        """Evidence without the detections that speak of classes or attributes nobody knows, and why, by index.

        `update` refuses such evidence as a whole: a program that made it is told. For a detector that knows more words
        than the deployment it would be a pity about the rest.

        wordless : keep them without their words, for known objects only: what is called by a wrong word is there.
        """
        objects = detections(evidence)
        refused = self._anchors.refused([(item.attributes, item.quantities) for item in objects])
        if not refused:
            return evidence, refused
        kept = [item for index, item in enumerate(objects) if index not in refused]
        if wordless:
            kept += [replace(objects[index], attributes={}, quantities={}, begins=False) for index in refused]
        return replace(evidence, objects=kept), refused

    def outside(self, evidence: WorldEvidence) -> FloatArray:
        """Positions (N, 3), m, of detections that are farther from the region than it is wide; they count nevertheless.

        That is no region stated too small: their unit or frame is another one.
        """
        spots = np.array([item.position for item in evidence.objects], dtype=np.float64).reshape(-1, 3)
        low, high = np.array(self.config.region, dtype=np.float64).T
        wide = (high - low).max()
        return spots[((spots < low - wide) | (spots > high + wide)).any(axis=1)]

    def _recorded(self, state: WorldState) -> WorldState:
        if self.store is not None:
            self.store.record(state)
        if self.household.due(state.stamp):
            told = (self.words.described(item) for item in self._anchors.shown.values())
            self.household.watch(told, state.stamp)
            self.household.keep(state.stamp)
        return state

    def explain(self, object_id: str) -> str:
        """What an object usually does, in a sentence; "" where nothing was learned. Raises InputError."""
        symbol = self._symbol(object_id)
        self._anchors.find(symbol)
        return self.household.explain(symbol, self.stamp)

    def _where(self, item: WorldObject) -> Mapping[str, float]:
        """By the words that are in use: they can be replaced, and copies of the model have their own."""
        return self.words.where(item)

    def _symbol(self, object_id: str) -> str:
        """The symbol of an object by that or by one it had before."""
        alias = self.household.aliases.get(require_word("object_id", object_id))
        if alias is None or any(track.id == object_id for track in self._anchors.tracks.values()):
            return object_id
        return alias

    def close(self) -> None:
        """Write what was learned, and close the store."""
        if self.store is not None:
            self.household.keep(self.stamp, now=True)
            self.store.close()

    def _state(self, associations: tuple[str | None, ...] = ()) -> WorldState:
        objects = self._by_now.told(self._anchors.shown.values(), self.stamp)
        share, count = float(self.anchoring.beliefs.probabilities()[0]), self.anchoring.beliefs.expected_count
        return WorldState(objects, share, count, self.stamp, self.epoch, 0, associations)

    def hypotheses(self) -> list[WorldState]:
        """All hypotheses that are kept, the most probable first; their probabilities sum to one."""
        count = self.anchoring.beliefs.expected_count
        worlds, now = self.anchoring.beliefs.worlds(), self.stamp
        return [
            WorldState(self._by_now.told(objects, now), probability, count, now, self.epoch, index)
            for index, (objects, probability) in enumerate(worlds)
        ]

    @property
    def world(self) -> WorldState:
        """The most probable world as it was told last: what nobody has looked for since is as it was then."""
        return self._state()

    def propagate(self, stamp: float) -> WorldState:
        """The most probable world at `stamp`, without evidence; the model itself stays as it is.

        What nobody has looked for is less probably there by then (`removed_per_second`).
        """
        stamp = as_stamp("stamp", stamp)
        objects = self._by_now.told(self.anchoring.presentation.predicted(stamp), stamp)
        expected = float(sum(item.existence for item in objects))
        return WorldState(
            objects, float(self.anchoring.beliefs.probabilities()[0]), expected, stamp, self.epoch
        )

    def query(self, *, stamp: float | str | None = None, **request: Any) -> list[QueryAnswer]:
        """Which objects meet a request, the most probable first; see `world_model.queries.Request`.

        class_name, predicate (one symbol or several), region (name of a place or of an object, a `Place`, or
        corners (N, 2) in m), object_id, min_probability, limit. stamp : s; the past is answered from the store,
        "last_seen" is when the region was last seen, None is now. Raises InputError naming the argument.
        """
        checked_request = Request.checked(**request)
        if checked_request.object_id:
            checked_request = replace(checked_request, object_id=self._symbol(checked_request.object_id))
        if isinstance(stamp, str) and stamp == LAST_SEEN:
            stamp = last_seen(_worlds_at(self, None)[0], self.store, checked_request.region, self.words)
        worlds, moment = _worlds_at(self, stamp)
        return ask(worlds, checked_request, moment, self.words)

    def report(self, object_id: str, outcome: str, stamp: float) -> WorldState:
        """Outcome of a verification of an object: "found", "occluded" (says nothing) or "not_found".

        After "not_found" the object is lost: anywhere in its room, not deleted. Raises InputError for an unknown
        id or outcome.
        """
        if require_word("outcome", outcome) not in OUTCOMES:
            raise InputError(f"outcome: one of {', '.join(OUTCOMES)}, got {outcome!r}")
        object_id = self._symbol(object_id)
        track = self._anchors.find(object_id)
        self.stamp = max(as_stamp("stamp", stamp), self.stamp)
        if outcome == "not_found":
            region = _room_of(self._state().find(object_id), self.places, self.config.region[2])
            self.anchoring.objects.lose(track, self.stamp, region)
        return self._recorded(self._state())

    def seen_through(self, origin: npt.ArrayLike, ends: npt.ArrayLike, stamp: float) -> WorldState:
        """Beams went from a place (3,) to others (N, 3), m, and met nothing on the way; returns the probable world.

        What would have stood in their way is not there: objects that rest, of a size that was measured. Raises
        InputError for shapes, and for numbers that are not finite.
        """
        start, points = as_vectors("origin", origin, 3), as_vectors("ends", ends, 3)
        if start.ndim != 1 or points.ndim != 2:
            raise InputError(f"origin (3,) and ends (N, 3) expected, not {start.shape} and {points.shape}")
        self.stamp = max(as_stamp("stamp", stamp), self.stamp)
        self._anchors.stamp = self.stamp
        self.anchoring.beliefs.show(self.anchoring.bodies.pass_through(start, points, self.stamp))
        return self._recorded(self._state())

    def forget(self, object_id: str) -> None:
        """Take an object out of the model for good. Raises InputError for an unknown id."""
        self.anchoring.objects.remove(self._anchors.find(self._symbol(object_id)))
        self._recorded(self._state())

    def relabel(self, object_id: str, class_name: str = "", new_object_id: str = "") -> None:
        """Correct the class or the id of an object; its old id stays an alias.

        Raises InputError for an unknown id, an id in use, or a class that is none of those the configuration names.
        """
        given = {"object_id": object_id, "class_name": class_name, "new_object_id": new_object_id}
        for name, word in given.items():
            require_word(name, word)
        track = self._anchors.find(object_id)
        if class_name:
            # A class that was never seen is one of any names that are allowed.
            for name, value in self._anchors.vocabulary.check([{"class": {class_name: 1.0}}]):
                self._anchors.learn_value(name, value)
            self.anchoring.objects.set_class(track, class_name)
        if new_object_id:
            self.anchoring.objects.rename(track, new_object_id)
            if self.store is not None:
                self.store.rename(object_id, new_object_id)
            self.household.rename(object_id, new_object_id)
            self.household.keep(self.stamp, now=True)
        self._recorded(self._state())

    def restore(
        self,
        objects: Iterable[WorldObject],
        stamp: float,
        epoch: int = 0,
        names: Mapping[str, int] | None = None,
    ) -> None:
        """Start from remembered objects, as after a restart; replaces all that is known.

        names : the highest number in use by class, so that no symbol is given twice.
        """
        # A run that nothing has been seen in has no stamp yet.
        stamp = stamp if stamp == -np.inf else as_stamp("stamp", stamp)
        self.anchoring.reset()
        self.stamp, self.epoch = stamp, epoch
        self._believe(objects, names or {})

    def _believe(self, objects: Iterable[WorldObject], names: Mapping[str, int]) -> None:
        for item in objects:
            self.anchoring.recall.remember(item, self.stamp)
        self.anchoring.objects.reserve(names)

    def reset(self) -> None:
        """Forget all objects and start a new epoch."""
        self.anchoring.reset()
        self.epoch += 1
        self.stamp, self.begun = -np.inf, np.inf
        self._earlier = ((), {})
        if self.store is not None:
            self.store.begin(self.epoch)

    def next_run(self) -> None:
        """Time went back: a new epoch, in which what rests is still believed in, as from an earlier run.

        How long ago that was nobody knows. The objects come back with the next evidence, as if nobody had looked for
        `BETWEEN_RUNS`, last seen before it; whoever moved is gone.
        """
        earlier, then = self._earlier, self.stamp + BETWEEN_RUNS
        if np.isfinite(then):
            objects = self.anchoring.presentation.predicted(then)
            resting = (item for item in objects if item.behaviors.get("constant_velocity", 0.0) <= 0.5)
            earlier = [_moved(item, -then) for item in resting], dict(self._anchors.names)
        self.reset()
        self._earlier = earlier

    def _take_up(self) -> None:
        """What an earlier run knew, at the first stamp of this one."""
        objects, names = self._earlier
        if objects:
            self._believe((_moved(item, self.stamp) for item in objects), names)
        self._earlier = ((), {})
        self.begun = min(self.begun, self.stamp)

    @property
    def of_earlier_runs(self) -> int:
        """Objects believed in that have not been seen in this run."""
        return sum(item.last_seen < self.begun for item in self._anchors.shown.values())

    @property
    def sensor_bias(self) -> tuple[float, ...]:
        """What the sensor's systematic errors are found to be: offset (m), scale, depth, turn, lean (rad), stretch,
        bend (1/rad), delay (s)."""
        return tuple(self.anchoring.calibration.bias.values.tolist())

    @property
    def health(self) -> dict[str, float]:
        """Figures for diagnostics: objects, anchors, hypotheses, leaves."""
        return self.anchoring.presentation.health()


def _worlds_at(model: WorldModel, stamp: float | str | None) -> tuple[list[World], float]:
    """All hypotheses now, or the most probable world at another time, and the moment that is.

    Raises InputError for a stamp that is no number, and for the past where nothing is remembered.
    """
    if stamp is None:
        stamp = model.stamp
    elif isinstance(stamp, str):
        raise InputError(f'stamp must be seconds, "{LAST_SEEN}" or None, not {stamp!r}')
    else:
        stamp = as_stamp("stamp", stamp)
    if stamp == model.stamp:
        return [(state.probability, state.objects) for state in model.hypotheses()], model.stamp
    if stamp > model.stamp:
        return [(1.0, model.propagate(stamp).objects)], stamp
    if model.store is None:
        raise InputError(
            f"stamp: {stamp:g} is in the past; only a world model with a store remembers the past"
        )
    return [(1.0, model.store.objects_at(stamp))], stamp


def _room_of(item: WorldObject | None, places: Places | None, heights: tuple[float, float]) -> Box | None:
    """The room that an object was in last, None where that is not known."""
    if item is None or item.lost or not places:
        return None if item is None else item.region
    room = places.room_of(item.position)
    if room is None:
        return None
    (x0, y0), (x1, y1) = room.polygon.min(0).tolist(), room.polygon.max(0).tolist()
    return ((x0, x1), (y0, y1), heights)


def routines_path(store: Path) -> Path:
    """The file beside a store that keeps the routines."""
    return store.with_name(store.name + SUFFIX)
