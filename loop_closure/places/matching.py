"""Lay the outline of one place on that of another: how well do they agree, and where do they if they do.

    F = match_features(a, candidates)       # (M, 28)

The second stage of the recognition cascade. All headings and translations up to 3 m are searched from coarse to fine;
the features are how many walls meet walls, how many stand on what the other saw as free floor, how much both know of
the common area, how sharply the best placement stands out against others and against sliding along it. It is a filter
of candidates, no verification: `registration.placement.align_globally` finds the pose that a closure carries.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimation.checks import FloatArray
from loop_closure.places.outline_kernels import MATCH_FEATURES, grids, match, sharp_grid
from loop_closure.places.outlines import Outline

NAMES = (
    "agreement",
    "agreement of the second best placement",
    "mean hit",
    "share on obstacles",
    "share on free floor",
    "share on the known",
    "mean hit, reversed",
    "share on obstacles, reversed",
    "share on free floor, reversed",
    "share on the known, reversed",
    "lesser share on obstacles",
    "greater share on free floor",
    "distance",
    "least loss by sliding 0.4 m",
    "greatest loss by sliding 0.4 m",
    "least loss by sliding 1 m",
    "greatest loss by sliding 1 m",
    "lesser number of points",
    "greater number of points",
    "obstacles among the known",
    "obstacles among the known, reversed",
    "free floor among the known",
    "free floor among the known, reversed",
    "turn",
    "closeness",
    "closeness, reversed",
    "closeness among the known",
    "closeness among the known, reversed",
)


class Grids:
    """The grids of an outline that `match` looks up; made when needed, 115 kB."""

    def __init__(self, outline: Outline) -> None:
        self.points = outline.points
        self.fine, self.coarse = grids(outline.points, outline.free)
        self.sharp = sharp_grid(outline.points)

    def match(self, b: Grids, out: FloatArray, pose: FloatArray) -> None:
        """Write the features (28,) of laying this outline on that of `b`, and its pose (3,) there."""
        match(self.points, self.fine, self.sharp, b.points, b.fine, b.coarse, b.sharp, out, pose)


def match_features(a: Outline, others: Sequence[Outline]) -> tuple[FloatArray, FloatArray]:
    """Features (M, 28) of laying `a` on each of M outlines, and the poses (M, 3) of `a` in their frames."""
    laid = Grids(a)
    F, poses = np.empty((len(others), MATCH_FEATURES)), np.empty((len(others), 3))
    for row, other in enumerate(others):
        laid.match(Grids(other), F[row], poses[row])
    return F, poses
