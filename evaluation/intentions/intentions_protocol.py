"""What `intentions` measures: correct exits while learning online, displacement errors, how much paths swing, times."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from evaluation.intentions.trajectories import EDINBURGH_METRES
from tracking.intentions import IntentionConfig, IntentionModel
from tracking.intentions.observations import at_times
from tracking.intentions.printed import PrintedModel
from tracking.intentions.routes import Routes, RouteScales
from tracking.intentions.walking_motion import estimate

Array = NDArray[np.float64]
FRACTIONS = (0.05, 0.2, 0.4, 0.6, 0.85)
CORRECT = 29.0 * EDINBURGH_METRES
FIRST = 10  # trajectories learned before the first prediction
OBSERVED, AHEAD = 8, 12  # frames of the hotel recording: 3.2 s seen, 4.8 s predicted
METHODS = ("routes", "ghmm", "linear")
# Routes without one of the things that they know.
STAGES = {
    "routes, nobody comes together": RouteScales(company=0.0, beside=0.0),
    "routes, never the other way": RouteScales(back=-1e3),
}
PRINTED = "printed"


@dataclass
class Online:
    """Online learning through a day: `correct` (predictions, fractions) and, per learned walk, sizes and times.

    said : (predictions, fractions, 2), how probable the first goal was told to be, and among the goals alone.
    """

    correct: NDArray[np.bool_]
    learn_ms: list[float] = field(default_factory=list)
    sizes: list[tuple[int, int, int]] = field(default_factory=list)  # nodes, states, edges
    model: IntentionModel | None = None
    said: Array = field(default_factory=lambda: np.zeros((0, len(FRACTIONS), 2)))

    @property
    def rates(self) -> Array:
        """Share of correct exits per fraction."""
        return np.asarray(self.correct.mean(axis=0))


def part(rows: Array, fraction: float) -> Array:
    """The first share of a walk's observations, two at least."""
    return rows[: max(2, round(fraction * len(rows)))]


def is_complete(rows: Array, low: Array, high: Array, margin: float = 0.6) -> bool:
    """Whether a walk leads from the border of the area to another place there, without standing about."""

    def outside(point: Array) -> bool:
        return bool((point < low + margin).any() or (point > high - margin).any())

    way = float(np.hypot(*np.diff(rows[:, :2], axis=0).T).sum())
    net = float(np.hypot(*(rows[-1] - rows[0])[:2]))
    return outside(rows[0, :2]) and outside(rows[-1, :2]) and net > 3.0 and way < 1.6 * net


def linear_exit(rows: Array, low: Array, high: Array) -> Array:
    """Where straight on leaves the area: linear extrapolation, which social forces follow."""
    state = estimate(rows, 1.5, 0.06).state
    ahead = state[2:]
    ends = [
        ((high if ahead[a] > 0.0 else low)[a] - state[a]) / ahead[a] for a in range(2) if abs(ahead[a]) > 1e-9
    ]
    return np.asarray(state[:2] + ahead * max(0.0, min(ends, default=0.0)))


def online(
    walks: list[Array],
    method: str,
    on_step: Callable[[], None] = lambda: None,
    ended: bool = False,
) -> Online:
    """Predict each walk's exit after each fraction, then learn it; the first ten are only learned.

    ended : a walk is learned only once it had ended when the next began, as a robot could; the text's protocol learns
    it at once, and so knows where the companions of the next have gone.
    """
    both = np.concatenate(walks)
    low, high = both[:, :2].min(axis=0), both[:, :2].max(axis=0)
    model = IntentionModel(IntentionConfig(method="ghmm" if method == "ghmm" else "routes"))
    if method in STAGES:
        model.routes = Routes(model.config.routes, STAGES[method])
    outcome = Online(np.zeros((0, len(FRACTIONS)), dtype=bool), model=model)
    correct, said = [], []
    waiting: list[Array] = []
    for k, walk in enumerate(walks):
        if k >= FIRST:
            row, sure = [], []
            for fraction in FRACTIONS:
                if method == "linear":
                    goal, first = linear_exit(part(walk, fraction), low, high), np.nan
                else:
                    goals, probabilities = model.intentions(part(walk, fraction), 10.0)
                    goal, first = goals[0], probabilities[0]
                sure.append(((1.0 - model.errors.elsewhere) * first, first))
                row.append(bool(np.hypot(*(goal - walk[-1, :2])) <= CORRECT))
            correct.append(row)
            said.append(sure)
        if method != "linear":
            waiting.append(walk)
            following = walks[k + 1][0, 2] if ended and k + 1 < len(walks) else np.inf
            for over in [other for other in waiting if other[-1, 2] < following]:
                begun = time.process_time()
                model.learn(over)
                outcome.learn_ms.append(1e3 * (time.process_time() - begun))
            waiting = [other for other in waiting if other[-1, 2] >= following]
        hmm = model.hmm
        outcome.sizes.append((len(hmm.places), len(hmm), hmm.edge_count))
        on_step()
    outcome.correct = np.array(correct, dtype=bool).reshape(-1, len(FRACTIONS))
    outcome.said = np.array(said, dtype=float).reshape(-1, len(FRACTIONS), 2)
    return outcome


def held_out(walks: list[Array], method: str, learned: int, judged: int, rng: np.random.Generator) -> Array:
    """Rates (fractions,) of correct exits of `judged` walks, each after `learned` others, all drawn at random.

    Times count from each walk's start: nothing is known about who comes together. Says what more walks are worth.
    """
    correct = []
    for k in rng.permutation(len(walks))[:judged]:
        walk = walks[k]
        others = rng.permutation([j for j in range(len(walks)) if j != k])[:learned]
        model = IntentionModel(IntentionConfig(method=method))
        for j in others:
            model.learn(walks[j] - [0.0, 0.0, walks[j][0, 2]])
        alone = walk - [0.0, 0.0, walk[0, 2]]
        goals = [model.intentions(part(alone, fraction), 10.0)[0][0] for fraction in FRACTIONS]
        correct.append([bool(np.hypot(*(goal - walk[-1, :2])) <= CORRECT) for goal in goals])
    return np.asarray(np.mean(correct, axis=0))


def _model(method: str) -> IntentionModel:
    return IntentionModel(IntentionConfig(method="routes" if method == "linear" else method))


def swing(walks: list[Array], method: str, count: int = 40) -> Array:
    """How much a predicted path moves when 0.5 s of observations arrive, m, per moment; the last `count` walks.

    The mean distance of two consecutive predictions at the same times, over the 5 s that both look at: what a robot
    that plans around the person would have to replan.
    """
    model = PrintedModel() if method == PRINTED else _model(method)
    fresh = IntentionModel()
    split = max(1, len(walks) - count)
    for walk in walks[:split]:
        model.learn(walk)
    moved = []
    for walk in walks[split:]:
        last: Array | None = None
        for t in np.arange(walk[0, 2] + 1.0, walk[-1, 2], 0.5):
            seen = walk[walk[:, 2] <= t]
            path = (fresh if method == "linear" else model).predict(seen, 5.5).path
            if last is not None:
                times = np.linspace(t, t + 5.0, 11)
                moved.append(float(np.hypot(*(at_times(path, times) - at_times(last, times)).T).mean()))
            last = path
        if method != "linear":
            model.learn(walk)
    return np.array(moved)


def displacement(
    people: dict[int, Array],
    method: str,
    others: bool = False,
    stride: int = 1,
) -> tuple[Array, Array]:
    """Errors (moments, 12) m at 0.4 s to 4.8 s ahead, and squared Mahalanobis distances of the same.

    method : "printed" (chapter 4 as printed, online), "learned" (online, people learned when their tracks end),
        "fresh" (nothing learned), "last step" or "mean of 8" (constant velocity of the last step, or over the 3.2 s).
    """
    model = PrintedModel() if method == PRINTED else IntentionModel()
    learns = method in ("learned", PRINTED)
    ended = sorted(people, key=lambda label: float(people[label][-1, 2]))
    errors, squares = [], []
    moments = [
        (label, k)
        for label in ended
        for k in range(OBSERVED, len(people[label]) - AHEAD + 1, stride)
        if people[label][k + AHEAD - 1, 2] - people[label][k - 1, 2] < 4.81
    ]
    moments.sort(key=lambda m: float(people[m[0]][m[1] - 1, 2]))
    learned = 0
    for label, k in moments:
        rows = people[label]
        now = float(rows[k - 1, 2])
        while learns and learned < len(ended) and people[ended[learned]][-1, 2] < now:
            model.learn(people[ended[learned]])
            learned += 1
        truth = rows[k : k + AHEAD]
        if method in ("last step", "mean of 8"):
            first = rows[k - 2] if method == "last step" else rows[k - OBSERVED]
            velocity = (rows[k - 1] - first)[:2] / (rows[k - 1, 2] - first[2])
            guess = rows[k - 1, :2] + velocity * (truth[:, 2:] - now)
        else:
            beside = None
            if others:
                beside = [
                    track[track[:, 2] <= now + 1e-6]
                    for other, track in people.items()
                    if other != label and track[0, 2] <= now <= track[-1, 2]
                ]
            told = model.predict(rows[:k], 4.8, others=beside)
            guess = at_times(told.path, truth[:, 2])
            index = np.searchsorted(told.path[:, 2], truth[:, 2] - 1e-6).clip(max=len(told.path) - 1)
            e = guess - truth[:, :2]
            squares.append(np.einsum("ti,tij,tj->t", e, np.linalg.inv(told.covariances[index]), e))
        errors.append(np.hypot(*(guess - truth[:, :2]).T))
    return np.array(errors), np.array(squares)
