"""Context of a pair in an ordered history: what lies around it along the path, and how the query fares elsewhere.

Single clouds of one place are often less alike than clouds of two. Two more things are known once a robot has driven:
places before the query must resemble places before (or, coming back the other way, after) the candidate, and a query
that resembles everything resembles nothing in particular. Both are numbers of the rows of first-stage log odds of the
query and its predecessors against the whole history; a boosted classifier weighs them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray

PREDECESSORS = 7
# Places this close along the path do not tell how the query fares elsewhere.
GAP = 20
LENGTHS = (2, 4, 7)
_QUANTILES = (0.5, 0.9, 0.97)
CONTEXT_FEATURES = 1 + 2 * len(_QUANTILES) + 2 * len(LENGTHS) + 4
UNKNOWN = -9.0


def usual_odds(row: FloatArray, elsewhere: npt.NDArray[np.bool_] | None = None) -> FloatArray:
    """Quantiles (3,) of a place's log odds (N,) with others, those far along the path only; 0 where there are none."""
    others = row if elsewhere is None or not elsewhere.any() else row[elsewhere]
    return np.quantile(others, _QUANTILES) if len(others) else np.zeros(len(_QUANTILES))


def context_features(
    rows: Sequence[FloatArray],
    elsewhere: npt.NDArray[np.bool_] | None = None,
    usual: FloatArray | None = None,
) -> FloatArray:
    """Features (N, CONTEXT_FEATURES) of a query with each of N places.

    Parameters
    ----------
    rows : log odds (N,) of the query with every place in order of path, then of its predecessors, the latest first; at
        most PREDECESSORS of these are used, a missing one is the last that is there.
    elsewhere : (N,) places that are far along the path from the query; None where all are.
    usual : (N, 3) `usual_odds` of each place: some resemble everything. None: those of the query stand for them.
    """
    current = rows[0]
    own = usual_odds(current, elsewhere)
    theirs = np.broadcast_to(own, (len(current), len(own))) if usual is None else usual
    chain = [rows[min(k, len(rows) - 1)] for k in range(PREDECESSORS + 1)]
    columns = [current, *(current - value for value in own), *(current - value for value in theirs.T)]
    for length in LENGTHS:
        ahead = np.mean([_best(chain[k], -k, 1) for k in range(length + 1)], axis=0)
        back = np.mean([_best(chain[k], k, 1) for k in range(length + 1)], axis=0)
        columns += [np.maximum(ahead, back), np.minimum(ahead, back)]
    around = [_shifted(current, k) for k in range(-3, 4)]
    columns += [np.mean(around, axis=0), np.max(around, axis=0)]
    around = [_shifted(row, k) for row in chain[:3] for k in range(-2, 3)]
    columns += [np.mean(around, axis=0), np.max(around, axis=0)]
    return np.column_stack(columns)


def _shifted(row: FloatArray, by: int) -> FloatArray:
    """row[i + by] for every i, the first or last value beyond the ends."""
    return row[np.clip(np.arange(len(row)) + by, 0, len(row) - 1)]


def _best(row: FloatArray, by: int, slack: int) -> FloatArray:
    """The greatest of row[i + by ± slack] for every i: steps of the two passes are not equally long."""
    return np.asarray(np.max([_shifted(row, by + k) for k in range(-slack, slack + 1)], axis=0))


def contexts(odds: FloatArray, queries: npt.NDArray[np.integer]) -> list[FloatArray]:
    """`context_features` of places (Q,) of a log whose log odds with each other are (N, N), one (N, ..) for each."""
    found = []
    index = np.arange(len(odds))
    usual = np.array([usual_odds(row, np.abs(index - k) >= GAP) for k, row in enumerate(odds)])
    for query in queries.tolist():
        before = range(query, max(query - PREDECESSORS, 0) - 1, -1)
        found.append(context_features([odds[k] for k in before], np.abs(index - query) >= GAP, usual))
    return found
