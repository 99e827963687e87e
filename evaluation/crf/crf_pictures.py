"""Figures 3 and 4 of the CRF text: who each technique takes for whom over four scans, and what moves in a pair."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import LineCollection
from matplotlib.figure import Figure
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.poses import compound, transform_points
from evaluation.drawing import saved
from evaluation.scenes.labelled_pairs import LabelledPair
from registration.laser.scan import Scan

SHADES = ("lightgray", "darkgray", "dimgray", "tab:blue")  # of scans, the latest in blue
MARGIN = 1.0  # metres around the movers that are magnified
SPAN = 24.0  # metres of the place that are shown around it


def busiest(pairs: Sequence[LabelledPair], length: int) -> list[LabelledPair]:
    """The `length` consecutive pairs of one run through which one object is on the most beams."""
    runs = [
        list(pairs[k : k + length])
        for k in range(len(pairs) - length + 1)
        if len({pair.sequence for pair in pairs[k : k + length]}) == 1
    ]
    return max(runs, key=lambda run: min(int(pair.moving.sum()) for pair in run))


def points_of(scan: Scan) -> FloatArray:
    """(N, 2) end point of each beam, NaN without a return."""
    ranges = np.where(scan.valid, scan.ranges, np.nan)
    return np.column_stack((ranges * np.cos(scan.bearings), ranges * np.sin(scan.bearings)))


def draw_associations(
    folder: Path, run: Sequence[LabelledPair], found: Mapping[str, Sequence[NDArray[np.int64]]]
) -> Path:
    """Figure 3. found : by technique, of each pair of the run the partner (N,) of each beam, -1 none."""
    # Each scan in the frame of the last, by the true motions.
    poses = [np.zeros(3)]
    for pair in reversed(run):
        poses.append(compound(poses[-1], pair.motions[0]))
    scans = [*(pair.scan_a for pair in run), run[-1].scan_b]
    placed = [
        transform_points(pose, points_of(scan)) for pose, scan in zip(reversed(poses), scans, strict=True)
    ]
    figure = Figure(figsize=(3.2 * len(found), 6.4), layout="constrained")
    rows = figure.subplots(2, len(found))
    low, high = _around_movers(run, placed)
    middle = 0.5 * (low + high)
    for column, (name, partners) in enumerate(found.items()):
        for axes in rows[:, column]:
            for points, shade in zip(placed, SHADES[-len(placed) :], strict=True):
                axes.plot(*points.T, ".", color=shade, markersize=2)
            for a, b, partner in zip(placed, placed[1:], partners, strict=False):
                told = partner >= 0
                ways = np.stack((a[told], b[partner[told]]), axis=1)
                axes.add_collection(LineCollection(list(ways), colors="tab:red", linewidths=0.5))
            axes.set(aspect="equal", xticks=[], yticks=[])
        _frame(rows[0, column], middle - 0.5 * SPAN, middle + 0.5 * SPAN)
        _frame(rows[1, column], low, high)
        rows[0, column].set_title(name, fontsize=9)
    return saved(figure, folder / "figure-3-associations.png", 110)


def _around_movers(
    run: Sequence[LabelledPair], placed: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Corners (2,) of what is magnified: what moves and is seen again."""
    own = np.concatenate([points[pair.clusters > 0] for points, pair in zip(placed, run, strict=False)])
    return np.min(own, axis=0) - MARGIN, np.max(own, axis=0) + MARGIN


def draw_clusters(folder: Path, pair: LabelledPair, found: Mapping[str, NDArray[np.int64]]) -> Path:
    """Figure 4. found : by technique, the cluster (N,) of each beam, 0 background, -1 outlier."""
    columns = -(-len(found) // 2)
    figure = Figure(figsize=(3.2 * columns, 6.4), layout="constrained")
    points = points_of(pair.scan_a)
    middle = np.nanmedian(points[pair.moving], axis=0)
    every = figure.subplots(2, columns).ravel()
    for axes in every[len(found) :]:
        axes.set_axis_off()
    for axes, (name, clusters) in zip(every, found.items(), strict=False):
        axes.plot(*points.T, ".", color="black", markersize=1.5)
        for k in range(int(clusters.max(initial=0)) + 1):
            color = "darkgreen" if k == 0 else f"C{k}" if k != 2 else "C8"
            axes.plot(*points[clusters == k].T, "o", color=color, markersize=4, fillstyle="none")
        axes.set(aspect="equal", xticks=[], yticks=[])
        axes.set_title(name, fontsize=9)
        _frame(axes, middle - 0.5 * SPAN, middle + 0.5 * SPAN)
    return saved(figure, folder / "figure-4-clusters.png", 110)


def _frame(axes: Axes, low: FloatArray, high: FloatArray) -> None:
    axes.set(xlim=(float(low[0]), float(high[0])), ylim=(float(low[1]), float(high[1])))
