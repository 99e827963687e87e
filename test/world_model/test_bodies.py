"""Two things do not fill the same space, and nothing is where a beam went through."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from estimation.errors import InputError
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig
from world_model.anchoring.anchors import Anchors
from world_model.anchoring.bodies import Bodies
from world_model.anchoring.loops.leaves import NONE, REST

SIGMA = 0.01
REGION = ((-3.0, 3.0), (-3.0, 3.0), (0.0, 2.0))
CONFIG = WorldModelConfig(
    classes=("box", "cup"), region=REGION, measurement_sigma=SIGMA, clutter_per_frame=0.2
)


def seen(*objects: tuple[float, float, float, float]) -> WorldEvidence:
    """Detections x, y, z and the width of a cube, all around."""
    given = [
        ObjectEvidence(
            [x, y, z],
            SIGMA**2 * np.eye(3),
            {"class": {"box": 0.9, "cup": 0.1}},
            quantities={"size": (width * np.sqrt(3.0), 1e-4), "ratio": (1.0, 1e-4)} if width else {},
        )
        for x, y, z, width in objects
    ]
    return WorldEvidence(given, {"pose": (0.0, -2.5, 1.0, 0.0), "range": 9.0, "angle": 2.0 * np.pi})


def scene(rng: np.random.Generator) -> tuple[Bodies, np.ndarray, np.ndarray, np.ndarray]:
    """Three tracks with two leaves each, of which the first track is surely there, in random hypotheses."""
    anchors = Anchors(CONFIG)
    leaves, slots = anchors.leaves, np.array([anchors.pool.take() for _ in range(6)])
    for k, slot in enumerate(slots.tolist()):
        leaves.track[slot] = k // 2
        leaves.rest[slot] = rng.uniform([0.0, 0.0, 0.5], [0.5, 0.4, 0.6])
        leaves.rest_cov[slot] = 1e-4 * np.eye(3)
        leaves.behavior[slot] = 0.0
        leaves.behavior[slot, REST] = 1.0 if k < 2 else rng.uniform(0.1, 0.95)
        leaves.behavior[slot, NONE] = 1.0 - leaves.behavior[slot, REST]
        leaves.values[slot] = [0.3 * np.sqrt(3.0), 1.0]
        leaves.variances[slot] = [1e-6, 1e-6]
    rows = np.unique(
        [[slots[0 + rng.integers(2)], *(slots[2 * t + rng.integers(2)] for t in (1, 2))] for _ in range(6)],
        axis=0,
    )
    weights = np.log(rng.dirichlet(np.ones(len(rows))))
    return Bodies(anchors), rows, weights, leaves.behavior[:, REST]


def solid_overlap(a: np.ndarray, b: np.ndarray) -> bool:
    """The cores of two cubes of 0.3 m whose places are known to 1 cm, written down plainly."""
    size = 0.3 * np.sqrt(3.0)
    reach = 0.7 * 0.3 * (1.0 - 2.0 * 1e-3 / size) - 3.0 * np.sqrt(2e-4)
    return bool(np.hypot(*(a - b)[:2]) < reach and abs(a[2] - b[2]) < reach)


def test_agrees_with_every_world() -> None:
    """Where one of two is surely there, hypotheses weigh as all worlds do in which no two fill the same space."""
    clashing = 0
    for seed in range(60):
        bodies, rows, weights, here = scene(np.random.default_rng(seed))
        place = bodies.anchors.leaves.rest
        # Which of two that may both be missing is there, is decided and not summed over.
        if any(solid_overlap(place[row[1]], place[row[2]]) for row in rows):
            continue
        clashing += any(solid_overlap(place[row[0]], place[other]) for row in rows for other in row[1:])
        wanted = by_enumeration(rows, weights, here, place)
        kept, own = bodies.exclude(rows, weights)
        found = {tuple(row): float(np.exp(w)) for row, w in zip(kept.tolist(), own, strict=True)}
        assert found == pytest.approx(wanted, abs=1e-9)
    assert clashing > 10


def by_enumeration(
    rows: np.ndarray, weights: np.ndarray, here: np.ndarray, place: np.ndarray
) -> dict[tuple[int, ...], float]:
    """Hypotheses without what cannot be there beside the first track, by all worlds that are possible."""
    wanted: dict[tuple[int, ...], float] = {}
    for row, weight in zip(rows.tolist(), np.exp(weights), strict=True):
        left = tuple(
            slot if k == 0 or not solid_overlap(place[slot], place[row[0]]) else -1
            for k, slot in enumerate(row)
        )
        mass = 0.0
        for there in product((0, 1), repeat=3):
            apart = not any(
                there[a] and there[b] and solid_overlap(place[row[a]], place[row[b]])
                for a, b in ((0, 1), (0, 2), (1, 2))
            )
            chance = np.prod([here[s] if t else 1.0 - here[s] for s, t in zip(row, there, strict=True)])
            mass += apart * chance
        wanted[left] = wanted.get(left, 0.0) + weight * mass
    total = sum(wanted.values())
    return {row: mass / total for row, mass in wanted.items()}


def test_a_detection_within_a_thing_is_no_other_thing() -> None:
    """A detector that reports a box twice, 12 cm apart; of unknown size they would be two."""
    for width, count in ((0.4, 1), (0.0, 2)):
        model, rng = WorldModel(CONFIG), np.random.default_rng(0)
        for k in range(30):
            first, second = (rng.normal(0.0, SIGMA, 2) for _ in range(2))
            both = [(first[0], first[1], 1.0, width)]
            if k > 10:
                both.append((0.12 + second[0], second[1], 1.0, width))
            state = model.update(seen(*both), 0.05 * k)
        assert len(state.objects) == count


def test_a_cup_in_a_bowl_and_boxes_side_by_side_stay_two() -> None:
    for other in ((0.0, 0.02, 0.98, 0.1), (0.31, 0.0, 1.0, 0.3), (0.0, 0.0, 1.31, 0.3)):
        model, rng = WorldModel(CONFIG), np.random.default_rng(1)
        for k in range(30):
            pair = [(*(np.array(o[:3]) + rng.normal(0, SIGMA, 3)), o[3]) for o in ((0, 0, 1.0, 0.3), other)]
            state = model.update(seen(*pair), 0.05 * k)
        assert len(state.objects) == 2


@pytest.mark.parametrize(
    ("height", "end", "stays"),
    [(1.0, 2.0, False), (1.3, 2.0, True), (1.0, -0.3, True), (1.0, 0.05, True)],
)
def test_nothing_hangs_where_a_beam_went_through(height: float, end: float, stays: bool) -> None:
    """Beams at a height to a distance, past a box of 30 cm: through it, above it, in front of it, into it."""
    model, rng = WorldModel(CONFIG), np.random.default_rng(2)
    for k in range(20):
        model.update(seen((*(np.array([0.0, 0.0, 1.0]) + rng.normal(0, SIGMA, 3)), 0.3)), 0.05 * k)
    ends = np.array([[x, end, height] for x in np.linspace(-0.05, 0.05, 5)])
    for k in range(3):
        state = model.seen_through([0.0, -2.0, height], ends, 1.0 + 0.1 * k)
    box = state.find("box-1")
    assert (box is not None and box.existence > 0.9) == stays


def test_beams_are_checked() -> None:
    model = WorldModel(CONFIG)
    with pytest.raises(InputError, match="ends"):
        model.seen_through([0.0, 0.0, 1.0], [0.0, 1.0, 1.0], 0.0)
    with pytest.raises(InputError, match="origin"):
        model.seen_through([0.0, np.nan, 1.0], [[0.0, 1.0, 1.0]], 0.0)
