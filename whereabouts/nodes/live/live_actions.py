"""What people and agents make the running suite do: search, look again, forget, relabel, keep and load maps."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from estimation.errors import InputError
from whereabouts.nodes.live.live_world import PATIENCE, Client, NoWorldError
from whereabouts.nodes.live.searching import RunningSearch, Searches
from whereabouts.nodes.messages.stamps import seconds
from whereabouts_msgs.action import FindObject
from whereabouts_msgs.srv import ForgetObject, LoadMap, RelabelObject, SaveMap, TriggerVerification
from world_model.questions import Recall
from world_model.questions.answers import clean
from world_model.questions.naming import PREPOSITIONS, in_known_words, plain, sort_of, things_named

MAP_PATIENCE = 60.0  # s that writing or reading a map may take
SERVICES: dict[str, tuple[Any, str, float]] = {
    "verify_object": (TriggerVerification, "world_maintenance/trigger", PATIENCE),
    "forget": (ForgetObject, "world_model/forget", PATIENCE),
    "relabel": (RelabelObject, "world_model/relabel", PATIENCE),
    "save_map": (SaveMap, "loop_closure/save_map", MAP_PATIENCE),
    "load_map": (LoadMap, "loop_closure/load_map", MAP_PATIENCE),
}
"""What a node does at once: its service, and the s that it may take."""


@dataclass(frozen=True)
class Done:
    """How it ended. ok : whether what was asked for is done. stamp : s, 0 where there is none. object : its id."""

    ok: bool
    sentence: str
    probability: float = 0.0
    stamp: float = 0.0
    object: str = ""


def goal_for(name: str, world: Recall | None) -> FindObject.Goal:
    """A goal from words: an object that they name, also by where it is, else a class with predicates before it.

    Raises InputError for none.
    """
    words = plain(name)
    if not words:
        raise InputError("an object to find must have a name, a class at least")
    if world is not None:
        known = _known(name, world)
        if known is not None:
            return known
    *predicates, kind = words.split()
    if kind in PREPOSITIONS.split("|"):
        raise InputError(f'"{words}" is no name of an object')
    return FindObject.Goal(class_name=kind, predicates=predicates)


def _known(name: str, world: Recall) -> FindObject.Goal | None:
    """A goal from words of which something is known."""
    try:
        meant = things_named(world, name)
    except InputError:
        meant = None
    words = plain(name)
    sort = sort_of(world, words) or sort_of(world, in_known_words(world, words))
    if sort is not None and sort.kind is not None and not (meant and meant.by_name):
        return FindObject.Goal(class_name=sort.kind, predicates=list(sort.predicates))
    if meant is not None and (meant.by_name or len(meant.ids) == 1):
        return FindObject.Goal(object_id=meant.ids[0])
    if meant is not None:
        raise InputError(f"which one: {' or '.join(map(clean, meant.ids[:8]))}?")
    return None


def find(
    client: Client,
    goal: FindObject.Goal,
    on_step: Callable[[str, float], None] = lambda words, probability: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Done:
    """Search for an object with the robot until it is found, given up or stopped; then the goal is cancelled.

    on_step : called with what the robot does next and the probability of seeing it there. Raises NoWorldError where no
    node object_search runs.
    """
    searches = Searches(client.node)
    try:
        if not client.until(lambda: searches.ready):
            raise NoWorldError(
                "nobody searches: start it with `whereabouts run object_search`"
                f"{client.elsewhere('find_object/_action/status')}"
            )
        search = searches.ask(goal, lambda step: on_step(step.reason, step.probability))
        try:
            while search.result is None and not stopped():
                client.spin()
        finally:
            if search.result is None:
                _cancel(client, search)
        return _outcome(
            search.result or FindObject.Result(code=FindObject.Result.CANCELED, message="cancelled")
        )
    finally:
        searches.destroy()


def _cancel(client: Client, search: RunningSearch) -> None:
    client.until(search.answered.done)
    if search.answered.done() and search.result is None:
        search.cancel()
        client.until(lambda: search.result is not None, PATIENCE)


def _outcome(result: FindObject.Result) -> Done:
    if result.code == FindObject.Result.CANCELED:
        return Done(False, f"The search was ended: {result.message}.")
    if result.code != FindObject.Result.FOUND:
        return Done(False, result.message or "It was not found.")
    found = result.object[0] if result.object else None
    where = f" at the {found.place.replace('_', ' ')}" if found is not None and found.place else ""
    name = found.id if found is not None else "It"
    sentence = f"{name} is found{where}, after {result.distance:.1f} m of driving."
    if found is None:
        return Done(True, sentence, 1.0)
    return Done(True, sentence, found.existence_probability, seconds(found.last_seen), found.id)


def act(client: Client, name: str, **fields: Any) -> Done:
    """Have a node do one of `SERVICES`; fields : of the request. Raises NoWorldError where no such node runs."""
    kind, service, patience = SERVICES[name]
    answer = client.call(kind, service, kind.Request(**fields), patience)
    path = getattr(answer, "path", "")
    return Done(answer.code == answer.SUCCESS, f"{answer.message}: {path}" if path else answer.message)
