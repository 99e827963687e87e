"""The start: the background's motion, what each scan says of the other under it, and groups that may have moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from estimation.geometry.poses import inverse
from estimation.geometry.sight import AGREES, THROUGH
from registration.crf.beams import Beams, beams_of, first_look, seen_by
from registration.crf.dominant import told_by_the_rest
from registration.crf.motion_hypotheses import MotionHypothesis, hypotheses, left_their_place
from registration.laser.outline import CLEAR, TOUCHING
from registration.laser.prepared import prepared
from registration.laser.scan import Scan
from registration.placement.align import REACH, TURN, best_of
from registration.placement.judgement import LENIENT, Asked, judged
from registration.result import Registration

CROWDED = Asked(0.65, 0.36, 1.15, -np.inf, False)  # of the nearest answer where there is no better one
HARDLY = Asked(0.55, 0.31, 0.9, -np.inf, False)  # the same, where what moved explains the rest
TOLD = 0.88  # share of what agrees or was seen through that then has to agree or to have moved
# Share of either scan's beams that agree with the other: outlines say less where one is filled.
LEAST_STANDING = 0.25
EXPLAINED = 0.7  # of a group that left its place, what is known to move
FASTEST = 12.0  # m/s, of anything, where stamps tell the interval
LEAST_REACH, MOST_REACH = 0.8, 1.5  # metres a thing may have gone between the scans


@dataclass(eq=False)
class Start:
    """What is known before the first message: made ready scans, the background's motion, groups that may move.

    `gone` are groups that certainly left their place but have no counterpart in scan b. sight, off : (n,) how b sees
    the points of a; fresh : (m,) how a sees those of b. again : (n,) points that left their place, where that
    was known of all of them; nothing was looked for then.
    """

    a: Beams
    b: Beams
    registration: Registration
    noise: float
    sight: NDArray[np.int64]
    off: FloatArray
    fresh: NDArray[np.int64]
    found: list[MotionHypothesis]
    gone: list[MotionHypothesis]
    again: NDArray[np.bool_] | None = None

    @property
    def motions(self) -> FloatArray:
        """(D, 3), background first."""
        return np.array([self.registration.transform, *(each.motion for each in self.found)])


def start(
    scan_a: Scan, scan_b: Scan, registration: Registration | None = None, trusted: bool = False,
    known: NDArray[np.bool_] | None = None,
) -> Start:  # fmt: skip
    """Register the background and find what does not follow it (InitialiseRT).

    trusted : the registration is not one that a near thing which fills much of the scans may have decided.
    known : (N,) beams of scan_a that are known to move; where these are all that left its place, where it went is not
        looked for.
    """
    a, b = beams_of(scan_a), beams_of(scan_b)
    guessed, doubtful = registration is not None, False
    if registration is None:
        registration, doubtful = _register(scan_a, scan_b)
    if not trusted:
        registration = told_by_the_rest(scan_a, scan_b, a, b, registration, guessed)
    background = registration.transform
    noise, sight, off = first_look(a, b, background)
    fresh, _ = seen_by(b, a, inverse(background), noise, TOUCHING)
    standing = min(np.mean(sight == AGREES), np.mean(fresh == AGREES)) if len(a) and len(b) else 0.0
    if registration.converged and standing < LEAST_STANDING:
        reason = f"only {standing:.0%} of the beams agree in both scans"
        registration = replace(registration, converged=False, reason=reason)
    again = _as_known(a, sight, known) if registration.converged and known is not None else None
    groups: list[MotionHypothesis] = []
    if registration.converged and again is None:
        groups, *explained = hypotheses(a, b, background, sight, fresh, reach_of(scan_a, scan_b), noise)
        told = _told((sight, fresh), explained) if doubtful else 1.0
        if told < TOLD:
            reason = f"little agrees, and what moved explains only {told:.0%} of the beams"
            registration = replace(registration, converged=False, reason=reason)
    found = [group for group in groups if group.matched]
    gone = [group for group in groups if not group.matched]
    return Start(a, b, registration, noise, sight, off, fresh, found, gone, again)


def _as_known(a: Beams, sight: NDArray[np.int64], known: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """(n,) points known to move that left their place; None where nothing did, or something else did as well."""
    groups = left_their_place(a, sight)
    own = known[a.beams]
    size = np.bincount(groups + 1, minlength=1)[1:]
    share = np.bincount(groups + 1, own, minlength=1)[1:] / np.maximum(size, 1)
    if not size.any() or (share[size > 0] < EXPLAINED).any():
        return None
    return np.asarray(own & (groups >= 0))


def _register(scan_a: Scan, scan_b: Scan) -> tuple[Registration, bool]:
    """The background's motion, and whether so little agrees that it has to be seen first what moved.

    Less is asked of it where it is not enough: in a crowd little of the outlines stands.
    """
    moving, still = prepared(scan_a), prepared(scan_b)
    nearest = best_of(moving, still, np.zeros(3), REACH, TURN)
    for asked in (LENIENT, CROWDED):
        near = judged(moving, still, *nearest, asked)
        if near.converged:
            return near, False
    return judged(moving, still, *nearest, HARDLY), True


def _told(sights: Sequence[NDArray[np.int64]], moved: Sequence[NDArray[np.bool_]]) -> float:
    """Share of what either scan shows of the other that agrees or is known to have `moved`."""
    agreeing = left = 0.0
    for sight, gone in zip(sights, moved, strict=True):
        agreeing += float(np.mean(sight == AGREES))
        left += float(np.mean(((sight == THROUGH) | (sight == CLEAR)) & ~gone))
    return agreeing / max(agreeing + left, 1e-9)


def reach_of(scan_a: Scan, scan_b: Scan) -> float:
    """Metres a thing may have gone between the scans."""
    interval = abs(scan_b.stamp - scan_a.stamp)
    return MOST_REACH if interval == 0.0 else float(np.clip(FASTEST * interval, LEAST_REACH, MOST_REACH))
