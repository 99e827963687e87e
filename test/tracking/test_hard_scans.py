"""Scans that are not what a tracker was made for: glass, somebody who sits down, a robot that is pushed."""

from __future__ import annotations

import numpy as np
import pytest

from registration import Odometry, Scan
from tracking import PeopleTracker
from whereabouts.simulation import Lidar, Shapes, box, cast, circle, joined

Array = np.ndarray
LIDAR = Lidar(361, np.pi)
RATE = 10.0


def through_glass(room: Shapes, pane: Shapes, pose: Array, stamp: float, rng: np.random.Generator) -> Scan:
    """Glass along y answers what meets it head on, and one beam in twenty; the others see what is behind."""
    angles = pose[2] + LIDAR.bearings
    origins = np.broadcast_to(pose[:2], (LIDAR.beams, 2))
    behind, _ = cast(room, origins, angles, LIDAR.range_max)
    before, _ = cast(joined([room, pane]), origins, angles, LIDAR.range_max)
    answers = (np.abs(np.sin(angles)) < np.sin(np.deg2rad(8.0))) | (rng.random(LIDAR.beams) < 0.05)
    ranges = np.where(answers, before, behind) + 0.01 * rng.standard_normal(LIDAR.beams)
    return Scan(ranges, LIDAR.bearings[0], np.pi / 360.0, 0.05, LIDAR.range_max, stamp)


@pytest.mark.parametrize("speed", [0.0, 0.4])
def test_nobody_is_behind_or_in_glass(speed: float) -> None:
    room = joined([box(12.0, 8.0), box(0.6, 0.4, (2.0, 1.0, 0.3)), circle(3.0, -1.0, 0.15)])
    pane = Shapes(np.array([[1.5, -3.9, 1.5, 3.9]]))
    rng, tracker, told = np.random.default_rng(1), PeopleTracker(), 0
    for k in range(200):
        pose = np.array([-4.0 + speed * k / RATE % 4.5, 0.0, 0.2 * np.sin(0.02 * k)])
        told += len(tracker.step(through_glass(room, pane, pose, k / RATE, rng), pose, k / RATE))
    assert told / 200 < 0.1


@pytest.mark.parametrize(("speed", "told_of"), [(0.0, 0.6), (0.3, 0.95)])
def test_who_sits_down_stays_somebody(speed: float, told_of: float) -> None:
    """To a robot that stands, somebody at rest among the legs of a chair becomes doubtful; his label stays."""
    chair = np.array([2.5, 0.5])
    start, end = np.array([1.0, -3.0]), chair - [0.35, 0.0]
    legs = [circle(chair[0] + x, chair[1] + y, 0.02) for x in (-0.2, 0.2) for y in (-0.2, 0.2)]
    room = joined([box(10.0, 8.0), *legs])
    way = (end - start) / np.linalg.norm(end - start)
    across = np.array([-way[1], way[0]])
    rng, tracker, found, others = np.random.default_rng(2), PeopleTracker(), [], 0
    for k in range(400):
        stamp = k / RATE
        walked = min(stamp, float(np.linalg.norm(end - start)))
        sits = walked < stamp
        swing = 0.0 if sits else 0.25 * np.sin(2.0 * np.pi * stamp)
        feet = [start + walked * way + side * 0.1 * across + side * swing * way for side in (-1.0, 1.0)]
        pose = np.array([-2.0 + speed * stamp % 2.0, 0.0, 0.0])
        shapes = joined([room, *(circle(*foot, 0.055) for foot in feet)])
        told = tracker.step(LIDAR.scan(shapes, pose, rng, stamp).scan, pose, stamp)
        if stamp > 5.0:
            here = [target for target in told if np.linalg.norm(target.mean[:2] - end) < 0.5]
            found.append({target.label for target in here})
            others += len(told) - len(here)
    assert np.mean([bool(labels) for labels in found]) > told_of
    assert len(set.union(*found)) == 1
    assert others == 0


def test_a_robot_that_is_pushed_makes_people_of_furniture_for_a_moment_at_most() -> None:
    """Its wheels notice nothing; odometry from the scans does."""
    room = joined([box(9.0, 7.0), *(circle(x, y, 0.06) for x, y in ((2.0, 1.0), (2.5, -1.5), (3.0, 0.3)))])
    rng, tracker, odometry, told = np.random.default_rng(3), PeopleTracker(), Odometry(), 0
    for k in range(150):
        scan = LIDAR.scan(room, np.array([-2.0, 0.2, 0.12]) * [1.0, k // 50, k // 50], rng, k / RATE).scan
        pose = odometry.register(scan, k / RATE, np.zeros(3))
        told += len(tracker.step(scan, pose, k / RATE)) if k > 5 else 0
    assert told < 5
    assert odometry.pose == pytest.approx([0.0, 0.4, 0.24], abs=0.02)
