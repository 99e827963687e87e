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

from estimation.checks import FloatArray
from estimation.errors import InputError
from loop_closure.features import PlaceFeatures


class PlaceDatabase:
    """Places stacked for comparison; adding one takes constant time on average, as the arrays grow by doubling.

    A place takes 8 bytes per scalar feature and 4 per bin: 4.4 kB with r_max = 50 m.

    Parameters
    ----------
    places : what to start with; all of one dimension and one max_range.
    """

    def __init__(self, places: Iterable[PlaceFeatures] = ()) -> None:
        self._size = 0
        self._first: PlaceFeatures | None = None
        self._values = np.empty((0, 0))
        self._profiles = np.empty((0, 0), dtype=np.float32)
        self._starts = np.zeros(1, dtype=np.int64)
        for place in places:
            self.append(place)

    def __len__(self) -> int:
        return self._size

    @property
    def values(self) -> FloatArray:
        """Scalar features of all places, (M, 35 | 32)."""
        return self._values[: self._size]

    @property
    def profiles(self) -> npt.NDArray[np.float32]:
        """Standardised histograms of all places (`PlaceFeatures.profile`), (M, W)."""
        return self._profiles[: self._size]

    @property
    def nbytes(self) -> int:
        """Memory of the stored places in bytes, without the room kept for growth."""
        return int(self.values.nbytes + self.profiles.nbytes)

    def append(self, place: PlaceFeatures) -> int:
        """Add a place; returns its index. InputError where it does not match those already there."""
        if self._first is None:
            self._first = place
            self._values = np.empty((8, len(place.values)))
            self._profiles = np.empty((8, len(place.profile)), dtype=np.float32)
            self._starts = _starts(place)
        require_comparable(self._first, place)
        if self._size == len(self._values):
            self._values = _doubled(self._values)
            self._profiles = _doubled(self._profiles)
        self._values[self._size] = place.values
        self._profiles[self._size] = place.profile
        self._size += 1
        return self._size - 1

    def compare(self, query: PlaceFeatures) -> FloatArray:
        """Pair features of `query` with every place, (M, n). InputError where they cannot be compared."""
        width = len(query.values) + len(query.histograms)
        if self._first is None:
            return np.empty((0, width))
        require_comparable(self._first, query)
        pairs = np.empty((self._size, width))
        _compare(query.values, query.profile, self.values, self.profiles, self._starts, pairs)
        return pairs


def require_comparable(a: PlaceFeatures, b: PlaceFeatures) -> None:
    """InputError unless both places have the same features, bins and max_range."""
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


def _doubled(array: npt.NDArray[np.floating]) -> npt.NDArray:
    grown = np.empty((2 * len(array), array.shape[1]), dtype=array.dtype)
    grown[: len(array)] = array
    return grown


# Reordered sums vectorise; every sum is accumulated in double precision.
@numba.njit(cache=True, fastmath={"reassoc", "contract"})
def _compare(values, profile, all_values, all_profiles, starts, pairs):  # type: ignore[no-untyped-def]
    scalars = len(values)
    for i in range(len(all_values)):
        for j in range(scalars):
            pairs[i, j] = abs(values[j] - all_values[i, j])
        for h in range(len(starts) - 1):
            total = 0.0
            for k in range(starts[h], starts[h + 1]):
                total += np.float64(profile[k]) * np.float64(all_profiles[i, k])
            pairs[i, scalars + h] = min(max(total, -1.0), 1.0)
