"""Identical movers in a box that merge and hide each other: the ants of section 2.6.3, whose videos are gone.

Ants walk at a few centimetres a second, turn, stop and start. Two closer than a body length are seen as one blob in
the middle, or the lower one is not seen at all, for as long as the encounter lasts.

The text gives neither speeds nor the length of encounters, but one of 13 images as a complication of one video, and
over 1,800 images in sixteen videos. Here an encounter lasts about 7 to 11 images, and a filter of constant velocity, as
the text has, mixes ants up within 113 images.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from world_model import ObjectEvidence, WorldEvidence

Array = NDArray[np.float64]


@dataclass(frozen=True)
class AntLook:
    """One image: evidence, true positions (N, 3) m, and per detection the ants behind it (none: clutter)."""

    stamp: float
    evidence: WorldEvidence
    truth: dict[int, Array]
    sources: tuple[tuple[int, ...], ...]


@dataclass
class AntScene:
    """`count` ants in a square of `side` metres, seen `rate` times a second.

    merge : distance below which two are seen as one, m. longest : looks after which one that is hidden is seen
    again. missed : probability of one being missed for no reason.
    """

    count: int = 20
    side: float = 0.3
    rate: float = 30.0
    speed: float = 0.02
    turning: float = 1.5
    merge: float = 0.008
    longest: int = 13
    sigma: float = 0.001
    missed: float = 0.02
    clutter: float = 0.05
    seed: int = 0

    def looks(self, count: int) -> Iterator[AntLook]:
        """`count` images."""
        rng = np.random.default_rng(self.seed)
        half = 0.5 * self.side
        position = rng.uniform(-half, half, (self.count, 2))
        heading = rng.uniform(-np.pi, np.pi, self.count)
        pace = rng.uniform(0.3, 1.5, self.count) * self.speed
        merged: dict[tuple[int, int], int] = {}
        dt = 1.0 / self.rate
        for k in range(count):
            heading = heading + self.turning * np.sqrt(dt) * rng.normal(size=self.count)
            pace = np.clip(
                pace + 0.5 * self.speed * np.sqrt(dt) * rng.normal(size=self.count), 0.0, 2.0 * self.speed
            )
            position = position + dt * pace[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])
            # At a wall they turn back.
            over = np.abs(position) > half
            heading = np.where(over[:, 0], np.pi - heading, heading)
            heading = np.where(over[:, 1], -heading, heading)
            position = np.clip(position, -half, half)
            yield self._look(k * dt, position, merged, rng)

    def _look(
        self, stamp: float, position: Array, merged: dict[tuple[int, int], int], rng: np.random.Generator
    ) -> AntLook:
        apart = np.linalg.norm(position[:, None] - position[None], axis=2)
        groups = list(range(self.count))
        for i in range(self.count):
            for j in range(i + 1, self.count):
                if apart[i, j] >= self.merge:
                    merged.pop((i, j), None)
                    continue
                merged[i, j] = merged.get((i, j), 0) + 1
                if merged[i, j] <= self.longest:
                    groups = [groups[i] if g == groups[j] else g for g in groups]
        found: list[tuple[tuple[int, ...], Array]] = []
        for label in sorted(set(groups)):
            members = tuple(i for i in range(self.count) if groups[i] == label)
            if rng.random() < self.missed:
                continue
            found.append((members, position[list(members)].mean(0)))
        for _ in range(rng.poisson(self.clutter)):
            found.append(((), rng.uniform(-0.5 * self.side, 0.5 * self.side, 2)))
        order = rng.permutation(len(found))
        covariance = self.sigma**2 * np.eye(3)
        evidence = [
            ObjectEvidence(
                [*(found[i][1] + rng.normal(0.0, self.sigma, 2)), 0.0], covariance, {"color": {"brown": 1.0}}
            )
            for i in order
        ]
        truth = {i: np.array([*position[i], 0.0]) for i in range(self.count)}
        return AntLook(stamp, WorldEvidence(evidence, ABOVE), truth, tuple(found[i][0] for i in order))


ABOVE = {"pose": (0.0, 0.0, 0.3, 0.0), "range": 2.0, "angle": 2.0 * np.pi}
