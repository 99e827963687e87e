"""World objects and places as rows of the store and back, and which changes are worth a row of history."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from estimation.geometry.places import Place, Places
from world_model.state import WorldObject

COLUMNS = "numbers, existence, lost, last_seen, first_seen, attributes, behaviors, region"
"""In the order of `encode` and `decode`."""
NUMBERS = 24  # Position (3), velocity (3), covariance (9), process noise (9)

MOVED = 0.05  # m: a smaller step is no event, unless it exceeds the standard deviation
CHANGED = 0.1  # Of a probability
SPREAD = 4.0  # Ratio of variances
SEEN_AGAIN = 60.0  # s: as often, at most, history notes that nothing has changed
OFTENEST = 0.5  # s: history of something that moves has a row at most as often
DRIFT = 0.01  # Existence that wanes by less, with nothing else new, is not written again
CERTAIN = 1e-6
QUANTITIES = "quantities"  # Beside the behaviours, which it is none of: stores of before have none


@dataclass
class Written:
    """What the store has of one object. `latest` is the newest, `row` the one in `current`, `noted` the newest in
    `history`, at `noted_at`; `rows` counts those; `text` is the JSON of `row`'s attributes, `mark` that of its row."""

    key: int
    latest: WorldObject
    row: WorldObject
    noted: WorldObject
    noted_at: float
    rows: int
    text: str
    mark: int


def encode(item: WorldObject, digits: int = 7, text: str = "") -> tuple[Any, ...]:
    """Values for `COLUMNS`. digits : of attributes' probabilities. text : of the attributes, where it is known."""
    numbers = b"".join(
        np.asarray(array, "<f8").tobytes()
        for array in (item.position, item.velocity, item.covariance, item.process_noise)
    )
    state = float(item.existence), bool(item.lost), float(item.last_seen), float(item.first_seen)
    region = None if item.region is None else json.dumps(item.region)
    text = text or _attributes_text(item.attributes, digits)
    return numbers, *state, text, behaviors_text(item), region


def _attributes_text(attributes: Mapping[str, Mapping[str, float]], digits: int) -> str:
    """JSON of attribute distributions; values that are practically excluded are left out."""
    told = {
        name: {value: round(p, digits) for value, p in values.items() if p > CERTAIN}
        for name, values in attributes.items()
    }
    return json.dumps(told, separators=(",", ":"))


def decode(object_id: str, row: tuple[Any, ...]) -> WorldObject:
    """The object of a row with `COLUMNS`. Raises ValueError, KeyError or TypeError where it is damaged."""
    numbers, existence, lost, last_seen, first_seen, attributes, behaviors, region = row
    values = np.frombuffer(numbers, "<f8").astype(np.float64)
    if values.shape != (NUMBERS,):
        raise ValueError(f"{NUMBERS} numbers expected, got {values.shape}")
    box = None if region is None else json.loads(region)
    shares = json.loads(behaviors)
    quantities = {name: (float(m), float(v)) for name, (m, v) in shares.pop(QUANTITIES, {}).items()}
    return WorldObject(
        object_id,
        values[:3],
        values[3:6],
        values[6:15].reshape(3, 3),
        json.loads(attributes),
        float(existence),
        bool(lost),
        float(last_seen),
        float(first_seen),
        shares,
        None if box is None else tuple((float(low), float(high)) for low, high in box),  # type: ignore[arg-type]
        process_noise=values[15:].reshape(3, 3),
        quantities=quantities,
    )


def behaviors_text(item: WorldObject) -> str:
    """JSON of the behaviours' probabilities, and of the quantities where some were measured."""
    given: dict[str, Any] = {value: round(p, 7) for value, p in item.behaviors.items()}
    if item.quantities:
        given[QUANTITIES] = {name: [mean, variance] for name, (mean, variance) in item.quantities.items()}
    return json.dumps(given, separators=(",", ":"))


def is_drift(before: WorldObject, item: WorldObject) -> bool:
    """Whether only time has passed between two versions of an object: it need not be written again.

    Late evidence, or another hypothesis, may put a thing elsewhere without its having been seen since.
    """
    return (
        before.last_seen == item.last_seen
        and float(np.linalg.norm(item.position - before.position)) <= MOVED
        and before.lost == item.lost
        and abs(before.existence - item.existence) < DRIFT
        and before.attributes == item.attributes
    )


def event(noted: WorldObject, noted_at: float, item: WorldObject, stamp: float) -> str:
    """What has happened to an object since history last noted it; "" where nothing worth a row has."""
    if item.lost != noted.lost:
        return "lost" if item.lost else "found"
    if _changed(noted.attributes, item.attributes) or abs(noted.existence - item.existence) > CHANGED:
        return "changed"
    if stamp - noted_at < OFTENEST:
        return ""
    step = item.position - noted.position
    variances, then = item.covariance.diagonal(), noted.covariance.diagonal()
    squared = float(step @ step)
    if squared > MOVED**2 or squared > float(then.sum()) > 0.0:
        return "moved"
    if float(variances.sum()) * SPREAD < float(then.sum()):
        return "changed"
    return "seen" if item.last_seen > noted.last_seen and stamp - noted_at >= SEEN_AGAIN else ""


def _changed(before: Mapping[str, Mapping[str, float]], now: Mapping[str, Mapping[str, float]]) -> bool:
    return any(
        name not in before
        or any(abs(p - before[name].get(value, 0.0)) > CHANGED for value, p in values.items())
        for name, values in now.items()
    )


# Rooms and furniture are rows of history of an object without a name, in a run before all runs: stores of before are
# read as they are, and marks, snapshots and repair hold for them as for any row.
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
    return encode(empty, text=text)
