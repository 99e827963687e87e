"""ROS messages as records: layouts of clouds, echoes, covariances, frames."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from whereabouts.logs import CloudRecord, TransformRecord, open_log
from whereabouts.logs.bags.storage import Qos, format_qos, parse_qos

CLOUD = "sensor_msgs/msg/PointCloud2"
TYPES = {"f4": 7, "f8": 8, "u4": 6, "u2": 4, "i1": 1}


def cloud(jazzy, values, height=1, row_padding=0, fields=None):
    """A PointCloud2 of a structured array; byte order as the array's."""
    layout = values.dtype
    made = []
    for name in fields or layout.names:
        kind, offset = layout.fields[name][:2]
        made.append(
            jazzy.make(
                "sensor_msgs/msg/PointField", name=name, offset=offset, datatype=TYPES[kind.str[1:]], count=1
            )
        )
    width = len(values) // height
    rows = values.reshape(height, width)
    data = b"".join(row.tobytes() + bytes(row_padding) for row in rows)
    return jazzy.make(
        CLOUD,
        header=jazzy.header(5_000_000_000, "/velodyne"),
        height=height,
        width=width,
        fields=made,
        is_bigendian=layout["x"].str[0] == ">",
        point_step=layout.itemsize,
        row_step=width * layout.itemsize + row_padding,
        data=np.frombuffer(data, dtype=np.uint8),
        is_dense=False,
    )


def layout(names, kinds, offsets, size):
    return np.dtype({"names": names, "formats": kinds, "offsets": offsets, "itemsize": size})


LAYOUTS = {
    "packed float32": layout(["x", "y", "z"], ["<f4"] * 3, [0, 4, 8], 12),
    "padded with intensity": layout(["x", "y", "z", "intensity"], ["<f4"] * 4, [0, 4, 8, 16], 32),
    "float64": layout(["x", "y", "z"], ["<f8"] * 3, [0, 8, 16], 24),
    "mixed and reordered": layout(["z", "y", "x"], ["<f8", "<f4", "<f4"], [8, 0, 4], 20),
    "big endian": layout(["x", "y", "z"], [">f4"] * 3, [0, 4, 8], 16),
    "with ring": layout(["x", "y", "z", "ring"], ["<f4", "<f4", "<f4", "<u2"], [0, 4, 8, 12], 22),
}


@pytest.mark.parametrize("kind", LAYOUTS.values(), ids=LAYOUTS.keys())
@pytest.mark.parametrize(("height", "padding"), [(1, 0), (4, 0), (4, 5)])
def test_every_layout_of_a_cloud(tmp_path, bag2, jazzy, kind, height, padding):
    values = np.zeros(40, dtype=kind)
    points = np.random.default_rng(1).normal(size=(40, 3)).round(2)
    for index, axis in enumerate("xyz"):
        values[axis] = points[:, index]
    values["y"][[3, 17]] = np.nan
    values["z"][20] = np.inf
    path = bag2(tmp_path / "b", [("/points", CLOUD, 9, cloud(jazzy, values, height, padding))])
    (record,) = open_log(path)
    assert isinstance(record, CloudRecord)
    kept = np.delete(points, [3, 17, 20], axis=0)
    np.testing.assert_allclose(record.points, kept, atol=1e-6)
    assert record.points.dtype == np.float64
    assert (record.stamp, record.frame_id, record.topic, record.times) == (5.0, "velodyne", "points", None)


@pytest.mark.parametrize(("name", "kind"), [("t", "<u4"), ("time", "<f4"), ("timestamp", "<f8")])
def test_times_of_points(tmp_path, bag2, jazzy, name, kind):
    values = np.zeros(5, dtype=[("x", "<f4"), ("y", "<f4"), ("z", "<f4"), (name, kind)])
    values[name], values["z"] = [0, 1, 2, 3, 4], 1.0
    values["x"][2] = np.nan
    (record,) = open_log(bag2(tmp_path / "b", [("/points", CLOUD, 9, cloud(jazzy, values))]))
    assert record.times.tolist() == [0, 1, 3, 4]


def test_an_empty_cloud_is_a_cloud(tmp_path, bag2, jazzy):
    values = np.zeros(0, dtype=LAYOUTS["packed float32"])
    (record,) = open_log(bag2(tmp_path / "b", [("/points", CLOUD, 9, cloud(jazzy, values))]))
    assert record.points.shape == (0, 3)


def test_clouds_that_cannot_be_read_are_skips(tmp_path, bag2, jazzy):
    values = np.zeros(5, dtype=LAYOUTS["packed float32"])
    flat = cloud(jazzy, values, fields=["x", "y"])
    short = cloud(jazzy, values)
    short.data = short.data[:-1]
    outside = cloud(jazzy, values)
    outside.fields[2].offset = 10
    huge = cloud(jazzy, values)
    huge.height, huge.width = 1_000_000, 1_000_000
    made = [("/points", CLOUD, time, message) for time, message in enumerate((flat, short, outside, huge))]
    log = open_log(bag2(tmp_path / "b", made))
    assert not list(log)
    assert {reason.split(": ")[1]: remark.count for reason, remark in log.summary.skipped.items()} == {
        "cloud without field z": 1,
        "cloud with less data than its size says": 2,
        "cloud with a field outside its points": 1,
    }


def test_the_first_echo_of_each_beam(tmp_path, bag2, jazzy):
    echoes = [[1.0, 2.0], [], [3.0]]
    message = jazzy.make(
        "sensor_msgs/msg/MultiEchoLaserScan",
        header=jazzy.header(1, "l"),
        angle_min=0.0,
        angle_max=0.2,
        angle_increment=0.1,
        time_increment=0.0,
        scan_time=0.1,
        range_min=0.1,
        range_max=30.0,
        ranges=[
            jazzy.make("sensor_msgs/msg/LaserEcho", echoes=np.array(e, dtype=np.float32)) for e in echoes
        ],
        intensities=[],
    )
    (record,) = open_log(bag2(tmp_path / "b", [("/s", "sensor_msgs/msg/MultiEchoLaserScan", 9, message)]))
    np.testing.assert_array_equal(record.scan.ranges, [1, np.nan, 3])


@pytest.mark.parametrize(
    "wrong",
    [{"angle_increment": 0.0}, {"range_max": 0.0}, {"angle_min": float("nan")}, {"range_min": float("inf")}],
)
def test_scans_that_make_no_sense_are_skips(tmp_path, bag2, jazzy, wrong):
    kind = "sensor_msgs/msg/LaserScan"
    made = [
        ("/scan", kind, 1, jazzy.scan(1, [1, 2, 3])),
        ("/scan", kind, 2, jazzy.scan(2, [1, 2, 3], **wrong)),
        ("/scan", kind, 3, jazzy.scan(3, [])),
    ]
    log = open_log(bag2(tmp_path / "b", made))
    assert len(list(log)) == 1
    assert log.summary.skipped_count == 2


def test_an_unusable_time_increment_is_unknown(tmp_path, bag2, jazzy):
    message = jazzy.scan(1, [1, 2], time_increment=float("nan"))
    (record,) = open_log(bag2(tmp_path / "b", [("/scan", "sensor_msgs/msg/LaserScan", 1, message)]))
    assert record.scan.time_increment == 0.0


def test_covariance_of_the_plane(tmp_path, bag2, jazzy):
    covariance = np.arange(36.0)
    message = jazzy.odometry(1, (0, 0, 0), covariance)
    (record,) = open_log(bag2(tmp_path / "b", [("/o", "nav_msgs/msg/Odometry", 1, message)]))
    assert record.covariance.tolist() == [[0, 1, 5], [6, 7, 11], [30, 31, 35]]


def test_nan_odometry_is_a_skip(tmp_path, bag2, jazzy):
    log = open_log(
        bag2(tmp_path / "b", [("/o", "nav_msgs/msg/Odometry", 1, jazzy.odometry(1, (0, float("nan"), 0)))])
    )
    assert not list(log)
    assert log.summary.skipped_count == 1


def test_a_quaternion_that_was_never_set_is_a_skip(tmp_path, bag2, jazzy):
    message = jazzy.odometry(1, (0, 0, 0))
    message.pose.pose.orientation = jazzy.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
    log = open_log(bag2(tmp_path / "b", [("/o", "nav_msgs/msg/Odometry", 1, message)]))
    assert not list(log)
    (reason,) = log.summary.skipped
    assert "quaternion" in reason


def test_static_transforms(tmp_path, bag2, jazzy):
    message = jazzy.tf(
        jazzy.transform(1, "base_link", "/laser", (0.2, 0.1, np.pi)),
        jazzy.transform(1, "/base_link", "cam", (0, 0, 0)),
    )
    first, second = open_log(bag2(tmp_path / "b", [("/tf_static", "tf2_msgs/msg/TFMessage", 1, message)]))
    assert isinstance(first, TransformRecord)
    assert first.static
    assert [(r.frame_id, r.child_frame_id) for r in (first, second)] == [
        ("base_link", "laser"),
        ("base_link", "cam"),
    ]
    np.testing.assert_allclose(first.transform @ [1, 0, 0, 1], [-0.8, 0.1, 0, 1], atol=1e-12)


@pytest.mark.parametrize("text", ["", "x: [", "17", "- 3", None])
def test_unreadable_qos_is_none(text):
    assert parse_qos(text) == ()


def test_qos_of_both_metadata_versions():
    numbers = "- history: 1\n  depth: 5\n  reliability: 2\n  durability: 1\n"
    assert parse_qos(numbers) == (Qos("keep_last", 5, "best_effort", "transient_local"),)
    offers = (Qos("keep_all", 3, "reliable", "volatile"), Qos())
    assert parse_qos(format_qos(offers)) == offers


def test_input_errors_are_one_family(tmp_path):
    with pytest.raises(InputError):
        open_log(tmp_path / "missing.bag")
