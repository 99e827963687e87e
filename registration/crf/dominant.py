"""A registration that one near thing decides: what fills much of a scan but is small may have moved itself.

Beams count what is near. The world is what is large: where the rest of both scans, laid on each other without that
thing, agrees clearly better, the rest stands and the thing has moved.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.poses import between, inverse
from estimation.geometry.sight import AGREES
from registration.crf.beams import Beams, seen_by
from registration.laser.outline import TOUCHING
from registration.laser.prepared import prepared
from registration.laser.scan import Scan
from registration.placement.align import among_movers
from registration.result import Registration

SHARE = 0.25  # of the returned beams, from which one piece may decide a registration
LARGEST = 5.0  # metres, extent of what may move
NEARER = 0.7  # of the median range of the rest: what fills much without being large
NOISE = 0.025  # metres, of the scanner, at the most
SAME = 0.03  # metres and radians between two answers that are one
BETTER = 0.02  # share of the rest that has to agree more for another answer
LEAST = 0.6  # share of the rest that has to agree with an answer that it does not give itself
LITTLE = 0.2  # the same, where what is near fills too little to have decided: in a crowd much of the rest moves as well
DECIDES = 0.47  # share of the returned beams, from which it may have
LEAST_FILLED = 0.6  # and with one that it gives, where most of the scan is filled
FOLLOWED = 0.7  # share of a near thing that agrees with an answer that it may have decided
MUCH = 0.4  # of the beams of a scan, from which the rest has to say in which direction the sensor went


def dominant(beams: Beams) -> NDArray[np.bool_]:
    """(n,) returns on small things near the sensor that fill `SHARE` of the scan each."""
    chosen = np.zeros(len(beams), dtype=bool)
    if not len(beams):
        return chosen
    ranges = beams.ranges[beams.beams]
    for piece in np.flatnonzero(np.bincount(beams.pieces) >= SHARE * len(beams)):
        members = beams.pieces == piece
        extent = float(np.hypot(*np.ptp(beams.points[members], axis=0)))
        if extent < LARGEST and not members.all():
            chosen |= members & (np.median(ranges[members]) < NEARER * np.median(ranges[~members]))
    return chosen


def told_by_the_rest(
    scan_a: Scan, scan_b: Scan, a: Beams, b: Beams, registration: Registration, guessed: bool = False
) -> Registration:
    """`registration`, or that of what is not dominant.

    Not converged where the rest contradicts and tells nothing, and where it leaves a direction of motion open: there
    the near thing alone would say how far the sensor went. guessed : something else says that too, such as odometry.
    """
    big, other = dominant(a), dominant(b)
    if not big.any() and not other.any():
        return registration
    moving, still = prepared(scan_a).without(big), prepared(scan_b).without(other)
    rest = among_movers(moving, still, registration.transform)
    share = max(float(np.mean(big)), float(np.mean(other)))
    if not guessed and share > MUCH and rest.converged and rest.reason:
        reason = f"a near object fills {share:.0%} of a scan; the rest leaves a direction of motion open"
        return replace(registration, converged=False, reason=reason)
    agreed = _agreeing(a, b, registration.transform, ~big)
    if rest.converged and _agreeing(a, b, rest.transform, ~big) > agreed + BETTER:
        return rest
    if rest.converged and np.abs(between(rest.transform, registration.transform)).max() < SAME:
        least = LEAST_FILLED if np.mean(big) > 0.5 else 0.0
    else:
        least = LEAST if np.mean(big) >= DECIDES else LITTLE
    if registration.converged and agreed < least and _follows(a, b, registration.transform, big, other):
        reason = f"a near object fills {np.mean(big):.0%} of the scan and fits, but only {agreed:.0%} of the rest does"
        return replace(registration, converged=False, reason=reason)
    return registration


def _follows(a: Beams, b: Beams, pose: FloatArray, big: NDArray[np.bool_], other: NDArray[np.bool_]) -> bool:
    """Whether what is near in either scan, (n,) and (m,), agrees with an answer; else it has not decided it."""
    shares = (_agreeing(a, b, pose, big), _agreeing(b, a, inverse(pose), other))
    return max(shares) > FOLLOWED


def _agreeing(a: Beams, b: Beams, pose: FloatArray, wanted: NDArray[np.bool_]) -> float:
    """Share of the wanted points of a, (n,), on b's outline."""
    return float(np.mean(seen_by(a, b, pose, NOISE, TOUCHING)[0][wanted] == AGREES)) if wanted.any() else 0.0
