"""Lines of the local map are as straight as they say, and what is uncertain of its direction says little along it."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.geometry.poses import between
from registration import Odometry
from registration.laser.local_map import LineMap
from registration.laser.prepared import view_of
from registration.laser.surface import scan_surface
from whereabouts.simulation import Drive, Lidar, box, corridor, joined, random_floor

CAMERA = Lidar(640, np.deg2rad(57.0), range_min=0.45, range_max=5.0, sigma=0.02)


@pytest.mark.parametrize("scans", [1, 3])
def test_normals_are_as_far_off_as_they_say(scans: int) -> None:
    """Lines of points beside each other share their noise: a dense scan tells a direction once, not once a beam."""
    rng, walls, squares = np.random.default_rng(11), corridor(), []
    for _ in range(20):
        lines = LineMap(30.0, 30.0)
        for number in range(scans):
            pose = np.array([0.05 * number, 0.0, 0.5])
            scan = CAMERA.scan(walls, pose, rng).scan
            lines.add(scan_surface(scan, CAMERA.sigma), view_of(scan), pose, 0.05 * number)
        target, count = lines.target, len(lines)
        lined = np.isfinite(target.tilt[:count]) & (target.points[:count, 0] < 3.0)
        off = np.arctan(target.normals[:count, 0] / target.normals[:count, 1])
        squares.append(np.mean((off**2 / target.tilt[:count])[lined]))
    assert 0.3 < np.mean(squares) < 2.0


def test_a_corridor_does_not_pull_a_noisy_narrow_view_along() -> None:
    """Only the wheels tell the way; the noise of the walls' directions must not be taken for a sight of it."""
    worst = []
    for seed in range(4):
        rng, odometry = np.random.default_rng([12, seed]), Odometry()
        floor, waypoints = random_floor(np.random.default_rng([31, seed]), 2)
        drive, off = Drive(waypoints, speed=0.4), []
        for number in range(60):
            pose, before = drive(0.1 * number), drive(0.1 * max(number - 1, 0))
            scan = CAMERA.scan(floor, pose, rng).scan
            odometry.register(scan, 0.1 * number, between(before, pose) if number else None)
            off.append(np.hypot(*between(between(drive(0.0), pose), odometry.pose)[:2]))
        worst.append(max(off))
    assert max(worst) < 0.1


def test_of_a_wall_seen_edge_on_a_scan_says_nothing_if_asked_to_stand_clear() -> None:
    """The map bends by centimetres, so a beam that runs along a wall may pass it on either side."""
    rng, lines = np.random.default_rng(14), LineMap(30.0, 30.0)
    wide = Lidar(361, 2.0 * np.pi * 360 / 361)
    walls = joined([box(12.0, 12.0), box(3.0, 0.2, (1.0, 1.0, 0.0))])
    scan = wide.scan(walls, np.zeros(3), rng).scan
    lines.add(scan_surface(scan, wide.sigma), view_of(scan), np.zeros(3), 0.0)
    beside = np.array([-2.0, 1.0 - 0.1 - 0.05, 0.0])
    empty = view_of(wide.scan(box(12.0, 12.0), beside, rng).scan)
    wall = np.abs(lines.points[:, 1] - 0.9) < 0.05
    assert lines.seen_through(empty, beside)[wall].mean() > 0.9
    assert not lines.seen_through(empty, beside, 0.24)[wall].any()
    opposite = np.array([-1.0, -3.0, 0.0])
    empty = view_of(wide.scan(box(12.0, 12.0), opposite, rng).scan)
    assert lines.seen_through(empty, opposite, 0.24)[wall].mean() > 0.9
