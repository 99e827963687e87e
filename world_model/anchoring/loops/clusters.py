"""Clusters: groups of tracks whose associations depend on each other, with their hypotheses (section 2.5.3).

Independent groups keep hypotheses of their own, so that cost adds up instead of multiplying.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.loops.leaves import IntArray
from world_model.state import Box


@dataclass
class Track:
    """One anchor: its number, its symbol once it is believed in, and whether a verification found it missing.

    born : densities (2,) of undetected objects where it was first seen, 1/m³, see `Unseen`; returned : how probably
    what is carried about has come there unseen. recognised : whether it has been compared with what was carried away.
    region : where it may be once it is lost, None for anywhere.
    """

    number: int
    cluster: int
    id: str | None = None
    lost: bool = False
    born: FloatArray = field(default_factory=lambda: np.zeros(2))
    returned: float = 1.0
    recognised: bool = False
    region: Box | None = None


@dataclass
class Cluster:
    """tracks (T,) : numbers. rows (H, T) : leaf of each track in each hypothesis, -1 for none, the most
    probable first. weights (H,) : their log probabilities, normalised."""

    tracks: list[int]
    rows: IntArray
    weights: FloatArray

    @property
    def lonely(self) -> bool:
        """One track, one hypothesis: nothing to decide but whether a detection is its own."""
        return self.rows.size == 1


def lonely(track: int, slot: int) -> Cluster:
    """The cluster of one track with one leaf."""
    return Cluster([track], np.array([[slot]]), np.zeros(1))


def combined(clusters: list[Cluster], keep: int, threshold: float) -> Cluster:
    """One cluster with the best combinations of hypotheses."""
    if len(clusters) == 1:
        return clusters[0]
    weights, picks = best_sums([cluster.weights for cluster in clusters], keep, threshold)
    rows = [cluster.rows[pick] for cluster, pick in zip(clusters, picks.T, strict=True)]
    return Cluster([track for cluster in clusters for track in cluster.tracks], np.hstack(rows), weights)


def best_sums(weights: list[FloatArray], keep: int, threshold: float = np.inf) -> tuple[FloatArray, IntArray]:
    """The best combinations of one hypothesis per cluster, those within `threshold` of the best: log weights (K,),
    choices (K, clusters)."""
    sums, picks = np.zeros(1), np.zeros((1, 0), np.int64)
    for own in weights:
        total = (sums[:, None] + own[None, :]).ravel()
        order = np.argsort(-total, kind="stable")[:keep]
        order = order[total[order] >= total[order[0]] - threshold]
        picks = np.column_stack([picks[order // len(own)], order % len(own)])
        sums = total[order]
    return sums, picks
