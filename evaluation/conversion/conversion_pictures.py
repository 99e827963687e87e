"""The pictures of `conversion`: each function draws one figure of chapter 6 and returns its path."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from estimation.checks import FloatArray
from estimation.conversion.polar import convert
from evaluation.conversion import conversion_analysis as analysis
from evaluation.conversion.conversion_drive import RecordedDrive
from evaluation.conversion.conversion_tracking import TrackedWalk
from evaluation.drawing import saved

COLOURS: dict[str, str] = dict(zip(analysis.METHODS, ("C3", "C1", "C0", "C2", "C4"), strict=True))


def curves(out: Path, name: str, x: FloatArray, lines: dict[str, FloatArray], ylabel: str, log: bool) -> Path:
    """One line per entry over the angular noise in degrees."""
    figure = Figure(figsize=(6, 3.6))
    axes = figure.subplots()
    for label, y in lines.items():
        axes.plot(x, y, label=label, color=COLOURS.get(label))
    axes.set(xlabel="σ_θ, degrees", ylabel=ylabel, yscale="log" if log else "linear")
    axes.legend(fontsize=8)
    axes.grid(alpha=0.3)
    return saved(figure, out / f"{name}.png", 100)


def bananas(out: Path, seed: int) -> Path:
    """Figure 6.4: samples with each conversion's 95 % ellipse."""
    figure = Figure(figsize=(8, 7))
    panels = figure.subplots(2, 2)
    for axes, degrees in zip(panels.ravel(), (2, 5, 10, 20), strict=True):
        sigma = np.radians(degrees)
        axes.plot(*analysis.banana(sigma, seed).T, ".", color="0.6", ms=2)
        for method in analysis.METHODS[:4]:
            mean, cov = convert(analysis.RANGE, analysis.BEARING, analysis.SIGMA_RANGE, sigma, method)
            axes.plot(*analysis.ellipse(mean, cov).T, color=COLOURS[method], lw=1, label=method)
            axes.plot(*mean, "+", color=COLOURS[method])
        axes.set(title=f"σ_θ = {degrees}°", xlabel="x, m", ylabel="y, m", aspect="equal")
    panels[0, 0].legend(fontsize=8)
    return saved(figure, out / "figure-6-4-bananas.png", 100)


def boxes(out: Path, name: str, values: dict[str, FloatArray], ylabel: str, log: bool = False) -> Path:
    """A box plot per entry: Figures 6.8, 6.12, 6.13, 6.15."""
    figure = Figure(figsize=(6.5, 3.6))
    axes = figure.subplots()
    axes.boxplot([v[np.isfinite(v)] for v in values.values()], tick_labels=list(values), flierprops={"ms": 2})
    axes.set(ylabel=ylabel, yscale="log" if log else "linear")
    axes.tick_params(axis="x", labelsize=8)
    axes.grid(alpha=0.3, axis="y")
    return saved(figure, out / f"{name}.png", 100)


def drive_ranges(out: Path, drive: RecordedDrive, ranges: dict[str, FloatArray]) -> Path:
    """Figure 6.11: localisation along the drive, and the critical ranges."""
    figure = Figure(figsize=(7, 6))
    top, bottom = figure.subplots(2, 1, sharex=True)
    deviations = np.sqrt(np.diagonal(drive.covariances, axis1=1, axis2=2))
    for k, label in enumerate(("σ_x, m", "σ_y, m", "σ_θ, rad")):
        top.plot(drive.stamps, deviations[:, k], label=label)
    for k, (label, values) in enumerate(ranges.items()):
        bottom.plot(drive.stamps, values, label=label, color=f"C{k // 2}", ls="-" if k % 2 == 0 else "--")
    top.set(ylabel="localisation")
    bottom.set(xlabel="time, s", ylabel="critical range, m", ylim=(0, 15))
    for axes in (top, bottom):
        axes.legend(fontsize=7, ncols=2)
        axes.grid(alpha=0.3)
    return saved(figure, out / "figure-6-11-drive.png", 100)


def modes(out: Path, runs: dict[str, TrackedWalk], rate: float) -> Path:
    """Figures 6.14 and 6.16: K, the mode and the time of every update in the third scenario."""
    figure = Figure(figsize=(7, 7))
    panels = figure.subplots(3, 1, sharex=True)
    for k, (label, run) in enumerate(runs.items()):
        t = np.arange(len(run.ratio)) / rate
        panels[0].plot(t, run.ratio, lw=0.8, label=label, color=f"C{k}")
        panels[1].step(t, run.particles + 0.05 * k, label=label, color=f"C{k}")
        panels[2].semilogy(t, 1e3 * run.update_time, ".", ms=1.5, label=label, color=f"C{k}")
    panels[0].axhline(1.075, color="0.4", ls="--", lw=0.8)
    panels[0].set(ylabel="K")
    panels[1].set(ylabel="mode: 0 KF, 1 PF")
    panels[2].set(ylabel="update, ms", xlabel="time, s")
    panels[0].legend(fontsize=8)
    return saved(figure, out / "figure-6-14-modes.png", 100)
