"""Recognising a new anchor as a known object that was carried: section 2.6.2.

That a detection far from everything known is a known object, carried there, is as likely at the first detection as
at any later one, because both this object and a new one may be anywhere. So it is weighed once, when the new
anchor is first believed in, and kept as a hypothesis beside the other until evidence decides: whether the old
place is found empty or the known object is found there after all.
"""

from __future__ import annotations

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.clusters import Cluster, Track
from world_model.anchoring.leaves import AWAY, MOVING, REST, IntArray, Leaves

RETURN_SECONDS = 10.0
"""Mean time for which a carried object is out of sight."""
LEAST_ODDS = 1e-3
MOST_CANDIDATES = 3


def away_probability(leaves: Leaves, slots: IntArray, carried: FloatArray, stamp: float) -> FloatArray:
    """Probability (n,) of each leaf's object having been carried away by `stamp`; carried (n,) rates, 1/s."""
    pi = leaves.behavior[slots]
    elapsed = np.maximum(stamp - leaves.stamp[slots], 0.0)
    result: FloatArray = pi[:, AWAY] + (1.0 - np.exp(-carried * elapsed)) * (pi[:, REST] + pi[:, MOVING])
    return result


def agreement(a: FloatArray, b: FloatArray, blocks: IntArray) -> FloatArray:
    """How much likelier equal attributes (n, A) and (A,) are of one object than of two."""
    out = np.ones(len(a))
    for start, end in blocks:
        if end > start:
            out *= (end - start) * (a[:, start:end] * b[start:end]).sum(1)
    return out


def odds(
    leaves: Leaves,
    slots: IntArray,
    new: int,
    track: Track,
    carried: FloatArray,
    blocks: IntArray,
    volume: float,
) -> FloatArray:
    """Odds (n,) of the new leaf being each of the known objects against its being new."""
    gone = away_probability(leaves, slots, carried, float(leaves.first[new]))
    back = 1.0 - np.exp(-track.unwatched / RETURN_SECONDS)
    alike = agreement(leaves.attributes[slots], leaves.attributes[new], blocks)
    result: FloatArray = gone * back / volume / max(track.born, 1e-300) * alike
    result[leaves.last[slots] >= leaves.first[new]] = 0.0
    return result


def candidates(values: FloatArray) -> IntArray:
    """Indices of the few worth a hypothesis, the likeliest first."""
    order = np.argsort(-values, kind="stable")[:MOST_CANDIDATES]
    if len(order) == 0:
        return order
    return order[values[order] > max(LEAST_ODDS, 0.02 * values[order[0]])]


def alternatives(
    whole: Cluster, new: int, known: int, values: dict[int, float]
) -> list[tuple[int, int, int, float]]:
    """Rows to add where the known track is the new anchor: (row, leaf of new, leaf of known, log weight).

    new, known : columns. values : odds by leaf of the known object.
    """
    out = []
    for h, row in enumerate(whole.rows.tolist()):
        if row[new] >= 0 and row[known] >= 0 and values.get(row[known], 0.0) > 0.0:
            out.append((h, row[new], row[known], float(whole.weights[h]) + float(np.log(values[row[known]]))))
    return out
