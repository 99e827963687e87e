"""How the detector looks: which movers may be detected as one, and how often each sensor looks."""

from __future__ import annotations

import math

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.geometry.rotations import wrap_scalar
from world_model.anchoring.loops.kernels import SETTLED_HITS
from world_model.anchoring.loops.leaves import MOVING, IntArray, Leaves
from world_model.anchoring.loops.look import Look
from world_model.evidence import SensorCone

TOUCHING = 12.0
"""Distance, in standard deviations of a detection, within which two movers may be detected as one."""


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
    turn = wrap_scalar(a[2] - b[2])
    return math.hypot(a[0] - b[0], a[1] - b[1]) < NEAR and abs(turn) < TURNED
