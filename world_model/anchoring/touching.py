"""How the detector looks: how near two movers must come to be detected as one, and how often each sensor looks."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from world_model.anchoring.loops.kernels import SETTLED_HITS
from world_model.anchoring.loops.leaves import MOVING, IntArray, Leaves
from world_model.anchoring.loops.look import Look
from world_model.evidence import SensorCone

EDGES = 2.0 ** np.arange(1.0, 6.01, 0.5)
"""Bounds of the distances that are told apart, in standard deviations of a detection."""
EXPECTED = 16.0
"""Within this distance, in standard deviations, movers are expected to be detected as one until it shows that they are
not."""
OFTEN = 0.1  # Share of vanishing from which a distance counts
LEAST = 2.0
FADE = 0.9999


class Touching:
    """Counts, by distance to the nearest other mover, of movers that were detected again at the next look and that were
    not."""

    def __init__(self, detection_probability: float) -> None:
        self.usual = 4.0 * (1.0 - detection_probability)
        self.reset()

    def reset(self) -> None:
        """As before the first look."""
        expected = EDGES[1:] <= EXPECTED
        self.seen: FloatArray = np.where(expected, 2.0, 1.0)
        self.vanished: FloatArray = np.where(expected, 2.0, 0.0)
        self._before: dict[int, FloatArray] = {}

    def watch(self, alone: dict[int, FloatArray], known: set[int], sigma: float) -> None:
        """Take in a look: positions (3,) of movers that had a detection of their own, by track; tracks that exist."""
        before = {number: place for number, place in self._before.items() if number in known}
        self._before = alone
        if len(before) < 2 or sigma <= 0.0:
            return
        numbers = list(before)
        places = np.array([before[number] for number in numbers])
        apart = np.linalg.norm(places[:, None] - places[None], axis=2)
        np.fill_diagonal(apart, np.inf)
        cells = np.searchsorted(EDGES, apart.min(1) / sigma) - 1
        cells = np.maximum(cells, 0)
        gone = np.array([number not in alone for number in numbers])
        near = cells < len(self.seen)
        self.seen *= FADE
        self.vanished *= FADE
        np.add.at(self.seen, cells[near], 1.0)
        np.add.at(self.vanished, cells[near & gone], 1.0)

    def look(self, leaves: Leaves, best: dict[int, int], look: Look) -> None:
        """Take in a look; best : row of each track in its most probable hypothesis, -1 for none."""
        seen = look.seen
        if seen.lag > 0.0 or len(seen.positions) == 0:
            return
        alone = {}
        for number, slot in best.items():
            if slot < 0 or leaves.behavior[slot, MOVING] < 0.5 or leaves.hits[slot] < SETTLED_HITS:
                continue
            if leaves.last[slot] == seen.stamp and leaves.together[slot] == 0:
                alone[number] = leaves.moving[slot, :3].copy()
        spread = float(np.sqrt(np.median(seen.covariances.diagonal(axis1=1, axis2=2).max(1))))
        self.watch(alone, set(best), spread)

    @property
    def reach(self) -> float:
        """Distance, in standard deviations of a detection, at which the detector ceases to tell two movers apart."""
        often = (self.vanished >= LEAST) & (self.vanished / self.seen > max(OFTEN, self.usual))
        return float(EDGES[1:][often].max(initial=EDGES[0]))

    def metres(self, spread: FloatArray, usual: float) -> float:
        """The reach for detections with standard deviations spread (M,), m; `usual` where there are none."""
        return self.reach * (float(np.median(spread)) if len(spread) else usual)


def touched_by(leaves: Leaves, look: Look, gated: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Detections (n, M) so near to settled movers without one of their own that they may be of these and of others."""
    slots = look.chosen
    unseen = ~gated.any(1) & (leaves.behavior[slots, MOVING] > 0.5) & (leaves.hits[slots] >= SETTLED_HITS)
    near = np.zeros_like(gated)
    if unseen.any() and gated.shape[1]:
        apart = look.seen.positions[None] - leaves.moving[slots[unseen], None, :3]
        near[unseen] = (apart**2).sum(2) < look.reach**2
    return near


def sharing(leaves: Leaves, slots: IntArray, here: npt.NDArray[np.bool_]) -> FloatArray:
    """Probability (n,) of being there of leaves that may share a detection: settled movers; 0 for all others.

    What nobody believes in yet hides nobody. here (n,) : whether the look concerns a leaf.
    """
    moving = leaves.behavior[slots, MOVING]
    known = here & (moving > 0.5) & (leaves.hits[slots] >= SETTLED_HITS)
    return np.where(known, moving, 0.0)


LONGEST = 0.3  # s: no mover that nobody looks at is shown for longer
LOOKS = 1.5  # Looks of the other sensors for which a mover that one has lost is shown
NEAR, TURNED = 0.5, 0.35  # m and rad between two looks of one sensor at the most. Sensors have no names.
Pose = tuple[float, float, float]


class Rounds:
    """Sensors told apart by where they are and look to; one that has not looked for a second is forgotten."""

    def __init__(self) -> None:
        self._sensors: list[tuple[Pose | None, float, float]] = []
        self.patience = LONGEST

    def look(self, sensor: SensorCone | None, stamp: float, silent: bool) -> None:
        """Take a look in; `patience` is then how long, in seconds, a mover is shown that nobody looks at.

        silent : whether not being seen means nothing in this look.
        """
        if silent:
            self.patience = LONGEST
            return
        pose = (
            None if sensor is None else (float(sensor.pose[0]), float(sensor.pose[1]), float(sensor.pose[3]))
        )
        known = [entry for entry in self._sensors if 0.0 <= stamp - entry[1] < 1.0]
        same = [entry for entry in known if _one(entry[0], pose)]
        if same:
            last = max(same, key=lambda entry: entry[1])
            known.remove(last)
            period = stamp - last[1] or last[2]
        else:
            period = LONGEST
        # What this sensor saw and does not look for now has left its view; another may be about to look.
        self.patience = min(LONGEST, LOOKS * max((entry[2] for entry in known), default=0.0))
        self._sensors = [*known, (pose, stamp, period)]


def _one(a: Pose | None, b: Pose | None) -> bool:
    if a is None or b is None:
        return a is b
    turn = math.remainder(a[2] - b[2], 2.0 * math.pi)
    return math.hypot(a[0] - b[0], a[1] - b[1]) < NEAR and abs(turn) < TURNED
