"""What was seen, kept so that later evidence can correct which object it was (`revision`)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.loops.leaves import IntArray, Leaves
from world_model.calibration.revision import Explanation, Sightings, explain
from world_model.calibration.sensor_bias import within
from world_model.evidence import Measurements

FIRST_LOOKS = 100  # Looks of a sensor that has not moved; as many as are needed where nobody looks back
MOST_LOOKS = 4000  # Older looks are forgotten: what they said is in the places of objects


@dataclass
class KeptLook:
    """stamp, s; measured : M detections as they came, without their words; likelihood (M, A); owners (M,) : numbers of
    tracks; symbols (M,) : what was said of each detection then; rate (3,) : speed of the sensor, m/s and rad/s."""

    stamp: float
    measured: Measurements
    likelihood: FloatArray
    owners: list[int]
    symbols: tuple[str | None, ...]
    rate: FloatArray


def polar(measured: Measurements) -> tuple[FloatArray, FloatArray]:
    """Range and bearing of detections (M, 2) and their standard deviations."""
    assert measured.sensor is not None
    pose = measured.sensor.pose
    off = measured.positions[:, :2] - pose[:2]
    distance = np.maximum(np.hypot(off[:, 0], off[:, 1]), 1e-3)
    along = off / distance[:, None]
    across = np.stack([-along[:, 1], along[:, 0]], -1)
    spread = measured.covariances[:, :2, :2]
    sigma = [np.sqrt(np.einsum("ni,nij,nj->n", line, spread, line)) for line in (along, across)]
    bearing = within(np.arctan2(off[:, 1], off[:, 0]) - pose[3])
    return np.stack([distance, bearing], -1), np.stack([sigma[0], sigma[1] / distance], -1)


class Hindsight:
    """The looks of a moving sensor, and what explains them. most : how many are kept."""

    def __init__(self, most: int = MOST_LOOKS) -> None:
        self._most = most
        self.reset()

    def reset(self) -> None:
        """Nothing was seen."""
        self.looks: deque[KeptLook] = deque(maxlen=self._most)

    def add(self, look: KeptLook, moved: bool) -> None:
        """Keep a look. Of a sensor that has not moved, few are kept."""
        if not moved and len(self.looks) >= FIRST_LOOKS:
            self.looks.popleft()
        self.looks.append(look)

    def explained(
        self,
        numbers: list[int],
        slots: IntArray,
        movers: set[int],
        leaves: Leaves,
        blocks: IntArray,
        known: FloatArray,
    ) -> tuple[Explanation, list[list[int]]]:
        """Explain all looks by the resting objects `numbers` (K,), leaves `slots`; returns it, and tracks by look.

        Detections of `movers` stay theirs. known (8,) : calibration.
        """
        column = {number: k for k, number in enumerate(numbers)}
        mine = [[j for j, owner in enumerate(look.owners) if owner not in movers] for look in self.looks]
        index = np.repeat(np.arange(len(mine)), [len(which) for which in mine])
        parts = list(zip(self.looks, mine, strict=True))
        likelihood = np.concatenate([look.likelihood[which] for look, which in parts])
        unlike = np.zeros((len(index), len(numbers)))
        for begin, end in blocks.tolist():
            if end > begin:
                factor = likelihood[:, begin:end] @ leaves.attributes[slots, begin:end].T
                unlike -= 2.0 * np.log(factor + 1e-9)
        views = [polar(look.measured) for look in self.looks]
        stamps, rates = (
            np.array([look.stamp for look in self.looks]),
            np.array([look.rate for look in self.looks]),
        )
        poses = np.array([sensor.pose for look in self.looks if (sensor := look.measured.sensor) is not None])
        told = zip(views, mine, strict=True)
        seen, sigma = (
            np.concatenate(each) for each in zip(*((r[w], s[w]) for (r, s), w in told), strict=True)
        )
        data = Sightings(stamps, poses, index, seen, sigma, np.maximum(unlike, 0.0), rates)
        owner = np.array([column.get(look.owners[j], -1) for look, which in parts for j in which])
        begun = Explanation(leaves.rest[slots, :2].copy(), known.copy(), np.zeros((len(mine), 2)), owner)
        found = explain(data, begun, known)
        tracks = [list(look.owners) for look in self.looks]
        at = 0
        for look, which in zip(tracks, mine, strict=True):
            for j in which:
                look[j] = numbers[found.owner[at]] if found.owner[at] >= 0 else -1
                at += 1
        return found, tracks
