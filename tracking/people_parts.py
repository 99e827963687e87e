"""Wide clusters in parts, by whom they are near: people side by side, or leaning at a wall."""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from tracking.legs import Clusters
from tracking.people_sweep import Sweep
from tracking.people_tracks import IntArray, Tracks

WIDE, BODY = (
    0.4,
    0.6,
)  # metres: wider than that it may be of several, and as wide as one person is seen at most
NEAR = 0.4  # metres from the middle of a person to returns of his
OLD = 0.5  # share from which something stood there before


def parts_of_people(tracks: Tracks, sweep: Sweep, clusters: Clusters, old: FloatArray) -> IntArray | None:
    """Number of the person each beam is near (N,), 0 without; None where nothing is to be split.

    old (N,) : how surely something stood where the return of each beam is.
    """
    sure = np.flatnonzero(tracks.shown | (tracks.public >= 0))
    if not len(sure):
        return None
    wide = np.append(clusters.widths > WIDE, False)[clusters.labels]
    if not wide.any():
        return None
    gaps = np.linalg.norm(sweep.points(wide)[:, None] - tracks.means[None, sure, :2], axis=2)
    fresh = old[wide] < OLD
    nearest = np.where((gaps.min(1) < NEAR) & fresh, gaps.argmin(1) + 1, 0)
    # Somebody who turns is not where he is expected, and no less one body for that.
    cluster = clusters.labels[wide]
    for k in np.unique(cluster[nearest > 0]).tolist():
        mine = cluster == k
        names = np.unique(nearest[mine & (nearest > 0)])
        if len(names) == 1 and clusters.widths[k] < BODY and fresh[mine].all():
            nearest[mine] = names[0]
    parts = np.zeros(len(wide), dtype=np.int64)
    parts[wide] = nearest
    return parts
