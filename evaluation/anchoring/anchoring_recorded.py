"""Anchoring on recordings: landmarks without their barcodes (MRCLAM), vehicles with simulated detections (KITTI)."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from estimation.conversion.polar import convert
from evaluation.anchoring import kitti, mrclam
from evaluation.anchoring.anchoring_gnn import GlobalNearestNeighbour
from evaluation.anchoring.identities import IdentityScore
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig

ACCELERATION = 2.0  # m/s^1.5, vehicles and pedestrians alike
NEAR = 2.0
DETECTED, FALSE, SIGMA = 0.9, 0.3, 0.2  # p_D, false detections per frame, m


@dataclass(frozen=True)
class LandmarkRun:
    """right : share of landmark detections whose object is of that landmark, as said at once; each object stands for
    one. corrected : the same of what is said in the end of all of them."""

    detections: int
    right: float
    corrected: float
    landmarks: int


def landmark_run(folder: Path, robot: int, sigma: tuple[float, float] = (0.05, 0.015)) -> LandmarkRun:
    """One robot's sightings of a MRCLAM recording from its true poses; sigma: of range (m) and bearing (rad)."""
    return anchored(mrclam.sightings(folder, robot), sigma)


def anchored(
    sightings: Iterable[mrclam.Sighting], sigma: tuple[float, float] = (0.05, 0.015), learn: bool = True
) -> LandmarkRun:
    """Sightings without their barcodes, from known poses. learn : whether the sensor's errors are learned."""
    config = WorldModelConfig(
        classes=("landmark", "robot"),
        region=((-2.0, 6.0), (-7.0, 7.0), (-0.5, 0.5)),
        rate_hz=5.0,
        detection_probability=0.35,
        clutter_per_frame=0.1,
        missed_run_frames=10.0,
        motion={
            "landmark": {"model": "static", "moved_per_second": 0.0},
            "robot": {"model": "constant_velocity", "accel_sigma": 0.2},
        },
        learn_sensor_bias=learn,
    )
    model = WorldModel(config)
    pairs: Counter[tuple[int, str | None]] = Counter()
    given: list[tuple[list[int], tuple[str | None, ...]]] = []
    for seen in sightings:
        evidence, subjects = [], []
        turn = np.array(
            [[np.cos(seen.pose[2]), -np.sin(seen.pose[2])], [np.sin(seen.pose[2]), np.cos(seen.pose[2])]]
        )
        for (distance, bearing), subject in zip(seen.readings, seen.subjects, strict=True):
            mean, spread = convert(distance, bearing, *sigma, method="ucm")
            covariance = np.diag([0.0, 0.0, 1e-4])
            covariance[:2, :2] = turn @ spread @ turn.T
            kind = "landmark" if subject >= mrclam.FIRST_LANDMARK else "robot"
            other = "robot" if kind == "landmark" else "landmark"
            position = [*(turn @ mean + seen.pose[:2]), 0.0]
            evidence.append(ObjectEvidence(position, covariance, {"class": {kind: 0.95, other: 0.05}}))
            subjects.append(int(subject))
        sensor = {"pose": (*seen.pose[:2], 0.0, seen.pose[2]), "range": 6.0, "angle": 1.1}
        state = model.update(WorldEvidence(evidence, sensor), seen.stamp)
        if subjects:
            given.append((subjects, state.associations))
        pairs.update(_of_landmarks(subjects, state.associations))
    after: Counter[tuple[int, str | None]] = Counter()
    # Nothing is kept to look back at unless errors are learned.
    final = [names for _, names in model.look_back()] if learn else [names for _, names in given]
    for (subjects, _), names in zip(given, final, strict=True):
        after.update(_of_landmarks(subjects, names))
    return LandmarkRun(pairs.total(), _right(pairs), _right(after), len({subject for subject, _ in pairs}))


def _of_landmarks(subjects: Sequence[int], names: Sequence[str | None]) -> list[tuple[int, str | None]]:
    pairs = zip(subjects, names, strict=True)
    return [(subject, name) for subject, name in pairs if subject >= mrclam.FIRST_LANDMARK]


def _right(pairs: Counter[tuple[int, str | None]]) -> float:
    """Share of detections whose object stands for their landmark, that of most of the object's."""
    stands_for: dict[str, int] = {}
    for (subject, name), _ in pairs.most_common():
        if name is not None:
            stands_for.setdefault(name, subject)
    return (
        sum(n for (subject, name), n in pairs.items() if name and stands_for[name] == subject) / pairs.total()
    )


def false_ones(frame: kitti.KittiFrame, rng: np.random.Generator) -> list[np.ndarray]:
    """Positions (3,) of false detections in the camera's view, 0.3 per frame."""
    found = []
    for _ in range(rng.poisson(FALSE)):
        distance, bearing = rng.uniform(3.0, 60.0), frame.sensor[3] + rng.uniform(-0.7, 0.7)
        off = [distance * np.cos(bearing), distance * np.sin(bearing), rng.uniform(-1.0, 1.0)]
        found.append(frame.sensor[:3] + off)
    return found


def traffic(frames: Sequence[kitti.KittiFrame], **more: Any) -> WorldModelConfig:
    """What is told of the traffic; more : other settings."""
    everything = np.concatenate([frame.positions for frame in frames])
    (x0, y0, z0), (x1, y1, z1) = (everything.min(0) - 5.0).tolist(), (everything.max(0) + 5.0).tolist()
    return WorldModelConfig(
        region=((x0, x1), (y0, y1), (z0, z1)),
        rate_hz=kitti.RATE,
        detection_probability=DETECTED,
        clutter_per_frame=FALSE,
        measurement_sigma=SIGMA,
        new_objects_per_second=1.0,
        removed_per_second=0.1,
        motion={"*": {"model": "constant_velocity", "accel_sigma": ACCELERATION}},
        **more,
    )


def nearest_neighbour() -> GlobalNearestNeighbour:
    """The peer, told the same."""
    return GlobalNearestNeighbour(ACCELERATION, SIGMA, ACCELERATION * float(np.sqrt(10.0)))


def tracking_run(folder: Path, sequence: str, seed: int) -> tuple[IdentityScore, IdentityScore]:
    """Scores of anchoring and of global nearest neighbour on the same detections of a KITTI sequence."""
    frames = list(kitti.frames(folder, sequence))
    rng = np.random.default_rng(seed)
    model, other = WorldModel(traffic(frames)), nearest_neighbour()
    ours, theirs = IdentityScore(NEAR), IdentityScore(NEAR)
    for frame in frames:
        found = [p + rng.normal(0.0, SIGMA, 3) for p in frame.positions if rng.random() < DETECTED]
        seen = np.array(found + false_ones(frame, rng)).reshape(-1, 3)
        state = model.update(
            WorldEvidence([ObjectEvidence(p, SIGMA**2 * np.eye(3)) for p in seen]), frame.stamp
        )
        truth = dict(zip(frame.identities, frame.positions, strict=True))
        positions = np.array([item.position for item in state.objects]).reshape(-1, 3)
        ours.add(truth, [item.id for item in state.objects], positions)
        tracks = other.step(seen, frame.stamp)
        theirs.add(truth, [t.id for t in tracks], np.array([t.mean[:3] for t in tracks]).reshape(-1, 3))
    return ours, theirs
