"""Storage of anchor states: one row per leaf of the track trees (section 2.5.3), shared by all hypotheses that use it.

A leaf is one anchor under one history of associations. Its behaviour models (2.2) are a constant-position filter
("rest"; of movers: along the predicted path), a constant-velocity filter ("moving") and "away" (carried off, hidden,
anywhere); with the probability that there is no such object these four sum to one: the signature (2.3) with its
existence.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray

IntArray = npt.NDArray[np.int64]
REST, MOVING, AWAY, NONE = 0, 1, 2, 3


class Leaves(NamedTuple):
    """Arrays with one row per leaf.

    rest (L, 3), rest_cov (L, 3, 3) : constant-position filter, m; of a mover whose path is predicted, its place on the
    path, which moves at led (L, 3), m/s. moving (L, 6), moving_cov (L, 6, 6) : constant-velocity filter.
    behavior (L, 4) : probabilities of rest, moving, away, no object. visible (L,) :
    probability of the object's detections not being in a run of misses, after the last look. stamp (L,) : s.
    attributes (L, A) : discrete distributions side by side. last (L,), first (L,) : stamps of detections.
    hits (L,) : detections. missed (L,) : clear looks without detection since the last. track (L,) : owner.
    values, variances (L, Q) : Gaussians over quantities, a variance below zero where nothing was measured.
    said (L,) : index of the look's detection that it took in, -1 for none. together (L,) : looks in which it shared its
    detection with another leaf, since it last had one alone.
    strain (L,) : squared Mahalanobis distance of late detections from where a mover was expected, fading mean;
    negative for what does not walk, or whose motion has turns.
    """

    rest: FloatArray
    rest_cov: FloatArray
    led: FloatArray
    moving: FloatArray
    moving_cov: FloatArray
    behavior: FloatArray
    visible: FloatArray
    stamp: FloatArray
    attributes: FloatArray
    last: FloatArray
    first: FloatArray
    hits: IntArray
    missed: FloatArray
    track: IntArray
    values: FloatArray
    variances: FloatArray
    said: IntArray
    together: IntArray
    strain: FloatArray


def empty(size: int, attributes: int, quantities: int = 0) -> Leaves:
    """Storage for `size` leaves."""
    filters = ((3,), (3, 3), (3,), (6,), (6, 6), (4,))
    values = (attributes,), (), (), (), (), (), (quantities,), (quantities,), (), (), ()
    made = Leaves(*(np.zeros((size, *shape)) for shape in (*filters, (), (), *values)))
    whole = {
        name: np.full(size, start)
        for name, start in (("hits", 0), ("track", -1), ("said", -1), ("together", 0))
    }
    return made._replace(variances=np.full((size, quantities), -1.0), **whole)


class Rows(NamedTuple):
    """leaves, and the stack `free` (L,) of rows that are not in use, of which the first top[0] count."""

    leaves: Leaves
    free: IntArray
    top: IntArray


class Pool:
    """Leaves with a stack of free rows; grows by doubling."""

    def __init__(self, attributes: int, quantities: int = 0, size: int = 256) -> None:
        self.leaves = empty(size, attributes, quantities)
        self.free = np.arange(size - 1, -1, -1)
        self.top = np.array([size])
        """How many entries of `free` are free."""

    @property
    def rows(self) -> Rows:
        """As compiled loops take it; valid until more rows are reserved."""
        return Rows(self.leaves, self.free, self.top)

    @property
    def size(self) -> int:
        return len(self.leaves.stamp)

    @property
    def used(self) -> int:
        """Rows in use."""
        return self.size - int(self.top[0])

    def reserve(self, count: int) -> None:
        """Make sure that `count` rows are free."""
        while self.top[0] < count:
            old = self.size
            grown = empty(2 * old, self.leaves.attributes.shape[1], self.leaves.values.shape[1])
            for mine, other in zip(grown, self.leaves, strict=True):
                mine[:old] = other
            self.leaves = grown
            free = np.zeros(2 * old, np.int64)
            top = int(self.top[0])
            free[:top] = self.free[:top]
            free[top : top + old] = np.arange(2 * old - 1, old - 1, -1)
            self.free = free
            self.top[0] = top + old

    def take(self) -> int:
        """A free row."""
        self.reserve(1)
        self.top[0] -= 1
        return int(self.free[self.top[0]])

    def give(self, slot: int) -> None:
        """Return a row."""
        self.leaves.track[slot] = -1
        self.free[self.top[0]] = slot
        self.top[0] += 1

    def widen(self, column: int) -> None:
        """Insert an attribute column (a new value) before `column`."""
        attributes = np.insert(self.leaves.attributes, column, 0.0, axis=1)
        self.leaves = self.leaves._replace(attributes=np.ascontiguousarray(attributes))
