"""The pictures of the demo's report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.demo.belief_judging import known
from evaluation.demo.judging import Trajectories
from evaluation.demo.reading import Grid, Said, SaidPrediction, Tracked, Truth
from evaluation.demo.screen import NOBODY
from whereabouts.simulation.home.floor_plan import Apartment
from world_model import WorldObject

Array = NDArray[np.float64]
INK, QUIET, TRUE = "#22303c", "#9aa7b1", "#1b9e77"
COLORS = {"red": "#d62728", "green": "#2ca02c", "blue": "#1f77b4", "white": "#f2f2f2", "black": "#222222"}
LINES = {
    "wheels": ("#b0b0b0", 1.0),
    "scan registration": ("#1f77b4", 1.2),
    "in the map, at the time": ("#ff7f0e", 1.0),
    "loops closed": ("#d62728", 1.6),
}
DPI = 110
HORIZON = 5.0
"""s after a prediction that are shown."""


def canvas(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    """A figure without a display, and its axes (rows, columns)."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=DPI, layout="constrained")
    return figure, figure.subplots(rows, columns, squeeze=False)


def draw_map(path: Path, home: Apartment, said: Said, tracks: Trajectories) -> None:
    """The occupancy grid with the robot's way through it."""
    figure, ((axes,),) = canvas(1, 1, (9.5, 7.6))
    draw_floor(axes, said.grid)
    for name in ("loops closed", "scan registration"):
        if name in tracks.named:
            axes.plot(*tracks.named[name][:, :2].T, color="#d62728", linewidth=1.0, label="the robot's way")
            break
    for name, place in home.places.by_name.items():
        if place.kind == "room":
            low = place.polygon.min(0)
            axes.text(low[0] + 0.12, low[1] + 0.12, name.replace("_", " "), color="#5b6b78", fontsize=9)
    axes.legend(loc="upper left", frameon=False)
    plain(axes, "map after the run")
    figure.savefig(path, format="png")


def draw_trajectories(path: Path, home: Apartment, tracks: Trajectories) -> None:
    """Ways from above, and how far each is off the truth over time."""
    figure, ((above, over),) = canvas(1, 2, (13.0, 5.4))
    draw_building(above, home)
    above.plot(*tracks.truth[:, :2].T, color=TRUE, linewidth=3.0, alpha=0.45, label="truth")
    begin = tracks.stamps[0] if len(tracks.stamps) else 0.0
    for name, poses in tracks.named.items():
        color, width = LINES.get(name, ("black", 1.0))
        above.plot(*poses[:, :2].T, color=color, linewidth=width, label=name)
        over.plot(
            tracks.stamps - begin,
            np.maximum(tracks.errors[name], 1e-3),
            color=color,
            linewidth=width,
            label=name,
        )
    above.legend(loc="lower right", fontsize=8, framealpha=0.9)
    plain(above, "trajectory")
    over.set_yscale("log")
    over.axhline(0.15, color=INK, linestyle=":", linewidth=1.0)
    over.text(0.0, 0.16, " wanted: 0.15 m", fontsize=8, color=INK, va="bottom")
    over.set(xlabel="seconds of the bag", ylabel="distance from the truth [m]", title="error")
    over.grid(alpha=0.25)
    over.legend(loc="upper left", fontsize=8, framealpha=0.9)
    figure.savefig(path, format="png")


def draw_people(path: Path, home: Apartment, said: Said, truth: Truth, ospa: tuple[Array, Array]) -> None:
    """Where people were tracked, by label, over where they truly went; OSPA over time."""
    figure, ((above, over),) = canvas(1, 2, (13.0, 5.4))
    draw_building(above, home)
    spots = np.array([spots for _, (spots, _) in sorted(truth.people.items())])
    for person in range(spots.shape[1] if spots.ndim == 3 else 0):
        label = "truth" if person == 0 else None
        above.plot(*spots[:, person].T, color=TRUE, linewidth=4.0, alpha=0.25, label=label)
    trails: dict[int, list[Array]] = {}
    for _, tracked in sorted(said.people.items()):
        for one in tracked:
            if not one.hidden:
                trails.setdefault(one.label, []).append(one.position)
    for number, points in trails.items():
        line = np.array(points)
        above.plot(*line.T, ".", color=f"C{number % 10}", markersize=2.0)
    above.plot([], [], ".", color=QUIET, label=f"tracked, {len(trails)} labels")
    above.legend(loc="lower right", fontsize=8, framealpha=0.9)
    plain(above, "people")
    stamps, values = ospa
    if len(stamps):
        over.plot(stamps - stamps[0], values, color=QUIET, linewidth=0.6, label="each scan")
        width = min(81, len(values))
        smooth = np.convolve(values, np.ones(width) / width, mode="same")
        over.plot(stamps - stamps[0], smooth, color="#d62728", linewidth=1.4, label="mean of ten seconds")
        over.axhline(
            float(np.mean(values)),
            color=INK,
            linewidth=1.0,
            linestyle="--",
            label=f"mean {np.mean(values):.2f} m",
        )
    over.axhline(0.3, color=INK, linestyle=":", linewidth=1.0, label="wanted: 0.30 m")
    over.set(
        xlabel="seconds of the bag",
        ylabel="OSPA [m] (c = 1 m)",
        title="how far people are off",
        ylim=(0, 1.02),
    )
    over.legend(loc="upper right", fontsize=8, framealpha=0.9)
    over.grid(alpha=0.25)
    figure.savefig(path, format="png")


def draw_predictions(path: Path, home: Apartment, said: Said, truth: Truth, moments: Sequence[float]) -> None:
    """Predicted paths at a few moments, and where people then went."""
    figure, panels = canvas(1, max(len(moments), 1), (4.6 * max(len(moments), 1), 4.9))
    begin = min(truth.poses) if truth.poses else 0.0
    stamps = sorted(truth.people)
    for axes, moment in zip(panels[0], moments, strict=False):
        draw_building(axes, home)
        ahead = [truth.people[s][0] for s in stamps if moment <= s <= moment + HORIZON]
        for person in range(len(ahead[0]) if ahead else 0):
            way = np.array([spots[person] for spots in ahead])
            axes.plot(*way.T, color=TRUE, linewidth=4.0, alpha=0.45)
        people = {one.label: one for one in _at(said.people, moment)}
        for prediction in _at(said.paths, moment):
            _prediction(axes, prediction, people.get(prediction.label))
        _robot(axes, _at(truth.poses, moment, np.zeros(3)))
        plain(axes, f"after {moment - begin:.0f} s")
    legend = panels[0][0]
    legend.plot([], [], "-", color=TRUE, label="truth, the next five seconds")
    legend.plot([], [], "--", color="#d62728", label="predicted")
    legend.plot([], [], "s", color="#d62728", label="goals")
    legend.legend(loc="lower right", fontsize=7.5, framealpha=0.9)
    figure.savefig(path, format="png")


def _prediction(axes: Any, prediction: SaidPrediction, person: Tracked | None) -> None:
    from matplotlib.patches import Circle

    color = "#d62728"
    if person is not None:
        axes.plot(*person.position, "o", color=color, markersize=7)
        axes.annotate(str(prediction.label), person.position, (5, 5), textcoords="offset points", fontsize=9)
    if len(prediction.points):
        axes.plot(*prediction.points.T, "--", color=color, linewidth=1.6)
        for point, sigma in list(zip(prediction.points, prediction.sigmas, strict=True))[::3]:
            axes.add_patch(Circle(tuple(point), sigma, facecolor=color, edgecolor="none", alpha=0.12))
    for goal, share in zip(prediction.goals, prediction.probabilities, strict=False):
        if share >= 0.1:
            axes.plot(*goal, "s", color=color, markersize=4, alpha=0.7)
            axes.annotate(f"{share:.0%}", goal, (4, -9), textcoords="offset points", fontsize=7, color=color)


def draw_worlds(path: Path, home: Apartment, said: Said, truth: Truth, moments: Sequence[float]) -> None:
    """The world with its symbols at a few moments; crosses are where things truly are."""
    columns = 2
    rows = (len(moments) + 1) // columns
    figure, panels = canvas(max(rows, 1), columns, (13.5, 5.6 * max(rows, 1)))
    begin = min(truth.poses) if truth.poses else 0.0
    for axes, moment in zip(panels.ravel(), moments, strict=False):
        draw_building(axes, home)
        world = _at(said.worlds, moment)
        things = known(world)
        for spot in _at(truth.things, moment, {}).values():
            axes.plot(*spot[:2], "+", color=TRUE, markersize=12, markeredgewidth=1.6)
        _symbols(axes, things)
        for one in _at(said.people, moment):
            axes.plot(*one.position, "o", color="#7f3fbf", markersize=9, alpha=0.45 if one.hidden else 0.9)
            axes.annotate(
                f"person {one.label}",
                one.position,
                (7, -3),
                textcoords="offset points",
                fontsize=7,
                color="#7f3fbf",
            )
        lost = [item.id for item in world if item.lost and item.most_probable("class") not in NOBODY]
        _robot(axes, _at(truth.poses, moment, np.zeros(3)))
        note = f"; lost: {', '.join(lost)}" if lost else ""
        plain(axes, f"after {moment - begin:.0f} s: {len(things)} things known{note}")
    for axes in panels.ravel()[len(moments) :]:
        axes.axis("off")
    figure.savefig(path, format="png")


def _symbols(axes: Any, things: Sequence[WorldObject]) -> None:
    """Ids beside their objects; neighbours are written above each other."""
    taken: list[tuple[float, float]] = []
    for thing in sorted(things, key=lambda thing: (thing.position[1], thing.position[0])):
        x, y = thing.position[:2]
        color = next((COLORS[word] for word in thing.predicates if word in COLORS), QUIET)
        axes.plot(x, y, "o", color=color, markeredgecolor=INK, markersize=7)
        level = y
        while any(abs(level - other) < 0.3 and abs(x - beside) < 1.7 for beside, other in taken):
            level += 0.31
        taken.append((x, level))
        right = x > 7.0
        axes.annotate(
            f"{thing.id} {thing.existence:.2f}", (x, y), (x - 0.18 if right else x + 0.18, level),
            fontsize=7.5, ha="right" if right else "left", va="center", color=INK,
        )  # fmt: skip


def draw_search(
    path: Path,
    home: Apartment,
    truth: Truth,
    search: Mapping[str, Any],
) -> None:
    """Where the thing was, where the search wanted to look, where the robot drove, and where it was found.

    search : "steps" [(number, goal (2,))], "start" and "end" in seconds, "old", "new" and "found" places (2,) or None.
    """
    figure, ((axes,),) = canvas(1, 1, (9.5, 7.4))
    draw_building(axes, home, names=True)
    way = np.array(
        [pose for stamp, pose in sorted(truth.poses.items()) if search["start"] <= stamp <= search["end"]]
    )
    if len(way):
        axes.plot(*way[:, :2].T, color="#1f77b4", linewidth=2.0, label="the robot's way meanwhile")
        _robot(axes, way[0])
    if search["old"] is not None:
        axes.plot(*search["old"], "x", color=INK, markersize=12, markeredgewidth=2.5, label="where it was")
    if search["new"] is not None:
        axes.plot(
            *search["new"], "+", color=TRUE, markersize=16, markeredgewidth=2.5, label="where it truly is"
        )
    if search["found"] is not None:
        axes.plot(
            *search["found"],
            "o",
            markerfacecolor="none",
            markeredgecolor="#d62728",
            markersize=15,
            markeredgewidth=2.0,
            label="found",
        )
    groups: dict[tuple[float, float], list[int]] = {}
    for number, goal in search["steps"]:
        groups.setdefault((round(goal[0], 1), round(goal[1], 1)), []).append(number)
    for (x, y), numbers in groups.items():
        axes.plot(x, y, "*", color="#ff7f0e", markersize=15, markeredgecolor=INK)
        told = ", ".join(map(str, numbers[:6])) + (", ..." if len(numbers) > 6 else "")
        axes.annotate(told, (x, y), (8, 6), textcoords="offset points", fontsize=10, weight="bold")
    if groups:
        axes.plot([], [], "*", color="#ff7f0e", markersize=12, label="goals, in the order of their numbers")
    axes.legend(loc="upper left", fontsize=9, framealpha=0.9)
    plain(axes, "search")
    figure.savefig(path, format="png")


def draw_floor(axes: Any, grid: Grid | None) -> None:
    """The map, if there is one."""
    if grid is None:
        return
    values = grid.values.astype(np.float64)
    shade = np.where(values < 0, 0.86, 1.0 - values / 100.0)
    axes.imshow(
        shade, cmap="gray", vmin=0.0, vmax=1.0, origin="lower", extent=grid.extent, interpolation="nearest"
    )


def draw_building(axes: Any, home: Apartment, names: bool = False) -> None:
    """Walls and furniture."""
    from matplotlib.patches import Polygon

    for name, place in home.places.by_name.items():
        if place.kind == "furniture":
            axes.add_patch(Polygon(place.polygon, facecolor="#eef1f3", edgecolor="#c3ccd3", linewidth=0.8))
        if names:
            centre = place.polygon.mean(0)
            room = place.kind == "room"
            axes.text(*centre, name.replace("_", " "), ha="center", va="center", fontsize=9 if room else 6.5,
                      color="#5b6b78" if room else "#8a98a3")  # fmt: skip
    for wall in home.walls:
        axes.plot(wall[[0, 2]], wall[[1, 3]], color=INK, linewidth=1.4)


def _robot(axes: Any, pose: Array) -> None:
    ahead = 0.45 * np.array([np.cos(pose[2]), np.sin(pose[2])])
    axes.plot(*pose[:2], "o", color="#1f77b4", markersize=11, markeredgecolor="white")
    axes.annotate("", pose[:2] + ahead, pose[:2], arrowprops={"arrowstyle": "-|>", "color": "#1f77b4"})


def plain(axes: Any, title: str) -> None:
    """The apartment's frame, without a box around it."""
    axes.set_aspect("equal")
    axes.set_title(title, fontsize=11)
    axes.set_xlim(-2.0, 9.0)
    axes.set_ylim(-5.5, 6.2)
    axes.tick_params(labelsize=7, colors=QUIET)
    for side in axes.spines.values():
        side.set_visible(False)


def _at(series: Mapping[float, Any], stamp: float, default: Any = ()) -> Any:
    """The last value at or before a stamp."""
    before = [when for when in series if when <= stamp + 0.02]
    return series[max(before)] if before else default
