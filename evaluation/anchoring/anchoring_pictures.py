"""Figures of chapter 2: what is detected and what the world model says, on the table and among ants."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Ellipse

from evaluation.anchoring.anchoring_scenes import AntRun
from evaluation.anchoring.anchoring_table import Shot
from evaluation.drawing import saved
from world_model import ObjectEvidence, WorldObject

TABLE_FIGURES: dict[str, tuple[tuple[str, str, bool], ...]] = {
    "figure-2-3": (("detections", "before", True), ("world state", "before", False)),
    "figure-2-4": (
        ("world state before", "moved", False),
        ("detections right after", "at once", True),
        ("world state 2 s later", "exchanged", False),
    ),
    "figure-2-5": (
        ("a second green box", "second box", False),
        ("two detections", "side by side", True),
        ("one detection", "as one", True),
        ("world state", "false box", False),
    ),
}
CUP_FIGURES = {
    f"figure-2-{number}": tuple((when, f"{run}, {when}", False) for when in ("before", "in part", "in view"))
    for number, run in ((7, "new cups likely"), (8, "new cups unlikely"))
}
GATE = 9.21  # squared deviations in a 99 % ellipse


def draw_shots(
    folder: Path, figures: Mapping[str, Sequence[tuple[str, str, bool]]], shots: Mapping[str, Shot]
) -> list[Path]:
    """One picture of each of `figures`: {name: (title of a panel, name of a moment, detections or world state)}."""
    paths = []
    for name, panels in figures.items():
        figure = Figure(figsize=(3.4 * len(panels), 3.6), layout="constrained")
        for axes, (title, moment, detections) in zip(
            np.atleast_1d(figure.subplots(1, len(panels))), panels, strict=True
        ):
            (_detections if detections else _world)(axes, shots[moment])
            axes.set(title=title, xlabel="x, m", ylabel="y, m", aspect="equal", xlim=(-1, 1), ylim=(-1, 1))
        paths.append(saved(figure, folder / f"{name}.png", 100))
    return paths


def _detections(axes: Axes, shot: Shot) -> None:
    for number, seen in enumerate(sorted(shot.evidence, key=_right_to_left)):
        said = _likeliest(seen)
        x, y = np.asarray(seen.position)[:2].tolist()
        axes.plot(x, y, "s", color=said.get("color", "gray"), markersize=9, alpha=0.6)
        words = "\n".join(f"{value} ({seen.attributes[name][value]:.2f})" for name, value in said.items())
        _label(axes, words, x, y, number)


def _likeliest(seen: ObjectEvidence) -> dict[str, str]:
    return {name: max(values, key=lambda v: values[v]) for name, values in seen.attributes.items()}


def _world(axes: Axes, shot: Shot) -> None:
    for number, item in enumerate(sorted(shot.state.objects, key=_right_to_left)):
        place = draw_object(axes, item, item.most_probable("color") or "gray")
        said = [item.id, *(word for word in map(item.most_probable, ("size", "shape", "class")) if word)]
        _label(axes, "\n".join(said), *place, number)


def draw_object(axes: Axes, item: WorldObject, color: str) -> tuple[float, float]:
    """A dot in a colour with the 99 % ellipse around it; returns where, x and y."""
    x, y = item.position[:2].tolist()
    values, vectors = np.linalg.eigh(item.covariance[:2, :2])
    turn = float(np.degrees(np.arctan2(vectors[1, 0], vectors[0, 0])))
    axes.plot(x, y, "o", color=color, markersize=7, alpha=0.6)
    axes.add_patch(Ellipse((x, y), *(2.0 * np.sqrt(GATE * values)), angle=turn, fill=False))
    return x, y


def _right_to_left(thing: Any) -> float:
    return -float(thing.position[0])


def _label(axes: Axes, words: str, x: float, y: float, number: int) -> None:
    """To the right and to the left in turns: what touches is told one after the other."""
    offset, side = ((7, -4), "left") if number % 2 == 0 else ((-7, -4), "right")
    axes.annotate(words, (x, y), xytext=offset, textcoords="offset points", fontsize=7, ha=side)


def draw_ants(folder: Path, run: AntRun, side: float) -> Path:
    """Figure 2.10: estimated trajectories; side : of the box, m."""
    figure = Figure(figsize=(5.0, 5.0), layout="constrained")
    axes = figure.add_subplot()
    for path in run.paths.values():
        axes.plot(*(100.0 * np.array(path)).T, linewidth=0.8)
    half = 50.0 * side
    axes.set(xlabel="x, cm", ylabel="y, cm", aspect="equal", xlim=(-half, half), ylim=(-half, half))
    return saved(figure, folder / "figure-2-10-ants.png", 120)
