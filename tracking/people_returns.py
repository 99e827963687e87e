"""Who was hidden and comes out elsewhere: known people are looked for among what has just appeared.

Out of sight people stop and turn. Where they appear again nobody can tell ahead, but that somebody will, and not far
away, is known: something that looks somewhat like a person there is more likely him than a stranger or a thing.
"""

from __future__ import annotations

import math

import numpy as np

from estimation.checks import FloatArray
from tracking.people_tracks import SURE, BoolArray, IntArray, Tracks

GONE_FOR = 0.25  # seconds without being seen from which somebody may come out elsewhere
LEAST_LOOKS = 0.15  # seconds that something must have been seen
ROAMING = 0.6  # m/s by which the places somebody may have gone to widen
TURNS = 0.4  # share of those out of sight for a while who turned
STAYING = 6.0  # seconds for which people stay about on average
STRANGERS = 1.0  # 1/m², things that appear where somebody has just vanished, and are not him
FARTHEST = 1.6  # m/s, nobody comes out farther away than that


def come_back(tracks: Tracks) -> BoolArray:
    """Hidden people take the place of what has appeared and is likelier them than not; (T,) those to be dropped."""
    dropped = np.zeros(len(tracks), dtype=bool)
    hidden = np.flatnonzero((tracks.public >= 0) & (tracks.hidden > GONE_FOR))
    young = np.flatnonzero((tracks.public < 0) & (tracks.hidden == 0.0) & (tracks.looks > LEAST_LOOKS))
    if not len(hidden) or not len(young):
        return dropped
    scores = _scores(tracks, hidden, young)
    while scores.size and scores.max() > 0.0:
        a, b = np.unravel_index(int(scores.argmax()), scores.shape)
        _take(tracks, int(hidden[a]), int(young[b]))
        dropped[young[b]] = True
        scores[a], scores[:, b] = -np.inf, -np.inf
    return dropped


def _scores(tracks: Tracks, hidden: IntArray, young: IntArray) -> FloatArray:
    """Log-odds (H, Y) that what has appeared is the hidden one."""
    time = tracks.hidden[hidden]
    roaming = (0.3**2 + (ROAMING * time) ** 2)[:, None, None] * np.eye(2)
    off, ahead = _density(
        tracks.means[hidden, :2], tracks.covariances[hidden][:, :2, :2] + roaming, tracks, young
    )
    # Or he turned behind what hides him, and comes out about where he went in.
    away, back = _density(tracks.spots[hidden], roaming, tracks, young)
    density = np.logaddexp(math.log(1.0 - TURNS) + ahead, math.log(TURNS) + back)
    # That he is not where he was expected does not say that he is gone.
    there = np.maximum(np.log(tracks.exists[hidden]), -time / STAYING)[:, None]
    scores = density + there - math.log(STRANGERS) + tracks.evidence()[young][None]
    scores -= 3.0 * np.maximum(0.0, tracks.oldness[young][None] - tracks.oldness[hidden][:, None])
    # What was there while he was still in view is not he.
    scores[tracks.age[young][None] > time[:, None] + 0.3] = -np.inf
    scores[np.minimum(off, away) > 0.7 + FARTHEST * time[:, None]] = -np.inf
    return np.asarray(scores)


def _density(
    places: FloatArray, covariances: FloatArray, tracks: Tracks, young: IntArray
) -> tuple[FloatArray, FloatArray]:
    """Distance, m, and logarithm of the density, 1/m², of what has appeared about some places; (H, Y) each."""
    off = tracks.means[young][None, :, :2] - places[:, None]
    square = np.einsum("hyi,hij,hyj->hy", off, np.linalg.inv(covariances), off)
    density = -0.5 * square - 0.5 * np.log(np.linalg.det(covariances))[:, None] - math.log(2.0 * math.pi)
    return np.asarray(np.hypot(off[..., 0], off[..., 1])), np.asarray(density)


def _take(tracks: Tracks, person: int, thing: int) -> None:
    """The person is where the thing was."""
    for name in (
        "means",
        "covariances",
        "origins",
        "last_seen",
        "extents",
        "rates",
        "oldness",
        "trails",
        "walking",
        "cruises",
        "bodies",
        "spots",
        "wholes",
        "part",
    ):
        getattr(tracks, name)[person] = getattr(tracks, name)[thing]
    tracks.existence[person] = min(max(tracks.existence[person], 0.0) + tracks.existence[thing], SURE)
    tracks.motion[person] = min(tracks.motion[person] + tracks.motion[thing], SURE)
    tracks.hidden[person] = tracks.doubled[person] = 0.0
