"""How the tracker of people changes with each number that was set: a table over ×0.7 and ×1.4."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import fields
from typing import Any

import numpy as np

from evaluation.people.people_yardsticks import measure
from evaluation.report import Report, RunOptions
from evaluation.scenes.occlusion_scenes import one_hardly_moves, to_and_fro
from evaluation.scenes.people_scenes import PeopleScene, peopled_floor
from tracking.people import cluster_model, person_class
from tracking.people import people_tracker as people
from tracking.people.people_config import PeopleConfig
from tracking.people.people_tracker import PeopleTracker
from whereabouts.system.progress import track

FACTORS = (0.7, 1.4)
SETTINGS = ("acceleration", "leg_noise", "detection_probability", "memory", "report", "located")
NUMBERS: tuple[tuple[Any, str], ...] = (
    (people, "OPPOSITE"),
    (people, "EXACTER"),
    (people, "CLUSTERS"),
    (people, "SPEED"),
    (people, "MARGIN"),
    (people, "BELONGS"),
    (people, "LEGS"),
    (people, "STRIDES"),
    (people, "JUMPS"),
    (people, "LEARNED"),
    (people, "FOUND"),
    (people, "UNFOUND"),
    (cluster_model, "SHAPE"),
    (cluster_model, "WALKS"),
    (cluster_model, "STARTS"),
    (cluster_model, "PERSISTS"),
    (cluster_model, "OUTSTANDS"),
    (person_class, "SHORT"),
    (person_class, "LONG"),
)


def sensitivity(options: RunOptions, report: Report) -> None:
    """OSPA of all targets and of people, on floors that a robot crosses, among walls, and where one hardly moves."""
    scenes = list(_scenes(options.seed, options.quick))
    usual = _judged(scenes, {})
    rows: list[list[Any]] = [["all as shipped", "", *usual, *usual]]
    names = SETTINGS[:1] if options.quick else SETTINGS
    for name in track(names, "settings"):
        value = getattr(PeopleConfig(), name)
        changed = [_judged(scenes, {name: _scaled(name, value, factor)}) for factor in FACTORS]
        rows.append([f"`{name}`", value, *changed[0], *changed[1]])
    for module, name in track(NUMBERS[:1] if options.quick else NUMBERS, "numbers"):
        value = getattr(module, name)
        figures: list[float] = []
        for factor in FACTORS:
            with _set(module, name, factor * value):
                figures += _judged(scenes, {})
        rows.append([f"`{module.__name__.removeprefix('tracking.')}.{name}`", value, *figures])
    columns = ["number", "value"]
    columns += [f"×{factor:g}: OSPA of {kind}, m ↓" for factor in FACTORS for kind in ("people", "all")]
    note = (
        "One number at a time, all else as shipped. Probabilities p become 1 - (1 - p) / factor. OSPA with p = 2, "
        "c = 1 m. The class is not trained anew."
    )
    if options.quick:
        note += " The quick run has the first of each kind only."
    report.add(
        "What each number does", columns, rows, note, "sensitivity", data="simulated", samples=len(scenes)
    )


def _scenes(seed: int, quick: bool) -> Iterator[tuple[PeopleScene, bool]]:
    """Scenes, and whether everybody in range has to be found, hidden or not."""
    for k in range(1 if quick else 2):
        rng = np.random.default_rng([seed, 10, k])
        yield to_and_fro(rng, "walls", "legs"), True
        if not quick:
            yield peopled_floor(rng), False
            yield one_hardly_moves(rng), True


def _judged(scenes: list[tuple[PeopleScene, bool]], settings: dict[str, float]) -> list[float]:
    """OSPA of people and of all targets, m."""
    told, every = [], []
    for k, (scene, everybody) in enumerate(scenes):
        marks = measure(scene, np.random.default_rng(k), PeopleTracker(PeopleConfig(**settings)), everybody)
        told.append(float(np.mean(marks.ospa)))
        every.append(float(np.mean(marks.ospa_all)))
    return [float(np.mean(told)), float(np.mean(every))]


def _scaled(name: str, value: float, factor: float) -> float:
    """A setting times a factor, in the range that it may have."""
    described = next(item for item in fields(PeopleConfig) if item.name == name).metadata
    scaled = 1.0 - (1.0 - value) / factor if name == "detection_probability" else value * factor
    return float(min(max(scaled, described["low"]), described["high"]))


@contextmanager
def _set(module: Any, name: str, value: float) -> Iterator[None]:
    before = getattr(module, name)
    setattr(module, name, value)
    try:
        yield
    finally:
        setattr(module, name, before)
