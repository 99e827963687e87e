"""Where in a local map a scan was taken: from a prediction, and where that fails, by search around it."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import between, transform_points, wrap_angle
from estimation.geometry.sight import THROUGH
from registration.laser.local_map import DOUBT, SPACING, LineMap
from registration.laser.prepared import NOTHING_SEEN, PreparedScan, ScanView
from registration.placement.align import keep_open
from registration.placement.consistency import Agreement, weigh
from registration.placement.correlative import candidates
from registration.placement.refine import NO_PRIOR, Refined, lead, refine

SURE = 0.6  # share of a scan's outline that needs no second look where it was predicted to be
# The same elsewhere: somebody walking along with the sensor pulls it along, as on csail.
SURER = 0.9
FAR = 0.4  # share asked of a match far from the prediction where nothing but the last motion predicts
# Less what contradicts, asked of a match turned far: rooms and corridors fit themselves backwards.
TURNED = 0.6
NEAR = (0.25, 0.12)  # metres and radians from the prediction within which little has to agree
ELSEWHERE = 0.6  # metres or radians from it from which on a few pieces of outline fit in many places
LEAST_OUTLINE = 4.0  # metres that have to agree far from the prediction
# The next two matter in a corridor without an end only.
AGREES, MUCH = 0.65, 6.0  # share and metres of outline that make what contradicts unimportant nearby
NEW, SOME = 0.3, 2.5  # the same where nothing contradicts
NEAR_SEARCH = (1.2, math.radians(70.0), 2)  # metres, radians, levels
WIDE_SEARCH = (2.8, math.pi, 4)
SIGHT = 15.0  # metres around the prediction a search looks at


# Metres of outline whose points go wrong together, as they are of one wall. Set on simulated floors and checked on
# csail; 1 m does about the same.
PIECE = 0.5
GROSS = 14.0  # nat, one in a million: how rarely wheels err as no covariance tells; 20 does the same

Prior = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Match:
    """A pose and how the scan agrees with the map there.

    against : metres of outline, the map's or the scan's, that stand where the other saw through.
    """

    refined: Refined
    agreement: Agreement
    against: float = 0.0

    @property
    def share(self) -> float:
        """Agreeing share of the scan's outline; what the map does not know counts as not agreeing."""
        return self.agreement.share

    @property
    def agrees(self) -> bool:
        """Whether so much of the outline agrees that the rest may contradict: doors open, glass is seen through."""
        return self.share >= AGREES and self.agreement.agreeing >= MUCH and self.refined.open_directions < 2

    @property
    def uncontradicted(self) -> bool:
        """Whether what the map knows agrees, though most of the view is new, as after a corner."""
        clear = self.against < 0.1 * self.agreement.agreeing and self.refined.open_directions < 2
        return clear and self.share >= NEW and self.agreement.agreeing >= SOME

    def expected(self, start: FloatArray) -> bool:
        """Whether it is about what was predicted."""
        return near(start, self.refined.pose, 0.5)

    def believable(self, start: FloatArray, far: float) -> bool:
        """Whether enough speaks for it: little is enough where it is what was predicted.

        far : share that is asked of a match `ELSEWHERE` from the prediction.
        """
        if self.refined.open_directions == 3:
            return False
        away = between(start, self.refined.pose)
        distance, turn = float(np.hypot(*away[:2])), abs(float(away[2]))
        if near(start, self.refined.pose):
            return self.share >= 0.25
        least = FAR
        if distance > ELSEWHERE or turn > ELSEWHERE:
            if self.refined.open_directions or self.agreement.agreeing < LEAST_OUTLINE:
                return False
            least = far
        doubt = self.against / self.agreement.agreeing if self.agreement.agreeing else 1.0
        if turn > ELSEWHERE and self.share - doubt < TURNED:
            return False
        return self.share >= least and doubt < 0.4


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

    def find(
        self,
        scan: PreparedScan,
        start: FloatArray,
        last: FloatArray,
        far: float = FAR,
        wide: bool = False,
        little: bool = False,
        other: FloatArray | None = None,
        prior: Prior | None = None,
    ) -> tuple[Match, bool]:
        """Best match around `start` (3,), and whether it is to be believed.

        other : a second prediction (3,) that is far from `start`; what the scan agrees with more is followed.
        far : share asked of a match far from the prediction.
        wide : search around `last` too, where the sensor was last sure to be.
        little : near `start`, little or contradicted agreement is enough: neighbouring scans share little.
        prior : pose and information that wheels give. Lines that tell little of the way along a corridor let a scan
            slide along it; one that leaves the prior must have more to say than the prior has against it.
        """
        best = self._refined(scan, start.copy(), self._doubt)
        if other is not None:
            rival = self._refined(scan, other.copy(), self._doubt)
            if self._outdoes(rival, best, scan):
                best = rival
            # Both may have led to one place: what predicted it is what is nearer to it.
            start = min(start, other, key=lambda pose: _away(pose, best.refined.pose))
        if prior is not None and not best.expected(start):
            held = self._refined(scan, prior[0].copy(), self._doubt, prior)
            if not self._outweighs(best, held, prior, scan):
                best = held
        if best.expected(start) and best.share >= SURE and best.refined.open_directions < 3:
            return best, True
        if best.believable(start, far) and best.share >= SURER:
            return best, True
        tight = self._refined(scan, start.copy(), 0.1)
        found = [best, tight, *self._search(scan, start, start, NEAR_SEARCH)]
        best = self._best(found, scan, start, far)
        if little and not best.believable(start, far):
            weighed = [self._weighed(match, scan) for match in found]
            close = [match for match in weighed if match.agrees or match.uncontradicted]
            if close:
                return max(close, key=lambda match: match.agreement.agreeing), True
        if wide and not best.believable(start, far):
            found = [best, *self._search(scan, last, start, WIDE_SEARCH)]
            farther = self._best(found, scan, start, far)
            # Of what is not to be believed, the nearer.
            best = farther if farther.believable(start, far) else best
        return best, best.believable(start, far)

    def outdoes_prediction(self, match: Match, scan: PreparedScan, start: FloatArray) -> bool:
        """Whether more speaks for a match that is not to be believed than for the prediction `start` (3,) as it is.

        It helps where places are lost, as in belgioioso.
        """
        away = between(start, match.refined.pose)
        reach, turn, _ = NEAR_SEARCH
        if match.refined.open_directions > 1 or np.hypot(*away[:2]) > reach or abs(away[2]) > turn:
            return False
        there = replace(match.refined, pose=start)
        kept = Match(there, weigh(scan.surface, self.map.target, NOTHING_SEEN, start, 0.1))
        ours, theirs = (_merit(self._weighed(m, scan), start) for m in (match, kept))
        return ours > theirs

    def led(self, match: Match, scan: PreparedScan, other: FloatArray) -> float:
        """By how many nat lines make a match likelier than another pose (3,)."""
        more = lead(scan.surface, self.map.target, match.refined, other, self._tolerance)
        return more * match.agreement.agreeing / PIECE

    def _outweighs(self, match: Match, held: Match, prior: Prior, scan: PreparedScan) -> bool:
        """Whether lines say more for a match than a prior says for one that it holds."""
        there, kept = (0.5 * _square(m.refined.pose, prior) for m in (match, held))
        return self.led(match, scan, held.refined.pose) > min(there - kept, GROSS)

    def _outdoes(self, rival: Match, match: Match, scan: PreparedScan) -> bool:
        """Whether more of the scan's outline agrees there, less what contradicts."""
        ours, theirs = (m.agreement.agreeing - self._weighed(m, scan).against for m in (match, rival))
        return rival.refined.open_directions < 3 and theirs > ours

    def _refined(self, scan: PreparedScan, start: FloatArray, doubt: float, prior: Prior = NO_PRIOR) -> Match:
        refined = refine(scan.surface, self.map.target, start, doubt, self._tolerance, prior=prior)
        return Match(refined, weigh(scan.surface, self.map.target, NOTHING_SEEN, refined.pose, 0.1))

    def _search(
        self, scan: PreparedScan, around: FloatArray, start: FloatArray, window: tuple[float, float, int]
    ) -> list[Match]:
        reach, turn, levels = window
        local = self.map.points
        around_it = np.ascontiguousarray(local[np.hypot(*(local - around[:2]).T) < SIGHT] - around[:2])
        centre = np.array([0.0, 0.0, around[2]])
        found = []
        for candidate in candidates(scan.surface.points, around_it, centre, reach, turn, levels=levels):
            pose = candidate[1:] + np.array([around[0], around[1], 0.0])
            match = self._refined(scan, pose, 0.2)
            if match.refined.open_directions in (1, 2):
                match = self._refined(scan, keep_open(match.refined, start), 0.2)
            found.append(match)
        return found

    def _best(self, found: list[Match], scan: PreparedScan, start: FloatArray, far: float) -> Match:
        weighed = [self._weighed(match, scan) for match in found]
        return max(weighed, key=lambda match: (match.believable(start, far), _merit(match, start)))

    def _weighed(self, match: Match, scan: PreparedScan) -> Match:
        """With what is `against` it: map outline this scan saw through, its own where the last scan did."""
        pose, surface = match.refined.pose, scan.surface
        through = SPACING * float(np.count_nonzero(self.map.seen_through(scan.view, pose)))
        odd = match.agreement.labels != 0
        points = transform_points(pose, surface.points[odd])
        standing = self._view.sight(points, self._view_pose, DOUBT) == THROUGH
        return replace(match, against=through + float(surface.length[odd][standing].sum()))


def near(one: FloatArray, other: FloatArray, share: float = 1.0) -> bool:
    """Whether two poses (3,) are within a `share` of `NEAR`."""
    away = between(one, other)
    return bool(np.hypot(*away[:2]) < share * NEAR[0] and abs(away[2]) < share * NEAR[1])


def _square(pose: FloatArray, prior: Prior) -> float:
    """Squared deviations of a pose (3,) from a prior."""
    away = pose - prior[0]
    away[2] = wrap_angle(away[2])
    return float(away @ prior[1] @ away)


def _away(one: FloatArray, other: FloatArray) -> float:
    """Distance of two poses (3,), in metres and radians together."""
    return float(np.abs(between(one, other)).sum())


def _merit(match: Match, start: FloatArray) -> float:
    """Agreeing outline, less what speaks against it, less for being far from the prediction.

    The last helps a little on csail without wheels.
    """
    away = between(start, match.refined.pose)
    far = min(float(np.hypot(*away[:2])) / 0.5 + abs(float(away[2])) / 0.3, 3.0)
    return match.agreement.agreeing * (1.0 - 0.15 * far) - match.against
