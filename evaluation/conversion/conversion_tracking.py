"""Section 6.8.2: a person walks to and fro in front of a robot; three scenarios, the filter in several forms."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from estimation.conversion.switching import ConstantVelocity, SwitchingFilter
from estimation.metrics.statistics import nees
from evaluation.conversion.switching_printed import PrintedSwitchingFilter
from evaluation.parallel import each

RATE = 40.0  # Hz
MEASUREMENT_COVARIANCE = np.diag([0.02**2, np.radians(2.0) ** 2])  # (6.19)
ROBOT_COVARIANCE = np.array([[0.07**2, 0.001, 0.0], [0.001, 0.07**2, 0.0], [0.0, 0.0, np.radians(2.0) ** 2]])
VELOCITY_NOISE = 0.02  # (6.21)
# The text does not print its process noise. At this one the plain Kalman filter's NEES is 2 in scenario 3.
ACCELERATION = 0.45

# Start (x, y), seconds between turns.
SCENARIOS = {1: ((0.75, -1.5), 3.0), 2: ((6.0, -1.5), 6.0), 3: ((0.75, -1.5), 6.0)}

# The filters compared: names as printed, options of SwitchingFilter.
FILTERS: dict[str, dict[str, Any]] = {
    "switching": {},
    "switching, polar K": {"position_in_ratio": False},
    "always particles": {"k_crit": 0.0},
    "always Kalman": {"k_crit": np.inf},
    "plain Kalman": {"k_crit": np.inf, "decorrelated": False},
    "Algorithm 1 as printed": {"printed": True},
}

# What a mode between the two could be held against: the Kalman mode, cheaper particles, and many more of them, which
# come near the exact answer.
BETWEEN: dict[str, dict[str, Any]] = {
    "always Kalman": {"k_crit": np.inf},
    "1,000 particles, 10 samples": {"k_crit": 0.0, "samples": 10},
    "1,000 particles, 50 samples": {"k_crit": 0.0, "samples": 50},
    "1,000 particles, 250 samples": {"k_crit": 0.0},
    "10,000 particles, 250 samples": {"k_crit": 0.0, "particles": 10_000},
}


@dataclass(frozen=True)
class Walk:
    """Truth (T, 4), estimated robot poses (T, 3), measurements (T, 2), at `RATE`."""

    truth: FloatArray
    robots: FloatArray
    measurements: FloatArray


@dataclass(frozen=True)
class TrackedWalk:
    """What a filter did: per step, position error (T, 2), its NEES, K, mode, kind of update, seconds."""

    error: FloatArray
    nees: FloatArray
    ratio: FloatArray
    particles: FloatArray
    kinds: list[str]
    predict_time: FloatArray
    update_time: FloatArray

    @property
    def rmse(self) -> float:
        """Of the position, m."""
        return float(np.sqrt((self.error**2).sum(1).mean()))

    @property
    def anees(self) -> float:
        """Mean NEES of the position; 2 is consistent."""
        return float(self.nees.mean())

    @property
    def cost(self) -> float:
        """Seconds spent in predict and update."""
        return float(self.predict_time.sum() + self.update_time.sum())


def walk(scenario: int, seed: int, seconds: float) -> Walk:
    """Simulate one scenario as printed: constant-speed walk, robot pose error and measurement noise per step."""
    rng = np.random.default_rng([scenario, seed])
    start, turn = SCENARIOS[scenario]
    steps = round(seconds * RATE)
    sign = np.where((np.arange(steps) / RATE // turn) % 2 == 0, 1.0, -1.0)
    velocity = np.stack([np.zeros(steps), sign], -1) + VELOCITY_NOISE * rng.standard_normal((steps, 2))
    position = np.array(start) + np.cumsum(velocity, 0) / RATE
    robots = rng.multivariate_normal(np.zeros(3), ROBOT_COVARIANCE, steps)
    polar = np.stack([np.hypot(*position.T), np.arctan2(position[:, 1], position[:, 0])], -1)
    polar += rng.standard_normal((steps, 2)) * np.sqrt(np.diag(MEASUREMENT_COVARIANCE))
    return Walk(np.hstack([position, velocity]), robots, polar)


def track(scene: Walk, seed: int, acceleration: float = ACCELERATION, **options: Any) -> TrackedWalk:
    """Run a filter over a walk, timing every predict and update in seconds of processor time.

    Processor time leaves out what other programs on the machine take.
    """
    start = np.array([*scene.truth[0, :2], 0.0, 1.0])
    spread = np.diag([0.1, 0.1, 0.05, 0.05])
    options = dict(options)
    kind = PrintedSwitchingFilter if options.pop("printed", False) else SwitchingFilter
    filter_ = kind(ConstantVelocity(acceleration), start, spread, seed=seed, **options)
    k_crit = options.get("k_crit", 1.075)
    steps = len(scene.truth)
    error, squares, ratio = np.empty((steps, 2)), np.empty(steps), np.empty(steps)
    particles, times, kinds = np.zeros(steps), np.zeros((steps, 2)), []
    for k in range(steps):
        before = filter_.mode, filter_.tests
        t0 = time.process_time()
        if k:
            filter_.predict(1.0 / RATE)
        t1 = time.process_time()
        filter_.update(scene.robots[k], ROBOT_COVARIANCE, scene.measurements[k], MEASUREMENT_COVARIANCE)
        times[k] = t1 - t0, time.process_time() - t1
        error[k] = (filter_.mean - scene.truth[k])[:2]
        squares[k] = nees(error[k], filter_.covariance[:2, :2])
        ratio[k], particles[k] = filter_.ratio, filter_.mode == "pf"
        kinds.append(_kind(before[0], filter_, before[1], k_crit))
    return TrackedWalk(error, squares, ratio, particles, kinds, times[:, 0], times[:, 1])


def _kind(
    mode_before: str, after: SwitchingFilter | PrintedSwitchingFilter, tests_before: int, k_crit: float
) -> str:
    if mode_before == "kf":
        return "KF" if after.mode == "kf" else "KF to PF"
    if after.mode == "kf":
        return "PF to KF"
    if after.tests > tests_before:
        return "PF, tested"
    return "PF, Gaussian" if after.ratio < k_crit else "PF, samples"


@cache
def compiled() -> None:
    """Compiles all that a filter calls, outside of any timing."""
    for options in ({"position_in_ratio": False}, {"k_crit": 0.0}):
        track(walk(3, 0, 3.0), 0, **options)


def paired(
    scenario: int, seeds: Sequence[int], seconds: float, filters: dict[str, dict[str, Any]], jobs: int
) -> dict[str, FloatArray]:
    """RMSE, ANEES and mean cost per step of every filter on the same walks: (seeds, 3) each."""
    rows = each(_one_seed, [(scenario, seed, seconds, filters) for seed in seeds], jobs)
    return {name: np.array([row[name] for row in rows]) for name in filters}


def _one_seed(
    scenario: int, seed: int, seconds: float, filters: dict[str, dict[str, Any]]
) -> dict[str, tuple[float, ...]]:
    compiled()
    scene = walk(scenario, seed, seconds)
    runs = {name: track(scene, seed, **options) for name, options in filters.items()}
    return {name: (run.rmse, run.anees, run.cost / len(run.nees)) for name, run in runs.items()}


def mean_ms(run: TrackedWalk, *kinds: str) -> float:
    """Mean update time, ms, of updates of the given kinds; NaN where there is none. The first step is left out."""
    chosen = [t for t, kind in zip(run.update_time[1:], run.kinds[1:], strict=True) if kind in kinds]
    return 1e3 * float(np.mean(chosen)) if chosen else float("nan")
