"""Murty's k best assignments on successive shortest paths: the compiled part of `estimation.filters.assignment`.

Costs are (n, m) with n ≤ m; every row gets a column. A subproblem fixes rows 0..t-1 to its parent's columns
and forbids row t some columns (Murty 1968). It starts from its parent's solution and dual variables, so that
one shortest augmenting path from row t solves it (Miller, Stone, Cox 1997).

Columns left over count as held by identical idle rows of cost 0; the duals are kept so that v ≤ 0 on columns
in use and v = 0 on idle ones. A search may therefore pass through an idle row: the freed column of row t can
attract another row although row t itself settles on an idle column.
"""

from __future__ import annotations

import numba
import numpy as np

IDLE = -1
_NO_ROW = -2


@numba.njit(cache=True)
def _hand_on(source, end, previous, row_of, column_of):  # type: ignore[no-untyped-def]
    """Give each row on the way from row `source` to column `end` the column after it."""
    while True:
        before = previous[end]
        row = source if before == _NO_ROW else row_of[before]
        row_of[end] = row
        if row >= 0:
            column_of[row] = end
        if before == _NO_ROW:
            break
        end = before


@numba.njit(cache=True)
def augment(costs, source, first, banned, freed, limit, row_of, column_of, u, v):  # type: ignore[no-untyped-def]
    """Give row `source` a column by the shortest augmenting path over columns whose row is ≥ `first`.

    row_of (m,) : row of each column, IDLE or -2 for the freed one (`freed`, or -1 where all are idle).
    Changes row_of, column_of, u, v in place; returns the increase of the cost, inf where there is no way or
    where it would exceed `limit` (then nothing is changed).
    """
    n, m = costs.shape
    distance = np.full(m, np.inf)
    previous = np.empty(m, np.int64)
    state = np.zeros(m, np.int8)  # 0 open, 1 scanned, 2 out of reach
    for j in range(m):
        if row_of[j] >= 0 and row_of[j] < first:
            state[j] = 2
    scanned = np.empty(m, np.int64)
    row, base, via = source, 0.0, _NO_ROW
    count, idle_column = 0, -1
    while True:
        if row != IDLE:
            for j in range(m):
                if state[j] == 0 and not (row == source and banned[j]):
                    value = base + costs[row, j] - u[row] - v[j]
                    if value < distance[j]:
                        distance[j] = value
                        previous[j] = via
        else:
            for j in range(m):
                if state[j] == 0 and base - v[j] < distance[j]:
                    distance[j] = base - v[j]
                    previous[j] = via
        best, column = np.inf, -1
        for j in range(m):
            if state[j] == 0 and distance[j] < best:
                best, column = distance[j], j
        if column < 0 or best > limit:
            return np.inf
        if row_of[column] == _NO_ROW or (freed < 0 and row_of[column] == IDLE):
            break
        state[column] = 1
        scanned[count] = column
        count += 1
        row, base, via = row_of[column], best, column
        # All idle rows are alike: what a later one reaches, the first one has reached before.
        if row == IDLE and idle_column < 0:
            idle_column = column
    u[source] += best
    for k in range(count):
        j = scanned[k]
        if row_of[j] >= 0:
            u[row_of[j]] += best - distance[j]
        v[j] -= best - distance[j]
    _hand_on(source, column, previous, row_of, column_of)
    if idle_column >= 0:
        shift = best - distance[idle_column]
        for j in range(m):
            v[j] += shift
        for i in range(n):
            u[i] -= shift
    return best


@numba.njit(cache=True)
def _match_all(costs, no_ban, row_of, column_of, u, v):  # type: ignore[no-untyped-def]
    """Write the cheapest complete assignment and its duals; its cost, inf where there is none."""
    n, m = costs.shape
    for i in range(n):
        # Reduced costs of a new row may be negative; starting at its smallest keeps them at 0 or above.
        smallest = np.inf
        for j in range(m):
            smallest = min(smallest, costs[i, j] - v[j])
        if smallest == np.inf:
            return np.inf
        u[i] = smallest
        # As integers, not as literals, of which each would be compiled for itself.
        step = augment(costs, i, np.int64(0), no_ban, np.int64(-1), np.inf, row_of, column_of, u, v)
        if step == np.inf:
            return np.inf
    total = 0.0
    for i in range(n):
        total += costs[i, column_of[i]]
    return total


@numba.njit(cache=True)
def _close(out, size, room, cost, first, columns, banned, u, v):  # type: ignore[no-untyped-def]
    """Take subproblem `out` from a pool of `size`, and the dearest ones beyond `room`; how many stay."""
    while True:
        # The last subproblem takes the place of the one that leaves.
        size -= 1
        cost[out], first[out] = cost[size], first[size]
        columns[out], banned[out] = columns[size], banned[size]
        u[out], v[out] = u[size], v[size]
        if size <= room:
            return size
        out = np.argmax(cost[:size])


@numba.njit(cache=True)
def k_best_full(costs, k):  # type: ignore[no-untyped-def]
    """Columns (K, n) of the K ≤ k cheapest complete assignments in ascending order; n ≤ m, inf forbids."""
    n, m = costs.shape
    found = np.empty((k, n), np.int64)
    no_ban = np.zeros(m, np.bool_)
    row_of = np.full(m, IDLE, np.int64)
    columns = np.full(n, -1, np.int64)
    u, v = np.zeros(n), np.zeros(m)
    total = _match_all(costs, no_ban, row_of, columns, u, v)
    if total == np.inf:
        return found[:0]
    # The pool holds at most as many open subproblems as solutions are still wanted.
    pool_cost = np.full(k, np.inf)
    pool_first = np.zeros(k, np.int64)
    pool_columns = np.empty((k, n), np.int64)
    pool_banned = np.empty((k, m), np.bool_)
    pool_u, pool_v = np.empty((k, n)), np.empty((k, m))
    pool_cost[0] = total
    pool_columns[0], pool_banned[0], pool_u[0], pool_v[0] = columns, no_ban, u, v
    size = 1
    count = 0
    while size > 0:
        at = np.argmin(pool_cost[:size])
        cost, first = pool_cost[at], pool_first[at]
        columns, banned = pool_columns[at].copy(), pool_banned[at].copy()
        u, v = pool_u[at].copy(), pool_v[at].copy()
        found[count] = columns
        count += 1
        size = _close(at, size, k - count, pool_cost, pool_first, pool_columns, pool_banned, pool_u, pool_v)
        if count == k:
            break
        parent_rows = np.full(m, IDLE, np.int64)
        parent_rows[columns] = np.arange(n)
        for t in range(first, n):
            slot = int(size)
            limit = np.inf
            if size == k - count:
                slot = int(np.argmax(pool_cost[:size]))
                limit = pool_cost[slot] - cost
            if t > first:
                banned = np.zeros(m, np.bool_)
            banned[columns[t]] = True
            child_rows, child_columns = parent_rows.copy(), columns.copy()
            child_u, child_v = u.copy(), v.copy()
            child_rows[columns[t]] = _NO_ROW
            step = augment(
                costs, t, t, banned, columns[t], limit, child_rows, child_columns, child_u, child_v
            )
            if step == np.inf or (slot < size and step >= limit):
                continue
            pool_cost[slot] = cost + step
            pool_first[slot] = t
            pool_columns[slot], pool_banned[slot] = child_columns, banned
            pool_u[slot], pool_v[slot] = child_u, child_v
            size = max(size, slot + 1)
    return found[:count]
