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
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from estimation.checks import FloatArray
from estimation.geometry.poses import compound, transform_points
from estimation.learning.gradient_boosting import GradientBoosting
from tracking.mixture.target import Target
from tracking.people.cluster_model import WALKS, ClusterScan
from tracking.people.legs import FEATURES

if TYPE_CHECKING:
    from tracking.mixture.components import IntArray
    from tracking.people.identity import Origin

MODEL = "person_class.json"
CARD = "person_class_card.json"
# Of every look, averaged over the time a target was seen: what its clusters are like, and where they are.
AVERAGED = (
    "shape", "pairs", "width", "free", "cut", "fresh", "old", "around", "sway", "bulge", "radius",
    "circle_error", "slimness", "roughness", "filled", "depth",
)  # fmt: skip
# How much some of them vary, m or nat; `jitter` : of the place.
VARYING = ("width_deviation", "shape_deviation", "gap", "gap_deviation", "jitter")
# The course: how long it was looked at, how its shape changed, whether it arrived, how it moved.
COURSE = (
    "looks", "shape_now", "shape_best", "shape_worst", "pair_now", "fresh_now", "arrived", "stood",
    "speed", "drift", "away", "moved", "moved_fast", "walked", "turned", "posed", "carried",
)  # fmt: skip
NAMES = (*AVERAGED, *VARYING, *COURSE)
SHAPE, WIDTH = AVERAGED.index("shape"), AVERAGED.index("width")
# s over which what is seen now, and walking, are averaged; in the first it shows whether it stands where it was empty.
SHORT, LONG = 0.5, 1.5
LONGEST, FARTHEST, VIEWS = 20.0, 5.0, 20  # s, m and sides beyond which a target is no better known
_CLUSTER = [
    FEATURES.index(name)
    for name in ("bulge", "circle_radius", "circle_error", "slimness", "roughness", "filled", "depth")
]


class ScanLook(NamedTuple):
    """A scan as looked at: clusters and what is averaged of each, (K, len(AVERAGED)) by `rows_of`; pose (3,) of the
    scanner, whether it is known, stamp, and dt since the scan before, s."""

    seen: ClusterScan
    rows: FloatArray
    pose: FloatArray
    dt: float
    stamp: float
    posed: bool


@dataclass
class ClassEvidence:
    """What was seen of one target: means over the time it was looked at, and its course.

    origin (2,) : where it was first, m. unseen : share of it where nobody had looked by then. before : who it may be
    that was known before. own : probability that it is a person by its own looks,
    from `SHORT` on, and of any newcomer there before. last_seen : stamp, s.
    looks : s it was seen for. means (len(AVERAGED),); squares (2,) : means of width² and shape². pairs (3,) : seconds
    with two clusters, and their gap and gap² by them. place, spread : means of where its clusters were and of that
    squared, m from the origin and m². now, fresh, returns : of the last half second. behind (2,) : where it was a
    while ago, m. views : it was seen from, rad.
    first_pose (3,) : it was seen from. carried : m at most that the scanner's own motion since then would have moved it
    in the scanner's frame: who looks at rest errs in no pose.
    """

    origin: FloatArray
    unseen: float = 0.0
    before: Origin | None = None
    own: float = 1.0
    last_seen: float = 0.0
    looks: float = 0.0
    means: FloatArray = field(default_factory=lambda: np.zeros(len(AVERAGED)))
    squares: FloatArray = field(default_factory=lambda: np.zeros(2))
    pairs: FloatArray = field(default_factory=lambda: np.zeros(3))
    place: FloatArray = field(default_factory=lambda: np.zeros(2))
    spread: float = 0.0
    returns: float = 0.0
    now: float = 0.0
    fresh: float = 0.0
    pair: float = 0.0
    best: float = -math.inf
    worst: float = math.inf
    arrived: float = 0.0
    stood: float = 0.0
    behind: FloatArray = field(default_factory=lambda: np.zeros(2))
    drift: float = 0.0
    moved: float = 0.0
    fast: float = 0.0
    walked: float = 0.0
    posed: float = 1.0
    views: list[float] = field(default_factory=list)
    carried: float = 0.0
    first_pose: FloatArray | None = None

    def look(self, view: ScanLook, whose: IntArray, target: Target, around: int) -> None:
        """Takes in a scan in which the clusters `whose` are the target's, none: not seen, and `around` others near."""
        if not len(whose):
            return
        seen, rows = view.seen, view.rows
        self.last_seen = view.stamp
        dt = min(max(view.dt, 1e-3), 0.5)
        if self.looks == 0.0:
            self.behind = target.mean[:2].copy()
        places, one = seen.places[whose], len(whose) == 1
        px, py = (places[0] if one else places.mean(0)).tolist()
        row = rows[whose[0]].copy() if one else rows[whose].mean(0)
        x, y = target.mean[:2].tolist()
        # Of two clusters the widths add up, and one that is cut cuts both.
        row[1], row[2], row[4] = not one, len(whose) * row[2], row[4] > 0.0
        row[7], row[8] = around, math.hypot(px - x, py - y)
        shape, width, fresh, old = float(row[0]), float(row[2]), float(row[5]), float(row[6])
        whole = dt / (self.looks + dt)
        self.means += whole * (row - self.means)
        self.posed += whole * (float(view.posed) - self.posed)
        self.squares[0] += whole * (width * width - self.squares[0])
        self.squares[1] += whole * (shape * shape - self.squares[1])
        mx, my = px - float(self.origin[0]), py - float(self.origin[1])
        self.place[0] += whole * (mx - self.place[0])
        self.place[1] += whole * (my - self.place[1])
        self.spread += whole * (mx * mx + my * my - self.spread)
        if len(whose) == 2:
            (ax, ay), (bx, by) = places.tolist()
            gap = math.hypot(ax - bx, ay - by)
            self.pairs += dt * np.array([1.0, gap, gap * gap])
        self.pair = float(not one)
        if self.looks < SHORT:
            self.arrived += whole * (fresh - self.arrived)
            self.stood += whole * (old - self.stood)
        share = 1.0 - math.exp(-dt / SHORT) if self.looks > 0.0 else 1.0
        self.now += share * (shape - self.now)
        self.returns += share * (float(sum(seen.counts[whose].tolist())) - self.returns)
        self.fresh += share * (fresh - self.fresh)
        self.looks += dt
        if self.looks > SHORT:
            self.best, self.worst = max(self.best, self.now), min(self.worst, self.now)
        self._moved(x, y, fresh, dt)
        at = view.pose.tolist()
        self._carried_by(at, x, y)
        side = math.atan2(at[1] - y, at[0] - x)
        if not self.views or abs((side - self.views[-1] + math.pi) % (2.0 * math.pi) - math.pi) > 0.1:
            self.views.append(side)

    def shift(self, motion: FloatArray) -> None:
        """Takes what was seen along with its frame, which moved by (3,) x, y, yaw."""
        self.origin, self.behind = transform_points(motion, np.array([self.origin, self.behind]))
        self.place = transform_points([0.0, 0.0, motion[2]], self.place)
        self.views = [view + motion[2] for view in self.views]
        if self.first_pose is not None:
            self.first_pose = compound(motion, self.first_pose)

    def _carried_by(self, pose: list[float], tx: float, ty: float) -> None:
        """Where who stands at (tx, ty) was in the scanner's frame at the first look, against where it is in it now."""
        if self.first_pose is None:
            self.first_pose = np.array(pose)
        x, y, yaw = self.first_pose.tolist()
        ax, ay, bx, by = tx - x, ty - y, tx - pose[0], ty - pose[1]
        c, s = math.cos(pose[2] - yaw), math.sin(pose[2] - yaw)
        self.carried = max(self.carried, math.hypot(c * ax - s * ay - bx, s * ax + c * ay - by))

    def _moved(self, x: float, y: float, fresh: float, dt: float) -> None:
        """How it moved to (x, y) since the last look, which was `dt` seconds ago."""
        self.moved = max(self.moved, math.hypot(x - float(self.origin[0]), y - float(self.origin[1])))
        dx, dy = x - float(self.behind[0]), y - float(self.behind[1])
        share = 1.0 - math.exp(-dt / LONG)
        self.behind[0] += share * dx
        self.behind[1] += share * dy
        self.drift = math.hypot(dx, dy) / LONG
        self.fast = max(self.fast, self.drift)
        self.walked += dt * float(self.drift > WALKS) * fresh

    def features(self, target: Target) -> list[float]:
        """What the class is learned from, one number for each of `NAMES`."""
        means, (width_square, shape_square) = self.means.tolist(), self.squares.tolist()
        shape, width = means[SHAPE], means[WIDTH]
        seconds, gap, square = self.pairs.tolist()
        gap, square = gap / max(seconds, 1e-9), square / max(seconds, 1e-9)
        (px, py), known = self.place.tolist(), self.looks > SHORT
        x, y, vx, vy = target.mean.tolist()
        varying = [
            _deviation(width_square - width * width),
            _deviation(shape_square - shape * shape),
            gap,
            _deviation(square - gap * gap),
            min(_deviation(self.spread - (px * px + py * py)), 3.0),
        ]
        course = [
            min(self.looks, LONGEST),
            self.now,
            self.best if known else self.now,
            self.worst if known else self.now,
            self.pair,
            self.fresh,
            self.arrived,
            self.stood,
            math.hypot(vx, vy),
            self.drift,
            min(math.hypot(x - float(self.origin[0]), y - float(self.origin[1])), FARTHEST),
            min(self.moved, FARTHEST),
            self.fast,
            min(self.walked, FARTHEST),
            float(min(len(self.views), VIEWS)),
            self.posed,
            min(self.carried, FARTHEST),
        ]
        return [*means, *varying, *course]


def rows_of(seen: ClusterScan) -> FloatArray:
    """Each cluster of a scan by `AVERAGED`, (K, 16); what depends on whose it is, is 0."""
    rows = np.zeros((len(seen.places), len(AVERAGED)))
    rows[:, 0], rows[:, 3] = np.clip(seen.shape, -4.0, 4.0), np.clip(seen.free, -1.0, 1.0)
    rows[:, 2], rows[:, 4] = seen.widths, seen.free < 0.0
    rows[:, 5], rows[:, 6] = seen.fresh, seen.old
    rows[:, 9:] = seen.clusters.features[seen.index][:, _CLUSTER]
    return rows


def _deviation(variance: float) -> float:
    return math.sqrt(max(variance, 0.0))


@dataclass(frozen=True)
class ClassModel:
    """Boosted trees over `NAMES`; `scale` and `prior` make their log-odds those that were observed."""

    trees: GradientBoosting
    scale: float
    prior: float

    def odds(self, features: list[list[float]]) -> FloatArray:
        """Log-odds (T,) that each target is a person, from its features (T, len(NAMES))."""
        if not features:
            return np.zeros(0)
        return self.scale * self.trees.decision(np.array(features)) + self.prior


@cache
def class_model() -> ClassModel:
    """The model of the package."""
    folder = resources.files("tracking.people") / "models"
    card = json.loads((folder / CARD).read_text(encoding="utf-8"))
    with resources.as_file(folder / MODEL) as path:
        trees = GradientBoosting.load(path)
    return ClassModel(trees, float(card["scale"]), float(card["prior"]))
