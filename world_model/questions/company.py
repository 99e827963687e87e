"""Who was at a place, from when to when, and what was moved meanwhile."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.places import Place
from estimation.geometry.polygons import outline_distance
from world_model.memory.stays import AWAY
from world_model.questions.answers import Answer, NothingKnownError, clean, clock, duration, iso, listed
from world_model.questions.moments import Span, When
from world_model.questions.naming import (
    at_the,
    described,
    name_of_person,
    one_named,
    people,
    people_named,
    place_named,
    spoken,
)
from world_model.questions.past import (
    Change,
    moves_at,
    moves_of,
    period_of,
    since_when,
    told_change,
)
from world_model.questions.recall import WEEK, Recall, Trust
from world_model.questions.where import where_is
from world_model.state import DAY, PERSON

BESIDE = 1.0  # m: who is that close to a piece of furniture is at it
NOW = 300.0  # s: who was seen within it is taken to be there
AROUND_MOVE = 30.0  # s before and after a move in which somebody who was there may have moved it


@dataclass(frozen=True)
class Visit:
    """One person at a place from `start` to `end`, s."""

    person: str
    start: float
    end: float


def who_was_here(world: Recall, place: str = "", since: When = None, person: str = "") -> Answer:
    """Who was at a place, or anywhere, since a moment (default: of the last day), and what was moved meanwhile.

    person : only this one, by id or name. value : [[person, from, until, [objects]], ...].
    Raises NothingKnownError, AmbiguousError, InputError.
    """
    only = _ids(world, person)
    span = since_when(world, since, DAY)
    where = place_named(world, "" if place == "here" else place, beside=True)
    visits = [visit for visit in visits_of(world, where, span) if not person or visit.person in only]
    changes = moves_at(world, where, span) if visits else []
    value: list[list[Any]] = []
    parts, evidence = [], []
    for visit in visits:
        during = [change for change in changes if change.start <= visit.end and change.end >= visit.start]
        value.append([visit.person, iso(visit.start), iso(visit.end), [change.object for change in during]])
        with_what = f" ({listed(told_change(world, change) for change in during)})" if during else ""
        parts.append(
            f"{described(world, visit.person)} from {clock(visit.start)} to {clock(visit.end)[11:]}{with_what}"
        )
        evidence.append({"object": visit.person, "event": "seen", "place": where, "stamp": iso(visit.start)})
    at = at_the(world, where) or " here"
    period = period_of(world, span)
    if visits:
        # One with a name is one under all ids.
        count = len({name_of_person(world.item(visit.person)) or visit.person for visit in visits})
        were = "1 person was" if count == 1 else f"{count} people were"
        sentence = f"{were}{at} {period}: {'; '.join(parts[-8:])}"
    else:
        nobody = f"not seen {_called(world, person)}" if person else "seen nobody"
        sentence = f"I have {nobody}{at} {period}"
    return Answer.stated(sentence, "who_was_here", Trust.SEEN, span.start, value, tuple(evidence[-8:]))


def who_was_last(world: Recall, place: str = "", since: When = None) -> Answer:
    """Who was at a place, or anywhere, last: since a moment, or in the last week. value as of `who_was_here`.

    Raises NothingKnownError, AmbiguousError, InputError.
    """
    span = since_when(world, since, WEEK)
    visits = visits_of(world, place_named(world, place, beside=True), span)
    last = max(visits, key=lambda visit: visit.end, default=None)
    return who_was_here(world, place, span if last is None else Span(last.start, last.end))


def who_is_here(world: Recall, place: str = "") -> Answer:
    """Who is at a place, or anywhere, now: seen there within `NOW`. value as of `who_was_here`.

    Raises NothingKnownError, AmbiguousError.
    """
    was = who_was_here(world, place, Span(world.now - NOW, world.now))
    names = [described(world, name) for name in dict.fromkeys(row[0] for row in was.value)]
    at = at_the(world, place_named(world, place, beside=True)) or " here"
    sentence = f"I have seen nobody{at} in the last {duration(NOW)}"
    if names:
        sentence = f"{listed(names)} {'is' if len(names) == 1 else 'are'}{at}"
    return Answer.stated(sentence, "who_was_here", Trust.NOT_SEEN, world.now, was.value, was.evidence)


def who_moved(
    world: Recall, what: str, since: When = None, person: str = "", place: str = "", way: str = ""
) -> Answer:
    """Who was there when an object was moved: last, or each time of a span. Nobody is known to have moved it.

    person : whether it was this one. place, way : from or to this one, as of `is_about`. value : ids of people.

    Raises NothingKnownError, AmbiguousError.
    """
    only = _ids(world, person)
    name, where = one_named(world, what), place_named(world, place)
    span = since_when(world, since)
    moves = moves_of(world, name, span, where, way, back=False)[1]
    if not moves:
        sentence = (
            f"{described(world, name)} was not moved{at_the(world, where)} in that time, as far as I know."
        )
        return Answer(sentence, "who_moved", Trust.NOT_SEEN, iso(world.now), [])
    parts, value = [], []
    for move in moves if since is not None else moves[-1:]:
        there = [each for each in present_at(world, move) if not person or each in only]
        value += [each for each in there if each not in value]
        nobody = f"I did not see {_called(world, person)} there" if person else "I saw nobody there"
        said = f"{listed(described(world, each) for each in there)} was there" if there else nobody
        parts.append(f"{said} when {told_change(world, move)}")
    return Answer.stated("; ".join(parts[-8:]), "who_moved", Trust.PROBABLY, moves[-1].end, value)


def who_has(world: Recall, what: str) -> Answer:
    """Who may have an object: who was there when it went from where it was, if it was not found since. value : ids.

    Nobody is known to have it. Raises NothingKnownError, AmbiguousError.
    """
    name = one_named(world, what)
    known, moved = where_is(world, name), who_moved(world, name)
    if not world.latest(name).lost:
        moved = replace(known, sentence=f"Nobody that I know of: {known.sentence}", value=[])
    else:
        moved = replace(moved, sentence=f"{known.sentence} {moved.sentence}")
    return replace(moved, kind="who_has")


def what_was_carried(world: Recall, person: str, since: When = None) -> Answer:
    """What was moved where a person was just then: probably by that person. value : ids of objects.

    Raises NothingKnownError.
    """
    only = _ids(world, person)
    span = since_when(world, since, DAY)
    moves = [move for move in moves_at(world, "", span) if set(only) & set(present_at(world, move))]
    called = _called(world, person)
    sentence = f"I know of nothing that was moved where {called} was {span.between}"
    if moves:
        told_of = "; ".join(told_change(world, move) for move in moves[-8:])
        sentence = f"Where {called} was {span.between}: {told_of}"
    value = list(dict.fromkeys(move.object for move in moves))
    return Answer.stated(sentence, "what_was_carried", Trust.PROBABLY, span.start, value)


def where_was_person(world: Recall, person: str, when: Span) -> Answer:
    """Where somebody was seen during a span, or within `NOW` of a moment. value : the last such place, or None.

    Raises NothingKnownError.
    """
    only = set(_ids(world, person))
    wide = Span(when.start - NOW, min(when.end, world.now) + NOW)
    found: dict[str, float] = {}
    for name in [each for each in _persons(world, wide) if each in only]:
        stamps, positions = _track(world, name, wide)
        for stamp, place in zip(stamps.tolist(), world.words(positions), strict=True):
            found.setdefault(place, stamp)
    told_of = [f"{spoken(world, place)} at {clock(stamp)}" for place, stamp in found.items()]
    said = listed(told_of) if told_of else f"not seen {wide.between}"
    best = max(found, key=found.__getitem__, default=None)
    return Answer(f"{_called(world, person)} was {said}.", "where_was", Trust.NOT_SEEN, iso(when.start), best)


def _called(world: Recall, person: str) -> str:
    """A person's name as it is written."""
    return clean(name_of_person(world.item(_ids(world, person)[0])) or person)


def _ids(world: Recall, person: str) -> list[str]:
    """Ids of a person. Raises NothingKnownError."""
    if not person:
        return []
    if person in world.epochs and world.kind(person) == PERSON:
        return [person]
    ids = people_named(world, person)
    if not ids:
        known = listed(map(clean, people(world)), 20) or "nobody by name"
        raise NothingKnownError(f'I know nobody called "{clean(person)}"; I know {known}.')
    return ids


def present_at(world: Recall, move: Change) -> list[str]:
    """People who were at the place that an object left, or that it came to, when it was moved."""
    span = Span(move.start - AROUND_MOVE, move.end + AROUND_MOVE)
    places = [place for place in (move.before, move.after) if place]
    there = {visit.person for place in places for visit in visits_of(world, place, span)}
    return [name for name in _persons(world, span) if name in there]


def visits_of(world: Recall, place: str, span: Span) -> list[Visit]:
    """Visits of people within a span, in order of time."""
    found: list[Visit] = []
    for name in _persons(world, span):
        stamps, positions = _track(world, name, span)
        inside = stamps[_at(world.places[place], positions)] if place else stamps
        found += _joined(name, inside)
    return sorted(found, key=lambda visit: visit.start)


def _persons(world: Recall, span: Span) -> list[str]:
    return [name for name in world.active(span.start, span.end) if world.kind(name) == PERSON]


def _track(world: Recall, name: str, span: Span) -> tuple[FloatArray, FloatArray]:
    """Stamps (N,) and positions (N, 3) at which a person was seen."""
    found: dict[float, FloatArray] = {}
    if world.store is not None:
        for _, event, numbers, existence, lost, seen, _ in world.store.sights(
            name, world.epochs.get(name, world.epoch), span.start, span.end
        ):
            if event != "gone" and not lost and existence >= 0.5:
                found[seen] = np.frombuffer(numbers, "<f8")
    item = world.present.get(name)
    if item is not None and not item.lost:
        found[item.last_seen] = item.position
    kept = sorted(stamp for stamp in found if span.start <= stamp <= span.end)
    return np.array(kept), np.array([found[stamp] for stamp in kept]).reshape(-1, 3)


def _at(place: Place, positions: FloatArray) -> Any:
    """Whether people stand in a room, or in or beside a piece of furniture."""
    inside = place.contains(positions[:, :2])
    if place.kind == "room" or not len(positions):
        return inside
    return inside | (outline_distance(place.polygon, positions[:, :2]) <= BESIDE)


def _joined(name: str, stamps: FloatArray) -> list[Visit]:
    """Visits of a person who was seen at these stamps (N,)."""
    runs = np.split(stamps, np.flatnonzero(np.diff(stamps) > AWAY) + 1)
    return [Visit(name, float(run[0]), float(run[-1])) for run in runs if len(run)]
