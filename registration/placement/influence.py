"""What the answer owes to single pieces of outline: leave out one small piece at a time, and look.

A person or a box that walked is, in one pair of scans, an outline like any other. Where walls leave a direction
open, such a piece alone may fill it, with a motion that is its own. Least squares does not notice: the piece fits
perfectly. So each connected piece small enough to be carried about is left out in turn, with the small ones about it;
a direction that is then open, or an answer that then moves away, was their word only, and the covariance says so.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from registration.laser.surface import Surface
from registration.laser.target_lines import TargetLines
from registration.placement.refine import ARM, TUKEY, Refined, determined, off_line, quadratic

SMALL = 2.0  # metres of connected outline that something that moves may have
BODY = 0.5  # metres between the middles of small pieces that may be of one body, as two legs are
LEAST_SHARE = 0.2  # share of some direction's information below which a piece cannot matter
GROWTH = 8.0  # times the stated variance that leaving a piece out has to add for the answer to hang on it


@njit(cache=True)
def _shares(  # type: ignore[no-untyped-def]
    points, pieces, others, from_source, matched, trust, pose, target, normals, tilt, width
):
    """Information, its share from noise of the normals, and gradient of each piece; yaw in units of metres by `ARM`."""
    count = (pieces.max() if from_source else others.max()) + 1
    H, slack, g = np.zeros((count, 3, 3)), np.zeros((count, 3, 3)), np.zeros((count, 3))
    c, s = math.cos(pose[2]), math.sin(pose[2])
    J, T = np.empty(3), np.empty(3)
    for k in range(len(points)):
        m = matched[k]
        if m < 0:
            continue
        r, u, rx, ry, nx, ny = off_line(points[k, 0], points[k, 1], c, s, pose, target[m], normals[m], width)
        if u >= 1.0:
            continue
        w = trust[k] * (1.0 - u) * (1.0 - u)
        J[0], J[1], J[2] = nx, ny, (ny * rx - nx * ry) / ARM
        T[0], T[1], T[2] = -ny, nx, (nx * rx + ny * ry) / ARM
        p = pieces[k] if from_source else others[m]
        for a in range(3):
            g[p, a] += w * r * J[a]
            for b in range(3):
                H[p, a, b] += w * J[a] * J[b]
                slack[p, a, b] += w * tilt[m] * T[a] * T[b]
    return H, slack, g


@njit(cache=True)
def _carried(points, pieces, length, count):  # type: ignore[no-untyped-def]
    """Of each piece: whether it is small enough to be carried about, and the middle (2,) of its points."""
    extent, number, middles = np.zeros(count), np.zeros(count), np.zeros((count, 2))
    for k in range(len(points)):
        extent[pieces[k]] += length[k]
        number[pieces[k]] += 1.0
        middles[pieces[k]] += points[k]
    return extent < SMALL, middles / number.reshape(-1, 1)


@njit(cache=True)
def _variance(H, slack, variance, prior):  # type: ignore[no-untyped-def]
    """Covariance (3, 3) of what `H` determines, with the variance `prior` for what it leaves open."""
    values, vectors, closed = determined(H, slack, variance)
    covariance = np.zeros((3, 3))
    for a in range(3):
        spread = 1.0 / (values[a] + 1.0 / prior) if closed[a] else prior
        for b in range(3):
            for d in range(3):
                covariance[b, d] += spread * vectors[b, a] * vectors[d, a]
    return covariance


@njit(cache=True)
def _more(rest, whole):  # type: ignore[no-untyped-def]
    """What `rest` (3, 3) is uncertain of beyond `whole`, positive semi-definite.

    The two leave open directions that differ by milliradians: across, their plain difference is negative.
    """
    values, vectors = np.linalg.eigh(rest - whole)
    return (vectors * np.maximum(values, 0.0)) @ vectors.T


@njit(cache=True)
def _worst(H, slack, g, small, middles, variance, prior, added):  # type: ignore[no-untyped-def]
    """Write what the body the answer hangs on most adds to the covariance, if more than `added` (3, 3) has.

    A body is a small piece with the small pieces about it.
    """
    total, noise, pull = H.sum(axis=0), slack.sum(axis=0), g.sum(axis=0)
    values, vectors = np.linalg.eigh(total)
    along = np.empty((len(H), 3))  # share of each piece in what is known along each direction
    for p in range(len(H)):
        for a in range(3):
            along[p, a] = quadratic(H[p], vectors, a) / max(values[a], 1e-9)
    whole = _variance(total, noise, variance, prior)
    others, blur, force = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    body, share = np.empty(len(H), np.bool_), np.empty(3)
    for p in range(len(H)):
        if not small[p]:
            continue
        share[:] = 0.0
        for q in range(len(H)):
            away = (middles[p, 0] - middles[q, 0]) ** 2 + (middles[p, 1] - middles[q, 1]) ** 2
            body[q] = small[q] and (q == p or away < BODY**2)
            if body[q]:
                for a in range(3):
                    share[a] += along[q, a]
        if share.max() < LEAST_SHARE:
            continue
        others[:], blur[:], force[:] = total, noise, pull
        for q in range(len(H)):
            if body[q]:
                others -= H[q]
                blur -= slack[q]
                force -= g[q]
        rest = _variance(others, blur, variance, prior)
        shift = -rest @ force / variance
        # What is not known can be anywhere within the doubt, not farther.
        shift *= min(1.0, math.sqrt(prior) / max(math.sqrt(shift @ shift), 1e-9))
        doubt = _more(rest, whole)
        for a in range(3):
            for b in range(3):
                doubt[a, b] += shift[a] * shift[b]
        grown = 0.0
        for a in range(3):
            grown = max(grown, quadratic(doubt, vectors, a) / quadratic(whole, vectors, a))
        if grown > GROWTH and np.trace(doubt) > np.trace(added):
            added[:] = doubt


def borrowed(
    refined: Refined, source: Surface, target: TargetLines, noise: float, prior: float, *others: Surface
) -> FloatArray:
    """Covariance (3, 3) of x, y, yaw to add because the answer hangs on one small piece; zero where it does not.

    Positive semi-definite, so that what it is added to stays a covariance.

    noise : metres, that the kernel of `refine` ended with. prior : m², variance of what nothing determines.
    others : the target's own surface, where its pieces count as well; a map's lines have none.
    """
    if refined.open_directions == 3 or not len(source):
        return np.zeros((3, 3))
    added = np.zeros((3, 3))
    for surface in (source, *others):
        H, slack, g = _shares(
            source.points, source.pieces, surface.pieces, surface is source, refined.matched, refined.trust,
            refined.pose, target.points, target.normals, target.tilt, TUKEY * noise,
        )  # fmt: skip
        small, middles = _carried(surface.points, surface.pieces, surface.length, len(H))
        _worst(H, slack, g, small, middles, refined.noise**2, prior, added)
    scale = np.array([1.0, 1.0, 1.0 / ARM])
    return np.asarray(added * np.outer(scale, scale))
