"""Chapter 4 as printed: goals by the plain GHMM (4.12), paths by the Kalman filter with social forces (4.13)."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from estimation.checks import FloatArray, as_points
from tracking.intentions.intention_config import IntentionConfig
from tracking.intentions.intention_model import MISSING, IntentionModel
from tracking.intentions.prediction import Prediction
from tracking.prediction.social_forces import Obstacles
from tracking.prediction.social_forces_printed import Acceleration, PrintedForces, SocialForceFilter

RECENT = 25  # observations that the filter runs over; older ones say nothing of the velocity any more


class PrintedModel(IntentionModel, method="printed"):
    """`IntentionModel` with the text's two steps; learns as the plain GHMM does.

    Other people go on as they are while one is predicted. Before anything is learned the goal is straight ahead, as
    in the text's benchmark.
    """

    def __init__(self, config: IntentionConfig | None = None) -> None:
        super().__init__(config or IntentionConfig(method="printed", time_step=0.2))
        self.printed = PrintedForces()

    def _predict(
        self,
        partials: list[ArrayLike],
        states: FloatArray,
        horizon: float,
        obstacles: ArrayLike | Obstacles | None,
        wanted: int,
    ) -> list[Prediction]:
        """Each is predicted by itself, from where it was last seen."""
        tracks, points = self._tracks(partials, horizon), _points(obstacles)
        moving = [self._motion(rows).state[None] for rows in tracks]
        return [
            self._alone(rows, np.concatenate([states, *moving[:k], *moving[k + 1 :]]), horizon, points)
            for k, rows in enumerate(tracks[:wanted])
        ]

    def _alone(self, rows: FloatArray, people: FloatArray, horizon: float, points: FloatArray) -> Prediction:
        """A track (N, 3) to its most probable goal, among people (P, 4) who go on as they are and things (K, 2)."""
        goals, probabilities = self.intentions(rows, horizon)
        begun = float(rows[-1, 2])

        def pushed(now: float) -> Acceleration:
            """Forces with everybody where they should be at `now` s."""
            there = people[:, :2] + (now - begun) * people[:, 2:]
            things = np.concatenate([there, points])
            radii = np.repeat([self.printed.radius, 0.0], [len(there), len(points)])
            return lambda x: self.printed.acceleration(x, goals[0], things, radii)

        filter_ = self._filtered(rows[-RECENT:], pushed)
        times = np.linspace(0.0, horizon, max(1, int(np.ceil(horizon / self.config.time_step - 1e-9))) + 1)
        path, covariances = [filter_.state[:2]], [filter_.covariance[:2, :2]]
        for before, after in pairwise(times):
            filter_.predict(float(after - before), pushed(begun + before))
            path.append(filter_.state[:2])
            covariances.append(filter_.covariance[:2, :2])
        return Prediction(
            goals, probabilities, np.column_stack((np.array(path), begun + times)), np.array(covariances)
        )

    def _filtered(self, rows: FloatArray, pushed: Callable[[float], Acceleration]) -> SocialForceFilter:
        """The filter after the observations since the last gap; before it nothing is told of the velocity either."""
        gaps = np.flatnonzero(np.diff(rows[:, 2]) > MISSING)
        rows = rows[gaps[-1] + 1 :] if len(gaps) else rows
        filter_ = SocialForceFilter(
            np.array([*rows[0, :2], 0.0, 0.0]), np.diag([0.01, 0.01, 4.0, 4.0]), dt=0.2
        )
        for before, after in pairwise(rows):
            filter_.predict(float(after[2] - before[2]), pushed(float(before[2])))
            filter_.update(after[:2])
        return filter_


def _points(obstacles: ArrayLike | Obstacles | None) -> FloatArray:
    if obstacles is None:
        return np.zeros((0, 2))
    return obstacles.points if isinstance(obstacles, Obstacles) else as_points("obstacles", obstacles, 2)
