"""What a prediction is made of: its results, their covariances, and the other people it is given."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from estimation.checks import FloatArray, as_floats
from estimation.errors import InputError


@dataclass(frozen=True)
class PredictedWay:
    """One path: `goal` index into the goals, `path` (T, 3) x, y, t in m and s, `covariances` (T, 2, 2) m²."""

    goal: int
    path: FloatArray
    covariances: FloatArray


@dataclass(frozen=True)
class Prediction:
    """What one person is expected to do.

    goals : (G, 2) m, intended positions, the most probable first.
    probabilities : (G,), of one who goes to one of them; they sum to one.
    elsewhere : in [0, 1], how probable it is that he goes to none of them, as so many did of late.
    path : (T, 3) x, y, t to the most probable goal, from the last observation's time to the horizon; absolute times.
    covariances : (T, 2, 2) m² of the path's points; they grow with time.
    alternatives : paths to the next goals.
    novelty : in [0, 1], how little of what was learned explains this person; 1 means plain social forces.
    """

    goals: FloatArray
    probabilities: FloatArray
    path: FloatArray
    covariances: FloatArray
    alternatives: list[PredictedWay] = field(default_factory=list)
    novelty: float = 0.0
    elsewhere: float = 0.0


def path_covariances(start: float, rates: FloatArray, after: FloatArray, run: FloatArray) -> FloatArray:
    """Covariances (T, 2, 2) m² of a run (T, 4) x, y, vx, vy: along and across it, growing with the time `after`, s.

    start : m, standard deviation at its start. rates : (T, 2) m/s, growth of that along and across.
    """
    speed = np.hypot(run[:, 2], run[:, 3])
    along, across = start**2 + np.maximum.accumulate(rates * after[:, None], axis=0).T ** 2
    # One who has arrived keeps the direction it came in.
    moving = np.maximum.accumulate(np.where(speed > 1e-2, np.arange(len(run)), 0))
    u = run[moving, 2:4] / np.maximum(speed[moving], 1e-2)[:, None]
    outer = u[:, :, None] * u[:, None, :]
    isotropic = across[:, None, None] * np.eye(2)
    return np.asarray(isotropic + (along - across)[:, None, None] * outer)


def parse_others(others: ArrayLike | Sequence[ArrayLike] | None) -> tuple[list[ArrayLike], FloatArray]:
    """Partial trajectories, and states (P, 4), of people beside the one predicted."""
    if others is None:
        return [], np.zeros((0, 4))
    if isinstance(others, np.ndarray) and others.ndim == 2:
        if others.shape[1] == 2:
            others = np.column_stack((others, np.zeros((len(others), 2))))
        if others.shape[1] == 4:
            states = as_floats("others", others)
            return [], states[np.isfinite(states).all(axis=1)]
        raise InputError(
            f"others must be a sequence of (M, 3) trajectories, (P, 4) or (P, 2), not {others.shape}"
        )
    if not isinstance(others, (Sequence, np.ndarray)):
        raise InputError(f"others must be a sequence of (M, 3) trajectories, not {type(others).__name__}")
    return list(others), np.zeros((0, 4))
