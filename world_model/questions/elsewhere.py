"""Where something may be that is no longer where it was, and that nobody has found again yet.

It was put somewhere else, or taken out of the house. What it did at other times at about this time of day says which;
against a place speaks a look at it since.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

from world_model.memory.courses import PlaceCourse, Sight, courses_of, courses_of_rows
from world_model.questions.recall import FOUND_AFTER, Recall, Timeline, remembered
from world_model.state import BELIEVED, DAY, PERSON, most_probable


def course_of(world: Recall, name: str, start: float) -> PlaceCourse | None:
    """Where one object was since a moment, None where it was not seen: of few objects cheaper than `presence_of`."""
    whole = world.kept.get((presence_of.__qualname__, start))
    return whole.get(name) if isinstance(whole, dict) else _of_one(world, name, start)


@remembered
def _of_one(world: Recall, name: str, start: float) -> PlaceCourse | None:
    if world.store is None:
        return _of_line(world.timeline(name))
    rows: list[Sight] = []
    for known in world.names_of(name):
        rows += [row[:6] for row in world.store.sights(known, world.epoch, start, again=False)]
    return courses_of_rows(world.store, {name: rows}, world.words, world.present, start).get(name)


@remembered
def presence_of(world: Recall, start: float) -> dict[str, PlaceCourse]:
    """Where all that is no person was since a moment, or since what can be read at once, by newest id."""
    if world.store is not None:
        return courses_of(
            world.store, world.words, world.present, start, lambda name: world.individual(name)[0]
        )
    courses = {name: _of_line(world.timeline(name)) for name in world.things()}
    return {name: course for name, course in courses.items() if course is not None}


def _of_line(line: Timeline) -> PlaceCourse | None:
    stamps: list[float] = []
    places: list[str | None] = []
    for stay in line.stays:
        stamps.append(stay.since)
        places.append(stay.place)
        if stay.left_by is not None:
            stamps.append(stay.left_by)
            places.append(None)
    return PlaceCourse.of(stamps, places, line.stays[-1].until) if line.stays else None


WEEKS = 28 * DAY  # s: of the history that says where things go
OUT = 2.0 * FOUND_AFTER  # s: what was found no sooner was out of the house, as far as anybody could tell
HOURS = 1.0  # Deviation of the time of day at which something does the same again
ANY_HOUR, ANY_PLACE = 0.05, 0.3  # What counts a move at another time of day, and one from another place
PRIOR_PLACES, PRIOR_OUT = 0.35, 0.15  # What is taken to be known of where anything goes, in moves
OVERLOOKED = 0.02  # That a look at a place does not find what is there
GUESS = 0.4  # Probability below which a place is no answer
SHORTEST, LONGEST = 120.0, 6 * 3600.0  # s: of a round of looks


@dataclass(frozen=True)
class Elsewhere:
    """places : probability by place, without the small ones. out : that it is out of the house, or at none of them."""

    places: dict[str, float]
    out: float

    @property
    def best(self) -> str:
        """The most probable place, "" where that is a mere guess, or it is more probably out of the house."""
        place = most_probable(self.places)
        return place if self.places.get(place, 0.0) >= max(self.out, GUESS) else ""


def elsewhere(world: Recall, line: Timeline) -> Elsewhere:
    """Where an object is that was not found where it was; `line` has at least its last stay."""
    last = line.stays[-1]
    return _weighed(world, line.id, last.place, last.until, min(last.left_by or world.now, world.now))


@remembered
def _weighed(world: Recall, name: str, was: str, until: float, left_by: float) -> Elsewhere:
    votes, out = _votes(course_of(world, name, world.now - WEEKS), was, left_by)
    furniture = [place.name for place in world.places if place.kind != "room"]
    names = furniture or [place.name for place in world.places]
    for other in names:
        if other != was:
            votes[other] = votes.get(other, 0.0) + PRIOR_PLACES / len(names)
    out += PRIOR_OUT
    round_of_looks, looked = _looks(world)
    # Its having been overlooked where it was is in the votes: until the next look there.
    overlooked = math.exp(-2.0 * (world.now - left_by) / round_of_looks)
    chances = {}
    for place, weight in votes.items():
        unnoticed = _unnoticed(looked.get(place), until, left_by, world.now, round_of_looks)
        chances[place] = weight * (overlooked if place == was else unnoticed)
    total = sum(chances.values()) + out
    return Elsewhere({place: p / total for place, p in chances.items() if p > 1e-3 * total}, out / total)


def _votes(course: PlaceCourse | None, place: str, stamp: float) -> tuple[dict[str, float], float]:
    """How often it went to each place, and out of the house, when it left a place: what was alike counts more."""
    votes: dict[str, float] = {}
    out = 0.0
    if course is None:
        return votes, out
    stamps, places = course.stamps.tolist(), course.places
    there = [index for index, at in enumerate(places) if at is not None]
    for index, after in pairwise(there):
        before, to, left = places[index], places[after], stamps[index + 1]
        weight = _same_hour(left, stamp) * (1.0 if before == place else ANY_PLACE)
        if stamps[after] - left > OUT:
            out += weight
        elif to and (before == place or to != place):
            votes[to] = votes.get(to, 0.0) + weight
    return votes, out


def _same_hour(then: float, stamp: float) -> float:
    """Weight of a moment by its time of day, local time."""
    first, second = (at.hour + at.minute / 60 for at in map(datetime.fromtimestamp, (then, stamp)))
    apart = abs(first - second)
    return ANY_HOUR + math.exp(-0.5 * (min(apart, 24 - apart) / HOURS) ** 2)


def _looks(world: Recall) -> tuple[float, dict[str, float]]:
    """How long a round of looks takes, s, and when each place was looked at last, as what rests there says."""
    seen: dict[str, float] = {}
    for item in world.present.values():
        if item.lost or item.existence < BELIEVED or item.most_probable("class") == PERSON:
            continue
        place = world.words(item.position[None])[0]
        seen[place] = max(seen.get(place, -math.inf), item.last_seen)
    ages = [world.now - stamp for stamp in seen.values()]
    longest = max((age for age in ages if age <= LONGEST), default=SHORTEST)
    count = max(len(ages), 1)
    return min(max(longest * (count + 1) / count, SHORTEST), LONGEST), seen


def _unnoticed(looked: float | None, until: float, left_by: float, now: float, around: float) -> float:
    """Probability that something which came to a place between two moments was not noticed there until now.

    looked : last look at the place, None where nobody knows. around : s of a round of looks.
    """
    long = max(now - left_by, 0.0)
    again = OVERLOOKED * math.exp(-0.5 * long / around)
    if looked is None:
        unseen = max(1.0 - long / around, 0.0)
    else:
        unseen = min(max((left_by - looked) / max(left_by - until, 1e-6), 0.0), 1.0)
    return unseen + (1.0 - unseen) * again
