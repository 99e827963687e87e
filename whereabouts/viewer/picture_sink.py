"""Draws shapes from above into a picture: the last state of each, with matplotlib."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from whereabouts.viewer.drawable import Array, Boxes, Lines, PlaceShape, Points, Shape, Value


class PictureSink:
    """Keeps what is shown last at each path until it is asked for a picture. A context manager like the other."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._places: dict[str, Array] = {}
        self._shapes: dict[str, Points | Lines | Boxes] = {}
        self._values: dict[str, list[tuple[float, float]]] = {}

    def __enter__(self) -> PictureSink:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            self.write()

    def draw(self, stamp: float, shapes: Iterable[Shape]) -> None:
        """Shapes that hold from `stamp` (s) on."""
        for shape in shapes:
            if isinstance(shape, PlaceShape):
                self._places[shape.path] = shape.matrix
            elif isinstance(shape, Value):
                self._values.setdefault(shape.path, []).append((stamp, shape.value))
            elif isinstance(shape, Points | Lines | Boxes):
                self._shapes[shape.path] = shape

    def transform(self, path: str) -> Array:
        """(4, 4) from the frame a shape's path ends in to the map."""
        parts, matrix = path.split("/")[:-1], np.eye(4)
        for count in range(1, len(parts) + 1):
            matrix = matrix @ self._places.get("/".join(parts[:count]), np.eye(4))
        return matrix

    def write(self) -> None:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(11.0, 7.0), dpi=120, layout="constrained")
        if self._values:
            grid = figure.add_gridspec(1, 2, width_ratios=(3, 1))
            side = grid[1].subgridspec(len(self._values), 1)
            for index, (name, series) in enumerate(sorted(self._values.items())):
                self._plot(figure.add_subplot(side[index]), name.rpartition("/")[2], np.array(series))
            axes = figure.add_subplot(grid[0])
        else:
            axes = figure.add_subplot()
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        for path, shape in self._shapes.items():
            self._add(axes, shape, self.transform(path))
        figure.savefig(self._path, format="png")

    def _plot(self, axes: Any, name: str, series: Array) -> None:
        axes.step(series[:, 0] - series[0, 0], series[:, 1], where="post", linewidth=1.0)
        axes.set_title(name, fontsize=8, loc="left")
        axes.tick_params(labelsize=7)
        axes.set_ylim(bottom=0.0)

    def _add(self, axes: Any, shape: Points | Lines | Boxes, matrix: Array) -> None:
        colors = np.array(shape.colors, dtype=np.float64).reshape(-1, 3) / 255.0
        if isinstance(shape, Lines):
            for index, strip in enumerate(shape.strips):
                points = _moved(strip, matrix)
                axes.plot(
                    points[:, 0], points[:, 1], color=colors[min(index, len(colors) - 1)], linewidth=1.2
                )
            return
        if isinstance(shape, Points):
            points = _moved(shape.positions, matrix)
            axes.scatter(
                points[:, 0], points[:, 1], s=(40.0 * shape.radius) ** 2 + 0.5, c=colors, linewidths=0
            )
        else:
            points = _moved(shape.centers, matrix)
            axes.scatter(points[:, 0], points[:, 1], s=40.0, marker="s", c=colors)
        for point, text in zip(points, shape.labels, strict=False):
            axes.annotate(text, point[:2], fontsize=6.5, xytext=(4, 4), textcoords="offset points")


def _moved(points: Array, matrix: Array) -> Array:
    """Points (N, 3) taken through a (4, 4)."""
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])
