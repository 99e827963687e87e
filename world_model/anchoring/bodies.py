"""Objects are bodies: two do not fill the same space, and nothing is where a beam went through.

Only of objects that rest and whose size was measured. Of the space that an object fills its core counts: what is surely
inside. Of two whose widths differ much the one may lie in the other: a bowl, a shelf, the box about a table are mostly
air.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from world_model.anchoring.anchors import THRESHOLD, Anchors
from world_model.anchoring.loops.expansion import unify
from world_model.anchoring.loops.kernels import miss, predict
from world_model.anchoring.loops.leaves import MOVING, REST, IntArray, leaves_in
from world_model.anchoring.occlusion import extents

CORE = 0.7  # Share of width and height that is surely filled
ALIKE = 0.7  # Ratio of two widths from which neither object can lie in the other
SURE = 3.0  # Standard deviations of where things are that a statement about bodies leaves open
SEEN_THROUGH = 0.99
"""Probability that a beam which would have met a core would have ended there: glass, thin legs, errors of the pose."""
BEAM = 0.02  # m: standard deviation of where a beam goes


class Bodies:
    """What follows for hypotheses from objects being solid."""

    def __init__(self, anchors: Anchors) -> None:
        self.anchors = anchors

    def solid(self, slots: IntArray) -> IntArray:
        """Those of these leaves that rest and have a known size."""
        leaves = self.anchors.leaves
        known = self.anchors.quantities.told(leaves, slots, "size")[1]
        return slots[known & (leaves.behavior[slots, REST] > leaves.behavior[slots, MOVING])]

    def cores(self, slots: IntArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Centres (n, 3), radii and half heights (n, 2), m, and standard deviations (n,) of where they are."""
        leaves, column = self.anchors.leaves, self.anchors.quantities.names.index("size")
        size = np.maximum(leaves.values[slots, column], 1e-6)
        least = np.maximum(1.0 - 2.0 * np.sqrt(np.maximum(leaves.variances[slots, column], 0.0)) / size, 0.0)
        width, height = extents(leaves, slots, self.anchors.quantities)
        half = 0.5 * CORE * least[:, None] * np.column_stack([width, height])
        spread = leaves.rest_cov[slots][:, range(3), range(3)].max(1)
        return leaves.rest[slots], half, np.sqrt(np.maximum(spread, 0.0))

    def clashes(self, slots: IntArray) -> npt.NDArray[np.bool_]:
        """Which leaves (n,) of different tracks fill the same space (n, n)."""
        place, half, sigma = self.cores(slots)
        apart = np.abs(place[:, None] - place)
        doubt = SURE * np.hypot(sigma[:, None], sigma)
        inside = np.hypot(apart[..., 0], apart[..., 1]) + doubt < half[:, None, 0] + half[:, 0]
        inside &= apart[..., 2] + doubt < half[:, None, 1] + half[:, 1]
        width = extents(self.anchors.leaves, slots, self.anchors.quantities)[0]
        inside &= np.minimum(width[:, None], width) > ALIKE * np.maximum(width[:, None], width)
        track = self.anchors.leaves.track[slots]
        return inside & (track[:, None] != track)

    def exclude(self, rows: IntArray, weights: FloatArray) -> tuple[IntArray, FloatArray]:
        """Hypotheses (H, T) given that not both of two that fill the same space are there.

        Of the two the one that is less probably there is not, and the hypothesis counts as much as this was probable.
        Where every hypothesis has two that are surely there, sizes are wrong and nothing follows.
        """
        slots = self.solid(leaves_in(rows))
        if len(slots) < 2:
            return rows, weights
        clash = self.clashes(slots)
        if not clash.any():
            return rows, weights
        here = self.anchors.leaves.here(slots)
        at = {slot: k for k, slot in enumerate(slots.tolist())}
        kept, own = rows.copy(), weights.copy()
        for h, row in enumerate(rows.tolist()):
            present = sorted((at[slot] for slot in row if slot in at), key=lambda k: -here[k])
            for k, one in enumerate(present):
                for other in present[k + 1 :]:
                    if clash[one, other] and slots[one] in kept[h] and slots[other] in kept[h]:
                        own[h] += np.log(max(1.0 - here[one] * here[other], 1e-12))
                        kept[h, row.index(slots[other])] = -1
        top = own.max()
        if top < weights.max() - THRESHOLD:
            return rows, weights
        good = own >= top - THRESHOLD
        return unify(np.ascontiguousarray(kept[good]), own[good])

    def possible(self, rows: IntArray, weights: FloatArray) -> tuple[IntArray, FloatArray]:
        """`exclude`, and leaves that no hypothesis uses any more are given back."""
        if "size" not in self.anchors.quantities.measured:
            return rows, weights
        kept, own = self.exclude(rows, weights)
        if kept is not rows:
            self.anchors.sweep(rows, kept)
        return kept, own

    def filled(self, number: int) -> bool:
        """Whether in the most probable world something that is shown fills the space where this track is."""
        anchors = self.anchors
        numbers = [number, *(other for other in anchors.shown if other != number)]
        best = np.array([anchors.best_leaf(anchors.tracks[other]) for other in numbers])
        slots = self.solid(best[best >= 0])
        return len(slots) > 1 and slots[0] == best[0] and bool(self.clashes(slots)[0].any())

    def pass_through(self, origin: FloatArray, ends: FloatArray, stamp: float) -> list[int]:
        """Beams went from a place (3,) to others (N, 3), m, through the air; returns the clusters that this concerns.

        What would have been in their way is not there, as if it had been looked for in vain.
        """
        anchors, leaves = self.anchors, self.anchors.leaves
        solid = self.solid(np.flatnonzero(leaves.track >= 0))
        hit = solid[self._crossed(solid, origin, ends)] if len(solid) else solid
        factor = np.zeros(anchors.pool.size)
        for slot in hit.tolist():
            predict(leaves, slot, stamp, anchors.motion, anchors.config.removed_per_second)
            factor[slot] = np.log(max(1.0 - SEEN_THROUGH * leaves.here(slot), 1e-12))
            # Not a look of the detector: of its runs of misses this says nothing.
            visible = leaves.visible[slot]
            miss(leaves, slot, SEEN_THROUGH, 1.0)
            leaves.visible[slot] = visible
        touched: list[int] = []
        for number in sorted({anchors.tracks[track].cluster for track in leaves.track[hit].tolist()}):
            cluster = anchors.clusters[number]
            gained = np.where(cluster.rows >= 0, factor[cluster.rows], 0.0).sum(1)
            own = cluster.weights + gained
            touched += anchors.restrict(number, own >= own.max() - THRESHOLD, gained)
        return touched

    def _crossed(self, slots: IntArray, origin: FloatArray, ends: FloatArray) -> npt.NDArray[np.bool_]:
        """Which cores (n,) some beam goes through and comes out of again."""
        place, half, sigma = self.cores(slots)
        along = ends - origin
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-9)
        unit = along / length[:, None]
        off = place[:, None] - origin
        reach = np.einsum("nkd,kd->nk", off, unit)
        miss_by = np.abs(off - reach[..., None] * unit)
        doubt = SURE * np.hypot(sigma, BEAM)[:, None]
        through = np.hypot(miss_by[..., 0], miss_by[..., 1]) + doubt < half[:, :1]
        through &= miss_by[..., 2] + doubt < half[:, 1:]
        # The far side of the whole body, not of its core.
        through &= (reach > 0.0) & (reach + half[:, :1] / CORE + doubt < length)
        return np.asarray(through.any(axis=1))
