"""Social forces: terms against the text's formulas, and symmetry."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from tracking.prediction.social_forces import Forces, Obstacles, Walker, simulate
from tracking.prediction.social_forces_kernels import push


def walker(x: float, y: float, vx: float, vy: float, goal: tuple[float, float] | None) -> Walker:
    return Walker(np.array([x, y, vx, vy]), None if goal is None else np.array([goal]), 1.2, None, 1e-3)


def test_without_a_way_and_without_others_velocity_stays() -> None:
    run = simulate([walker(0.0, 0.0, 1.0, -0.5, None)], 4.0, Forces())
    np.testing.assert_allclose(run[-1, 0], [4.0, -2.0, 1.0, -0.5], atol=1e-9)


def test_intended_velocity_is_taken_on_within_the_relaxation_time() -> None:
    """(4.16) alone is v(t) = v_wanted + (v_0 - v_wanted) exp(-t / τ)."""
    run = simulate([walker(0.0, 0.0, 0.0, 0.0, (1000.0, 0.0))], 3.0, Forces(relaxation=1.5), dt=0.01)
    t = np.linspace(0.0, 3.0, len(run))
    np.testing.assert_allclose(run[:, 0, 2], 1.2 * (1.0 - np.exp(-t / 1.5)), atol=0.01)


def test_push_is_that_of_the_text() -> None:
    """(4.17) beyond contact; (4.18) is added to it where people overlap."""
    assert push(1.5, 2.0, 0.5, 10.0, 0.6) == pytest.approx(2.0 * np.exp((0.6 - 1.5) / 0.5))
    assert push(0.4, 2.0, 0.5, 10.0, 0.6) == pytest.approx(2.0 + 10.0 * 0.2)


def test_two_who_meet_make_way_symmetrically() -> None:
    people = [walker(0.0, 0.1, 1.2, 0.0, (8.0, 0.0)), walker(8.0, -0.1, -1.2, 0.0, (0.0, 0.0))]
    run = simulate(people, 6.0, Forces(people_strength=2.0, people_range=0.4))
    np.testing.assert_allclose(run[:, 0, 0], 8.0 - run[:, 1, 0], atol=1e-6)
    np.testing.assert_allclose(run[:, 0, 1], -run[:, 1, 1], atol=1e-6)
    apart = np.hypot(*(run[:, 0, :2] - run[:, 1, :2]).T).min()
    alone = simulate(people, 6.0, Forces(people_strength=0.0, hardness=0.0))
    assert apart > np.hypot(*(alone[:, 0, :2] - alone[:, 1, :2]).T).min() + 0.04


def test_companions_stay_together() -> None:
    pair = [walker(0.0, 0.3, 1.2, 0.0, (9.0, 0.3)), walker(0.0, -0.3, 1.2, 0.0, (9.0, -0.3))]
    run = simulate(pair, 5.0, Forces())
    np.testing.assert_allclose(run[:, 0, 1] - run[:, 1, 1], 0.6, atol=0.02)


def test_nearest_obstacle_is_found_as_by_brute_force() -> None:
    from tracking.prediction.social_forces import CELL
    from tracking.prediction.social_forces_kernels import nearest_in_cells

    rng = np.random.default_rng(0)
    around = Obstacles(rng.uniform(-5, 5, (400, 2)))
    for place in rng.uniform(-6, 6, (200, 2)):
        found = nearest_in_cells(*place, around.walls)
        away = np.hypot(*(around.points - place).T)
        if away.min() < CELL:
            assert found == away.argmin()


def test_obstacles_are_checked_and_may_be_none() -> None:
    assert len(Obstacles()) == 0
    assert len(Obstacles(np.zeros((0, 2)))) == 0
    assert len(Obstacles([[0.01, 0.01], [0.02, 0.02], [5.0, 5.0]])) == 2
    for bad in ([[np.nan, 0.0]], [[1.0, 2.0, 3.0]]):
        with pytest.raises(InputError, match="obstacles"):
            Obstacles(bad)
