"""The hypotheses against enumerating every history of associations, (2.4) to (2.11) written down plainly."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig

REGION = ((0.0, 2.0), (0.0, 2.0), (0.0, 1.0))
SENSOR = {"pose": (-1.0, 1.0, 0.5, 0.0), "range": 10.0, "angle": 2.0 * np.pi}
CLASSES = ("cup", "bowl", "book")
SIGMA = 0.05
INITIAL, ARRIVALS, REMOVALS, DT = 2.0, 0.5, 0.2, 0.5


def settings(detection: float, clutter: float) -> WorldModelConfig:
    return WorldModelConfig(
        classes=CLASSES,
        region=REGION,
        rate_hz=1.0 / DT,
        detection_probability=detection,
        clutter_per_frame=clutter,
        initial_objects=INITIAL,
        new_objects_per_second=ARRIVALS,
        removed_per_second=REMOVALS,
        motion={"*": {"model": "static", "moved_per_second": 0.0}},
        class_accuracy=0.95,
    )


def gauss(z: np.ndarray, mean: np.ndarray, variance: float) -> float:
    return float(np.exp(-0.5 * ((z - mean) ** 2).sum() / variance) / (2.0 * np.pi * variance) ** 1.5)


def history_weight(
    history: list[tuple[int, int]], looks: list, detection: float, first: int
) -> tuple[float, float]:
    """Weight of one object having exactly these detections (look, index), and of it being there at the end.

    Sums over when it was removed; `first` is the look of its first detection, misses before are in its birth.
    """
    alive, dead = 1.0, 0.0
    mean, variance, count = np.zeros(3), 0.0, 0
    belief = np.full(3, 1.0 / 3.0)
    stay = np.exp(-REMOVALS * DT)
    seen = dict(history)
    for k in range(first, len(looks)):
        if k > first:
            dead += (1.0 - stay) * alive
            alive *= stay
        if k in seen:
            z, d = looks[k][seen[k]]
            likelihood = 1.0 if count == 0 else gauss(z, mean, variance + SIGMA**2)
            likelihood *= 3.0 * (belief * d).sum() if count else 1.0
            belief = belief * d / (belief * d).sum()
            gain = 1.0 if count == 0 else variance / (variance + SIGMA**2)
            mean, variance = mean + gain * (z - mean), SIGMA**2 if count == 0 else (1.0 - gain) * variance
            count += 1
            alive *= likelihood * (1.0 if k == first else detection)
            dead = 0.0
        else:
            alive *= 1.0 - detection
    return alive, dead


def enumerated(looks: list, detection: float, clutter: float) -> tuple[float, np.ndarray]:
    """Expected number of objects that were ever detected, and of their mean positions summed, exactly."""
    volume = 4.0
    detections = [(k, j) for k, look in enumerate(looks) for j in range(len(look))]
    undetected = []
    left = INITIAL
    for k in range(len(looks)):
        if k:
            left = left * np.exp(-REMOVALS * DT) + ARRIVALS * DT
        undetected.append(left)
        left *= 1.0 - detection
    total, count, moment = 0.0, 0.0, np.zeros(3)
    # Every detection is clutter (-1) or of the object numbered by its first detection.
    for labels in product(*[range(-1, n + 1) for n in range(len(detections))]):
        groups: dict[int, list[tuple[int, int]]] = {}
        for n, label in enumerate(labels):
            if label >= 0:
                groups.setdefault(label, []).append(detections[n])
        if any(labels[n] != n for n in groups) or any(
            len({k for k, _ in g}) < len(g) for g in groups.values()
        ):
            continue
        weight = (clutter / volume) ** labels.count(-1)
        there = []
        for history in groups.values():
            first = history[0][0]
            alive, dead = history_weight(history, looks, detection, first)
            weight *= undetected[first] * detection / volume * (alive + dead)
            mean = np.mean([looks[k][j][0] for k, j in history], axis=0)
            there.append((alive / (alive + dead), mean))
        total += weight
        count += weight * sum(p for p, _ in there)
        moment += weight * sum((p * m for p, m in there), np.zeros(3))
    return count / total, moment / total


def believed(model: WorldModel) -> tuple[float, np.ndarray]:
    anchors = model._anchors
    leaves = anchors.pool.leaves
    count, moment = 0.0, np.zeros(3)
    for cluster in anchors.clusters.values():
        for row, weight in zip(cluster.rows, np.exp(cluster.weights), strict=True):
            for slot in row[row >= 0]:
                here = leaves.behavior[slot, :2].sum()
                count += weight * here
                moment += weight * here * leaves.rest[slot]
    return count, moment


def scene(seed: int, apart: float, looks: int) -> list:
    """Looks as lists of (position, class distribution): two objects `apart` metres, some missed, some clutter."""
    rng = np.random.default_rng(seed)
    out = []
    for _ in range(looks):
        look = []
        for x in (1.0, 1.0 + apart):
            if rng.random() < 0.75:
                look.append(
                    (np.array([x, 1.0, 0.5]) + rng.normal(0.0, SIGMA, 3), rng.dirichlet([4.0, 1.5, 1.5]))
                )
        if rng.random() < 0.4 and len(look) < 2:
            look.append((rng.uniform([0.7, 0.7, 0.2], [1.4, 1.3, 0.8]), rng.dirichlet([1.0, 1.0, 1.0])))
        out.append(look)
    return out


@pytest.mark.parametrize(("detection", "clutter"), [(0.9, 0.3), (0.6, 2.0)])
@pytest.mark.parametrize("apart", [0.12, 0.3])
def test_agrees_with_every_history(detection: float, clutter: float, apart: float) -> None:
    compared = 0
    for seed in range(12):
        looks = scene(seed, apart, 3)
        model = WorldModel(settings(detection, clutter))
        for k, look in enumerate(looks):
            # The enumeration takes the density of objects as known.
            unseen = model._anchors.unseen
            unseen.found, unseen.exposure = np.zeros(2), np.zeros(2)
            given = [
                ObjectEvidence(z, SIGMA**2 * np.eye(3), {"class": dict(zip(CLASSES, d, strict=True))})
                for z, d in look
            ]
            model.update(WorldEvidence(given, SENSOR), k * DT)
        believes = [[(z, _believed(d)) for z, d in look] for look in looks]
        expected, moment = enumerated(believes, detection, clutter)
        count, mean = believed(model)
        assert count == pytest.approx(expected, abs=0.01)
        np.testing.assert_allclose(mean, moment, atol=0.01)
        compared += sum(len(look) for look in looks)
    assert compared > 40


def _believed(d: np.ndarray) -> np.ndarray:
    """A detector's distribution, believed in up to the accuracy stated, and never wholly."""
    mix = 0.01
    if d.max() * (1.0 - mix) + mix / 3.0 > 0.95:
        mix = (d.max() - 0.95) / (d.max() - 1.0 / 3.0)
    return (1.0 - mix) * d + mix / 3.0
