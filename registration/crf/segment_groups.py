"""Which points may have moved together: pieces of a scan that another scan contradicts."""

from __future__ import annotations

import numpy as np
from numba import njit

from estimation.geometry.sight import HIDDEN, THROUGH
from registration.crf.beams import ends_of
from registration.laser.outline import CLEAR, length


@njit(cache=True)
def groups_of(points, pieces, labels, ranges, largest):  # type: ignore[no-untyped-def]
    """Number of the group of each point, -1 for the background.

    A piece may have moved where part of it stands in what the other scan saw through, or where it is hidden from
    it and stands before what is beside it: what is behind its neighbours is what a mover hides.
    """
    n = len(points)
    groups = np.full(n, -1, dtype=np.int64)
    if n == 0:
        return groups
    size = np.bincount(pieces)
    through = (labels == THROUGH) | (labels == CLEAR)
    ends = ends_of(pieces, size)
    for p in range(len(size)):
        f, l, before, beyond = ends[p]
        # A single reading between others is more often false than it is a thing.
        if size[p] < 2:
            continue
        free = hidden = 0
        for k in range(f, l + 1):
            free += pieces[k] == p and through[k]
            hidden += pieces[k] == p and labels[k] == HIDDEN
        stands_out = (before < 0 or ranges[before] > ranges[f]) and (
            beyond >= n or ranges[beyond] > ranges[l]
        )
        least = max(2.0, 0.06 * size[p])
        across = length(points[l, 0] - points[f, 0], points[l, 1] - points[f, 1])
        whole = across < largest and (free >= least or (stands_out and free + hidden >= least))
        for k in range(f, l + 1):
            if pieces[k] == p and (whole or through[k]):
                groups[k] = f
    return groups
