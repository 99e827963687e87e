"""Which points move: boosted trees over the evidence of each point, its piece and what explains it.

What is said to move beyond the groups joins the object of its piece or the one beside it, or becomes one whose motion
nobody knows; what is said to stand goes back to the background.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from estimation.checks import FloatArray
from estimation.geometry.sight import AGREES
from estimation.learning.gradient_boosting import GradientBoosting
from registration.crf.beam_evidence import evidence, of_pieces
from registration.crf.setup import Start

MOVES = 1.5  # log odds, both equally likely beforehand, from which a point moves
LINK = 0.45  # metres between parts of one thing: two legs


def decided(
    begun: Start, labels: NDArray[np.int64], trees: GradientBoosting
) -> tuple[NDArray[np.int64], FloatArray]:
    """Clusters (n,) of the points of scan a and the probability (n,) that each moves.

    labels : (n,) by the groups alone (`groups_as_labels`).
    """
    a, odds = begun.a, trees.decision(evidence(begun, labels)) - MOVES
    # What lies between two hollow corners moves as a whole or not at all.
    moving = 1.0 / (1.0 + np.exp(-odds))
    probability = of_pieces(a.parts, moving[:, None], moving)[0][a.parts, 0]
    return with_movers(begun, labels, probability > 0.5), probability


def with_movers(begun: Start, labels: NDArray[np.int64], moves: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Clusters (n,) where what `moves` (n,), and nothing else, is above 0; new ones come after those of the groups."""
    a = begun.a
    clusters = np.where(moves, labels, np.where(begun.sight == AGREES, 0, -1))
    objects, loose = np.flatnonzero(moves & (labels > 0)), np.flatnonzero(moves & (labels <= 0))
    if len(objects) and len(loose):
        away, nearest = cKDTree(a.points[objects]).query(a.points[loose])
        of_piece = np.zeros(int(a.pieces.max()) + 1, dtype=np.int64)
        of_piece[a.pieces[objects]] = labels[objects]
        own = of_piece[a.pieces[loose]]
        clusters[loose] = np.where(own > 0, own, np.where(away < LINK, labels[objects[nearest]], 0))
        loose = loose[clusters[loose] <= 0]
    number = len(begun.found) + len(begun.gone) + 1
    while len(loose):
        first = loose[a.pieces[loose] == a.pieces[loose[0]]]
        group = loose[cKDTree(a.points[first]).query(a.points[loose])[0] < LINK]
        clusters[group] = number
        number += 1
        loose = np.setdiff1d(loose, group)
    return clusters
