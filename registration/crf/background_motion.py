"""The background's motion once it is known what moves: refined on what is left of both outlines."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between
from registration.laser.prepared import prepared
from registration.laser.scan import Scan
from registration.placement.align import agreements
from registration.placement.judgement import LENIENT, judged
from registration.placement.refine import refine
from registration.result import Registration

DOUBT = 0.08  # metres, how far what stands may still lie off
MOST = 0.1  # metres and radians the motion may change by; more is another answer, not a better one


def without_movers(
    scan_a: Scan,
    scan_b: Scan,
    registration: Registration,
    associations: NDArray[np.int64],
    moving: NDArray[np.bool_],
) -> Registration:
    """`registration` refined without the beams of scan_a that move, (N,), and their partners in scan_b."""
    if not moving.any():
        return registration
    left = np.zeros(len(scan_b), dtype=bool)
    left[associations[moving & (associations >= 0)]] = True
    rest = prepared(scan_a).without(moving[scan_a.valid])
    target = prepared(scan_b).without(left[scan_b.valid])
    refined = refine(rest.surface, target.target, registration.transform.copy(), DOUBT)
    if (
        not refined.settled
        or refined.open_directions
        or np.abs(between(registration.transform, refined.pose)).max() > MOST
    ):
        return registration
    found = judged(
        rest, target, refined, registration.transform, agreements(rest, target, refined.pose), LENIENT
    )
    return found if found.converged else replace(registration, transform=refined.pose)
