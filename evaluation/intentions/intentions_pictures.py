"""The pictures of `intentions`: each function draws one figure of chapter 4 and returns its path."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

from evaluation.drawing import saved
from evaluation.intentions.intentions_protocol import FIRST, FRACTIONS, Online
from tracking.intentions import IntentionModel, Prediction

Array = NDArray[np.float64]
COLOURS = ("C0", "C1", "C2", "C4", "C5", "C6", "C8", "C9")


def _save(figure: Figure, out: Path, name: str) -> Path:
    path = saved(figure, out / f"{name}.png", 90)
    # A palette is enough for lines, and a third of the bytes.
    with Image.open(path) as drawn:
        few = drawn.convert("RGB").quantize(64)
    few.save(path, optimize=True)
    return path


def fractions(out: Path, rates: Mapping[str, Array], theirs: Mapping[str, Sequence[float | None]]) -> Path:
    """Figure 4.9: correct exits over the share of the walk that was seen."""
    figure = Figure(figsize=(6, 3.8))
    axes = figure.subplots()
    share = 100.0 * np.array(FRACTIONS)
    for k, (name, values) in enumerate(rates.items()):
        axes.plot(share, values, "o-", color=COLOURS[k], label=name)
    for name, numbers in theirs.items():
        given = np.array([np.nan if number is None else number for number in numbers])
        known = np.isfinite(given)
        axes.plot(share[known], given[known], "x--", color="0.5", ms=5, label=f"theirs ({name}), 30 July")
    axes.set(xlabel="share of the walk seen, %", ylabel="correct exits", ylim=(0, 1))
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)
    return _save(figure, out, "figure-4-9-fractions")


def over_learned(out: Path, correct: Mapping[str, NDArray[np.bool_]]) -> Path:
    """Figure 4.8: ratio of correct exits up to each number of learned walks, after 20 and 40 % of the walk."""
    figure = Figure(figsize=(6, 3.8))
    axes = figure.subplots()
    for k, (name, right) in enumerate(correct.items()):
        count = np.arange(1, len(right) + 1)
        for fraction, style in ((0.2, "--"), (0.4, "-")):
            column = FRACTIONS.index(fraction)
            running = np.cumsum(right[:, column]) / count
            axes.plot(FIRST + count, running, style, color=COLOURS[k], label=f"{name}, {100 * fraction:g} %")
    axes.set(xlabel="walks learned", ylabel="correct exits so far", ylim=(0, 1))
    axes.legend(fontsize=7)
    axes.grid(alpha=0.3)
    return _save(figure, out, "figure-4-8-learned")


def growth(out: Path, outcome: Online) -> Path:
    """Figure 4.6: nodes, states and edges, and the time to learn, over the number of learned walks."""
    figure = Figure(figsize=(6, 3.8))
    axes = figure.subplots()
    sizes = np.array(outcome.sizes)
    for column, name in enumerate(("nodes", "states", "edges")):
        axes.plot(sizes[:, column], color=COLOURS[column], label=name)
    axes.set(xlabel="walks learned", ylabel="count")
    other = axes.twinx()
    other.plot(outcome.learn_ms, ".", color="0.4", ms=3, label="ms per walk")
    other.set(ylabel="ms per walk", yscale="log")
    axes.legend(loc="upper left", fontsize=8)
    return _save(figure, out, "figure-4-6-growth")


def manifolds(out: Path, model: IntentionModel, walks: Sequence[Array]) -> Path:
    """Figures 4.5 and 4.7: the topological map, and the three largest manifolds."""
    hmm = model.hmm
    places = hmm.places.positions
    figure = Figure(figsize=(10, 7.5))
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    goals, sizes = np.unique(hmm.goal, return_counts=True)
    largest = goals[np.argsort(-sizes, kind="stable")[:3]]
    for axes in panels.ravel():
        for walk in walks:
            axes.plot(walk[:, 0], walk[:, 1], color="0.85", lw=0.5, zorder=0)
        axes.set_aspect("equal")
    for i, j in hmm.places.edges:
        panels[0, 0].plot(*places[[i, j]].T, color="C0", lw=0.8)
    panels[0, 0].plot(*places[hmm.places.nodes].T, ".", color="C0", ms=4)
    panels[0, 0].set_title(f"topological map, {len(hmm.places)} nodes", fontsize=9)
    for axes, goal in zip(panels.ravel()[1:], largest, strict=False):
        states = np.flatnonzero(hmm.goal == goal)
        for s in states:
            for j in hmm.successors[s][hmm.successors[s] >= 0]:
                axes.plot(*places[[hmm.node[s], hmm.node[j]]].T, color="k", lw=0.6)
        axes.plot(*places[hmm.node[states]].T, "o", color="C3", ms=4)
        axes.plot(*places[goal], "o", color="C2", ms=11)
        axes.set_title(f"manifold with {len(states)} states", fontsize=9)
    panels[0, 0].invert_yaxis()
    return _save(figure, out, "figure-4-7-manifolds")


def consistency(out: Path, walks: Sequence[Array], complete: Sequence[Array]) -> Path:
    """Figures 4.10 and 4.11: one walk predicted again and again, learned and by straight lines."""
    chosen = max(complete[len(complete) // 2 :], key=lambda walk: float(np.hypot(*(walk[-1] - walk[0])[:2])))
    model, plain = IntentionModel(), IntentionModel()
    for walk in walks:
        if walk[-1, 2] < chosen[0, 2]:
            model.learn(walk)
    figure = Figure(figsize=(10, 7.5))
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, share in zip(panels.ravel(), (0.15, 0.25, 0.35, 0.6), strict=True):
        seen = chosen[: max(3, int(share * len(chosen)))]
        rest = float(chosen[-1, 2] - seen[-1, 2]) + 2.0
        told = model.predict(seen, rest)
        for walk in walks:
            axes.plot(walk[:, 0], walk[:, 1], color="0.9", lw=0.5, zorder=0)
        axes.plot(*chosen[:, :2].T, ":", color="C9", label="way it took")
        axes.plot(*plain.predict(seen, rest).path[:, :2].T, "--", color="C1", label="straight on")
        axes.plot(*told.path[:, :2].T, color="C2", label="predicted")
        axes.plot(*seen[:, :2].T, "x", color="C3", ms=3, label="seen")
        _goals(axes, told, "C6")
        axes.plot(*chosen[-1, :2], "*", color="C3", ms=10)
        axes.set_aspect("equal")
        axes.set_title(f"{100 * share:g} % seen", fontsize=9)
    panels[0, 0].legend(fontsize=7)
    panels[0, 0].set(xlim=(-1, 17), ylim=(12, -1))
    return _save(figure, out, "figure-4-11-consistency")


def scenes(out: Path, model: IntentionModel, walks: Sequence[Array], name: str) -> Path:
    """Figures 4.12 and 4.13: the four moments at which most people are walking, all predicted together."""
    times = np.arange(min(w[0, 2] for w in walks), max(w[-1, 2] for w in walks), 2.0)
    walking = [walk for walk in walks if np.hypot(*np.ptp(walk[:, :2], axis=0)) > 3.0]
    present = np.array([[walk[0, 2] + 1.0 < t < walk[-1, 2] - 2.0 for walk in walking] for t in times]).sum(
        axis=1
    )
    moments: list[float] = []
    for k in np.argsort(-present, kind="stable"):
        if all(abs(times[k] - moment) > 15.0 for moment in moments):
            moments.append(float(times[k]))
        if len(moments) == 4:
            break
    figure = Figure(figsize=(10, 8))
    panels = figure.subplots(2, 2, sharex=True, sharey=True)
    for axes, moment in zip(panels.ravel(), sorted(moments), strict=False):
        here = [walk for walk in walking if walk[0, 2] + 1.0 < moment < walk[-1, 2] - 2.0]
        seen = [walk[walk[:, 2] <= moment] for walk in here]
        for k, (walk, told) in enumerate(zip(here, model.predict_all(seen, 8.0), strict=True)):
            colour = COLOURS[k % len(COLOURS)]
            axes.plot(*seen[k][:, :2].T, "x", ms=3, color=colour)
            axes.plot(*told.path[:, :2].T, color=colour)
            for way in told.alternatives:
                axes.plot(*way.path[:, :2].T, color=colour, lw=0.5, alpha=0.6)
            axes.plot(*walk[-1, :2], "*", color=colour, ms=9)
            _goals(axes, told, colour, 1)
        axes.set_aspect("equal")
        axes.set_title(f"{len(here)} people, t = {moment:.0f} s", fontsize=9)
    low = np.min([walk[:, :2].min(axis=0) for walk in walks], axis=0) - 1.0
    high = np.max([walk[:, :2].max(axis=0) for walk in walks], axis=0) + 1.0
    panels[0, 0].set(xlim=(low[0], high[0]), ylim=(high[1], low[1]))
    return _save(figure, out, name)


def _goals(axes: Any, told: Prediction, colour: str, most: int = 3) -> None:
    for goal, probability in list(zip(told.goals, told.probabilities, strict=True))[:most]:
        axes.plot(*goal, "s", color=colour, ms=5, mfc="none")
        axes.annotate(
            f"{probability:.2f}", goal, fontsize=7, color=colour, xytext=(4, 4), textcoords="offset points"
        )
