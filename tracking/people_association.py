"""Which clusters are whose: every person has two legs, every leg one person; a linear assignment with two slots."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from estimation.assignment import cheapest
from estimation.checks import FloatArray
from tracking.people_config import PeopleConfig
from tracking.people_tracks import BoolArray, IntArray, Tracks

WIDE = 0.25  # metres, a cluster wider than that is both legs or a trunk
FARTHEST_LEGS = 0.9  # metres between the legs of a stride
TURN, TURNING = (
    0.3,
    0.05,
)  # metres by which somebody who turns is off his way, and how likely that is from scan to scan
FRESH = 1.5  # log-likelihood that what is where it was empty is a person who was near
SECOND_LEG = 0.5  # log-likelihood that a second leg costs: people have two, clutter is everywhere


@dataclass(frozen=True)
class Seen:
    """Clusters that may be of people, in the frame of the tracks.

    places (K, 2) : middle of the leg or trunk, m. widths, ranges (K,) m. shape (K,) : log-likelihood ratio person :
    other. fresh, old (K,) : share that lies where it was empty, where something stood. counts (K,) : returns.
    free (K,) : metres by which each stands in front of the surroundings, the lesser of both ends.
    depths (K,) : metres of the middle behind the returns. sights (K, 2) : from the scanner to each, of length 1.
    cut (K, 2) : whether something nearer hides what is next to the first, the last return. turning : 1 where beams turn
    to the left, -1 to the right.
    index (K,) : number of each among the scan's clusters.
    """

    places: FloatArray
    widths: FloatArray
    ranges: FloatArray
    shape: FloatArray
    fresh: FloatArray
    old: FloatArray
    counts: IntArray
    free: FloatArray
    depths: FloatArray
    sights: FloatArray
    cut: BoolArray
    turning: float
    index: IntArray

    def __len__(self) -> int:
        return len(self.widths)


def associate(
    tracks: Tracks, seen: Seen, config: PeopleConfig, steady: bool = True
) -> tuple[IntArray, FloatArray]:
    """Owners (K,) of the clusters, -1 without, and log-likelihood ratio owner : clutter of each (K,).

    steady : False where the frame of the tracks may have jumped: what was empty in it is not known.
    """
    owners = np.full(len(seen), -1, dtype=np.int64)
    scores = np.zeros(len(seen))
    if not len(tracks) or not len(seen):
        return owners, scores
    gains = _gains(tracks, seen, config, steady)
    # Both slots of a person; the second leg has to be worth it.
    both = np.concatenate((gains, gains - SECOND_LEG))
    rows, columns = cheapest(-np.maximum(both, 0.0))
    for row, column in zip(rows.tolist(), columns.tolist(), strict=True):
        if both[row, column] > 0.0:
            owners[column] = row % len(tracks)
            scores[column] = gains[row % len(tracks), column]
    _part_strangers(owners, scores, seen)
    return owners, scores


def _gains(tracks: Tracks, seen: Seen, config: PeopleConfig, steady: bool) -> FloatArray:
    """Log-likelihood ratio of cluster k coming from track t, (T, K); -inf outside the gate."""
    off = seen.places[None] - tracks.means[:, None, :2]
    noise = np.where(seen.widths > WIDE, config.body_noise, config.leg_noise) ** 2 + (0.01 * seen.ranges) ** 2
    S = tracks.covariances[:, None, :2, :2] + noise[None, :, None, None] * np.eye(2)
    determinant = S[..., 0, 0] * S[..., 1, 1] - S[..., 0, 1] ** 2
    square = (
        S[..., 1, 1] * off[..., 0] ** 2
        - 2.0 * S[..., 0, 1] * off[..., 0] * off[..., 1]
        + S[..., 0, 0] * off[..., 1] ** 2
    ) / determinant
    gains = -0.5 * square - 0.5 * np.log(determinant)
    # People turn on the spot, and are not where they were going.
    turned = determinant + TURN**2 * (S[..., 0, 0] + S[..., 1, 1]) + TURN**4
    distance = np.hypot(off[..., 0], off[..., 1])
    off_way = (square * determinant + TURN**2 * distance**2) / turned
    gains = np.maximum(gains, math.log(TURNING) - 0.5 * off_way - 0.5 * np.log(turned))
    gains -= math.log(2.0 * math.pi * config.clutter)
    # A person who was seen where nothing stood does not become a piece of furniture.
    gains += 0.5 * np.clip(seen.shape, -3.0, 2.0)[None]
    gains -= 3.0 * np.maximum(0.0, seen.old[None] - tracks.oldness[:, None])
    # Who was hidden may come out anywhere near; strangers out of nowhere are rarer than pieces of furniture.
    hidden = (tracks.shown & (tracks.hidden > 0.25)).astype(float)
    if steady:
        gains += FRESH * (tracks.shown & (tracks.hidden <= 0.25))[:, None] * seen.fresh[None]
    gains += hidden[:, None] * (0.5 * np.clip(seen.shape, 0.0, 2.0) + 1.5 * seen.fresh + 0.5)[None]
    gains += 0.15 * np.clip(tracks.existence, -SURE_GAIN, SURE_GAIN)[:, None]
    reach = config.gate + (0.5 + hidden) * np.sqrt(np.trace(tracks.covariances[:, :2, :2], axis1=1, axis2=2))
    gains[(distance > reach[:, None]) | (off_way > 16.0)] = -np.inf
    return np.asarray(gains)


SURE_GAIN = 6.0


def _part_strangers(owners: IntArray, scores: FloatArray, seen: Seen) -> None:
    """Two clusters of one track that are too far apart for legs, or are a trunk and a leg: the better one stays."""
    for owner in np.unique(owners[owners >= 0]):
        pair = np.flatnonzero(owners == owner)
        if len(pair) == 2:
            gap = np.linalg.norm(seen.places[pair[0]] - seen.places[pair[1]])
            if gap > FARTHEST_LEGS or seen.widths[pair].max() > 0.45:
                owners[pair[np.argmin(scores[pair])]] = -1
