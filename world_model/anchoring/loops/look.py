"""One look in arrays, as the steps of anchoring and its compiled loops pass it on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from estimation.checks import FloatArray
from world_model.anchoring.loops.leaves import IntArray


class Detections(NamedTuple):
    """M detections of a look that was made `lag` seconds before `stamp`, s.

    indices (M,) : in the look. positions (M, 3), covariances (M, 3, 3). likelihood (M, A) : of each value of each
    attribute. log_new (M,) : log density of being clutter or an object not known yet, (2.6); existence (M,) : how
    probable the latter is then.
    """

    stamp: float
    lag: float
    indices: IntArray
    positions: FloatArray
    covariances: FloatArray
    likelihood: FloatArray
    log_new: FloatArray
    existence: FloatArray

    def only(self, which: IntArray) -> Detections:
        """Some of them."""
        arrays: tuple[Any, ...] = self[2:]
        return Detections(self.stamp, self.lag, *(array[which] for array in arrays))


class Classes(NamedTuple):
    """motion (C + 1, 6), see `kernels`. blocks (K, 2), prior (A,) : columns of the attributes, and what an object is of
    which nothing is known, see `vocabulary`."""

    motion: FloatArray
    blocks: IntArray
    prior: FloatArray


@dataclass
class Look:
    """seen : M detections. born (2, M) : densities of undetected objects there, 1/m³; returned (M,) : how probably what
    is carried about has come there unseen; room (M,) : probability that something new can be there. reach : m at which
    two movers are detected as one, 0 where that is out of the question. chosen (n,) : leaves that the look concerns;
    clear (n,) : probability that being there would have meant being in view; matrix (n, M), missing (n, 2) : as
    `gating.weigh` returns them."""

    seen: Detections
    born: FloatArray
    returned: FloatArray
    room: FloatArray
    reach: float
    chosen: IntArray
    clear: FloatArray
    matrix: FloatArray
    missing: FloatArray
