"""ROS 1 bags: whole, compressed, zipped, cut anywhere."""

from __future__ import annotations

import contextlib
import zipfile
from types import SimpleNamespace

import numpy as np
import pytest
from rosbags.rosbag1 import Reader
from rosbags.typesys import get_types_from_msg

from whereabouts.logs import (
    DamagedLogError,
    LogError,
    MessageRecord,
    OdometryRecord,
    ScanRecord,
    TransformRecord,
    UnknownFormatError,
    open_log,
    open_raw,
)
from whereabouts.viewer.playback import play


def expected(path):
    """(topic, type, time) of all messages by rosbags' own reader."""
    with Reader(path) as reader:
        return [(connection.topic, connection.msgtype, time) for connection, time, _ in reader.messages()]


@pytest.mark.parametrize("compression", [None, "bz2", "lz4"])
def test_records_of_a_bag(tmp_path, bag1, noetic, entries, compression):
    log = open_log(bag1(tmp_path / "a.bag", entries(noetic), compression))
    records = list(log)
    assert log.format == "rosbag1"
    assert log.summary.records == {"wheel_odom": 30, "tf": 30, "scan": 30}
    (reason,) = log.summary.skipped
    assert "std_msgs/msg/String" in reason
    scans = [record for record in records if isinstance(record, ScanRecord)]
    np.testing.assert_allclose(scans[5].scan.ranges, 1.5 + 0.01 * np.arange(21), rtol=1e-6)
    assert scans[5].stamp == pytest.approx(100.5)
    assert scans[5].frame_id == "laser"  # recorded as "/laser"
    odometry = [record for record in records if isinstance(record, OdometryRecord)]
    np.testing.assert_allclose(odometry[7].pose, [0.7, -0.35, 0.07])
    np.testing.assert_allclose(odometry[7].twist, [0.4, 0, 0.2])
    assert (odometry[7].frame_id, odometry[7].covariance) == ("odom", None)
    tf = [record for record in records if isinstance(record, TransformRecord)]
    assert (tf[0].frame_id, tf[0].child_frame_id, tf[0].static) == ("odom", "base_link", False)


def test_raw_messages_are_those_of_rosbags_as_cdr(tmp_path, bag1, noetic, jazzy, entries):
    path = bag1(tmp_path / "a.bag", entries(noetic))
    raw = list(open_raw(path))
    assert [(m.name, m.type_name, m.log_time) for m in raw] == expected(path)
    last = [m for m in raw if m.name == "/scan"][-1]
    message = jazzy.store.deserialize_cdr(last.data, last.type_name)
    assert message.header.stamp.sec == 102
    assert not hasattr(message.header, "seq")
    assert last.topic.type_hash == jazzy.store.hash_rihs01("sensor_msgs/msg/LaserScan")


def test_a_bag_is_drawn(tmp_path, bag1, noetic, entries):
    scene = play(
        [bag1(tmp_path / "a.bag", entries(noetic))], SimpleNamespace(draw=lambda stamp, shapes: None)
    )
    assert scene.taken == 90  # scans, odometry and tf


def test_messages_are_given_by_log_time_even_where_chunks_overlap(tmp_path, bag1, noetic):
    generator = np.random.default_rng(2)
    times = (generator.permutation(300) + 5) * 1_000_000
    made = [("/a", "std_msgs/msg/String", int(time), noetic.string("x" * 50)) for time in times]
    path = bag1(tmp_path / "a.bag", made, chunk=1000)
    with Reader(path) as reader:
        assert len(reader.chunks) > 5
    assert [message.log_time for message in open_raw(path)] == sorted(times.tolist())


def test_a_type_of_its_own_is_carried_with_its_definition(tmp_path, bag1, noetic):
    store = noetic.store
    if "barc/msg/Encoder" not in store.fielddefs:
        store.register(get_types_from_msg("Header header\nfloat32 left\ntime at", "barc/msg/Encoder"))
    time = noetic.make("builtin_interfaces/msg/Time", sec=3, nanosec=4)
    message = store.types["barc/msg/Encoder"](header=noetic.header(5, "/b"), left=1.5, at=time)
    path = bag1(tmp_path / "a.bag", [("/wheels", "barc/msg/Encoder", 9, message)])
    (raw,) = open_raw(path)
    assert "float32 left" in raw.topic.definition
    assert "seq" not in raw.topic.definition
    (record,) = open_log(path, topics=["wheels"])
    assert isinstance(record, MessageRecord)
    assert (record.message.left, record.message.at.sec, record.stamp) == (1.5, 3, 5e-9)


def test_fields_that_ros2_added_are_filled_in(tmp_path, bag1, noetic, jazzy):
    pose = noetic.make(
        "geometry_msgs/msg/Pose",
        position=noetic.point(1.0, 2.0, 0.0, "Point"),
        orientation=noetic.quaternion(0.3),
    )
    marker = noetic.make(
        "visualization_msgs/msg/Marker",
        header=noetic.header(7, "/map"),
        ns="n",
        id=3,
        type=1,
        action=0,
        pose=pose,
        scale=noetic.point(1.0, 1.0, 1.0),
        color=noetic.make("std_msgs/msg/ColorRGBA", r=1.0, g=0.0, b=0.0, a=1.0),
        lifetime=noetic.make("builtin_interfaces/msg/Duration", sec=1, nanosec=0),
        frame_locked=False,
        points=[],
        colors=[],
        text="t",
        mesh_resource="",
        mesh_use_embedded_materials=False,
    )
    path = bag1(tmp_path / "a.bag", [("/m", "visualization_msgs/msg/Marker", 9, marker)])
    (raw,) = open_raw(path)
    back = jazzy.store.deserialize_cdr(raw.data, raw.type_name)
    assert (back.id, back.text, back.pose.position.y, back.texture_resource) == (3, "t", 2.0, "")


def test_a_zipped_bag(tmp_path, bag1, noetic, entries):
    path = bag1(tmp_path / "a.bag", entries(noetic))
    with zipfile.ZipFile(tmp_path / "a.bag.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.write(path, "a.bag")
    with open_log(tmp_path / "a.bag.zip") as log:
        assert len(list(log)) == 90


@pytest.mark.parametrize("share", np.linspace(0.02, 0.999, 14))
def test_a_cut_bag_is_read_up_to_its_last_whole_chunk(tmp_path, bag1, noetic, entries, share):
    whole = bag1(tmp_path / "a.bag", entries(noetic, count=80), "lz4")
    reference = expected(whole)
    cut = tmp_path / "cut.bag"
    cut.write_bytes(whole.read_bytes()[: int(share * whole.stat().st_size)])
    if cut.stat().st_size < 4117:  # rosbag pads its header to this size
        with pytest.raises(DamagedLogError, match="nothing can be read"):
            open_raw(cut)
        return
    log = open_raw(cut)
    got = [(m.name, m.type_name, m.log_time) for m in log]
    assert got == reference[: len(got)]
    if share > 0.5:
        assert got
    assert any("rosbag reindex" in reason for reason in log.summary.notes)


def test_a_bag_whose_index_was_never_written(tmp_path, bag1, noetic, entries):
    path = bag1(tmp_path / "a.bag", entries(noetic))
    content = bytearray(path.read_bytes())
    at = content.index(b"index_pos=") + len(b"index_pos=")
    content[at : at + 8] = bytes(8)
    (tmp_path / "killed.bag").write_bytes(content)
    log = open_raw(tmp_path / "killed.bag")
    assert [(m.name, m.type_name, m.log_time) for m in log] == expected(path)
    assert {topic.name for topic in log.topics} == {"/wheel_odom", "/tf", "/scan", "/chatter"}


def test_a_damaged_chunk_is_skipped_and_counted(tmp_path, bag1, noetic, entries):
    path = bag1(tmp_path / "a.bag", entries(noetic, count=80), "bz2")
    content = bytearray(path.read_bytes())
    second = content.index(b"BZh", content.index(b"BZh") + 3)
    content[second + 20 : second + 60] = bytes(40)
    path.write_bytes(content)
    log = open_raw(path)
    times = [message.log_time for message in log]
    assert 0 < len(times) < 320
    (remark,) = log.summary.skipped.values()
    assert remark.count == 1
    assert remark.first.startswith("byte ")


def test_bytes_that_do_not_fit_their_type_are_skipped(tmp_path, bag1, noetic, entries, monkeypatch):
    made = entries(noetic, count=3)
    original = type(noetic.store).serialize_ros1

    def shorten(self, message, kind):
        data = original(self, message, kind)
        return data[:-3] if kind.endswith("LaserScan") else data

    monkeypatch.setattr(type(noetic.store), "serialize_ros1", shorten)
    path = bag1(tmp_path / "a.bag", made)
    log = open_log(path)
    assert not [record for record in log if isinstance(record, ScanRecord)]
    assert any("/scan" in reason and remark.count == 3 for reason, remark in log.summary.skipped.items())


@pytest.mark.parametrize("text", [b"#ROSBAG V1.2\n", b"#ROSBAG VX\n"])
def test_other_versions_are_named(tmp_path, text):
    path = tmp_path / "old.bag"
    path.write_bytes(text + b"rest")
    with pytest.raises(UnknownFormatError, match="version"):
        open_log(path)


@pytest.mark.parametrize("compression", [None, "lz4"])
def test_random_damage_never_escapes_the_error_family(tmp_path, bag1, noetic, entries, compression):
    data = bag1(tmp_path / "a.bag", entries(noetic, 12), compression).read_bytes()
    generator = np.random.default_rng(9)
    path = tmp_path / "damaged.bag"
    for _ in range(25):
        damaged = bytearray(data)
        for place in generator.integers(0, len(data), 30):
            damaged[place] = generator.integers(0, 256)
        path.write_bytes(damaged)
        with contextlib.suppress(LogError), open_log(path) as log:
            for _ in log:
                pass
