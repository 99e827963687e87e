"""Points of clouds of odd layouts, against bytes packed one value at a time."""

from __future__ import annotations

import struct
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from whereabouts.messages import decode

NAN, INF = float("nan"), float("inf")
POINTS = [
    (1.0, -2.0, 0.5),
    (NAN, 0.0, 1.0),
    (3.25, 4.0, -7.5),
    (0.0, INF, 2.0),
    (5.0, 6.0, NAN),
    (-8.0, 9.0, 2e6),
]
FINITE = [0, 2]
LETTERS = {7: "f", 8: "d", 4: "H", 6: "I"}
TINTS = [0x00FF8000 + k for k in range(6)]


def cloud(
    points: list[tuple[float, float, float]],
    offsets: dict[str, tuple[int, int]],
    step: int,
    height: int = 1,
    padding: int = 0,
    big: bool = False,
) -> Any:
    """A message; offsets : of each field and its type. The time of point k is k / 8."""
    width = len(points) // height
    data = bytearray(b"\xa5" * (height * (width * step + padding)))
    for k, (x, y, z) in enumerate(points):
        start = (k // width) * (width * step + padding) + (k % width) * step
        values = {
            "x": x,
            "y": y,
            "z": z,
            "t": k / 8.0,
            "ring": k,
            "rgba": TINTS[k],
            "rgb": struct.unpack("<f", struct.pack("<I", TINTS[k]))[0],
        }
        for name, (offset, kind) in offsets.items():
            struct.pack_into((">" if big else "<") + LETTERS[kind], data, start + offset, values[name])
    fields = [SimpleNamespace(name=n, offset=o, datatype=kind, count=1) for n, (o, kind) in offsets.items()]
    return SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=3, nanosec=0), frame_id="lidar"),
        height=height, width=width, fields=fields, is_bigendian=big, point_step=step,
        row_step=width * step + padding, data=np.frombuffer(bytes(data), np.uint8), is_dense=False,
    )  # fmt: skip


PLAIN = {"x": (0, 7), "y": (4, 7), "z": (8, 7)}
LAYOUTS = {
    "tight": (PLAIN, 12),
    "padded": (PLAIN, 32),
    "in any order": ({"z": (0, 7), "t": (4, 8), "x": (12, 7), "y": (16, 7)}, 20),
    "not aligned": ({"ring": (0, 4), "x": (2, 7), "y": (6, 7), "z": (10, 7)}, 15),
    "of several kinds": ({"x": (1, 8), "y": (9, 7), "z": (13, 8), "t": (21, 7)}, 26),
}


def test_beams_that_met_nothing_are_no_points_at_the_sensor() -> None:
    points = [
        (0.0, 0.0, 0.0),
        (0.0, 2.0, 0.0),
        (1.0, 0.0, 0.0),
        (0.0, 0.0, -0.0),
        (0.0, 0.0, 3.0),
        (-0.0, 0.0, 0.0),
    ]
    coloured = {**PLAIN, "rgba": (12, 6)}
    message = cloud(points, coloured, 16)
    (record,) = decode.clouds(message, "points")
    assert record.points.tolist() == [list(points[k]) for k in (1, 2, 4)]
    tints = decode.cloud_colors(message)
    assert tints is not None
    assert np.rint(tints[:, 2] * 255).tolist() == [TINTS[k] & 255 for k in (1, 2, 4)]


@pytest.mark.parametrize("place", [0, 2])
def test_times_that_are_none_take_no_points_with_them(place: int) -> None:
    message = cloud(POINTS, {**PLAIN, "t": (12, 7)}, 16)
    message.data = message.data.copy()
    message.data[16 * place + 12 : 16 * place + 16] = np.frombuffer(struct.pack("<f", NAN), np.uint8)
    (record,) = decode.clouds(message, "points")
    assert len(record.points) == len(FINITE)
    assert record.times is None


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize(("height", "padding"), [(1, 0), (2, 0), (3, 5)])
@pytest.mark.parametrize("name", LAYOUTS)
def test_points_of_any_layout(name: str, height: int, padding: int, big: bool) -> None:
    offsets, step = LAYOUTS[name]
    for points, expected in ((POINTS, FINITE), ([POINTS[k] for k in (0, 2, 0)] * 2, range(6))):
        (record,) = decode.clouds(cloud(points, offsets, step, height, padding, big), "points")
        assert record.points.dtype == np.float64
        assert record.points.tolist() == [list(points[k]) for k in expected]
        if "t" in offsets:
            assert record.times.tolist() == [k / 8.0 for k in expected]
        else:
            assert record.times is None


def test_points_are_no_view_of_the_message() -> None:
    """A message's memory is used again."""
    message = cloud(POINTS[:1], PLAIN, 12)
    (record,) = decode.clouds(message, "points")
    assert not np.shares_memory(record.points, message.data)


def test_a_cloud_of_which_nothing_is_finite_has_no_points() -> None:
    (record,) = decode.clouds(cloud([(NAN, NAN, NAN)] * 4, PLAIN, 12), "points")
    assert record.points.shape == (0, 3)


@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("kind", [("rgb", 7), ("rgba", 6)])
def test_colors_are_those_of_the_points(kind: tuple[str, int], big: bool) -> None:
    """Packed into a float or a whole number: 255, 128 and the number of the point."""
    message = cloud(POINTS, {**PLAIN, kind[0]: (16, kind[1])}, 24, 2, 3, big)
    found = decode.cloud_colors(message)
    assert found is not None
    (record,) = decode.clouds(message, "points")
    assert len(found) == len(record.points)
    np.testing.assert_allclose(255.0 * found, [[255.0, 128.0, k] for k in FINITE], atol=1e-9)
    assert decode.cloud_colors(cloud(POINTS, PLAIN, 12)) is None
