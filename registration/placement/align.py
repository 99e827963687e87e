"""Pairwise registration (section 2.5 and Paper A section 4.3): one entry for planar and spatial data.

`align` lays a source on a target from a guess. In the plane the default method searches the surroundings of
the guess by correlation, refines the best candidates on lines, drops what turns out to have moved, and judges
the outcome by what each scan saw through. The text's own methods stay selectable.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from estimation.checks import FloatArray, as_floats, as_own
from estimation.errors import InputError
from estimation.geometry.poses import inverse, wrap_angle
from estimation.geometry.rotations import require_rigid
from registration.clouds.cloud_registration import align_clouds, align_clouds_ndt
from registration.laser.prepared import PreparedScan, prepare
from registration.laser.scan import Scan
from registration.placement.classic import CLASSIC
from registration.placement.consistency import Agreement, weigh
from registration.placement.correlative import Wanted, candidates
from registration.placement.judgement import LENIENT, STRICT, Asked, judged
from registration.placement.refine import Refined, refine
from registration.result import Registration

METHODS = ("robust", "icp", "point_to_line", "ndt")
CLOUDS = {"robust": align_clouds, "ndt": align_clouds_ndt}
REACH = 0.8  # metres around the guess that are searched
TURN = np.deg2rad(50.0)  # radians around the guess that are searched
CANDIDATES = 3
SEARCHED = 64  # points of the source that are searched with

Views = tuple[Agreement, Agreement]


def align(
    source: Scan | ArrayLike,
    target: Scan | ArrayLike,
    guess: ArrayLike | None = None,
    method: str = "robust",
) -> Registration:
    """Motion that lays `source` on `target`.

    Parameters
    ----------
    source, target : both planar, each a `Scan` or points (N, 2), or both clouds (N, 3); metres, sensor frames.
        Scans are judged better than bare points: they also say where nothing was. What is not finite is dropped.
    guess : expected pose of the source in the target frame, (3,) or (4, 4); none means the same place.
        The robust method searches 0.8 m and 50° around it; for the others it has to be close.
    method : "robust"; the text's "ndt", for planar data also its "icp" (point to point) and "point_to_line".

    Returns
    -------
    Registration : never raises on poor data; `converged` is False and `reason` says why.

    Raises
    ------
    InputError : wrong shapes, a planar with a spatial argument, an unknown method, a guess that is not finite.
    """
    if method not in METHODS:
        raise InputError(f"method: one of {', '.join(METHODS)} expected, got {method!r}")
    if both_clouds(source, target):
        if method not in CLOUDS:
            raise InputError(f"method: clouds are registered by {' or '.join(CLOUDS)}, got {method!r}")
        return CLOUDS[method](np.asarray(source), np.asarray(target), as_guess(guess, (4, 4), np.eye(4)))
    start = as_guess(guess, (3,), np.zeros(3))
    moving, still = prepare("source", source), prepare("target", target)
    if method != "robust":
        refined = CLASSIC[method](moving, still, start)
        return judged(moving, still, refined, start, agreements(moving, still, refined.pose))
    return search(moving, still, start, REACH, TURN)


def both_clouds(source: Scan | ArrayLike, target: Scan | ArrayLike) -> bool:
    """Whether two measurements are spatial, (N, 3). InputError where only one is."""
    spatial, other = (
        not isinstance(one, Scan) and as_floats(name, one).shape[1:] == (3,)
        for name, one in (("source", source), ("target", target))
    )
    if spatial != other:
        raise InputError("target: source and target must both be planar or both be clouds (N, 3)")
    return spatial


def as_guess(guess: ArrayLike | None, shape: tuple[int, ...], default: FloatArray) -> FloatArray:
    if guess is None:
        return default
    start = as_own("guess", guess, shape)
    return start if shape == (3,) else require_rigid("guess", start)


def among_movers(moving: PreparedScan, still: PreparedScan, start: FloatArray) -> Registration:
    """As `align`, for who can tell afterwards what moved: long outlines that contradict are no reason to refuse."""
    return search(moving, still, start, REACH, TURN, LENIENT)


def search(
    moving: PreparedScan,
    still: PreparedScan,
    start: FloatArray,
    reach: float,
    turn: float,
    asked: Asked = STRICT,
) -> Registration:
    """Best of the candidates within `reach` metres and `turn` radians of `start`."""
    return judged(moving, still, *best_of(moving, still, start, reach, turn), asked)


def best_of(
    moving: PreparedScan, still: PreparedScan, start: FloatArray, reach: float, turn: float
) -> tuple[Refined | None, FloatArray, Views | None]:
    """Best of the candidates of `search`, `start` and how the outlines see each other then: not judged yet."""
    found = candidates(
        moving.surface.points, still.surface.points, start, reach, turn,
        wanted=Wanted(most=CANDIDATES, points=SEARCHED),
    )  # fmt: skip
    refined = (refine(moving.surface, still.target, candidate[1:].copy(), 0.15) for candidate in found)
    best = ranked(moving, still, refined)
    if not best:
        return None, start, None
    pose, views = held(moving, still, *settle(moving, still, *best[0][1:]), start)
    return pose, start, views


def ranked(
    moving: PreparedScan, still: PreparedScan, found: Iterable[Refined], against: float = 1.0
) -> list[tuple[float, Refined, Views]]:
    """Candidates, how the outlines see each other there, and what speaks for each; the best first.

    That is the agreeing outline less `against` times the contradicting, metres.
    """
    judged = []
    for refined in found:
        views = agreements(moving, still, refined.pose)
        merit = sum(view.agreeing - against * view.standing for view in views)
        judged.append((merit, refined, views))
    return sorted(judged, key=lambda entry: -entry[0])


def held(
    moving: PreparedScan,
    still: PreparedScan,
    refined: Refined,
    views: Views,
    start: FloatArray,
) -> tuple[Refined, Views]:
    """Where the lines leave some direction open, at `keep_open`; how the outlines see each other there."""
    if refined.open_directions not in (1, 2):
        return refined, views
    pose = keep_open(refined, start)
    return replace(refined, pose=pose), agreements(moving, still, pose)


def keep_open(refined: Refined, start: FloatArray) -> FloatArray:
    """The refined pose (3,), moved to where `start` has it along what the lines leave open."""
    _, vectors = np.linalg.eigh(refined.information)
    free = vectors[:, : refined.open_directions]
    away = start - refined.pose
    away[2] = wrap_angle(away[2])
    pose = refined.pose + free @ (free.T @ away)
    pose[2] = wrap_angle(pose[2])
    return pose


def agreements(moving: PreparedScan, still: PreparedScan, pose: FloatArray) -> Views:
    """Each outline judged against the other's."""
    back = inverse(pose)
    return (
        weigh(moving.surface, still.target, still.view, pose),
        weigh(still.surface, moving.target, moving.view, back),
    )


def settle(
    moving: PreparedScan, still: PreparedScan, refined: Refined, views: Views
) -> tuple[Refined, Views]:
    """Once more without the pieces that moved."""
    dropped = [movers(outline, view) for outline, view in zip((moving, still), views, strict=True)]
    if not (dropped[0].any() or dropped[1].any()):
        return refined, views
    rest = [
        outline.without(drop) if drop.any() else outline
        for outline, drop in zip((moving, still), dropped, strict=True)
    ]
    again = refine(rest[0].surface, rest[1].target, refined.pose.copy(), 0.08)
    if again.open_directions > refined.open_directions:
        return refined, views
    return again, agreements(moving, still, again.pose)


def movers(outline: PreparedScan, view: Agreement) -> np.ndarray:
    """Points (N,) of small connected pieces much of which stands in space the other scan saw through."""
    pieces = outline.surface.pieces
    count = int(pieces.max()) + 1 if len(pieces) else 0
    length = np.bincount(pieces, outline.surface.length, count)
    standing = np.bincount(pieces, view.labels == 1, count)
    agreeing = np.bincount(pieces, view.labels == 0, count)
    moved = (standing > 0.35 * (standing + agreeing)) & (length < 2.0)
    return np.asarray(moved[pieces])
