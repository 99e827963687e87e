"""Clusters of one laser scan and the features by which legs are told from furniture (item 5 of the tracker).

A leg at knee height is a short convex arc in front of its surroundings; two legs together, or a skirt, a wider one.
What a cluster looks like depends on the scanner's resolution and on the distance, so all features are in metres or
in shares of what the scanner could have returned.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numba import njit

from estimation.checks import FloatArray
from registration.laser.scan import Scan

IntArray = npt.NDArray[np.int64]

FEATURES = (
    "count", "width", "filled", "depth", "slimness", "bulge", "circle_radius", "circle_error", "roughness",
    "length_share", "jump_left", "jump_right", "jump_least", "jump_most", "partner_gap", "partner_width",
)  # fmt: skip
FAR = 3.0  # metres, cap of jumps and gaps


@dataclass(frozen=True)
class Clusters:
    """K clusters of neighbouring returns in the sensor frame.

    centres (K, 2) : metres, mean of the returns. counts (K,) : returns. widths (K,) : metres from the first to the last
    return. first, last (K,) : their beams. features (K, len(FEATURES)). labels (N,) : cluster of each beam, -1 without.
    """

    centres: FloatArray
    counts: IntArray
    widths: FloatArray
    first: IntArray
    last: IntArray
    features: FloatArray
    labels: IntArray

    def __len__(self) -> int:
        return len(self.counts)

    @property
    def ranges(self) -> FloatArray:
        """Distance of each centre from the sensor, (K,) metres."""
        return np.asarray(np.hypot(self.centres[:, 0], self.centres[:, 1]))


def clusters_of(
    scan: Scan,
    join: float = 0.1,
    max_range: float = np.inf,
    ignore: npt.NDArray[np.bool_] | None = None,
) -> Clusters:
    """Clusters of a scan: neighbouring returns less than `join` metres, or three beam spacings, apart.

    Up to two beams without a return do not end a cluster. Returns at `max_range` metres and beyond and beams of
    `ignore` (N,) are left out.
    """
    ranges = np.where(scan.valid, scan.ranges, np.inf)
    ranges[ranges >= max_range] = np.inf
    if ignore is not None:
        ranges[ignore] = np.inf
    bearings = scan.bearings
    labels, count = _joined(ranges, abs(scan.angle_increment), join)
    table = _features(ranges, bearings, labels, count, abs(scan.angle_increment))
    centres, counts, widths, ends, features = table
    _context(centres, widths, features)
    return Clusters(centres, counts, widths, ends[:, 0], ends[:, 1], features, labels)


@njit(cache=True)
def _joined(ranges, step, join):  # type: ignore[no-untyped-def]
    """Cluster number per beam (-1 without a return) and how many there are."""
    labels = np.full(len(ranges), -1, dtype=np.int64)
    count, last = 0, -1
    for k in range(len(ranges)):
        if not math.isfinite(ranges[k]):
            continue
        new = True
        if last >= 0 and k - last <= 3:
            angle = (k - last) * step
            a, b = ranges[last], ranges[k]
            gap = math.sqrt(max(a * a + b * b - 2.0 * a * b * math.cos(angle), 0.0))
            new = gap > max(join, 3.0 * step * min(a, b))
        if new:
            count += 1
        labels[k] = count - 1
        last = k
    return labels, count


@njit(cache=True)
def _neighbour(ranges, labels, beam, direction, step):  # type: ignore[no-untyped-def]
    """Range of the surroundings next to a cluster's end: the nearest return within 3° (at least two beams)."""
    reach = max(2, int(0.05 / step))
    k = beam + direction
    best = math.inf
    for _ in range(reach):
        if k < 0 or k >= len(ranges):
            break
        if math.isfinite(ranges[k]):
            best = ranges[k]
            break
        k += direction
    return best


@njit(cache=True)
def _features(ranges, bearings, labels, count, step):  # type: ignore[no-untyped-def]
    centres = np.zeros((count, 2))
    counts = np.zeros(count, dtype=np.int64)
    widths = np.zeros(count)
    ends = np.zeros((count, 2), dtype=np.int64)
    features = np.zeros((count, 16))
    beams = np.flatnonzero(labels >= 0)
    start = 0
    while start < len(beams):
        stop = start
        name = labels[beams[start]]
        while stop < len(beams) and labels[beams[stop]] == name:
            stop += 1
        n = stop - start
        x, y = np.empty(n), np.empty(n)
        for i in range(n):
            k = beams[start + i]
            x[i], y[i] = ranges[k] * math.cos(bearings[k]), ranges[k] * math.sin(bearings[k])
        mx, my = x.mean(), y.mean()
        first, last = beams[start], beams[stop - 1]
        centres[name, 0], centres[name, 1] = mx, my
        counts[name] = n
        ends[name, 0], ends[name, 1] = first, last
        width = math.hypot(x[n - 1] - x[0], y[n - 1] - y[0])
        widths[name] = width
        row = features[name]
        row[0] = n
        row[1] = width
        row[2] = n / (last - first + 1)
        _shape(x, y, mx, my, width, row)
        left = _neighbour(ranges, labels, first, -1, step)
        right = _neighbour(ranges, labels, last, 1, step)
        row[10] = max(-FAR, min(FAR, left - ranges[first]))
        row[11] = max(-FAR, min(FAR, right - ranges[last]))
        row[12], row[13] = min(row[10], row[11]), max(row[10], row[11])
        start = stop
    return centres, counts, widths, ends, features


@njit(cache=True)
def _shape(x, y, mx, my, width, row):  # type: ignore[no-untyped-def]
    """Columns 3 to 9 of a cluster's row: its depth, flatness, bulge, circle, roughness and length."""
    n, away = len(x), math.sqrt(mx * mx + my * my)
    # Along and across the line of sight.
    ux, uy = mx / away, my / away
    near, far, middle = math.inf, 0.0, 0.0
    length, rough = 0.0, 0.0
    for i in range(n):
        along = x[i] * ux + y[i] * uy
        near, far = min(near, along), max(far, along)
        if i > 0:
            length += math.hypot(x[i] - x[i - 1], y[i] - y[i - 1])
    row[3] = far - near
    xx, xy, yy = 0.0, 0.0, 0.0
    for i in range(n):
        xx += (x[i] - mx) ** 2 / n
        xy += (x[i] - mx) * (y[i] - my) / n
        yy += (y[i] - my) ** 2 / n
    half = math.hypot(0.5 * (xx - yy), xy)
    big, small = 0.5 * (xx + yy) + half, max(0.5 * (xx + yy) - half, 0.0)
    row[4] = math.sqrt(small / max(big, 1e-8))
    # How far the middle stands out of the chord towards the sensor, in widths.
    if n >= 3 and width > 1e-3:
        ends_along = 0.5 * ((x[0] + x[n - 1]) * ux + (y[0] + y[n - 1]) * uy)
        for i in range(1, n - 1):
            middle += x[i] * ux + y[i] * uy
        row[5] = (ends_along - middle / (n - 2)) / width
    row[6], row[7] = _circle(x, y)
    if n >= 3:
        for i in range(1, n - 1):
            bx, by = x[i] - 0.5 * (x[i - 1] + x[i + 1]), y[i] - 0.5 * (y[i - 1] + y[i + 1])
            rough += math.hypot(bx, by) / (n - 2)
    row[8] = rough
    row[9] = length / max(width, 0.01)


@njit(cache=True)
def _circle(x, y):  # type: ignore[no-untyped-def]
    """Least-squares circle through points: radius, at most 1 m, and root mean square distance off it."""
    n = len(x)
    if n < 4:
        return 0.0, 0.0
    mx, my = x.mean(), y.mean()
    suu, suv, svv, suz, svz = 0.0, 0.0, 0.0, 0.0, 0.0
    mz = 0.0
    for i in range(n):
        u, v = x[i] - mx, y[i] - my
        z = u * u + v * v
        mz += z / n
        suu += u * u
        suv += u * v
        svv += v * v
        suz += u * z
        svz += v * z
    determinant = suu * svv - suv * suv
    if determinant < 1e-12:
        return 1.0, math.sqrt(max(0.0, min(suu, svv)) / n)
    a = 0.5 * (suz * svv - svz * suv) / determinant
    b = 0.5 * (svz * suu - suz * suv) / determinant
    radius = math.sqrt(a * a + b * b + mz)
    error = 0.0
    for i in range(n):
        error += (math.hypot(x[i] - mx - a, y[i] - my - b) - radius) ** 2 / n
    return min(radius, 1.0), math.sqrt(error)


@njit(cache=True)
def _context(centres, widths, features):  # type: ignore[no-untyped-def]
    """Fills in what is near: the closest other slim cluster, looked for from each to both sides along x."""
    order = np.argsort(centres[:, 0])
    for place in range(len(order)):
        k = order[place]
        partner, partner_width = FAR, 0.0
        for side in (-1, 1):
            other = place + side
            while 0 <= other < len(order) and abs(centres[order[other], 0] - centres[k, 0]) < partner:
                j = order[other]
                gap = math.hypot(centres[j, 0] - centres[k, 0], centres[j, 1] - centres[k, 1])
                if widths[j] < 0.45 and gap < partner:
                    partner, partner_width = gap, widths[j]
                other += side
        features[k, 14], features[k, 15] = partner, partner_width
