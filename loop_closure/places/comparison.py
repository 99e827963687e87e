"""Pairs of places as the classifier sees them: equations (4) and (5) of Paper A, singly and against a history.

    pair_features(a, b)                     (44,) in 2D, (41,) in 3D
    pair_features_many(query, database)     (M, 44 | 41), one compiled pass

First the absolute differences of the scalar features, then the correlation coefficients of the range histograms, in
[-1, 1]. Alike means small differences and coefficients near 1. Of two constant histograms (equal counts in all bins,
as with a single bin) the coefficient is 1, of a constant and another one 0. Coefficients are computed from profiles in
single precision: they are good to 1e-6.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numba
import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, require_kind
from estimation.errors import InputError
from loop_closure.growing_array import GrowingArray
from loop_closure.places.features import PlaceFeatures
from loop_closure.places.outlines import Outline


class PlaceDatabase:
    """Places stacked for comparison; adding one takes constant time on average, as the arrays grow by doubling.

    A place takes 8 bytes per scalar feature and 4 per bin: 4.4 kB with r_max = 50 m. With `wide` it also takes its
    signature, 4 bytes per number, and its outline, 2 kB of free cells and 8 bytes per point.

    Parameters
    ----------
    places : what to start with; all of one dimension and one max_range.
    wide : also keep what models beyond the text's features look at, for `compare_wide`.
    """

    def __init__(self, places: Iterable[PlaceFeatures] = (), wide: bool = False) -> None:
        self.wide = wide
        self._outlines: list[Outline | None] = []
        self._first: PlaceFeatures | None = None
        self._values, self._starts = GrowingArray((0,)), np.zeros(1, dtype=np.int64)
        self._profiles, self._signatures = GrowingArray((0,), np.float32), GrowingArray((0,), np.float32)
        for place in places:
            self.append(place)

    def __len__(self) -> int:
        return len(self._values)

    @property
    def values(self) -> FloatArray:
        """Scalar features of all places, (M, 35 | 32)."""
        return self._values.rows

    @property
    def profiles(self) -> npt.NDArray[np.float32]:
        """Standardised histograms of all places (`PlaceFeatures.profile`), (M, W)."""
        return self._profiles.rows

    @property
    def signatures(self) -> npt.NDArray[np.float32]:
        """Signatures of all places (`PlaceFeatures.signature`), (M, S); (0, 0) unless `wide`."""
        return self._signatures.rows

    def outline(self, index: int) -> Outline | None:
        """The outline of a place, None where it has none or the database is not `wide`."""
        return self._outlines[index] if self.wide else None

    @property
    def nbytes(self) -> int:
        """Memory of the stored places in bytes, without the room kept for growth."""
        outlines = sum(outline.nbytes for outline in self._outlines if outline is not None)
        return int(self.values.nbytes + self.profiles.nbytes + self.signatures.nbytes) + outlines

    def append(self, place: PlaceFeatures) -> int:
        """Add a place; returns its index. InputError where it does not match those already there."""
        require_kind("place", place, PlaceFeatures)
        if self._first is None:
            self._first = place
            self._values = GrowingArray(place.values.shape)
            self._profiles = GrowingArray(place.profile.shape, np.float32)
            self._starts = _starts(place)
            if self.wide:
                self._signatures = GrowingArray(place.signature.shape, np.float32)
        require_comparable(self._first, place, self.wide)
        if self.wide:
            self._signatures.append(place.signature)
            self._outlines.append(place.outline)
        self._values.append(place.values)
        self._profiles.append(place.profile)
        return len(self) - 1

    def keep(self, rows: npt.NDArray[np.int64]) -> None:
        """Forget all places but those of these indices (K,), ascending; they are counted anew."""
        self._require_rows(rows)
        self._values, self._profiles = (
            GrowingArray.of(kept.rows[rows]) for kept in (self._values, self._profiles)
        )
        if self.wide:
            self._signatures = GrowingArray.of(self.signatures[rows])
            self._outlines = [self._outlines[row] for row in rows]

    def compare(self, query: PlaceFeatures, rows: npt.NDArray[np.integer] | None = None) -> FloatArray:
        """Pair features of `query` with all places or those of `rows`, (K, n).

        Raises
        ------
        InputError : places that cannot be compared, or rows that do not exist.
        """
        return self._compared(query, rows, False)

    def compare_wide(self, query: PlaceFeatures, rows: npt.NDArray[np.integer] | None = None) -> FloatArray:
        """`compare` and absolute differences of signatures, (K, n + S). InputError also where this is not `wide`."""
        if not self.wide:
            raise InputError("places: a wider model needs PlaceDatabase(places, wide=True)")
        return self._compared(query, rows, True)

    def _compared(self, query: PlaceFeatures, rows: npt.NDArray[np.integer] | None, wide: bool) -> FloatArray:
        require_kind("query", query, PlaceFeatures)
        narrow = len(query.values) + len(query.histograms)
        width = narrow + (len(query.signature) if wide else 0)
        if self._first is None:
            return np.empty((0, width))
        require_comparable(self._first, query, wide)
        rows = np.arange(len(self)) if rows is None else rows
        self._require_rows(rows)
        pairs = np.empty((len(rows), width))
        _compare(query.values, query.profile, self.values, self.profiles, self._starts, rows, pairs)
        if wide:
            _differ(query.signature, self.signatures, rows, pairs, narrow)
        return pairs

    def _require_rows(self, rows: npt.NDArray[np.integer]) -> None:
        if len(rows) and not 0 <= rows.min() <= rows.max() < len(self):
            raise InputError(f"rows: indices from 0 to {len(self) - 1} expected")


def require_comparable(a: PlaceFeatures, b: PlaceFeatures, wide: bool = False) -> None:
    """InputError unless both places have the same features, bins and max_range, and with `wide` outlines or none."""
    require_kind("places", b, PlaceFeatures)
    if wide and (a.outline is None) != (b.outline is None):
        raise InputError("places: one has an outline, the other has none")
    if len(a.values) != len(b.values):
        raise InputError(f"places: {len(a.values)} and {len(b.values)} scalar features cannot be compared")
    if a.max_range != b.max_range:
        raise InputError(f"places: max_range must be equal, got {a.max_range} and {b.max_range} m")
    if [len(h) for h in a.histograms] != [len(h) for h in b.histograms]:
        raise InputError("places: histograms of different bins cannot be compared")


def pair_features(a: PlaceFeatures, b: PlaceFeatures) -> FloatArray:
    """Extracted features F of two places, (44,) in 2D or (41,) in 3D, equation (5); symmetric in a and b.

    Raises
    ------
    InputError : places of different dimension, max_range or bins.
    """
    return pair_features_many(a, [b])[0]


def pair_features_many(query: PlaceFeatures, database: PlaceDatabase | Sequence[PlaceFeatures]) -> FloatArray:
    """Extracted features of `query` with each of M places, (M, 44 | 41); rows equal `pair_features`.

    A `PlaceDatabase` is compared as it is; a list is stacked first, which costs more than the comparison.

    Raises
    ------
    InputError : places of different dimension, max_range or bins.
    """
    if not isinstance(database, PlaceDatabase):
        database = PlaceDatabase(database)
    return database.compare(query)


def _starts(place: PlaceFeatures) -> npt.NDArray[np.int64]:
    """Where each histogram begins in a profile, (H + 1,)."""
    return np.concatenate(([0], np.cumsum([len(h) + 1 for h in place.histograms]))).astype(np.int64)


# Reordered sums vectorise, and only over slices: an index counted from elsewhere might be negative. Every sum is
# accumulated in double precision.
@numba.njit(cache=True, fastmath={"reassoc", "contract"})
def _compare(values, profile, all_values, all_profiles, starts, rows, pairs):  # type: ignore[no-untyped-def]
    scalars = len(values)
    for i in range(len(rows)):
        row = rows[i]
        for j in range(scalars):
            pairs[i, j] = abs(values[j] - all_values[row, j])
        for h in range(len(starts) - 1):
            own = profile[starts[h] : starts[h + 1]]
            other = all_profiles[row, starts[h] : starts[h + 1]]
            total = 0.0
            for k in range(len(own)):
                total += np.float64(own[k]) * np.float64(other[k])
            pairs[i, scalars + h] = min(max(total, -1.0), 1.0)


@numba.njit(cache=True)
def _differ(signature, all_signatures, rows, wide, start):  # type: ignore[no-untyped-def]
    """Absolute differences of signatures, in single precision as they are, into the columns of `wide` from `start`."""
    for i in range(len(rows)):
        other, out = all_signatures[rows[i]], wide[i, start:]
        for j in range(len(signature)):
            out[j] = abs(signature[j] - other[j])
