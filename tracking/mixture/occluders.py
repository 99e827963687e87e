"""Detection probability that knows what is in the way (item 3, Figure 4f of Paper B).

Whether a target can be seen is read off the scan itself: beams towards it that end nearer were stopped by something,
whatever that was. The share is averaged over where the target may be, so it changes smoothly as somebody walks behind
something, and grows again as his position becomes uncertain.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from registration.laser.scan import Scan

HALF_WIDTH = 0.15  # metres to either side of a person's middle that the laser sees
MARGIN = 0.35  # metres before and behind the middle that are still the person
# A beam that ends where the person should be has seen something: it may be the person, merged with what is beside.
AMBIGUOUS = 0.4


# Places in standard deviations (13, 2): the middle, eight around it, four twice as far; and their probabilities (13,)
# with about the moments of a standard normal distribution.
_TURNS = 0.25 * np.pi * np.arange(8)
_RING = np.column_stack((np.cos(_TURNS), np.sin(_TURNS)))
PLACES = np.concatenate((np.zeros((1, 2)), _RING, 2.0 * _RING[::2]))
WEIGHTS = np.repeat((0.16, 0.06, 0.09), (1, 8, 4))


def seen_shares(
    scan: Scan, centres: FloatArray, spreads: FloatArray, max_range: float
) -> tuple[FloatArray, FloatArray]:
    """How much of a person this scan would show at the places where each target may be.

    centres : (T, 2) metres in the sensor frame. spreads : (T, 2, 2) their covariances, m².

    Returns
    -------
    shares (T, 13) in [0, 1] for places (T, 13, 2), m from the centre; `WEIGHTS` are the probabilities of the places.
    """
    ranges = np.where(scan.valid, scan.ranges, np.inf)
    limit = min(max_range, scan.range_max)
    # A root of each covariance whose columns are the axes of the ellipse.
    values, vectors = np.linalg.eigh(spreads)
    axes = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    places = PLACES @ np.swapaxes(axes, 1, 2)
    shares = _shares(ranges, scan.angle_min, scan.angle_increment, limit, centres[:, None] + places)
    return np.asarray(shares), np.asarray(places)


@njit(cache=True)
def _shares(ranges, angle_min, step, limit, places):  # type: ignore[no-untyped-def]
    shares = np.zeros(places.shape[:2])
    for t in range(places.shape[0]):
        for s in range(places.shape[1]):
            shares[t, s] = _seen(ranges, angle_min, step, limit, places[t, s, 0], places[t, s, 1])
    return shares


@njit(cache=True)
def _seen(ranges, angle_min, step, limit, x, y):  # type: ignore[no-untyped-def]
    """How much of a person at (x, y) this scan would show."""
    away = math.hypot(x, y)
    if away > limit:
        return 0.0
    half = math.atan2(HALF_WIDTH, max(away, HALF_WIDTH))
    beams = max(1, int(half / abs(step)))
    turn = (math.atan2(y, x) - angle_min) * (1.0 if step > 0 else -1.0)
    middle = round((turn % (2.0 * math.pi)) / abs(step))
    around = max(1, round(2.0 * math.pi / abs(step)))
    seen = 0.0
    for k in range(middle - beams, middle + beams + 1):
        # A scanner that sees all around continues at its other end.
        beam = k % around
        if beam >= len(ranges) or ranges[beam] < away - MARGIN:
            continue
        seen += AMBIGUOUS if ranges[beam] < away + MARGIN else 1.0
    return seen / (2 * beams + 1)


@njit(cache=True)
def unseen_states(means, covariances, places, detected, weights):  # type: ignore[no-untyped-def]
    """Moves the first T means (J, 4) and covariances (J, 4, 4), in place, to where who is not seen rather is.

    places : (T, S, 2) m from the mean, of probabilities `weights` (S,). detected : (T, S) p_D at each.
    """
    left, shift, change = np.empty(len(weights)), np.empty(2), np.empty((2, 2))
    for t in range(len(places)):
        P = covariances[t].copy()
        for s in range(len(weights)):
            left[s] = weights[s] * (1.0 - detected[t, s])
        left /= left.sum()
        shift[:], change[:] = 0.0, 0.0
        for s in range(len(weights)):
            for i in range(2):
                shift[i] += left[s] * places[t, s, i]
                for j in range(2):
                    change[i, j] += (left[s] - weights[s]) * places[t, s, i] * places[t, s, j]
        for i in range(2):
            for j in range(2):
                change[i, j] = 0.9 * (change[i, j] - shift[i] * shift[j])
        determinant = P[0, 0] * P[1, 1] - P[0, 1] * P[0, 1]
        gain = np.empty((4, 2))
        for i in range(4):
            gain[i, 0] = (P[1, 1] * P[0, i] - P[0, 1] * P[1, i]) / determinant
            gain[i, 1] = (P[0, 0] * P[1, i] - P[0, 1] * P[0, i]) / determinant
            means[t, i] += gain[i, 0] * shift[0] + gain[i, 1] * shift[1]
        # The rest of the state follows from the place as before, so only that of the place could be unsound.
        a, b, d = P[0, 0] + change[0, 0], P[0, 1] + change[0, 1], P[1, 1] + change[1, 1]
        half = 0.5 * (a + d)
        if half - math.sqrt(max(half * half - (a * d - b * b), 0.0)) <= 1e-9:
            continue
        for i in range(4):
            for j in range(4):
                u = gain[i, 0] * change[0, 0] + gain[i, 1] * change[1, 0]
                v = gain[i, 0] * change[0, 1] + gain[i, 1] * change[1, 1]
                covariances[t, i, j] = P[i, j] + u * gain[j, 0] + v * gain[j, 1]
