"""Whether a planar registration can be believed, and with what covariance.

A pose is only as good as what both scans could see says it is: enough outline in common, little of it in space
the other sensor saw through. What the lines leave open has the variance of the guess.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from registration.laser.prepared import PreparedScan
from registration.placement.consistency import Agreement
from registration.placement.influence import borrowed
from registration.placement.refine import KERNEL, Refined
from registration.placement.scatter import scattered_information
from registration.result import Registration

GUESS_SIGMA = np.array([0.5, 0.5, 0.5])  # m, m, rad: doubt about a guess where nothing else is known
# m, m, rad: what many beams cannot average away, points near corners and edges that take a neighbour's line; where
# a direction is open there are none.
FLOOR = np.array([3.5e-4, 3.5e-4, 3e-5])
LEAST_LENGTH = 1.0  # metres of agreeing outline
LEAST_POINTS = 20
# What moved stands in seen space in pieces of the size of people and boxes, what belongs to another room in stretches
# of wall: the longer the mean piece and the mean metre's piece are, the more of the outlines has to agree.
TOO_LONG = 0.3  # of overlap per metre
MOST_BORROWED = 0.1  # metres or radians of doubt that one small piece may be the only remedy for


@dataclass(frozen=True)
class Asked:
    """What is asked of a registration: least fitness, overlap, sum of the two, and merit of its `Evidence`.

    alone : whether one small piece of outline may not be the only thing that fixes a direction.
    """

    fitness: float = 0.0
    overlap: float = 0.0
    together: float = 0.0
    merit: float = 0.21  # measured between strangers' rooms and rooms full of movers
    alone: bool = True


STRICT = Asked()
# For who finds out next what moved, be it as long as a car.
LENIENT = Asked(0.6, 0.4, 1.2, -np.inf, False)


@dataclass(frozen=True)
class PieceEvidence:
    """What speaks for and against a registration, over both outlines.

    fitness : agreeing share of what can be judged. overlap : agreeing share of everything, judged or not.
    piece : metres, mean length of the pieces that stand in space the other saw through. metre : the same, every
    metre's piece counted by its length. length : metres of agreeing outline, of the lesser side.
    """

    fitness: float
    overlap: float
    piece: float
    metre: float
    length: float

    @property
    def merit(self) -> float:
        """Overlap, less what the contradicting pieces are too long for."""
        return self.overlap - TOO_LONG * (self.piece + self.metre)


@njit(cache=True)
def _contradicting(labels, pieces, lengths):  # type: ignore[no-untyped-def]
    """Number, length and squared length of the runs of connected outline that stand where the other saw through."""
    count, total, squares, run, last = 0, 0.0, 0.0, 0.0, -1
    for k in range(len(labels)):
        if run > 0.0 and (labels[k] == 0 or pieces[k] != last):
            count, total, squares, run = count + 1, total + run, squares + run * run, 0.0
        if labels[k] == 1:
            run, last = run + lengths[k], pieces[k]
    if run > 0.0:
        count, total, squares = count + 1, total + run, squares + run * run
    return count, total, squares


def evidence(moving: PreparedScan, still: PreparedScan, views: tuple[Agreement, Agreement]) -> PieceEvidence:
    """Sum of both views."""
    agreeing = sum(view.agreeing for view in views)
    standing = sum(view.standing for view in views)
    unknown = sum(view.unknown for view in views)
    runs = np.zeros(3)
    for outline, view in zip((moving, still), views, strict=True):
        runs += _contradicting(view.labels, outline.surface.pieces, outline.surface.length)
    return PieceEvidence(
        agreeing / max(agreeing + standing, 1e-9),
        agreeing / max(agreeing + standing + unknown, 1e-9),
        float(runs[1] / max(runs[0], 1.0)),
        float(runs[2] / max(runs[1], 0.3)),
        min(view.agreeing for view in views),
    )


def judged(
    moving: PreparedScan,
    still: PreparedScan,
    refined: Refined | None,
    start: FloatArray,
    views: tuple[Agreement, Agreement] | None,
    asked: Asked = STRICT,
) -> Registration:
    """The registration `refined` amounts to; None stands for no candidate at all."""
    for name, outline in (("source", moving), ("target", still)):
        lined = int(outline.surface.lined.sum())
        if lined < LEAST_POINTS:
            reason = f"{name} has {lined} points on lines; at least {LEAST_POINTS} are needed"
            return Registration(start, np.diag(GUESS_SIGMA**2), 0.0, False, reason)
    if refined is None or views is None:
        return Registration(start, np.diag(GUESS_SIGMA**2), 0.0, False, "no overlap was found")
    found = evidence(moving, still, views)
    covariance = pairwise_covariance(refined, moving, still)
    reason = _refusal(refined, found, asked)
    if reason:
        return Registration(refined.pose, covariance + np.diag(GUESS_SIGMA**2), found.fitness, False, reason)
    doubt = borrowed(refined, moving.surface, still.target, KERNEL, GUESS_SIGMA[0] ** 2, still.surface)
    covariance = covariance + doubt
    if asked.alone and np.diag(doubt).max() > MOST_BORROWED**2:
        reason = "only one small segment constrains a direction of motion"
        return Registration(refined.pose, covariance, found.fitness, False, reason)
    if refined.open_directions:
        reason = f"{refined.open_directions} of 3 directions of motion are open: the guess is kept there"
    return Registration(refined.pose, covariance, found.fitness, refined.open_directions < 2, reason)


def _refusal(refined: Refined, found: PieceEvidence, asked: Asked) -> str:
    if refined.open_directions == 3:
        return "no lines match"
    if not refined.settled:
        return "the iterations did not settle"
    if found.length < LEAST_LENGTH or found.overlap < asked.overlap:
        return f"too little overlap: {found.length:.1f} m of contour ({found.overlap:.0%})"
    if found.fitness < asked.fitness or found.fitness + found.overlap < asked.together:
        return f"only {found.fitness:.0%} of the overlap agrees ({found.overlap:.0%} of the whole scan)"
    if found.merit < asked.merit:
        return f"one scan sees through {found.metre:.1f} m of the other's walls; {found.overlap:.0%} agrees"
    return ""


def pairwise_covariance(refined: Refined, moving: PreparedScan, still: PreparedScan) -> FloatArray:
    """(3, 3) of x, y, yaw where both scans are noisy."""
    information = scattered_information(refined, moving.surface, still.surface, KERNEL)
    covariance = np.linalg.inv(information + np.diag(GUESS_SIGMA**-2.0))
    if refined.open_directions == 0:
        covariance += np.diag(FLOOR**2)
    return 0.5 * (covariance + covariance.T)
