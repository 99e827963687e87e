"""Simulated worlds against geometry worked out another way."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from estimation.errors import InputError
from evaluation.scenes.people_scenes import peopled_floor
from evaluation.scenes.scan_pairs import CROWDED, EASY, random_pair
from evaluation.scenes.varied_floors import disturbed, things_stand_about, varied_floor
from whereabouts.simulation import (
    Drive,
    Lidar,
    Mover,
    Shapes,
    Wheels,
    box,
    cast,
    circle,
    corridor,
    joined,
    outlines,
    polygon,
    random_floor,
    random_room,
)
from whereabouts.simulation.robot import relative

angles = st.floats(-np.pi, np.pi)


@settings(max_examples=50)
@given(st.floats(-3.0, 3.0), st.floats(-1.5, 1.5), angles)
def test_rays_in_a_rectangle_end_on_its_walls(x: float, y: float, angle: float) -> None:
    ranges, owners = cast(box(8.0, 4.0), np.array([x, y]), np.array([angle]))
    end = np.array([x, y]) + ranges[0] * np.array([np.cos(angle), np.sin(angle)])
    assert owners[0] == 0
    assert max(abs(end[0]) / 4.0, abs(end[1]) / 2.0) == pytest.approx(1.0, abs=1e-9)


@settings(max_examples=50)
@given(angles, st.floats(0.1, 1.9))
def test_rays_meet_a_circle_where_the_quadratic_says(angle: float, radius: float) -> None:
    ranges, owners = cast(circle(3.0, 1.0, radius).owned_by(4), np.zeros(2), np.array([angle]))
    roots = np.roots([1.0, -2.0 * (3.0 * np.cos(angle) + np.sin(angle)), 10.0 - radius**2])
    if np.isreal(roots).all() and roots.real.min() > 0.0:
        assert ranges[0] == pytest.approx(roots.real.min(), abs=1e-6)
        assert owners[0] == 4
    elif not np.isreal(roots).all():
        assert np.isinf(ranges[0])
        assert owners[0] == -1


def test_the_nearest_outline_hides_the_others() -> None:
    world = joined([box(10.0, 10.0), circle(2.0, 0.0, 0.5).owned_by(1)])
    ranges, owners = cast(world, np.zeros(2), np.array([0.0, np.pi]))
    np.testing.assert_allclose(ranges, [1.5, 5.0])
    np.testing.assert_array_equal(owners, [1, 0])


def test_nothing_is_seen_at_or_beyond_the_maximum() -> None:
    ranges, owners = cast(box(10.0, 10.0), np.zeros(2), np.array([0.0]), max_range=5.0)
    assert np.isinf(ranges[0])
    assert owners[0] == -1


def test_scan_noise_dropouts_and_maximum() -> None:
    rng = np.random.default_rng(3)
    lidar = Lidar(beams=20001, sigma=0.02, dropout=0.1, range_max=4.5)
    seen = lidar.scan(circle(0.0, 0.0, 4.0), (3.0, 0.0, 0.0), rng)
    assert not seen.scan.valid.any()  # inside a circle there is no outline to hit from outside
    wall = Shapes(np.array([[3.0, -50.0, 3.0, 50.0]]))
    seen = lidar.scan(wall, (0.0, 0.0, 0.0), rng)
    expected = 3.0 / np.cos(seen.scan.bearings)
    near = expected < 4.0
    hit = seen.owners >= 0
    assert np.mean(hit[near]) == pytest.approx(0.9, abs=0.01)
    assert np.std((seen.scan.ranges - expected)[hit & near]) == pytest.approx(0.02, rel=0.05)
    np.testing.assert_array_equal(seen.scan.ranges[~hit], 4.5)
    np.testing.assert_array_equal(seen.scan.valid, hit)


def test_a_sweep_from_a_moving_sensor_sees_each_beam_from_its_own_place() -> None:
    lidar = Lidar(beams=5, opening=np.pi / 2, sigma=0.0, sweep_time=0.4)
    wall = Shapes(np.array([[10.0, -50.0, 10.0, 50.0]]))
    seen = lidar.scan(wall, lambda time: np.array([time, 0.0, 0.0]), np.random.default_rng(0))
    reach = seen.scan.ranges * np.cos(seen.scan.bearings)
    np.testing.assert_allclose(reach, 10.0 - np.array([0.0, 0.1, 0.2, 0.3, 0.4]), atol=1e-12)
    assert seen.scan.time_increment == pytest.approx(0.1)


def test_same_seed_same_world() -> None:
    for make in (random_room, lambda rng: random_floor(rng)[0]):
        a, b = make(np.random.default_rng(5)), make(np.random.default_rng(5))
        np.testing.assert_array_equal(a.segments, b.segments)
        np.testing.assert_array_equal(a.circles, b.circles)
    lidar = Lidar(beams=61)
    a, b = (random_pair(np.random.default_rng(9), lidar, CROWDED) for _ in range(2))
    np.testing.assert_array_equal(a.source.scan.ranges, b.source.scan.ranges)


def test_movers_are_labelled_and_cover_about_what_the_experiment_asks_for() -> None:
    rng = np.random.default_rng(0)
    lidar = Lidar()
    crowded = [random_pair(rng, lidar, CROWDED) for _ in range(40)]
    assert 0.2 < np.mean([np.mean(pair.target.owners > 0) for pair in crowded]) < 0.4
    empty = random_pair(rng, lidar, EASY)
    assert not (empty.target.owners > 0).any()
    assert np.hypot(*empty.motion[:2]) <= 0.2
    assert abs(empty.motion[2]) <= np.deg2rad(10.0)


def test_people_walk_at_their_speed_on_two_legs() -> None:
    walker = Mover("person", np.array([1.0, 2.0, 0.0]), np.array([1.0, 0.5]), size=0.7)
    for time in (0.0, 0.3, 1.7):
        legs = outlines([walker], time)
        assert len(legs.circles) == 2
        assert set(legs.circle_owners) == {1}
        np.testing.assert_allclose(legs.circles[:, :2].mean(axis=0), [1.0 + time, 2.0 + 0.5 * time])


@given(*[st.floats(-5.0, 5.0)] * 6)
def test_relative_undoes_compounding(
    ax: float, ay: float, at: float, mx: float, my: float, mt: float
) -> None:
    b = [ax + np.cos(at) * mx - np.sin(at) * my, ay + np.sin(at) * mx + np.cos(at) * my, at + mt]
    motion = relative([ax, ay, at], b)
    np.testing.assert_allclose(motion[:2], [mx, my], atol=1e-9)
    assert np.sin(motion[2]) == pytest.approx(np.sin(mt), abs=1e-9)


def test_a_drive_keeps_its_speed_and_clear_of_the_walls() -> None:
    for seed in range(3):
        shapes, waypoints = random_floor(np.random.default_rng(seed), rooms=3)
        drive = Drive(waypoints, speed=0.5)
        poses = np.array([drive(time) for time in np.arange(0.0, drive.duration, 0.2)])
        assert np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1).max() <= 0.1 + 1e-9
        assert min(shapes.distance(pose[:2]) for pose in poses) > 0.2


def test_wheels_err_as_configured() -> None:
    rng = np.random.default_rng(1)
    wheels = Wheels(scale=1.05, per_metre=0.03, per_radian=0.02)
    driven = np.array(
        [
            wheels.motion([1.0, 1.0, 0.3], [1.0 + np.cos(0.3), 1.0 + np.sin(0.3), 0.8], rng)
            for _ in range(4000)
        ]
    )
    assert driven[:, 0].mean() == pytest.approx(1.05, abs=0.002)
    assert driven[:, 0].std() == pytest.approx(0.03, rel=0.1)
    assert driven[:, 2].std() == pytest.approx(0.02 * np.sqrt(0.5), rel=0.1)


@pytest.mark.parametrize("call", [lambda: polygon([[0.0, 0.0]]), lambda: Drive([[0.0, 0.0]])])
def test_wrong_shapes_are_refused(call) -> None:
    with pytest.raises(InputError):
        call()


def test_a_corridor_looks_the_same_from_every_place_along_it() -> None:
    angles_around = np.linspace(-np.pi, np.pi, 100)
    a, _ = cast(corridor(), np.array([0.0, 0.3]), angles_around, 10.0)
    b, _ = cast(corridor(), np.array([7.0, 0.3]), angles_around, 10.0)
    np.testing.assert_allclose(a, b)


def test_people_on_a_floor_keep_off_each_other_the_robot_and_the_furniture() -> None:
    scene = peopled_floor(np.random.default_rng(2), duration=20.0)
    assert 6 <= len(scene.people) <= 12
    assert set(scene.standing.tolist()) == {True, False}
    assert callable(scene.pose)
    solid = joined([scene.room, scene.things])
    for time in np.arange(0.0, 20.0, 0.2):
        spots = np.array([scene.pose(time)[:2], *(person.position(time) for person in scene.people)])
        gaps = np.linalg.norm(spots[:, None] - spots[None], axis=2)[~np.eye(len(spots), dtype=bool)]
        assert gaps.min() > 0.59
        assert min(solid.distance(spot) for spot in spots[1:]) > 0.3


def test_mixed_pixels_lie_between_the_sides_of_an_edge() -> None:
    world = joined([box(8.0, 6.0), circle(1.5, 0.0, 0.1)])
    plain, mixed = (
        Lidar(721, sigma=0.0, mixed=share).scan(world, np.zeros(3), np.random.default_rng(8)).scan.ranges
        for share in (0.0, 1.0)
    )
    changed = np.flatnonzero(plain != mixed)
    # The pole has two edges that are farther apart than 2 m from the wall behind it; the room has none.
    assert len(changed) == 0
    near = joined([world, circle(3.0, 1.0, 0.1)])
    plain, mixed = (
        Lidar(721, sigma=0.0, mixed=share).scan(near, np.zeros(3), np.random.default_rng(8)).scan.ranges
        for share in (0.0, 1.0)
    )
    changed = np.flatnonzero(plain != mixed)
    assert len(changed) == 2
    for beam in changed:
        low, high = sorted(plain[beam : beam + 2])
        assert low <= mixed[beam] <= high


def test_varied_floors_have_people_off_the_things_and_empty_ones_have_none() -> None:
    for seed in range(3):
        rng = np.random.default_rng(seed)
        assert not varied_floor(rng).people
        scene = varied_floor(rng, 6)
        assert scene.people
        assert len(scene.things.segments) + len(scene.things.circles) > 0
        solid = joined([scene.room, scene.things])
        for person in scene.people:
            assert solid.distance(person.position(5.0)) > 0.4
        again = varied_floor(np.random.default_rng(seed), 0)
        np.testing.assert_array_equal(
            again.room.segments, varied_floor(np.random.default_rng(seed)).room.segments
        )


def test_things_that_stand_about_hide_people_in_part_who_keep_off_them() -> None:
    shown = []
    for seed in range(12):
        scene = things_stand_about(np.random.default_rng(seed), 4.0)
        assert len(scene.things.segments) + len(scene.things.circles) > 0
        alone = replace(scene, things=box(60.0, 60.0), room=Shapes())
        for scan, free in zip(
            scene.scans(np.random.default_rng(1)), alone.scans(np.random.default_rng(1)), strict=True
        ):
            for k, (some, most) in enumerate(zip(scan.returns, free.returns, strict=True)):
                assert scene.things.distance(scan.people[k]) > 0.3
                if most > 5:
                    shown.append(some / most)
    # Some are in plain view, some are hidden, and many are hidden in part.
    assert np.mean(np.array(shown) > 0.95) > 0.2
    assert np.mean((np.array(shown) > 0.1) & (np.array(shown) < 0.9)) > 0.1


def test_wrong_poses_stay_near_the_true_ones() -> None:
    errors = np.concatenate([disturbed(np.random.default_rng(k), 10.0, 400) for k in range(20)])
    assert errors.shape == (8000, 3)
    assert 0.01 < np.abs(errors[:, :2]).mean() < 0.15
    assert np.abs(errors[:, 2]).mean() < 0.05
