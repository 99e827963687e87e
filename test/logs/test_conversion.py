"""Any log as a rosbag2 recording: what is written, in which order, and with which times."""

from __future__ import annotations

import json

import numpy as np
import pytest
import typer
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import StoragePlugin
from typer.testing import CliRunner

from estimation.errors import InputError
from whereabouts.cli.convert import convert
from whereabouts.logs import LogError, NothingRecognisedError, convert_log, open_log, open_raw

RANGES = [1.0 + 0.01 * i for i in range(180)]


@pytest.fixture
def command():
    """Runs the sub-command as a user does."""
    app = typer.Typer()
    app.command()(convert)
    return lambda *arguments: CliRunner().invoke(app, [str(argument) for argument in arguments])


def convert_to(source, target, **options):
    convert_log(source, target, **options)
    return target


def read(path):
    """(topic, log time, message) by rosbags."""
    with AnyReader([path]) as reader:
        return [(c.topic, time, reader.deserialize(data, c.msgtype)) for c, time, data in reader.messages()]


def stamp_of(message):
    return message.header.stamp.sec + message.header.stamp.nanosec * 1e-9


def test_a_carmen_log(tmp_path, lines):
    source = tmp_path / "a.clf"
    text = [
        "PARAM robot_frontlaser_offset 0.25 0 h 0\n",
        lines.odom((1, 2, 0.5), 10.0),
        lines.flaser(RANGES, laser=(1.25, 2, 0), robot=(1, 2, 0), stamp=10.1),
        lines.odom((1, 2, 0.6), 10.2),
        lines.flaser(RANGES, laser=(1.25, 2, 0), robot=(1, 2, 0), stamp=10.3),
    ]
    source.write_text("".join(text))
    result = convert_log(source, tmp_path / "out.mcap")
    assert (result.scans, result.odometry, result.clouds) == (2, 2, 0)
    assert result.duration == pytest.approx(0.3)
    found = read(tmp_path / "out.mcap")
    assert [topic for topic, _, _ in found] == ["/wheel_odom", "/tf_static", "/scan", "/wheel_odom", "/scan"]
    tf = found[1][2].transforms[0]
    assert (tf.header.frame_id, tf.child_frame_id) == ("base_link", "laser")
    assert tf.transform.translation.x == pytest.approx(0.25)
    scan = found[2][2]
    assert stamp_of(scan) == pytest.approx(10.1)
    assert len(scan.ranges) == 180


@pytest.mark.parametrize("name", ["out.mcap", "out"])
def test_only_the_beginning(tmp_path, lines, name):
    source = tmp_path / "a.clf"
    source.write_text("".join(lines.flaser(RANGES, stamp=100.0 + 0.25 * i) for i in range(20)))
    whole = read(convert_to(source, tmp_path / "whole.mcap"))
    begun = read(convert_to(source, tmp_path / name, seconds=1.5))
    assert [stamp_of(m) for topic, _, m in begun if topic == "/scan"] == [100.0 + 0.25 * i for i in range(7)]
    again = read(convert_to(tmp_path / "whole.mcap", tmp_path / f"bag-{name}", seconds=1.5))
    assert [(topic, at) for topic, at, _ in again] == [(topic, at) for topic, at, _ in whole][: len(begun)]
    with pytest.raises(InputError, match="seconds: positive number"):
        convert_log(source, tmp_path / name, seconds=0.0)


def test_odometry_of_the_scans_where_the_log_has_none_of_its_own(tmp_path, lines):
    source = tmp_path / "a.clf"
    source.write_text(
        "".join(lines.flaser(RANGES, robot=(i, 0, 0), laser=(i, 0, 0), stamp=i) for i in range(3))
    )
    result = convert_log(source, tmp_path / "out.mcap")
    assert (result.scans, result.odometry) == (3, 3)
    odometry = [message for topic, _, message in read(tmp_path / "out.mcap") if topic == "/wheel_odom"]
    assert [message.pose.pose.position.x for message in odometry] == [0, 1, 2]
    assert convert_log(source, tmp_path / "out.mcap", topics=["scan"]).odometry == 0


def test_header_stamps_stay_and_log_times_never_go_back(tmp_path, lines):
    source = tmp_path / "a.clf"
    stamps = [5.0, 7.0, 6.0, 6.5, 8.0]
    source.write_text("".join(lines.flaser(RANGES, stamp=stamp) for stamp in stamps))
    result = convert_log(source, tmp_path / "out.mcap", topics=["scan"])
    scans = [(time, stamp_of(m)) for topic, time, m in read(tmp_path / "out.mcap") if topic == "/scan"]
    assert [stamp for _, stamp in scans] == stamps
    assert [time * 1e-9 for time, _ in scans] == [5.0, 7.0, 7.0, 7.0, 8.0]
    assert sum(remark.count for remark in result.summary.notes.values()) == 1


def test_stamps_beyond_ros_are_skips_and_a_rate_helps(tmp_path, lines):
    source = tmp_path / "a.clf"
    source.write_text(
        "".join(lines.flaser(RANGES, stamp=4.29497e9) for _ in range(4)) + lines.odom((0, 0, 0), -1)
    )
    with pytest.raises(NothingRecognisedError, match="a rate gives new stamps"):
        convert_log(source, tmp_path / "out.mcap")
    assert [entry.name for entry in tmp_path.iterdir()] == ["a.clf"]
    result = convert_log(source, tmp_path / "out.mcap", rate=10.0)
    assert (result.scans, result.odometry) == (4, 4)
    stamps = [record.stamp for record in open_log(tmp_path / "out.mcap").scans()]
    np.testing.assert_allclose(stamps, [0, 0.1, 0.2, 0.3])
    with pytest.raises(InputError, match="rate"):
        convert_log(source, tmp_path / "out.mcap", rate=0.0)


def test_two_lasers_have_two_mounts(tmp_path, lines):
    source = tmp_path / "a.clf"
    front = lines.flaser(RANGES, laser=(0.2, 0, 0), robot=(0, 0, 0), stamp=1)
    rear = lines.flaser(RANGES, laser=(-0.3, 0, np.pi), robot=(0, 0, 0), stamp=2, keyword="RLASER")
    source.write_text(front + rear)
    convert_log(source, tmp_path / "out.mcap")
    last = [message for topic, _, message in read(tmp_path / "out.mcap") if topic == "/tf_static"][-1]
    assert [tf.child_frame_id for tf in last.transforms] == ["laser", "rear_laser"]


def test_a_graph(tmp_path, lines):
    source = tmp_path / "a.g2o"
    source.write_text(
        "VERTEX_SE2 0 0 0 0\n"
        + lines.robotlaser(RANGES, stamp=1)
        + "VERTEX_SE2 1 1.1 0 0\n"
        + lines.robotlaser(RANGES, stamp=2)
        + "EDGE_SE2 0 1 1 0 0 1 0 0 1 0 1\n"
    )
    result = convert_log(source, tmp_path / "out.mcap")
    assert (result.scans, result.odometry) == (2, 2)
    last = [message for topic, _, message in read(tmp_path / "out.mcap") if topic == "/wheel_odom"][-1]
    assert last.pose.pose.position.x == pytest.approx(1.0)  # by the constraint, not as solved


def test_a_ros1_bag_keeps_all_messages(tmp_path, bag1, noetic, entries):
    source = bag1(tmp_path / "a.bag", entries(noetic))
    result = convert_log(source, tmp_path / "out.mcap")
    assert (result.scans, result.odometry, sum(result.messages.values())) == (30, 30, 120)
    found = read(tmp_path / "out.mcap")
    assert len(found) == 120
    assert [time for _, time, _ in found] == [message.log_time for message in open_raw(source)]
    before, after = list(open_log(source).scans()), list(open_log(tmp_path / "out.mcap").scans())
    for a, b in zip(before, after, strict=True):
        np.testing.assert_array_equal(a.scan.ranges, b.scan.ranges)
        assert (a.stamp, a.frame_id) == (b.stamp, b.frame_id)


@pytest.mark.parametrize("name", ["out.mcap", "directory"])
def test_a_ros2_database_is_copied(tmp_path, bag2, jazzy, entries, name):
    source = bag2(tmp_path / "bag", entries(jazzy), StoragePlugin.SQLITE3)
    convert_log(source, tmp_path / name)
    assert [(m.name, m.data, m.log_time) for m in open_raw(tmp_path / name)] == [
        (m.name, m.data, m.log_time) for m in open_raw(source)
    ]


def test_only_some_topics(tmp_path, bag2, jazzy, entries):
    source = bag2(tmp_path / "bag", entries(jazzy))
    result = convert_log(source, tmp_path / "out.mcap", topics=["scan", "/tf"])
    assert set(result.messages) == {"/scan", "/tf"}
    with pytest.raises(NothingRecognisedError, match="not in it"):
        convert_log(source, tmp_path / "none.mcap", topics=["/nothing"])
    assert not (tmp_path / "none.mcap").exists()


def test_progress_is_reported(tmp_path, lines):
    source = tmp_path / "a.clf"
    source.write_text("".join(lines.flaser(RANGES, stamp=i) for i in range(900)))
    seen: list[float] = []
    convert_log(source, tmp_path / "out.mcap", report=seen.append)
    assert seen == sorted(seen)
    assert len(seen) > 2
    assert seen[0] >= 0
    assert seen[-1] <= 1


def test_the_command_says_in_one_line_what_it_wrote(tmp_path, lines, command):
    source = tmp_path / "a.clf"
    source.write_text(lines.flaser(RANGES, stamp=1) + "FLASER 3\n" + lines.flaser(RANGES, stamp=2))
    result = command(source, tmp_path / "out.mcap", "--json", tmp_path / "f.json")
    assert result.exit_code == 0, result.output
    (line,) = result.stdout.strip().splitlines()
    assert "2 scans, 2 odometry messages" in line
    assert "1 skipped" in line
    assert "line 2" in result.stderr
    figures = json.loads((tmp_path / "f.json").read_text())
    assert (figures["scans"], figures["odometry"], figures["duration_s"]) == (2, 2, 1.0)
    (skip,) = figures["skipped"].values()
    assert skip == {"count": 1, "first": "line 2"}


def test_the_command_explains_itself(command):
    text = command("--help").output
    for word in ("CARMEN", "ROS 1 bag", "--max-range", "--rate", "--topic", "--json", "Log times"):
        assert word in text


def test_errors_of_the_command_are_of_the_family(tmp_path, command):
    result = command(tmp_path / "nothing.clf", tmp_path / "out.mcap")
    assert isinstance(result.exception, LogError)
    assert not list(tmp_path.iterdir())
