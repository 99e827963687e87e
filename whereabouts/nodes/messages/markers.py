"""Markers for RViz, points and colours, as all nodes make them."""

from __future__ import annotations

from collections.abc import Iterable

from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker

from estimation.checks import FloatArray as Array

Rgb = tuple[float, float, float]
COLOURS: tuple[Rgb, ...] = (
    (0.1, 0.5, 0.9), (0.9, 0.5, 0.1), (0.2, 0.7, 0.2), (0.8, 0.2, 0.3), (0.6, 0.3, 0.8), (0.5, 0.4, 0.3),
)  # fmt: skip
"""Of labels, over and over."""


def colour(rgb: Rgb, opacity: float = 1.0) -> ColorRGBA:
    """Red, green and blue in [0, 1], as a message."""
    return ColorRGBA(r=rgb[0], g=rgb[1], b=rgb[2], a=opacity)


def marker(
    header: Header, name: str, shape: int, paint: ColorRGBA, width: float = 0.0, number: int = 0
) -> Marker:
    """A marker of `width` m in all directions, known by name and number."""
    made = Marker(header=header, ns=name, id=number, type=shape, action=Marker.ADD, color=paint)
    made.scale.x = made.scale.y = made.scale.z = width
    made.pose.orientation.w = 1.0
    return made


def point(at: Array, z: float = 0.0) -> Point:
    """A place (2 | 3,) m; z : where it has none of its own."""
    return Point(x=float(at[0]), y=float(at[1]), z=float(at[2]) if len(at) == 3 else z)


def vector(values: Iterable[float]) -> Vector3:
    """Three numbers (3,) as a message."""
    return Vector3(**dict(zip("xyz", map(float, values), strict=True)))
