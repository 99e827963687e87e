"""Figures 2.3, 2.4 and 2.7 of the licentiate thesis: uncertainty of range data, and a registration by ICP."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from estimation.checks import FloatArray
from estimation.conversion.polar import convert
from estimation.geometry.poses import transform_points
from evaluation.drawing import saved
from registration import Scan, align

MEASURED = (10.0, np.deg2rad(45.0))  # m, rad: section 2.2
UNSURE = (0.3, np.deg2rad(4.0))  # m, rad, of figure 2.3; the text states none
NOISE = (0.01, 0.01 * np.pi / 180.0)  # m, rad, of (2.10) at no range
EVERY, ENLARGED = 10, 10.0  # points of figure 2.4 between two ellipses, and how much larger they are drawn


def noise_of(ranges: FloatArray, farthest: float) -> tuple[FloatArray, FloatArray]:
    """Standard deviations of range, m, and bearing, rad, by (2.10)."""
    grown = 1.0 + ranges / farthest
    return NOISE[0] * grown, NOISE[1] * grown


def ellipse(mean: FloatArray, covariance: FloatArray, deviations: float) -> FloatArray:
    """Points (60, 2) at so many standard deviations around a mean (2,)."""
    turn = np.linspace(0.0, 2.0 * np.pi, 60)
    circle = np.stack((np.cos(turn), np.sin(turn)))
    return np.asarray(mean + deviations * (np.linalg.cholesky(covariance) @ circle).T)


def cartesian(polar: FloatArray) -> FloatArray:
    """(..., 2) x, y of range and bearing (..., 2), (2.5)."""
    return np.asarray(polar[..., :1] * np.stack((np.cos(polar[..., 1]), np.sin(polar[..., 1])), axis=-1))


def draw_uncertainty(folder: Path) -> Path:
    """Figure 2.3: 1 to 3 standard deviations of one measurement in polar coordinates, carried over, to first order."""
    figure = Figure(figsize=(10.0, 3.6), layout="constrained")
    panels = figure.subplots(1, 3)
    mean, covariance = convert(*MEASURED, *UNSURE, method="linear")
    for deviations in (1.0, 2.0, 3.0):
        around = ellipse(np.array(MEASURED), np.diag(np.square(UNSURE)), deviations)
        panels[0].plot(around[:, 0], np.degrees(around[:, 1]), color="black")
        panels[1].plot(*cartesian(around).T, color="black")
        panels[2].plot(*ellipse(mean, covariance, deviations).T, color="black")
    panels[0].set(title="polar", xlabel="range, m", ylabel="bearing, °")
    for axes, title in zip(panels[1:], ("carried over by (2.5)", "first order, (2.9)"), strict=True):
        axes.set(title=title, xlabel="x, m", ylabel="y, m", aspect="equal", xlim=(4, 10), ylim=(4, 10))
    return saved(figure, folder / "figure-2-3.png", 110)


def draw_cloud(folder: Path, scan: Scan) -> Path:
    """Figure 2.4: a scan in polar and Cartesian coordinates, with ellipses of every tenth point by (2.10)."""
    figure = Figure(figsize=(10.0, 4.0), layout="constrained")
    left, right = figure.subplots(1, 2)
    polar = np.column_stack((scan.ranges, scan.bearings))[scan.valid]
    left.plot(np.degrees(polar[:, 1]), polar[:, 0], ".", color="black", markersize=2)
    right.plot(*cartesian(polar).T, ".", color="black", markersize=2)
    ranges, bearings = polar[::EVERY].T
    sigmas = noise_of(ranges, scan.range_max)
    means, covariances = convert(ranges, bearings, *sigmas, method="linear")
    for k in range(len(ranges)):
        around = ellipse(polar[k * EVERY], np.diag([sigmas[0][k] ** 2, sigmas[1][k] ** 2]), 3.0 * ENLARGED)
        left.plot(np.degrees(around[:, 1]), around[:, 0], color="tab:red", linewidth=0.8)
        right.plot(*ellipse(means[k], covariances[k], 3.0 * ENLARGED).T, color="tab:red", linewidth=0.8)
    figure.suptitle(f"3σ ellipses, {ENLARGED:g} times as large", fontsize=9)
    left.set(xlabel="bearing, °", ylabel="range, m")
    right.set(xlabel="x, m", ylabel="y, m", aspect="equal")
    return saved(figure, folder / "figure-2-4.png", 110)


def draw_icp(folder: Path, source: Scan, target: Scan) -> Path:
    """Figure 2.7: two scans before and after ICP."""
    figure = Figure(figsize=(9.0, 4.5), layout="constrained")
    found = align(source, target, method="icp").transform
    panels: list[Axes] = list(figure.subplots(1, 2))
    for axes, pose, title in zip(panels, (np.zeros(3), found), ("before", "after ICP"), strict=True):
        axes.plot(*target.points().T, ".", color="black", markersize=3)
        axes.plot(*transform_points(pose, source.points()).T, ".", color="tab:red", markersize=3)
        axes.set(title=title, xlabel="x, m", ylabel="y, m", aspect="equal")
    return saved(figure, folder / "figure-2-7.png", 110)
