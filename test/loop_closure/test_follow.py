"""Following a log: which of its odometry topics are the wheels."""

from __future__ import annotations

import numpy as np
import pytest

from whereabouts.logs import OdometryRecord, ScanRecord
from whereabouts.recorded.follow import Follower, follow
from whereabouts.simulation import Lidar, box


@pytest.mark.parametrize("names", [("ground_truth/pose", "wheel_odom"), ("odom", "ground_truth/pose")])
def test_the_truth_beside_the_wheels_is_not_mixed_with_them(
    names: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    rng, taken = np.random.default_rng(0), []
    monkeypatch.setattr(Follower, "add_wheels", lambda self, record: taken.append(record.topic))
    records: list[OdometryRecord | ScanRecord] = []
    for k in range(3):
        pose = np.array([0.1 * k, 0.0, 0.0])
        records += [OdometryRecord(pose, float(k), name) for name in names]
        scan = Lidar(90).scan(box(8.0, 6.0), pose, rng, float(k)).scan
        records.append(ScanRecord(scan, float(k)))
    assert len(list(follow(records))) == 3  # type: ignore[arg-type]
    wanted = "wheel_odom" if "wheel_odom" in names else "odom"
    # Before the wheels were heard the only one there was is taken.
    assert taken[1:] == [wanted] * (len(taken) - 1)
    assert taken.count(wanted) == 3
