"""What a wider model knows of a place beside the text's features: a short vector that turning does not change.

`PlaceFeatures.signature` is (SCAN_SIZE,) with an outline: quantiles of the logarithmic range, then of the outline how
its points are apart from each other, how far they are from the robot, how much of each ring around it is free, and its
spectrum. Pairs are compared by absolute differences. Linear histograms of ranges are nearly empty indoors; in
logarithms a room and a hall fill them alike. The spectrum, the magnitude of the Fourier transform of the points in
polar coordinates, does not change when the robot stands a little elsewhere; mean and deviation over all directions are
left of it, so that it does not change when the robot turns either.
"""

from __future__ import annotations

import math
from functools import cache

import numba
import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from loop_closure.places.outline_kernels import CELL, CELLS, RADIUS
from loop_closure.places.outlines import Outline

QUANTILES = 24
SPACINGS, RINGS = 24, 16
WAVES, DIRECTIONS = 14, 36
OUTLINE_SIZE = SPACINGS + 2 * RINGS + 2 * WAVES
SCAN_SIZE = QUANTILES + OUTLINE_SIZE
# Points that enter the distances between points: a sample, these are the square of as many.
_SAMPLED = 160
# Distances between points from 0.4 to 32 m, and rings up to RADIUS, both by equal factors.
_NEAREST, _FURTHEST = 0.4, 2.0 * RADIUS
_LEAST_RING = 0.5
# Points of the spectrum within 12 m, fading towards it; wave lengths from 14 to 0.7 m.
_SPECTRUM_RADIUS, _SPECTRUM_CELLS = 12.0, 96


def range_quantiles(counts: FloatArray, width: float) -> FloatArray:
    """Quantiles of log range (QUANTILES,) of a histogram of ranges (B,) in bins of `width` metres.

    Within a bin ranges are taken to be spread evenly.
    """
    total = counts.sum()
    if total == 0.0:
        return np.zeros(QUANTILES)
    below = np.concatenate(([0.0], np.cumsum(counts)))
    wanted = total * (np.arange(QUANTILES) + 0.5) / QUANTILES
    edges = width * np.arange(len(below))
    return np.asarray(np.log(np.maximum(np.interp(wanted, below, edges), width)))


def outline_signature(outline: Outline) -> FloatArray:
    """The part of the signature that an outline gives, (OUTLINE_SIZE,); shares, cumulated from near to far."""
    shares = _outline_signature(outline.points, outline.free, *_ring_table())
    magnitudes = np.sqrt(spectrum(outline.points, *_waves()))
    return np.concatenate((shares, magnitudes.mean(axis=0), magnitudes.std(axis=0)))


@cache
def _waves() -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Cosine and sine of the DIRECTIONS, (36,) each, and of the WAVES at all cells of a projection, (14, 96) each."""
    angles = np.arange(DIRECTIONS) * np.pi / DIRECTIONS
    width = 2.0 * _SPECTRUM_RADIUS / _SPECTRUM_CELLS
    cells = (np.arange(_SPECTRUM_CELLS) + 0.5) * width - _SPECTRUM_RADIUS
    phases = 2.0 * np.pi / np.geomspace(14.0, 0.7, WAVES)[:, None] * cells
    return np.cos(angles), np.sin(angles), np.cos(phases), np.sin(phases)


@numba.njit(cache=True, fastmath=True)
def spectrum(points, cosines, sines, wave_cosines, wave_sines):  # type: ignore[no-untyped-def]
    """Magnitudes (DIRECTIONS, WAVES) of the transform of points (K, 2), 1 at wave number 0.

    By the projection-slice theorem: project on each direction, transform the one-dimensional histogram.
    """
    waves, cells = wave_cosines.shape
    out = np.zeros((len(cosines), waves))
    counts = np.empty(cells)
    scale = 0.5 * cells / _SPECTRUM_RADIUS
    for a in range(len(cosines)):
        counts[:] = 0.0
        total = 0.0
        for p in range(len(points)):
            x, y = points[p, 0], points[p, 1]
            fade = 1.0 - (x * x + y * y) / _SPECTRUM_RADIUS**2
            if fade > 0.0:
                cell = int((x * cosines[a] + y * sines[a] + _SPECTRUM_RADIUS) * scale)
                counts[min(max(cell, 0), cells - 1)] += fade
                total += fade
        if total == 0.0:
            continue
        for k in range(waves):
            c, s = 0.0, 0.0
            for b in range(cells):
                c += counts[b] * wave_cosines[k, b]
                s += counts[b] * wave_sines[k, b]
            out[a, k] = math.sqrt(c * c + s * s) / total
    return out


@cache
def _ring_table() -> tuple[npt.NDArray[np.int8], npt.NDArray[np.int64]]:
    """Ring of every cell (CELLS²,), -1 outside, and cells per ring; made once."""
    centre = (np.arange(CELLS) + 0.5) * CELL - RADIUS
    distance = np.hypot(centre[:, None], centre[None, :]).ravel()
    inside = np.log(np.maximum(distance, _LEAST_RING) / _LEAST_RING) / math.log(RADIUS / _LEAST_RING)
    ring = np.floor(RINGS * inside)
    ring = np.where(distance < RADIUS, np.minimum(ring, RINGS - 1), -1).astype(np.int8)
    return ring, np.bincount(ring[ring >= 0], minlength=RINGS).astype(np.int64)


@numba.njit(cache=True)
def _outline_signature(points, free, ring, cells):  # type: ignore[no-untyped-def]
    out = np.zeros(SPACINGS + 2 * RINGS)
    count = min(len(points), _SAMPLED)
    scale = SPACINGS / math.log(_FURTHEST / _NEAREST)
    for i in range(count):
        for j in range(i):
            dx, dy = points[i, 0] - points[j, 0], points[i, 1] - points[j, 1]
            apart = math.sqrt(dx * dx + dy * dy)
            k = int(scale * math.log(max(apart, _NEAREST) / _NEAREST))
            out[min(max(k, 0), SPACINGS - 1)] += 1.0
    scale = RINGS / math.log(RADIUS / _LEAST_RING)
    for i in range(len(points)):
        distance = math.sqrt(points[i, 0] ** 2 + points[i, 1] ** 2)
        k = int(scale * math.log(max(distance, _LEAST_RING) / _LEAST_RING))
        out[SPACINGS + min(max(k, 0), RINGS - 1)] += 1.0
    for part in range(2):
        first = 0 if part == 0 else SPACINGS
        last = SPACINGS if part == 0 else SPACINGS + RINGS
        for k in range(first + 1, last):
            out[k] += out[k - 1]
        total = max(out[last - 1], 1.0)
        # The last cumulated share is 1: in its place, how many there are.
        for k in range(first, last):
            out[k] /= total
        out[last - 1] = 0.2 * math.log(1.0 + (len(points) if part == 1 else count))
    for k in range(len(ring)):
        if ring[k] >= 0 and (free[k >> 3] >> (7 - (k & 7))) & 1:
            out[SPACINGS + RINGS + ring[k]] += 1.0
    for k in range(RINGS):
        out[SPACINGS + RINGS + k] /= max(cells[k], 1)
    return out
