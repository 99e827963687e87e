"""A PointCloud2 of 100,000 points as numpy's: what a node pays for each cloud.

    python bench/bench_clouds.py > bench/bench_clouds.txt

Each time: least and median of interleaved calls on one core, ms. "Points not finite": a fifth of them, as in organised
clouds. "Columns stacked and masked" is how it was done before.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
from rclpy.serialization import deserialize_message, serialize_message
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header

from whereabouts.nodes.messages.conversions import cloud_message, points_from_message

COUNT = 100_000
REPEATS = 25


def stacked(message: PointCloud2) -> np.ndarray:
    """As it was done before: columns stacked, and a mask whether it is needed or not."""
    kinds = {
        "names": ["x", "y", "z"],
        "formats": ["<f4"] * 3,
        "offsets": [0, 4, 8],
        "itemsize": message.point_step,
    }
    values = np.asarray(message.data, dtype=np.uint8).view(np.dtype(kinds))
    points = np.column_stack([values[axis].astype(np.float64) for axis in "xyz"])
    with np.errstate(invalid="ignore"):
        return points[(np.abs(points) <= 1e6).all(axis=1)]


def main() -> None:
    rng = np.random.default_rng(0)
    print(f"{COUNT:,} points, ms: least and median of {REPEATS}")
    for title, missing in (("all finite", 0.0), ("points not finite", 0.2)):
        points = rng.uniform(-40.0, 40.0, (COUNT, 3))
        points[rng.random(COUNT) < missing] = np.nan
        raw = serialize_message(cloud_message(Header(), points))
        message = deserialize_message(raw, PointCloud2)
        calls: dict[str, Callable[[], object]] = {
            "deserialised by rclpy": lambda r=raw: deserialize_message(r, PointCloud2),
            "points_from_message": lambda m=message: points_from_message(m),
            "columns stacked and masked": lambda m=message: stacked(m),
        }
        assert np.array_equal(points_from_message(message)[0], stacked(message))
        spent: dict[str, list[float]] = {name: [] for name in calls}
        for _ in range(REPEATS):
            for name, call in calls.items():
                begun = time.perf_counter()
                call()
                spent[name].append(1e3 * (time.perf_counter() - begun))
        print(title)
        for name, times in spent.items():
            print(f"  {name:30s} {min(times):7.3f} {np.median(times):7.3f}")


if __name__ == "__main__":
    main()
