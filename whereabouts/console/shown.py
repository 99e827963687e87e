"""What the page shows, as plain data: one form for the running suite and for a store.

A shown world is a mapping with `stamp` (s), `robot` (x, y, yaw or None), `people`, `things`, `tasks`, `goals`, `health`
and `map` (where the picture lies: x0, x1, y0, y1 in m, and its number). Positions are metres in the map's frame.
"""

from __future__ import annotations

import io
import math
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from estimation.checks import FloatArray
from estimation.geometry.grid import FREE_SHARE, OCCUPIED_SHARE
from estimation.geometry.places import LIKELY
from world_model.state import WorldObject, most_probable

Shown = dict[str, Any]
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
    """An object."""
    classes, colors = item.attributes.get("class", {}), item.attributes.get("color", {})
    kind, color = most_probable(classes), most_probable(colors)
    (a, b), (_, c) = item.covariance[:2, :2].tolist()
    # The larger eigenvalue.
    spread = math.sqrt(max(0.5 * (a + c) + math.hypot(0.5 * (a - c), b), 0.0))
    return {
        "id": item.id,
        "class": kind,
        "class_probability": round(float(classes.get(kind, 0.0)), 3),
        "color": color if colors.get(color, 0.0) > LIKELY else "",
        **{key: round(float(value), 3) for key, value in zip("xyz", item.position, strict=True)},
        "spread": round(spread, 3),
        "existence": round(float(item.existence), 3),
        "lost": bool(item.lost),
        "place": str(item.place),
        "place_probability": round(float(item.place_probability), 3),
        "last_seen": round(float(item.last_seen), 3),
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
    colors[(cells >= 0) & (cells < 100 * FREE_SHARE)] = FREE
    colors[cells >= 100 * OCCUPIED_SHARE] = OCCUPIED
    out = io.BytesIO()
    Image.fromarray(colors[::-1]).save(out, format="PNG")
    size = step * resolution
    return out.getvalue(), [x, x + size * cells.shape[1], y, y + size * cells.shape[0]]
