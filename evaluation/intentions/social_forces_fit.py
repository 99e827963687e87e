"""Social-force parameters from recorded people: what section 4.6.4 of the anchoring text leaves to future work.

Everybody present at a moment is simulated together, each towards the place it really reached, and the parameters are
those with which the simulated paths come closest to the recorded ones. Knowing the destination keeps what was not
understood about intentions out of the forces.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from tracking.intentions.observations import at_times
from tracking.intentions.walking_motion import estimate
from tracking.prediction.social_forces import Forces, Walker, simulate

HORIZON = 4.8  # s that are predicted
FITTED = ("relaxation", "people_strength", "people_range")
BOUNDS = {"relaxation": (0.3, 20.0), "people_strength": (0.01, 10.0), "people_range": (0.05, 2.0)}


@dataclass(frozen=True)
class FittedForces:
    """`forces` that were found, mean error m with them and `before`, and how many people were followed."""

    forces: Forces
    error: float
    before: float
    followed: int


@dataclass(frozen=True)
class _Scene:
    walkers: list[Walker]
    truths: list[FloatArray]  # (n, 2) at the times of the scene
    times: FloatArray


def fit_forces(
    trajectories: Sequence[FloatArray],
    start: Forces | None = None,
    scenes: int = 150,
) -> FittedForces:
    """Relaxation time, strength and range of other people from trajectories (N, 3) x, y, t seen at the same times.

    The moments are spread evenly over the recording; the search is deterministic. Half of the moments decide, the other
    half only judges: where the fit is not better there, `start` is given back.

    Raises
    ------
    InputError : nobody is followed for long enough.
    """
    # Forces are fitted at home, from what was recorded; nodes that follow people do without scipy.optimize.
    from scipy.optimize import minimize

    first = start or Forces()
    made = _scenes(trajectories, scenes)
    if len(made) < 2:
        raise InputError(f"trajectories: nobody is there for {HORIZON:g} s after 1 s of being seen")
    train, judge = made[::2], made[1::2]
    x0 = np.log([getattr(first, name) for name in FITTED])

    def forces_of(x: FloatArray) -> Forces:
        values = {name: float(np.clip(np.exp(v), *BOUNDS[name])) for name, v in zip(FITTED, x, strict=True)}
        return replace(first, **values)

    simplex = np.vstack((x0, x0 + 0.7 * np.eye(len(x0))))
    found = minimize(
        lambda x: _error(train, forces_of(x)),
        x0,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 120, "xatol": 0.02, "fatol": 1e-5},
    )
    before, after = (_error(judge, f) for f in (first, forces_of(found.x)))
    followed = sum(len(scene.walkers) for scene in made)
    if after < before:
        return FittedForces(forces_of(found.x), after, before, followed)
    return FittedForces(first, before, before, followed)


def _scenes(trajectories: Sequence[FloatArray], count: int) -> list[_Scene]:
    long = [rows for rows in trajectories if len(rows) > 2 and rows[-1, 2] - rows[0, 2] > HORIZON + 1.0]
    if not long:
        return []
    starts = np.sort(np.concatenate([rows[(rows[:, 2] > rows[0, 2] + 1.0), 2] for rows in long]))
    made = []
    for moment in starts[np.unique(np.linspace(0, len(starts) - 1, count).round().astype(int))]:
        walkers, truths = [], []
        times = np.linspace(HORIZON / 4.0, HORIZON, 4)
        for rows in trajectories:
            if not rows[0, 2] + 1.0 < moment <= rows[-1, 2] - HORIZON:
                continue
            motion = estimate(rows[rows[:, 2] <= moment], 1.5, 0.06)
            now = float(rows[rows[:, 2] <= moment][-1, 2])
            walkers.append(Walker(motion.state, rows[-1:, :2], motion.speed, None, 1e-3))
            truths.append(at_times(rows, now + times))
        if walkers:
            made.append(_Scene(walkers, truths, times))
    return made


def _error(scenes: list[_Scene], forces: Forces) -> float:
    """Mean distance of simulated and recorded places, m."""
    total, number = 0.0, 0
    for scene in scenes:
        run = simulate(scene.walkers, HORIZON, forces)
        index = np.round(scene.times / HORIZON * (len(run) - 1)).astype(int)
        for k, truth in enumerate(scene.truths):
            total += float(np.hypot(*(run[index, k, :2] - truth).T).mean())
            number += 1
    return total / number
