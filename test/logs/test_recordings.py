"""The recordings, where they are: counts, beams and quirks as their description states them."""

from __future__ import annotations

import numpy as np
import pytest
from rosbags.rosbag1 import Reader

from whereabouts.logs import OdometryRecord, ScanRecord, TransformRecord, convert_log, open_log, open_raw


@pytest.mark.parametrize(
    ("name", "scans", "beams", "limit"),
    [
        ("intel-corrected", 910, 180, 50.0),
        ("freiburg-079-corrected", 4791, 360, 80.99),
        ("freiburg-101-corrected", 292, 360, 80.99),
        ("belgioioso-corrected", 395, 361, 80.99),
        ("infinite-corridor-corrected", 1941, 180, 50.0),
    ],
)
def test_corrected_logs(recorded, name, scans, beams, limit):
    log = open_log(recorded(f"carmen/{name}.log.gz"))
    records = list(log)
    assert len(records) == scans
    assert {len(record.scan) for record in records} == {beams}
    assert {record.scan.range_max for record in records} == {limit}
    assert all(record.odometry is None and record.pose is not None for record in records)
    assert set(log.summary.records) == {"scan"}


def test_raw_intel(recorded):
    log = open_log(recorded("carmen/intel.clf.bz2"))
    scans, odometry = 0, 0
    for record in log:
        scans += isinstance(record, ScanRecord)
        odometry += isinstance(record, OdometryRecord)
    assert (scans, odometry) == (13631, 26915)
    assert not log.summary.skipped
    notes = {reason: remark.count for reason, remark in log.summary.notes.items()}
    assert notes["stamp on scan earlier than the one before it, kept as recorded"] == 631


def test_raw_freiburg_has_its_laser_behind_the_centre(recorded):
    log = open_log(recorded("carmen/fr079.clf.bz2"), topics=["scan"])
    scans = list(log.scans())
    assert len(scans) == 4934
    assert all(len(record.scan) == 360 and record.pose is None for record in scans)
    np.testing.assert_allclose([record.sensor_pose for record in scans], [(-0.04, 0, 0)] * 4934, atol=2e-3)


BAGS = [
    "moving_objects/overtake_ego.bag",
    "moving_objects/parallel.bag",
    "people/demo_stationary_simple_environment.bag",
    "people/legs_training/negative_2.bag",
    "people/legs_training/positive_4_extracted.bag",
]


@pytest.mark.parametrize("name", BAGS)
def test_bags_agree_with_rosbags(recorded, name):
    path = recorded(name)
    with Reader(path) as reader:
        expected = [(connection.topic, time) for connection, time, _ in reader.messages()]
    raw = open_raw(path)
    assert sorted((message.name, message.log_time) for message in raw) == sorted(expected)
    assert not raw.summary.skipped
    assert not raw.summary.notes


def test_people(recorded):
    assert len(list(open_log(recorded("people/demo_stationary_simple_environment.bag")).scans())) == 1265
    with open_log(recorded("people/person_following_outdoor_1.bag.zip")) as log:
        scans = list(log.scans())
        assert len(scans) == 7170
        assert {len(record.scan) for record in scans} == {245}
        (labels,) = (
            r.count for reason, r in log.summary.skipped.items() if "leg_tracker/msg/Person" in reason
        )
        assert labels == 6179


def test_moving_objects(recorded):
    log = open_log(recorded("moving_objects/parallel.bag"))
    records = list(log)
    scans = [record for record in records if isinstance(record, ScanRecord)]
    assert len(scans) == 219
    assert {len(record.scan) for record in scans} == {360}
    assert np.mean([record.scan.valid.mean() for record in scans]) < 0.5
    frames = {r.frame_id for r in records if isinstance(r, TransformRecord)} | {scans[0].frame_id}
    assert not any(frame.startswith("/") for frame in frames)
    assert {reason.split(":")[0] for reason in log.summary.skipped} == {
        "/ego_pose",
        "/red_pose",
        "/rc_inputs",
        "/imu/data",
        "/wheel_speeds",
    }
    wheels = list(open_log(recorded("moving_objects/parallel.bag"), topics=["wheel_speeds"]))
    assert len(wheels) == 626
    assert wheels[0].type_name == "barc/msg/Encoder"


def test_a_bag_with_its_own_types_converts_whole(recorded, tmp_path):
    source = recorded("moving_objects/parallel.bag")
    result = convert_log(source, tmp_path / "out.mcap")
    assert sum(result.messages.values()) == len(list(open_raw(source)))
    assert not result.summary.skipped


def test_a_corrected_log_converts_without_odometry(recorded, tmp_path):
    result = convert_log(recorded("carmen/freiburg-101-corrected.log.gz"), tmp_path / "out.mcap")
    assert (result.scans, result.odometry) == (292, 0)
