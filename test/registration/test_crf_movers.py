"""Labels alone, where the sensor's motion is known: as the whole inference has them, for less."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

from evaluation.crf.crf_metrics import f1_of, scores
from evaluation.scenes.labelled_pairs import protocol
from evaluation.scenes.scan_pairs import free_pose
from registration import Scan
from registration.crf import JointEstimate, JointModel, setup
from registration.crf.motion_hypotheses import hypotheses
from registration.laser.prepared import prepare
from registration.placement.align import among_movers
from whereabouts.simulation import Lidar, Mover, SimulatedScan, box, joined, outlines, random_room

LIDAR = Lidar(361, 2.0 * np.pi * 360 / 361)


def test_what_moves_is_what_the_whole_inference_says() -> None:
    model, counts = JointModel.load(), []
    # Of the second street, four pairs have movers that no group was found for.
    for pair in [*protocol(6), *protocol(7)]:
        a, b = pair.scan_a, pair.scan_b
        registration = among_movers(prepare("a", a), prepare("b", b), np.zeros(3))
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
    registration = among_movers(prepare("a", a), prepare("b", b), np.zeros(3))
    found = JointModel.load().movers(a, b, registration)
    assert found.converged
    assert not found.moving.any()
    assert np.mean(found.clusters[a.valid] == 0) > 0.8
    assert_allclose(found.motions, registration.transform[None])
    assert np.nanmax(found.probabilities) < 0.5


def test_too_few_returns_are_no_answer() -> None:
    room = random_room(np.random.default_rng(3))
    scan = LIDAR.scan(room, free_pose(room, np.random.default_rng(1), 2.0), np.random.default_rng(0)).scan
    registration = among_movers(prepare("a", scan), prepare("b", scan), np.zeros(3))
    found = JointModel.load().movers(Scan([1.0], 0.0, 0.1), scan, registration)
    assert not found.converged
    assert "returns" in found.reason


def test_a_second_pair_confirms_what_the_first_said_and_looks_for_what_it_did_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A box on its way through a room: both earlier scans show that it left, and only it."""
    model, rng = JointModel.load(), np.random.default_rng(2)
    room, pose = box(8.0, 6.0), np.array([0.5, -0.3, 0.2])
    mover = Mover("box", pose + np.array([1.2, 0.3, 0.4]), np.array([0.3, -0.6]), size=0.8)
    now, before, earlier = (
        LIDAR.scan(joined([room, outlines([mover], time)]), pose, rng, time) for time in (1.0, 0.5, 0.0)
    )
    asked = []

    def counting(*given):  # type: ignore[no-untyped-def]
        asked.append(given)
        return hypotheses(*given)

    monkeypatch.setattr(setup, "hypotheses", counting)

    def against(other: SimulatedScan, known: JointEstimate | None = None) -> JointEstimate:
        still = prepare("b", other.scan)
        registration = among_movers(prepare("a", now.scan), still, np.zeros(3))
        return model.movers(now.scan, other.scan, registration, known=known)

    first = against(before)
    truth = now.owners > 0
    assert np.mean(first.moving[truth]) > 0.9
    assert len(asked) == 1
    second = against(earlier, first)
    assert len(asked) == 1
    assert np.mean(second.moving[truth]) > 0.9
    assert not second.moving[~first.moving].any()
    assert_array_equal(second.probabilities[second.moving], first.probabilities[second.moving])
    assert second.motions.shape == (2, 3)
    nobody = replace(first, clusters=np.where(first.moving, 0, first.clusters))
    assert np.mean(against(earlier, nobody).moving[truth]) > 0.9
    assert len(asked) == 2
