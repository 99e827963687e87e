"""Registration by histograms (Bosse and Zlot; Paper A section 4.3): where a scan may lie on another, without a guess.

Which way surfaces face, weighted by their length, is one histogram per scan. A turn of the sensor shifts it: the
peaks of a circular correlation are the turns that may be. Turned so, what faces one way is projected on that way; a
motion shifts the projection. Two ways that most outline faces give the translation.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter1d

from estimation.checks import FloatArray
from estimation.geometry.poses import wrap_angle
from registration.laser.submap import CELL
from registration.laser.surface import Surface

BINS = 360  # of a full turn
BLUR = 1.5  # bins that normals waver by
SMEAR = 1.0  # bins of a projection that points waver by; they are of CELL metres
TURNS, SHIFTS = 8, 4  # peaks that are followed
APART = 5  # bins between two peaks of turns
CELLS = 301  # of a projection: 15 m to either side


def orientations(surface: Surface) -> FloatArray:
    """(BINS,) metres of outline by the way its normals point, from -π; both ways where it is not known which."""
    lined = surface.lined
    histogram = np.zeros(BINS)
    for sign in (1.0,) if surface.signed else (1.0, -1.0):
        normals = sign * surface.normals[lined]
        angle = np.arctan2(normals[:, 1], normals[:, 0])
        bins = np.round((angle + np.pi) * BINS / (2.0 * np.pi)).astype(np.int64) % BINS
        histogram += np.bincount(bins, surface.length[lined], BINS)
    return np.asarray(gaussian_filter1d(histogram, BLUR, mode="wrap"))


def turns(source: FloatArray, target: FloatArray) -> FloatArray:
    """(k,) radians by which `source` (BINS,) has to be turned to be most alike `target` (BINS,), best first."""
    alike = np.fft.irfft(np.conj(np.fft.rfft(source)) * np.fft.rfft(target), BINS)
    peaks = _peaks(alike, TURNS, APART)
    return np.asarray(wrap_angle(peaks * 2.0 * np.pi / BINS))


def facing(histogram: FloatArray) -> FloatArray:
    """Unit vectors (2, 2): the way most outline faces or turns its back on, and that which most of the rest does."""
    half = histogram[: BINS // 2] + histogram[BINS // 2 :]
    angle = np.arange(BINS // 2) * 2.0 * np.pi / BINS
    first = angle[np.argmax(half)]
    second = angle[np.argmax(half * np.sin(angle - first) ** 2)]
    return np.array([[np.cos(each), np.sin(each)] for each in (first, second)])


def shifts(source: Surface, target: Surface, turn: float, way: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(k,) metres along `way` (2,) that may lay `source`, turned, on `target`, best first, and their correlations."""
    alike = np.zeros(2 * CELLS)
    for sign in (1.0, -1.0):
        here = np.fft.rfft(profile(source, turn, way, sign), 2 * CELLS)
        there = np.fft.rfft(profile(target, 0.0, way, sign), 2 * CELLS)
        alike += np.fft.irfft(np.conj(here) * there, 2 * CELLS)
    alike = np.roll(alike, CELLS)
    peaks = _peaks(alike, SHIFTS, 2)
    return (peaks - CELLS) * CELL, alike[np.round(peaks).astype(np.int64)]


def profile(surface: Surface, turn: float, way: FloatArray, sign: float) -> FloatArray:
    """(CELLS,) outline of a turned surface that faces `way` (2,), or away from it, by its place along it."""
    c, s = np.cos(turn), np.sin(turn)
    own = np.array([c * way[0] + s * way[1], c * way[1] - s * way[0]])
    along, cosine = surface.points @ own, surface.normals @ own
    faced = np.abs(cosine) if not surface.signed else np.maximum(sign * cosine, 0.0)
    bins = np.round(along / CELL).astype(np.int64) + CELLS // 2
    inside = (bins >= 0) & (bins < CELLS)
    along_it = np.bincount(bins[inside], (surface.length * faced**4)[inside], CELLS)
    return np.asarray(gaussian_filter1d(along_it, SMEAR))


def _peaks(values: FloatArray, most: int, apart: int) -> FloatArray:
    """(k,) places of the highest maxima of a circle of values, on parabolas through their neighbours, highest first."""
    around = np.stack([np.roll(values, shift) for shift in range(-apart, apart + 1)])
    tops = np.flatnonzero((values >= around.max(axis=0)) & (values > 0.0))
    tops = tops[np.argsort(-values[tops], kind="stable")][:most]
    left, middle, right = values[tops - 1], values[tops], values[(tops + 1) % len(values)]
    bend = np.minimum(left - 2.0 * middle + right, -1e-12)
    return np.asarray(tops + np.clip(0.5 * (left - right) / bend, -0.5, 0.5))


def histogram_candidates(source: Surface, target: Surface, most: int) -> NDArray[np.float64]:
    """Motions (k, 3) that may lay `source` on `target`, most alike first."""
    if not (source.lined.any() and target.lined.any()):
        return np.zeros((0, 3))
    wanted = orientations(target)
    ways = facing(wanted)
    if abs(np.linalg.det(ways)) < 0.1:
        ways[1] = [-ways[0, 1], ways[0, 0]]
    found = []
    for turn in turns(orientations(source), wanted):
        (first, one), (second, other) = (shifts(source, target, turn, way) for way in ways)
        for i, j in np.ndindex(len(first), len(second)):
            found.append((one[i] * other[j], *np.linalg.solve(ways, [first[i], second[j]]), turn))
    ranked = np.array(sorted(found, reverse=True)).reshape(-1, 4)
    return ranked[:most, 1:]
