"""Objects, what is seen of them, and what is asked about them, as shapes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from whereabouts.viewer.drawable import Boxes, Color, Lines, Points, Shape, TextNote, Value
from whereabouts.viewer.fields import matrix_of, most_probable, rows, xyz
from world_model.describing import LIKELY
from world_model.state import MOVED_ON, SURE

PRESENT: Color = (40, 120, 210)
LOST: Color = (215, 60, 60)
SEEN: Color = (240, 150, 20)
VIEW: Color = (200, 200, 120)
TASK: Color = (160, 60, 200)
# Of an object whose extent nobody knows, and of what is seen of it.
UNKNOWN_SIZE = 0.15
FAR = 50.0


def world(message: Any, path: str, name: str) -> Iterator[Shape]:
    """whereabouts_msgs/WorldState: a box with its symbols for each object; the lost ones in red, over their region."""
    centers, sizes, colors, labels = [], [], [], []
    for item in message.objects:
        place, size = item.pose.pose.position, xyz(item.size)
        if item.lost and any(xyz(item.region.size)):
            place, size = item.region.center.position, xyz(item.region.size)
        centers.append(xyz(place))
        sizes.append(tuple(extent or UNKNOWN_SIZE for extent in size))
        colors.append(LOST if item.lost else PRESENT)
        labels.append(label_of(item))
    yield Boxes(f"{path}/{name}", rows(centers), rows(sizes), tuple(colors), tuple(labels))  # type: ignore[arg-type]
    yield Value(f"plots/{name}, expected", float(message.expected_count))
    yield Value(f"plots/{name}, believed", float(len(centers)))


def label_of(item: Any) -> str:
    """An object in words: what it is, its symbol, place, and how probable it is."""
    words = [_named(item)]
    if item.place:
        words.append(f"at {item.place}")
    if item.lost:
        words.append("lost")
    return f"{'; '.join(words)}, p = {float(item.existence_probability):.2f}"


def _named(item: Any) -> str:
    """ "the red cup (cup-1)", or the symbol with its predicates where the class is not known."""
    kind, probability = most_probable(item.class_distribution)
    predicates = [str(word) for word in item.predicates]
    if not kind or probability < LIKELY:
        return ", ".join([str(item.id), *predicates])
    share = "" if probability >= SURE else f", {probability:.2f}"
    return f"the {' '.join([*(word for word in predicates if word not in (kind, MOVED_ON)), kind])}{share} ({item.id})"


def hypotheses(message: Any) -> Iterator[Shape]:
    """whereabouts_msgs/WorldHypotheses: how many there are, and how far the best is believed."""
    yield Value("plots/hypotheses", float(len(message.hypotheses)))
    if len(message.hypotheses):
        yield Value("plots/best hypothesis", float(message.hypotheses[0].probability))


def evidence(message: Any, path: str, name: str) -> Iterator[Shape]:
    """whereabouts_msgs/WorldEvidence: what was detected, and the view it was detected in."""
    labels = []
    for item in message.objects:
        classes = [a.discrete for a in item.attributes if a.name == "class"]
        labels.append(most_probable(classes[0])[0] if classes else "")
    seen = [xyz(item.pose.pose.position) for item in message.objects]
    yield Points(f"{path}/{name}", rows(seen), SEEN, 0.05, tuple(labels))
    strips = tuple(_sector(view) for view in message.field_of_view)
    yield Lines(f"{path}/{name}/view", strips, VIEW, 0.02)


def _sector(view: Any) -> np.ndarray:
    """Outline (N, 3) of a field of view in the sensor's x-y plane."""
    half = 0.5 * min(float(view.horizontal_angle), 2.0 * np.pi)
    angles = np.linspace(-half, half, 33)
    arc = min(float(view.range_max), FAR) * np.column_stack((np.cos(angles), np.sin(angles), np.zeros(33)))
    outline = np.vstack((np.zeros(3), arc, np.zeros(3))) if half < np.pi - 1e-3 else arc
    matrix = matrix_of(view.pose)
    return np.asarray(outline @ matrix[:3, :3].T + matrix[:3, 3])


def task(message: Any, path: str) -> Iterator[Shape]:
    """whereabouts_msgs/VerificationTask: the region to look into, and why."""
    region = message.region
    sizes = tuple(extent or UNKNOWN_SIZE for extent in xyz(region.size))
    center = rows([xyz(region.center.position)])
    yield Boxes(f"{path}/verification", center, rows([sizes]), (TASK,), (f"look for {message.object_id}",))  # type: ignore[list-item]
    yield TextNote("log/maintenance", str(message.reason))
