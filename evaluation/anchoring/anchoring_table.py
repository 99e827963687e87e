"""The table of sections 2.6.1 and 2.6.2: what anchoring says in each situation of the text."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from evaluation.anchoring.anchoring_blobs import Blob, detection
from evaluation.anchoring.anchoring_scenes import known
from whereabouts.simulation.objects import ObjectScene, Thing
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldState

TABLE = ((-1.0, 1.0), (-1.0, 1.0), (0.0, 1.2))
SEES_ALL: dict[str, Any] = {"pose": (-1.5, 0.0, 1.0, 0.0), "range": 10.0, "angle": 2.0 * np.pi}


# Table 2.1, and the two boxes that touch as one blob.
GREEN, RED = (40.0, 150.0, 120.0), (172.0, 176.0, 120.0)
BOX = Blob(-0.5, 0.3, GREEN, 0.2, 0.09)
SECOND_BOX = Blob(-0.5, -0.3, GREEN, 0.18, 0.08)
CAN = Blob(0.0, -0.4, GREEN, 0.08, 0.09)
TEA = Blob(0.5, 0.3, RED, 0.07, 0.07)
CUP = Blob(0.4, -0.1, RED, 0.08, 0.085)
BOTH = Blob(0.05, 0.3, GREEN, 0.38, 0.09)


@dataclass(frozen=True)
class Shot:
    """One moment of a run: what was detected, and what the model says then."""

    evidence: list[ObjectEvidence]
    state: WorldState


@dataclass
class _Table:
    """A table in front of a camera, 20 images a second, and the model that is told of it."""

    seed: int
    fixed: bool
    clock: float = 0.0

    def __post_init__(self) -> None:
        self._rng = np.random.default_rng(self.seed)
        config = WorldModelConfig(
            colors=("green", "red"),
            region=TABLE,
            detection_probability=0.9,
            clutter_per_frame=0.05,
            new_objects_per_second=0.005,
            class_accuracy=0.8,
            motion={"*": {"model": "static", "accel_sigma": 0.5, "moved_per_second": 0.05}},
        )
        self._model = WorldModel(config)

    def show(self, seconds: float, *things: Blob, blocked: bool = False) -> Shot:
        """Things for a time, each missed in a tenth of the images; all of them where the view is `blocked`."""
        seen: list[ObjectEvidence] = []
        for step in range(int(20 * seconds)):
            there = [thing for thing in things if self._rng.random() < 0.9]
            seen = [detection(self._rng, thing.after(step / 20), self.fixed) for thing in there]
            state = self._model.update(WorldEvidence(seen, None if blocked else SEES_ALL), self.clock)
            self.clock += 0.05
        return Shot(seen, state)


def dynamic_table(seed: int, fixed: bool = True) -> tuple[list[tuple[str, str, bool]], dict[str, Shot]]:
    """Section 2.6.1 in its three parts: rows of a name, what the text's run does, and whether this one does; moments.

    fixed : each symbol has the text's probability, not its own.
    """
    table = _Table(seed, fixed)
    shots = {"before": table.show(3.0, BOX, CAN, TEA)}
    shots["moved"] = moved = table.show(3.0, replace(BOX, speed=0.2), CAN, TEA)
    rows = [
        (
            "moved",
            "one of three is moved at 0.2 m/s, all keep their identities",
            _same(shots["before"], moved),
        )
    ]
    box = BOX.at(0.1, 0.3)
    table.show(4.0, blocked=True)
    shots["at once"] = table.show(0.1, box, CAN, CUP)
    shots["exchanged"] = after = table.show(1.9, box, CAN, CUP)
    said = "out of sight, a red box is exchanged for a red cup elsewhere, which takes its identity"
    rows.append(("exchanged", said, _same(moved, after)))
    shots["second box"] = second = table.show(2.0, box, CAN, CUP, SECOND_BOX)
    added = len(second.state.objects) == len(after.state.objects) + 1
    rows.append(("second box", "a second green box comes and is added", added))
    touching = SECOND_BOX.at(-0.09, 0.3)
    shots["side by side"] = table.show(2.0, box, CAN, CUP, touching)
    for _ in range(6):
        shots["as one"] = table.show(0.4, BOTH, CAN, CUP)
        shots["false box"] = table.show(0.4, box, touching, CAN, CUP)
    ghost = any(item.most_probable("size") == "large" for item in shots["false box"].state.objects)
    said = "the two touch and are now and then detected as a large one, which is added"
    rows.append(("false box", said, ghost))
    return rows, shots


def _same(before: Shot, after: Shot) -> bool:
    return {item.id for item in before.state.objects} == {item.id for item in after.state.objects}


FIRST, SECOND = (0.0, 0.5), (0.2, -0.5)
"""m, places of the two cups of section 2.6.2."""
MOMENTS = {"before": 90, "in part": 235, "in view": 299}
"""Images: before all is hidden, while the second cup's place alone is in view, at the end."""


def cups(often_new: bool, seed: int) -> list[Shot]:
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
    shots = []
    for seen in scene.looks(300):
        evidence = seen.evidence
        if 9.0 <= seen.stamp < 12.0:
            part = {"pose": (0.2, -2.0, 0.8, np.pi / 2.0), "range": 1.8, "angle": 0.6}
            evidence = WorldEvidence(evidence.objects, part)
        shots.append(Shot(list(evidence.objects), model.update(evidence, seen.stamp)))
    return shots


def ambiguous_cups(seed: int) -> tuple[list[tuple[str, str, bool]], dict[str, Shot]]:
    """Section 2.6.2 in both settings: rows of a name, what the text's run says, and whether this one does; moments."""
    runs = {"new cups likely": cups(True, seed), "new cups unlikely": cups(False, seed)}
    shots = {f"{run}, {when}": runs[run][at] for run in runs for when, at in MOMENTS.items()}
    likely, unlikely = ([shots[f"{run}, {when}"].state for when in MOMENTS] for run in runs)
    one, other = (_named(states[0], FIRST) for states in (likely, unlikely))
    rows = []
    for when, state, said in (
        ("in part", likely[1], "new cups likely, only the second cup's place in view: it is new"),
        ("in view", likely[2], "new cups likely, all in view: it is new, as before"),
    ):
        new = _named(state, FIRST) == one and _named(state, SECOND) not in (None, one)
        rows.append((f"new cup {when}", said, new))
    said = "new cups unlikely, only the second cup's place in view: the first was moved there"
    rows.append(("moved cup in part", said, _named(unlikely[1], SECOND) == other))
    said = "new cups unlikely, all in view: corrected, the first never moved and the other is new"
    corrected = _named(unlikely[2], FIRST) == other and _named(unlikely[2], SECOND) not in (None, other)
    rows.append(("moved cup in view", said, corrected))
    return rows, shots


def _named(state: WorldState, place: tuple[float, float]) -> str | None:
    """Who is within 15 cm of a place, None: nobody."""
    near = [item.id for item in state.objects if np.hypot(*(item.position[:2] - place)) < 0.15]
    return near[0] if len(near) == 1 else None
