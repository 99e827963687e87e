"""What is near something, and how far two things are apart: metres between places, and no word for how near is near."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.polygons import outline_distance
from world_model.questions.answers import Answer, NothingKnownError, NotUnderstoodError, clean, clock, listed
from world_model.questions.moments import When
from world_model.questions.naming import at_the, described, one_named, place_named, spoken, things_named
from world_model.questions.recall import Recall, Trust
from world_model.questions.where import line_at, where_is, where_was, within
from world_model.state import BELIEVED

TOLD = 3  # things that a sentence names; the value has all


class _Spot(NamedTuple):
    """Where something is at a moment. position : (3,) m; p : that it is there."""

    place: str
    position: FloatArray
    p: float


def what_is_near(world: Recall, what: str, when: When = None, kind: str = "") -> Answer:
    """The things in the room of a thing or a piece of furniture, the nearest first. value : ids.

    kind : of these only, as "cups". Of furniture the distance is that to its outline, and what is on or in it is not
    near it. Raises NothingKnownError, AmbiguousError, and NotUnderstoodError for more than a moment.
    """
    stamp = _moment(world, when)
    then = "" if when is None else f" at {clock(stamp)}"
    try:
        name, center = one_named(world, what, when is not None), ""
    except NothingKnownError as error:
        name, center = "", _furniture(world, what, error)
    mine = _Spot(center, np.zeros(3), 1.0) if center else _spot(world, name, stamp)
    if mine is None:
        return where_is(world, name) if when is None else where_was(world, name, when)
    found: list[tuple[float, str, float]] = []
    others = world.heads(world.present) if when is None else world.things()
    for other in things_named(world, kind, when is not None).ids if kind else others:
        spot = None if other == name else _spot(world, other, stamp)
        if spot is None or not _together(world, mine.place, spot.place) or spot.place == center:
            continue
        away = float(np.linalg.norm(spot.position - mine.position))
        if center:
            away = float(outline_distance(world.places[center].polygon, spot.position[:2]))
        found.append((away, other, spot.p))
    found.sort()
    subject = spoken(world, center).partition(" ")[2] if center else described(world, name)
    if not center:
        subject += at_the(world, mine.place)
    near = [f"{described(world, other)}, {away:.1f} m away" for away, other, _ in found[:TOLD]]
    sentence = f"Nearest to {subject}{then}: {listed(near)}"
    if not found:
        sentence = f"I know of nothing near {subject}{then}"
    p = mine.p * (found[0][2] if found else Trust.NOT_SEEN)
    options = tuple({"object": other, "distance": away, "probability": q} for away, other, q in found)
    return Answer.stated(sentence, "what_is_near", p, stamp, [other for _, other, _ in found], (), options)


def how_far(world: Recall, what: str, other: str, when: When = None) -> Answer:
    """How far apart two things are, or were at a moment. value : m.

    Raises NothingKnownError, AmbiguousError, and NotUnderstoodError for more than a moment.
    """
    stamp = _moment(world, when)
    names = [one_named(world, words, when is not None) for words in (what, other)]
    spots = [_spot(world, name, stamp) for name in names]
    if spots[0] is None or spots[1] is None:
        lost = names[0] if spots[0] is None else names[1]
        return where_is(world, lost) if when is None else where_was(world, lost, when)
    away = float(np.linalg.norm(spots[0].position - spots[1].position))
    said = [
        described(world, name) + at_the(world, spot.place)
        for name, spot in zip(names, spots, strict=True)
        if spot
    ]
    sentence = f"{said[0]} {'is' if when is None else 'was'} {away:.1f} m from {said[1]}"
    sentence += "" if when is None else f" at {clock(stamp)}"
    return Answer.stated(sentence, "how_far", spots[0].p * spots[1].p, stamp, away)


def _moment(world: Recall, when: When) -> float:
    span = within(world, when)
    if span.lasts:
        raise NotUnderstoodError(f'When? Say a moment of "{clean(span.words)}", as "yesterday at nine".')
    return span.middle


def _furniture(world: Recall, what: str, error: NothingKnownError) -> str:
    """The piece of furniture that is meant; what is near a whole room is not told. Raises the error for other words."""
    try:
        place = place_named(world, what)
    except NothingKnownError:
        raise error from None
    if not place or world.places[place].kind == "room":
        raise error
    return place


def _spot(world: Recall, name: str, stamp: float) -> _Spot | None:
    """None where it is believed to be nowhere."""
    line = line_at(world, name, stamp)
    chances, stay = line.at(stamp)
    item = world.present.get(line.id) if stamp >= world.now else None
    if stay is None or (stamp >= world.now and (item is None or line.lost)):
        return None
    p = chances.get(stay.place, 0.0) * (1.0 if item is None else item.existence)
    return _Spot(stay.place, stay.position if item is None else item.position, p) if p >= BELIEVED else None


def _together(world: Recall, first: str, second: str) -> bool:
    """Whether two places are in one room, as far as rooms are known: what a wall parts is not near."""
    rooms = [set(world.rooms_of(name)) for name in (first, second)]
    return not all(rooms) or bool(rooms[0] & rooms[1])
