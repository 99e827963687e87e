"""The rule of chapter 3 as printed, against the equations written out for a few objects."""

import math

import numpy as np
import pytest

from estimation.errors import InputError
from evaluation.maintenance.maintenance_printed import PrintedRule, entropy, room_of, simulate
from evaluation.maintenance.printed_kernels import best_as_printed, expected

RULE = PrintedRule(threshold=2.0, speed=0.5, time_step=1.0)


def by_hand(item, here, positions, variances, growth, rule):
    """(3.6) with whole covariances and a Kalman filter, entropies by (3.3): gain, metres."""
    P = [v * np.eye(2) for v in variances]
    R, away = rule.variance * np.eye(2), positions[item] - here
    length = np.linalg.norm(away)
    steps, total = max(math.ceil(length / rule.stride - 1e-9), 1), 0.0
    for k in range(1, steps + 1):
        robot = here + away / np.linalg.norm(away) * min(k * rule.stride, length)
        for i in range(len(P)):
            P[i] = P[i] + growth[i] * np.eye(2)
            distance = np.linalg.norm(positions[i] - robot)
            if not rule.range_min <= distance <= rule.range_max:
                continue
            before, K = entropy(P[i]), P[i] @ np.linalg.inv(P[i] + R)
            P[i] = (np.eye(2) - K) @ P[i]
            total += before - entropy(P[i])
    return total, length


def test_the_gain_of_a_way_is_the_sum_of_its_cycles():
    rng = np.random.default_rng(0)
    for _ in range(20):
        positions, here = rng.uniform(0, 6, (4, 2)), rng.uniform(0, 6, 2)
        variances, growth = rng.uniform(0.001, 0.5, 4), rng.uniform(0, 0.05, 4)
        room, pose = (
            room_of(RULE, 0, 10.0).truth._replace(positions=positions, growth=growth),
            np.array([*here, 0.0]),
        )
        wanted = [by_hand(k, here, positions, variances, growth, RULE) for k in range(4)]
        np.testing.assert_allclose([expected(k, pose, room, variances) for k in range(4)], wanted, rtol=1e-9)
        utility = [gain / RULE.norm - RULE.weight * length / RULE.scale for gain, length in wanted]
        able = [k for k in range(4) if wanted[k][0] > RULE.threshold]
        assert best_as_printed(pose, room, variances, RULE.numbers) == max(
            able, key=lambda k: utility[k], default=-1
        )


def test_entropy_of_a_gaussian_is_the_mean_of_minus_its_logarithm():
    P = np.array([[0.5, 0.2], [0.2, 0.3]])
    x = np.random.default_rng(1).multivariate_normal([0, 0], P, 200_000)
    log_p = -0.5 * np.einsum("ni,ij,nj->n", x, np.linalg.inv(P), x) - 0.5 * np.log(
        np.linalg.det(2 * np.pi * P)
    )
    assert entropy(P) == pytest.approx(-log_p.mean(), abs=0.01)


def test_nothing_is_looked_at_between_and_a_high_threshold_keeps_the_robot_where_it_is():
    still = simulate(PrintedRule(threshold=1e6), 3)
    assert still.distance == 0.0
    assert still.updates.sum() == still.goals.sum() == 0
    assert simulate(PrintedRule(threshold=1e6), 3, idle=True).distance == 0.0
    driven = simulate(PrintedRule(threshold=1.0), 3)
    assert driven.goals.sum() > 20
    assert driven.updates.sum() > driven.goals.sum()


def test_the_benchmark_makes_the_printed_number_of_goals_and_updates():
    """Figure 3.7: 973 updates and 263 goals in one run; here the mean of some rooms."""
    runs = [simulate(PrintedRule(), seed, fixed=True) for seed in range(40)]
    assert np.mean([r.goals.sum() for r in runs]) == pytest.approx(263, rel=0.1)
    assert np.mean([r.updates.sum() for r in runs]) == pytest.approx(973, rel=0.15)
    # One after the other: no object is more than one goal ahead.
    assert max(np.ptp(r.goals) for r in runs) <= 1


def test_the_fixed_path_is_driven_as_it_says():
    found = simulate(PrintedRule(), 5, fixed=True)
    legs = np.hypot(*np.diff(found.path, axis=0).T)
    assert legs.sum() == pytest.approx(found.distance)
    assert legs.max() <= PrintedRule().stride + 1e-9


def test_bad_settings_are_named():
    with pytest.raises(InputError, match="range_min"):
        PrintedRule(range_min=3.0)
    with pytest.raises(InputError, match="speed"):
        PrintedRule(speed=0.0)


def test_what_is_looked_at_in_passing():
    """A straight drive of one step past one thing to another: both from where the step ends."""
    room = room_of(PrintedRule(speed=1.0, time_step=1.0), 0, 10.0).truth
    room = room._replace(positions=np.array([[1.0, 0.0], [1.0, 1.0]]), growth=np.zeros(2))
    gain, length = expected(0, np.zeros(3), room, np.array([1.0, 0.5]))
    assert length == 1.0
    # The robot stands on the first, too near for its sensor, and 1 m from the second.
    assert gain == pytest.approx(math.log(0.51 / 0.01))
