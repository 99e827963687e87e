"""The world model: what a detector says becomes objects with names; they are remembered, missed, and asked for.

python examples/remember_objects.py
"""

import numpy as np

from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, ask

rng = np.random.default_rng(0)
model = WorldModel(WorldModelConfig(classes=("cup", "bowl"), colors=("red", "blue")))
sensor = {"pose": (0.0, 0.0, 1.2, 0.0), "range": 4.0, "angle": 1.2}  # what the camera could have seen
cup, bowl = np.array([1.5, 0.3, 0.8]), np.array([2.0, -0.5, 0.8])


def look(things: list, stamp: float):
    """One look of the detector at what is there."""
    found = [
        ObjectEvidence(
            place + rng.normal(0.0, 0.02, 3),
            np.eye(3) * 0.02**2,
            {"class": {name: 0.9, other: 0.1}, "color": {color: 0.8, rest: 0.2}},
        )
        for place, name, other, color, rest in things
    ]
    return model.update(WorldEvidence(found, sensor), stamp)


both = [(cup, "cup", "bowl", "red", "blue"), (bowl, "bowl", "cup", "blue", "red")]
for k in range(10):
    state = look(both, float(k))
for item in state.objects:
    print(f"{item.id} at {np.round(item.position, 2)} m, exists with {item.existence:.3f}")

for k in range(10, 20):  # somebody has taken the bowl
    state = look(both[:1], float(k))
print("now there:", ", ".join(item.id for item in state.objects if item.existence > 0.5))
print(ask(model, "where is the red cup").sentence)
