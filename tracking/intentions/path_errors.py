"""How far people get from predicted paths and goals: learned from walks that ended, each predicted before."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.checks import FloatArray
from tracking.intentions.observations import at_times
from tracking.intentions.prediction import PredictedWay

# Times ahead at which a predicted path is compared with what followed, s.
LAGS = (1.0, 2.0, 4.0)
# Walks over which is averaged who went to none of the goals, as their share falls with what is known of a place. Set on
# the hall; 10 and 40 tell as well.
LATELY = 20.0


class PathErrors:
    """Growth of the errors of predicted paths, along and across them, of people who stand and of people who walk.

    How straight and how evenly people walk depends on the place: in a street they hardly turn, in a home they do after
    a few steps. What is given counts as one walk.

    Parameters
    ----------
    given : (2,) m/s, along and across, before anything is learned. memory : walks over which is averaged.

    Attributes
    ----------
    elsewhere : in [0, 1], share of moments at which a walk ended at none of the goals that were told.
    """

    def __init__(self, given: tuple[float, float], memory: int) -> None:
        self.memory = memory
        # (standing | walking, lag, along | across) m²/s², and of how many walks each lag is the mean.
        self._squares: FloatArray = np.tile(np.square(given), (2, len(LAGS), 1))
        self._walks = np.ones((2, len(LAGS)))
        self.elsewhere, self._ends = 0.5, 1.0

    def rates(self, walking: bool, after: FloatArray) -> FloatArray:
        """(T, 2) m/s, by which the time ahead `after` (T,) s is multiplied for standard deviations along and across."""
        squares = np.maximum(self._squares[int(walking)], 0.0)
        return np.sqrt(np.column_stack([np.interp(after, LAGS, squares[:, axis]) for axis in (0, 1)]))

    def learn(self, judged: Sequence[tuple[bool, FloatArray]], elsewhere: float) -> None:
        """Take in one walk: whether the person walked, and squared rates (L, 2) m²/s² of the first lags, at moments.

        elsewhere : in [0, 1], at how many of the moments its end was at none of the goals.

        What is told besides, such as noise, is taken off them before, so that single ones may be below 0.
        """
        self._ends = min(self._ends + 1.0, LATELY)
        self.elsewhere += (elsewhere - self.elsewhere) / self._ends
        for k, lag in np.ndindex(self._walks.shape):
            squares = [square[lag] for walking, square in judged if walking == bool(k) and lag < len(square)]
            if squares:
                self._walks[k, lag] = min(float(self._walks[k, lag]) + 1.0, float(self.memory))
                self._squares[k, lag] += (np.mean(squares, axis=0) - self._squares[k, lag]) / self._walks[
                    k, lag
                ]

    def as_arrays(self) -> dict[str, NDArray[Any]]:
        """What was learned, for storage."""
        ends = np.array([self.elsewhere, self._ends])
        return {"squares": self._squares, "walks": self._walks, "ends": ends}

    def from_arrays(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Take over what `as_arrays` gave; nothing where there is none, as in older files. Raises ValueError."""
        if not arrays:
            return
        squares, walks = (np.array(arrays[name], dtype=np.float64) for name in ("squares", "walks"))
        fits = squares.shape == self._squares.shape and walks.shape == self._walks.shape
        if not (fits and np.isfinite(squares).all() and (walks > 0.0).all()):
            raise ValueError("the errors of paths do not fit together")
        ends = np.asarray(arrays.get("ends", (self.elsewhere, self._ends)), dtype=np.float64)
        if ends.shape != (2,) or not (0.0 <= ends[0] <= 1.0 and 1.0 <= ends[1] <= LATELY):
            raise ValueError("the share of those who went elsewhere is none")
        self._squares, self._walks = squares, walks
        self.elsewhere, self._ends = map(float, ends)


def squared_rates(ways: Sequence[PredictedWay], probabilities: FloatArray, truth: FloatArray) -> FloatArray:
    """Squared growth (L, 2) m²/s² of the errors of predicted ways, along and across, by the lags that were reached.

    truth : (M, 3) x, y, t of what followed. Each way counts by how probable it is after that: one to another goal is
    not off its path, it is another path.
    """
    start = ways[0].path[0, 2]
    lags = np.array([lag for lag in LAGS if start + lag <= truth[-1, 2]])
    if not len(lags):
        return np.zeros((0, 2))
    there = at_times(truth, start + lags)
    squares, logs = [], []
    for way in ways:
        t = way.path[:, 2]
        index = np.searchsorted(t, start + lags - 1e-6).clip(1, len(t) - 1)
        ahead = way.path[index, :2] - way.path[index - 1, :2]
        along = ahead / np.maximum(np.hypot(*ahead.T), 1e-9)[:, None]
        off = there - at_times(way.path, start + lags)
        on = np.einsum("li,li->l", off, along)
        squares.append(np.column_stack((on**2, np.maximum(np.square(off).sum(axis=1) - on**2, 0.0))))
        covariances = way.covariances[index]
        distance = np.einsum("li,lij,lj->l", off, np.linalg.inv(covariances), off)
        logs.append(-0.5 * float((distance + np.log(np.linalg.det(covariances))).mean()))
    odds = np.log(np.maximum(probabilities, 1e-300)) + np.array(logs)
    weights = np.exp(odds - odds.max())
    rates = np.array(squares) / np.square(lags)[:, None]
    return np.asarray(np.average(rates, axis=0, weights=weights))
