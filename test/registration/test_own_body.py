"""What the scanner sees of its own robot."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.geometry.poses import between, compound
from loop_closure import Slam
from registration import Odometry, Scan
from registration.laser.own_body import OwnBody
from whereabouts.simulation import Drive, Lidar, Shapes, box, joined, random_floor

BARE = Lidar(720, np.deg2rad(359.5), range_min=0.1, range_max=12.0)
LIDAR = replace(BARE, posts=0.2)
POSTS = LIDAR.on_posts


def turned(scan: Scan, beams: int) -> Scan:
    """The same as it comes from a scanner that begins its sweep at another beam each time."""
    first = scan.angle_min + beams * scan.angle_increment
    return Scan(np.roll(scan.ranges, -beams), first, scan.angle_increment, scan.range_min, scan.range_max)


@pytest.mark.parametrize("begins", [0, 50], ids=["at one beam", "anywhere"])
@pytest.mark.parametrize("period", [0.1, 0.02], ids=["10 Hz", "50 Hz"])
def test_posts_are_left_out_and_nothing_else(begins: int, period: float) -> None:
    rng = np.random.default_rng(2)
    floor, waypoints = random_floor(rng, rooms=2)
    drive, body, left, wrong = Drive(waypoints), OwnBody(), [], 0
    for number, stamp in enumerate(np.arange(0.0, 10.0, period)):
        scan = LIDAR.scan(floor, drive(stamp), rng, stamp).scan
        shift = number * begins
        own = np.roll(body.mask(turned(scan, shift), drive(stamp)), shift)
        left.append((POSTS & ~own).sum())
        wrong += int((own & ~POSTS & ~np.roll(POSTS, 2) & ~np.roll(POSTS, -2)).sum())
    assert left[0] == POSTS.sum()
    assert max(left[int(5.0 / period) :], default=0) == 0
    assert wrong == 0


def test_odometry_and_map_with_posts_are_almost_as_good_as_without() -> None:
    rng = np.random.default_rng(3)
    floor, waypoints = random_floor(rng, rooms=2)
    drive, odometry, slam = Drive(waypoints), Odometry(), Slam()
    begin = drive(0.0)
    for stamp in np.arange(0.0, 30.0, 0.1):
        scan = LIDAR.scan(floor, drive(stamp), rng, stamp).scan
        pose = odometry.register(scan, stamp)
        off = between(between(begin, drive(stamp)), pose)
        # Until they are known, half a metre on, they hold it back; it drifts by metres where they are not left out.
        assert np.hypot(*off[:2]) < 0.2
        slam.process(scan, pose)
    last = slam.keyframes[len(slam.keyframes) - 1].scan
    assert last.valid[~POSTS].sum() > 600
    assert not last.valid[POSTS].any()


@pytest.mark.parametrize(
    "walls",
    [box(40.0, 0.9), joined([box(40.0, 6.0), box(30.0, 0.1, (0.0, 0.5, 0.0))])],
    ids=["narrow passage", "wall to the left"],
)
def test_a_wall_alongside_is_no_part_of_the_robot(walls: Shapes) -> None:
    rng, body = np.random.default_rng(4), OwnBody()
    for x in np.arange(-8.0, 8.0, 0.1):
        pose = np.array([x, 0.0, 0.0])
        assert not body.mask(BARE.scan(walls, pose, rng).scan, pose).any()


def test_what_is_taken_off_the_robot_is_seen_through_again() -> None:
    rng, body, room = np.random.default_rng(5), OwnBody(), box(8.0, 6.0)
    for number, x in enumerate(np.arange(-3.0, 3.0, 0.1)):
        pose = np.array([x, 0.0, 0.0])
        scan = (LIDAR if number < 30 else BARE).scan(room, pose, rng).scan
        own = body.mask(scan, pose)
        if not 4 < number < 8:  # half a metre of way
            assert own.any() == (8 <= number < 30)


def test_somebody_who_stands_by_is_no_part_of_the_robot() -> None:
    """The scanner turns on the spot; a post of the world stays where it is."""
    rng, body = np.random.default_rng(6), OwnBody()
    world = joined([box(8.0, 6.0), box(0.1, 0.1, (0.5, 0.0, 0.0))])
    for yaw in np.arange(0.0, 7.0, 0.1):
        pose = compound(np.zeros(3), np.array([0.0, 0.0, yaw]))
        assert not body.mask(BARE.scan(world, pose, rng).scan, pose).any()


def test_who_keeps_pace_is_no_part_of_the_robot() -> None:
    """He goes ahead of the scanner for longer than a post would need; the posts stay known."""
    rng, body = np.random.default_rng(7), OwnBody()
    for number, x in enumerate(np.arange(-9.0, 2.0, 0.1)):
        pose = np.array([x, 0.0, 0.0])
        distance = 2.5 if number < 60 else 0.7
        world = joined([box(20.0, 6.0), box(0.2, 0.2, (x + distance, 0.0, 0.0))])
        own = body.mask(LIDAR.scan(world, pose, rng).scan, pose)
        if number > 10:
            assert not (own & ~POSTS & ~np.roll(POSTS, 2) & ~np.roll(POSTS, -2)).any()
            assert own[POSTS].all()
