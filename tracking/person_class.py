"""The class of a target as a part of its state: log-odds that it is a person, from all that was seen of it.

Boosted trees over averages of the shape of its clusters, of how it moved and of where it stands. They are trained on
targets of the tracker itself, so that what a minute of looking at a table leg says is learned, not assumed.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, field
from functools import cache
from importlib import resources
from typing import TYPE_CHECKING

import numpy as np

from estimation.checks import FloatArray
from estimation.gradient_boosting import GradientBoosting
from tracking.target import Target

if TYPE_CHECKING:
    from tracking.cluster_model import ClusterScan
    from tracking.components import IntArray

MODEL = "person_class.json"
CARD = "person_class_card.json"
NAMES = (
    "looks",
    "shape",
    "shape_now",
    "shape_best",
    "shape_worst",
    "pairs",
    "width",
    "width_deviation",
    "gap",
    "free",
    "fresh",
    "arrived",
    "old",
    "around",
    "speed",
    "moved",
    "moved_fast",
    "walked",
    "sway",
    "turned",
    "range",
)
FIRST = 0.5  # s in which it shows whether something stands where it was empty before
SHORT, LONG = 0.5, 1.5  # s over which what is seen now, and walking, are averaged


@dataclass
class Evidence:
    """What was seen of one target: sums over its looks, in seconds.

    origin (2,) : where it was first, m. began, last_seen : stamps, s.
    """

    origin: FloatArray
    began: float
    last_seen: float = 0.0
    looks: float = 0.0
    sums: FloatArray = field(default_factory=lambda: np.zeros(12))
    now: float = 0.0
    best: float = -9.0
    worst: float = 9.0
    arrived: float = 0.0
    behind: FloatArray = field(default_factory=lambda: np.zeros(2))
    moved: float = 0.0
    fast: float = 0.0
    walked: float = 0.0
    views: list[float] = field(default_factory=list)

    def look(
        self,
        seen: ClusterScan,
        whose: IntArray,
        target: Target,
        pose: FloatArray,
        around: int,
        dt: float,
        stamp: float,
    ) -> None:
        """Takes in a scan in which the clusters `whose` are the target's, taken from `pose` (3,); none: not seen."""
        if not len(whose):
            return
        self.last_seen = stamp
        dt = min(max(dt, 1e-3), 0.5)
        if self.looks == 0.0:
            self.behind = target.mean[:2].copy()
        shape = float(np.clip(seen.shape[whose], -4.0, 4.0).mean())
        width, two = float(seen.widths[whose].sum()), len(whose) == 2
        gap = float(np.linalg.norm(seen.places[whose[0]] - seen.places[whose[1]])) if two else 0.0
        offset = target.mean[:2] - self.origin
        row = [
            1.0,
            shape,
            float(len(whose) > 1),
            width,
            width * width,
            gap,
            float(np.clip(seen.free[whose], -1.0, 1.0).mean()),
            float(seen.fresh[whose].mean()),
            float(seen.old[whose].mean()),
            float(around),
            float(seen.ranges[whose].mean()),
            float(np.hypot(*(seen.places[whose].mean(0) - target.mean[:2]))),
        ]
        self.sums += dt * np.array(row)
        if self.looks < FIRST:
            self.arrived += dt / (self.looks + dt) * (row[7] - self.arrived)
        share = 1.0 - math.exp(-dt / SHORT)
        self.now = shape if self.looks == 0.0 else self.now + share * (shape - self.now)
        self.looks += dt
        if self.looks > SHORT:
            self.best, self.worst = max(self.best, self.now), min(self.worst, self.now)
        self.moved = max(self.moved, float(np.hypot(*offset)))
        lag = target.mean[:2] - self.behind
        self.behind += (1.0 - math.exp(-dt / LONG)) * lag
        speed = float(np.hypot(*lag)) / LONG
        self.fast = max(self.fast, speed)
        self.walked += dt * float(speed > 0.3) * row[7]
        view = math.atan2(pose[1] - target.mean[1], pose[0] - target.mean[0])
        if not self.views or abs((view - self.views[-1] + math.pi) % (2.0 * math.pi) - math.pi) > 0.1:
            self.views.append(view)

    def features(self, target: Target) -> list[float]:
        """What the class is learned from, one number for each of `NAMES`."""
        total = max(self.sums[0], 1e-9)
        mean = self.sums / total
        return [
            min(self.looks, 20.0),
            mean[1],
            self.now,
            self.best if self.looks > SHORT else self.now,
            self.worst if self.looks > SHORT else self.now,
            mean[2],
            mean[3],
            math.sqrt(max(mean[4] - mean[3] ** 2, 0.0)),
            self.sums[5] / max(self.sums[2], 1e-9),
            mean[6],
            mean[7],
            self.arrived,
            mean[8],
            mean[9],
            float(np.hypot(*target.mean[2:])),
            min(self.moved, 5.0),
            self.fast,
            min(self.walked, 5.0),
            mean[11],
            float(min(len(self.views), 20)),
            mean[10],
        ]


@dataclass(frozen=True)
class ClassModel:
    """Boosted trees over `columns` of `NAMES`, and the log-odds `prior` that a target is a person."""

    trees: GradientBoosting
    columns: tuple[int, ...]
    prior: float

    def odds(self, features: list[list[float]]) -> FloatArray:
        """Log-odds (T,) that each target is a person, from its features (T, len(NAMES))."""
        if not features:
            return np.zeros(0)
        return self.trees.decision(np.array(features)[:, self.columns]) + self.prior


@cache
def class_model() -> ClassModel:
    """The model of the package."""
    folder = resources.files("tracking") / "models"
    card = json.loads((folder / CARD).read_text(encoding="utf-8"))
    with resources.as_file(folder / MODEL) as path:
        trees = GradientBoosting.load(path)
    return ClassModel(trees, tuple(NAMES.index(name) for name in card["features"]), float(card["prior"]))
