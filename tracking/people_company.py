"""Whether people are about: who walked lately is somewhere, and what looks like a person may be one of them.

How likely a cluster is of a person depends on the place: in an empty hall hardly ever, in a home where somebody walked
out of sight a minute ago quite likely. As many as walked at the same time are expected to be about for a while; while
one of them is unaccounted for, less evidence is asked for than of a stranger.
"""

from __future__ import annotations

import math

import numpy as np

from estimation.checks import FloatArray
from tracking.people_tracks import BoolArray, Tracks

WALKED = 7.0  # log-likelihood ratio of having walked from which somebody surely is a person
LATELY = 300.0  # seconds for which people who walked are expected to be about
ABOUT = 0.5  # log-odds by which a person is more likely where people are about
LOST, ARRIVED = 2.5, 3.0  # the same while one is unaccounted for, and where besides nothing stood before
MAYBE = (
    0.02  # probability of being a person from which it is kept out of the surroundings while people are about
)


class Company:
    """How many people are about.

    most : as many as walked here at the same time, fading. recent : 1 while somebody does, fading to 0.
    """

    def __init__(self) -> None:
        self.most = 0.0
        self.recent = 0.0

    def meet(self, tracks: Tracks, dt: float) -> None:
        """Count who is known to walk, `dt` seconds after the last scan."""
        keep = math.exp(-dt / LATELY)
        walked = tracks.shown & (tracks.motion > WALKED)
        self.most = max(self.most * keep, float(np.sum(walked)))
        self.recent = max(self.recent * keep, float(np.any(walked & (tracks.hidden == 0.0))))

    def unaccounted(self, tracks: Tracks) -> FloatArray:
        """How surely (T,) somebody is about who is none of those that are more surely people, in [0, 1]."""
        surer = np.where(tracks.shown, tracks.evidence(), -np.inf)
        others = np.sum(surer[None, :] > surer[:, None], axis=1)
        return np.asarray(np.clip(self.most - others, 0.0, 1.0))

    def prior(self, tracks: Tracks, alone: float) -> FloatArray:
        """Log-odds (T,) that each track is of a person before it was looked at; `alone` : where nobody is about."""
        more = (LOST + ARRIVED * tracks.arrived) * self.unaccounted(tracks)
        return np.asarray(alone + ABOUT * self.recent + more)

    def maybe(self, tracks: Tracks, alone: float) -> BoolArray:
        """Who may be a person (T,), so that he had better not be taken for a part of the surroundings."""
        likely = (tracks.person(self.prior(tracks, alone)) > MAYBE) & (self.recent > 0.05)
        return np.asarray(tracks.shown | likely)
