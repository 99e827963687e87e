"""A registration that one near thing decides: what fills much of a scan but is small may have moved itself.

Beams count what is near. The world is what is large: where the rest of both scans, laid on each other without that
thing, agrees clearly better, the rest stands and the thing has moved.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.poses import inverse
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
BETTER = 0.02  # share of the rest that has to agree more for another answer
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
    pose = registration.transform
    rest = among_movers(prepared(scan_a).without(big), prepared(scan_b).without(other), pose)
    share = max(float(np.mean(big)), float(np.mean(other)))
    agreed = _agreeing(a, b, pose, ~big)
    unsaid = rest.converged and bool(rest.reason) and not guessed
    if rest.converged and not unsaid:
        return rest if _agreeing(a, b, rest.transform, ~big) > agreed + BETTER else registration
    # What fits worse than the rest, or fills less than fits of the rest, has not decided it.
    held = max(_agreeing(a, b, pose, big), _agreeing(b, a, inverse(pose), other))
    if agreed > min(held, share) and not (unsaid and share > MUCH):
        return registration
    reason = f"a near object fills {share:.0%} of a scan; the rest does not tell how the sensor moved"
    return replace(registration, converged=False, reason=reason)


def _agreeing(a: Beams, b: Beams, pose: FloatArray, wanted: NDArray[np.bool_]) -> float:
    """Share of the wanted points of a, (n,), on b's outline."""
    return float(np.mean(seen_by(a, b, pose, NOISE, TOUCHING)[0][wanted] == AGREES)) if wanted.any() else 0.0
