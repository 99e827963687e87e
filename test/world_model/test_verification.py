"""Looking into regions: against a simulated room with and without the thing, and with something in front."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.poses import pose_to_matrix
from whereabouts.simulation import Lidar, box, joined
from whereabouts.simulation.shapes import Shapes
from world_model.tasks.appearance import Appearance
from world_model.tasks.verification import RegionBox, Verification, look_with_cloud, look_with_scan

LIDAR = Lidar(720, 2.0 * np.pi * 719 / 720)
SENSOR = pose_to_matrix(np.array([1.0, 0.5, 0.3, 0.0, 0.0, 0.7]))
POSE = np.array([1.0, 0.5, 0.7])
REGION = RegionBox(np.array([3.0, 1.5, 0.3]), np.array([0.6, 0.6, 0.6]))


def scanned(*things: Shapes) -> tuple[np.ndarray, float, float]:
    room = box(10.0, 8.0, (0.0, 0.0, 0.0))
    scan = LIDAR.scan(joined([room, *things]), POSE, np.random.default_rng(0)).scan
    return np.where(scan.valid, scan.ranges, np.inf), scan.angle_min, scan.angle_increment


def look(*things: Shapes) -> tuple[int, float]:
    ranges, first, step = scanned(*things)
    frame = look_with_scan(REGION, ranges, first, step, 12.0, SENSOR)
    return len(frame.points), frame.visible


def test_a_thing_in_the_region_an_empty_region_and_one_that_is_hidden_look_different() -> None:
    thing, screen = box(0.3, 0.3, (3.0, 1.5, 0.2)), box(0.1, 1.6, (2.0, 1.0, 0.46))
    inside, _ = look(thing)
    assert inside > 5
    empty, visible = look()
    assert (empty, visible) == (0, 1.0)
    hidden, seen = look(thing, screen)
    assert hidden == 0
    assert seen < 0.1


def test_scanners_that_sweep_the_other_way_or_hang_upside_down_see_the_same() -> None:
    ranges, first, step = scanned(box(0.3, 0.3, (3.0, 1.5, 0.2)))
    plain = look_with_scan(REGION, ranges, first, step, 12.0, SENSOR)
    back = look_with_scan(REGION, ranges[::-1], first + step * (len(ranges) - 1), -step, 12.0, SENSOR)
    hanging = SENSOR @ np.diag([1.0, -1.0, -1.0, 1.0])
    under = look_with_scan(REGION, ranges[::-1], -(first + step * (len(ranges) - 1)), step, 12.0, hanging)
    for other in (back, under):
        np.testing.assert_allclose(np.sort(other.points, axis=0), np.sort(plain.points, axis=0), atol=1e-9)
        assert other.visible == pytest.approx(plain.visible, abs=0.02)


def test_a_scanner_at_another_height_sees_nothing_of_it() -> None:
    ranges, first, step = scanned()
    low = RegionBox(np.array([3.0, 1.5, 1.0]), np.array([0.6, 0.6, 0.4]))
    assert look_with_scan(low, ranges, first, step, 12.0, SENSOR).visible == 0.0


def test_a_cloud_tells_the_same_three_cases_apart() -> None:
    rng = np.random.default_rng(1)
    wall = np.column_stack([np.full(4000, 5.0), rng.uniform(-3, 4, 4000), rng.uniform(-0.5, 1.5, 4000)])
    thing = rng.uniform([2.9, 1.4, 0.1], [3.0, 1.6, 0.5], (80, 3))
    screen = np.column_stack([np.full(6000, 2.0), rng.uniform(0, 2, 6000), rng.uniform(-0.3, 0.9, 6000)])
    empty = look_with_cloud(REGION, wall, SENSOR, 12.0)
    assert len(empty.points) == 0
    assert empty.visible > 0.9
    assert len(look_with_cloud(REGION, np.vstack([wall, thing]), SENSOR, 12.0).points) == 80
    assert look_with_cloud(REGION, screen, SENSOR, 12.0).visible < 0.2


def test_a_camera_says_nothing_of_what_it_does_not_look_at() -> None:
    rng = np.random.default_rng(2)
    wall = np.column_stack([np.full(4000, 5.0), rng.uniform(-2, 3, 4000), rng.uniform(-1.0, 2.0, 4000)])
    pixels = np.vstack([wall, np.full((5, 3), np.nan), np.tile(SENSOR[:3, 3], (5, 1))])

    def visible(x: float, y: float, z: float, cloud: np.ndarray = pixels) -> float:
        return look_with_cloud(RegionBox([x, y, z], [0.4, 0.4, 0.4]), cloud, SENSOR, 12.0).visible

    assert visible(2.0, 0.5, 0.3) == 1.0
    for aside in ((-1.0, 0.5, 0.3), (1.0, 2.0, 0.3), (2.0, 2.0, 0.3), (2.0, 0.5, 3.0)):
        assert visible(*aside) == 0.0
    # A window in the wall: nothing comes back, and nothing stands in the way.
    assert visible(2.0, 0.5, 0.3, pixels[~(np.abs(pixels[:, 1] - 0.5) < 1.0)]) == 1.0
    assert visible(2.0, 0.5, 0.3, pixels[4000:]) == 0.0


def test_a_scanner_that_turns_sees_all_around_between_its_rings() -> None:
    turn = np.arange(0.0, 2.0 * np.pi, 0.01)
    rings = [
        np.column_stack([5.0 * np.cos(turn), 5.0 * np.sin(turn), np.full_like(turn, z)]) for z in (-1.0, 2.0)
    ]
    cloud = np.vstack(rings) + SENSOR[:3, 3]

    def visible(x: float, y: float, z: float, cloud: np.ndarray = cloud) -> float:
        return look_with_cloud(
            RegionBox(SENSOR[:3, 3] + [x, y, z], [0.4, 0.4, 0.4]), cloud, SENSOR, 12.0
        ).visible

    assert visible(-2.0, 0.5, 0.0) == 1.0
    assert visible(-2.0, 0.5, 3.0) == 0.0
    behind = np.abs(np.arctan2(*(cloud - SENSOR[:3, 3]).T[1::-1])) > 2.0
    assert visible(-2.0, 0.5, 0.0, cloud[~behind]) == 0.0


def test_several_frames_have_to_agree_and_hidden_ones_say_nothing() -> None:
    ranges, first, step = scanned(box(0.3, 0.3, (3.0, 1.5, 0.2)))
    full = look_with_scan(REGION, ranges, first, step, 12.0, SENSOR)
    ranges, first, step = scanned()
    empty = look_with_scan(REGION, ranges, first, step, 12.0, SENSOR)
    ranges, first, step = scanned(box(0.1, 1.6, (2.0, 1.0, 0.46)))
    hidden = look_with_scan(REGION, ranges, first, step, 12.0, SENSOR)
    verification = Verification(REGION)
    assert [verification.take(frame) for frame in (full, empty, full, hidden, full)] == [None] * 4 + ["found"]
    position, covariance = verification.measurement(0.05)
    assert np.hypot(*(position - [3.0, 1.5, 0.3])[:2]) < 0.2
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    vain = Verification(REGION)
    assert [vain.take(empty) for _ in range(3)] == [None, None, "not_found"]
    blind = Verification(REGION)
    assert [blind.take(hidden) for _ in range(5)] == [None] * 5
    assert blind.outcome() == "occluded"


def test_what_the_map_has_anyway_is_no_object() -> None:
    region = RegionBox(np.array([4.9, 1.0, 0.3]), np.array([0.6, 0.6, 0.6]))
    ranges, first, step = scanned()
    frame = look_with_scan(region, ranges, first, step, 12.0, SENSOR)
    assert len(frame.points) > 5
    values = np.zeros((80, 100), dtype=int)
    values[:, -1] = 100
    grid = OccupancyGrid.from_values(values, 0.1, (-4.95, -4.0))
    assert Verification(region, needed=1).take(frame) == "found"
    assert Verification(region, needed=1, grid=grid).take(frame) != "found"


def test_regions_without_size_are_refused() -> None:
    with pytest.raises(InputError, match="size"):
        RegionBox(np.zeros(3), np.array([1.0, 0.0, 1.0]))
    with pytest.raises(InputError, match="centre"):
        RegionBox(np.array([np.nan, 0.0, 0.0]), np.ones(3))


def test_a_return_in_a_wide_region_may_be_anything() -> None:
    ranges, first, step = scanned(box(0.3, 0.3, (3.0, 1.5, 0.2)))
    outcomes = []
    for width in (0.6, 2.0):
        region = RegionBox(REGION.centre, np.array([width, width, 0.6]))
        verification = Verification(region, needed=2)
        for _ in range(2):
            outcome = verification.take(look_with_scan(region, ranges, first, step, 12.0, SENSOR))
        outcomes.append(outcome)
    assert outcomes == ["found", "occluded"]


def ball(
    rng: np.random.Generator, spot: tuple[float, float, float], width: float, count: int = 200
) -> np.ndarray:
    """Returns of the near side of a thing."""
    return np.array(spot) + width / np.sqrt(3.0) * rng.uniform(
        [-0.5, -0.5, -0.5], [0.0, 0.5, 0.5], (count, 3)
    )


RED, GREEN = np.array([0.7, 0.1, 0.1]), np.array([0.1, 0.6, 0.15])


@pytest.mark.parametrize(
    ("expected", "width", "color", "outcome"),
    [
        (Appearance((0.3, 1e-4)), 0.3, RED, "found"),
        (Appearance((0.3, 1e-4)), 0.15, RED, "found"),  # partly seen, it may be
        (Appearance((0.15, 1e-4)), 0.5, RED, "not_found"),  # nothing makes a cup look like a box
        (Appearance((0.15, 1.0)), 0.5, RED, "found"),  # of unknown size
        (Appearance(colors={"red": 0.9, "blue": 0.1}), 0.3, RED, "found"),
        (Appearance(colors={"red": 0.95, "blue": 0.05}), 0.3, GREEN, "not_found"),
        (Appearance(colors={"red": 0.5, "green": 0.5}), 0.3, GREEN, "found"),
        (Appearance(), 0.5, GREEN, "found"),
    ],
)
def test_what_looks_otherwise_is_something_else(
    expected: Appearance, width: float, color: np.ndarray, outcome: str
) -> None:
    rng = np.random.default_rng(0)
    verification = Verification(REGION, appearance=expected)
    for _ in range(3):
        cloud = ball(rng, (3.0, 1.5, 0.3), width)
        colors = np.clip(color + rng.normal(0.0, 0.03, cloud.shape), 0.0, 1.0)
        said = verification.take(look_with_cloud(REGION, cloud, SENSOR, 12.0, colors))
    assert said == outcome


def test_an_object_beside_something_larger_is_found() -> None:
    """A cup near the edge of a region that a box fills for the rest."""
    rng = np.random.default_rng(1)
    verification = Verification(REGION, appearance=Appearance((0.12, 1e-4), {"red": 1.0}))
    for _ in range(3):
        cup, other = ball(rng, (3.2, 1.25, 0.2), 0.12, 40), ball(rng, (2.95, 1.6, 0.3), 0.6)
        other = other[np.linalg.norm(other - [3.2, 1.25, 0.2], axis=1) > 0.25]
        cloud, colors = (
            np.vstack([cup, other]),
            np.vstack([np.tile(RED, (40, 1)), np.tile(GREEN, (len(other), 1))]),
        )
        said = verification.take(look_with_cloud(REGION, cloud, SENSOR, 12.0, colors))
    assert said == "found"
