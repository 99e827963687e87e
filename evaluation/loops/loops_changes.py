"""Figures 7, 9 and 12: what translation and moving things do to the likelihood, and the matrix of a whole log."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from evaluation.drawing import saved
from evaluation.loops.place_training import Recording
from evaluation.report import Report, RunOptions
from evaluation.scenes.scan_pairs import free_pose
from loop_closure import PlaceFeatures, PlaceModel, features_2d, pair_features, shipped_model
from loop_closure.places.place_model import TRAINED_RANGE
from whereabouts.simulation import Lidar, crowd, joined, outlines, random_room

EDGES = (0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0)


def translation(options: RunOptions, report: Report, recordings: Mapping[str, Recording]) -> None:
    """Figure 7: mean likelihood of pairs of a densely scanned stretch against their distance, headings within 45°."""
    if "freiburg-079" not in recordings:
        return
    recording = recordings["freiburg-079"]
    count = 150 if options.quick else 400
    places, poses = recording.places[:count], recording.poses[:count]
    rows: list[list[Any]] = []
    scores = {}
    apart, alike = [], []
    for i in range(0, count, 4):
        apart.append(np.linalg.norm(poses[:, :2] - poses[i, :2], axis=1))
        turn = np.abs(np.mod(poses[:, 2] - poses[i, 2] + math.pi, 2 * math.pi) - math.pi)
        alike.append((turn < math.radians(45.0)) & (np.arange(count) != i))
    for name in ("plain_2d", "best_2d"):
        scores[name] = _rows(shipped_model(name), places, range(0, count, 4))
    distance, kept = np.concatenate(apart), np.concatenate(alike)
    for low, high in pairwise(EDGES):
        inside = kept & (distance >= low) & (distance < high)
        if inside.any():
            means = [float(scores[name][inside].mean()) for name in scores]
            rows.append([f"{low:g} to {high:g} m apart", int(inside.sum()), *means])
    report.add(
        "Figure 7: mean likelihood by translation",
        ["pairs", "number", "plain", "best"],
        rows,
        "First stretch of freiburg-079. The text: a rapid decay, as the scene itself changes. The "
        "shipped models have seen this log.",
        "translation",
        data="tuned on",
        samples={str(row[0]): int(row[1]) for row in rows},
    )


def _rows(model: PlaceModel, places: Sequence[PlaceFeatures], queries: range) -> np.ndarray:
    database = model.database(places)
    return np.concatenate([model.likelihoods(places[i], database) for i in queries])


def dynamic_objects(options: RunOptions, report: Report) -> None:
    """Figure 9: one pose in a simulated room, again with movers: likelihood against feature difference (24)."""
    rng = np.random.default_rng([options.seed, 0])
    lidar = Lidar(361, 2.0 * np.pi * 360 / 361)
    count = options.share(200, 40)
    models = [shipped_model(name) for name in ("plain_2d", "best_2d")]
    differences: dict[int, list[np.ndarray]] = {}
    usual_pairs = []
    likelihoods: dict[int, list[list[float]]] = {}
    for movers in (0, 4, 8, 16):
        for _ in range(count):
            room = random_room(rng)
            pose = free_pose(room, rng, 3.0)
            first = features_2d(lidar.scan(room, pose, rng).scan, TRAINED_RANGE)
            if movers == 0:
                beside = pose + np.array([*rng.uniform(-0.5, 0.5, 2), 0.0])
                near = features_2d(lidar.scan(room, beside, rng).scan, TRAINED_RANGE)
                usual_pairs.append(pair_features(first, near))
            people = crowd(rng, pose[:2], movers, (0.8, 4.0))
            shapes = joined([room, outlines(people, 0.0)]) if people else room
            again = features_2d(lidar.scan(shapes, pose, rng).scan, TRAINED_RANGE)
            differences.setdefault(movers, []).append(pair_features(first, again))
            likelihoods.setdefault(movers, []).append(
                [float(model.likelihoods(again, model.database([first]))[0]) for model in models]
            )
    # The positive pairs of a data set: half a metre apart, nothing moves.
    usual = np.mean(usual_pairs, axis=0)
    usual = np.where(np.abs(usual) > 1e-9, usual, 1.0)
    rows = []
    for movers, found in differences.items():
        root = np.sqrt(np.mean((np.array(found) / usual) ** 2, axis=1))
        plain, best = np.array(likelihoods[movers]).T
        rows.append(
            [f"{movers} movers", float(np.median(root)), *(float(np.median(v)) for v in (plain, best))]
        )
        rows[-1] += [100.0 * float(np.mean(plain >= 0.5)), 100.0 * float(np.mean(best >= 0.5))]
    report.add(
        "Figure 9: the same pose with moving things around",
        [
            "around",
            "difference (24)",
            "plain ↑",
            "best ↑",
            "plain at least 0.5, % ↑",
            "best at least 0.5, % ↑",
        ],
        rows,
        "Medians of the difference of features and of the likelihood; 361 beams all round. The text "
        "sees no clear trend up to a difference of 5.25 and about 0.5 there.",
        "movers",
        data="simulated",
        samples=count,
    )


def likelihood_matrix(options: RunOptions, report: Report, recordings: Mapping[str, Recording]) -> None:
    """Figure 12: likelihood of every pair of a log, by the text's method and by the best, as a picture."""
    if "belgioioso" not in recordings:
        return
    recording = recordings["belgioioso"]
    step = 3 if options.quick else 1
    places = list(recording.places[::step])
    figure = Figure(figsize=(13, 4), layout="constrained")
    positions = recording.poses[::step, :2]
    near = np.linalg.norm(positions[:, None] - positions[None], axis=2) < 2.0
    pictures = {"within 2 m": near.astype(float)}
    for name in ("plain_2d", "best_2d"):
        pictures[name] = _rows(shipped_model(name), places, range(len(places))).reshape(len(places), -1)
    for axis, (title, values) in zip(figure.subplots(1, 3), pictures.items(), strict=True):
        axis.imshow(values, vmin=0.0, vmax=1.0, cmap="gray_r", interpolation="nearest")
        axis.set_title(title)
    report.pictures.append(saved(figure, options.out / "likelihood_matrix.png", 100))
