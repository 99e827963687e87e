"""Compiled search for the ways in which known, new and split-off targets may have caused a group of returns.

A *structure* says which targets gave returns at all and which new ones there are. Within a structure, which return
is whose is summed out by a variational bound: return i belongs to target k with probability r_ik, and

    F(r) = Σ_k f_k(n_k, z̄_k, Z_k) + Σ_ik r_ik log g_ik + Σ_i r_i0 log κ_i - Σ r log r ≤ log of the sum over all
    associations,

where n_k, z̄_k, Z_k are count, mean and scatter of the returns weighted by r_ik and f_k is the log-likelihood of a
cell (9d) with the same factorisation, n_k fractional. With every r either 0 or 1 it is the weight of one partition.
Returns have a look, of log-likelihood ratio s_i between two classes of targets; clutter looks like the second class.
Of a target that is of the first with probability c_k, g_ik = c_k exp(s_i) + 1 - c_k.

A source (a row of `sources`) is a target that may have given returns; its columns are below.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numba import njit

# Columns of a source: position and its covariance, spread of returns, gamma density of the rate, log-weight of giving
# returns, log-weight of giving none, probability of the first class.
MX, MY, PXX, PXY, PYY, XXX, XXY, XYY, ALPHA, BETA, ON, OFF, CLASS = range(13)
COLUMNS = 13
# What follows from those, computed once a search: logarithms of the rate and of the volume of the spread, precisions of
# the spread and of the position.
LOG_RATE, LOG_X, WXX, WXY, WYY, QXX, QXY, QYY = range(13, 21)
# Columns of a return: position, log-density of clutter there, log-likelihood ratio of its look.
X, Y, CLUTTER, LOOK = range(4)
# Columns of a cell: count, mean, scatter, and the spread of the mean that comes from not knowing whose returns are.
N, ZX, ZY, SXX, SXY, SYY, UXX, UXY, UYY = range(9)
CELL = 9
LOG_TWO_PI = math.log(2.0 * math.pi)
# A target that gives returns gives this many at least (of fractional ones).
FEWEST = 0.5


class CellModel(NamedTuple):
    """gate : squared distance. rate_known : whether sources give as many returns as configured. sweeps : of the
    association at most."""

    gate: float
    rate_known: bool
    sweeps: int


class SearchBudget(NamedTuple):
    """Structures within `margin` nat of the best are kept, `most` at most, and the best `expansions` varied."""

    margin: float
    most: int
    expansions: int


class Kept(NamedTuple):
    """Structures (M,): log-weights, what is on (M, S), cells (M, S, 9), centres (M, S, 2), whether varied already."""

    values: Any
    active: Any
    cells: Any
    centres: Any
    done: Any


class Problem(NamedTuple):
    """Returns z (n, 4), the sources with what follows from them (S, 21), log g_ik (n, S), and room to work in: what is
    on (S,), terms of its likelihoods (S, 7), moments of what it gets (S, 9), and of one return (S,) who may have caused
    it, the log-likelihoods and the shares."""

    z: Any
    sources: Any
    ratios: Any
    index: Any
    terms: Any
    total: Any
    near: Any
    logs: Any
    shares: Any


@njit(cache=True)
def posed(z: Any, sources: Any) -> Problem:
    """The problem of returns (n, 4) and sources (S, 13)."""
    S = len(sources)
    index, near = np.empty(S, np.int64), np.empty(S, np.int64)
    terms, total, logs, shares = np.empty((S, 7)), np.empty((S, CELL)), np.empty(S), np.empty(S)
    ratios = _look_ratios(z, sources)
    return Problem(z, with_constants(sources), ratios, index, terms, total, near, logs, shares)


@njit(cache=True)
def with_constants(sources: Any) -> Any:
    """Sources (S, 21) with what follows from their first 13 columns."""
    whole = np.empty((len(sources), QYY + 1))
    for k in range(len(sources)):
        s = whole[k]
        for q in range(COLUMNS):
            s[q] = sources[k, q]
        volume, p = s[XXX] * s[XYY] - s[XXY] ** 2, s[PXX] * s[PYY] - s[PXY] ** 2
        s[LOG_RATE], s[LOG_X] = math.log(s[ALPHA] / s[BETA]), math.log(volume)
        s[WXX], s[WXY], s[WYY] = s[XYY] / volume, -s[XXY] / volume, s[XXX] / volume
        s[QXX], s[QXY], s[QYY] = s[PYY] / p, -s[PXY] / p, s[PXX] / p
    return whole


@njit(cache=True)
def _look_ratios(z: Any, sources: Any) -> Any:
    """log g_ik (n, S) of the returns z (n, 4) under the sources (S, 13)."""
    ratios = np.zeros((len(z), len(sources)))
    for i in range(len(z)):
        ratio = math.exp(z[i, LOOK]) if z[i, LOOK] != 0.0 else 1.0
        for k in range(len(sources)):
            likely = sources[k, CLASS]
            if likely > 0.0 and ratio != 1.0:
                ratios[i, k] = math.log(likely * ratio + 1.0 - likely)
    return ratios


@njit(cache=True, inline="always")
def log_cell(s: Any, c: Any, rate_known: bool) -> float:
    """Log-likelihood of a cell of fractional count under a source (21,): rate, mean and scatter of the returns."""
    n = c[N]
    if rate_known:
        result = n * s[LOG_RATE] - s[ALPHA] / s[BETA]
    else:
        a, b = s[ALPHA], s[BETA]
        result = math.lgamma(a + n) - math.lgamma(a) + a * math.log(b) - (a + n) * math.log(b + 1.0)
    a, b, d = s[PXX] + s[XXX] / n, s[PXY] + s[XXY] / n, s[PYY] + s[XYY] / n
    determinant = a * d - b * b
    x, y = c[ZX] - s[MX], c[ZY] - s[MY]
    square = (d * x * x - 2.0 * b * x * y + a * y * y) / determinant
    result += -0.5 * (square + math.log(determinant)) - LOG_TWO_PI
    trace = s[WXX] * c[SXX] + 2.0 * s[WXY] * c[SXY] + s[WYY] * c[SYY]
    return result - 0.5 * ((n - 1.0) * (2.0 * LOG_TWO_PI + s[LOG_X]) + trace) - math.log(n)


@njit(cache=True, inline="always")
def _weights_of(s: Any, c: Any, centre: Any, predictive: bool, model: CellModel, out: Any) -> None:
    """Terms (7,) of a return's log-likelihood under a source: constant, precision xx, xy, yy, centre x, y, and the
    variance in x, which says at once of most returns that they are too far away."""
    out[4], out[5] = centre[0], centre[1]
    if not predictive:
        out[0], out[1], out[2], out[3] = -0.5 * s[LOG_X], s[WXX], s[WXY], s[WYY]
    else:
        xx, xy, yy = s[PXX] + s[XXX], s[PXY] + s[XXY], s[PYY] + s[XYY]
        determinant = xx * yy - xy * xy
        out[0] = -0.5 * math.log(determinant)
        out[1], out[2], out[3] = yy / determinant, -xy / determinant, xx / determinant
    out[6] = out[3] / (out[1] * out[3] - out[2] * out[2])
    if model.rate_known or predictive:
        out[0] += s[LOG_RATE] - LOG_TWO_PI
    else:
        out[0] += math.log(max(s[ALPHA] + c[N] - 0.5, 0.1) / (s[BETA] + 1.0)) - LOG_TWO_PI
    if not predictive:
        # The centre itself is uncertain: (P⁻¹ + n X⁻¹)⁻¹ spreads the expected square.
        n = c[N]
        a, b, d = s[QXX] + n * out[1], s[QXY] + n * out[2], s[QYY] + n * out[3]
        out[0] -= 0.5 * (out[1] * d - 2.0 * out[2] * b + out[3] * a) / (a * d - b * b)


@njit(cache=True, inline="always")
def _share_out(problem: Problem, K: int, centres: Any, gate: float) -> float:
    """Σ r (log κ + log g - log r) of the returns by the terms of the first K sources of the index.

    Fills `problem.total` with the moments of what each gets, about its centre.
    """
    z, _, ratios, index, terms, total, near, logs, shares = problem
    total[:K] = 0.0
    value = 0.0
    for i in range(len(z)):
        zx, zy, clutter = z[i, X], z[i, Y], z[i, CLUTTER]
        count, top = 0, clutter
        for a in range(K):
            x, y = zx - terms[a, 4], zy - terms[a, 5]
            if x * x >= gate * terms[a, 6]:
                continue
            square = terms[a, 1] * x * x + 2.0 * terms[a, 2] * x * y + terms[a, 3] * y * y
            if square < gate:
                log = terms[a, 0] + ratios[i, index[a]] - 0.5 * square
                near[count], logs[count] = a, log
                count += 1
                top = max(top, log)
        whole = 0.0
        for b in range(count):
            shares[b] = math.exp(logs[b] - top)
            whole += shares[b]
        left = math.exp(clutter - top)
        whole += left
        # Of each share its logarithm is known but for that of the whole.
        log_whole = top + math.log(whole)
        value += left / whole * log_whole
        for b in range(count):
            share = shares[b] / whole
            if share <= 1e-9:
                continue
            k = index[near[b]]
            value += share * (ratios[i, k] - logs[b] + log_whole)
            _add(total[near[b]], share, zx - centres[k, 0], zy - centres[k, 1])
    return value


@njit(cache=True, inline="always")
def _add(total: Any, share: float, x: float, y: float) -> None:
    """Adds a share of a return, which lies at (x, y) from the centre, to moments (9,)."""
    unsure = share * (1.0 - share)
    total[N] += share
    total[ZX] += share * x
    total[ZY] += share * y
    total[SXX] += share * x * x
    total[SXY] += share * x * y
    total[SYY] += share * y * y
    total[UXX] += unsure * x * x
    total[UXY] += unsure * x * y
    total[UYY] += unsure * y * y


@njit(cache=True, inline="always")
def _recentre(s: Any, total: Any, cell: Any, centre: Any) -> float:
    """Cell (9,) of the moments `total` (9,) about a centre (2,), which moves to m + P (P + X/n)⁻¹ (z̄ - m).

    Returns how far it moved, squared and in spreads of returns; -1 where the source gets no return.
    """
    count = total[N]
    cell[N] = count
    if count < 1e-3:
        return -1.0
    x, y = total[ZX] / count, total[ZY] / count
    cell[ZX], cell[ZY] = centre[0] + x, centre[1] + y
    cell[SXX] = max(total[SXX] - count * x * x, 0.0)
    cell[SXY] = total[SXY] - count * x * y
    cell[SYY] = max(total[SYY] - count * y * y, 0.0)
    cell[UXX], cell[UXY], cell[UYY] = total[UXX], total[UXY], total[UYY]
    u, v, w = s[PXX] + s[XXX] / count, s[PXY] + s[XXY] / count, s[PYY] + s[XYY] / count
    q = u * w - v * v
    x, y = cell[ZX] - s[MX], cell[ZY] - s[MY]
    x, y = (w * x - v * y) / q, (u * y - v * x) / q
    nx, ny = s[MX] + s[PXX] * x + s[PXY] * y, s[MY] + s[PXY] * x + s[PYY] * y
    moved: float = ((nx - centre[0]) ** 2 + (ny - centre[1]) ** 2) / (s[XXX] + s[XYY])
    centre[0], centre[1] = nx, ny
    return moved


@njit(cache=True)
def evaluate(problem: Problem, on: Any, cells: Any, centres: Any, started: Any, model: CellModel) -> float:
    """F of a structure: the sources `on` (S,) share the returns with clutter.

    cells (S, 9), centres (S, 2) : with `started` where the sweeps begin, otherwise from the predictions; filled with
    the cells and the corrected positions. Returns -inf where a source that is on gets no return.
    """
    sources, index, terms, total = problem.sources, problem.index, problem.terms, problem.total
    K = 0
    for k in range(len(sources)):
        if on[k]:
            index[K] = k
            K += 1
    value = -np.inf
    for sweep in range(model.sweeps):
        first = not started and sweep == 0
        for a in range(K):
            k = index[a]
            if first:
                centres[k, 0], centres[k, 1] = sources[k, MX], sources[k, MY]
            _weights_of(sources[k], cells[k], centres[k], first, model, terms[a])
        value = _share_out(problem, K, centres, model.gate)
        moved, starved = 0.0, False
        for a in range(K):
            k = index[a]
            step = _recentre(sources[k], total[a], cells[k], centres[k])
            starved |= step < 0.0
            moved = max(moved, step)
        if starved:
            return -np.inf
        if sweep > 0 and moved < 1e-4:
            break
    for k in range(len(sources)):
        if not on[k]:
            value += sources[k, OFF]
        elif cells[k, N] < FEWEST:
            return -np.inf
        else:
            value += sources[k, ON] + log_cell(sources[k], cells[k], model.rate_known)
    return value


@njit(cache=True)
def _divide(cell: Any, way: float, parent: Any, child: Any) -> None:
    """Centres (2,) of two halves of a cell along its longer axis."""
    xx, xy, yy = cell[SXX] / cell[N], cell[SXY] / cell[N], cell[SYY] / cell[N]
    length = 0.5 * (xx + yy) + math.hypot(0.5 * (xx - yy), xy)
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    # Where the halves of a Gaussian have their means.
    away = way * math.sqrt(2.0 / math.pi * length)
    x, y = away * math.cos(angle), away * math.sin(angle)
    parent[0], parent[1] = cell[ZX] + x, cell[ZY] + y
    child[0], child[1] = cell[ZX] - x, cell[ZY] - y


@njit(cache=True)
def _any_equal(rows: Any, row: Any) -> bool:
    """Whether one of the rows (M, S) equals a row (S,)."""
    for other in rows:
        same = True
        for k in range(len(row)):
            if other[k] != row[k]:
                same = False
                break
        if same:
            return True
    return False


class Structure(NamedTuple):
    """One structure: what is on (S,), cells (S, 9), centres (S, 2)."""

    on: Any
    cells: Any
    centres: Any


@njit(cache=True)
def _copy(base: Structure, on: Any, cells: Any, centres: Any) -> None:
    """Writes a structure into arrays like its own."""
    for k in range(len(on)):
        on[k] = base.on[k]
        for q in range(CELL):
            cells[k, q] = base.cells[k, q]
        centres[k, 0], centres[k, 1] = base.centres[k, 0], base.centres[k, 1]


@njit(cache=True)
def _varied(base: Structure, into: Structure, k: int, sources: Any, known: int, seeds: Any) -> bool:
    """Makes `into` what `base` is with source k on or off instead; False if that may not be."""
    births = known + len(seeds)
    spawned, parent = k >= births, (k - births) // 2
    on, cells, centres = into
    # A target splits off one that is seen with it.
    if spawned and (base.on[k] or not base.on[parent]):
        return False
    first = births + 2 * k
    if k < known and first < len(sources) and (base.on[first] or base.on[first + 1]):
        return False
    _copy(base, on, cells, centres)
    on[k] = not on[k]
    if not on[k]:
        return True
    s = sources[k]
    if spawned:
        way = 1.0 if (k - births) % 2 == 0 else -1.0
        _divide(base.cells[parent], way, centres[parent], centres[k])
        for q in range(CELL):
            cells[parent, q] *= 0.5
            cells[k, q] = cells[parent, q]
        return True
    centres[k, 0], centres[k, 1] = s[MX], s[MY]
    if k >= known:
        centres[k, 0], centres[k, 1] = seeds[k - known, 0], seeds[k - known, 1]
    expected = s[ALPHA] / s[BETA]
    cells[k, N], cells[k, SXX] = expected, expected * s[XXX]
    cells[k, SXY], cells[k, SYY] = expected * s[XXY], expected * s[XYY]
    return True


@njit(cache=True)
def _reaches(problem: Problem, structure: Structure, k: int, model: CellModel) -> bool:
    """Whether any return lies in the gate of source k, from where its sweeps begin."""
    term = problem.terms[0]
    _weights_of(problem.sources[k], structure.cells[k], structure.centres[k], False, model, term)
    for i in range(len(problem.z)):
        x, y = problem.z[i, X] - term[4], problem.z[i, Y] - term[5]
        if term[1] * x * x + 2.0 * term[2] * x * y + term[3] * y * y < model.gate:
            return True
    return False


@njit(cache=True)
def _first(problem: Problem, known: int, model: CellModel, kept: Kept) -> None:
    """The structure in which all known targets gave returns but those that nothing is left for, as the first."""
    on, cell, centre = kept.active[0], kept.cells[0], kept.centres[0]
    on[:known] = True
    for _ in range(known + 1):
        # Not as a literal, for each of which it would be compiled.
        kept.values[0] = evaluate(problem, on, cell, centre, np.bool_(False), model)
        if kept.values[0] > -np.inf:
            return
        weakest = -1
        for k in range(known):
            if on[k] and (weakest < 0 or cell[k, N] < cell[weakest, N]):
                weakest = k
        if weakest < 0:
            return
        on[weakest] = False
        cell[:] = 0.0


@njit(cache=True)
def search(
    z: Any, sources: Any, known: int, seeds: Any, model: CellModel, budget: SearchBudget
) -> tuple[Any, Any, Any]:
    """The likeliest structures, best first: their log-weights (M,), what is on (M, S), and the cells (M, S, 9).

    z (n, 4) : returns. sources (S, 13): `known` targets, then places for new ones, whose sweeps begin at `seeds`
    (births, 2), then, two for each known target or none at all, targets that may have split off it. Structures are
    varied by one target at a time.
    """
    S, most, margin = len(sources), budget.most, budget.margin
    problem = posed(z, sources)
    kept = Kept(
        np.full(most, -np.inf),
        np.zeros((most, S), np.bool_),
        np.zeros((most, S, CELL)),
        np.zeros((most, S, 2)),
        np.zeros(most, np.bool_),
    )
    new = Structure(np.zeros(S, np.bool_), np.zeros((S, CELL)), np.zeros((S, 2)))
    _first(problem, known, model, kept)
    count, best = 1, kept.values[0]
    for _ in range(budget.expansions):
        likeliest, chosen = -np.inf, 0
        for m in range(count):
            if not kept.done[m] and kept.values[m] > likeliest:
                likeliest, chosen = kept.values[m], m
        if likeliest <= best - margin:
            break
        kept.done[chosen] = True
        base = Structure(kept.active[chosen].copy(), kept.cells[chosen].copy(), kept.centres[chosen].copy())
        for k in range(S):
            if not _varied(base, new, k, sources, known, seeds) or _any_equal(kept.active[:count], new.on):
                continue
            if new.on[k] and not _reaches(problem, new, k, model):
                continue  # it would be evaluated as impossible
            value = evaluate(problem, new.on, new.cells, new.centres, np.bool_(True), model)
            if value < best - margin or value == -np.inf:
                continue
            best = max(best, value)
            place = count if count < most else np.argmin(kept.values)
            if count == most and kept.values[place] >= value:
                continue
            count = min(count + 1, most)
            kept.values[place], kept.done[place] = value, False
            _copy(new, kept.active[place], kept.cells[place], kept.centres[place])
    order = np.argsort(-kept.values[:count])
    order = order[: max(int((kept.values[:count] > best - margin).sum()), 1)]
    return kept.values[order], kept.active[order], kept.cells[order]
