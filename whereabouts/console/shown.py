"""What the page shows, as plain data: one form for the running suite and for a store.

A shown world is a mapping with `stamp` (s), `robot` (x, y, yaw or None), `people`, `things`, `tasks`, `goals`, `health`
and `map` (where the picture lies: x0, x1, y0, y1 in m, and its number). Positions are metres in the map's frame.
"""

from __future__ import annotations

import io
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from estimation.checks import FloatArray
from estimation.geometry.places import LIKELY
from world_model.state import WorldObject, most_probable

Shown = dict[str, Any]
FREE_BELOW, OCCUPIED_FROM = 25, 65
FREE, OCCUPIED = (128, 136, 144, 40), (96, 110, 124, 255)
"""Red, green, blue and opacity; what is unknown is clear, so that the picture fits a light and a dark page."""
MOST_CELLS = 4_000_000
"""Larger maps are thinned out before they are sent."""


def empty() -> Shown:
    """A world of which nothing is known."""
    return {
        "stamp": None, "robot": None, "people": [], "things": [], "tasks": [], "goals": [], "health": [],
        "map": None, "search": None,
    }  # fmt: skip


def thing(item: WorldObject) -> Shown:
    """An object as a store has it."""
    return _thing(
        item.id, item.attributes, item.position, item.covariance,
        existence=item.existence, lost=item.lost, place=item.place, sure=item.place_probability,
        seen=item.last_seen,
    )  # fmt: skip


def thing_of_message(item: Any) -> Shown:
    """The same of a `whereabouts_msgs/WorldObject`."""
    point = item.pose.pose.position
    known = {attribute.name: attribute.discrete for attribute in item.properties}
    return _thing(
        item.id,
        {name: _mapping(values) for name, values in {**known, "class": item.class_distribution}.items()},
        np.array([point.x, point.y, point.z]),
        np.asarray(item.pose.covariance, dtype=float).reshape(6, 6)[:3, :3],
        existence=float(item.existence_probability),
        lost=bool(item.lost),
        place=str(item.place),
        sure=float(item.place_probability),
        seen=item.last_seen.sec + 1e-9 * item.last_seen.nanosec,
    )


def _mapping(distribution: Any) -> dict[str, float]:
    return dict(zip(distribution.values, map(float, distribution.probabilities), strict=False))


def _thing(
    name: str,
    attributes: Mapping[str, Mapping[str, float]],
    position: FloatArray,
    covariance: FloatArray,
    **known: Any,
) -> Shown:
    classes, colors = attributes.get("class", {}), attributes.get("color", {})
    kind, color = most_probable(classes), most_probable(colors)
    (a, b), (_, c) = covariance[:2, :2].tolist()
    # The larger eigenvalue.
    spread = math.sqrt(max(0.5 * (a + c) + math.hypot(0.5 * (a - c), b), 0.0))
    return {
        "id": name,
        "class": kind,
        "class_probability": round(float(classes.get(kind, 0.0)), 3),
        "color": color if colors.get(color, 0.0) > LIKELY else "",
        **{key: round(float(value), 3) for key, value in zip("xyz", position, strict=True)},
        "spread": round(spread, 3),
        "existence": round(float(known["existence"]), 3),
        "lost": known["lost"],
        "place": known["place"],
        "place_probability": round(float(known["sure"]), 3),
        "last_seen": round(float(known["seen"]), 3),
    }


def person(target: Any, pose: FloatArray) -> Shown:
    """A `whereabouts_msgs/Target`. pose : (3,) of its frame in the map's."""
    x, y = moved(pose, target.position.x, target.position.y)
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    vx, vy = float(target.velocity.x), float(target.velocity.y)
    return {
        "label": int(target.label), "x": x, "y": y, "vx": round(cosine * vx - sine * vy, 3),
        "vy": round(sine * vx + cosine * vy, 3), "hidden": bool(target.occluded), "path": [], "goals": [],
    }  # fmt: skip


def moved(pose: FloatArray, x: float, y: float) -> tuple[float, float]:
    """A point of a frame that lies at `pose` (3,), in m, to the millimetre."""
    cosine, sine = math.cos(pose[2]), math.sin(pose[2])
    return round(float(pose[0] + cosine * x - sine * y), 3), round(float(pose[1] + sine * x + cosine * y), 3)


def map_picture(cells: NDArray[np.int8], resolution: float, x: float, y: float) -> tuple[bytes, list[float]]:
    """PNG of a grid and the box it covers.

    cells : (H, W) from 0 to 100, -1 unknown, the first row at the lower edge. resolution : m. x, y : of its corner, m.
    """
    height, width = cells.shape
    step = max(1, math.ceil(math.sqrt(cells.size / MOST_CELLS)))
    if step > 1:
        # A wall of one cell has to stay.
        rows, columns = -(-height // step) * step, -(-width // step) * step
        padded = np.full((rows, columns), -1, dtype=np.int8)
        padded[:height, :width] = cells
        cells = padded.reshape(rows // step, step, columns // step, step).max(axis=(1, 3))
    colors = np.zeros((*cells.shape, 4), dtype=np.uint8)
    colors[(cells >= 0) & (cells < FREE_BELOW)] = FREE
    colors[cells >= OCCUPIED_FROM] = OCCUPIED
    out = io.BytesIO()
    Image.fromarray(colors[::-1]).save(out, format="PNG")
    size = step * resolution
    return out.getvalue(), [x, x + size * cells.shape[1], y, y + size * cells.shape[0]]
