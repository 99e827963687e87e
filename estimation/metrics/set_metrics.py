"""Distances between finite sets of points: OSPA (Schuhmacher 2008) and GOSPA (Rahmathullah 2017)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_floats, as_number, as_points, require_positive
from estimation.errors import InputError
from estimation.filters.assignment import cheapest


@dataclass(frozen=True)
class GospaParts:
    """GOSPA and what it is made of; `localisation`, `missed` and `false` are p-th powers that add up to it.

    Only α = 2 decomposes so. `missed` counts points of Y without a partner, `false` points of X.
    """

    value: float
    localisation: float
    missed: float
    false: float
    pairs: list[tuple[int, int]]


def _set(name: str, value: npt.ArrayLike) -> FloatArray:
    """An (N, d) array; an empty list is the empty set."""
    array = as_floats(name, value)
    return array.reshape(0, 0) if array.size == 0 else as_points(name, array)


def _distances(X: npt.ArrayLike, Y: npt.ArrayLike) -> FloatArray:
    """Euclidean distances (n, m); of an empty set, an empty matrix of the right shape."""
    X, Y = _set("X", X), _set("Y", Y)
    if len(X) == 0 or len(Y) == 0:
        return np.zeros((len(X), len(Y)))
    if X.shape[1] != Y.shape[1]:
        raise InputError(f"X and Y must have the same dimension, not {X.shape[1]} and {Y.shape[1]}")
    return np.linalg.norm(X[:, None] - Y[None], axis=-1)


def _check(c: float, p: float) -> None:
    require_positive("c", c)
    if not as_number("p", p) >= 1.0:
        raise InputError(f"p must be a finite number of at least 1, not {p!r}")


def ospa(X: npt.ArrayLike, Y: npt.ArrayLike, c: float, p: float) -> float:
    """Optimal sub-pattern assignment distance of the point sets X (n, d) and Y (m, d).

    c : cut-off, in the unit of the points; p ≥ 1 : order. Two empty sets are at distance 0, an empty and a
    non-empty one at distance c. Raises InputError.
    """
    _check(c, p)
    distances = _distances(X, Y)
    larger = max(distances.shape)
    if larger == 0:
        return 0.0
    costs = np.minimum(distances, c) ** p
    total = costs[cheapest(costs)].sum() + c**p * (larger - min(distances.shape))
    return float((total / larger) ** (1.0 / p))


def gospa(X: npt.ArrayLike, Y: npt.ArrayLike, c: float, p: float, alpha: float = 2) -> float:
    """Generalised OSPA of the point sets X (n, d) and Y (m, d), not normalised by their size.

    c : cut-off; p ≥ 1 : order; alpha in (0, 2]: each point too many costs c^p / alpha. Raises InputError.
    """
    _check(c, p)
    if not 0.0 < as_number("alpha", alpha) <= 2.0:
        raise InputError(f"alpha must be in (0, 2], not {alpha!r}")
    costs = np.minimum(_distances(X, Y), c) ** p
    surplus = abs(costs.shape[0] - costs.shape[1])
    total = costs[cheapest(costs)].sum() + c**p / alpha * surplus
    return float(total ** (1.0 / p))


def gospa_parts(X: npt.ArrayLike, Y: npt.ArrayLike, c: float, p: float) -> GospaParts:
    """GOSPA with α = 2 split into localisation, missed (Y, the truth) and false (X, the estimate)."""
    _check(c, p)
    distances = _distances(X, Y)
    rows, columns = cheapest(np.minimum(distances, c) ** p)
    # A pair at the cut-off or beyond costs c^p, exactly a missed and a false point together.
    pairs = [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if distances[i, j] < c]
    localisation = float(sum(distances[i, j] ** p for i, j in pairs))
    missed = c**p / 2 * (distances.shape[1] - len(pairs))
    false = c**p / 2 * (distances.shape[0] - len(pairs))
    return GospaParts((localisation + missed + false) ** (1 / p), localisation, missed, false, pairs)
