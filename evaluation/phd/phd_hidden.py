"""Figure 4 in simulation: a person hidden by another, with constant and with variable detection probability."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from evaluation.drawing import saved
from evaluation.scenes.hidden_people import ENTRY, PERIOD, POSE, RANGE, hidden_person
from tracking import ExtendedTargetPhd, PhdConfig

# Table 1, experiments: standard deviation σ = 0.1 m, γ = 12, spawn 0.01.
BIRTHS = ((-9.0, 8.0), (-3.0, 11.0), (3.0, 11.0), (9.0, 8.0), (8.0, 3.0))
# What distinguishes `PhdConfig.as_printed` from the defaults.
PRINTED = {
    name: value
    for name, value in vars(PhdConfig.as_printed()).items()
    if name not in ("births", "spawn") and value != getattr(PhdConfig, name)
}
FILTERS: dict[str, tuple[dict[str, Any], bool]] = {
    "as printed, constant p_D": (PRINTED, False),
    "as printed, variable p_D": (PRINTED, True),
    "with sub-partitions, p_D by bodies": ({"filter": "phd"}, True),
    "mixture, constant p_D": ({}, False),
    "mixture, variable p_D": ({}, True),
    "mixture, variable p_D, own rates": ({"rate_spread": 0.5}, True),
}


@dataclass(frozen=True)
class HiddenRun:
    """Over the sweeps: expected and true numbers, and who was hidden when.

    followed : whether a target was within 1 m of the hidden person before, while and after. kept : under one label.
    """

    expected: np.ndarray
    truth: np.ndarray
    hidden: np.ndarray
    followed: bool
    kept: bool

    @property
    def jump(self) -> float:
        """Largest excess of the expected number over the true one from the beginning of the hiding on."""
        begin = int(np.flatnonzero(self.hidden)[0])
        return float((self.expected - self.truth)[begin:].max())

    @property
    def fall(self) -> float:
        """Largest shortfall while hidden and in the second after."""
        begin = int(np.flatnonzero(self.hidden)[0])
        return float((self.truth - self.expected)[begin : int(np.flatnonzero(self.hidden)[-1]) + 6].max())


def configuration(away: tuple[float, float], **settings: Any) -> PhdConfig:
    """The parameters of the experiment in Table 1: rates per sweep, seven places of birth around the area."""
    places = [(-6.0, away[0]), (5.0, away[1]), *BIRTHS]
    births = [(0.1 / len(places), np.array([x, y, 0.0, 0.0]), np.eye(4)) for x, y in places]
    return PhdConfig(
        surveillance=((-RANGE, RANGE), (0.0, RANGE)),
        clutter_rate=1.0,
        measurement_noise=0.1,
        measurement_rate=12.0,
        births=births,
        spawn=(0.01, 0.01 * np.eye(4)),
        scan_period=PERIOD,
        **settings,
    )


def follow(
    settings: dict[str, Any],
    variable: bool,
    seed: int | Sequence[int],
    speed: float,
    away: tuple[float, float],
) -> HiddenRun:
    """One run; with `variable` the filter is told where the scanner stands."""
    rng = np.random.default_rng([*np.atleast_1d(seed), round(100 * speed)])
    world = hidden_person(rng, speed, away)
    filter_ = ExtendedTargetPhd(configuration(away, **settings))
    expected, names = [], []
    for k, points in enumerate(world.returns):
        targets = filter_.step(points, PERIOD * k, POSE if variable else None)
        expected.append(filter_.expected_count)
        names.append({target.label: target.mean[:2] for target in targets})
    hidden = world.beams[:, 1] == 0
    hidden[: ENTRY[1] + 1] = False
    within = np.flatnonzero(hidden)
    before, after = int(within[0]) - 5, min(int(within[-1]) + 8, len(names) - 1)
    labels = [_nearest(names[k], world.scene.positions[k][1]) for k in (before, *within, after)]
    followed = None not in labels
    kept = followed and len(set(labels)) == 1
    truth = np.array([len(there) for there in world.scene.positions])
    return HiddenRun(np.array(expected), truth, hidden, followed, kept)


def _nearest(found: dict[int, np.ndarray], position: np.ndarray) -> int | None:
    """Label of the target within 1 m of a place."""
    away = {label: float(np.hypot(*(at - position))) for label, at in found.items()}
    label = min(away, key=lambda key: away[key], default=None)
    return label if label is not None and away[label] < 1.0 else None


def draw(out: Path, runs: dict[str, HiddenRun]) -> Path:
    """Figures 4c and 4d: expected number of targets over the sweeps."""
    figure = Figure(figsize=(7, 5))
    panels = figure.subplots(2, 1, sharex=True)
    for name, run in runs.items():
        panels[int(name.startswith("mixture"))].plot(run.expected, label=name)
    for axes, run in zip(panels, (next(iter(runs.values())),) * 2, strict=True):
        axes.plot(run.truth, "k:", lw=1, label="true")
        axes.fill_between(np.arange(len(run.hidden)), 0, 3, where=run.hidden, color="0.9", label="hidden")
        axes.set(ylabel="expected number", ylim=(0, 3))
        axes.legend(fontsize=7, loc="upper left")
    panels[1].set_xlabel(f"sweep ({PERIOD} s)")
    return saved(figure, out / "figure-4-hidden.png", 120)
