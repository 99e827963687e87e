"""Written recordings, read back by rosbags and by the mcap package."""

from __future__ import annotations

from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.reader import make_reader
from rosbags.highlevel import AnyReader

from estimation.errors import InputError
from registration import Scan
from whereabouts.logs import (
    CloudRecord,
    LogError,
    McapWriter,
    OdometryRecord,
    ScanRecord,
    TransformRecord,
    WriteError,
    open_log,
    open_raw,
)
from whereabouts.logs.bags.encode import nanoseconds
from whereabouts.logs.bags.storage import Qos, Topic
from whereabouts.messages.decode import seconds

SCAN = ScanRecord(Scan([1.0, 2.5, 81.83], -1.0, 0.5, 0.1, 50.0, 3.25, 0.001), 3.25)
ODOMETRY = OdometryRecord(
    np.array([1.0, -2.0, 0.5]), 3.25, twist=np.array([0.5, 0.0, 0.1]), covariance=np.diag([0.1, 0.2, 0.3])
)
CLOUD = CloudRecord(np.array([[1.0, 2, 3], [4, 5, 6]]), 3.5, times=np.array([0.0, 0.25]))
MOUNT = TransformRecord(np.eye(4), 3.25, "base_link", "laser", "tf_static")


def write_all(path):
    with McapWriter(path) as writer:
        writer.write_transforms([MOUNT])
        writer.write_scan(SCAN)
        writer.write_odometry(ODOMETRY)
        writer.write_cloud(CLOUD)
    return writer


def read_by_rosbags(path):
    with AnyReader([path]) as reader:
        return {
            connection.topic: (connection, time, reader.deserialize(data, connection.msgtype))
            for connection, time, data in reader.messages()
        }


@pytest.mark.parametrize("name", ["a.mcap", "directory"])
def test_rosbags_reads_what_was_written(tmp_path, jazzy, name):
    writer = write_all(tmp_path / name)
    assert writer.counts == {"/tf_static": 1, "/scan": 1, "/wheel_odom": 1, "/points": 1}
    found = read_by_rosbags(tmp_path / name)
    connection, time, scan = found["/scan"]
    assert time == 3_250_000_000
    assert connection.msgtype == "sensor_msgs/msg/LaserScan"
    assert scan.ranges.tolist() == pytest.approx([1.0, 2.5, 81.83])
    assert (scan.angle_min, scan.angle_max, scan.range_max) == (-1.0, 0.0, 50.0)
    assert (scan.header.stamp.sec, scan.header.stamp.nanosec, scan.header.frame_id) == (
        3,
        250_000_000,
        "laser",
    )
    odometry = found["/wheel_odom"][2]
    assert (odometry.pose.pose.position.x, odometry.child_frame_id) == (1.0, "base_link")
    assert odometry.pose.pose.orientation.z == pytest.approx(np.sin(0.25))
    assert odometry.pose.covariance[[0, 7, 35]].tolist() == [0.1, 0.2, 0.3]
    cloud = found["/points"][2]
    assert (cloud.width, cloud.point_step, [field.name for field in cloud.fields]) == (
        2,
        20,
        ["x", "y", "z", "timestamp"],
    )
    tf = found["/tf_static"][2].transforms[0]
    assert (tf.header.frame_id, tf.child_frame_id, tf.transform.rotation.w) == ("base_link", "laser", 1.0)


def test_the_mcap_package_finds_a_finished_indexed_ros2_file(tmp_path, jazzy):
    write_all(tmp_path / "a.mcap")
    with (tmp_path / "a.mcap").open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        summary = reader.get_summary()
        assert summary.statistics.message_count == 4
        assert {chunk.compression for chunk in summary.chunk_indexes} == {"zstd"}
        for channel in summary.channels.values():
            schema = summary.schemas[channel.schema_id]
            assert schema.encoding == "ros2msg"
            assert channel.metadata["topic_type_hash"] == jazzy.store.hash_rihs01(schema.name)
            (qos,) = yaml.safe_load(channel.metadata["offered_qos_profiles"])
            latched = channel.topic == "/tf_static"
            assert qos["durability"] == ("transient_local" if latched else "volatile")
        (metadata,) = reader.iter_metadata()
        assert yaml.safe_load(metadata.metadata["serialized_metadata"])["message_count"] == 4


def test_records_come_back_as_they_were(tmp_path):
    write_all(tmp_path / "a.mcap")
    mount, scan, odometry, cloud = open_log(tmp_path / "a.mcap")
    assert mount.static
    np.testing.assert_allclose(scan.scan.ranges, SCAN.scan.ranges, rtol=1e-6)
    assert (scan.stamp, scan.scan.range_max, scan.frame_id) == (3.25, 50.0, "laser")
    assert scan.scan.valid.tolist() == [True, True, False]
    np.testing.assert_allclose(odometry.pose, ODOMETRY.pose)
    np.testing.assert_allclose(odometry.covariance, ODOMETRY.covariance)
    np.testing.assert_allclose(odometry.twist, ODOMETRY.twist)
    np.testing.assert_allclose(cloud.points, CLOUD.points)
    np.testing.assert_allclose(cloud.times, CLOUD.times)


def test_the_same_input_gives_the_same_bytes(tmp_path):
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
        write_all(tmp_path / name / "x.mcap")
        write_all(tmp_path / name / "bag")
    for relative in ("x.mcap", "bag/bag_0.mcap", "bag/metadata.yaml"):
        assert (tmp_path / "a" / relative).read_bytes() == (tmp_path / "b" / relative).read_bytes()


def test_many_messages_make_many_chunks(tmp_path, jazzy):
    noise = np.random.default_rng(1)
    with McapWriter(tmp_path / "a.mcap") as writer:
        for number in range(300):
            scan = Scan(noise.uniform(1, 40, 2000), -1.0, 0.001, 0.0, 50.0, float(number))
            writer.write_scan(ScanRecord(scan, float(number)))
    with (tmp_path / "a.mcap").open("rb") as stream:
        assert len(make_reader(stream).get_summary().chunk_indexes) > 2
    assert [record.stamp for record in open_log(tmp_path / "a.mcap")] == list(range(300))


def test_raw_messages_keep_type_definition_and_qos(tmp_path):
    topic = Topic(
        "/own",
        "my_msgs/msg/Thing",
        "float32 x\n",
        "ros2msg",
        "RIHS01_ab",
        (Qos("keep_all", 3, "best_effort"),),
    )
    with McapWriter(tmp_path / "a.mcap") as writer:
        writer.write_raw(topic, b"\0\1\0\0\0\0\x80\x3f", 17)
    (message,) = open_raw(tmp_path / "a.mcap")
    back = message.topic
    assert (back.name, back.type_name, back.definition) == (topic.name, topic.type_name, topic.definition)
    assert (back.type_hash, back.qos, message.log_time) == (topic.type_hash, topic.qos, 17)
    (record,) = open_log(tmp_path / "a.mcap", topics=["own"])
    assert record.message.x == 1.0


def test_a_type_nobody_knows_is_kept_without_definition(tmp_path):
    with McapWriter(tmp_path / "a.mcap") as writer:
        writer.write_raw(Topic("/own", "my_msgs/msg/Thing"), b"\0\1\0\0", 1)
    (message,) = open_raw(tmp_path / "a.mcap")
    assert message.data == b"\0\1\0\0"


@pytest.mark.parametrize("name", ["a.mcap", "directory"])
def test_after_an_error_nothing_is_left_and_the_old_stays(tmp_path, name):
    target = tmp_path / name
    write_all(target)
    before = [record.stamp for record in open_log(target)]

    def fail():
        with McapWriter(target) as writer:
            writer.write_scan(SCAN)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert [entry.name for entry in tmp_path.iterdir()] == [name]
    assert [record.stamp for record in open_log(target)] == before
    write_all(target)  # and it can be replaced
    assert [entry.name for entry in tmp_path.iterdir()] == [name]


def test_the_target_appears_only_at_the_end(tmp_path):
    with McapWriter(tmp_path / "a.mcap") as writer:
        writer.write_scan(SCAN)
        assert not (tmp_path / "a.mcap").exists()
    assert (tmp_path / "a.mcap").exists()


@pytest.mark.parametrize("stamp", [-1.0, 2.0**31, float("nan"), float("inf")])
def test_stamps_that_ros_cannot_express_are_refused(stamp):
    with pytest.raises(InputError, match="stamp"):
        nanoseconds(stamp)


def test_decimal_stamps_keep_their_decimals():
    assert nanoseconds(976052857.337284) == 976052857337284000
    assert nanoseconds(0.0) == 0


@settings(max_examples=300)
@given(stamp=st.integers(0, 2**31 * 10**6 - 1).map(lambda micros: micros / 1e6))
def test_stamps_in_microseconds_come_back_to_the_last_bit(stamp):
    whole, rest = divmod(nanoseconds(stamp), 10**9)
    assert seconds(SimpleNamespace(sec=whole, nanosec=rest)) == stamp


def test_targets_that_cannot_be_written_are_named(tmp_path):
    (tmp_path / "file").write_text("x")
    (tmp_path / "folder.mcap").mkdir()
    for target, reason in (
        ("no/a.mcap", "does not exist"),
        ("file", "is a file"),
        ("folder.mcap", "is a directory"),
    ):
        with pytest.raises(WriteError, match=reason):
            write_all(tmp_path / target)
    writer = McapWriter(tmp_path / "a.mcap")
    with pytest.raises(WriteError, match="not open"):
        writer.write_scan(SCAN)


def test_a_record_longer_than_any_file_is_no_defect(tmp_path: Path) -> None:
    path = tmp_path / "long.mcap"
    with McapWriter(path) as writer:
        for k in range(9):
            writer.write_odometry(OdometryRecord(np.zeros(3), float(k)))
    whole = path.read_bytes()
    # The first record follows the mark of eight bytes. A record begins with its kind and length. Kind 6 is a chunk: its
    # head ends with the length of what is packed in it.
    at = 8
    while whole[at] != 6:
        at += 9 + int.from_bytes(whole[at + 1 : at + 9], "little")
    for place in range(at + 1, at + 64):
        broken = bytearray(whole)
        broken[place] = 0xFF
        path.write_bytes(broken)
        with suppress(LogError), open_log(path) as log:
            list(log)
