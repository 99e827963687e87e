"""Local maps laid on local maps: what closes a loop, from any direction (Paper A, section 4.3).

All placements within a window are searched by correlation; each promising one is refined on lines and judged by
what both maps saw there. A placement is believed where enough outline agrees, hardly any stands in space the other
map saw through, the lines fix all three directions, and no other placement does nearly as well.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from estimation.geometry.poses import between, inverse
from registration.laser.submap import Submap
from registration.placement.consistency import judge
from registration.placement.correlative import Wanted, candidates
from registration.placement.refine import refine

MOST = 4  # placements
SEARCHED = 220  # points of the source the search looks at
DOUBT = 0.25  # metres a candidate of the search may be off
NOISE = 0.03  # metres, of a fused outline over metres of odometry
FLOOR = np.array([0.02, 0.02, 0.002])  # m, m, rad: what bent local maps and their fusing leave
CORRELATED = 30.0  # neighbouring points share their error: so many count as one
FREE = np.array([3.0, 3.0, 1.0])  # m, m, rad: of a direction the lines leave open
LOOSEST = 0.12  # metres, standard deviation in the direction a placement says least about
LEAST_AGREEING = 4.0  # metres of outline, of the lesser side
LEAST_FITNESS = 0.9
LEAST_OVERLAP = 0.35  # agreeing share of the source's outline, looked at or not
RIVAL = 0.85
APART = (0.35, np.deg2rad(10.0))  # placements nearer than this are one


@dataclass(frozen=True)
class Placement:
    """One way to lay a local map on another.

    pose : (3,) of the source's anchor in the target's frame; covariance (3, 3) of it, target's frame.
    fitness : agreeing share of the outline that could be judged, both ways. overlap : agreeing share of the lesser
    side's whole outline. agreeing : metres, of the lesser side. reason : why it cannot be believed, or empty.
    """

    pose: FloatArray
    covariance: FloatArray
    fitness: float
    overlap: float
    agreeing: float
    merit: float
    open_directions: int
    reason: str

    @property
    def sure(self) -> bool:
        """Whether it can be believed, other placements aside."""
        return not self.reason


def align_submaps(
    source: Submap, target: Submap, guess: FloatArray, reach: float, turn: float
) -> list[Placement]:
    """Placements of `source` on `target` around `guess` (3,), the best MOST of them, best first, apart from each other.

    reach : metres to either side of the guess in x and y. turn : radians to either side.
    """
    if len(source) < 20 or len(target) < 20:
        return []
    # The target is searched around where the source is expected, so that far parts of it play no role.
    near = np.ascontiguousarray(target.points - guess[:2])
    found = candidates(
        _spread(source.points, SEARCHED),
        near,
        np.array([0.0, 0.0, guess[2]]),
        reach,
        turn,
        Wanted(keep=0.75, most=2 * MOST, points=10**6),
    )
    starts = found[:, 1:] + np.array([guess[0], guess[1], 0.0])
    placed = [place(source, target, start, DOUBT) for start in starts]
    placed.sort(key=lambda placement: -placement.merit)
    chosen: list[Placement] = []
    for placement in placed:
        if all(apart(placement.pose, other.pose) for other in chosen):
            chosen.append(placement)
    return chosen[:MOST]


def place(source: Submap, target: Submap, start: FloatArray, doubt: float) -> Placement:
    """The placement that refinement from `start` (3,) leads to."""
    refined = refine(source.surface, target.target, start.copy(), doubt, NOISE)
    views = judge(source, target, refined.pose), judge(target, source, inverse(refined.pose))
    agreeing, both = min(view.agreeing for view in views), sum(view.agreeing for view in views)
    standing = sum(view.standing for view in views)
    fitness = both / max(both + views[0].standing + views[1].standing, 1e-9)
    overlap = max(view.share for view in views)
    covariance = np.linalg.inv(refined.information / CORRELATED + np.diag(FREE**-2.0)) + np.diag(FLOOR**2)
    covariance = 0.5 * (covariance + covariance.T)
    reason = ""
    if refined.open_directions:
        reason = f"{refined.open_directions} of 3 directions are unconstrained"
    elif not refined.settled:
        reason = "the iterations did not settle"
    elif (loosest := float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]))) > LOOSEST:
        reason = f"the position is uncertain by {loosest:.2f} m in one direction"
    elif agreeing < LEAST_AGREEING or overlap < LEAST_OVERLAP:
        reason = f"too little overlap: {agreeing:.1f} m of contour ({overlap:.0%})"
    elif fitness < LEAST_FITNESS:
        reason = f"only {fitness:.0%} of the overlap agrees"
    merit = both - 2.0 * standing
    return Placement(
        refined.pose, covariance, fitness, overlap, agreeing, merit, refined.open_directions, reason
    )


def ambiguous(placements: list[Placement]) -> bool:
    """Whether another placement does nearly as well as the first."""
    return len(placements) > 1 and placements[1].merit > RIVAL * placements[0].merit


def apart(a: FloatArray, b: FloatArray) -> bool:
    """Whether two poses (3,) are different placements."""
    away = between(a, b)
    return bool(np.hypot(*away[:2]) > APART[0] or abs(away[2]) > APART[1])


@njit(cache=True)
def _spread(points, count):  # type: ignore[no-untyped-def]
    """About `count` of `points` (N, 2), evenly over the plane: the first in each cell, of growing cells."""
    low, high = np.full(2, np.inf), np.full(2, -np.inf)
    for k in range(len(points)):
        for a in range(2):
            low[a], high[a] = min(low[a], points[k, a]), max(high[a], points[k, a])
    first = np.empty(len(points), dtype=np.int64)
    cell = 0.1
    while True:
        left, bottom = math.floor(low[0] / cell), math.floor(low[1] / cell)
        taken = np.zeros(
            (math.floor(high[0] / cell) - left + 1, math.floor(high[1] / cell) - bottom + 1), dtype=np.bool_
        )
        found = 0
        for k in range(len(points)):
            i, j = math.floor(points[k, 0] / cell) - left, math.floor(points[k, 1] / cell) - bottom
            if not taken[i, j]:
                taken[i, j] = True
                first[found] = k
                found += 1
        if found <= count:
            return points[first[:found]]
        cell *= max(1.15, np.sqrt(found / count) * 0.9)
