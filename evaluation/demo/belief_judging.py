"""What the world model believes, beside where things truly are."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from evaluation.demo.screen import BELIEVED, NOBODY
from whereabouts.simulation.home.apartment_day import THINGS
from world_model import WorldObject
from world_model.state import MOVED_ON

Array = NDArray[np.float64]
SAME = 0.4
"""m, between a thing and the object that is believed to be it."""


@dataclass(frozen=True)
class JudgedBeliefs:
    """At one moment. wrong : ids that are believed to be where no such thing lies. unknown : things nobody knows of."""

    stamp: float
    wrong: tuple[str, ...]
    unknown: tuple[str, ...]


def known(objects: Iterable[WorldObject]) -> list[WorldObject]:
    """Things that are believed in, somewhere; people are none."""
    return [
        item
        for item in objects
        if item.existence >= BELIEVED and not item.lost and item.most_probable("class") not in NOBODY
    ]


def believed(objects: Iterable[WorldObject]) -> list[WorldObject]:
    """Things that are said to be somewhere: known, and not probably gone."""
    return [item for item in known(objects) if MOVED_ON not in item.predicates]


def apart(item: WorldObject, spot: Array) -> float:
    """m from an object to a place (3,)."""
    return float(np.linalg.norm(item.position - spot))


def matched(
    things: Mapping[str, Array | None], kind_of: Callable[[str], str], objects: Iterable[WorldObject]
) -> dict[str, WorldObject]:
    """Of each thing the object of its class within SAME, one at most for each, the nearest pairs first.

    things : where each truly lies, None while it is carried.
    """
    left, found = {item.id: item for item in objects}, {}
    pairs = sorted(
        (apart(item, spot), name, item.id)
        for name, spot in things.items()
        if spot is not None
        for item in left.values()
        if item.most_probable("class") == kind_of(name)
    )
    for away, name, own in pairs:
        if away <= SAME and name not in found and own in left:
            found[name] = left.pop(own)
    return found


def judged(objects: Iterable[WorldObject], things: Mapping[str, Array | None], stamp: float) -> JudgedBeliefs:
    """Beliefs at a stamp, s: one is right where a thing of its class lies, and each thing makes one belief right."""
    beliefs = believed(objects)
    right = matched(things, lambda name: THINGS[name][0].kind, beliefs)
    lying = {name for name, spot in things.items() if spot is not None}
    wrong = {item.id for item in beliefs} - {item.id for item in right.values()}
    return JudgedBeliefs(stamp, tuple(sorted(wrong)), tuple(sorted(lying - set(right))))
