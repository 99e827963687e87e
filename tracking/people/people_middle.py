"""Where the middle of a body is whose front is seen, or a part of it.

Returns at equal steps across an ellipse stand out before its middle by π/4 of its depth on average, and its first and
last by what half a step leaves of the edge. How far the middle of an arc stands out of its ends tells the depth of the
body; few or noisy returns hardly do, and what most bodies are like then counts.
"""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from tracking.people.legs import FEATURES, Clusters

LEG_RADIUS = 0.05  # metres from the middle of a leg's returns to its axis
WIDE = 0.25  # metres, a cluster wider than that is both legs or a trunk
SLIM = 0.2  # metres, up to which what is seen is one leg
DEEPER = 0.35  # metres by which the middle lies deeper for every metre a body is wider
SPREAD = 0.06  # metres by which bodies of one width differ in that
END_NOISE = 0.02  # metres, of a return
FEWEST = 5  # returns that have a shape
_BULGE = FEATURES.index("bulge")


def depths(clusters: Clusters, free: npt.NDArray[np.bool_], spacing: FloatArray) -> FloatArray:
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
