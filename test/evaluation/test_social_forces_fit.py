"""Parameters of social forces found again from simulated people."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from evaluation.intentions.social_forces_fit import fit_forces
from tracking.prediction.social_forces import Forces, Walker, simulate


def walker(x: float, y: float, vx: float, goal: tuple[float, float]) -> Walker:
    return Walker(np.array([x, y, vx, 0.0]), np.array([goal]), 1.2, None, 1e-3)


def crowd(forces: Forces, seed: int) -> list[np.ndarray]:
    """Recorded people that obey `forces`: groups that cross, each to its own goal."""
    rng = np.random.default_rng(seed)
    tracks = []
    for scene in range(12):
        people = []
        for side in (1.0, -1.0):
            for _ in range(3):
                start = np.array([-5.0 * side, rng.uniform(-1.5, 1.5)])
                goal = (9.0 * side, float(rng.uniform(-3.0, 3.0)))
                people.append(walker(*start, 1.2 * side, goal))
        run = simulate(people, 9.0, forces, dt=0.1)
        t = 100.0 * scene + np.linspace(0.0, 9.0, len(run))
        tracks += [np.column_stack((run[:, k, :2], t)) for k in range(len(people))]
    return tracks


def test_parameters_are_found_again_from_simulated_people() -> None:
    truth = Forces(relaxation=1.0, people_strength=2.0, people_range=0.4)
    fitted = fit_forces(
        crowd(truth, 3), Forces(relaxation=4.0, people_strength=0.3, people_range=0.2), scenes=150
    )
    assert fitted.error < 0.7 * fitted.before
    assert fitted.forces.relaxation == pytest.approx(1.0, rel=0.5)
    assert fitted.followed > 100


def test_nobody_to_fit_to_is_said() -> None:
    short = np.column_stack((np.zeros((4, 2)), np.arange(4.0)))
    with pytest.raises(InputError, match="trajectories"):
        fit_forces([short])
