"""Whether a planar registration can be believed, and with what covariance.

A pose is only as good as what both scans could see says it is: enough outline in common, little of it in space
the other sensor saw through. What the lines leave open has the variance of the guess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from registration.consistency import Agreement
from registration.motion import Array
from registration.outline import Outline
from registration.refine import KERNEL, Refined
from registration.result import Registration
from registration.scatter import scattered_information

GUESS_SIGMA = np.array([0.5, 0.5, 0.5])  # m, m, rad: doubt about a guess where nothing else is known
# m, m, rad: what many beams cannot average away, points near corners and edges that take a neighbour's line; where
# a direction is open there are none.
FLOOR = np.array([3.5e-4, 3.5e-4, 3e-5])
LEAST_FITNESS = 0.6
LEAST_OVERLAP = 0.4
LEAST_TOGETHER = 1.2  # fitness and overlap: little of the one takes much of the other
MOST_BROKEN = 0.3
LEAST_LENGTH = 1.0  # metres of agreeing outline
LEAST_POINTS = 20
LONG = 1.5  # metres of connected outline that people and things that move do not have


@dataclass(frozen=True)
class Evidence:
    """What speaks for and against a registration, over both outlines.

    fitness : agreeing share of what can be judged. overlap : agreeing share of everything, judged or not.
    broken : share of long connected outline that stands in space the other saw through: walls do not move.
    length : metres of agreeing outline, of the lesser side.
    """

    fitness: float
    overlap: float
    broken: float
    length: float


def evidence(moving: Outline, still: Outline, views: tuple[Agreement, Agreement]) -> Evidence:
    """Sum of both views."""
    agreeing = sum(view.agreeing for view in views)
    standing = sum(view.standing for view in views)
    unknown = sum(view.unknown for view in views)
    held = broken = 0.0
    for outline, view in zip((moving, still), views, strict=True):
        length = np.minimum(outline.surface.spacing, 0.3)
        pieces = outline.surface.pieces
        long = np.bincount(pieces, length)[pieces] > LONG if len(pieces) else np.zeros(0, dtype=bool)
        held += float(length[long & (view.labels == 0)].sum())
        broken += float(length[long & (view.labels == 1)].sum())
    return Evidence(
        agreeing / max(agreeing + standing, 1e-9),
        agreeing / max(agreeing + standing + unknown, 1e-9),
        broken / max(held + broken, 1e-9),
        min(view.agreeing for view in views),
    )


def judged(
    moving: Outline,
    still: Outline,
    refined: Refined | None,
    start: Array,
    views: tuple[Agreement, Agreement] | None,
) -> Registration:
    """The registration `refined` amounts to; None stands for no candidate at all."""
    for name, outline in (("source", moving), ("target", still)):
        lined = int(outline.surface.lined.sum())
        if lined < LEAST_POINTS:
            reason = f"{name} has {lined} points on lines, {LEAST_POINTS} are needed"
            return Registration(start, np.diag(GUESS_SIGMA**2), 0.0, False, reason)
    if refined is None or views is None:
        return Registration(start, np.diag(GUESS_SIGMA**2), 0.0, False, "nothing in common was found")
    found = evidence(moving, still, views)
    covariance = pairwise_covariance(refined, moving, still)
    reason = _refusal(refined, found)
    if reason:
        return Registration(refined.pose, covariance + np.diag(GUESS_SIGMA**2), found.fitness, False, reason)
    if refined.open_directions:
        reason = f"{refined.open_directions} of 3 directions of motion are open and kept from the guess"
    return Registration(refined.pose, covariance, found.fitness, refined.open_directions < 2, reason)


def _refusal(refined: Refined, found: Evidence) -> str:
    if refined.open_directions == 3:
        return "no lines of the two correspond"
    if not refined.settled:
        return "the iterations did not settle"
    if found.length < LEAST_LENGTH or found.overlap < LEAST_OVERLAP:
        return f"only {found.length:.1f} m of outline ({found.overlap:.0%}) in common"
    if found.fitness < LEAST_FITNESS or found.fitness + found.overlap < LEAST_TOGETHER:
        return f"only {found.fitness:.0%} of what both could see agrees, {found.overlap:.0%} of all"
    if found.broken > MOST_BROKEN:
        return f"{found.broken:.0%} of the walls stand in space the other scan saw through"
    return ""


def pairwise_covariance(refined: Refined, moving: Outline, still: Outline) -> Array:
    """(3, 3) of x, y, yaw where both scans are noisy."""
    information = scattered_information(refined, moving.surface, still.surface, KERNEL)
    covariance = np.linalg.inv(information + np.diag(GUESS_SIGMA**-2.0))
    if refined.open_directions == 0:
        covariance += np.diag(FLOOR**2)
    return 0.5 * (covariance + covariance.T)
