"""A small robot in a flat, recorded as its drivers publish it: a short-range scanner, wheels with tf, base_footprint.

Frames and topics are those of a TurtleBot 3: `odom` -> `base_footprint` by the wheels, `base_footprint` -> `base_link`
-> `base_scan` fixed. The wheels have driven before: their pose does not begin at zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from estimation.geometry.poses import compound, pose_to_matrix
from whereabouts.logs import McapWriter, OdometryRecord, ScanRecord, TransformRecord
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.robot import Drive, Wheels
from whereabouts.simulation.shapes import Array, Shapes, box, joined

SCAN_RATE, WHEEL_RATE = 5.0, 30.0
MOUNT = np.array([-0.032, 0.0, 0.0])
WHEELS_AT = np.array([1.3, -0.6, 0.7])
BEGIN = 1_700_000_000.0
# All that the cheapest scanners are: short-sighted, noisy, and as slow as the scans come.
SHORT_RANGE = Lidar(
    360, np.deg2rad(359.0), range_min=0.12, range_max=3.5, sigma=0.015, dropout=0.03, sweep_time=0.199
)


@dataclass(frozen=True)
class Naming:
    """What the robot calls its frames and topics.

    base : the frame that the wheels place. broadcast : whether they say so on tf, beside the message.
    """

    scan: str = "scan"
    wheels: str = "odom"
    scanner: str = "base_scan"
    base: str = "base_footprint"
    odom: str = "odom"
    broadcast: bool = True


def flat() -> Shapes:
    """Two rooms with a door between them, furnished, 8 by 5 m."""
    furniture = [
        box(0.9, 0.4, (-3.3, 2.1, 0.0)), box(0.5, 0.5, (-1.4, -2.0, 0.4)), box(1.2, 0.5, (1.6, 2.1, 0.0)),
        box(0.4, 0.9, (3.6, -0.9, 0.0)), box(0.3, 0.3, (1.9, 0.0, 0.7)), box(0.6, 0.3, (-2.4, 0.1, 0.2)),
        box(0.4, 0.4, (3.5, 1.9, 0.0)), box(0.7, 0.3, (2.6, -2.2, 0.1)),
    ]  # fmt: skip
    walls = [box(0.12, 3.0, (0.1, 1.0, 0.0)), box(0.12, 0.8, (0.1, -2.1, 0.0))]
    return joined([box(8.0, 5.0), *walls, *furniture])


def way() -> Drive:
    """A round through both rooms."""
    points = [(-3.0, -1.4), (1.0, -1.4), (2.9, -1.5), (2.8, 1.2), (1.1, 1.1), (1.0, -1.2), (-1.2, -1.1),
              (-1.1, 1.5), (-3.2, 1.2), (-3.1, -1.2)]  # fmt: skip
    return Drive(points, speed=0.22, turn_rate=0.8)


def record(path: Path, naming: Naming | None = None, seed: int = 3, duration: float | None = None) -> Array:
    """Write the run; returns the truth at each scan, (N, 4): stamp, then x, y, yaw of the base where it began."""
    named, drive, rng = naming or Naming(), way(), np.random.default_rng(seed)
    scanner = Lidar(360, 2.0 * np.pi * 359 / 360, range_min=0.12, range_max=3.5, sigma=0.01, resolution=0.001)
    world, wheels = flat(), Wheels(scale=1.01, bias=0.02)
    driven, before, truth = WHEELS_AT, drive(0.0), []
    until = drive.duration if duration is None else duration
    with McapWriter(path) as writer:
        _mounts(writer, named)
        ticks = int(until * WHEEL_RATE)
        for tick in range(ticks):
            time = tick / WHEEL_RATE
            pose, stamp = drive(time), BEGIN + time
            driven, before = compound(driven, wheels.motion(before, pose, rng)), pose
            _wheels(writer, named, driven, stamp)
            if tick % round(WHEEL_RATE / SCAN_RATE) == 0:
                # Taken a little before, as scanners are: between two readings of the wheels.
                taken = max(0.0, time - 0.01)
                scan = scanner.scan(world, compound(drive(taken), MOUNT), rng, BEGIN + taken).scan
                writer.write_scan(
                    ScanRecord(scan, BEGIN + taken, named.scan, named.scanner), round(stamp * 1e9)
                )
                truth.append([BEGIN + taken, *drive(taken)])
    return np.array(truth)


def _mounts(writer: McapWriter, named: Naming) -> None:
    fixed = [(*MOUNT[:2], 0.172, 0.0, 0.0, 0.0)]
    links = [("base_link", named.scanner)]
    if named.base == "base_footprint":
        fixed, links = [(0.0, 0.0, 0.01, 0.0, 0.0, 0.0), *fixed], [(named.base, "base_link"), *links]
    records = [
        TransformRecord(pose_to_matrix(np.array(pose)), BEGIN, parent, child, "tf_static")
        for pose, (parent, child) in zip(fixed, links, strict=True)
    ]
    writer.write_transforms(records)


def _wheels(writer: McapWriter, named: Naming, pose: Array, stamp: float) -> None:
    writer.write_odometry(OdometryRecord(pose, stamp, named.wheels, named.odom, named.base))
    if named.broadcast:
        matrix = pose_to_matrix(np.array([*pose[:2], 0.0, 0.0, 0.0, pose[2]]))
        writer.write_transforms([TransformRecord(matrix, stamp, named.odom, named.base, "tf")])
