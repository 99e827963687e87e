"""Compiled search for the ways in which known, new and split-off targets may have caused a group of returns.

A *structure* says which targets gave returns at all and which new ones there are. Within a structure, which return
is whose is summed out by a variational bound: return i belongs to target k with probability r_ik, and

    F(r) = Σ_k f_k(n_k, z̄_k, Z_k) + Σ_i r_i0 log κ_i - Σ r log r ≤ log of the sum over all associations,

where n_k, z̄_k, Z_k are count, mean and scatter of the returns weighted by r_ik and f_k is the log-likelihood of a
cell (9d) with the same factorisation, n_k fractional. With every r either 0 or 1 it is the weight of one partition.

A source (a row of `sources`) is a target that may have given returns; its columns are below.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

# Columns of a source: position and its covariance, spread of returns, gamma density of the rate, Wishart scatter and
# freedom of the spread, log-weight of giving returns, log-weight of giving none.
MX, MY, PXX, PXY, PYY, XXX, XXY, XYY, ALPHA, BETA, VXX, VXY, VYY, NU, ON, OFF = range(16)
COLUMNS = 16
# Columns of a cell: count, mean, scatter, and the spread of the mean that comes from not knowing whose returns are.
N, ZX, ZY, SXX, SXY, SYY, UXX, UXY, UYY = range(9)
CELL = 9
LOG_TWO_PI = math.log(2.0 * math.pi)
LOG_PI = math.log(math.pi)
# A target that gives returns gives this many at least (of fractional ones).
FEWEST = 0.5


@njit(cache=True)
def log_cell(s: Any, c: Any, rate_known: bool, spread_known: bool) -> float:
    """Log-likelihood of a cell of fractional count under a source (16,): rate, mean and scatter of the returns."""
    n = c[N]
    if rate_known:
        result = n * math.log(s[ALPHA] / s[BETA]) - s[ALPHA] / s[BETA]
    else:
        a, b = s[ALPHA], s[BETA]
        result = math.lgamma(a + n) - math.lgamma(a) + a * math.log(b) - (a + n) * math.log(b + 1.0)
    a, b, d = s[PXX] + s[XXX] / n, s[PXY] + s[XXY] / n, s[PYY] + s[XYY] / n
    determinant = a * d - b * b
    x, y = c[ZX] - s[MX], c[ZY] - s[MY]
    square = (d * x * x - 2.0 * b * x * y + a * y * y) / determinant
    result += -0.5 * (square + math.log(determinant)) - LOG_TWO_PI
    if spread_known:
        volume = s[XXX] * s[XYY] - s[XXY] ** 2
        trace = (s[XYY] * c[SXX] - 2.0 * s[XXY] * c[SXY] + s[XXX] * c[SYY]) / volume
        return result - 0.5 * ((n - 1.0) * (2.0 * LOG_TWO_PI + math.log(volume)) + trace) - math.log(n)
    before = s[VXX] * s[VYY] - s[VXY] ** 2
    after = (s[VXX] + c[SXX]) * (s[VYY] + c[SYY]) - (s[VXY] + c[SXY]) ** 2
    nu, new = s[NU], s[NU] + n - 1.0
    result += math.lgamma(0.5 * new) + math.lgamma(0.5 * new - 0.5)
    result -= math.lgamma(0.5 * nu) + math.lgamma(0.5 * nu - 0.5)
    return result + 0.5 * (nu * math.log(before) - new * math.log(after)) - (n - 1.0) * LOG_PI - math.log(n)


@njit(cache=True)
def _weights_of(
    s: Any, c: Any, centre: Any, predictive: bool, rate_known: bool, spread_known: bool, out: Any
) -> None:
    """Terms (6,) of a return's log-likelihood under a source: constant, precision xx, xy, yy, centre x, y."""
    if predictive:
        xx, xy, yy = s[PXX] + s[XXX], s[PXY] + s[XXY], s[PYY] + s[XYY]
    elif spread_known:
        xx, xy, yy = s[XXX], s[XXY], s[XYY]
    else:
        freedom = max(s[NU] + c[N] - 1.0, 1.0)
        xx, xy, yy = (s[VXX] + c[SXX]) / freedom, (s[VXY] + c[SXY]) / freedom, (s[VYY] + c[SYY]) / freedom
    determinant = xx * yy - xy * xy
    if rate_known or predictive:
        out[0] = math.log(s[ALPHA] / s[BETA])
    else:
        out[0] = math.log(max(s[ALPHA] + c[N] - 0.5, 0.1) / (s[BETA] + 1.0))
    out[0] -= LOG_TWO_PI + 0.5 * math.log(determinant)
    out[1], out[2], out[3] = yy / determinant, -xy / determinant, xx / determinant
    out[4], out[5] = centre[0], centre[1]
    if not predictive:
        # The centre itself is uncertain: (P⁻¹ + n X⁻¹)⁻¹ spreads the expected square.
        p = s[PXX] * s[PYY] - s[PXY] ** 2
        n = c[N]
        a, b, d = s[PYY] / p + n * out[1], -s[PXY] / p + n * out[2], s[PXX] / p + n * out[3]
        q = a * d - b * b
        out[0] -= 0.5 * (out[1] * d - 2.0 * out[2] * b + out[3] * a) / q


@njit(cache=True)
def evaluate(
    z: Any,
    sources: Any,
    on: Any,
    cells: Any,
    centres: Any,
    started: bool,
    gate: float,
    log_clutter: Any,
    rate_known: bool,
    spread_known: bool,
    sweeps: int,
) -> float:
    """F of a structure: the sources `on` (S,) share the returns z (n, 2) with clutter of log-density log_clutter (n,).

    cells (S, 9), centres (S, 2) : with `started` where the sweeps begin, otherwise from the predictions; filled with
    the cells and the corrected positions. Returns -inf where a source that is on gets no return.
    """
    n, S = len(z), len(sources)
    index = np.empty(S, np.int64)
    K = 0
    for k in range(S):
        if on[k]:
            index[K] = k
            K += 1
    terms = np.empty((K, 6))
    shares = np.empty(K + 1)
    total = np.empty((K, CELL))
    value = -np.inf
    for sweep in range(sweeps):
        for a in range(K):
            k = index[a]
            if not started and sweep == 0:
                centres[k, 0], centres[k, 1] = sources[k, MX], sources[k, MY]
            _weights_of(
                sources[k],
                cells[k],
                centres[k],
                not started and sweep == 0,
                rate_known,
                spread_known,
                terms[a],
            )
        total[:] = 0.0
        entropy, clutter = 0.0, 0.0
        for i in range(n):
            shares[K] = log_clutter[i]
            top = log_clutter[i]
            for a in range(K):
                x, y = z[i, 0] - terms[a, 4], z[i, 1] - terms[a, 5]
                square = terms[a, 1] * x * x + 2.0 * terms[a, 2] * x * y + terms[a, 3] * y * y
                shares[a] = terms[a, 0] - 0.5 * square if square < gate else -np.inf
                top = max(top, shares[a])
            whole = 0.0
            for a in range(K + 1):
                shares[a] = math.exp(shares[a] - top) if shares[a] > top - 30.0 else 0.0
                whole += shares[a]
            for a in range(K + 1):
                share = shares[a] / whole
                if share > 1e-9:
                    entropy -= share * math.log(share)
                    if a == K:
                        clutter += share * log_clutter[i]
                    else:
                        x, y = z[i, 0] - centres[index[a], 0], z[i, 1] - centres[index[a], 1]
                        total[a, N] += share
                        total[a, ZX] += share * x
                        total[a, ZY] += share * y
                        total[a, SXX] += share * x * x
                        total[a, SXY] += share * x * y
                        total[a, SYY] += share * y * y
                        unsure = share * (1.0 - share)
                        total[a, UXX] += unsure * x * x
                        total[a, UXY] += unsure * x * y
                        total[a, UYY] += unsure * y * y
        moved = 0.0
        starved = False
        for a in range(K):
            k, count = index[a], total[a, N]
            if count < 1e-3:
                cells[k, N] = count
                starved = True
                continue
            x, y = total[a, ZX] / count, total[a, ZY] / count
            cells[k, N] = count
            cells[k, ZX], cells[k, ZY] = centres[k, 0] + x, centres[k, 1] + y
            cells[k, SXX] = max(total[a, SXX] - count * x * x, 0.0)
            cells[k, SXY] = total[a, SXY] - count * x * y
            cells[k, SYY] = max(total[a, SYY] - count * y * y, 0.0)
            cells[k, UXX], cells[k, UXY], cells[k, UYY] = total[a, UXX], total[a, UXY], total[a, UYY]
            # The corrected position: m + P (P + X/n)⁻¹ (z̄ - m).
            s = sources[k]
            u, v, w = s[PXX] + s[XXX] / count, s[PXY] + s[XXY] / count, s[PYY] + s[XYY] / count
            q = u * w - v * v
            x, y = cells[k, ZX] - s[MX], cells[k, ZY] - s[MY]
            x, y = (w * x - v * y) / q, (u * y - v * x) / q
            nx, ny = s[MX] + s[PXX] * x + s[PXY] * y, s[MY] + s[PXY] * x + s[PYY] * y
            moved = max(moved, ((nx - centres[k, 0]) ** 2 + (ny - centres[k, 1]) ** 2) / (s[XXX] + s[XYY]))
            centres[k, 0], centres[k, 1] = nx, ny
        if starved:
            return -np.inf
        value = entropy + clutter
        if sweep > 0 and moved < 1e-4:
            break
    for a in range(K):
        k = index[a]
        if cells[k, N] < FEWEST:
            return -np.inf
        value += sources[k, ON] + log_cell(sources[k], cells[k], rate_known, spread_known)
    for k in range(S):
        if not on[k]:
            value += sources[k, OFF]
    return value


@njit(cache=True)
def _divide(cell: Any, way: float, parent: Any, child: Any) -> None:
    """Centres (2,) of two halves of a cell along its longer axis."""
    xx, xy, yy = cell[SXX] / cell[N], cell[SXY] / cell[N], cell[SYY] / cell[N]
    root = math.sqrt(max(0.25 * (xx - yy) ** 2 + xy * xy, 0.0))
    length = 0.5 * (xx + yy) + root
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    # Halves of a Gaussian have their means at 0.8 standard deviations.
    x, y = 0.8 * way * math.sqrt(length) * math.cos(angle), 0.8 * way * math.sqrt(length) * math.sin(angle)
    parent[0], parent[1] = cell[ZX] + x, cell[ZY] + y
    child[0], child[1] = cell[ZX] - x, cell[ZY] - y


@njit(cache=True)
def search(
    z: Any,
    sources: Any,
    known: int,
    births: int,
    seeds: Any,
    gate: float,
    log_clutter: Any,
    rate_known: bool,
    spread_known: bool,
    sweeps: int,
    margin: float,
    most: int,
    expansions: int,
) -> tuple[Any, Any, Any]:
    """The likeliest structures, best first: their log-weights (M,), what is on (M, S), and the cells (M, S, 9).

    sources (S, 16): `known` targets, then `births` places for new ones, whose sweeps begin at `seeds` (births, 2),
    then, two for each known target or none at all, targets that may have split off it. Structures within `margin` of
    the best are kept, `most` at most; each of the best `expansions` is varied by one target at a time. log_clutter (n,)
    is the log-density of clutter at each return.
    """
    S = len(sources)
    size = most + 1
    values = np.full(size, -np.inf)
    active = np.zeros((size, S), np.bool_)
    cells = np.zeros((size, S, CELL))
    centres = np.zeros((size, S, 2))
    done = np.zeros(size, np.bool_)
    count = 0

    on = np.zeros(S, np.bool_)
    on[:known] = True
    cell, centre = np.zeros((S, CELL)), np.zeros((S, 2))
    for _ in range(known + 1):
        # From the predictions; a target that nothing is left for gave no return.
        value = evaluate(
            z, sources, on, cell, centre, False, gate, log_clutter, rate_known, spread_known, sweeps
        )
        if value > -np.inf:
            break
        weakest, least = -1, np.inf
        for k in range(known):
            if on[k] and cell[k, N] < least:
                weakest, least = k, cell[k, N]
        if weakest < 0:
            break
        on[weakest] = False
        cell[:] = 0.0
    values[0], active[0], cells[0], centres[0] = value, on, cell, centre
    count = 1
    best = value

    for _ in range(expansions):
        chosen = -1
        for m in range(count):
            if not done[m] and values[m] > best - margin and (chosen < 0 or values[m] > values[chosen]):
                chosen = m
        if chosen < 0:
            break
        done[chosen] = True
        base_on, base_cells, base_centres = (
            active[chosen].copy(),
            cells[chosen].copy(),
            centres[chosen].copy(),
        )
        for k in range(S):
            spawned = k >= known + births
            parent = (k - known - births) // 2
            # A target splits off one that is seen with it.
            if spawned and (base_on[k] or not base_on[parent]):
                continue
            first = known + births + 2 * k
            if k < known and first < S and (base_on[first] or base_on[first + 1]):
                continue
            on[:] = base_on
            on[k] = not base_on[k]
            cell[:] = base_cells
            centre[:] = base_centres
            if on[k]:
                if spawned:
                    way = 1.0 if (k - known - births) % 2 == 0 else -1.0
                    _divide(base_cells[parent], way, centre[parent], centre[k])
                    cell[parent] *= 0.5
                    cell[k] = cell[parent]
                else:
                    centre[k, 0], centre[k, 1] = sources[k, MX], sources[k, MY]
                    if k >= known:
                        centre[k] = seeds[k - known]
                    expected = sources[k, ALPHA] / sources[k, BETA]
                    cell[k, N], cell[k, SXX] = expected, expected * sources[k, XXX]
                    cell[k, SXY], cell[k, SYY] = expected * sources[k, XXY], expected * sources[k, XYY]
            known_already = False
            for m in range(count):
                same = True
                for j in range(S):
                    if active[m, j] != on[j]:
                        same = False
                        break
                if same:
                    known_already = True
                    break
            if known_already:
                continue
            value = evaluate(
                z, sources, on, cell, centre, True, gate, log_clutter, rate_known, spread_known, sweeps
            )
            if value < best - margin or value == -np.inf:
                continue
            best = max(best, value)
            place = count
            if count == most:
                place = 0
                for m in range(count):
                    if values[m] < values[place]:
                        place = m
                if values[place] >= value:
                    continue
            else:
                count += 1
            values[place], active[place], cells[place], centres[place] = value, on, cell, centre
            done[place] = False
    order = np.argsort(-values[:count])
    keep = 0
    for m in order:
        if values[m] > best - margin or keep == 0:
            keep += 1
    order = order[:keep]
    return values[order], active[order], cells[order]
