"""Where the middle of a body is whose front is seen, or a part of it.

Returns at equal steps across an ellipse stand out before its middle by π/4 of its depth on average, and its first and
last by what half a step leaves of the edge. How far the middle of an arc stands out of its ends tells the depth of the
body; few or noisy returns hardly do, and what most bodies are like then counts. Of somebody known to be one round body
who goes behind something, the end that is still free tells where his middle is.
"""

from __future__ import annotations

import math

import numpy as np

from estimation.checks import FloatArray
from tracking.legs import FEATURES, Clusters
from tracking.people_association import WIDE, Seen
from tracking.people_tracks import BoolArray, IntArray, Tracks

LEG_RADIUS = 0.05  # metres from the middle of a leg's returns to its axis
SLIM = 0.2  # metres, up to which what is seen is one leg
DEEPER = 0.35  # metres by which the middle lies deeper for every metre a body is wider
SPREAD = 0.06  # metres by which bodies of one width differ in that
END_NOISE = 0.02  # metres, of a return
FEWEST = 5  # returns that have a shape
CUT = -0.1  # metres by which what is next to an end is nearer where it hides the rest
SOLID = 0.7  # share of the time somebody was seen as one body, from which he is taken for one
LEARNING = 0.5  # seconds over which a body's size is learned
_BULGE = FEATURES.index("bulge")


def depths(clusters: Clusters, free: BoolArray, spacing: FloatArray) -> FloatArray:
    """How far behind the middle of its returns the middle of each body is, (K,) metres.

    free (K,) : not cut off at either end. spacing (K,) : metres between neighbouring beams at each.
    """
    widths = clusters.widths
    usual = LEG_RADIUS + DEEPER * np.maximum(widths - SLIM, 0.0) * (widths > WIDE)
    half = 0.5 * (widths + spacing)
    whole = 0.25 * math.pi * half
    # Of a circle: how far the mean return stands out of the first and last ones.
    edge = np.sqrt(np.maximum(half**2 - np.maximum(half - 0.5 * spacing, 0.0) ** 2, 0.0))
    stands_out = np.maximum(whole - edge, 0.3 * whole)
    gain = whole / np.maximum(stands_out, 1e-6)
    seen = gain * np.clip(clusters.features[:, _BULGE] * widths, 0.2 * stands_out, 1.3 * stands_out)
    noise = (END_NOISE * gain) ** 2
    trust = np.where(
        free & (clusters.counts >= FEWEST) & (widths > WIDE), SPREAD**2 / (SPREAD**2 + noise), 0.0
    )
    return np.asarray(trust * seen + (1.0 - trust) * usual)


def learn_body(tracks: Tracks, t: int, seen: Seen, mine: IntArray, dt: float) -> None:
    """Size of a body seen wholly, and whether it is one."""
    if (seen.cut[mine].any() and len(mine) != 2) or seen.counts[mine[0]] < FEWEST:
        return
    one = len(mine) == 1 and seen.widths[mine[0]] > WIDE
    share = dt / (min(tracks.looks[t], LEARNING) + dt)
    tracks.bodies[t, 2] += share * (float(one) - tracks.bodies[t, 2])
    if one:
        size = np.array([0.5 * seen.widths[mine[0]], seen.depths[mine[0]]])
        tracks.bodies[t, :2] += (share if tracks.bodies[t, 0] else 1.0) * (size - tracks.bodies[t, :2])


def middle(tracks: Tracks, t: int, seen: Seen, mine: IntArray) -> FloatArray | None:
    """Middle (2,) of one round body of which something hides one side; None of others."""
    k = mine[0]
    half, depth, solid = tracks.bodies[t]
    width = max(seen.widths[k], 0.1 * half)
    if len(mine) != 1 or solid < SOLID or seen.cut[k].sum() != 1 or width > 1.7 * half or half == 0.0:
        return None
    # Where the visible part is across the body, from -1 to 1, and how far it stands out of the middle.
    inner = 1.0 - min(width / half, 1.99)
    share = (_area(1.0) - _area(inner)) / (1.0 - inner)
    aside = (half - 0.5 * width) * (1.0 if seen.cut[k, 1] else -1.0)
    side = np.array([-seen.sights[k, 1], seen.sights[k, 0]]) * seen.turning
    place = (
        seen.places[k] + (depth / (0.25 * math.pi) * share - seen.depths[k]) * seen.sights[k] + aside * side
    )
    return np.asarray(place)


def _area(x: float) -> float:
    """Integral of the height of a unit circle from 0 to x."""
    return 0.5 * (x * math.sqrt(max(1.0 - x * x, 0.0)) + math.asin(max(-1.0, min(1.0, x))))
