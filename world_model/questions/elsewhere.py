"""Where something may be that is no longer where it was, and that nobody has found again yet.

It was put somewhere else, or taken out of the house: what it did when it left that place before, at about this time of
day, says which. The longer it is not found, though all places are looked at by turns, the more probably it is out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import datetime
from itertools import pairwise

import numpy as np

from world_model.memory.stays import FOUND_AFTER, Timeline
from world_model.questions.recall import Recall, remembered
from world_model.state import BELIEVED, DAY, PERSON, most_probable

WEEKS = 28 * DAY  # s: of the history that says where things go
OUT = 2.0 * FOUND_AFTER  # s: what was found no sooner was out of the house, as far as anybody could tell
ANY_HOUR = 0.05  # What counts a move at another time of day
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
    return _weighed(world, line.id, last.place, min(last.left_by or world.now, world.now))


@remembered
def _weighed(world: Recall, name: str, was: str, left_by: float) -> Elsewhere:
    furniture = [place.name for place in world.places if place.kind != "room"]
    others = [place for place in furniture or [place.name for place in world.places] if place != was]
    votes = dict.fromkeys(others, PRIOR_PLACES / max(len(others), 1))
    out = PRIOR_OUT
    for before, after in pairwise(weeks_of(world, name).stays):
        left = before.left_by or after.since
        if before.place != was:
            continue
        if after.since - left > OUT:
            out += _same_hour(left, left_by)
        elif after.place:  # also where it was: it had been overlooked
            votes[after.place] = votes.get(after.place, 0.0) + _same_hour(left, left_by)
    unnoticed = math.exp(-(world.now - left_by) / _round_of_looks(world))
    total = unnoticed * sum(votes.values()) + out
    chances = {place: unnoticed * weight / total for place, weight in votes.items()}
    return Elsewhere({place: p for place, p in chances.items() if p > 1e-3}, out / total)


def _same_hour(then: float, stamp: float) -> float:
    """Weight of a moment by its time of day, local time."""
    first, second = (at.hour + at.minute / 60 for at in map(datetime.fromtimestamp, (then, stamp)))
    apart = abs(first - second)
    # It does the same again an hour, one deviation, sooner or later.
    return ANY_HOUR + math.exp(-0.5 * min(apart, 24 - apart) ** 2)


@remembered
def _round_of_looks(world: Recall) -> float:
    """How long a round of looks at all places takes, s, as what rests there says."""
    seen: dict[str, float] = {}
    for item in world.present.values():
        if not item.lost and item.existence >= BELIEVED and item.most_probable("class") != PERSON:
            [place] = world.words(item.position[None])
            seen[place] = max(seen.get(place, 0.0), item.last_seen)
    ages = [world.now - stamp for stamp in seen.values()]
    longest = max((age for age in ages if age <= LONGEST), default=0.0)
    return float(np.clip(longest * (1.0 + 1.0 / max(len(ages), 1)), SHORTEST, LONGEST))
