"""How a bag is to be replayed, from what is in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from registration import Scan
from whereabouts.bag_profile import profile_of
from whereabouts.log_errors import NothingRecognisedError
from whereabouts.logs import CloudRecord, McapWriter, OdometryRecord, ScanRecord, TransformRecord

SCAN = Scan(np.full(10, 2.0), 0.0, 0.1, 0.1, 30.0, 1.0)


def test_robot_with_wheels_and_a_mounted_laser(tmp_path: Path) -> None:
    bag = tmp_path / "robot.mcap"
    with McapWriter(bag) as writer:
        writer.write_transforms([TransformRecord(np.eye(4), 1.0, "base_link", "laser", "tf_static")])
        writer.write_odometry(OdometryRecord(np.zeros(3), 1.0, topic="odom"))
        writer.write_odometry(OdometryRecord(np.zeros(3), 1.0, topic="ground_truth"))
        writer.write_scan(ScanRecord(SCAN, 1.0, topic="front_scan"))
    profile = profile_of(bag)
    assert profile.parameters == {"scan_topics": ["/front_scan"], "base_frame": "base_link"}
    assert profile.remappings == {"wheel_odom": "/odom"}
    assert profile.notes == ()


def test_bare_sensor_is_the_robot(tmp_path: Path) -> None:
    bag = tmp_path / "sensor.mcap"
    with McapWriter(bag) as writer:
        writer.write_cloud(CloudRecord(np.ones((5, 3)), 1.0, topic="velodyne", frame_id="lidar"))
    profile = profile_of(bag)
    assert profile.parameters == {"cloud_topics": ["/velodyne"], "base_frame": "lidar"}
    assert "no transform from 'lidar' to 'base_link'" in profile.notes[0]


def test_bag_without_sensors_is_refused(tmp_path: Path) -> None:
    bag = tmp_path / "wheels.mcap"
    with McapWriter(bag) as writer:
        writer.write_odometry(OdometryRecord(np.zeros(3), 1.0))
    with pytest.raises(NothingRecognisedError, match="neither LaserScan nor PointCloud2"):
        profile_of(bag)
