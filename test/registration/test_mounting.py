"""Scans of tilted, mirrored and displaced scanners as the robot sees them."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from estimation.geometry.poses import compound
from registration.laser.mounting import level_pose, seen_from_robot, upright
from registration.laser.scan import Scan
from whereabouts.simulation import Lidar, box


def mounting(x: float, y: float, rotation: Rotation) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:2, 3] = rotation.as_matrix(), (x, y)
    return matrix


def box_scan(x: float, y: float, yaw: float, beams: int = 721, pitch: float = 0.0) -> Scan:
    """A scan of the walls x = ±4, y = ±3 from a scanner at (x, y, yaw), its plane tilted about its y axis."""
    bearings = np.linspace(-np.pi / 2, np.pi / 2, beams)
    # Direction of each beam on the ground; a wall is met when the ground distance is covered.
    beam = np.column_stack((np.cos(bearings), np.sin(bearings), np.zeros(beams)))
    world = Rotation.from_euler("ZY", [yaw, pitch]).apply(beam)
    with np.errstate(divide="ignore"):
        to_x = np.where(world[:, 0] > 0, (4.0 - x) / world[:, 0], (-4.0 - x) / world[:, 0])
        to_y = np.where(world[:, 1] > 0, (3.0 - y) / world[:, 1], (-3.0 - y) / world[:, 1])
    ranges = np.minimum(np.abs(to_x), np.abs(to_y))
    return Scan(ranges, -np.pi / 2, np.pi / (beams - 1), 0.05, 30.0)


def wall_distance(points: np.ndarray) -> np.ndarray:
    return np.minimum(np.abs(np.abs(points[:, 0]) - 4.0), np.abs(np.abs(points[:, 1]) - 3.0))


def test_level_scanner_keeps_its_planar_pose() -> None:
    pose = level_pose(mounting(0.3, -0.2, Rotation.from_euler("z", 0.7)))
    assert pose is not None
    assert np.allclose(pose, [0.3, -0.2, 0.7])


def test_upside_down_scanner_is_level_and_mirrored() -> None:
    turned = mounting(0.0, 0.0, Rotation.from_euler("x", np.pi))
    assert level_pose(turned) is not None
    scan = box_scan(0.5, 0.4, 0.0)
    mirrored = Scan(scan.ranges[::-1], scan.angle_min, scan.angle_increment, 0.05, 30.0)
    restored = upright(mirrored, turned).points()
    assert np.allclose(np.sort(restored, axis=0), np.sort(scan.points(), axis=0), atol=1e-9)


def test_tilted_scanner_is_not_level() -> None:
    assert level_pose(mounting(0.0, 0.0, Rotation.from_euler("y", np.radians(10.0)))) is None


@pytest.mark.parametrize("pitch", [0.0, np.radians(15.0)])
def test_walls_stay_where_they_are(pitch: float) -> None:
    scan = box_scan(0.5, 0.4, 0.3, pitch=pitch)
    tilted = mounting(0.5, 0.4, Rotation.from_euler("ZY", [0.3, pitch]))
    seen = seen_from_robot((scan, tilted))
    errors = wall_distance(seen.points())
    # Exact on the walls; where two walls meet, the corner's own sample may stay rough.
    assert np.median(errors) < 1e-6
    assert np.percentile(errors, 98) < 0.01
    # Half of the bearings around the robot are in the half circle of the scanner.
    assert 0.4 < np.isfinite(seen.ranges).mean() < 0.65


def test_nearest_surface_counts() -> None:
    ranges = np.full(181, 5.0)
    ranges[85:96] = 2.0
    scan = Scan(ranges, -np.pi / 2, np.pi / 180, 0.05, 30.0)
    seen = seen_from_robot((scan, mounting(-1.0, 0.0, Rotation.identity())))
    ahead = seen.ranges[np.abs(seen.bearings) < 0.05]
    assert np.allclose(ahead, 1.0, atol=0.02)


def test_scan_without_returns_gives_none() -> None:
    scan = Scan(np.full(181, np.nan), -np.pi / 2, np.pi / 180, 0.05, 30.0)
    assert len(seen_from_robot((scan, np.eye(4))).points()) == 0


def test_two_scanners_together_see_all_around() -> None:
    front, rear = box_scan(0.5, 0.4, 0.0), box_scan(0.1, 0.4, np.pi)
    seen = seen_from_robot(
        (front, mounting(0.2, 0.0, Rotation.identity())),
        (rear, mounting(-0.2, 0.0, Rotation.from_euler("z", np.pi))),
    )
    assert np.isfinite(seen.ranges).mean() > 0.95
    errors = wall_distance(seen.points() + np.array([0.3, 0.4]))
    assert np.percentile(errors, 98) < 0.01


def _on_the_way(place: np.ndarray, velocity: np.ndarray, begin: float, way: float, time: float) -> np.ndarray:
    """Pose (3,) at `begin` + `way` · `time` s of a scanner at `place` (3,) on a robot that goes on with `velocity`."""
    return np.asarray(compound((begin + way * time) * velocity, place))


@pytest.mark.parametrize("roll", [0.0, np.pi])
def test_sweeps_on_the_way_of_two_scanners_show_walls_where_they_are(roll: float) -> None:
    """A robot that drives and turns in a room of 8 by 6 m."""
    walls, lidar = box(8.0, 6.0), Lidar(361, np.radians(270.0), sigma=0.0, sweep_time=0.09)
    motion, elapsed = np.array([0.06, 0.0, 0.1]), 0.1
    mounted = []
    for x, y, yaw in ((0.3, 0.2, 0.8), (-0.3, -0.2, -2.4)):
        place = np.array([x, y, yaw])
        # One that hangs upside down sweeps the other way round: its first beam is the last of one that does not.
        begin, way = (0.0, 1.0) if roll == 0.0 else (lidar.sweep_time, -1.0)
        pose = partial(_on_the_way, place, motion / elapsed, begin, way)
        scan = lidar.scan(walls, pose, np.random.default_rng(0)).scan
        scan = replace(scan, ranges=scan.ranges[:: int(way)])
        mounted.append((scan, mounting(x, y, Rotation.from_euler("ZX", [yaw, roll]))))
    off = [
        np.quantile(wall_distance(seen_from_robot(*mounted, **told).points()), 0.95)
        for told in ({}, {"motion": motion, "elapsed": elapsed})
    ]
    assert off[0] > 0.1
    assert off[1] < 0.02
