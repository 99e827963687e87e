"""The simulated apartment: geometry, people, camera and the bag that is made from them."""

from __future__ import annotations

import runpy
from pathlib import Path

import numpy as np
import pytest

from estimation.errors import InputError
from whereabouts.logs import open_raw
from whereabouts.simulation import Drive
from whereabouts.simulation.home.apartment_bag import record
from whereabouts.simulation.home.apartment_camera import Camera, Item
from whereabouts.simulation.home.apartment_day import MOVED, PUT, THINGS, ApartmentDay
from whereabouts.simulation.home.apartment_people import CLEAR, SPOTS, WAYS, route
from whereabouts.simulation.home.floor_plan import CAMERA_HEIGHT, apartment, first_hits

BAG = Path(__file__).resolve().parents[2] / "bags" / "apartment.mcap"


@pytest.fixture(scope="module")
def day() -> ApartmentDay:
    return ApartmentDay()


def test_rays_meet_boxes_where_marching_along_them_says() -> None:
    rng = np.random.default_rng(3)
    low = rng.uniform(-4.0, 4.0, (12, 3))
    blocks = np.hstack([low, low + rng.uniform(0.2, 1.5, (12, 3))])
    origin = np.array([-6.0, 0.1, 0.2])
    rays = rng.normal([1.0, 0.0, 0.0], 0.4, (60, 3))
    rays /= np.linalg.norm(rays, axis=1)[:, None]
    found = first_hits(blocks, origin, rays)
    steps = np.arange(0.0, 14.0, 0.005)
    for ray, distance in zip(rays, found, strict=True):
        points = origin + steps[:, None, None] * ray
        inside = ((points >= blocks[:, :3]) & (points <= blocks[:, 3:])).all(axis=2).any(axis=1)
        expected = steps[np.argmax(inside)] if inside.any() else np.inf
        # Marching steps over corners that are grazed.
        assert distance == pytest.approx(expected, abs=0.006) or not inside.any()


def test_rooms_are_closed_but_for_their_doors() -> None:
    home = apartment()
    for x, y in ((-2.0, 0.0), (9.0, 0.0), (0.0, 6.0), (0.0, -5.4)):
        inside = np.array([0.5, 0.3, 1.0])
        ray = np.array([x, y, 1.0]) - inside
        away = np.linalg.norm(ray)
        assert first_hits(home.blocks, inside, (ray / away)[None])[0] < away
    through = first_hits(home.blocks, np.array([1.2, 0.0, 1.0]), np.array([[0.0, 1.0, 0.0]]))[0]
    assert through > 2.0


def test_ways_of_people_keep_off_walls_and_furniture() -> None:
    home = apartment()
    for a, b in WAYS:
        line = np.linspace(SPOTS[a], SPOTS[b], 30)
        assert min(home.outlines.distance(spot) for spot in line) > 0.25, (a, b)
    assert route("desk", "counter")[0] == "desk"
    with pytest.raises(InputError):
        route("desk", "nowhere")


def test_nobody_walks_into_anybody(day: ApartmentDay) -> None:
    times = np.arange(0.0, day.duration, 0.5)
    robot = np.array([day.drive(time)[:2] for time in times])
    ways = [np.array([person.walker.position(time) for time in times]) for person in day.people]
    for k, way in enumerate(ways):
        for other in (robot, *ways[:k]):
            assert np.linalg.norm(way - other, axis=1).min() > CLEAR - 0.15


def test_things_are_where_they_were_put(day: ApartmentDay) -> None:
    assert 300.0 <= day.duration <= 600.0
    begin, end = day.things(0.0), day.things(day.duration)
    assert {name: tuple(spot) for name, spot in begin.items()} == {
        name: spot for name, (_, spot) in THINGS.items()
    }
    for name, spots in PUT.items():
        assert tuple(end[name]) == spots[-1]  # type: ignore[arg-type]
    taken = next(
        when for person in day.people for when, name, took in person.handled if name == MOVED and took
    )
    assert day.things(taken + 0.5)[MOVED] is None


def test_what_is_hidden_is_not_detected_and_what_is_in_plain_view_mostly_is() -> None:
    camera, rng = Camera(false_per_look=0.0), np.random.default_rng(1)
    blocks = np.array([[1.9, -2.0, 0.0, 2.0, 0.0, 2.0]])
    things = {
        "seen": (Item("cup", "red"), np.array([3.0, 0.6, CAMERA_HEIGHT - 0.3])),
        "hidden": (Item("bowl", "green"), np.array([3.0, -0.6, CAMERA_HEIGHT - 0.3])),
    }
    looks = [camera.look(rng, np.zeros(3), blocks, things) for _ in range(300)]
    spots = [np.asarray(item.position) for look in looks for item in look.objects]
    assert len(spots) / 300 == pytest.approx(camera.detected, abs=0.06)
    assert np.mean(spots, axis=0) == pytest.approx([3.0, 0.6, -0.3], abs=0.01)
    errors = np.array(spots) - [3.0, 0.6, -0.3]
    stated = np.asarray(looks[0].objects[0].covariance if looks[0].objects else np.eye(3))
    assert np.sqrt(np.trace(np.cov(errors.T))) == pytest.approx(np.sqrt(np.trace(stated)), rel=0.25)
    # What the camera says it has seen all of ends before the wall, or beside it.
    view = looks[0].sensor
    assert view is not None
    for bearing in np.linspace(-0.5, 0.5, 9) * view["angle"] + view["pose"][3]:
        end = view["range"] * np.array([np.cos(bearing), np.sin(bearing)])
        assert not (end[0] > 1.9 and end[1] * 1.9 / end[0] < -0.02)


def test_a_drive_rests_where_it_is_told_to() -> None:
    drive = Drive([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0)], speed=0.5, turn_rate=1.0, rests=[1.0, 2.0, 0.0])
    assert drive.duration == pytest.approx(1.0 + 2.0 + 2.0 + 0.5 * np.pi + 2.0)
    np.testing.assert_allclose(drive(0.9), [0.0, 0.0, 0.0])
    np.testing.assert_allclose(drive(4.9), [1.0, 0.0, 0.0], atol=1e-9)
    with pytest.raises(InputError, match="rests"):
        Drive([(0.0, 0.0), (1.0, 0.0)], rests=[1.0])


def test_every_recipe_of_a_bag_finds_what_it_imports() -> None:
    recipes = sorted((Path(__file__).parents[2] / "bags").glob("*.py"))
    assert recipes
    for recipe in recipes:
        assert callable(runpy.run_path(str(recipe))["main"]), recipe


def test_the_shipped_bag_is_what_the_recipe_makes(tmp_path: Path) -> None:
    made = tmp_path / "made.mcap"
    record(made, 2.0)
    assert BAG.stat().st_size <= 5_000_000
    compared = 0
    with open_raw(BAG) as shipped, open_raw(made) as again:
        assert {t.name: t.type_name for t in shipped.topics} == {t.name: t.type_name for t in again.topics}
        for ours, theirs in zip(again, shipped, strict=False):
            assert (ours.name, ours.log_time, bytes(ours.data)) == (
                theirs.name,
                theirs.log_time,
                bytes(theirs.data),
            )
            compared += 1
    assert compared > 60
