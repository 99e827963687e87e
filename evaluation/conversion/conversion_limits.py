"""Figure 6.8: at which angular noise converted measurements stop passing for Gaussian, and which measure knows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from estimation.checks import FloatArray
from estimation.conversion.polar import absolute_bias, bias_significance, condition_ratio, mardia_test

K_CRIT = 1.075
SETS, SET_SIZE, FAILURES = 100, 250, 25
STEP, LARGEST = np.radians(0.2), np.radians(15.0)

# 10 × 9 × 9 = 810 operating points: objects up to 10 m away all around, range noise of laser range finders.
RANGES = np.arange(1.0, 10.5, 1.0)
SIGMA_RANGES = np.linspace(0.01, 0.05, 9)
BEARINGS = np.radians(np.arange(-160.0, 170.0, 40.0))


@dataclass(frozen=True)
class Limit:
    """One operating point: the largest admissible σ_θ by Mardia's test and by K, rad, NaN where none is."""

    measured: float
    by_ratio: float
    by_polar_ratio: float
    ratio: float
    bias: float
    significance: float


def failures(
    r: float, bearing: float, sr: float, st: float, position: float, rng: np.random.Generator
) -> int:
    """How many of 100 sets of 250 converted measurements fail Mardia's test."""
    ranges = r + sr * rng.standard_normal((SETS, SET_SIZE))
    angles = bearing + st * rng.standard_normal((SETS, SET_SIZE))
    points = np.stack([ranges * np.cos(angles), ranges * np.sin(angles)], -1)
    if position > 0:
        points = points + position * rng.standard_normal(points.shape)
    return sum(not mardia_test(p) for p in points)


def predicted(r: float, sr: float, position: float) -> float:
    """σ_θ, rad, at which K reaches `K_CRIT`; `LARGEST` where it does not up to there, NaN where it always is."""
    covariance = position**2 * np.eye(2) if position > 0 else None

    def excess(st: float) -> float:
        return float(condition_ratio(r, 0.0, sr, st, covariance)) - K_CRIT

    low = np.radians(0.01)
    if excess(low) > 0:
        return float("nan")
    return LARGEST if excess(LARGEST) < 0 else float(brentq(excess, low, LARGEST))


def find_limit(r: float, bearing: float, sr: float, position: float, seed: int) -> Limit:
    """Raise σ_θ in steps of 0.2° until a quarter of the sets fails; the limit is half a step before that."""
    rng = np.random.default_rng(seed)
    steps = np.arange(STEP, LARGEST + STEP / 2, STEP)
    measured = LARGEST
    for st in steps:
        if failures(r, bearing, sr, st, position, rng) >= FAILURES:
            measured = float(st - STEP / 2) if st > steps[0] else float("nan")
            break
    at = measured if np.isfinite(measured) else STEP
    covariance = position**2 * np.eye(2) if position > 0 else None
    return Limit(
        measured,
        predicted(r, sr, position),
        predicted(r, sr, 0.0),
        float(condition_ratio(r, bearing, sr, at, covariance)),
        float(absolute_bias(r, bearing, sr, at)),
        float(bias_significance(r, bearing, sr, at)),
    )


def operating_points() -> list[tuple[float, float, float]]:
    """The 810 (range, bearing, σ_r)."""
    return [(float(r), float(b), float(s)) for r in RANGES for s in SIGMA_RANGES for b in BEARINGS]


def within(limits: list[Limit], degrees: float) -> float:
    """Share of operating points whose limit is predicted within so many degrees."""
    error = np.degrees([abs(x.by_ratio - x.measured) for x in limits])
    return float(np.mean(error <= degrees))


def best_fixed_angle(limits: list[Limit], degrees: float) -> float:
    """Share within so many degrees of the one angle that serves most operating points."""
    measured = np.degrees([x.measured for x in limits])
    candidates = np.arange(0.1, 15.0, 0.1)
    return float(np.max(np.mean(np.abs(measured[None] - candidates[:, None]) <= degrees, axis=1)))


def normalised(limits: list[Limit]) -> dict[str, FloatArray]:
    """Critical values of the four candidates over their mean, the boxes of Figure 6.8."""
    values = {
        "largest angle": np.array([x.measured for x in limits]),
        "absolute bias": np.array([x.bias for x in limits]),
        "bias significance": np.array([x.significance for x in limits]),
        "condition ratio K": np.array([x.ratio for x in limits]),
    }
    return {name: v / np.nanmean(v) for name, v in values.items()}
