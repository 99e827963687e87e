"""People: who is in a simulated room, where, and how sure that is.

python examples/follow_people.py
"""

import numpy as np

from tracking import PeopleTracker
from whereabouts.simulation import Lidar, Mover, joined, random_room

rng = np.random.default_rng(4)
room = random_room(rng, clutter=0)
lidar, pose = Lidar(beams=361), np.zeros(3)
people = [
    Mover("person", start=np.array([1.5, -1.0, 0.0]), velocity=np.array([0.0, 0.6])),
    Mover("person", start=np.array([1.8, 1.2, 0.0]), velocity=np.array([-0.4, 0.0])),
]

tracker = PeopleTracker()
for stamp in np.arange(0.0, 3.0, 0.1):
    world = joined([room, *(person.shapes(stamp, owner=k + 1) for k, person in enumerate(people))])
    seen = tracker.step(lidar.scan(world, pose, rng, stamp).scan, pose, stamp)

for target in seen:
    speed = np.hypot(*target.mean[2:])
    print(
        f"person {target.label} at {np.round(target.mean[:2], 2)} m, {speed:.1f} m/s, weight {target.weight:.2f}"
    )
print(f"{len(tracker.targets)} things stand or move freely, people among them")
