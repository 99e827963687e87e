"""The scalar features of App. A.A, one compiled function per heading of the text, with its numbers in 2D and 3D.

Common arguments
----------------
r : (N,) ranges in metres in order of acquisition, limited to `limit`; a no-return is at `limit`.
limit : r_max, metres.
P : (N, 3) positions in metres, z = 0 in a planar scan; a row of NaN where the direction of a no-return is unknown.
steps : (L,) distance from point i to the next one, metres; L = N where the last point is followed by the first
    (a full circle), else N - 1. NaN where a position is unknown.

"Below" means r < r_max. Where the text restricts a feature to nothing, all points count. Standard deviations divide
by the number of values, as the moments of equation (29) do. A mean, deviation or kurtosis of nothing is 0.
"""

from __future__ import annotations

import math

import numba
import numpy as np

# All bin widths of Table 7 are whole multiples of 5 cm: ranges are tabulated once, and counts added up.
BINS_PER_METRE = 20
# Sums may be reordered (that makes them vectorise); NaN and infinity keep their meaning.
_SUMS = {"reassoc", "contract"}
# Eigenvalues of the scatter below this share of the largest are none: the points lie on a line or in a plane.
_FLAT = 1e-12


@numba.njit(cache=True, fastmath=_SUMS)
def mean_and_deviation(values):  # type: ignore[no-untyped-def]
    """Mean and standard deviation of (K,) values; zeros where K = 0."""
    count = len(values)
    if count == 0:
        return 0.0, 0.0
    total = 0.0
    for i in range(count):
        total += values[i]
    mean = total / count
    squares = 0.0
    for i in range(count):
        squares += (values[i] - mean) * (values[i] - mean)
    return mean, math.sqrt(squares / count)


@numba.njit(cache=True)
def returns(r, limit):  # type: ignore[no-untyped-def]
    """The ranges below the limit, (K,)."""
    kept = np.empty(len(r))
    count = 0
    for i in range(len(r)):
        if r[i] < limit:
            kept[count] = r[i]
            count += 1
    return kept[:count]


@numba.njit(cache=True, fastmath=_SUMS)
def content(r, limit, power):  # type: ignore[no-untyped-def]
    """Features 1 (all r) and 2 (r below the limit), equations (27) and (31): area (power 2) or volume (power 3).

    As a share of the greatest measurable one of as many points.
    """
    if len(r) == 0:
        return 0.0
    total = 0.0
    for i in range(len(r)):
        share = r[i] / limit
        total += share * share * (share if power == 3 else 1.0)
    return total / len(r)


@numba.njit(cache=True)
def range_statistics(r, below, limit):  # type: ignore[no-untyped-def]
    """Features 3 to 6: average normalised range below the limit and of all; standard deviation likewise."""
    mean_below, deviation_below = mean_and_deviation(below)
    mean, deviation = mean_and_deviation(r)
    return mean_below / limit, mean / limit, deviation_below / limit, deviation / limit


@numba.njit(cache=True, fastmath=_SUMS)
def _scatter(P):  # type: ignore[no-untyped-def]
    """Of the known points: number, mean (3,), Σ u uᵀ (3, 3), ½ Σ |u|² u (3,), with u = p - mean."""
    count, x, y, z = 0, 0.0, 0.0, 0.0
    for i in range(len(P)):
        if not math.isnan(P[i, 0]):
            count += 1
            x += P[i, 0]
            y += P[i, 1]
            z += P[i, 2]
    some = max(count, 1)
    x, y, z = x / some, y / some, z / some
    xx, xy, xz, yy, yz, zz, px, py, pz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(len(P)):
        if math.isnan(P[i, 0]):
            continue
        u, v, w = P[i, 0] - x, P[i, 1] - y, P[i, 2] - z
        half = 0.5 * (u * u + v * v + w * w)
        xx, xy, xz = xx + u * u, xy + u * v, xz + u * w
        yy, yz, zz = yy + v * v, yz + v * w, zz + w * w
        px, py, pz = px + half * u, py + half * v, pz + half * w
    second = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return count, np.array([x, y, z]), second, np.array([px, py, pz])


@numba.njit(cache=True, fastmath=_SUMS)
def _distances(P, centre, kept):  # type: ignore[no-untyped-def]
    """Distances of the points that are `kept` (N,) to `centre` (3,)."""
    found, count = np.empty(len(P)), 0
    x, y, z = centre
    for i in range(len(P)):
        if kept[i]:
            found[count] = math.sqrt((P[i, 0] - x) ** 2 + (P[i, 1] - y) ** 2 + (P[i, 2] - z) ** 2)
            count += 1
    return found[:count]


@numba.njit(cache=True)
def circularity(P, limit):  # type: ignore[no-untyped-def]
    """Features 7 to 9, the fitted circle or sphere: r_c / r_max, residual sum of squares / (N r_c), |p_c| / r_max.

    The text asks for a least squares fit and does not say of what. Fitted is the linear form |p|² = 2 p·c + k (no
    iteration, one solution). Points in a plane do not determine a centre off it, points on a line none beside it: the
    centre is put into the plane (which makes it the circle of a planar scan) or onto the line. The residual is 0
    where r_c is.
    """
    count, centre, second, third = _scatter(P)
    if count == 0:
        return 0.0, 0.0, 0.0
    values, vectors = np.linalg.eigh(second)
    square = (second[0, 0] + second[1, 1] + second[2, 2]) / count
    for k in range(3):
        if values[k] > _FLAT * values[2]:
            along = (vectors[0, k] * third[0] + vectors[1, k] * third[1] + vectors[2, k] * third[2]) / values[
                k
            ]
            square += along * along
            for a in range(3):
                centre[a] += along * vectors[a, k]
    radius = math.sqrt(square)
    mean, deviation = mean_and_deviation(_distances(P, centre, ~np.isnan(P[:, 0])))
    residual = deviation * deviation + (radius - mean) ** 2
    offset = math.sqrt(centre[0] ** 2 + centre[1] ** 2 + centre[2] ** 2)
    return radius / limit, residual / radius if radius > 0.0 else 0.0, offset / limit


@numba.njit(cache=True, fastmath=_SUMS)
def centroid(r, P, limit):  # type: ignore[no-untyped-def]
    """Features 10 to 12, of points below the limit: |mean|, then mean and standard deviation of distances to it, m."""
    count, x, y, z = 0, 0.0, 0.0, 0.0
    for i in range(len(r)):
        if r[i] < limit:
            count += 1
            x += P[i, 0]
            y += P[i, 1]
            z += P[i, 2]
    if count == 0:
        return 0.0, 0.0, 0.0
    mean = np.array([x / count, y / count, z / count])
    average, deviation = mean_and_deviation(_distances(P, mean, r < limit))
    return math.sqrt(mean[0] ** 2 + mean[1] ** 2 + mean[2] ** 2), average, deviation


@numba.njit(cache=True)
def maximum_range(r, limit):  # type: ignore[no-untyped-def]
    """Features 13 and 14: number of ranges at the limit (no-returns are) and of ranges below it."""
    below = 0
    for i in range(len(r)):
        below += r[i] < limit
    return len(r) - below, below


@numba.njit(cache=True)
def distance_and_regularity(r, steps, limit, gate):  # type: ignore[no-untyped-def]
    """Features 15 to 18: Σ δp of all points, of pairs below the limit, of those under g_dist; deviation of δp below."""
    everything, under, count = 0.0, 0.0, 0
    below = np.empty(len(steps))
    for i in range(len(steps)):
        step = steps[i]
        if math.isnan(step):
            continue
        everything += step
        after = i + 1 if i + 1 < len(r) else 0
        if r[i] < limit and r[after] < limit:
            below[count] = step
            count += 1
            if step < gate:
                under += step
    mean, deviation = mean_and_deviation(below[:count])
    return everything, mean * count, under, deviation


@numba.njit(cache=True)
def _legs(P, before, here, after):  # type: ignore[no-untyped-def]
    """Of the two legs of a corner: |a × b|, a · b and the distance between its ends, |a + b|."""
    ax, ay, az = P[here, 0] - P[before, 0], P[here, 1] - P[before, 1], P[here, 2] - P[before, 2]
    bx, by, bz = P[after, 0] - P[here, 0], P[after, 1] - P[here, 1], P[after, 2] - P[here, 2]
    x, y, z = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
    far = math.sqrt((ax + bx) ** 2 + (ay + by) ** 2 + (az + bz) ** 2)
    return math.sqrt(x * x + y * y + z * z), ax * bx + ay * by + az * bz, far


@numba.njit(cache=True)
def _corners(r, steps):  # type: ignore[no-untyped-def]
    """First and one past last index of points that have both neighbours."""
    if len(steps) == len(r):
        return 0, len(r)
    return 1, len(r) - 1


@numba.njit(cache=True)
def curvature(r, P, steps, limit, gate):  # type: ignore[no-untyped-def]
    """Features 19 and 20: mean and standard deviation of 4 A / (d₋ d d₊), 1/m.

    Over points that are below the limit with both neighbours, all three sides of the triangle under g_dist. A
    triangle with coincident corners has no curvature and is left out.
    """
    n = len(r)
    first, last = _corners(r, steps)
    found, count = np.empty(n), 0
    for i in range(first, last):
        before, after = i - 1 if i > 0 else n - 1, i + 1 if i + 1 < n else 0
        if not (r[before] < limit and r[i] < limit and r[after] < limit):
            continue
        if not (0.0 < steps[before] < gate and 0.0 < steps[i] < gate):
            continue
        cross, _, far = _legs(P, before, i, after)
        if 0.0 < far < gate:
            found[count] = 2.0 * cross / (steps[before] * steps[i] * far)
            count += 1
    return mean_and_deviation(found[:count])


@numba.njit(cache=True, fastmath=_SUMS)
def kurtosis(r, limit):  # type: ignore[no-untyped-def]
    """Features 21 (r below the limit) and 22 (all r), equation (29): m₄ / m₂² - 3; 0 where all ranges are equal."""
    mean, deviation = mean_and_deviation(r)
    # Equal ranges leave a deviation of rounding.
    if deviation <= 1e-12 * limit:
        return 0.0
    fourth = 0.0
    for i in range(len(r)):
        square = ((r[i] - mean) / deviation) ** 2
        fourth += square * square
    return fourth / len(r) - 3.0


@numba.njit(cache=True)
def relative_range(r, steps, limit):  # type: ignore[no-untyped-def]
    """Features 23 to 26: mean and standard deviation of rᵢ / rᵢ₊₁ of all pairs, then of pairs below the limit."""
    ratios, below, count = np.empty(len(steps)), np.empty(len(steps)), 0
    for i in range(len(steps)):
        after = i + 1 if i + 1 < len(r) else 0
        ratios[i] = r[i] / r[after]
        if r[i] < limit and r[after] < limit:
            below[count] = ratios[i]
            count += 1
    mean, deviation = mean_and_deviation(ratios)
    mean_below, deviation_below = mean_and_deviation(below[:count])
    return mean, deviation, mean_below, deviation_below


@numba.njit(cache=True)
def range_difference(r, steps, gate):  # type: ignore[no-untyped-def]
    """Features 27 to 32, two per gate g_r: mean and standard deviation of |rᵢ - rᵢ₊₁| / g_r, both ranges ≤ g_r."""
    differences, count = np.empty(len(steps)), 0
    for i in range(len(steps)):
        after = i + 1 if i + 1 < len(r) else 0
        if r[i] <= gate and r[after] <= gate:
            differences[count] = abs(r[i] - r[after])
            count += 1
    mean, deviation = mean_and_deviation(differences[:count])
    return mean / gate, deviation / gate


@numba.njit(cache=True)
def groups(r, steps, gate, minimum):  # type: ignore[no-untyped-def]
    """Features 33 and 34, 2D: number of groups and average number of points in one (0 without groups).

    A group is a run of more than `minimum` points, each closer than `gate` to the next.
    """
    n = len(r)
    start, gaps = 0, 0
    for i in range(len(steps)):
        if steps[i] >= gate:
            start, gaps = i + 1, gaps + 1
    if len(steps) < n:
        start, gaps = 0, 1
    found, members, size = 0, 0, 0
    for k in range(n):
        i = (start + k) % n
        size += 1
        # The last point ends a group even where a circle without any gap comes round to the first.
        if k == n - 1 or steps[i] >= gate:
            if size > minimum:
                found, members = found + 1, members + size
            size = 0
    return found, members / found if found else 0.0


@numba.njit(cache=True)
def angular_difference(r, P, steps, limit):  # type: ignore[no-untyped-def]
    """Feature 35, 2D, equation (30): sum of angles between consecutive point to point vectors below the limit, rad.

    Named a mean, defined as a sum: it is the sum. A vector of length zero has no direction and is left out.
    """
    n = len(r)
    first, last = _corners(r, steps)
    total = 0.0
    for i in range(first, last):
        before, after = i - 1 if i > 0 else n - 1, i + 1 if i + 1 < n else 0
        if r[before] < limit and r[i] < limit and r[after] < limit and steps[before] > 0.0 and steps[i] > 0.0:
            cross, dot, _ = _legs(P, before, i, after)
            # The arc cosine of the text loses half the digits of a small angle; this is the same angle.
            total += math.atan2(cross, dot)
    return total


@numba.njit(cache=True)
def range_histograms(r, multiples, starts):  # type: ignore[no-untyped-def]
    """Features 36 to 44 in 2D, 33 to 41 in 3D: all ranges tabulated in bins of each width, one after the other.

    multiples : (H,) bin widths in units of 1 / BINS_PER_METRE;  starts : (H + 1,) where each histogram begins. A range
    at the limit is in the last bin.
    """
    finest = starts[1] * multiples[0]
    fine = np.zeros(finest, dtype=np.int64)
    for i in range(len(r)):
        # A product, not a quotient: ranges in whole centimetres fall on edges, and 0.7 * 20 is 14 while 0.7 / 0.05
        # is below it.
        at = r[i] * BINS_PER_METRE
        fine[max(int(at), 0) if at < finest - 1 else finest - 1] += 1
    counts = np.zeros(starts[-1])
    for h in range(len(multiples)):
        last = starts[h + 1] - 1
        for k in range(finest):
            counts[min(starts[h] + k // multiples[h], last)] += fine[k]
    return counts
