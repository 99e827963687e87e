"""The rule of chapter 3 as printed, (3.3) to (3.11), beside what `world_model.tasks.maintenance` made of it.

No anticipation, no stand-off, no tours: the robot drives to the object and looks at each time step on the way. An
action is worth what its predict-update cycles bring, each by (3.5), summed over the cycles and over all objects that
are in range. The text leaves three ways open to measure the gain of a way with several cycles: against the entropy
now, against the entropy that nobody looked would have led to, and cycle by cycle. The third is taken: of the three it
is the one with which distances fall where Figure 3.4 has them fall (`whereabouts experiment maintenance`).

Covariances are circular, a variance per object and axis, as in the text's simulation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from estimation.checks import FloatArray, require_positive
from estimation.errors import InputError

# mypy: disable-error-code="no-untyped-def"


@dataclass(frozen=True)
class PrintedRule:
    """Settings of section 3.7.1.

    threshold : IG_thr, nat (3.7). weight : ω, norm : IG_norm, nat (3.9). scale : C_scale, m (3.8). range_min,
    range_max : m, of the sensor. variance : σ_M, m² per axis of one look. speed : m/s, time_step : s; the text states
    neither. Raises InputError naming the field.
    """

    threshold: float = 8.0
    weight: float = 0.75
    norm: float = 5.0
    scale: float = 10.0
    range_min: float = 0.4
    range_max: float = 2.0
    variance: float = 0.01
    speed: float = 1.7
    time_step: float = 1.2

    def __post_init__(self) -> None:
        for name in ("norm", "scale", "variance", "speed", "time_step"):
            require_positive(name, getattr(self, name))
        if not 0.0 <= self.range_min < self.range_max < math.inf:
            raise InputError(
                f"range_min, range_max: 0 <= min < max expected, got {self.range_min!r}, {self.range_max!r}"
            )
        if not (self.threshold >= 0.0 and self.weight >= 0.0):
            raise InputError(
                f"threshold, weight: at least 0 expected, got {self.threshold!r}, {self.weight!r}"
            )

    @property
    def stride(self) -> float:
        """m in a time step."""
        return self.speed * self.time_step

    def numbers(self) -> FloatArray:
        """What the compiled functions take."""
        worth = self.threshold, self.weight, self.norm, self.scale
        return np.array([*worth, self.range_min, self.range_max, self.variance, self.stride])


def entropy(covariance: FloatArray) -> float:
    """H of a Gaussian of covariance (n, n), nat: (3.3)."""
    n = len(covariance)
    return 0.5 * n * (1.0 + math.log(2.0 * math.pi)) + 0.5 * float(np.linalg.slogdet(covariance)[1])


@njit(cache=True)
def towards(x, y, goal_x, goal_y, stride):
    """One time step to a goal: the new x, y and the metres it took."""
    dx, dy = goal_x - x, goal_y - y
    away = math.hypot(dx, dy)
    taken = min(away, stride)
    if away > 1e-12:
        x += dx * taken / away
        y += dy * taken / away
    return x, y, taken


@njit(cache=True)
def look(position, x, y, variance, numbers):
    """Variance after a look from (x, y) by the Kalman filter, unchanged where the object is out of range."""
    away = math.hypot(position[0] - x, position[1] - y)
    if numbers[4] <= away <= numbers[5]:
        return variance * numbers[6] / (variance + numbers[6])
    return variance


@njit(cache=True)
def expected(item, x, y, positions, variances, growth, numbers):
    """Gain of going for an object, nat (3.6), and the metres to drive: fake measurements at each time step."""
    now = variances.copy()
    gain = 0.0
    length = math.hypot(positions[item, 0] - x, positions[item, 1] - y)
    for _ in range(max(math.ceil(length / numbers[7] - 1e-9), 1)):
        x, y, _ = towards(x, y, positions[item, 0], positions[item, 1], numbers[7])
        for i in range(len(now)):
            now[i] += growth[i]
            after = look(positions[i], x, y, now[i], numbers)
            # Two axes of half a logarithm each.
            gain += math.log(now[i] / after)
            now[i] = after
    return gain, length


@njit(cache=True)
def best(x, y, positions, variances, growth, numbers):
    """a* of (3.10): the object of the largest utility (3.9) among those of (3.7), -1 where that set is empty."""
    chosen, most = -1, -np.inf
    for i in range(len(growth)):
        gain, length = expected(i, x, y, positions, variances, growth, numbers)
        utility = gain / numbers[2] - numbers[1] * length / numbers[3]
        if gain > numbers[0] and utility > most:
            chosen, most = i, utility
    return chosen


@njit(cache=True)
def run(positions, growth, start, steps, numbers, fixed, idle):
    """A run of section 3.7: means over time of H_max (3.13) and H_sum (3.14), metres, looks (N,), goals (N,), path.

    positions : (N, 2) m. growth : (N,) m² per step. start : (2,) m. fixed : from object to object over and over, the
    text's benchmark, in place of the rule. idle : whether objects are looked at, too, while nothing is worth going for.
    """
    count = len(growth)
    variances = np.full(count, numbers[6])
    updates, goals = np.zeros(count, np.int64), np.zeros(count, np.int64)
    path = np.empty((steps + 1, 2))
    x, y = start[0], start[1]
    path[0] = start
    worst = total = distance = 0.0
    task, following = -1, 0
    for k in range(steps):
        if task < 0 and fixed:
            task, following = following, (following + 1) % count
        elif task < 0:
            task = best(x, y, positions, variances, growth, numbers)
        if task >= 0:
            x, y, taken = towards(x, y, positions[task, 0], positions[task, 1], numbers[7])
            distance += taken
        largest = -np.inf
        for i in range(count):
            variances[i] += growth[i]
            if task >= 0 or idle:
                after = look(positions[i], x, y, variances[i], numbers)
                updates[i] += after < variances[i]
                variances[i] = after
            uncertain = 1.0 + math.log(2.0 * math.pi) + math.log(variances[i])
            total += uncertain
            largest = max(largest, uncertain)
        worst += largest
        path[k + 1, 0], path[k + 1, 1] = x, y
        if task >= 0 and math.hypot(positions[task, 0] - x, positions[task, 1] - y) <= 1e-6:
            goals[task] += 1
            task = -1
    return worst / steps, total / steps, distance, updates, goals, path


IntArray = NDArray[np.int64]


@dataclass(frozen=True)
class PrintedRun:
    """Means over time of H_max (3.13) and H_sum (3.14), nat; metres; looks (N,) and goals (N,); path (K + 1, 2) m."""

    worst: float
    total: float
    distance: float
    updates: IntArray
    goals: IntArray
    path: FloatArray


def simulate(
    rule: PrintedRule, seed: int, fixed: bool = False, idle: bool = False, duration: float = 1000.0
) -> PrintedRun:
    """One room of 10 m with ten objects and σ_P from [0, 0.01] m² per time step, 1000 s (section 3.7.1).

    fixed : the benchmark, from object to object. idle : looks, too, while there is nothing to go for.
    """
    rng = np.random.default_rng(seed)
    positions, growth = rng.uniform(0.0, rule.scale, (10, 2)), rng.uniform(0.0, 0.01, 10)
    start = np.full(2, 0.5 * rule.scale)
    steps = round(duration / rule.time_step)
    return PrintedRun(*run(positions, growth, start, steps, rule.numbers(), fixed, idle))
