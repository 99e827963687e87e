"""Storage of anchor states: one row per leaf of the track trees (section 2.5.3), shared by all hypotheses that use it.

A leaf is one anchor under one history of associations. Its behaviour models (2.2) are a constant-position filter
("rest"; of movers: along the predicted path), a constant-velocity filter ("moving") and "away" (carried off, hidden,
anywhere); with the probability that there is no such object these four sum to one: the signature (2.3) with its
existence.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numba
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

    def here(self, slots: Any) -> Any:
        """Probability that the objects of leaves are there, resting or moving; slots : a row, or rows (n,)."""
        return self.behavior[slots, REST] + self.behavior[slots, MOVING]

    def move(self, slots: Any) -> Any:
        """Whether the objects of leaves rather move than rest; slots : as of `here`."""
        return self.behavior[slots, MOVING] > self.behavior[slots, REST]

    def spots(self, slots: IntArray) -> tuple[FloatArray, FloatArray]:
        """Where leaves (n,) most probably are (n, 3), m, and the covariances of that (n, 3, 3), m²."""
        moving = self.move(slots)[:, None]
        covariances = np.where(moving[..., None], self.moving_cov[slots, :3, :3], self.rest_cov[slots])
        return np.where(moving, self.moving[slots, :3], self.rest[slots]), covariances


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


def leaves_in(rows: IntArray) -> IntArray:
    """Leaves (n,) of rows of hypotheses, each once."""
    found: IntArray = np.unique(rows)
    return found[found >= 0]


class Rows(NamedTuple):
    """leaves, and the stack `free` (L,) of rows that are not in use, of which the first top[0] count."""

    leaves: Leaves
    free: IntArray
    top: IntArray


@numba.njit(cache=True)
def claim(free, top):  # type: ignore[no-untyped-def]
    """A free row."""
    top[0] -= 1
    return free[top[0]]


@numba.njit(cache=True)
def release(track, free, top, slot):  # type: ignore[no-untyped-def]
    """Give a row back; track (L,) : owners of all."""
    track[slot] = -1
    free[top[0]] = slot
    top[0] += 1


class Pool:
    """Leaves with a stack of free rows; grows by doubling. rows : as compiled loops take them, valid until more are
    reserved."""

    def __init__(self, attributes: int, quantities: int, size: int = 256) -> None:
        self.rows = Rows(empty(size, attributes, quantities), np.arange(size - 1, -1, -1), np.array([size]))

    @property
    def leaves(self) -> Leaves:
        return self.rows.leaves

    @property
    def size(self) -> int:
        return len(self.rows.free)

    @property
    def used(self) -> int:
        """Rows in use."""
        return self.size - int(self.rows.top[0])

    def reserve(self, count: int) -> None:
        """Make sure that `count` rows are free."""
        while self.rows.top[0] < count:
            old, (leaves, free, top) = self.size, self.rows
            grown = empty(2 * old, leaves.attributes.shape[1], leaves.values.shape[1])
            for mine, other in zip(grown, leaves, strict=True):
                mine[:old] = other
            more = np.concatenate([free[: top[0]], np.arange(2 * old - 1, old - 1, -1)])
            self.rows = Rows(grown, np.resize(more, 2 * old), top + old)

    def take(self) -> int:
        """A free row."""
        self.reserve(1)
        return int(claim(self.rows.free, self.rows.top))

    def give(self, slot: int) -> None:
        """Return a row."""
        release(self.leaves.track, self.rows.free, self.rows.top, slot)

    def widen(self, column: int, other: int | None) -> None:
        """Insert an attribute column (a new value) before `column`; it is as likely as `other`, the first one of its
        attribute, of which it was a part until now."""
        attributes = np.ascontiguousarray(np.insert(self.leaves.attributes, column, 0.0, axis=1))
        if other is not None:
            attributes[:, column] = attributes[:, other]
            attributes[:, other : column + 1] /= 1.0 + attributes[:, [other]]
        self.rows = self.rows._replace(leaves=self.leaves._replace(attributes=attributes))
