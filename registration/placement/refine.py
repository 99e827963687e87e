"""Point-to-line registration from a close guess: robust, and right about what it leaves open.

Iteratively reweighted Gauss-Newton. The kernel narrows from the initial doubt to the noise the residuals
themselves show, and ends as Tukey's biweight. Normals are noisy, so even a bare corridor seems to say a little
about motion along it; that much is subtracted (`slack`), and a direction that is left with nothing is not
estimated but kept from the guess. And a point beside its line's foot is off by what turns the line: the noisier the
line's direction, the less its points weigh, the more so the more of them share it (`trust`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray
from registration.laser.surface import Surface
from registration.laser.target_lines import TargetLines, nearest

TUKEY = 4.685  # 95 % efficiency at the normal distribution
KERNEL = 0.012  # metres, noise the kernel narrows to
LEAST_SPREAD = 0.002  # metres; residuals of a scan on itself are nothing, its noise is not
FINEST = 0.15  # metres, correspondences are looked for at least this far
ARM = 3.0  # metres, what a radian is worth in a room
FLOOR = 4.0  # information (1/m²) below which a direction is open whatever the normals' noise
AGREE = 0.6  # cosine between normals that may correspond
NO_PRIOR = np.zeros(3), np.zeros((3, 3))
EFFICIENCY = 0.963  # variance of the estimate under Tukey's weights, in units of the inverse information's


@dataclass(frozen=True)
class Refined:
    """Outcome of `refine`.

    pose : (3,) of the source in the target frame. information : (3, 3) of x, y, yaw of `pose`, without the prior,
    with open directions at zero. open_directions : how many of the three. noise : standard deviation of matched
    points off their lines, metres. matched : (N,) index of the target point of each source point, or -1. trust : (N,)
    what is left of the weight of each as the direction of its line is noisy.
    """

    pose: FloatArray
    information: FloatArray
    open_directions: int
    noise: float
    matched: NDArray[np.int64]
    trust: FloatArray
    settled: bool


@njit(cache=True)
def _match(  # type: ignore[no-untyped-def]
    points, normals, usable, pose, radius, spacing, target, target_normals, heads, following, signed, matched
):
    """Write the index of each point's nearest target line, or -1."""
    c, s = math.cos(pose[2]), math.sin(pose[2])
    for k in range(len(points)):
        matched[k] = -1
        if usable[k]:
            x = pose[0] + c * points[k, 0] - s * points[k, 1]
            y = pose[1] + s * points[k, 0] + c * points[k, 1]
            nx = c * normals[k, 0] - s * normals[k, 1]
            ny = s * normals[k, 0] + c * normals[k, 1]
            reach = max(radius, min(0.8 * spacing[k], 0.5))
            matched[k] = nearest(x, y, nx, ny, reach, AGREE, signed, target, target_normals, heads, following)


@njit(cache=True, inline="always")
def off_line(x, y, c, s, pose, foot, normal, width):  # type: ignore[no-untyped-def]
    """Distance r of a point at `pose` off its line, (r / width)², the point turned by (c, s), the line's normal."""
    rx, ry = c * x - s * y, s * x + c * y
    r = normal[0] * (rx + pose[0] - foot[0]) + normal[1] * (ry + pose[1] - foot[1])
    return r, (r / width) ** 2, rx, ry, normal[0], normal[1]


@njit(cache=True)
def _count(matched, crowd):  # type: ignore[no-untyped-def]
    """Write how many points share each target line."""
    for m in matched:
        if m >= 0:
            crowd[m] = 0
    for m in matched:
        if m >= 0:
            crowd[m] += 1


@njit(cache=True)
def _normal_equations(  # type: ignore[no-untyped-def]
    points, pose, target, target_normals, target_tilt, matched, width, robust_start, variance, crowd, trust
):
    """Information, its share that is only noise of the normals, gradient, weight and squares; per unit variance.

    And how many points are matched. Writes the `trust` of each.
    """
    c, s = math.cos(pose[2]), math.sin(pose[2])
    H, slack, g = np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(3)
    total = squares = 0.0
    count = 0
    J, T = np.empty(3), np.empty(3)
    for k in range(len(points)):
        m = matched[k]
        if m < 0:
            continue
        count += 1
        nx, ny = target_normals[m, 0], target_normals[m, 1]
        x = pose[0] + c * points[k, 0] - s * points[k, 1] - target[m, 0]
        y = pose[1] + s * points[k, 0] + c * points[k, 1] - target[m, 1]
        r = nx * x + ny * y
        u = (r / width) * (r / width)
        w = 0.0
        if robust_start:
            w = 1.0 / ((1.0 + u) * (1.0 + u))
        elif u < 1.0:
            w = (1.0 - u) * (1.0 - u)
        if w == 0.0:
            continue
        v, beside = target_tilt[m], nx * y - ny * x
        trust[k] = 1.0 / (1.0 + crowd[m] * v * beside * beside / variance)
        w *= trust[k]
        rx, ry = c * points[k, 0] - s * points[k, 1], s * points[k, 0] + c * points[k, 1]
        J[0], J[1], J[2] = nx, ny, nx * -ry + ny * rx
        T[0], T[1], T[2] = -ny, nx, -ny * -ry + nx * rx
        for a in range(3):
            g[a] += w * r * J[a]
            for b in range(3):
                H[a, b] += w * J[a] * J[b]
                slack[a, b] += w * v * T[a] * T[b]
        total += w
        squares += w * r * r
    return H, slack, g, total, squares, count


@njit(cache=True)
def quadratic(M, vectors, a):  # type: ignore[no-untyped-def]
    """`v @ M @ v` of column `a` of `vectors`, in scalars: a library call takes longer than nine products."""
    value = 0.0
    for b in range(3):
        for d in range(3):
            value += vectors[b, a] * M[b, d] * vectors[d, a]
    return value


@njit(cache=True)
def _scaled(M, by):  # type: ignore[no-untyped-def]
    """A matrix (3, 3) of x, y, yaw, yaw in units of `by` metres."""
    out = M.copy()
    for a in range(3):
        out[a, 2] /= by
        out[2, a] /= by
    return out


@njit(cache=True)
def determined(H, slack, variance):  # type: ignore[no-untyped-def]
    """Values and vectors of the debiased information, in units of metres, and which directions lines determine."""
    values, vectors = np.linalg.eigh((H - slack) / variance)
    closed = np.zeros(3, dtype=np.bool_)
    for a in range(3):
        closed[a] = values[a] > max(FLOOR, 2.0 * quadratic(slack, vectors, a) / variance)
    return values, vectors, closed


@njit(cache=True)
def _newton(H, slack, g, variance, arm, information, step):  # type: ignore[no-untyped-def]
    """Step in the directions the lines determine; writes information and step, returns how many stay open."""
    values, vectors, closed = determined(_scaled(H, arm), _scaled(slack, arm), variance)
    information[:, :] = 0.0
    step[:] = 0.0
    opened = 0
    for a in range(3):
        if not closed[a]:
            opened += 1
            continue
        along = vectors[0, a] * g[0] + vectors[1, a] * g[1] + vectors[2, a] * g[2] / arm
        along /= variance * values[a]
        for b in range(3):
            step[b] -= along * vectors[b, a]
            for d in range(3):
                information[b, d] += values[a] * vectors[b, a] * vectors[d, a]
    for b in range(3):
        information[b, 2] *= arm
        information[2, b] *= arm
    step[2] /= arm
    return opened


@njit(cache=True)
def _hold(information, step, away, prior):  # type: ignore[no-untyped-def]
    """Write the step that lines and a prior make together; `away` : (3,) of the pose from where it is expected."""
    away[2] = math.atan2(math.sin(away[2]), math.cos(away[2]))
    step[:] = np.linalg.solve(information + prior, information @ step - prior @ away)


@njit(cache=True)
def _spread(square, width):  # type: ignore[no-untyped-def]
    """Standard deviation of normal residuals whose weighted mean square under a kernel of `width` is `square`."""
    variance = square
    for _ in range(3):
        # To first order the biweight takes four times (deviation / width)² off; at 4.685 deviations that is 0.172.
        variance = square / (1.0 - min(3.78 * variance / (width * width), 0.172))
    return math.sqrt(max(variance, LEAST_SPREAD * LEAST_SPREAD))


@njit(cache=True)
def _arm(points):  # type: ignore[no-untyped-def]
    """Mean distance from the sensor, metres: what a radian is worth."""
    total = 0.0
    for k in range(len(points)):
        total += math.hypot(points[k, 0], points[k, 1])
    return max(total / max(len(points), 1), 0.1)


@njit(cache=True)
def _straighten(information, arm, target_normals, target_tilt, matched):  # type: ignore[no-untyped-def]
    """Turn an open direction that is a translation to where the best-known normals leave it open.

    Every line counted alike, the noise of short ones turns the direction by milliradians, and half a metre along
    it becomes an error across that nobody expects.
    """
    _, vectors = np.linalg.eigh(_scaled(information, arm))
    xx = xy = yy = 0.0
    for m in matched:
        if m >= 0:
            weight = 1.0 / target_tilt[m]
            xx += weight * target_normals[m, 0] * target_normals[m, 0]
            xy += weight * target_normals[m, 0] * target_normals[m, 1]
            yy += weight * target_normals[m, 1] * target_normals[m, 1]
    angle = 0.5 * math.atan2(2.0 * xy, xx - yy)
    free = np.array([-math.sin(angle), math.cos(angle), 0.0])
    if abs(free @ vectors[:, 0]) > 0.99:
        keep = np.eye(3) - np.outer(free, free)
        information[:] = keep @ information @ keep


@njit(cache=True)
def _refine(source, lines, signed, guess, doubt, noise, most, prior):  # type: ignore[no-untyped-def]
    """`refine` of arrays: see `_arrays`."""
    points, normals, tilt, spacing = source
    target, target_normals, target_tilt, heads, following = lines
    expected, held = prior
    usable = tilt < math.inf
    matched = np.full(len(points), -1, dtype=np.int64)
    arm = _arm(points)
    pose = guess.copy()
    information, step = np.zeros((3, 3)), np.zeros(3)
    finest_width = TUKEY * noise
    width = max(doubt, finest_width)
    opened, settled = 3, False
    moved = math.inf  # since the last matching
    spread = noise
    crowd, trust = np.empty(len(target), np.int64), np.ones(len(points))
    for turns in range(most):
        final = width <= finest_width
        if not final or moved > 0.002 or turns == 0:
            radius = max(2.0 * width, FINEST)
            _match(
                points, normals, usable, pose, radius, spacing, target, target_normals, heads, following, signed,
                matched,
            )  # fmt: skip
            _count(matched, crowd)
            moved = 0.0
        H, slack, g, total, squares, count = _normal_equations(
            points, pose, target, target_normals, target_tilt, matched, width, not final,
            spread * spread, crowd, trust,
        )  # fmt: skip
        if count < 5 or total <= 0.0:
            opened = 3
            information[:, :] = 0.0
            break
        spread = _spread(squares / total, width)
        opened = _newton(H, slack, g, spread * spread, arm, information, step)
        if held[2, 2] > 0.0:
            _hold(information, step, pose - expected, held)
        for b in range(3):
            pose[b] += step[b]
        change = abs(step[0]) + abs(step[1]) + arm * abs(step[2])
        moved += change
        if final and change < 3e-4:
            settled = True
            break
        if not final:
            width = max(0.6 * width, finest_width)
    if opened == 1:
        _straighten(information, arm, target_normals, target_tilt, matched)
    return pose, information, opened, spread, matched, trust, settled


def _arrays(source: Surface, target: TargetLines) -> tuple[tuple[Any, ...], tuple[Any, ...], bool]:
    """Points to move, lines to move them to, and whether both know which side of a line is seen.

    Plain tuples: a compiled function is called a few microseconds faster with them than with named ones.
    """
    points = source.points, source.normals, source.tilt, source.spacing
    lines = target.points, target.normals, target.tilt, target.heads, target.following
    return points, lines, source.signed and target.signed


def refine(
    source: Surface,
    target: TargetLines,
    guess: FloatArray,
    doubt: float = 0.3,
    noise: float = KERNEL,
    most: int = 40,
    prior: tuple[FloatArray, FloatArray] = NO_PRIOR,
) -> Refined:
    """Move `source` onto the lines of `target` from `guess` (3,) x, y, yaw.

    doubt : metres, how far points may be off at first; the kernel narrows from there to `noise`.
    noise : metres, standard deviation to expect of a point off its line.
    most : iterations.
    prior : pose (3,) that is expected, and its information (3, 3) in the units of `Refined.information`.
    """
    pose, information, opened, spread, matched, trust, settled = _refine(
        *_arrays(source, target), guess, doubt, noise, most, prior
    )
    pose[2] = math.atan2(math.sin(pose[2]), math.cos(pose[2]))
    return Refined(pose, information, opened, spread, matched, trust, settled)


@njit(cache=True)
def _cost(source, lines, signed, pose, width, trust):  # type: ignore[no-untyped-def]
    """Half the squares of points off their lines under the biweight of `width`; points without a line are off."""
    points, normals, tilt, spacing = source
    target, target_normals, _, heads, following = lines
    usable, radius = tilt < math.inf, max(2.0 * width, FINEST)
    matched = np.full(len(points), -1, dtype=np.int64)
    _match(
        points, normals, usable, pose, radius, spacing, target, target_normals, heads, following, signed, matched
    )  # fmt: skip
    c, s = math.cos(pose[2]), math.sin(pose[2])
    total = 0.0
    for k in range(len(points)):
        if usable[k]:
            left = 0.0
            m = matched[k]
            if m >= 0:
                _, u, _, _, _, _ = off_line(
                    points[k, 0], points[k, 1], c, s, pose, target[m], target_normals[m], width
                )
                left = max(1.0 - u, 0.0) ** 3
            total += trust[k] * (1.0 - left)
    return width * width / 6.0 * total


def lead(source: Surface, target: TargetLines, refined: Refined, other: FloatArray, noise: float) -> float:
    """How much likelier, nat a point, lines make `refined` than the pose `other` (3,); noise : as of `refine`."""
    width = TUKEY * noise
    arrays = _arrays(source, target)
    costs = [_cost(*arrays, pose, width, refined.trust) for pose in (other, refined.pose)]
    points = max(int(np.count_nonzero(refined.matched >= 0)), 1)
    return float((costs[0] - costs[1]) / (refined.noise**2 * EFFICIENCY * points))
