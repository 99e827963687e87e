"""What a replay was recorded of, from a recording made here."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.demo.replayed import read_replay
from whereabouts.logs import McapWriter, OdometryRecord


def test_poses_and_closures_are_read_by_their_stamps(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    with McapWriter(path) as writer:
        for k in range(20):
            pose = np.array([0.5 * k, 0.0, 0.0])
            writer.write_odometry(OdometryRecord(pose, float(k), topic="odometry"))
            writer.write_odometry(OdometryRecord(1.1 * pose, float(k)))
    replayed = read_replay(path)
    assert replayed.path_length == pytest.approx(9.5)
    assert np.allclose(replayed.poses[:, 0], 0.5 * replayed.stamps)


def test_a_robot_that_stands_still_drives_no_way(tmp_path: Path) -> None:
    path = tmp_path / "out.mcap"
    rng = np.random.default_rng(2)
    with McapWriter(path) as writer:
        for k in range(500):
            pose = np.array([*rng.normal(0.0, 0.01, 2), 0.0])
            writer.write_odometry(OdometryRecord(pose, 0.1 * k, topic="odometry"))
    assert read_replay(path).path_length == 0.0
