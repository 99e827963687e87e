"""Where new targets are looked for among the returns of a scan, and all sources that may have caused these."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from tracking.mixture import association_kernels as kernels
from tracking.mixture.components import Components, IntArray
from tracking.mixture.hypothesis_kernels import single_linkage
from tracking.mixture.phd_models import Sight

# A place for new targets is narrow where its spread is within this many times that of a target's returns.
NARROW = 3.0
# Seeds for new targets per group of returns at most.
MOST_SEEDS = 8


@dataclass(frozen=True)
class ReturnLooks:
    """What is known of N returns beside their places; see `tracking.mixture.association_kernels` on looks and classes.

    log_clutter (N,) : of the density of clutter there. log_births (N,) : of that of new targets, per scan and m², and
    birth_class (N,) the probability that one is of the first class. look (N,) : log-likelihood ratio of the classes.
    exactness (N,) : by how much the variance of a return is smaller than usual, if it is all there is of a target.
    """

    log_clutter: FloatArray
    log_births: FloatArray
    birth_class: FloatArray
    look: FloatArray
    exactness: FloatArray


@dataclass
class Seeds:
    """Where new targets are looked for: places (B, 2), rows of sources, and their rows (B, 13) of the table."""

    places: FloatArray
    rows: list[int]
    table: FloatArray


@dataclass
class Predicted:
    """All sources of returns: tracks, places for new targets, and what splits off tracks, with their table (S, 13)."""

    sources: Components
    tracks: int
    births: int
    table: FloatArray
    seen: FloatArray
    sight: Sight
    gated: npt.NDArray[np.bool_]

    def spawn_rows(self, rows: tuple[int, ...]) -> list[int]:
        """Two rows for what may split off each track, none where nothing does."""
        first = self.tracks + self.births
        if first == len(self.sources):
            return []
        return [first + row for row in rows for _ in range(2)]


def narrow_places(predicted: Predicted, noise: float) -> npt.NDArray[np.bool_]:
    """Which places for new targets (B,) are about as small as a target's own returns, `noise` m."""
    P = predicted.sources.covariances[predicted.tracks : predicted.tracks + predicted.births]
    largest = np.maximum(P[:, 0, 0], P[:, 1, 1])
    narrow: npt.NDArray[np.bool_] = largest <= (NARROW * noise) ** 2
    return narrow


def seeds_among(
    predicted: Predicted,
    points: FloatArray,
    members: IntArray,
    narrow: npt.NDArray[np.bool_],
    link: float,
    looks: ReturnLooks | None,
) -> Seeds:
    """Where new targets may be looked for among the returns `members` (n,) of points (N, 2).

    narrow (B,) : `narrow_places`. link : m, up to which returns are of one cluster.
    """
    tracks = predicted.tracks
    gated = predicted.gated[tracks:][:, members]
    if not gated.any():
        return Seeds(np.zeros((0, 2)), [], np.zeros((0, kernels.COLUMNS)))
    near = np.flatnonzero(gated.any(1))
    rows = [tracks + b for b in near[narrow[near]].tolist()]
    places = [predicted.sources.means[row, :2] for row in rows]
    values = [predicted.table[row] for row in rows]
    wide = near[~narrow[near]]
    if len(wide):
        table = predicted.table[tracks + wide]
        size = table[:, kernels.PXX] * table[:, kernels.PYY] - table[:, kernels.PXY] ** 2
        whose = members[gated[wide].any(0)]
        clusters = _clusters(points[whose], link)[: max(MOST_SEEDS - len(rows), 0)]
        centres = np.array([centre for centre, _ in clusters]).reshape(-1, 2)
        square = (centres[:, :1] - table[:, kernels.MX]) ** 2 / table[:, kernels.PXX]
        square += (centres[:, 1:] - table[:, kernels.MY]) ** 2 / table[:, kernels.PYY]
        density = -kernels.LOG_TWO_PI - 0.5 * (square + np.log(size))
        likeliest = (table[:, kernels.ON] + density).argmax(1).tolist()
        for c, ((centre, near_it), best) in enumerate(zip(clusters, likeliest, strict=True)):
            value = table[best].copy()
            if looks is not None:
                value[kernels.ON] = looks.log_births[whose[near_it]].max() - density[c, best]
                value[kernels.CLASS] = looks.birth_class[whose[near_it]].max()
            rows.append(int(tracks + wide[best]))
            places.append(centre)
            values.append(value)
    return Seeds(np.array(places[:MOST_SEEDS]), rows[:MOST_SEEDS], np.array(values[:MOST_SEEDS]))


def _clusters(points: FloatArray, link: float) -> list[tuple[FloatArray, npt.NDArray[np.bool_]]]:
    """Centres of clusters of returns, and which are theirs, at two distances, the largest clusters first."""
    if len(points) == 1:
        return [(points[0], np.ones(1, dtype=bool))]
    wide, close = single_linkage(points, link), single_linkage(points, 0.5 * link)
    whole, part = np.bincount(wide), np.bincount(close)
    # What does not fall apart at the smaller distance is one and the same cluster.
    first = np.unique(close, return_index=True)[1]
    parts = np.flatnonzero(part < whole[wide[first]])
    inside = np.concatenate((wide == np.arange(len(whole))[:, None], close == parts[:, None]))
    sizes = np.concatenate((whole, part[parts]))
    chosen = np.argsort(-sizes, kind="stable")
    centres = (inside @ points) / sizes[:, None]
    return [(centres[k], inside[k]) for k in chosen.tolist()]
