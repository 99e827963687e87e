"""The joint model: which beams of a scan hit something that moves, and how it moved.

python examples/what_moves.py
"""

import numpy as np

from registration.crf import JointModel
from whereabouts.simulation import Lidar, Mover, joined, random_room

rng = np.random.default_rng(2)
room = random_room(rng, clutter=2)
lidar, pose = Lidar(beams=361), np.zeros(3)
walker = Mover("person", start=np.array([1.6, 0.6, 0.0]), velocity=np.array([0.0, -1.0]))

before, after = (
    lidar.scan(joined([room, walker.shapes(stamp, owner=1)]), pose, rng, stamp) for stamp in (0.0, 0.5)
)
estimate = JointModel.load().infer(before.scan, after.scan)
moving = estimate.clusters > 0
print(
    f"{moving.sum()} of {len(moving)} beams hit something that moves; {(before.owners == 1).sum()} hit the person"
)
for number, motion in enumerate(estimate.motions[1:], 1):
    beams = (estimate.clusters == number).sum()
    print(f"object {number} ({beams} beams) moved by {np.round(motion[:2], 2)} m in 0.5 s")
