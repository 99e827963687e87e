"""Messages of `motion_predictor`: targets in, paths, markers and occupied points out; nothing here decides anything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from nav_msgs.msg import OccupancyGrid
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.grid import OCCUPIED_SHARE
from estimation.geometry.poses import pose_to_matrix
from tracking.intentions import Prediction
from tracking.intentions.observations import at_times
from whereabouts.nodes.messages.conversions import pose_from_message
from whereabouts.nodes.messages.markers import COLOURS, colour, marker, point
from whereabouts.nodes.messages.stamps import duration_message, seconds
from whereabouts.nodes.messages.world_reading import grid_values
from whereabouts_msgs.msg import (
    PredictedAlternative,
    PredictedPath,
    PredictedPathArray,
    PredictedPoint,
    TargetArray,
)

# A ring of points around a path's point stands for a person in a costmap.
RING = np.column_stack((np.cos(np.arange(8) * np.pi / 4), np.sin(np.arange(8) * np.pi / 4)))


def people_from_message(
    message: TargetArray, least: float, transform: Array
) -> tuple[dict[int, Array], list[int]]:
    """Positions (2,) by label of people that are seen now, in the frame `transform` leads to; labels of hidden ones.

    Targets with a class distribution must be a person with probability `least`.
    Raises InputError: a position that is not finite, or a label that is there twice.
    """
    people: dict[int, Array] = {}
    hidden: list[int] = []
    for target in message.targets:
        if target.occluded:
            hidden.append(int(target.label))
            continue
        classes = target.class_distribution
        known = dict(zip(classes.values, classes.probabilities, strict=False))
        if known and known.get("person", 0.0) < least:
            continue
        p = target.position
        position = (transform @ [p.x, p.y, p.z, 1.0])[:2]
        if not np.isfinite(position).all():
            raise InputError(f"target {target.label}: finite position expected, got {p.x}, {p.y}")
        if target.label in people:
            raise InputError(f"target {target.label} is in the message twice")
        people[target.label] = position
    return people, hidden


def occupied_points(grid: OccupancyGrid) -> Array:
    """Centres (K, 2) m of the occupied cells, in the frame of the grid.

    Raises InputError: a resolution that is not above zero, or another number of cells than it says.
    """
    row, column = np.nonzero(grid_values(grid) >= 100 * OCCUPIED_SHARE)
    local = np.column_stack((column + 0.5, row + 0.5)) * grid.info.resolution
    matrix = pose_to_matrix(pose_from_message(grid.info.origin))
    return np.asarray(local @ matrix[:2, :2].T + matrix[:2, 3])


def paths_message(
    header: Header, predictions: Mapping[int, Prediction], horizon: float, interval: float
) -> PredictedPathArray:
    """All predictions, by label, from the header's stamp on."""
    start = seconds(header.stamp)
    message = PredictedPathArray(header=header, horizon=duration_message(horizon))
    for label, told in sorted(predictions.items()):
        path = PredictedPath(label=label)
        path.goals = [point(goal) for goal in told.goals]
        path.goal_probabilities = ((1.0 - told.elsewhere) * told.probabilities).tolist()
        path.points = _points(told.path, told.covariances, start, horizon, interval)
        path.alternatives = [
            PredictedAlternative(
                goal=way.goal, points=_points(way.path, way.covariances, start, horizon, interval)
            )
            for way in told.alternatives
        ]
        message.paths.append(path)
    return message


def markers_message(header: Header, predictions: Mapping[int, Prediction]) -> MarkerArray:
    """A line for every path, and a disc with its probability at every goal that has one."""
    message = MarkerArray(markers=[Marker(header=header, action=Marker.DELETEALL)])
    for label, told in sorted(predictions.items()):
        paths = [told.path, *(way.path for way in told.alternatives)]
        for rank, path in enumerate(paths):
            probability = float((1.0 - told.elsewhere) * told.probabilities[rank])
            paint = colour(COLOURS[label % len(COLOURS)], 0.2 + 0.8 * probability)
            name = f"{label}/{rank}"
            line = marker(header, f"path {name}", Marker.LINE_STRIP, paint, 0.06 if rank == 0 else 0.03)
            line.points = [point(at) for at in path[:, :2]]
            disc = marker(header, f"goal {name}", Marker.CYLINDER, paint, 0.4)
            disc.scale.z = 0.02
            disc.pose.position = point(told.goals[rank])
            text = marker(header, f"text {name}", Marker.TEXT_VIEW_FACING, paint, 0.3)
            text.pose.position = point(told.goals[rank], 0.4)
            text.text = f"{probability:.2f}"
            message.markers += [line, disc, text]
    return message


@dataclass(frozen=True)
class PathMarkers:
    """Which ways of a person count, and where along them: for `horizon` s every `interval` s.

    least : probability of a goal below which the way to it does not count. The most probable one always does.
    """

    horizon: float
    interval: float
    least: float

    def of(self, told: Prediction, start: float) -> list[tuple[float, Array]]:
        """Probability and places (N, 2), m, from `start` s on, of each way; the most probable one first."""
        ways = [(0, told.path), *((way.goal, way.path) for way in told.alternatives)]
        times = start + np.arange(0.0, self.horizon + 1e-9, self.interval)
        return [
            (float(told.probabilities[goal]), at_times(path, times))
            for goal, path in ways
            if goal == 0 or told.probabilities[goal] >= self.least
        ]


def occupancy_points(
    predictions: Mapping[int, Prediction], start: float, ways: PathMarkers, radius: float, height: float
) -> Array:
    """Points (M, 3) m where people will be: places along their ways, and rings of `radius` m around these."""
    parts = [np.zeros((0, 2))]
    for told in predictions.values():
        for _, centres in ways.of(told, start):
            parts += [centres, (centres[:, None] + radius * RING).reshape(-1, 2)]
    flat = np.concatenate(parts)
    return np.column_stack((flat, np.full(len(flat), height)))


def _points(
    path: Array, covariances: Array, start: float, horizon: float, interval: float
) -> list[PredictedPoint]:
    """Points of a path every `interval` s from `start` s to the horizon."""
    after = np.arange(0.0, horizon + 1e-9, interval)
    index = np.searchsorted(path[:, 2], start + after - 1e-6).clip(max=len(path) - 1)
    return [
        PredictedPoint(
            time_from_start=duration_message(float(t)),
            position=point(place),
            covariance=covariances[k].ravel().tolist(),
        )
        for t, place, k in zip(after, at_times(path, start + after), index, strict=True)
    ]
