"""How far the estimate of a registration scatters, read off its residuals.

Least squares believes that every residual is as noisy as the next and independent of it. Neither holds: next to
corners and on slow movers residuals lean the same way over half a metre, and far along a wall they are small. So the
scores of stretches of outline are added up before they are squared (a sandwich estimate, clustered by stretch), and
what the model says steadies the few stretches there are.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from estimation.checks import FloatArray
from registration.laser.surface import Surface
from registration.placement.refine import ARM, EFFICIENCY, TUKEY, Refined, off_line

STRETCH = 0.6  # metres of outline whose residuals may lean together: two neighbourhoods of a line
GAP = 0.5  # metres without outline after which another stretch begins
BELIEF = 0.75  # share of what the residuals say; the rest is the model's: by them alone NEES rises


@njit(cache=True)
def _scores(points, pieces, matched, trust, pose, target, normals, width):  # type: ignore[no-untyped-def]
    """Sum of squared scores of stretches (3, 3), how many there are, and weight over curvature of the kernel."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    total, score, jacobian = np.zeros((3, 3)), np.zeros(3), np.empty(3)
    stretches, length, last = 0, 0.0, -1
    weights = curvature = 0.0
    for k in range(len(points)):
        m = matched[k]
        if m < 0:
            continue
        gap = 0.0
        if last >= 0:
            gap = math.hypot(points[k, 0] - points[last, 0], points[k, 1] - points[last, 1])
        length += gap
        if last < 0 or pieces[k] != pieces[last] or gap > GAP or length > STRETCH:
            for a in range(3):
                for b in range(3):
                    total[a, b] += score[a] * score[b]
            score[:] = 0.0
            stretches, length = stretches + 1, 0.0
        last = k
        r, u, rx, ry, nx, ny = off_line(points[k, 0], points[k, 1], c, s, pose, target[m], normals[m], width)
        if u >= 1.0:
            continue
        w = trust[k] * (1.0 - u) * (1.0 - u)
        weights += w
        curvature += trust[k] * (1.0 - u) * (1.0 - 5.0 * u)
        jacobian[0], jacobian[1], jacobian[2] = nx, ny, ny * rx - nx * ry
        for a in range(3):
            score[a] += w * r * jacobian[a]
    for a in range(3):
        for b in range(3):
            total[a, b] += score[a] * score[b]
    return total, stretches, weights / max(curvature, 0.3 * weights) if weights > 0.0 else 1.0


def scattered_information(refined: Refined, source: Surface, target: Surface, noise: float) -> FloatArray:
    """Information (3, 3) of x, y, yaw of `refined.pose`, zero along its open directions.

    noise : metres, that the kernel of `refine` ended with.
    """
    # The model: residuals show the source's noise and the little that smoothing left of the target's, but errors of
    # the smoothed target are shared between neighbours and weigh as much as the source's own.
    model = refined.information * 2.0 / (1.0 + target.leverage) * EFFICIENCY
    total, stretches, sharpness = _scores(
        source.points, source.pieces, refined.matched, refined.trust, refined.pose, target.feet, target.normals,
        TUKEY * noise,
    )  # fmt: skip
    # Three go into the pose; two more because the inverse of a variance read off few stretches is too large on average.
    middle, spare = model, stretches - 5
    if spare > 0:
        seen = total * sharpness**2 * (stretches / spare) / refined.noise**4
        middle = BELIEF * seen + (1.0 - BELIEF) * model
    return _sandwich(refined.information, middle, refined.open_directions)


def _sandwich(outer: FloatArray, middle: FloatArray, opened: int) -> FloatArray:
    """outer · middle⁻¹ · outer in the directions `outer` (3, 3) determines, all but `opened` of them."""
    scale = np.array([1.0, 1.0, 1.0 / ARM])
    _, vectors = np.linalg.eigh(outer * np.outer(scale, scale))
    closed = vectors[:, opened:] * scale[:, None]
    bread = closed.T @ outer @ closed
    inner = bread @ np.linalg.solve(closed.T @ middle @ closed, bread)
    back = vectors[:, opened:] / scale[:, None]
    return np.asarray(back @ inner @ back.T)
