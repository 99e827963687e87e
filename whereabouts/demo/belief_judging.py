"""What the world model believes, beside where things truly are."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from whereabouts.demo.judging import SAME
from whereabouts.demo.reading import BELIEVED, NOBODY
from whereabouts.simulation.home.apartment_day import THINGS
from world_model import WorldObject
from world_model.state import MOVED_ON

Array = NDArray[np.float64]


@dataclass(frozen=True)
class JudgedBeliefs:
    """At one moment. wrong : ids that are believed to be where no such thing lies. unknown : things nobody knows of."""

    stamp: float
    wrong: tuple[str, ...]
    unknown: tuple[str, ...]


def believed(objects: Iterable[WorldObject]) -> list[WorldObject]:
    """Things that are said to be somewhere: neither lost nor probably gone, and no people."""
    return [
        item
        for item in objects
        if item.existence >= BELIEVED
        and not item.lost
        and MOVED_ON not in item.predicates
        and item.most_probable("class") not in NOBODY
    ]


def judged(objects: Iterable[WorldObject], things: Mapping[str, Array | None], stamp: float) -> JudgedBeliefs:
    """Beliefs at a stamp, s. things : where each truly lies, None while it is carried.

    A belief is right where a thing of its class lies within SAME; each thing makes one belief right.
    """
    known = {item.id: item for item in believed(objects)}
    pairs = sorted(
        (float(np.linalg.norm(item.position - spot)), name, item.id)
        for name, spot in things.items()
        if spot is not None
        for item in known.values()
        if item.most_probable("class") == THINGS[name][0].kind
    )
    right: dict[str, str] = {}
    for away, name, own in pairs:
        if away <= SAME and name not in right and own in known:
            right[name] = own
            del known[own]
    lying = {name for name, spot in things.items() if spot is not None}
    return JudgedBeliefs(stamp, tuple(sorted(known)), tuple(sorted(lying - set(right))))
