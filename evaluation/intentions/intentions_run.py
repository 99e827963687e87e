"""Learning from and predicting one file of trajectories: what the command `intentions` does."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from evaluation.intentions.intentions_protocol import FIRST, FRACTIONS, part
from tracking.intentions import IntentionModel
from tracking.intentions.observations import at_times, clean

Array = NDArray[np.float64]


@dataclass
class Told:
    """Outcome of a file: shares of correct exits by fraction, mean errors in m, and what taught nothing."""

    taught: int = 0
    predictions: int = 0
    moments: int = 0
    error: float = 0.0
    constant: float = 0.0
    correct: dict[float, float] = field(default_factory=dict)
    refused: Counter[str] = field(default_factory=Counter)
    dropped: Counter[str] = field(default_factory=Counter)

    def figures(self) -> dict[str, Any]:
        """Flat numbers for `--json`."""
        correct = {f"correct_{fraction:g}": rate for fraction, rate in self.correct.items()}
        return {
            "learned": self.taught,
            "predictions": self.predictions,
            **correct,
            "moments": self.moments,
            "error_m": self.error,
            "constant_velocity_error_m": self.constant,
            "refused": dict(self.refused),
            "dropped": dict(self.dropped),
        }


def learn_and_predict(
    model: IntentionModel,
    trajectories: list[Array],
    horizon: float,
    radius: float,
    on_step: Callable[[], None] = lambda: None,
) -> Told:
    """Predict each trajectory's exit and, halfway, its path over `horizon` s; then learn it.

    A model that knows fewer than ten walks learns up to ten before it is judged.
    """
    told = Told()
    right, errors, constants = [], [], []
    for given in trajectories:
        if model.learned >= FIRST and len(given) > 1:
            rows = clean("trajectory", given).rows
            goals = [model.intentions(part(rows, fraction), 10.0)[0][0] for fraction in FRACTIONS]
            right.append(np.hypot(*(np.array(goals) - rows[-1, :2]).T) <= radius)
            seen = part(rows, 0.5)
            then = seen[-1, 2] + horizon
            if then <= rows[-1, 2]:
                truth, guess = (at_times(p, then)[0] for p in (rows, model.predict(seen, horizon).path))
                first = seen[np.searchsorted(seen[:, 2], seen[-1, 2] - 3.2)]
                elapsed = max(seen[-1, 2] - first[2], 1e-6)
                constant = seen[-1, :2] + (seen[-1] - first)[:2] * (horizon / elapsed)
                errors.append(float(np.hypot(*(guess - truth))))
                constants.append(float(np.hypot(*(constant - truth))))
        outcome = model.learn(given)
        told.taught += outcome.taken
        told.dropped.update(outcome.dropped)
        if not outcome.taken:
            told.refused[outcome.reason] += 1
        on_step()
    told.predictions, told.moments = len(right), len(errors)
    if right:
        told.correct = dict(zip(FRACTIONS, np.mean(right, axis=0).tolist(), strict=True))
    if errors:
        told.error, told.constant = float(np.mean(errors)), float(np.mean(constants))
    return told


def draw(model: IntentionModel, trajectories: list[Array], target: Path) -> Path:
    """Scenes of people predicted together, as one picture at `target`."""
    from evaluation.intentions.intentions_pictures import scenes

    made = scenes(target.parent, model, trajectories, target.stem)
    if made != target:
        made.replace(target)
    return target
