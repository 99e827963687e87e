"""The report of a replay: what was recorded from the suite, as pictures and one Markdown page."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound, transform_points
from whereabouts.logs import CloudRecord, G2oGraph, MessageRecord, OdometryRecord, open_log

Array = NDArray[np.float64]
STEP = 0.1
"""m: the robot has moved once it is so far from where it was."""
MAP_CELL = 0.1
BEST_REVISIT_AGE = 50


@dataclass
class Replayed:
    """What the suite said during a replay.

    stamps (N,), poses (N, 3) : of `odometry`. wheels (K, 3) : of `wheel_odom`, in its own frame.
    points (M, 2) : static points in the frame of the poses.
    figures : the last diagnostics of each node, by node and key.
    keyframes {stamp: pose (3,)} : the corrected trajectory, as last published.
    closures : (stamp of the earlier, of the later, relative pose (3,)). points_closed : as points, loops closed.
    """

    stamps: Array
    poses: Array
    wheels: Array
    points: Array
    figures: dict[str, dict[str, str]] = field(default_factory=dict)
    keyframes: dict[float, Array] = field(default_factory=dict)
    closures: list[tuple[float, float, Array]] = field(default_factory=list)
    points_closed: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def corrected(self) -> Array:
        """Poses (N, 3) in the map: each hangs on the keyframe before it; empty where nothing was mapped."""
        if not self.keyframes:
            return np.zeros((0, 3))
        known = np.array(sorted(self.keyframes))
        own = {round(float(stamp), 4): pose for stamp, pose in zip(self.stamps, self.poses, strict=True)}
        placed = []
        for stamp, pose in zip(self.stamps, self.poses, strict=True):
            key = float(known[max(int(np.searchsorted(known, stamp + 1e-4)) - 1, 0)])
            there = own.get(round(key, 4))
            placed.append(pose if there is None else compound(self.keyframes[key], between(there, pose)))
        return np.array(placed)

    @property
    def path_length(self) -> float:
        """Length of the trajectory in metres, without the trembling of a pose that stands still."""
        length = 0.0
        counted = self.poses[:1, :2]
        for xy in self.poses[:, :2]:
            step = math.hypot(*(xy - counted[0]).tolist())
            if step >= STEP:
                length, counted = length + step, xy[None]
        return length


def read_replay(recording: Path, bag: Path) -> Replayed:
    """Collect a recording of the suite's output and the wheel odometry of the bag it was made from."""
    poses: dict[float, Array] = {}
    clouds: list[tuple[float, Array]] = []
    figures: dict[str, dict[str, str]] = {}
    keyframes: dict[float, Array] = {}
    closures: list[tuple[float, float, Array]] = []
    topics = ["odometry", "static_points", "diagnostics", "trajectory", "loop_closures"]
    with open_log(recording, topics=topics) as log:
        for record in log:
            if isinstance(record, OdometryRecord):
                poses[record.stamp] = np.asarray(record.pose)
            elif isinstance(record, CloudRecord):
                clouds.append((record.stamp, record.points[:, :2]))
            elif isinstance(record, MessageRecord) and record.topic.strip("/") == "trajectory":
                keyframes = {_seconds(item.header.stamp): _planar(item.pose) for item in record.message.poses}
            elif isinstance(record, MessageRecord) and record.topic.strip("/") == "loop_closures":
                message = record.message
                stamps = _seconds(message.earlier_stamp), _seconds(message.header.stamp)
                closures.append((*stamps, _planar(message.relative.pose)))
            elif isinstance(record, MessageRecord):
                for status in record.message.status:
                    figures[status.name] = {item.key: item.value for item in status.values}
    seen = [(stamp, cloud) for stamp, cloud in clouds if stamp in poses and len(cloud)]
    points = [transform_points(poses[stamp], cloud) for stamp, cloud in seen]
    with open_log(bag, topics=["wheel_odom"]) as log:
        wheels = [np.asarray(record.pose) for record in log.odometry()]
    ordered = sorted(poses)
    replayed = Replayed(
        np.array(ordered),
        np.array([poses[stamp] for stamp in ordered]).reshape(-1, 3),
        np.array(wheels).reshape(-1, 3),
        _thinned(np.concatenate(points)) if points else np.zeros((0, 2)),
        figures,
        keyframes,
        closures,
    )
    if keyframes:
        by_stamp = dict(zip(ordered, replayed.corrected, strict=True))
        moved = [transform_points(by_stamp[stamp], cloud) for stamp, cloud in seen]
        replayed.points_closed = _thinned(np.concatenate(moved)) if moved else np.zeros((0, 2))
    return replayed


def _seconds(stamp: Any) -> float:
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _planar(pose: Any) -> Array:
    p, q = pose.position, pose.orientation
    yaw = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return np.array([p.x, p.y, yaw])


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
    styles = {
        "wheels": ("0.6", 1.0),
        "solved": ("tab:green", 1.0),
        "scan registration": ("tab:blue", 1.0),
        "loops closed": ("tab:red", 1.4),
    }
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


def revisit_recall(replayed: Replayed, graph: G2oGraph, near: float = 2.0) -> dict[str, float]:
    """How many known revisits of the graph were closed, and how well the corrected trajectory meets them.

    A revisit counts as closed where a closure joins places within `near` metres of path of its two ends. Closures are
    held against the solved poses too; those more than 3 m off are counted.
    """
    if not replayed.keyframes:
        return {}
    along = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(replayed.poses[:, :2], axis=0).T))))
    ends = np.array([(a, b) for a, b, _ in replayed.closures]).reshape(-1, 2)
    index = np.clip(np.searchsorted(replayed.stamps, ends - 1e-4), 0, len(along) - 1)
    rank = {int(vertex): number for number, vertex in enumerate(graph.ids)}
    closed = 0
    for edge in graph.revisits:
        i, j = sorted((rank[edge.source], rank[edge.target]))
        if j - i < BEST_REVISIT_AGE or j >= len(along):
            continue
        close = (np.abs(along[index[:, 0]] - along[i]) < near) & (
            np.abs(along[index[:, 1]] - along[j]) < near
        )
        closed += bool(close.any())
    off = 0
    for (a, b), (_, _, relative) in zip(index, replayed.closures, strict=True):
        error = between(between(graph.poses[a], graph.poses[b]), relative)
        off += bool(np.hypot(*error[:2]) > 3.0)
    misses = revisit_errors(replayed.corrected, graph)
    return {
        "revisits_closed": closed,
        "closures_off": off,
        "closed_error_median_m": float(np.median(misses)) if len(misses) else float("nan"),
        "closed_error_95_m": float(np.quantile(misses, 0.95)) if len(misses) else float("nan"),
    }


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
    if len(replayed.corrected):
        trajectories["loops closed"] = from_start(replayed.corrected)
    draw_trajectories(folder / "trajectory.png", trajectories)
    draw_map(folder / "map.png", replayed.points, replayed.poses)
    if len(replayed.corrected):
        draw_map(folder / "map_closed.png", replayed.points_closed, replayed.corrected)
    lines = [f"# {title}", "", "| | |", "| --- | --- |"]
    lines += [f"| {name} | {value} |" for name, value in facts.items()]
    lines += ["", "![trajectory](trajectory.png)", "", "Before a loop is closed:", "", "![map](map.png)", ""]
    if len(replayed.corrected):
        lines += ["With loops closed:", "", "![map with loops closed](map_closed.png)", ""]
    for node, values in sorted(replayed.figures.items()):
        lines += [f"## Diagnostics of {node}", "", "| | |", "| --- | --- |"]
        lines += [f"| {key} | {value} |" for key, value in values.items()] + [""]
    page = folder / "report.md"
    page.write_text("\n".join(lines), encoding="utf-8")
    return page


def anchored(poses: Array, first: Array) -> Array:
    """Poses (N, 3) that start at the origin, moved to start at `first`."""
    return np.array([compound(first, pose) for pose in poses])
