"""How the shipped models are trained: simulated pairs of streets, halls, offices and crowds."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evaluation.crf.crf_learning import learned_printed, learned_trees
from evaluation.scenes.labelled_pairs import (
    CROWD,
    INTERVALS,
    LabelledPair,
    labelled,
    protocol,
)
from evaluation.scenes.streets import SCENES, traffic
from registration.crf.as_printed import PrintedCrf
from registration.crf.joint_model import JointModel
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.movers import Mover, outlines
from whereabouts.simulation.shapes import Shapes, circle, joined
from whereabouts.system.progress import track

SEED = 2026
ROUND = Lidar(361, 2.0 * np.pi * 360 / 361)
LOOKS = {"street": 1600, "hall": 500, "office": 1000, "crowd": 4000}  # pairs the trees are learned from
SCANNERS = ((361, np.pi), (361, ROUND.opening), (1081, np.deg2rad(270.0)), (541, np.deg2rad(270.0)),
            (360, 2.0 * np.pi * 359 / 360))  # fmt: skip
STANDING = 0.75  # of the scenes in which things stand that look like those that move
LOSSY = 0.35  # of the scanners, which lose up to half of their beams
EMPTY = 0.1  # of the scenes in which nothing moves


def looks(seed: int = SEED) -> Iterator[LabelledPair]:
    """Pairs for the trees: all kinds of scanners, noise and intervals, and what stands looks like what moves."""
    for number, (scene, count) in enumerate(LOOKS.items()):
        rng = np.random.default_rng([seed, 20 + number])
        for _ in track(range(count), f"pairs, {scene}"):
            yield _look(scene, rng)


def _look(scene: str, rng: np.random.Generator) -> LabelledPair:
    usual = INTERVALS[scene]
    interval = usual if rng.random() < 0.5 else usual * rng.uniform(0.5, 2.0)
    beams, opening = SCANNERS[rng.integers(len(SCANNERS))]
    sigma = 0.01 if rng.random() < 0.6 else rng.uniform(0.003, 0.03)
    street = scene == "street"
    farthest, lost = 40.0 if street else 30.0, 0.0
    if rng.random() < LOSSY:
        farthest, lost = rng.uniform(6.0, farthest), rng.uniform(0.0, 0.5)
    lidar = Lidar(beams, opening, range_max=farthest, sigma=sigma, dropout=lost)
    while True:
        place = _place(scene, rng)
        movers = [] if rng.random() < EMPTY else traffic(rng, scene, _count(scene, rng))
        start = np.array([*rng.uniform(-1.5, 1.5, 2), rng.uniform(-np.pi, np.pi)])
        if street:
            start = np.array([*(start[:2] - [0.0, 1.8]), rng.uniform(-0.1, 0.1)])
        course = start[2] + (0.0 if street else rng.uniform(-0.3, 0.3))
        way = interval * rng.uniform(0.0, 6.0 if street else 1.0)
        turn = interval * (rng.uniform(-0.05, 0.05) if street else rng.uniform(-0.5, 0.5))
        end = start + np.array([way * np.cos(course), way * np.sin(course), turn])
        times = (0.0, interval)
        clear = 1.2 if street else 0.5
        if min(place.distance(pose[:2]) for pose in (start, end)) > clear and _is_free(
            movers, (start, end), times
        ):
            resolution = float(rng.choice([0.0, 0.01, 0.02]))
            return labelled(place, movers, (start, end), times, lidar, rng, resolution)


def _place(scene: str, rng: np.random.Generator) -> Shapes:
    place = SCENES[scene](rng)
    if rng.random() < STANDING:
        still = outlines(traffic(rng, scene, int(rng.integers(1, CROWD + 1))), 0.0)
        poles = [
            circle(rng.uniform(-4.0, 4.0), rng.uniform(-4.0, 4.0), rng.uniform(0.02, 0.1))
            for _ in range(int(rng.integers(16)))
        ]
        place = joined([place, still.owned_by(0), *poles])
    return place


def _count(scene: str, rng: np.random.Generator) -> int:
    return CROWD if scene == "crowd" and rng.random() < 0.7 else int(rng.integers(1, 6))


def _is_free(movers: list[Mover], poses: tuple[np.ndarray, ...], times: tuple[float, ...]) -> bool:
    """Whether no mover is where the sensor is."""
    return not movers or all(
        outlines(movers, time).distance(pose[:2]) > 0.5 for pose, time in zip(poses, times, strict=True)
    )


def train_shipped(seed: int = SEED) -> JointModel:
    """The model in `registration/crf/models/movers.json`."""
    card = {
        "trained by": "whereabouts segment --train --out registration/crf/models/movers.json",
        "pairs": sum(LOOKS.values()),
        "seed": seed,
        "data": "simulated streets, halls, offices and crowds (evaluation.crf.crf_training); no recordings. In "
        "most of them things stand that look like what moves, in a tenth nothing moves",
    }
    return JointModel(learned_trees(looks(seed)), card)


def train_printed(seed: int = SEED) -> PrintedCrf:
    """The model in `registration/crf/models/as_printed.json`: the text's number of pairs, of another seed."""
    pairs = protocol(seed)
    card = {
        "trained by": "whereabouts segment --method as_printed --train --out registration/crf/models/as_printed.json",
        "pairs": len(pairs),
        "seed": seed,
    }
    return learned_printed(pairs, card)
