"""The report of a replay: what was recorded from the suite, as pictures and one Markdown page."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.poses import between, compound, transform_points
from whereabouts.logs import CloudRecord, G2oGraph, MessageRecord, OdometryRecord, open_log

Array = NDArray[np.float64]
MAP_CELL = 0.1
BEST_REVISIT_AGE = 50


@dataclass
class Replayed:
    """What the suite said during a replay.

    stamps (N,), poses (N, 3) : of `odometry`. wheels (K, 3) : of `wheel_odom`, in its own frame.
    points (M, 2) : static points in the frame of the poses.
    figures : the last diagnostics of each node, by node and key.
    """

    stamps: Array
    poses: Array
    wheels: Array
    points: Array
    figures: dict[str, dict[str, str]] = field(default_factory=dict)

    @property
    def path_length(self) -> float:
        """Length of the trajectory in metres."""
        return float(np.linalg.norm(np.diff(self.poses[:, :2], axis=0), axis=1).sum())


def read_replay(recording: Path, bag: Path) -> Replayed:
    """Collect a recording of the suite's output and the wheel odometry of the bag it was made from."""
    poses: dict[float, Array] = {}
    clouds: list[tuple[float, Array]] = []
    figures: dict[str, dict[str, str]] = {}
    with open_log(recording, topics=["odometry", "static_points", "diagnostics"]) as log:
        for record in log:
            if isinstance(record, OdometryRecord):
                poses[record.stamp] = np.asarray(record.pose)
            elif isinstance(record, CloudRecord):
                clouds.append((record.stamp, record.points[:, :2]))
            elif isinstance(record, MessageRecord):
                for status in record.message.status:
                    figures[status.name] = {item.key: item.value for item in status.values}
    points = [
        transform_points(poses[stamp], cloud) for stamp, cloud in clouds if stamp in poses and len(cloud)
    ]
    with open_log(bag, topics=["wheel_odom"]) as log:
        wheels = [np.asarray(record.pose) for record in log.odometry()]
    ordered = sorted(poses)
    return Replayed(
        np.array(ordered),
        np.array([poses[stamp] for stamp in ordered]).reshape(-1, 3),
        np.array(wheels).reshape(-1, 3),
        _thinned(np.concatenate(points)) if points else np.zeros((0, 2)),
        figures,
    )


def _thinned(points: Array) -> Array:
    """One point per map cell."""
    _, first = np.unique(np.floor(points / MAP_CELL).astype(np.int64), axis=0, return_index=True)
    return points[np.sort(first)]


def from_start(poses: Array) -> Array:
    """Poses (N, 3) relative to the first."""
    return np.array([between(poses[0], pose) for pose in poses])


def draw_trajectories(path: Path, named: dict[str, Array]) -> None:
    """Trajectories (N, 2 | 3) from above, on one picture."""
    figure, axes = _axes()
    styles = {"wheels": ("0.6", 1.0), "solved": ("tab:green", 1.0), "scan registration": ("tab:blue", 1.4)}
    for name, poses in named.items():
        color, width = styles.get(name, (None, 1.0))
        axes.plot(poses[:, 0], poses[:, 1], color=color, linewidth=width, label=name)
    start = next(iter(named.values()))[0]
    axes.plot(start[0], start[1], "o", color="black", markersize=5, label="start")
    axes.legend(loc="best", frameon=False)
    _save(figure, path)


def draw_map(path: Path, points: Array, poses: Array) -> None:
    """Static points (M, 2) and the trajectory through them."""
    figure, axes = _axes()
    axes.plot(points[:, 0], points[:, 1], ",", color="0.15", alpha=0.6)
    axes.plot(poses[:, 0], poses[:, 1], color="tab:blue", linewidth=0.8)
    _save(figure, path)


def _axes() -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 7.0), dpi=130, layout="constrained")
    axes = figure.add_subplot()
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.grid(alpha=0.25)
    return figure, axes


def _save(figure: Any, path: Path) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    FigureCanvasAgg(figure).print_png(str(path))


def revisit_errors(poses: Array, graph: G2oGraph) -> Array:
    """Distance (K,) in metres by which the trajectory misses each known revisit of the graph.

    poses : (N, 3), one per vertex. For a constraint between vertices i and j with motion z the trajectory
    says that j lies at inverse(p_i) + p_j; the error is the distance between that and z.
    """
    rank = {int(vertex): index for index, vertex in enumerate(graph.ids)}
    errors = []
    for edge in graph.revisits:
        i, j = rank[edge.source], rank[edge.target]
        if abs(i - j) < BEST_REVISIT_AGE or max(i, j) >= len(poses):
            continue
        error = between(edge.motion, between(poses[i], poses[j]))
        errors.append(float(np.hypot(error[0], error[1])))
    return np.array(errors)


def write_report(
    folder: Path, title: str, replayed: Replayed, facts: dict[str, str], solved: Array | None
) -> Path:
    """Pictures and report.md in `folder`; returns the page's path.

    facts : name and value of every row of the first table. solved : (N, 3) reference trajectory, None without.
    """
    trajectories = {}
    if len(replayed.wheels):
        trajectories["wheels"] = from_start(replayed.wheels)
    if solved is not None:
        trajectories["solved"] = from_start(solved)
    trajectories["scan registration"] = replayed.poses
    draw_trajectories(folder / "trajectory.png", trajectories)
    draw_map(folder / "map.png", replayed.points, replayed.poses)
    lines = [f"# {title}", "", "| | |", "| --- | --- |"]
    lines += [f"| {name} | {value} |" for name, value in facts.items()]
    lines += ["", "![trajectory](trajectory.png)", "", "![map](map.png)", ""]
    for node, values in sorted(replayed.figures.items()):
        lines += [f"## Diagnostics of {node}", "", "| | |", "| --- | --- |"]
        lines += [f"| {key} | {value} |" for key, value in values.items()] + [""]
    page = folder / "report.md"
    page.write_text("\n".join(lines), encoding="utf-8")
    return page


def anchored(poses: Array, first: Array) -> Array:
    """Poses (N, 3) that start at the origin, moved to start at `first`."""
    return np.array([compound(first, pose) for pose in poses])
