"""Times of `estimation`, each as a ratio to a named alternative in the same run.

`python bench/bench_estimation.py` prints the table and writes it to `bench/bench_estimation.txt`. Times are the
least of several rounds on one core: the machine may be shared. Nothing here is a test.
"""

from __future__ import annotations

import argparse
import heapq
import itertools
import os
import platform
import sys
from collections.abc import Callable
from pathlib import Path
from timeit import Timer

# Before numpy starts its threads: one core is what is measured.
os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from scipy.optimize import linear_sum_assignment

from estimation.conversion.map_frame import convert_to_map, convert_with_ratio
from estimation.conversion.polar import condition_ratio, convert, mardia_test
from estimation.conversion.switching import ConstantVelocity, SwitchingBank, SwitchingFilter
from estimation.filters import kalman
from estimation.filters.assignment import k_best
from estimation.geometry.poses import compound, compound_jacobians, pose_from_matrix, pose_to_matrix

COUNT = 1000
ROBOT, ROBOT_COVARIANCE = np.array([0.5, -0.2, 0.3]), np.diag([0.0049, 0.0049, 0.0012])
NOISE = np.diag([0.02**2, np.radians(2) ** 2])
MOTION = ConstantVelocity(0.6)


def least(function: Callable[[], object], rounds: int = 7, budget: float = 0.15) -> float:
    """Seconds per call: the least mean over several rounds, each about `budget` seconds long."""
    function()
    timer = Timer(function)
    once = timer.timeit(1)
    number = max(1, int(budget / max(once, 1e-7)))
    return min(timer.repeat(rounds, number)) / number


def measurements() -> tuple[np.ndarray, ...]:
    """(COUNT,) range, bearing and their standard deviations."""
    rng = np.random.default_rng(0)
    return (
        rng.uniform(1, 8, COUNT),
        rng.uniform(-3, 3, COUNT),
        np.full(COUNT, 0.02),
        np.full(COUNT, np.radians(2)),
    )


def conversion() -> list[tuple[str, float, str, float, str]]:
    """1,000 conversions with K."""
    r, theta, sr, st = measurements()

    def singly() -> None:
        for k in range(COUNT):
            convert(r[k], theta[k], sr[k], st[k])
            condition_ratio(r[k], theta[k], sr[k], st[k])

    def arrays() -> None:
        convert(r, theta, sr, st)
        condition_ratio(r, theta, sr, st)

    compiled = least(lambda: convert_with_ratio(r, theta, sr, st))
    in_map = least(lambda: convert_with_ratio(r, theta, sr, st, ROBOT, ROBOT_COVARIANCE))
    loop, plain = least(singly, 3), least(arrays)
    return [
        (
            "1,000 conversions with K, one pass",
            compiled,
            "convert(), condition_ratio() one by one",
            loop,
            "≤ 0.5 ms",
        ),
        (
            "1,000 conversions with K, arrays",
            plain,
            "convert(), condition_ratio() one by one",
            loop,
            "≤ 0.5 ms",
        ),
        (
            "the same through a robot pose, one pass",
            in_map,
            "convert(), condition_ratio() one by one",
            loop,
            "",
        ),
    ]


def kalman_mode() -> list[tuple[str, float, str, float, str]]:
    """Predict and update in Kalman mode, per filter."""
    rng = np.random.default_rng(1)
    position = rng.uniform(0.5, 1.2, (COUNT, 2))
    means = np.hstack([position, np.zeros((COUNT, 2))])
    covariances = np.tile(0.05 * np.eye(4), (COUNT, 1, 1))
    offset = position - ROBOT[:2]
    bearing = np.arctan2(offset[:, 1], offset[:, 0]) - ROBOT[2]
    z = np.stack([np.hypot(*offset.T), np.angle(np.exp(1j * bearing))], -1)
    bank = SwitchingBank(MOTION, means, covariances)
    single = SwitchingFilter(MOTION, means[0], covariances[0])
    F, Q = MOTION.matrices(0.025)
    H = np.eye(2, 4)

    def batch() -> None:
        bank.predict(0.025)
        bank.update(ROBOT, ROBOT_COVARIANCE, z, NOISE)

    def one() -> None:
        single.predict(0.025)
        single.update(ROBOT, ROBOT_COVARIANCE, z[0], NOISE)

    def arrays() -> None:
        m, P = kalman.predict(means, covariances, F, Q)
        sigma = np.sqrt(np.diag(NOISE))
        converted, R = convert_to_map(ROBOT, ROBOT_COVARIANCE, z[:, 0], z[:, 1], *sigma)
        kalman.update(m, P, converted, H, R)

    a, b, c = least(batch), least(one), least(arrays)
    assert bank.in_kalman_mode.all()
    return [
        (
            "Kalman predict and update, bank of 1,000, per filter",
            a / COUNT,
            "SwitchingFilter, one by one",
            b,
            "≤ 5 µs",
        ),
        ("the same", a / COUNT, "estimation.filters.kalman on arrays, no K, no switching", c / COUNT, ""),
    ]


def particle_mode() -> list[tuple[str, float, str, float, str]]:
    """One step of 1,000 particles against 250 samples, and against the Kalman mode."""
    filters = {
        k_crit: SwitchingFilter(MOTION, [3.0, 1, 0, 0], 0.05 * np.eye(4), k_crit=k_crit)
        for k_crit in (0.0, np.inf)
    }

    def step(k_crit: float) -> Callable[[], None]:
        def run() -> None:
            filters[k_crit].predict(0.025)
            filters[k_crit].update(np.zeros(3), ROBOT_COVARIANCE, [3.1, 0.3], NOISE)

        return run

    pf, kf = least(step(0.0), 5), least(step(np.inf))
    x = np.random.default_rng(2).normal(size=(1000, 4))

    def all_pairs() -> None:
        offsets = x - x.mean(0)
        products = offsets @ np.linalg.inv(offsets.T @ offsets / len(x)) @ offsets.T
        (products**3).mean(), (np.diag(products) ** 2).mean()

    moments, pairs = least(lambda: mardia_test(x)), least(all_pairs, 5)
    return [
        (
            "Kalman step of one SwitchingFilter",
            kf,
            "particle step, 1,000 particles and 250 samples",
            pf,
            "≤ 1 %",
        ),
        ("Mardia's test, 1,000 particles, by moments", moments, "over all pairs, as defined", pairs, ""),
    ]


def murty_by_scipy(costs: np.ndarray, k: int) -> list[float]:
    """Murty's algorithm solving every subproblem anew with scipy: the plain alternative."""
    counter = itertools.count()

    def solve(matrix: np.ndarray) -> tuple[float, np.ndarray] | None:
        try:
            rows, columns = linear_sum_assignment(matrix)
        except ValueError:
            return None
        return float(matrix[rows, columns].sum()), columns

    first = solve(costs)
    assert first is not None
    heap = [(first[0], next(counter), first[1], costs, 0)]
    found: list[float] = []
    while heap and len(found) < k:
        cost, _, columns, matrix, fixed = heapq.heappop(heap)
        found.append(cost)
        matrix = matrix.copy()
        for row in range(fixed, len(columns)):
            child = matrix.copy()
            child[row, columns[row]] = np.inf
            solved = solve(child)
            if solved is not None:
                heapq.heappush(heap, (solved[0], next(counter), solved[1], child, row))
            keep = matrix[row, columns[row]]
            matrix[row], matrix[:, columns[row]] = np.inf, np.inf
            matrix[row, columns[row]] = keep
    return found


def assignment() -> list[tuple[str, float, str, float, str]]:
    """Murty's 100 best of 20 × 20: the median over ten matrices."""
    ours, theirs = [], []
    for seed in range(10):
        costs = np.random.default_rng(seed).random((20, 20))
        found = [cost for cost, _ in k_best(costs, 100)]
        np.testing.assert_allclose(found, murty_by_scipy(costs, 100))
        ours.append(least(lambda costs=costs: k_best(costs, 100), 5, 0.02))
        theirs.append(least(lambda costs=costs: murty_by_scipy(costs, 100), 2, 0.02))
    return [
        (
            "100 best assignments of 20 × 20",
            float(np.median(ours)),
            "Murty on scipy.linear_sum_assignment",
            float(np.median(theirs)),
            "≤ 5 ms",
        )
    ]


def poses() -> list[tuple[str, float, str, float, str]]:
    """Compounding, per scan."""
    a, b = np.array([1.0, 2.0, 0.3]), np.array([0.1, -0.2, 0.4])
    c, d = np.array([1, 2, 3, 0.1, 0.2, 0.3]), np.array([0.3, 0.2, 0.1, 0.3, -0.2, 0.1])

    def matrices(x: np.ndarray, y: np.ndarray) -> Callable[[], object]:
        return lambda: pose_from_matrix(pose_to_matrix(x) @ pose_to_matrix(y))

    return [
        (
            "compound in SE(2)",
            least(lambda: compound(a, b)),
            "by matrices",
            least(matrices(a, b)),
            "a few µs",
        ),
        (
            "its Jacobians",
            least(lambda: compound_jacobians(a, b)),
            "compound in SE(2)",
            least(lambda: compound(a, b)),
            "",
        ),
        ("compound in SE(3)", least(lambda: compound(c, d)), "by matrices", least(matrices(c, d)), ""),
    ]


def human(seconds: float) -> str:
    """With three digits and a unit."""
    for unit, scale in (("s", 1.0), ("ms", 1e-3), ("µs", 1e-6)):
        if seconds >= scale:
            return f"{seconds / scale:.3g} {unit}"
    return f"{seconds / 1e-9:.3g} ns"


def main() -> None:
    """Measure, print and write."""
    lines = [
        f"{platform.machine()}, Python {platform.python_version()}, numpy {np.__version__}, one core",
        "",
    ]
    header = (
        f"{'what':<54}{'time':>10}  {'wanted':<9}{'alternative in the same run':<50}{'time':>10}{'ratio':>9}"
    )
    lines.append(header)
    for group in (conversion, kalman_mode, particle_mode, assignment, poses):
        for what, ours, name, theirs, wanted in group():
            lines.append(
                f"{what:<54}{human(ours):>10}  {wanted:<9}{name:<50}{human(theirs):>10}{ours / theirs:>9.2g}"
            )
    text = "\n".join(lines) + "\n"
    print(text, end="")
    Path(__file__).with_suffix(".txt").write_text(text)


if __name__ == "__main__":
    argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "").parse_args()
    main()
