"""From a keyframe to placements on the map: candidates by place and by appearance, verified by registration.

Candidates lie within the uncertainty of the current estimate (the odometry gate of section 2.5), or look alike to the
classifier and lie within it too. Each is laid on the map by `registration.placement.align_submaps`, local map
on local map.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from estimation.checks import FloatArray
from loop_closure.graph.edges import Edge
from loop_closure.graph.uncertainty import DEVIATIONS, window
from loop_closure.keyframes import AROUND, Keyframes
from loop_closure.motions import compose, length, motion, planar, positions, turn
from loop_closure.slam.closure_hypotheses import Guess
from loop_closure.slam.cloud_closing import lay
from loop_closure.work import Steps
from registration.placement.align_submaps import APART, Placement, align_submaps, ambiguous

# Metres between places whose local maps have something in common, and of path between candidates.
COMMON = 3.0
BACK = 6.0  # metres of path in the newer local map
# Candidates where the place is known well, where it is not, and of what looks alike.
FEW, MANY, ALIKE = 3, 10, 5
CERTAIN_IN_SPACE = 2.0  # metres: a cloud of a street has far more to tell than a scan
LAYING, LAYING_CLOUD = (4.0, 8.0), 60.0  # ms of laying a local map on another, known well and not; of a cloud


@dataclass(frozen=True)
class Gate:
    """Where a keyframe may be: standard deviations (N,) relative to it of all others."""

    sigma: FloatArray
    turn: FloatArray


@dataclass(frozen=True)
class Search:
    """How candidates are looked for; metres."""

    apart: float  # path between a place and its revisit
    certain: float  # standard deviation below which a placement within the gate needs no second opinion
    farthest: float  # standard deviation beyond which only what looks alike is laid on the map
    anywhere: bool = False  # only what looks alike is laid on the map, wherever it is
    only_certain: bool = False  # leave out what would have to wait


def looking(
    k: int,
    keyframes: Keyframes,
    poses: FloatArray,
    gate: Gate,
    search: Search,
    likely: dict[int, float],
    both: bool,
) -> Steps[list[Guess]]:
    """Placements of keyframe `k` that can be believed, best first; a step for each that is tried.

    likely : likelihood of earlier keyframes by the classifier. both : use the path after `k` too, in hindsight.
    """
    chosen = candidates_of(k, keyframes, poses, gate, search, likely)
    if not chosen:
        return []
    if not planar(poses):
        yield LAYING_CLOUD
        return _look_around(k, chosen, keyframes, poses, gate, search)
    source = keyframes.local_map(k, AROUND, AROUND) if both else keyframes.local_map(k, BACK, 0.0)
    fits: list[Guess] = []
    for j in chosen:
        yield LAYING[bool(gate.sigma[j] > search.certain or search.anywhere)]
        target = keyframes.local_map(j, AROUND, AROUND)
        expected = guess = motion(poses[j], poses[k])
        # What looks alike far from the estimate makes that as doubtful as it is far off.
        outside = search.anywhere and length(guess) > COMMON + DEVIATIONS * gate.sigma[j]
        sigma = max(float(gate.sigma[j]), length(guess) / DEVIATIONS if outside else 0.0)
        loose = sigma > search.certain
        reach, turned = window(sigma, float(gate.turn[j]))
        turned = np.pi if outside else min(turned, np.pi)
        if loose:
            # As far as corridors repeat, even where less would do: odometry that slipped by a door is sure of itself.
            reach = 2.0 * COMMON
            guess = nearer(guess, reach)
        placements = align_submaps(source, target, guess, reach, turned)
        fits += _believed(placements, Edge(j, k, expected, np.eye(3), True), sigma, loose, likely.get(j, 0.0))
    fits.sort(key=lambda fit: -fit.merit)
    return fits


def _believed(
    placements: list[Placement], expected: Edge, sigma: float, loose: bool, likelihood: float
) -> list[Guess]:
    """Placements that fit, best first; where the place is not known well, what fits half as well waits as a rival.

    expected : closure by the estimate, whose place is known to `sigma` metres, not well where `loose`.
    """
    if not placements or not placements[0].sure:
        return []
    alone = not ambiguous(placements)
    fits = []
    for placement in placements if loose else placements[:1]:
        missed = length(motion(expected.motion, placement.pose))
        allowed = missed <= DEVIATIONS * sigma + 0.5
        weighty = placement.merit > 0.5 * placements[0].merit
        if placement.sure and weighty and (allowed or loose):
            edge = replace(expected, motion=placement.pose, covariance=placement.covariance)
            merit, fitness = placement.merit, placement.fitness
            fits.append(Guess(edge, merit, fitness, likelihood, sigma, allowed, missed, not loose, alone))
    return fits


def candidates_of(
    k: int, keyframes: Keyframes, poses: FloatArray, gate: Gate, search: Search, likely: dict[int, float]
) -> list[int]:
    """Earlier keyframes that may show the place of `k`, the most promising first."""
    paths = keyframes.paths[: len(poses)]
    if search.anywhere:
        return _spread([], sorted(likely, key=lambda j: -likely[j]), paths, COMMON, ALIKE)
    where = positions(poses)
    away = np.linalg.norm(where - where[k], axis=1)
    reach = COMMON + DEVIATIONS * gate.sigma
    allowed = (paths <= paths[k] - search.apart) & (away <= reach) & (gate.sigma <= search.farthest)
    allowed[k:] = False
    if search.only_certain:
        allowed &= gate.sigma <= search.certain
    pool = np.flatnonzero(allowed)
    loose = not len(pool) or gate.sigma[pool].min() > search.certain
    chosen: list[int] = []
    if loose and likely:
        alike = [j for j in sorted(likely, key=lambda j: -likely[j]) if away[j] <= reach[j]]
        _spread(chosen, alike, paths, COMMON, ALIKE)
    # The better known ones first, nearest first.
    rank = away[pool] / reach[pool]
    order = pool[np.argsort(rank, kind="stable")].tolist()
    if loose:
        return _spread(chosen, order, paths, COMMON, len(chosen) + MANY)
    return _spread(chosen, order, paths, 2.0 * COMMON, FEW)


def lost(k: int, keyframes: Keyframes, poses: FloatArray, gate: Gate, search: Search) -> bool:
    """Whether keyframe `k` may be at places that are not known well, and at none that is: looks matter then."""
    away = np.linalg.norm(positions(poses) - positions(poses)[k], axis=1)
    near = keyframes.paths[: len(poses)] <= keyframes.paths[k] - search.apart
    near &= away <= COMMON + DEVIATIONS * gate.sigma
    return bool(near.any() and gate.sigma[near].min() > search.certain)


def _spread(chosen: list[int], more: list[int], paths: FloatArray, gap: float, limit: int) -> list[int]:
    """`chosen` with those of `more` that are `gap` metres of path away from all others, up to `limit`."""
    for j in more:
        if len(chosen) >= limit:
            break
        if all(abs(paths[j] - paths[other]) >= gap for other in chosen):
            chosen.append(j)
    return chosen


def nearer(guess: FloatArray, reach: float) -> FloatArray:
    """A guess (3,) brought to within half of `reach` metres: a revisit passes close by."""
    away = float(np.hypot(guess[0], guess[1]))
    if away <= 0.5 * reach:
        return guess
    moved = guess.copy()
    moved[:2] *= 0.5 * reach / away
    return moved


def _look_around(
    k: int, chosen: list[int], keyframes: Keyframes, poses: FloatArray, gate: Gate, search: Search
) -> list[Guess]:
    """The same for clouds, which are rarely mistaken for each other but take long to register: one candidate does."""
    fits = []
    for j in chosen[:1]:
        sigma = float(gate.sigma[j])
        guess = motion(poses[j], poses[k])
        laid = lay(keyframes, j, k, guess, sigma, DEVIATIONS * sigma + 1.0)
        if laid is not None:
            edge, fitness = laid
            fits.append(Guess(edge, 100.0 * fitness, fitness, 0.0, sigma, certain=sigma <= CERTAIN_IN_SPACE))
    return fits


def agree(fits: list[Guess], poses: FloatArray) -> bool:
    """Whether all placements put the keyframe at the same place."""
    placed = [compose(poses[fit.edge.a], fit.edge.motion) for fit in fits]
    return all(
        length(motion(placed[0], other)) <= APART[0] and turn(motion(placed[0], other)) <= APART[1]
        for other in placed[1:]
    )


def off(edge: Edge, poses: FloatArray) -> tuple[float, float]:
    """Metres and radians by which a closure misses the current estimate."""
    error = motion(motion(poses[edge.a], poses[edge.b]), edge.motion)
    return length(error), turn(error)
