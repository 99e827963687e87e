"""Scenes of objects on which anchoring is judged: what it is told, count and identities it ends with, and times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from time import process_time
from typing import Any

import numpy as np

from evaluation.anchoring.identities import IdentityScore
from evaluation.scenes.ants import AntScene
from whereabouts.simulation.objects import ObjectScene, Thing, in_view, scattered
from world_model import WorldModel, WorldModelConfig

ROOM = ((-2.5, 2.5), (-2.5, 2.5), (0.0, 1.5))
HALL = ((-5.0, 5.0), (-5.0, 5.0), (0.0, 1.5))
FLOOR = ((-20.0, 20.0), (-20.0, 20.0), (0.0, 1.5))
ALL_ROUND: dict[str, Any] = {"pose": (-3.0, 0.0, 1.0, 0.0), "range": 10.0, "angle": 2.0 * np.pi}
HARD: dict[str, Any] = {"detection": 0.6, "clutter": 3.0}


def known(scene: ObjectScene, **more: Any) -> WorldModelConfig:
    """What a deployment may know about a scene: rates, accuracy, region; not what is in it."""
    return WorldModelConfig(
        classes=scene.classes,
        colors=scene.colors,
        region=scene.region,  # type: ignore[arg-type]
        rate_hz=scene.rate,
        detection_probability=scene.detection,
        clutter_per_frame=scene.clutter,
        measurement_sigma=scene.sigma,
        class_accuracy=scene.accuracy,
        missed_run_frames=scene.missed_run,
        **more,
    )


@dataclass(frozen=True)
class Played:
    """objects : at the end; true : that are there then and were in view once. switches : of identity.
    mean_ms : of an update, without the first five."""

    objects: int
    true: int
    switches: int
    mean_ms: float


def play(scene: ObjectScene, looks: int = 600, near: float = 0.14, **more: Any) -> Played:
    """Run a scene through a new model; more : settings of it."""
    model = WorldModel(known(scene, **more))
    score = IdentityScore(near)
    times, met = [], set()
    for seen in scene.looks(looks):
        begin = process_time()
        state = model.update(seen.evidence, seen.stamp)
        times.append(1e3 * (process_time() - begin))
        met |= set(seen.sources)
        positions = np.array([item.position for item in state.objects]).reshape(-1, 3)
        score.add(seen.truth, [item.id for item in state.objects], positions)
    true = len(met & set(seen.truth))
    return Played(len(state.objects), true, score.switches, float(np.mean(times[5:])))


def turning(count: int, in_view: int, region: Any, reach: float, seed: int, **detector: Any) -> ObjectScene:
    """`count` objects around a sensor that turns and has `in_view` of them in view on average."""
    rng = np.random.default_rng(seed)
    things: list[Thing] = []
    while len(things) < count:
        (thing,) = scattered(1, rng, region)
        near = all(np.linalg.norm(thing.position - other.position) >= 0.25 for other in things)
        if near and np.hypot(*thing.position[:2]) < reach - 0.2:
            things.append(thing)
    angle = 2.0 * np.pi * in_view / count
    sensor = {"pose": (0.0, 0.0, 1.0, 0.0), "range": reach, "angle": angle}
    # Two turns in 30 s, so that everything is seen again.
    return ObjectScene(things, region, sensor=sensor, turn=4.0 * np.pi / 30.0, seed=seed, **detector)


WALK: dict[str, Any] = {"*": {"model": "constant_velocity", "accel_sigma": 0.3}}


def walkers(seed: int, looks: int) -> list[Thing]:
    """Fifty things within 5 m that walk about at 0.3 m/s."""
    rng = np.random.default_rng(seed)
    made = []
    for thing in turning(50, 10, HALL, 5.0, seed).things:
        place, heading, path = thing.position, rng.uniform(-np.pi, np.pi), []
        for k in range(1, looks):
            heading += rng.normal(0.0, 0.07)
            to = place + 0.015 * np.array([np.cos(heading), np.sin(heading), 0.0])
            if np.hypot(*to[:2]) > 4.8:
                to, heading = place, heading + rng.uniform(0.5 * np.pi, 1.5 * np.pi)
            path.append((k / 20.0, to))
            place = to
        made.append(replace(thing, path=tuple(path)))
    return made


@dataclass(frozen=True)
class Walked:
    """surplus : movers told of beyond those in view, mean. exact : share of looks with as many. known : the same of who
    knows which detection is of whom, and tells of those in view that were detected twice there. mean_ms : of an
    update."""

    surplus: float
    exact: float
    known: float
    mean_ms: float


def walk(seed: int, looks: int, turn: float) -> Walked:
    """Fifty movers around a sensor that has ten in view on average, and turns at `turn` rad/s; from 2 s on."""
    scene = replace(turning(50, 10, HALL, 5.0, seed), things=walkers(seed, looks), turn=turn)
    model = WorldModel(known(scene, motion=WALK))
    off, unsure, times = [], [], []
    detected: dict[int, int] = {}
    for seen in scene.looks(looks):
        begin = process_time()
        told = len(model.update(seen.evidence, seen.stamp).objects)
        times.append(1e3 * (process_time() - begin))
        view = None if seen.evidence.sensor is None else dict(seen.evidence.sensor)
        here = [number for number, place in seen.truth.items() if in_view(place, view)]
        detected = {number: detected.get(number, 0) + (number in seen.sources) for number in here}
        if seen.stamp > 2.0:
            off.append(told - len(here))
            unsure.append(sum(count < 2 for count in detected.values()))
    exact, known_exact = (float(np.mean(np.array(each) == 0)) for each in (off, unsure))
    return Walked(float(np.mean(off)), exact, known_exact, float(np.mean(times[5:])))


def scenes(seed: int) -> dict[str, ObjectScene]:
    """The scenes that WIRE was measured on, and what it could not do."""
    rng = np.random.default_rng(seed)
    made: dict[str, ObjectScene] = {}
    for count in (10, 20, 30):
        made[f"{count} objects"] = ObjectScene(scattered(count, rng, ROOM), ROOM, sensor=ALL_ROUND, seed=seed)
    made["100 objects, 20 in view"] = turning(100, 20, HALL, 5.0, seed)
    for count in (10, 20, 30):
        things = scattered(count, rng, ROOM)
        made[f"{count}, p_D 0.6, 3 false"] = ObjectScene(things, ROOM, sensor=ALL_ROUND, seed=seed, **HARD)
    made["1,000 objects, 20 in view"] = turning(1000, 20, FLOOR, 20.0, seed)
    twins = [Thing("cup", "red", np.array([x, y, 0.8])) for x, y in ((0.0, 0.0), (0.15, 0.0), (1.0, 1.0))]
    made["twins 15 cm apart"] = ObjectScene(twins, ROOM, sensor=ALL_ROUND, seed=seed)
    others = scattered(9, rng, ROOM)
    leaving = Thing("cup", "red", np.array([0.0, 0.0, 0.8]), path=((20.0, None),))
    made["one of 10 removed"] = ObjectScene([*others, leaving], ROOM, sensor=ALL_ROUND, seed=seed)
    place = np.array([1.0, 1.0, 0.8])
    carried = Thing("cup", "red", np.array([0.0, 0.0, 0.8]), path=((10.0, None), (15.0, place)))
    apart = [t for t in others if np.linalg.norm(t.position - place) > 0.3 and t.kind != "cup"]
    made["one carried"] = ObjectScene([*apart, carried], ROOM, sensor=ALL_ROUND, seed=seed)
    return made


@dataclass(frozen=True)
class AntRun:
    """mixed : ants that have another identity at the end than at the beginning. counts (K, 3) : expected, detected
    and true number over time. paths : (k, 2) estimated positions of each identity, m."""

    mixed: int
    corrected: int
    merged: int
    mean_ms: float
    counts: np.ndarray
    paths: dict[str, list[np.ndarray]]


def ants(scene: AntScene, looks: int, **more: Any) -> AntRun:
    """Identities of ants, judged where they are alone; changes that were taken back count as corrected.

    more : settings of the model that are others.
    """
    half = 0.5 * scene.side + 0.005
    config = WorldModelConfig(
        colors=("brown",),
        region=((-half, half), (-half, half), (-0.005, 0.005)),
        rate_hz=scene.rate,
        detection_probability=0.97,
        clutter_per_frame=scene.clutter,
        measurement_sigma=scene.sigma,
        missed_run_frames=2.0,
        new_objects_per_second=0.05,
        initial_objects=float(scene.count),
        motion={
            "*": {
                "model": "constant_velocity",
                "accel_sigma": 0.5 * scene.speed,
                "turn_sigma": scene.turning,
            }
        },
        merged_detections=True,
    )
    model = WorldModel(replace(config, **more))
    first: dict[int, str] = {}
    now: dict[int, str] = {}
    changes = merged = 0
    times, counts = [], []
    paths: dict[str, list[np.ndarray]] = {}
    for index, seen in enumerate(scene.looks(looks)):
        begin = process_time()
        state = model.update(seen.evidence, seen.stamp)
        times.append(1e3 * (process_time() - begin))
        counts.append((state.expected_count, len(seen.evidence.objects), len(seen.truth)))
        merged += sum(len(behind) > 1 for behind in seen.sources)
        true = np.array(list(seen.truth.values()))
        apart = np.linalg.norm(true[:, None] - true[None], axis=2) + np.eye(len(true))
        found = np.array([item.position for item in state.objects]).reshape(-1, 3)
        for item in state.objects:
            paths.setdefault(item.id, []).append(item.position[:2])
        if index < 10 or not len(found):
            continue
        off = np.linalg.norm(true[:, None] - found[None], axis=2)
        for ant in np.flatnonzero(apart.min(1) > 1.5 * scene.merge):
            nearest = int(off[ant].argmin())
            if off[ant, nearest] < 0.5 * scene.merge:
                name = state.objects[nearest].id
                changes += now.get(int(ant), name) != name
                first.setdefault(int(ant), name)
                now[int(ant)] = name
    mixed = sum(now[ant] != first[ant] for ant in first)
    return AntRun(mixed, changes - mixed, merged, float(np.mean(times[5:])), np.array(counts), paths)
