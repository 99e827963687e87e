"""Registration where odometry says how the sensor moved: refined from there, searched for where that does not fit."""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import between
from registration.laser.prepared import PreparedScan
from registration.placement.align import agreements, among_movers, held, settle
from registration.placement.judgement import LENIENT, evidence, judged
from registration.placement.refine import refine
from registration.result import UNKNOWN, Registration

DOUBT = 0.15  # metres points may be off where odometry puts them
MOST = np.array([0.15, 0.15, 0.1])  # m, m, rad the answer may be away from there
FITS = 0.75  # share of what both could see that has to agree, for nothing else to be looked for
COMMON = 0.5  # share of all outline, likewise


def near_expected(
    moving: PreparedScan, still: PreparedScan, expected: FloatArray, covariance: bool = True
) -> Registration:
    """As `among_movers`, which searches wide, for who knows the motion (3,) to a decimetre.

    covariance : whether it is asked for, and millimetres matter. Without, `UNKNOWN` is given in its place, and
        what moves is not left out.
    """
    refined = refine(moving.surface, still.target, expected.copy(), DOUBT)
    views = agreements(moving, still, refined.pose)
    if covariance:
        refined, views = settle(moving, still, refined, views)
    refined, views = held(moving, still, refined, views, expected)
    if (
        refined.settled
        and refined.open_directions < 2
        and (np.abs(between(expected, refined.pose)) < MOST).all()
    ):
        found = evidence(moving, still, views)
        if found.fitness > FITS and found.overlap > COMMON:
            if not covariance:
                return Registration(refined.pose, UNKNOWN, found.fitness, True, "")
            registration = judged(moving, still, refined, expected, views, LENIENT)
            if registration.converged:
                return registration
    return among_movers(moving, still, expected)
