"""The measurement model `clusters`: what one scan says of people and of whatever else stands free.

A target gives one or two clusters of returns, as a person does who shows two legs. Each measurement is the middle of a
cluster; the density of clutter at it is learned from what always stood there, and lower the more its shape is that of a
leg or a trunk. Whether a target can be seen at all is read off the scan (`tracking.mixture.occluders`).
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from functools import cache
from importlib import resources

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from registration.laser.scan import Scan
from tracking.mixture.components import Components, IntArray
from tracking.mixture.occluders import WEIGHTS, seen_shares, unseen_states
from tracking.mixture.phd_models import ConstantVelocityMotion, Sight
from tracking.people.free_space import Background
from tracking.people.legs import FEATURES, Clusters
from tracking.people.people_shape import ShapeModel
from tracking.people.people_sweep import Sweep

# Kinds of places: that were empty, where something stood, where nobody has looked, none of them; and any, where the
# surroundings are not known at all.
KINDS = ("empty", "stood", "unseen", "between", "any")
DENSITIES = "people_densities.json"
BoolArray = npt.NDArray[np.bool_]

# Speed of a walk, m/s; probability that who stands is about to walk; and seconds over which a velocity persists.
WALKS, STARTS, PERSISTS = 0.3, 0.05, 3.0
SHAPE = 2.0  # most that the shape of a cluster says against clutter, or for it, nat
WIDEST = 0.9  # m, of a cluster that can be a target
MOST_CLUSTERS = 400  # of a scan, the nearest; for speed
MOVING = 0.8  # how surely a beam lies where it was empty that registration says moves
FREE, FREER = FEATURES.index("jump_least"), FEATURES.index("jump_most")
OUTSTANDS = 0.05  # m by which a target stands in front of its surroundings on one side at least


@dataclass(frozen=True)
class Densities:
    """Log-densities (5,) by `KINDS`, 1/m²: of clutter per scan, of people and of things that come up per 0.1 s."""

    clutter: FloatArray
    people: FloatArray
    things: FloatArray


@cache
def densities() -> Densities:
    """Those of the package; `evaluation/people/people_density_training.py` learned them."""
    text = (resources.files("tracking.people") / "models" / DENSITIES).read_text(encoding="utf-8")
    known = json.loads(text)["densities"]
    return Densities(*(np.array(known[name]) for name in ("clutter", "people", "things")))


def kinds_of(empty: FloatArray, stood: FloatArray, unseen: FloatArray) -> FloatArray:
    """What a place is by the first four `KINDS`, (K, 4): shares that add up to 1."""
    kinds = np.column_stack((empty, stood, unseen))
    kinds /= np.maximum(kinds.sum(1, keepdims=True), 1.0)
    return np.column_stack((kinds, 1.0 - kinds.sum(1)))


@dataclass(frozen=True)
class ClusterScan:
    """K measurements of a scan in the frame of the tracks.

    places (K, 2) : middles, m. log_clutter (K,) : of the density of clutter there, 1/m². log_births (K,) : of that of
    new targets, 1/m² per 0.1 s; birth_class (K,) : probability that one is a person. kinds (K, 4) : what the place is
    by the first four `KINDS`, all 0 where the surroundings are not known. shape (K,) : log-likelihood ratio
    person : other. fresh, old (K,) : share that lies where it was empty, where something stood. widths (K,) m.
    free (K,) : m by which each stands in front of its surroundings. counts (K,) : returns. index (K,) : of each
    among `clusters`. thinned : whether there were more than are looked at.
    """

    places: FloatArray
    log_clutter: FloatArray
    log_births: FloatArray
    birth_class: FloatArray
    kinds: FloatArray
    shape: FloatArray
    fresh: FloatArray
    old: FloatArray
    widths: FloatArray
    free: FloatArray
    ranges: FloatArray
    counts: IntArray
    index: IntArray
    clusters: Clusters
    thinned: bool

    @classmethod
    def of(
        cls,
        scan: Scan,
        sweep: Sweep,
        clusters: Clusters,
        background: Background,
        model: ShapeModel,
        moving: BoolArray,
    ) -> ClusterScan:
        """The measurements of a scan; beams of `moving` (N,) hit what moves."""
        inside = clusters.labels >= 0
        fresh, old, unseen = background.evidence(sweep.points(inside), scan.ranges[inside])
        fresh = np.maximum(fresh, MOVING * moving[inside])
        names, counts = clusters.labels[inside], np.maximum(clusters.counts, 1)
        fresh = np.bincount(names, fresh, len(clusters)) / counts
        old = np.bincount(names, old, len(clusters)) / counts
        unseen = np.bincount(names, unseen, len(clusters)) / counts
        spacing = clusters.ranges * abs(scan.angle_increment)
        free, freer = clusters.features[:, FREE], clusters.features[:, FREER]
        enough = (clusters.counts >= 3) | ((clusters.counts == 2) & (spacing > 0.03)) | (spacing > 0.08)
        chosen = np.flatnonzero(enough & (clusters.widths < WIDEST) & (freer > OUTSTANDS))
        thinned = len(chosen) > MOST_CLUSTERS
        if thinned:
            chosen = chosen[np.argsort(clusters.ranges[chosen], kind="stable")[:MOST_CLUSTERS]]
        kinds = kinds_of(fresh[chosen], old[chosen], unseen[chosen]) * (not background.forgot)
        density = densities()
        known = np.column_stack((kinds, np.full(len(chosen), background.forgot)))
        persons, things = known @ density.people, known @ density.things
        log_births = np.logaddexp(persons, things)
        shape = model.evidence(clusters)[chosen]
        ranges = clusters.ranges[chosen]
        # Returns at equal steps across a round body lie π/4 of its radius before its middle, on average.
        behind = math.pi / 4.0 * 0.5 * (clusters.widths + spacing)[chosen]
        places = clusters.centres[chosen] * (1.0 + behind / np.maximum(ranges, 1e-9))[:, None]
        middles = (clusters.first[chosen] + clusters.last[chosen]) // 2
        return cls(
            sweep.placed(places, middles),
            known @ density.clutter,
            log_births,
            np.exp(persons - log_births),
            kinds,
            shape,
            fresh[chosen],
            old[chosen],
            clusters.widths[chosen],
            free[chosen],
            ranges,
            clusters.counts[chosen],
            chosen,
            clusters,
            thinned,
        )


class StandingOrWalking(ConstantVelocityMotion):
    """Two states with their moments matched: who stands hardly accelerates, who walks does, and slows down in the end.

    The probability of walking is that of a speed above `WALKS` by the state; at least `STARTS`, as anybody may start.
    Velocity decays over `PERSISTS`, so that somebody out of sight is somewhere, not everywhere.
    """

    def survivors(self, components: Components, dt: float) -> tuple[Components, FloatArray]:
        """Components dt seconds on, and their covariances (J, 4, 4) before process noise is added."""
        slower = np.exp(-dt / PERSISTS)
        F, Q = self.matrices(dt)
        F[0, 2] = F[1, 3] = PERSISTS * (1.0 - slower)
        F[2, 2] = F[3, 3] = slower
        moved = F @ components.covariances @ F.T
        square = (components.means[:, 2:] ** 2).sum(1)
        square += components.covariances[:, 2, 2] + components.covariances[:, 3, 3]
        walks = np.maximum(-np.expm1(-square / (2.0 * WALKS**2)), STARTS)
        means, covariances = components.means @ F.T, moved + walks[:, None, None] * Q
        return self.surviving(components, dt, means, covariances), moved


class ScanDetection:
    """p_D from the scan itself: how much of each target it could have shown, over the places where it may be."""

    def __init__(self, probability: float, max_range: float) -> None:
        """probability : of giving any cluster in plain view."""
        self.probability, self.max_range = probability, max_range
        self.scan: Scan | None = None

    def __call__(self, means: FloatArray, sensor_pose: FloatArray | None) -> FloatArray:
        """Probabilities (J,) with nothing in between."""
        return np.full(len(means), self.probability)

    def in_scene(
        self, components: Components, weights: FloatArray, tracks: int, sensor_pose: FloatArray | None
    ) -> Sight:
        """What the scan, taken from `sensor_pose` (3,), could show of the first `tracks`; of the others all of it."""
        sight = Sight.plain(self(components.means, sensor_pose), components)
        if sensor_pose is None or self.scan is None or tracks == 0:
            return sight
        c, s = np.cos(sensor_pose[2]), np.sin(sensor_pose[2])
        turn = np.array([[c, s], [-s, c]])
        means, P = components.means[:tracks], components.covariances[:tracks]
        shares, places = seen_shares(
            self.scan, (means[:, :2] - sensor_pose[:2]) @ turn.T, turn @ P[:, :2, :2] @ turn.T, self.max_range
        )
        probability = sight.probability.copy()
        all_means, covariances = components.means.copy(), components.covariances.copy()
        probability[:tracks] *= shares @ WEIGHTS
        # Who is not seen rather is where the scan could not show him.
        unseen_states(all_means, covariances, places @ turn, self.probability * shares, WEIGHTS)
        return Sight(probability, sight.share, all_means, covariances, sight.probability)
