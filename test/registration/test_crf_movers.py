"""Labels alone, where the sensor's motion is known: as the whole inference has them, for less."""

from __future__ import annotations

import numpy as np
from numpy.testing import assert_allclose, assert_array_equal

from registration import Scan
from registration.align import among_movers
from registration.crf import JointModel
from registration.outline import outline_of
from whereabouts.experiments.crf import f1_of
from whereabouts.experiments.crf_metrics import scores
from whereabouts.simulation import Lidar, random_room
from whereabouts.simulation.labelled_pairs import protocol
from whereabouts.simulation.pairs import free_pose

LIDAR = Lidar(361, 2.0 * np.pi * 360 / 361)


def test_what_moves_is_what_the_whole_inference_says() -> None:
    model, counts = JointModel.load(), []
    for pair in protocol(6):
        a, b = pair.scan_a, pair.scan_b
        registration = among_movers(outline_of("a", a), outline_of("b", b), np.zeros(3))
        assert registration.converged
        whole, labels = model.infer(a, b, registration), model.movers(a, b, registration)
        assert_array_equal(labels.moving, whole.moving)
        counts.append(scores(pair, labels).counts)
    assert f1_of(counts)[0] > 0.88


def test_nothing_moves_in_a_room_where_nothing_does() -> None:
    room = random_room(np.random.default_rng(3))
    rng = np.random.default_rng(0)
    pose = free_pose(room, rng, 2.0)
    a, b = (LIDAR.scan(room, pose + step, rng).scan for step in (np.zeros(3), np.array([0.2, 0.05, 0.1])))
    registration = among_movers(outline_of("a", a), outline_of("b", b), np.zeros(3))
    found = JointModel.load().movers(a, b, registration)
    assert found.converged
    assert not found.moving.any()
    assert np.mean(found.clusters[a.valid] == 0) > 0.8
    assert_allclose(found.motions, registration.transform[None])
    assert np.nanmax(found.probabilities) == 0.0


def test_too_few_returns_are_no_answer() -> None:
    room = random_room(np.random.default_rng(3))
    scan = LIDAR.scan(room, free_pose(room, np.random.default_rng(1), 2.0), np.random.default_rng(0)).scan
    registration = among_movers(outline_of("a", scan), outline_of("b", scan), np.zeros(3))
    found = JointModel.load().movers(Scan([1.0], 0.0, 0.1), scan, registration)
    assert not found.converged
    assert "returns" in found.reason
