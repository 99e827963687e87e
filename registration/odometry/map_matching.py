"""Where in a local map a scan was taken: the placement with the best odds, looked for farther the worse they are."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import transform_points, wrap_angle
from estimation.geometry.sight import SIGMAS, THROUGH
from registration.laser.local_map import DOUBT, SPACING, LineMap
from registration.laser.prepared import NOTHING_SEEN, PreparedScan, ScanView
from registration.placement.align import keep_open
from registration.placement.consistency import Agreement, weigh
from registration.placement.correlative import ROUGH, candidates
from registration.placement.refine import EFFICIENCY, NO_PRIOR, Refined, lead, refine

# Set on csail, an endless corridor and simulated floors, scans at a rate and a metre apart.
WORTH = 0.7  # metres of agreeing outline that tell one nat
# Metres of agreeing outline that one metre outweighs of which the map knows nothing, and one that is contradicted.
UNKNOWN, AGAINST = 0.33, 2.0
TAIL = 2.0  # degrees of freedom of predictions' errors: how often they are many deviations off
ACCEPT = -3.0  # nat, odds from which on a placement is believed
SURE = 0.5  # share of the best odds any placement of a scan can have from which on none other is looked for
NEAR_SEARCH = (1.2, math.radians(70.0))  # metres, radians
WIDE_SEARCH = (2.8, math.pi)
HELD = 1.0  # nat against a placement from which on wheels are asked to hold the scan
# Metres of outline whose points go wrong together, as they are of one wall; 1 m does about the same.
PIECE = 0.5
GROSS = 14.0  # nat, one in a million: how rarely wheels err as no covariance tells; 20 does the same
SIGHT = 15.0  # metres around the prediction a search looks at
CLEAR = SIGMAS * DOUBT  # metres a sensor stands off the plane of a line that it can see through

Prior = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class ExpectedPose:
    """Where a scan is expected.

    pose : (3,). covariance : (3, 3) of it, map frame. prior : it with the information that wheels give, if any.
    """

    pose: FloatArray
    covariance: FloatArray
    prior: Prior | None = None

    @cached_property
    def information(self) -> FloatArray:
        """(3, 3) inverse of `covariance`."""
        return np.asarray(np.linalg.inv(self.covariance))

    def against(self, pose: FloatArray) -> float:
        """Nat that speak against a pose (3,) as it is not where it is expected: those of Student's distribution."""
        square = _square(pose, self.pose, self.information)
        return 0.5 * (TAIL + 3.0) * math.log1p(square / TAIL)


@dataclass(frozen=True)
class Match:
    """A pose and how the scan agrees with the map there.

    against : metres of outline, the map's or the scan's, that stand where the other saw through.
    odds : nat, for the scan having been taken there.
    """

    refined: Refined
    agreement: Agreement
    against: float
    odds: float

    @property
    def share(self) -> float:
        """Agreeing share of the scan's outline; what the map does not know counts as not agreeing."""
        return self.agreement.share

    @property
    def reason(self) -> str:
        """Why it is doubtful."""
        return f"only {self.share:.0%} of the scan agrees with the map, and {self.against:.1f} m contradict"

    @property
    def believable(self) -> bool:
        """Whether it is where the scan was taken, as far as can be told."""
        return self.odds > ACCEPT

    @property
    def sure(self) -> bool:
        """Whether the scan can hardly agree with any other place as much."""
        return self.odds > SURE * self.agreement.length / WORTH


class MapMatcher:
    """Finds scans in a map.

    doubt : metres a prediction may be off for a plain refinement. tolerance : metres, deviation from a line up to
    which a point pulls with nearly full weight. It is several times the noise on purpose: a tighter kernel believes
    the map's own errors and keeps them.
    """

    def __init__(self, local_map: LineMap, doubt: float, tolerance: float) -> None:
        self.map, self._doubt, self._tolerance = local_map, doubt, tolerance
        self._view, self._view_pose = NOTHING_SEEN, np.zeros(3)

    def saw(self, view: ScanView, pose: FloatArray) -> None:
        """Remember what the last registered scan saw through."""
        self._view, self._view_pose = view, pose

    def find(self, scan: PreparedScan, expected: ExpectedPose, last: FloatArray) -> Match:
        """The best match there is.

        last : (3,) where the sensor was last sure to be, which is searched around where all else fails.
        """
        best = self._laid(scan, expected, expected.pose, self._doubt)
        if expected.against(best.refined.pose) > HELD:
            # Lines that tell little of the way along a corridor let a scan slide along it: the prediction holds it.
            motion = expected.pose, EFFICIENCY * expected.information
            prior = expected.prior or motion
            held = self._laid(scan, expected, expected.pose, self._doubt, prior)
            if expected.prior is None:
                best = max([best, held], key=_odds)
            else:
                there, kept = (0.5 * _square(one.refined.pose, *prior) for one in (best, held))
                if self.led(best, scan, held.refined.pose) <= min(there - kept, GROSS):
                    best = held
        if not best.sure:
            best = max([best, *self._search(scan, expected, expected.pose, NEAR_SEARCH)], key=_odds)
        if not best.believable:
            farther = max([best, *self._search(scan, expected, last, WIDE_SEARCH)], key=_odds)
            # Of what is not to be believed, the nearer.
            best = farther if farther.believable else best
        return best

    def kept(self, scan: PreparedScan, expected: ExpectedPose, match: Match) -> Match:
        """The prediction as it is, in the place of `match`."""
        return self._judged(scan, expected, replace(match.refined, pose=expected.pose))

    def led(self, match: Match, scan: PreparedScan, other: FloatArray) -> float:
        """By how many nat lines make a match likelier than another pose (3,)."""
        more = lead(scan.surface, self.map.target, match.refined, other, self._tolerance)
        return more * match.agreement.agreeing / PIECE

    def _laid(
        self,
        scan: PreparedScan,
        expected: ExpectedPose,
        start: FloatArray,
        doubt: float,
        prior: Prior = NO_PRIOR,
    ) -> Match:
        refined = refine(scan.surface, self.map.target, start.copy(), doubt, self._tolerance, prior=prior)
        return self._judged(scan, expected, refined)

    def _search(
        self,
        scan: PreparedScan,
        expected: ExpectedPose,
        around: FloatArray,
        window: tuple[float, float],
    ) -> list[Match]:
        reach, turn = window
        local = self.map.points
        around_it = np.ascontiguousarray(local[np.hypot(*(local - around[:2]).T) < SIGHT] - around[:2])
        centre = np.array([0.0, 0.0, around[2]])
        found = []
        for candidate in candidates(scan.surface.points, around_it, centre, reach, turn):
            pose = candidate[1:] + np.array([around[0], around[1], 0.0])
            match = self._laid(scan, expected, pose, ROUGH)
            if match.refined.open_directions in (1, 2):
                match = self._laid(scan, expected, keep_open(match.refined, expected.pose), ROUGH)
            found.append(match)
        return found

    def _judged(self, scan: PreparedScan, expected: ExpectedPose, refined: Refined) -> Match:
        """With its odds: what of the scan's outline agrees, less what does not, less how far it is from where expected.

        Against it are map outline that this scan saw through and its own where the last scan did.
        """
        pose, surface = refined.pose, scan.surface
        agreement = weigh(surface, self.map.target, NOTHING_SEEN, pose, 0.1)
        against = SPACING * float(np.count_nonzero(self.map.seen_through(scan.view, pose, CLEAR)))
        odd = agreement.labels != 0
        points = transform_points(pose, surface.points[odd])
        standing = self._view.sight(points, self._view_pose, DOUBT) == THROUGH
        against += float(surface.length[odd][standing].sum())
        told = agreement.agreeing - UNKNOWN * agreement.unknown - AGAINST * against
        return Match(refined, agreement, against, told / WORTH - expected.against(pose))


def _odds(match: Match) -> float:
    return match.odds


def _square(pose: FloatArray, expected: FloatArray, information: FloatArray) -> float:
    """Squared deviations of a pose (3,) from what is expected."""
    away = pose - expected
    away[2] = wrap_angle(float(away[2]))
    return float(away @ information @ away)
