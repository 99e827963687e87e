"""The k cheapest assignments of rows to columns (Murty 1968), for data association by hypotheses."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray, as_floats, require_count
from estimation.errors import InputError
from estimation.filters.murty import k_best_full

IntArray = npt.NDArray[np.int64]
DEAREST = 1e200


def cheapest(costs: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows and columns (min(n, m),) of the cheapest assignment; scipy's `linear_sum_assignment`, in its words.

    scipy.optimize holds 7 MiB of each process that imports it; a node that never assigns does without. Raises
    InputError for costs that are NaN, and where forbidden pairs (inf) leave no assignment.
    """
    from scipy.optimize import linear_sum_assignment

    if np.isnan(costs).any():
        raise InputError("costs must not hold NaN")
    try:
        rows, columns = linear_sum_assignment(costs)
    except ValueError as error:
        raise InputError(f"costs (n, m) without an assignment: {error}") from error
    return rows, columns


def k_best(costs: npt.ArrayLike, k: int) -> list[tuple[float, IntArray]]:
    """The k cheapest assignments, cheapest first: (cost, columns (n,)), columns[i] = -1 for unassigned.

    costs : (n, m), any sign; inf forbids a pair. Each column is used at most once. An assignment has as
    many pairs as the forbidden ones allow: all rows where that is possible, otherwise some rows carry -1.
    A row may only stay unassigned for want of columns; give it a column of its own with the price of
    "no association" where that is a hypothesis. The cost is the sum over the pairs. Fewer than k are
    returned where there are no more. Each is returned once; the order of equally expensive ones is
    determined by the costs alone, so it repeats. Raises InputError for NaN, -inf, other shapes, k < 1.
    """
    matrix = as_floats("costs", costs)
    if matrix.ndim != 2:
        raise InputError(f"costs must have shape (n, m), not {matrix.shape}")
    if np.isnan(matrix).any() or np.isneginf(matrix).any():
        raise InputError("costs must be finite, or inf for a forbidden pair; they hold NaN or -inf")
    if (np.abs(matrix[np.isfinite(matrix)]) > DEAREST).any():
        raise InputError(f"costs up to {DEAREST:g} expected: larger ones cannot be added up")
    k = require_count("k", k)
    n, m = matrix.shape
    if n == 0 or m == 0:
        return [(0.0, np.full(n, -1))]
    if n <= m:
        solutions = k_best_full(np.ascontiguousarray(matrix), k)
    else:
        solutions = _transposed(k_best_full(np.ascontiguousarray(matrix.T), k), n)
    if len(solutions) == 0:
        solutions = _partial(matrix, k)
    # The solver sums its costs step by step; the last digit decides between near ties only here.
    return sorted(((_cost(matrix, columns), columns) for columns in solutions), key=lambda entry: entry[0])


def _cost(costs: FloatArray, columns: IntArray) -> float:
    rows = np.flatnonzero(columns >= 0)
    return float(costs[rows, columns[rows]].sum())


def _transposed(solutions: IntArray, n: int) -> IntArray:
    """Rows per column (K, m) turned into columns per row (K, n)."""
    out = np.full((len(solutions), n), -1)
    for row, solution in zip(out, solutions, strict=True):
        row[solution] = np.arange(len(solution))
    return out


def _partial(costs: FloatArray, k: int) -> IntArray:
    """Assignments of most pairs where forbidden pairs leave no complete one.

    Row i may take a column m + i of its own at a price above any difference between complete assignments:
    fewer such columns always win, and no assignment appears twice.
    """
    n, m = costs.shape
    finite = costs[np.isfinite(costs)]
    if finite.size == 0:
        return np.full((1, n), -1)
    # Shifting all pairs by one amount changes no order among assignments with equally many pairs.
    low, high = float(finite.min()), float(finite.max())
    price = (high - low + 1.0) * (min(n, m) + 1)
    extended = np.full((n, m + n), np.inf)
    extended[:, :m] = costs - low
    extended[np.arange(n), m + np.arange(n)] = price
    solutions = k_best_full(extended, k)
    solutions[solutions >= m] = -1
    unassigned = (solutions < 0).sum(1)
    return solutions[unassigned == unassigned[0]]
