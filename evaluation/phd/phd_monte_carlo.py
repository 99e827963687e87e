"""Monte Carlo runs of Section 5.2: new noise, returns and clutter on every run of one scene."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from evaluation.drawing import saved
from evaluation.phd.target_scores import Score, labels_kept
from evaluation.scenes.targets import (
    TargetScene,
    TargetSensor,
    cross_and_spawn,
    crossing,
    side_by_side,
)
from tracking import ExtendedTargetPhd, PhdConfig

SENSOR = TargetSensor()
SCENES = {"crossing and spawning": cross_and_spawn, "side by side": side_by_side}


def follow(scene: TargetScene, settings: dict[str, Any], seed: int | Sequence[int]) -> np.ndarray:
    """One run: OSPA, expected and reported number over the scans, (K, 3)."""
    score = scored(scene, settings, seed)
    return np.column_stack([score.ospa, score.expected, score.count])


def scored(
    scene: TargetScene, settings: dict[str, Any], seed: int | Sequence[int], births: Any = None
) -> Score:
    """One run's score; `births` as in PhdConfig, the text's where None.

    "association" among the settings: "pda" or "jpda" on clusters of returns.
    """
    rng = np.random.default_rng(seed)
    settings = dict(settings)
    association = settings.pop("association", None)
    if births is not None:
        settings["births"] = births
    tracker: Any = ExtendedTargetPhd(PhdConfig(**settings))
    if association is not None:
        from evaluation.peers.stone_soup_jpda import StoneSoupJpda

        tracker = StoneSoupJpda(PhdConfig(**settings), association == "jpda")
    score = Score(60.0)
    for k, there in enumerate(scene.positions):
        found = tracker.step(SENSOR.returns(there, rng), float(k))
        score.add(found, there, tracker.expected_count)
    return score


def crossing_kept(settings: dict[str, Any], seed: int | Sequence[int]) -> bool:
    """Whether both targets of a random crossing carry their labels from 12 scans before to 12 scans after it."""
    scene = crossing(np.random.default_rng([*np.atleast_1d(seed), 7]))
    births = [
        (0.1, np.array([*there, 0.0, 0.0]), np.diag([100.0, 100.0, 100.0, 100.0]))
        for there in scene.positions[0]
    ]
    score = scored(scene, settings, seed, births)
    middle = len(scene) // 2
    return labels_kept(score, scene.positions, middle - 12, middle + 12)


def draw(out: Path, name: str, runs: dict[str, np.ndarray], scene: TargetScene) -> Path:
    """Figures 3b and 3c: mean OSPA with one standard deviation, and mean expected number, over the scans."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    scans = np.arange(1, len(scene) + 1)
    for label, values in runs.items():
        mean, deviation = values[:, :, 0].mean(0), values[:, :, 0].std(0)
        (line,) = left.plot(scans, mean, label=label)
        left.fill_between(scans, mean - deviation, mean + deviation, alpha=0.15, color=line.get_color())
        right.plot(scans, values[:, :, 1].mean(0), label=label)
    right.plot(scans, [len(there) for there in scene.positions], "k:", label="true")
    left.set(xlabel="scan", ylabel="OSPA, m", ylim=(0, None))
    right.set(xlabel="scan", ylabel="expected number of targets", ylim=(0, 6))
    figure.legend(*left.get_legend_handles_labels(), fontsize=8, ncols=3, loc="outside lower center")
    return saved(figure, out / f"{name}.png", 75)
