"""The table of sections 2.6.1 and 2.6.2: what anchoring says in each situation of the text."""

from __future__ import annotations

from typing import Any

import numpy as np

from evaluation.experiments.anchoring_scenes import known
from whereabouts.simulation.objects import ObjectScene, Thing
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldState

TABLE = ((-1.0, 1.0), (-1.0, 1.0), (0.0, 1.2))
SEES_ALL: dict[str, Any] = {"pose": (-1.5, 0.0, 1.0, 0.0), "range": 10.0, "angle": 2.0 * np.pi}
SIGMA = np.sqrt(0.0008)


def blob(rng: np.random.Generator, x: float, y: float, color: str, size: str, shape: str) -> ObjectEvidence:
    """A detection of the blob detector: each symbol with probability 0.8 (section 2.6.1)."""
    values = {
        "color": ("green", "red"),
        "size": ("small", "medium", "large"),
        "shape": ("square", "rectangle"),
    }
    attributes = {}
    for name, said in (("color", color), ("size", size), ("shape", shape)):
        others = [value for value in values[name] if value != said]
        attributes[name] = {said: 0.8} | {value: 0.2 / len(others) for value in others}
    position = np.array([x, y, 0.87]) + rng.normal(0.0, SIGMA, 3)
    return ObjectEvidence(position, SIGMA**2 * np.eye(3), attributes)


def dynamic_table(seed: int) -> list[tuple[str, str, str]]:
    """Section 2.6.1 in its three parts: (situation, the text's outcome, ours)."""
    rng = np.random.default_rng(seed)
    config = WorldModelConfig(
        colors=("green", "red"),
        region=TABLE,
        detection_probability=0.9,
        clutter_per_frame=0.05,
        new_objects_per_second=0.005,
        class_accuracy=0.8,
        motion={"*": {"model": "static", "accel_sigma": 0.5, "moved_per_second": 0.05}},
    )
    model = WorldModel(config)
    clock = 0.0

    def show(seconds: float, *things: Any, blocked: bool = False) -> WorldState:
        nonlocal clock
        for step in range(int(20 * seconds)):
            seen = (
                []
                if blocked
                else [blob(rng, *_at(thing, step / 20)) for thing in things if rng.random() < 0.9]
            )
            state = model.update(WorldEvidence(seen, None if blocked else SEES_ALL), clock)
            clock += 0.05
        return state

    box, can = (-0.5, 0.3, "green", "medium", "rectangle"), (0.0, -0.4, "green", "small", "square")
    tea = (0.5, 0.3, "red", "small", "square")
    before = show(3.0, box, can, tea)
    moved = show(3.0, (-0.5, 0.3, "green", "medium", "rectangle", 0.2), can, tea)
    rows = [("one of three is moved, 0.2 m/s", "followed", _same(before, moved, "followed"))]
    box = (0.1, 0.3, "green", "medium", "rectangle")
    show(4.0, blocked=True)
    cup = (0.4, -0.1, "red", "small", "square")
    after = show(2.0, box, can, cup)
    rows.append(
        (
            "out of sight, a red box is exchanged for a red cup, same symbols, elsewhere",
            "cup takes the box's identity",
            _same(moved, after, "cup takes the box's identity"),
        )
    )
    second = (-0.5, -0.3, "green", "medium", "rectangle")
    with_second = show(2.0, box, can, cup, second)
    rows.append(
        ("a second green box is added", "added", f"{len(with_second.objects) - len(after.objects)} added")
    )
    touching = (0.0, 0.3, "green", "medium", "rectangle")
    show(2.0, box, can, cup, touching)
    large = (0.05, 0.3, "green", "large", "rectangle")
    for _ in range(6):
        show(0.4, large, can, cup)
        last = show(0.4, box, touching, can, cup)
    ghosts = sum(item.most_probable("size") == "large" for item in last.objects)
    rows.append(
        (
            "it touches the first; detector says one large box now and then",
            "a large box is added",
            f"{ghosts} large",
        )
    )
    return rows


def _at(thing: tuple[Any, ...], seconds: float) -> tuple[Any, ...]:
    x, y, *symbols = thing
    speed = symbols.pop() if len(symbols) > 3 else 0.0
    return (x + speed * seconds, y, *symbols)


def _same(before: WorldState, after: WorldState, good: str) -> str:
    kept = {item.id for item in before.objects} == {item.id for item in after.objects}
    return good if kept else f"{len(after.objects)} objects, identities change"


def cups(often_new: bool, seed: int) -> list[WorldState]:
    """Section 2.6.2: a cup, a can and a box; all hidden from 5 to 9 s, then a cup elsewhere, from 12 s on all.

    often_new : the first setting, with a high probability of new cups; otherwise the second, where cups are moved.
    """
    places = [(-0.5, -0.5), (-0.5, 0.4), (0.0, 0.5), (0.2, -0.5)]
    kinds = ["box", "bottle", "cup", "cup"]
    things = [Thing(k, "red", np.array([x, y, 0.8])) for k, (x, y) in zip(kinds, places, strict=True)]
    scene = ObjectScene(
        things,
        TABLE,
        sensor=SEES_ALL,
        blocked=[(5.0, 9.0)],
        drop=[((0.0, 6.0), [3]), ((9.0, 12.0), [0, 1, 2])],
        clutter=0.01,
        seed=seed,
    )
    config = known(
        scene,
        new_objects_per_second=1.0 if often_new else 0.001,
        initial_objects=10.0 if often_new else 0.1,
        motion={"*": {"model": "static", "moved_per_second": 1e-5 if often_new else 0.01}},
    )
    model = WorldModel(config)
    states = []
    for seen in scene.looks(300):
        evidence = seen.evidence
        if 9.0 <= seen.stamp < 12.0:
            part = {"pose": (0.2, -2.0, 0.8, np.pi / 2.0), "range": 1.8, "angle": 0.6}
            evidence = WorldEvidence(evidence.objects, part)
        states.append(model.update(evidence, seen.stamp))
    return states


def cups_in_words(state: WorldState) -> str:
    """Symbols and places of the cups in the most probable world, and its probability."""
    found = [
        f"{item.id} at ({item.position[0]:.1f}, {item.position[1]:.1f})"
        for item in state.objects
        if item.most_probable("class") == "cup"
    ]
    return f"{', '.join(found)} (p = {state.probability:.2f})"
