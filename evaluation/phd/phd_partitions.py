"""Section 4.1 of Paper B: how many partitions of a scan are weighed, of how many there are."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri

from estimation.checks import FloatArray
from evaluation.report import Printed, Report, RunOptions
from tracking.mixture.phd_config import PhdConfig
from tracking.phd.partitioning import Distances, Tree
from tracking.phd.partitions import PredictedTargets

TARGETS, RETURNS, CLUTTER = 4, 20, 50  # the text's example
SIGMA, HALF = 20.0, 1000.0  # m: standard deviation of a return, half a side of the area (Table 1)
PROBABILITIES = (0.30, 0.80)


def scan(rng: np.random.Generator) -> FloatArray:
    """Returns (N, 2) of four targets anywhere and clutter everywhere, 130 in the mean."""
    centres = rng.uniform(-HALF, HALF, (TARGETS, 2))
    parts = [centre + SIGMA * rng.standard_normal((rng.poisson(RETURNS), 2)) for centre in centres]
    return np.concatenate([*parts, rng.uniform(-HALF, HALF, (rng.poisson(CLUTTER), 2))])


def distinct(points: FloatArray, low: float = 0.0, high: float = np.inf) -> int:
    """Distinct partitions of (N, 2) over all thresholds of D (12) with low < d < high, and d = 0 where low is 0.

    A threshold changes the partition exactly where it is the length of a link of the single-linkage tree; those below
    `low` are joined at every threshold.
    """
    if len(points) < 2:
        return min(len(points), 1)
    heights = np.unique(Tree(points, 4.0 * HALF).heights)
    distances = np.hypot(*(points[:, None] - points[None]).transpose(2, 0, 1))
    thresholds = np.unique(distances[np.triu_indices(len(points), 1)])
    thresholds = thresholds[(thresholds > low) & (thresholds < high)]
    if low <= 0.0:
        thresholds = np.concatenate(([0.0], thresholds))
    # How many links each threshold has closed says which partition it makes.
    return len(np.unique(np.searchsorted(heights, thresholds, side="right")))


def bell_exponent(count: int) -> float:
    """log10 of the Bell number: all partitions of so many returns."""
    row = [1]
    for _ in range(count - 1):
        following = [row[-1]]
        for value in row:
            following.append(following[-1] + value)
        row = following
    return math.log10(row[-1])


def table(options: RunOptions, report: Report) -> None:
    """The text's example, and what the product weighs."""
    rng = np.random.default_rng([options.seed, 4])
    scans = [scan(rng) for _ in range(options.share(200, 25))]
    low, high = SIGMA * np.sqrt(chdtri(2, np.subtract(1.0, PROBABILITIES)))
    every = float(np.mean([distinct(points) for points in scans]))
    some = float(np.mean([distinct(points, low, high) for points in scans]))
    plain = Distances(PhdConfig.as_printed())
    grouped = [plain.partition(points, PredictedTargets.none()) for points in scans]
    weighed = float(np.mean([len(found.group) for found in grouped]))
    stood_for = float(np.mean([np.log10(np.bincount(found.group)).sum() for found in grouped]))
    where = "Paper B, section 4.1"
    rows: list[list[object]] = [
        ["all partitions of 130 returns, power of 10", Printed(161, where), bell_exponent(130), ""],
        ["partitions at all distances", Printed(130, where), every, ""],
        ["partitions between the quantiles 0.3 and 0.8", Printed(27, where), some, weighed],
        ["whole partitions these stand for, power of 10", "", float(np.log10(some)), stood_for],
    ]
    note = (
        f"Four targets of {RETURNS} returns and {CLUTTER} of clutter in 2 km × 2 km. Here, groups of returns that no "
        "considered cell joins have thresholds of their own: the sum over partitions factorises. The text's 27 does "
        "not come out between its own quantiles."
    )
    report.add(
        "How many partitions are weighed", ["what", "text", "as printed, here", "ours"], rows, note, "partitions",
        {"text": where}, "simulated", len(scans),
    )  # fmt: skip
