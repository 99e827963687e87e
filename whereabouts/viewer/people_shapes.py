"""People and where they go, as shapes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from whereabouts.viewer.drawable import Array, Color, Lines, Points, Shape, Value
from whereabouts.viewer.fields import ellipse, rows, xyz

PALETTE: tuple[Color, ...] = (
    (31, 119, 180), (255, 127, 14), (44, 160, 44), (148, 103, 189), (140, 86, 75), (227, 119, 194), (23, 190, 207),
)  # fmt: skip
HIDDEN_SHADE = 0.45
HEIGHT = 0.02


def color_of(label: int, pale: float = 0.0) -> Color:
    """Of a target, the same for as long as it lives; pale from 0 to 1 towards white."""
    red, green, blue = (round(part + pale * (255 - part)) for part in PALETTE[label % len(PALETTE)])
    return red, green, blue


def targets(message: Any, path: str, name: str) -> Iterator[Shape]:
    """whereabouts_msgs/TargetArray: where they are, their extent, and where they are in a second."""
    people = list(message.targets)
    centers = [xyz(item.position) for item in people]
    colors = tuple(color_of(int(item.label), HIDDEN_SHADE if item.occluded else 0.0) for item in people)
    labels = tuple(f"{item.label}, hidden" if item.occluded else f"{item.label}" for item in people)
    shades = np.array(colors, dtype=np.uint8).reshape(-1, 3)
    yield Points(f"{path}/{name}", rows(centers), shades, 0.12, labels)
    outlines = [ellipse(c, item.extent, 2.0) for c, item in zip(centers, people, strict=True)]
    yield Lines(f"{path}/{name}/extent", tuple(outlines), colors, HEIGHT)
    ways: list[Array] = []
    for center, item in zip(centers, people, strict=True):
        velocity = xyz(item.velocity)
        ways.append(rows([center, tuple(c + v for c, v in zip(center, velocity, strict=True))]))  # type: ignore[list-item]
    yield Lines(f"{path}/{name}/velocity", tuple(ways), colors, 0.04)
    yield Value(f"plots/{name}", float(message.expected_count))


def predictions(message: Any, path: str) -> Iterator[Shape]:
    """whereabouts_msgs/PredictedPathArray: the probable path of each, the others paler, goals with probabilities."""
    strips, colors, goals, labels = [], [], [], []
    for item in message.paths:
        options = [(0, item.points), *((int(other.goal), other.points) for other in item.alternatives)]
        probabilities = [float(p) for p in item.goal_probabilities]
        for goal, points in options:
            share = probabilities[goal] if goal < len(probabilities) else 0.0
            strips.append(rows([xyz(point.position) for point in points]))
            colors.append(color_of(int(item.label), 0.7 * (1.0 - share)))
        for place, share in zip(item.goals, probabilities, strict=False):
            goals.append(xyz(place))
            labels.append(f"{item.label}: {share:.2f}")
    yield Lines(f"{path}/predicted_paths", tuple(strips), tuple(colors), 0.03)
    yield Points(f"{path}/goals", rows(goals), (200, 140, 20), 0.08, tuple(labels))
