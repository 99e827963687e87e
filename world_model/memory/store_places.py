"""Rooms and furniture as the store keeps them: rows of history of an object without a name, in a run before all runs.

So they need no table of their own: stores of before are read and written as they are, and marks, snapshots and repair
hold for them as for any row.
"""

from __future__ import annotations

import json
import math
from functools import lru_cache
from typing import Any

import numpy as np

from estimation.geometry.places import Place, Places
from world_model.memory.store_rows import encode
from world_model.state import WorldObject

RUN = -1  # The run of what belongs to the home and not to a recording
NAME = ""
EVENT = "places"
KEPT = 31  # Level of rows that are never thinned out


def places_text(places: Places) -> str:
    """JSON of all places, the same for the same places."""
    return json.dumps(
        {"frame": places.frame, "places": {place.name: _entry(place) for place in places}},
        separators=(",", ":"),
    )


def _entry(place: Place) -> dict[str, Any]:
    entry: dict[str, Any] = {"polygon": place.polygon.tolist(), "kind": place.kind, "type": place.type}
    if all(map(math.isfinite, place.height)):
        entry["height"] = list(place.height)
    elif any(map(math.isfinite, place.height)):
        entry["height"] = [max(place.height[0], -1e9), min(place.height[1], 1e9)]
    return {**entry, "preposition": place.preposition}


@lru_cache(8)
def places_of(text: str) -> Places:
    """Places of their JSON. Raises InputError or ValueError where it is none."""
    return Places.from_mapping(json.loads(text))


def places_row(text: str, stamp: float) -> tuple[Any, ...]:
    """Values of a row of history, from the numbers on."""
    nothing = np.zeros((3, 3))
    empty = WorldObject(NAME, np.zeros(3), np.zeros(3), nothing, {}, 0.0, False, stamp, stamp)
    return encode(empty, text)
