"""Registration without a guess: what loop closures and lost robots need (Paper A section 4.3, Bosse and Zlot).

In the plane every rotation and translations of several metres are searched by correlation with bounds; the best
candidates are refined and scored by overlap and free-space violation, and two places that fit equally well are no
answer. The text's own way, histograms refined by ICP, stays selectable. In space KISS-Matcher finds the rough
transform and small_gicp refines it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from estimation.checks import FloatArray
from estimation.errors import InputError
from estimation.geometry.poses import between
from registration.clouds.cloud_doubt import OPEN_VARIANCE
from registration.clouds.cloud_registration import (
    align_clouds,
    checked_cloud,
    leaf_size,
    too_few,
)
from registration.clouds.feature_matching import match_features
from registration.laser.prepared import PreparedScan, prepare
from registration.laser.scan import Scan
from registration.placement.align import Views, both_clouds, held, ranked, settle
from registration.placement.align_submaps import RIVAL, apart
from registration.placement.classic import icp
from registration.placement.correlative import ROUGH, Wanted, candidates
from registration.placement.histograms import histogram_candidates
from registration.placement.judgement import GUESS_SIGMA, Asked, judged
from registration.placement.refine import Refined, refine
from registration.result import Registration

REACH = 6.0  # metres between the two sensors in x and in y
CANDIDATES = 12
KEEP = 0.55  # share of the best candidate's correlation that another needs: seen from elsewhere, little fits
AGAINST = 3.0  # metres of agreeing outline that one in seen space outweighs: where places are one, little contradicts
# What was out of view speaks for no place. A room laid on itself after half a turn agrees along all of its walls, while
# the true place, of which both scans saw little, only has nothing against it: share of the best merit, and of what can
# be judged, from which such a place is one. Without, more simulated pairs are accepted, some of them wrong.
POSSIBLE, UNDISPUTED = 0.5, 0.95
TURNED = 0.3  # rad by which that place has to be turned; along a wall, places next to each other are alike
# Without a guess there are as many wrong places as there are candidates.
ASKED = Asked(merit=0.39)


def align_globally(
    source: Scan | ArrayLike, target: Scan | ArrayLike, method: str = "correlation"
) -> Registration:
    """Motion that lays `source` on `target`, from anywhere: any rotation, in the plane up to 6 m apart in x and y.

    Parameters
    ----------
    source, target : both planar, each a `Scan` or points (N, 2), or both clouds (N, 3); metres, sensor frames.
    method : "correlation"; for planar data also the text's "histogram".

    Returns
    -------
    Registration : `converged` is False and `reason` says why where too little agrees or several places do.

    Raises
    ------
    InputError : wrong shapes, a planar with a spatial argument, an unknown method.
    """
    if method not in tuple(METHODS):
        raise InputError(f"method: one of {', '.join(METHODS)} expected, got {method!r}")
    if both_clouds(source, target):
        if method != "correlation":
            raise InputError(f"method: clouds are registered by 'correlation' only, got {method!r}")
        return _clouds(np.asarray(source), np.asarray(target))
    return _outlines(prepare("source", source), prepare("target", target), METHODS[method])


def _by_correlation(moving: PreparedScan, still: PreparedScan) -> Iterator[Refined]:
    found = candidates(
        moving.surface.points, still.surface.points, np.zeros(3), REACH, np.pi, Wanted(KEEP, CANDIDATES)
    )  # fmt: skip
    for candidate in found:
        yield refine(moving.surface, still.target, candidate[1:].copy(), ROUGH)


def _by_histograms(moving: PreparedScan, still: PreparedScan) -> Iterator[Refined]:
    for candidate in histogram_candidates(moving.surface, still.surface, CANDIDATES):
        yield icp(moving, still, candidate)


METHODS = {"correlation": _by_correlation, "histogram": _by_histograms}


def _outlines(
    moving: PreparedScan,
    still: PreparedScan,
    found: Callable[[PreparedScan, PreparedScan], Iterator[Refined]],
) -> Registration:
    start = np.zeros(3)
    placed = ranked(moving, still, found(moving, still), AGAINST)
    if not placed:
        return judged(moving, still, None, start, None)
    best = placed[0][0]
    refined, views = held(moving, still, *settle(moving, still, *placed[0][1:]), start)
    outcome = judged(moving, still, refined, start, views, ASKED)
    if not outcome.converged:
        return outcome
    if refined.open_directions:
        return _refused(outcome, outcome.reason + " and there is no guess")
    for score, rival, views in placed[1:]:
        if not apart(refined.pose, rival.pose):
            continue
        if score > RIVAL * best:
            return _refused(outcome, "another pose fits as well")
        turned = abs(between(refined.pose, rival.pose)[2]) > TURNED
        if turned and score > POSSIBLE * best and _undisputed(views):
            return _refused(outcome, "another pose cannot be ruled out: no view contradicts it")
    return outcome


def _undisputed(views: Views) -> bool:
    agreeing, standing = sum(view.agreeing for view in views), sum(view.standing for view in views)
    return bool(agreeing > UNDISPUTED * (agreeing + standing))


def _refused(outcome: Registration, reason: str) -> Registration:
    covariance = outcome.covariance + np.diag(GUESS_SIGMA**2)
    return replace(outcome, covariance=covariance, converged=False, reason=reason)


def _clouds(source: FloatArray, target: FloatArray) -> Registration:
    moving, still = checked_cloud("source", source), checked_cloud("target", target)
    refusal = too_few(moving, still, np.eye(4))
    if refusal is not None:
        return refusal
    best: Registration | None = None
    for voxel in (4.0 * leaf_size(still), 7.0 * leaf_size(still)):
        match = match_features(moving, still, voxel)
        if match is None:
            continue
        found = align_clouds(moving, still, match.transform, close=True)
        if found.converged and match.inliers < 5:
            reason = f"only {match.inliers} features match"
            found = replace(found, converged=False, reason=reason)
        if best is None or (found.converged, found.fitness) > (best.converged, best.fitness):
            best = found
    if best is None:
        return Registration(np.eye(4), OPEN_VARIANCE * np.eye(6), 0.0, False, "no features match")
    return best
