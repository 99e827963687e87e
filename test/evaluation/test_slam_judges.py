"""The second judge of closures, the plain peer, and place models that have not seen the building they are judged in."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from estimation.geometry.poses import between, compound
from evaluation.loops.loops_data import Reading, simulated
from evaluation.loops.place_training import train_plain
from evaluation.report import RunOptions
from evaluation.slam import slam_places, slam_proximity
from evaluation.slam.slam_direct import Direct, check, single_errors
from evaluation.slam.slam_judging import Followed, false_closures, misses
from loop_closure.places import recognizer
from loop_closure.places.pairs import PairRule
from loop_closure.places.place_model import PlaceModel
from registration import Scan
from whereabouts.logs import ScanRecord
from whereabouts.simulation import Drive, Lidar, random_floor, random_room

LIDAR = Lidar(beams=361)


def followed(scans: list[Scan], poses: np.ndarray) -> Followed:
    records = [
        ScanRecord(scan, float(k), pose=pose) for k, (scan, pose) in enumerate(zip(scans, poses, strict=True))
    ]
    return Followed(records, poses.copy(), np.zeros((len(poses), 3, 3)), poses.copy(), 0.0)


@pytest.fixture(scope="module")
def walk() -> Followed:
    """Nine poses 0.15 m apart in one room, along a bend."""
    rng = np.random.default_rng(2)
    room = random_room(rng)
    poses = np.column_stack((np.arange(9) * 0.15 - 1.2, 0.05 * np.arange(9), 0.1 * np.arange(9)))
    return followed([LIDAR.scan(room, pose, rng).scan for pose in poses], poses)


def test_two_scans_of_a_room_are_laid_on_each_other_and_two_of_a_corridor_are_not(walk: Followed) -> None:
    direct = Direct([record.scan for record in walk.records])
    truth = np.asarray(between(walk.truth[1], walk.truth[3]))
    found = direct.relative(1, 3, [truth + np.array([0.2, -0.1, 0.05]), np.array([5.0, 0.0, 3.0])])
    assert found == pytest.approx(truth, abs=0.03)
    angles = np.linspace(-np.pi, np.pi, 361)
    with np.errstate(divide="ignore"):
        ranges = np.minimum(1.0 / np.abs(np.sin(angles)), 100.0)
    corridor = Scan(np.where(ranges < 8.0, ranges, np.inf), -np.pi, angles[1] - angles[0], 0.05, 30.0)
    assert Direct([corridor, corridor]).relative(0, 1, [np.zeros(3)]) is None


def test_closures_are_judged_without_odometry(walk: Followed) -> None:
    direct = Direct([record.scan for record in walk.records])
    right = [(a, a + 2, np.asarray(between(walk.truth[a], walk.truth[a + 2]))) for a in range(3)]
    wrong = (0, 3, np.asarray(between(walk.truth[0], walk.truth[3])) + np.array([0.8, 0.0, 0.0]))
    # The reference calls the second one false, wrongly, and the last one, rightly.
    found = check(walk, direct, [*right, wrong], [1, 3])
    assert (found.checked, found.off, found.both, found.cleared) == (4, 1, 1, 1)
    assert check(walk, direct, [], []).checked == 0


def test_single_poses_that_are_off_are_told_apart(walk: Followed) -> None:
    direct = Direct([record.scan for record in walk.records])
    truth, poses = walk.truth.copy(), walk.poses.copy()
    poses[4] = compound(poses[4], [0.6, 0.0, 0.0])
    truth[6, 2] += 0.3
    # What moves for good is no single pose.
    truth[8:, 1] += 0.5
    worst = single_errors(Followed(walk.records, poses, walk.covariances, truth, 0.0), direct)
    assert worst[1, 0] == pytest.approx(0.6, abs=0.05)
    assert worst[0, 1] == pytest.approx(0.3, abs=0.02)
    assert worst[0, 0] < 0.15
    assert worst[1, 1] < 0.02


def test_the_plain_peer_closes_a_second_round() -> None:
    rng = np.random.default_rng(1)
    floor, waypoints = random_floor(rng, 2)
    drive = Drive(waypoints)
    once = np.array([drive(stamp) for stamp in np.arange(0.0, drive.duration, 0.5)])
    truth = np.concatenate((once, once))
    log = followed([LIDAR.scan(floor, pose, rng).scan for pose in truth], truth)
    run = slam_proximity.driven(log)
    assert len(run.closures) >= 3
    assert false_closures(misses(log, run.closures), 0.5) == []
    assert len(run.kept) == len(run.paths) == run.left
    np.testing.assert_allclose(run.estimate[:, :2], truth[:, :2], atol=0.2)


def test_slam_is_judged_with_a_model_that_has_not_seen_the_building(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    floor = simulated(0, Reading(step=2.0, local_map=0.0))
    model, trained = train_plain([floor], PairRule(1.0, 20.0), rounds=3), []

    def train(logs: tuple[Path, ...], config: object, building: str) -> PlaceModel:
        trained.append(building)
        return model

    monkeypatch.setattr(slam_places, "_trained", train)
    options = RunOptions(tmp_path, data=tmp_path, kept=tmp_path / "kept")
    shipped = recognizer.shipped_model
    for _ in range(2):
        with slam_places.without("intel", options):
            known = recognizer.PlaceRecognizer()
            known.add(floor.places[0], 0.0)
            assert isinstance(known.model, PlaceModel)
            assert not known.model.wide
    assert trained == ["intel"]
    with slam_places.without("csail", options):
        assert recognizer.shipped_model is shipped
    assert recognizer.shipped_model is shipped


@pytest.mark.parametrize("quick", [False, True])
def test_no_building_is_among_what_its_model_is_trained_on(tmp_path: Path, quick: bool) -> None:
    (tmp_path / "carmen").mkdir()
    for name in slam_places.TRAINED:
        (tmp_path / "carmen" / name).touch()
    table = slam_places.table(list(slam_places.BUILDINGS), RunOptions(tmp_path, quick=quick, data=tmp_path))
    rows = {str(log): str(text) for log, text in table.rows}
    assert "intel" not in rows["intel.clf.bz2"]
    assert "mit" not in rows["killian.g2o"]
    assert "mit" not in rows["infinite-corridor-corrected.log.gz"]
    assert "freiburg-101" in rows["intel.clf.bz2"]
    assert ("fr079" in rows["intel.clf.bz2"]) != quick
    assert rows["mit-csail.clf.bz2"] == "the shipped model"
    assert set(slam_places.JUDGED.values()) == {"left out", "model left out"}
