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


def dynamic_table(seed: int) -> list[tuple[str, str, bool]]:
    """Section 2.6.1 in its three parts: a name, what the text's run does, and whether this one does."""
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
    rows = [("moved", "one of three is moved at 0.2 m/s, all keep their identities", _same(before, moved))]
    box = (0.1, 0.3, "green", "medium", "rectangle")
    show(4.0, blocked=True)
    cup = (0.4, -0.1, "red", "small", "square")
    after = show(2.0, box, can, cup)
    said = "out of sight, a red box is exchanged for a red cup elsewhere, which takes its identity"
    rows.append(("exchanged", said, _same(moved, after)))
    second = (-0.5, -0.3, "green", "medium", "rectangle")
    with_second = show(2.0, box, can, cup, second)
    added = len(with_second.objects) == len(after.objects) + 1
    rows.append(("second box", "a second green box comes and is added", added))
    touching = (0.0, 0.3, "green", "medium", "rectangle")
    show(2.0, box, can, cup, touching)
    large = (0.05, 0.3, "green", "large", "rectangle")
    for _ in range(6):
        show(0.4, large, can, cup)
        last = show(0.4, box, touching, can, cup)
    ghost = any(item.most_probable("size") == "large" for item in last.objects)
    said = "the two touch and are now and then detected as a large one, which is added"
    rows.append(("false box", said, ghost))
    return rows


def _at(thing: tuple[Any, ...], seconds: float) -> tuple[Any, ...]:
    x, y, *symbols = thing
    speed = symbols.pop() if len(symbols) > 3 else 0.0
    return (x + speed * seconds, y, *symbols)


def _same(before: WorldState, after: WorldState) -> bool:
    return {item.id for item in before.objects} == {item.id for item in after.objects}


FIRST, SECOND = (0.0, 0.5), (0.2, -0.5)
"""m, places of the two cups of section 2.6.2."""


def cups(often_new: bool, seed: int) -> list[WorldState]:
    """Section 2.6.2: a cup, a can and a box; all hidden from 5 to 9 s, then a cup elsewhere, from 12 s on all.

    often_new : the first setting, with a high probability of new cups; otherwise the second, where cups are moved.
    """
    places = [(-0.5, -0.5), (-0.5, 0.4), FIRST, SECOND]
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


def ambiguous_cups(seed: int) -> list[tuple[str, str, bool]]:
    """Section 2.6.2 in both settings: a name, what the text's run says, and whether this one does."""
    rows = []
    likely, unlikely = cups(True, seed), cups(False, seed)
    one, other = (_named(states[90], FIRST) for states in (likely, unlikely))
    for when, at, said in (
        ("in part", 235, "new cups likely, only the second cup's place in view: it is new"),
        ("in view", -1, "new cups likely, all in view: it is new, as before"),
    ):
        new = _named(likely[at], FIRST) == one and _named(likely[at], SECOND) not in (None, one)
        rows.append((f"new cup {when}", said, new))
    said = "new cups unlikely, only the second cup's place in view: the first was moved there"
    rows.append(("moved cup in part", said, _named(unlikely[235], SECOND) == other))
    said = "new cups unlikely, all in view: corrected, the first never moved and the other is new"
    corrected = _named(unlikely[-1], FIRST) == other and _named(unlikely[-1], SECOND) not in (None, other)
    rows.append(("moved cup in view", said, corrected))
    return rows


def _named(state: WorldState, place: tuple[float, float]) -> str | None:
    """Who is within 15 cm of a place, None: nobody."""
    near = [item.id for item in state.objects if np.hypot(*(item.position[:2] - place)) < 0.15]
    return near[0] if len(near) == 1 else None
