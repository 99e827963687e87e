"""Where something may be that is no longer where it was, and that nobody has found again yet.

It was put somewhere else, or taken out of the house. What it did at other times at about this time of day says which;
against a place speaks a look at it since.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

from world_model.memory.stays import FOUND_AFTER, ObjectStay, Timeline
from world_model.questions.recall import Recall, remembered
from world_model.state import BELIEVED, DAY, PERSON, most_probable

WEEKS = 28 * DAY  # s: of the history that says where things go
OUT = 2.0 * FOUND_AFTER  # s: what was found no sooner was out of the house, as far as anybody could tell
ANY_HOUR, ANY_PLACE = 0.05, 0.3  # What counts a move at another time of day, and one from another place
PRIOR_PLACES, PRIOR_OUT = 0.35, 0.15  # What is taken to be known of where anything goes, in moves
SHORTEST, LONGEST = 120.0, 6 * 3600.0  # s: of a round of looks


def weeks_of(world: Recall, name: str) -> Timeline:
    """Where one object was in the last weeks; what was missing for a while has left."""
    return world.line(name, world.now - WEEKS, coarse=True)


@dataclass(frozen=True)
class Elsewhere:
    """places : probability by place, without the small ones. out : that it is out of the house, or at none of them."""

    places: dict[str, float]
    out: float

    @property
    def best(self) -> str:
        """The most probable place, "" where it is rather at another, or out of the house."""
        place = most_probable(self.places)
        return place if self.places.get(place, 0.0) >= BELIEVED else ""


def elsewhere(world: Recall, line: Timeline) -> Elsewhere:
    """Where an object is that was not found where it was; `line` has at least its last stay."""
    last = line.stays[-1]
    return _weighed(world, line.id, last.place, last.until, min(last.left_by or world.now, world.now))


@remembered
def _weighed(world: Recall, name: str, was: str, until: float, left_by: float) -> Elsewhere:
    votes, out = _votes(weeks_of(world, name).stays, was, left_by)
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


def _votes(stays: Sequence[ObjectStay], place: str, stamp: float) -> tuple[dict[str, float], float]:
    """How often it went to each place, and out of the house, when it left a place: what was alike counts more."""
    votes: dict[str, float] = {}
    out = 0.0
    for before, after in pairwise(stays):
        left = before.left_by or after.since
        weight = _same_hour(left, stamp) * (1.0 if before.place == place else ANY_PLACE)
        if after.since - left > OUT:
            out += weight
        elif after.place and (before.place == place or after.place != place):
            votes[after.place] = votes.get(after.place, 0.0) + weight
    return votes, out


def _same_hour(then: float, stamp: float) -> float:
    """Weight of a moment by its time of day, local time."""
    first, second = (at.hour + at.minute / 60 for at in map(datetime.fromtimestamp, (then, stamp)))
    apart = abs(first - second)
    # It does the same again an hour, one deviation, sooner or later.
    return ANY_HOUR + math.exp(-0.5 * min(apart, 24 - apart) ** 2)


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
    if looked is None:
        return max(1.0 - max(now - left_by, 0.0) / around, 0.0)
    return min(max((left_by - looked) / max(left_by - until, 1e-6), 0.0), 1.0)
