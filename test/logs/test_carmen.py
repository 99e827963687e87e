"""CARMEN logs: the meaning of every field, and what is done with lines that are wrong."""

from __future__ import annotations

import bz2
import gzip
import math
import zipfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from whereabouts.logs import (
    EmptyLogError,
    NothingRecognisedError,
    OdometryRecord,
    ScanRecord,
    UnknownFormatError,
    open_log,
)
from whereabouts.logs.formats.carmen_laser import beam_angles
from whereabouts.logs.summary import Summary

RANGES = [1.0 + 0.01 * i for i in range(180)]


def write(path: Path, *text: str) -> Path:
    path.write_text("".join(text))
    return path


def test_flaser_gives_scan_odometry_and_mount(tmp_path, lines):
    # A laser 0.3 m ahead of a robot that looks along +y stands 0.3 m further along +y.
    text = lines.flaser(RANGES, laser=(1, 2.3, math.pi / 2), robot=(1, 2, math.pi / 2), stamp=12.25)
    (record,) = open_log(write(tmp_path / "a.clf", text))
    assert isinstance(record, ScanRecord)
    assert (record.topic, record.frame_id, record.stamp, record.scan.stamp) == ("scan", "laser", 12.25, 12.25)
    np.testing.assert_allclose(record.scan.ranges, RANGES)
    np.testing.assert_allclose(record.odometry, [1, 2, math.pi / 2])
    np.testing.assert_allclose(record.sensor_pose, [0.3, 0, 0], atol=1e-9)
    assert record.pose is None


@pytest.mark.parametrize(
    ("count", "last", "step"),
    [(180, 89, 1), (181, 90, 1), (360, 89.5, 0.5), (361, 90, 0.5), (541, 90, 1 / 3)],
)
def test_first_beam_is_at_the_right_and_the_step_is_the_scanners(count, last, step):
    start, increment = beam_angles(count)
    assert math.degrees(start) == pytest.approx(-90)
    assert math.degrees(increment) == pytest.approx(step)
    assert math.degrees(start + (count - 1) * increment) == pytest.approx(last)


def test_odom_gives_pose_and_velocity(tmp_path, lines):
    (record,) = open_log(write(tmp_path / "a.log", lines.odom((1, 2, 0.5), 7.5, speed=0.4, turn=-0.2)))
    assert isinstance(record, OdometryRecord)
    np.testing.assert_allclose(record.pose, [1, 2, 0.5])
    np.testing.assert_allclose(record.twist, [0.4, 0, -0.2])
    assert (record.topic, record.stamp, record.frame_id) == ("wheel_odom", 7.5, "odom")


@pytest.mark.parametrize("name", ["robot_front_laser_max", "robot_frontlaser_max", "laser_front_laser_max"])
def test_maximum_range_comes_from_the_log(tmp_path, lines, name):
    text = f"PARAM {name} 8.0 0 host 0\n" + lines.flaser([7.99, 8.0, 81.83] * 60)
    (record,) = open_log(write(tmp_path / "a.clf", text))
    assert record.scan.range_max == 8.0
    assert record.scan.valid.tolist() == [True, False, False] * 60


def test_no_return_values_of_both_modes_are_none_where_the_log_is_silent(tmp_path, lines):
    (record,) = open_log(write(tmp_path / "a.clf", lines.flaser([30.0, 81.83, 51.06] * 60)))
    assert record.scan.valid.tolist() == [True, False, False] * 60


@pytest.mark.parametrize(
    ("stated", "limit"), [(81.9, 81.83), (82.0, 81.83), (80.0, 80.0), (120.0, 120.0), (0.0, 50.0)]
)
def test_a_stated_maximum_does_not_make_returns_of_a_sicks_error_codes(tmp_path, lines, stated, limit):
    text = lines.robotlaser([1.0, 81.83, 81.91], head=f"0 -1.57 3.14 0.0175 {stated} 0.01 0")
    (record,) = open_log(write(tmp_path / "a.log", text))
    assert record.scan.range_max == limit


def test_the_caller_may_set_the_maximum_range(tmp_path, lines):
    path = write(tmp_path / "a.clf", "PARAM robot_front_laser_max 8.0 0 h 0\n", lines.flaser(RANGES))
    (record,) = open_log(path, max_range=2.0)
    assert record.scan.range_max == 2.0


def test_a_corrected_pose_in_the_laser_field_is_not_taken_for_a_mount(tmp_path, lines):
    text = [
        lines.flaser(RANGES, laser=(0.2 * i, 0.5 * i, 0), robot=(0.2 * i, 0, 0), stamp=i) for i in range(5)
    ]
    records = list(open_log(write(tmp_path / "a.clf", *text)))
    assert records[0].pose is None
    for number, record in enumerate(records[1:], start=1):
        np.testing.assert_allclose(record.sensor_pose, [0, 0, 0], atol=1e-9)
        np.testing.assert_allclose(record.odometry, [0.2 * number, 0, 0])
        np.testing.assert_allclose(record.pose, [0.2 * number, 0.5 * number, 0])


def test_a_stated_mount_takes_the_laser_off_a_corrected_pose(tmp_path, lines):
    text = "PARAM robot_frontlaser_offset 0.3 0 h 0\n" + lines.flaser(
        RANGES, laser=(5.3, 4, 0), robot=(0, 0, 0)
    )
    (record,) = open_log(write(tmp_path / "a.clf", text))
    np.testing.assert_allclose(record.sensor_pose, [0.3, 0, 0])
    np.testing.assert_allclose(record.pose, [5.0, 4, 0])


@pytest.mark.parametrize("turn", [0.0, math.pi])
def test_the_rear_laser_looks_back(tmp_path, lines, turn):
    text = lines.flaser(RANGES, laser=(0.7, 2, turn), robot=(1, 2, 0), keyword="RLASER")
    (record,) = open_log(write(tmp_path / "a.clf", text))
    assert (record.topic, record.frame_id) == ("rear_scan", "rear_laser")
    np.testing.assert_allclose(record.sensor_pose[:2], [-0.3, 0], atol=1e-9)
    assert abs(record.sensor_pose[2]) == pytest.approx(math.pi)


def test_robotlaser_describes_itself(tmp_path, lines):
    head = "4 -2.0 4.0 0.02 30.0 0.01 1"
    text = lines.robotlaser(RANGES, stamp=3.5, head=head, remissions=[1, 2, 3])
    (record,) = open_log(write(tmp_path / "a.log", text))
    scan = record.scan
    assert (scan.angle_min, scan.angle_increment, scan.range_max, record.stamp) == (-2.0, 0.02, 30.0, 3.5)
    np.testing.assert_allclose(scan.ranges, RANGES)
    assert (
        next(iter(open_log(write(tmp_path / "b.log", text.replace("LASER1", "LASER2"))))).topic == "rear_scan"
    )


def test_a_mappers_log_has_poses_and_no_odometry(tmp_path, lines):
    text = lines.odom((0, 0, 0)) + lines.flaser(RANGES) + lines.odom((1, 2, 0.5), 0.0) + "NEFF 12\n"
    log = open_log(write(tmp_path / "a.log", text))
    (record,) = log
    assert record.odometry is None
    np.testing.assert_allclose(record.pose, [1, 2, 0.5])
    assert log.summary.skipped_count == 3


def test_stamps_stay_as_recorded_and_disorder_is_counted(tmp_path, lines):
    stamps = [5.0, 4.0, 4.0, 6.0, 0.0]
    log = open_log(write(tmp_path / "a.clf", *(lines.flaser(RANGES, stamp=stamp) for stamp in stamps)))
    assert [record.stamp for record in log] == stamps
    earlier, equal = (
        next(r for k, r in log.summary.notes.items() if word in k) for word in ("earlier", "equal")
    )
    assert (earlier.count, earlier.first, equal.count, equal.first) == (2, "line 2", 1, "line 3")


BROKEN = {
    "beam count": "FLASER 180 " + "1.0 " * 170 + "0 0 0 0 0 0 1 h 1\n",
    "garbage range": "FLASER 2 1.0 abc 0 0 0 0 0 0 1 h 1\n",
    "nan pose": "FLASER 2 1.0 1.0 nan 0 0 0 0 0 1 h 1\n",
    "inf stamp": "FLASER 2 1.0 1.0 0 0 0 0 0 0 inf h 1\n",
    "negative count": "FLASER -2 1.0 1.0 0 0 0 0 0 0 1 h 1\n",
    "huge count": "FLASER 99999999999 1.0\n",
    "no count": "FLASER\n",
    "odom cut": "ODOM 1 2\n",
    "odom garbage": "ODOM 1 x 0 0 0 0 1 h 1\n",
    "robotlaser cut": "ROBOTLASER1 0 1 2\n",
    "robotlaser zero step over nan": "ROBOTLASER1 0 nan 3 0.01 50 0 0 2 1 1 0 0 0 0 0 0 0 0 0 0 0 0 1 h 1\n",
    "unknown": "HELLO world\n",
    "binary": "\x01\x02\x03\n",
    "param cut": "PARAM robot_front_laser_max\n",
}


@pytest.mark.parametrize("broken", BROKEN.values(), ids=BROKEN.keys())
def test_one_broken_line_is_a_counted_skip_with_its_number(tmp_path, lines, broken):
    good = lines.flaser(RANGES)
    log = open_log(write(tmp_path / "a.clf", good, broken, good))
    assert len(list(log)) == 2
    (remark,) = log.summary.skipped.values()
    assert (remark.count, remark.first) == (1, "line 2")


def test_nan_readings_are_no_returns(tmp_path, lines):
    (record,) = open_log(write(tmp_path / "a.clf", lines.flaser([1.0, math.nan, math.inf])))
    assert record.scan.valid.tolist() == [True, False, False]


def test_comments_and_blank_lines_are_no_skips(tmp_path, lines):
    log = open_log(write(tmp_path / "a.clf", "# x\n\n#PARAM y\n", lines.flaser(RANGES), "\r\n"))
    assert len(list(log)) == 1
    assert not log.summary.skipped


def test_windows_line_ends(tmp_path, lines):
    (record,) = open_log(write(tmp_path / "a.clf", lines.flaser(RANGES).replace("\n", "\r\n")))
    assert len(record.scan) == 180


def test_reasons_that_differ_by_their_numbers_are_one():
    summary = Summary()
    for topic, count in (("/scan_1", 3), ("/scan_1", 25), ("/scan_2", 3), ("/1/scan", 3), ("/2/scan", 3)):
        summary.skip(f"{topic}: {count} of 1e-3 m, -0.{count} s", "line 1")
    assert [line.partition(" (")[0] for line in summary.lines()] == [
        "skipped 2 × /scan_1: 3 of 1e-3 m, -0.3 s",
        "skipped 1 × /scan_2: 3 of 1e-3 m, -0.3 s",
        "skipped 1 × /1/scan: 3 of 1e-3 m, -0.3 s",
        "skipped 1 × /2/scan: 3 of 1e-3 m, -0.3 s",
    ]


def test_a_log_can_be_read_again_and_the_summary_starts_anew(tmp_path, lines):
    log = open_log(write(tmp_path / "a.clf", lines.flaser(RANGES), "FLASER 3\n"))
    for _ in range(2):
        assert len(list(log)) == 1
        assert log.summary.skipped_count == 1
        assert log.summary.records == {"scan": 1}


def test_topics_filter(tmp_path, lines):
    path = write(tmp_path / "a.clf", lines.odom((0, 0, 0)), lines.flaser(RANGES))
    assert [record.topic for record in open_log(path, topics=["/scan"])] == ["scan"]
    assert [record.topic for record in open_log(path, topics=["wheel_odom"])] == ["wheel_odom"]


def test_a_topic_that_is_not_there_is_said(tmp_path, lines):
    log = open_log(write(tmp_path / "a.clf", lines.flaser(RANGES)), topics=["scan", "front_scan"])
    assert len(list(log)) == 1
    (note,) = log.summary.notes
    assert "front_scan" in note


def test_scans_of_one_topic_only(tmp_path, lines):
    text = [lines.flaser(RANGES, stamp=i, keyword=("FLASER", "RLASER")[i % 2]) for i in range(6)]
    log = open_log(write(tmp_path / "a.clf", *text))
    assert [record.stamp for record in log.scans()] == [0, 2, 4]
    assert [record.stamp for record in log.scans("/rear_scan")] == [1, 3, 5]


@pytest.mark.parametrize("name", ["a.clf.gz", "a.clf.bz2", "a.zip", "misnamed.bag"])
def test_packed_logs_are_known_by_content(tmp_path, lines, name):
    content = (lines.odom((0, 0, 0)) + lines.flaser(RANGES)).encode()
    path = tmp_path / name
    if name.endswith(".gz"):
        path.write_bytes(gzip.compress(content))
    elif name.endswith(".bz2"):
        path.write_bytes(bz2.compress(content))
    elif name.endswith(".zip"):
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            archive.writestr("run/a.clf", content)
            archive.writestr("__MACOSX/run/._a.clf", b"shadow")
    else:
        path.write_bytes(content)
    log = open_log(path)
    assert [record.topic for record in log] == ["wheel_odom", "scan"]
    assert log.progress == 1.0


@pytest.mark.parametrize("pack", [gzip.compress, bz2.compress])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.9, 0.999])
def test_a_cut_archive_is_read_to_where_it_breaks_off(tmp_path, lines, pack, share):
    generator = np.random.default_rng(3)
    text = "".join(lines.flaser(generator.uniform(1, 9, 180).round(3), stamp=i) for i in range(400))
    whole = b"".join([pack(text.encode())])
    path = tmp_path / "cut.clf"
    path.write_bytes(whole[: int(share * len(whole))])
    try:
        log = open_log(path)
    except EmptyLogError:
        assert pack is bz2.compress  # one block of bzip2 holds more than this
        return
    stamps = [record.stamp for record in log]
    assert stamps == [float(i) for i in range(len(stamps))]
    assert len(stamps) < 400
    assert any("breaks off" in reason for reason in log.summary.notes)


def test_a_file_without_one_message_is_an_error(tmp_path):
    with pytest.raises(NothingRecognisedError, match=r"a\.clf.*not one of 3 lines"):
        list(open_log(write(tmp_path / "a.clf", "this\nGPS 1\nprose\n")))


def test_prose_with_another_name_is_no_log(tmp_path):
    with pytest.raises(UnknownFormatError, match=r"notes\.txt.*CARMEN.*ROS 2"):
        open_log(write(tmp_path / "notes.txt", "this\nis\nprose\n"))


@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_no_mutation_of_a_line_escapes(tmp_path, lines, data):
    """Whatever happens to one line, the others are read and nothing but a record or a skip comes of it."""
    good = lines.flaser([1.0, 2.0, 3.0])
    victim = data.draw(st.sampled_from([good, lines.odom((1, 2, 3)), lines.robotlaser([1.0, 2.0])])).encode()
    start = data.draw(st.integers(0, len(victim)))
    stop = data.draw(st.integers(start, len(victim)))
    put = data.draw(
        st.one_of(st.binary(max_size=6), st.sampled_from([b" nan ", b" -1 ", b" 1e999 ", b" 0x1 "]))
    )
    mutated = victim[:start] + put + victim[stop:]
    path = tmp_path / "fuzz.clf"
    path.write_bytes(good.encode() + mutated + b"\n" + good.encode())
    records = list(open_log(path))
    assert len(records) >= 2
    for record in records:
        assert math.isfinite(record.stamp)
