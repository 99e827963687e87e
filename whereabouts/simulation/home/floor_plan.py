"""An apartment of five rooms around a hall: walls, doors, furniture; for a planar scanner and for a camera.

Rooms and furniture come from `defaults/apartment.yaml`, which is also what the world model is told about the home.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np

from estimation.geometry.places import Places
from whereabouts.simulation.shapes import Array, Shapes, box, circle, joined

LASER_HEIGHT = 0.25
CAMERA_HEIGHT = 1.25
CEILING = 2.5
DOOR = 0.95
"""m, width of a door."""
# Middle of each opening, the wall it is in and its width: (x, y, along x or y, m).
OPENINGS = (
    (1.2, 1.1, "x", DOOR),  # hall, kitchen
    (3.9, 1.1, "x", 1.4),  # hall, living room
    (7.4, 1.1, "x", DOOR),  # hall, living room
    (2.6, 4.2, "y", DOOR),  # kitchen, living room
    (0.6, -1.1, "x", DOOR),  # hall, office
    (3.9, -1.1, "x", DOOR),  # hall, bedroom
    (7.4, -1.1, "x", DOOR),  # hall, bathroom
)
# Tall furniture nothing is put on: x0, y0, x1, y1, height.
TALL = (
    (-1.6, 4.65, -0.95, 5.3, 1.8),  # fridge
    (2.3, -5.1, 2.9, -3.2, 2.0),  # wardrobe
)
# Further furniture that only stands about: x0, y0, x1, y1, height.
LOW = (
    (4.9, 1.15, 6.4, 1.5, 0.5),  # bench of the television
    (7.6, 4.9, 8.3, 5.6, 0.42),  # armchair
    (8.0, -3.7, 8.6, -2.2, 0.55),  # bathtub
    (6.5, -2.7, 6.85, -2.1, 0.85),  # washbasin
)
ON_LEGS = ("kitchen_table", "low_table", "desk")
LEG = 0.03


@dataclass(frozen=True)
class Apartment:
    """The building.

    outlines : what the planar scanner hits. blocks (N, 6) : boxes x0, y0, z0, x1, y1, z1 in m that hide things from a
    camera. walls (W, 4) : segments.
    """

    places: Places
    outlines: Shapes
    blocks: Array
    walls: Array


def places_file() -> Path:
    """Rooms and furniture, as the parameter `places_file` takes it."""
    return Path(str(files("whereabouts.simulation") / "defaults" / "apartment.yaml"))


def apartment() -> Apartment:
    """The apartment, empty of people and things."""
    places = Places.load(places_file())
    walls = _walls(places)
    parts = [Shapes(walls)]
    blocks = [_upright(wall) for wall in walls]
    for name, place in places.by_name.items():
        if place.kind != "furniture":
            continue
        (x0, y0), (x1, y1) = place.polygon.min(0), place.polygon.max(0)
        top = place.height[0]
        if name in ON_LEGS:
            parts += [circle(x, y, LEG) for x in (x0 + 0.06, x1 - 0.06) for y in (y0 + 0.06, y1 - 0.06)]
            blocks.append([x0, y0, top - 0.05, x1, y1, top])
        else:
            parts.append(_outline(x0, y0, x1, y1))
            blocks.append([x0, y0, 0.0, x1, y1, top])
    for x0, y0, x1, y1, height in (*TALL, *LOW):
        parts.append(_outline(x0, y0, x1, y1))
        blocks.append([x0, y0, 0.0, x1, y1, height])
    return Apartment(places, joined(parts), np.array(blocks, dtype=np.float64), walls)


def _outline(x0: float, y0: float, x1: float, y1: float) -> Shapes:
    return box(x1 - x0, y1 - y0, (0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.0))


def _upright(wall: Array) -> list[float]:
    """A wall as a thin box."""
    x, y = sorted((wall[0], wall[2])), sorted((wall[1], wall[3]))
    return [x[0] - 0.02, y[0] - 0.02, 0.0, x[1] + 0.02, y[1] + 0.02, CEILING]


def _walls(places: Places) -> Array:
    """(W, 4) sides of all rooms, without the doors."""
    pieces: set[tuple[float, float, float, float]] = set()
    for place in places.by_name.values():
        if place.kind != "room":
            continue
        corners = place.polygon
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            (x0, y0), (x1, y1) = np.minimum(a, b), np.maximum(a, b)
            along = "x" if y0 == y1 else "y"
            start, end, level = (x0, x1, y0) if along == "x" else (y0, y1, x0)
            cuts = [start]
            for x, y, way, width in sorted(OPENINGS):
                middle, at = (x, y) if way == "x" else (y, x)
                if way == along and at == level and start < middle < end:
                    cuts += [middle - 0.5 * width, middle + 0.5 * width]
            cuts.append(end)
            for low, high in zip(cuts[::2], cuts[1::2], strict=True):
                piece = (low, level, high, level) if along == "x" else (level, low, level, high)
                pieces.add(tuple(round(float(value), 6) for value in piece))  # type: ignore[arg-type]
    return np.array(sorted(pieces))


def first_hits(blocks: Array, origin: Array, directions: Array) -> Array:
    """Distance (N,) along each ray to the first block, inf where none is met.

    blocks (B, 6) m; origin (3,) m; directions (N, 3), unit vectors. By the slabs of each box.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = 1.0 / directions[:, None, :]
        near = (blocks[None, :, :3] - origin) * inverse
        far = (blocks[None, :, 3:] - origin) * inverse
    enter = np.nanmax(np.minimum(near, far), axis=2)
    leave = np.nanmin(np.maximum(near, far), axis=2)
    met = (leave >= np.maximum(enter, 0.0)) & (enter > 0.0)
    return np.asarray(np.where(met, enter, np.inf).min(axis=1, initial=np.inf))
