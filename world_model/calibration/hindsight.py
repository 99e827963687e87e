"""What was seen, kept so that later evidence can correct which object it was (`revision`)."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from estimation.checks import FloatArray
from world_model.anchoring.loops.leaves import IntArray, Leaves
from world_model.calibration.revision import Explanation, Sightings, explain
from world_model.calibration.sensor_bias import lines_of_sight
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
    distance, bearing, along = lines_of_sight(measured.positions[:, :2], measured.sensor.pose)
    across = np.stack([-along[:, 1], along[:, 0]], -1)
    spread = measured.covariances[:, :2, :2]
    sigma = [np.sqrt(np.einsum("ni,nij,nj->n", line, spread, line)) for line in (along, across)]
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
        counts = [len(look.owners) for look in self.looks]
        whose = np.concatenate([look.owners for look in self.looks])
        mine = ~np.isin(whose, np.array(sorted(movers), np.int64))
        index = np.repeat(np.arange(len(counts)), counts)[mine]
        likelihood = np.concatenate([look.likelihood for look in self.looks])[mine]
        unlike = np.zeros((len(index), len(numbers)))
        for begin, end in blocks.tolist():
            if end > begin:
                factor = likelihood[:, begin:end] @ leaves.attributes[slots, begin:end].T
                unlike -= 2.0 * np.log(factor + 1e-9)
        stamps = np.array([look.stamp for look in self.looks])
        rates = np.array([look.rate for look in self.looks])
        poses = np.array([sensor.pose for look in self.looks if (sensor := look.measured.sensor) is not None])
        views = zip(*(polar(look.measured) for look in self.looks), strict=True)
        seen, sigma = (np.concatenate(each)[mine] for each in views)
        data = Sightings(stamps, poses, index, seen, sigma, np.maximum(unlike, 0.0), rates)
        column = {number: k for k, number in enumerate(numbers)}
        owner = np.array([column.get(number, -1) for number in whose[mine].tolist()])
        begun = Explanation(leaves.rest[slots, :2].copy(), known.copy(), np.zeros((len(counts), 2)), owner)
        found = explain(data, begun, known)
        whose[mine] = np.append(numbers, -1)[found.owner]
        return found, [part.tolist() for part in np.split(whose, np.cumsum(counts)[:-1])]
