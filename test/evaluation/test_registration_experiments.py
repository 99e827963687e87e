"""The registration and odometry experiments run without recordings and report what they measured."""

from pathlib import Path

import numpy as np
import pytest

from evaluation.datasets import recording
from evaluation.experiments import odometry, registration
from evaluation.peers.point_to_line import PointToLine
from evaluation.registration.odometry_wheels import FAULTS, with_faults
from evaluation.running import Run, run
from evaluation.scenes.scan_pairs import EASY, random_pair
from registration import align
from whereabouts.logs import open_log
from whereabouts.simulation import Lidar
from whereabouts.simulation.robot import relative


def test_a_method_is_tallied_by_its_errors() -> None:
    rng = np.random.default_rng(0)
    lidar = Lidar(181, 2.0 * np.pi)
    tally = registration.measure(align, [random_pair(rng, lidar, EASY) for _ in range(5)])
    success, median_mm, median_ms, wrong = tally.row()
    assert success == 100.0
    assert wrong == 0.0
    assert 0.0 < median_mm < 20.0
    assert median_ms > 0.0


def test_other_libraries_have_the_signature_of_align() -> None:
    rng = np.random.default_rng(1)
    pair = random_pair(rng, Lidar(361, 2.0 * np.pi), EASY)
    for name, aligner in registration.methods().items():
        found = aligner(pair.source.scan, pair.target.scan)
        assert found.transform.shape == (3,), name


def test_absent_recordings_are_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = {key: part for key, part in odometry.PARTS.items() if part.needs}
    monkeypatch.setattr(odometry, "PARTS", recorded)
    found = run(Run("odometry", tmp_path, quick=True))
    assert any("want of recordings" in note for note in found.content["notes"])


def test_relative_errors_of_a_stretched_path() -> None:
    truth = np.column_stack((np.arange(0.0, 60.0, 0.5), np.zeros(120), np.zeros(120)))
    share, turn = odometry.relative_errors(truth * [1.02, 1.0, 1.0], truth)
    assert share == pytest.approx(0.02)
    assert turn == pytest.approx(0.0)


def test_simulated_floors_carry_wheels_and_truth() -> None:
    records, truth = odometry.simulated_floor(0, 1, Lidar(61))
    assert len(records) == len(truth)
    assert records[0].odometry is not None
    outcome = odometry.follow(records[:60], wheels=True)
    assert outcome.poses.shape == (60, 3)


def test_corrected_scans_are_joined_to_raw_ones_in_order() -> None:
    raw_path, corrected_path = (recording(f"carmen/{name}") for name in list(odometry.RAW.items())[-1])
    if raw_path is None or corrected_path is None:
        pytest.skip("the CARMEN recordings are not here")
    with open_log(raw_path) as log:
        raw = [record for record, _ in zip(log.scans(), range(200), strict=False)]
    with open_log(corrected_path) as log:
        corrected = [record for record, _ in zip(log.scans(), range(100), strict=False)]
    index = odometry.joined(raw, corrected)
    known = index[index >= 0]
    assert len(known) > 90
    assert (np.diff(known) > 0).all()


def test_faults_of_wheels_are_where_they_are_said_to_be() -> None:
    records, _ = odometry.simulated_floor(3, 1, Lidar(61))
    true = np.array([record.odometry for record in records])
    length = np.hypot(*np.diff(true[:, :2], axis=0).T)
    for fault in FAULTS:
        driven = with_faults(records, fault, np.random.default_rng(0))
        made = np.array([record.odometry for record in driven])
        moved = np.hypot(*np.diff(made[:, :2], axis=0).T)
        if fault == "good":
            assert made == pytest.approx(true - true[0], abs=1e-9)
        elif fault == "jump":
            assert np.sum(np.abs(moved - length) > 0.05) == pytest.approx(5, abs=2)
        elif fault == "slip":
            assert moved.sum() > 1.05 * length.sum()
        else:
            stood = [np.sum(np.abs(np.diff(path, axis=0)).max(axis=1) < 1e-12) for path in (made, true)]
            assert stood[0] - stood[1] == pytest.approx(50, abs=5)
            # Who catches up ends where good wheels do, but for the turns on the way.
            caught = np.hypot(*(made[-1] - true[-1])[:2]) < 0.01
            assert caught == (fault == "stall and catch up")


def test_the_plain_matcher_follows_a_simulated_floor() -> None:
    records, truth = odometry.simulated_floor(4, 1, Lidar(181, np.pi))
    run = odometry.follow(records[:200], True, by=PointToLine())
    assert np.hypot(*(run.poses[-1] - relative(truth[0], truth[199]))[:2]) < 0.1
