"""What the people tracker remembers: potential people, their motion, existence and what speaks for being a person."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray

IntArray = npt.NDArray[np.int64]
BoolArray = npt.NDArray[np.bool_]

SURE = 8.0  # log-odds, the most that is believed of anything
SMOOTHLY = 0.15  # share of the usual acceleration with which somebody who walks does so out of sight
WALKS = 3.0  # log-likelihood ratio of having walked from which somebody is known to
GOES_ON = 2.5  # seconds out of sight after which somebody slows down
TRAIL = 16  # places remembered of everybody


@dataclass
class Tracks:
    """T potential people.

    names : number of each, for good. means (T, 4) x, y, vx, vy; covariances (T, 4, 4). existence : log-odds that there
    is something. shape, looks : mean log-likelihood ratio of its clusters, and the seconds it was seen in. motion :
    log-likelihood ratio from how it moved. origins (T, 2) : where it was a while ago; moved : farthest from there, m.
    age : seconds. last_seen : stamp. oldness : how much it stood where something stood before. extents (T, 2, 2);
    rates : returns per scan.
    hidden : seconds since it was seen. doubled : seconds for which it and a neighbour had one leg each.
    walking : the same from having walked just now, which fades.
    bodies (T, 3) : half the width and the depth of one round body, m, and how much of the time it is one.
    cruises (T, 2) : velocity over the last steps, m/s. spots (T, 2) : where it was when it was last seen, m.
    wholes (T, 2) : where it was when nothing hid a part of it, m; part : seconds since then.
    arrived : share of its first half second in which it stood where it was empty before.
    trails (T, TRAIL, 2) : where it was in the last one and a half seconds, the newest last, nan before it was there.
    public : label once reported, -1 before. shown : whether it is reported now.
    """

    names: IntArray
    means: FloatArray
    covariances: FloatArray
    existence: FloatArray
    shape: FloatArray
    looks: FloatArray
    motion: FloatArray
    origins: FloatArray
    moved: FloatArray
    age: FloatArray
    last_seen: FloatArray
    oldness: FloatArray
    extents: FloatArray
    rates: FloatArray
    public: IntArray
    shown: BoolArray
    hidden: FloatArray
    doubled: FloatArray
    trails: FloatArray
    walking: FloatArray
    bodies: FloatArray
    cruises: FloatArray
    spots: FloatArray
    wholes: FloatArray
    part: FloatArray
    arrived: FloatArray

    def __len__(self) -> int:
        return len(self.names)

    @classmethod
    def born(cls, names: IntArray, means: FloatArray, covariances: FloatArray, stamp: float) -> Tracks:
        """Tracks that are seen for the first time."""
        n = len(names)
        return cls(
            names,
            means,
            covariances,
            np.zeros(n),
            np.zeros(n),
            np.zeros(n),
            np.zeros(n),
            means[:, :2].copy(),
            np.zeros(n),
            np.zeros(n),
            np.full(n, stamp),
            np.zeros(n),
            np.zeros((n, 2, 2)),
            np.zeros(n),
            np.full(n, -1, dtype=np.int64),
            np.zeros(n, dtype=bool),
            np.zeros(n),
            np.zeros(n),
            np.full((n, TRAIL, 2), np.nan),
            np.zeros(n),
            np.zeros((n, 3)),
            np.zeros((n, 2)),
            means[:, :2].copy(),
            means[:, :2].copy(),
            np.zeros(n),
            np.zeros(n),
        )

    @classmethod
    def none(cls) -> Tracks:
        """No tracks."""
        return cls.born(np.zeros(0, dtype=np.int64), np.zeros((0, 4)), np.zeros((0, 4, 4)), 0.0)

    def select(self, index: BoolArray | IntArray) -> Tracks:
        """Those of an index or a mask, copied."""
        return Tracks(*(getattr(self, item.name)[index] for item in fields(self)))

    def joined(self, others: Tracks) -> Tracks:
        """These and others."""
        return Tracks(
            *(np.concatenate((getattr(self, item.name), getattr(others, item.name))) for item in fields(self))
        )

    def predict(self, dt: float, acceleration: float, memory: float) -> None:
        """`dt` seconds on at constant velocity; somebody hidden for long slows down and may have gone."""
        if not len(self):
            return
        F = np.eye(4)
        F[0, 2] = F[1, 3] = dt
        Q = np.zeros((4, 4))
        Q[0, 0] = Q[1, 1] = dt**3 / 3.0
        Q[0, 2] = Q[2, 0] = Q[1, 3] = Q[3, 1] = dt**2 / 2.0
        Q[2, 2] = Q[3, 3] = dt
        # Out of sight people mostly go on as they did.
        smoothly = np.where(self.motion > WALKS, SMOOTHLY, 0.5)
        q = np.where(self.hidden > 0.25, smoothly * acceleration, acceleration) ** 2
        self.means = self.means @ F.T
        self.covariances = F @ self.covariances @ F.T + q[:, None, None] * Q
        # Who is out of sight goes on for a while, but not for ever.
        slower = np.where(self.hidden > GOES_ON, math.exp(-dt / 1.5), 1.0)
        self.means[:, 2:] *= slower[:, None]
        self.age += dt
        self.part += dt
        survival = math.exp(-dt / memory)
        known = 1.0 / (1.0 + np.exp(-self.existence))
        stays = np.where(self.hidden > 0.0, known * survival, known)
        self.existence = np.minimum(np.log(stays / np.maximum(1.0 - stays, 1e-9)), SURE)

    def shift(self, motion: FloatArray) -> None:
        """Moves everything by `motion` (3,) x, y, yaw: the frame has jumped."""
        c, s = math.cos(motion[2]), math.sin(motion[2])
        turn = np.array([[c, s], [-s, c]])
        self.means[:, :2] = self.means[:, :2] @ turn + motion[:2]
        self.means[:, 2:] = self.means[:, 2:] @ turn
        self.cruises[:] = self.cruises @ turn
        self.origins[:] = self.origins @ turn + motion[:2]
        self.wholes[:] = self.wholes @ turn + motion[:2]
        self.spots[:] = self.spots @ turn + motion[:2]
        self.trails[:] = self.trails @ turn + motion[:2]
        both = np.kron(np.eye(2), turn.T)
        self.covariances[:] = both @ self.covariances @ both.T

    def evidence(self) -> FloatArray:
        """Log-likelihood ratio person : other of what was seen of each, (T,)."""
        # Looking longer at the same thing from the same side says less and less.
        weight = 0.35 + 0.65 * (1.0 - np.exp(-self.looks / 1.0))
        return np.asarray(1.75 * weight * self.shape + np.maximum(self.motion, self.walking))

    def person(self, prior: float | FloatArray) -> FloatArray:
        """Probability that each, if it exists, is a person, (T,)."""
        odds = prior + self.evidence()
        return np.asarray(1.0 / (1.0 + np.exp(-np.clip(odds, -SURE, SURE))))

    def within(self, distance: float) -> FloatArray:
        """Probability that each is within `distance` m of its estimate, (T,)."""
        variance = np.maximum(0.5 * (self.covariances[:, 0, 0] + self.covariances[:, 1, 1]), 1e-12)
        return np.asarray(1.0 - np.exp(-0.5 * distance**2 / variance))

    @property
    def exists(self) -> FloatArray:
        """Probability that each exists, (T,)."""
        return np.asarray(1.0 / (1.0 + np.exp(-self.existence)))
