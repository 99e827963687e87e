"""Places against drawn samples, quadrature and matplotlib's polygons."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.path import Path as Outline
from scipy.integrate import dblquad
from scipy.stats import multivariate_normal

from estimation.errors import InputError
from estimation.geometry.places import Place, Places
from estimation.geometry.polygons import check_outline, clipped_area, gaussian_mass, points_inside

L_SHAPE = np.array([[0.0, 0.0], [4.0, 0.0], [4.0, 1.0], [1.0, 1.0], [1.0, 3.0], [0.0, 3.0]])


def home() -> Places:
    return Places.load(str(files("world_model").joinpath("defaults/home.yaml")))


def test_gaussian_mass_agrees_with_quadrature() -> None:
    mean, covariance = np.array([1.3, 0.8]), np.array([[0.5, 0.3], [0.3, 0.6]])
    density = multivariate_normal(mean, covariance).pdf
    lower, _ = dblquad(lambda y, x: density([x, y]), 0.0, 4.0, 0.0, 1.0, epsabs=1e-10)
    upper, _ = dblquad(lambda y, x: density([x, y]), 0.0, 1.0, 1.0, 3.0, epsabs=1e-10)
    assert gaussian_mass(L_SHAPE, [0], mean, covariance)[0] == pytest.approx(lower + upper, abs=1e-8)


@pytest.mark.parametrize("seed", range(6))
def test_gaussian_mass_agrees_with_samples(seed: int) -> None:
    rng = np.random.default_rng(seed)
    angles = np.sort(rng.uniform(0.0, 2.0 * np.pi, 9))
    star = rng.uniform(0.5, 3.0, (9, 1)) * np.column_stack([np.cos(angles), np.sin(angles)])
    root = rng.normal(size=(2, 2))
    mean, covariance = rng.normal(size=2), root @ root.T + 0.01 * np.eye(2)
    samples = rng.multivariate_normal(mean, covariance, 200_000)
    share = Outline(check_outline("star", star)).contains_points(samples).mean()
    assert gaussian_mass(check_outline("star", star), [0], mean, covariance)[0] == pytest.approx(
        share, abs=0.006
    )


def test_exact_positions_and_means_on_an_edge_are_no_special_case() -> None:
    nothing = np.zeros((2, 2))
    assert gaussian_mass(L_SHAPE, [0], np.array([0.5, 0.5]), nothing)[0] == pytest.approx(1.0)
    assert gaussian_mass(L_SHAPE, [0], np.array([2.0, 2.0]), nothing)[0] == pytest.approx(0.0)
    on_edge = gaussian_mass(L_SHAPE, [0], np.array([2.5, 1.0]), 1e-4 * np.eye(2))[0]
    on_corner = gaussian_mass(L_SHAPE, [0], np.array([1.0, 1.0]), 1e-4 * np.eye(2))[0]
    assert (on_edge, on_corner) == (pytest.approx(0.5, abs=1e-6), pytest.approx(0.75, abs=1e-6))


def test_containment_and_clipping_agree_with_others() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.0, 5.0, (5000, 2))
    assert (points_inside(L_SHAPE, points) == Outline(L_SHAPE).contains_points(points)).all()
    box = np.array([[0.5, 3.0], [0.4, 2.0]])
    inside = rng.uniform(box[:, 0], box[:, 1], (200_000, 2))
    share = Outline(L_SHAPE).contains_points(inside).mean()
    assert clipped_area(L_SHAPE, box) / 4.0 == pytest.approx(share, abs=0.005)


def test_turning_an_outline_round_changes_nothing() -> None:
    clockwise = Place.checked("a", {"polygon": L_SHAPE[::-1].tolist()})
    assert clockwise.area == pytest.approx(6.0)
    assert clockwise.contains([0.5, 2.0])


def test_rooms_of_the_example_fill_up_a_home_without_overlap() -> None:
    places = home()
    samples = np.random.default_rng(0).uniform((0.0, 0.0), (9.5, 8.5), (4000, 2))
    counts = sum(place.contains(samples).astype(int) for place in places.rooms)
    assert counts.max() == 1
    assert {place.type for place in places.furniture} >= {"table", "shelf"}
    for piece in places.furniture:
        assert places.room_of(piece.center) is not None


@pytest.mark.parametrize(
    ("given", "named"),
    [
        ({"name": ""}, "no name"),
        ({"name": None}, "no name"),
        ({"height": (2.0, 1.0)}, "height"),
        ({"height": (np.nan, 1.0)}, "height"),
        ({"type": None}, "type"),
    ],
)
def test_a_place_made_by_hand_is_checked_like_one_of_a_file(given: dict[str, Any], named: str) -> None:
    with pytest.raises(InputError, match=named):
        Place(**{"name": "a", "polygon": L_SHAPE, **given})


def test_words_prefer_likely_furniture_to_the_room_around_it() -> None:
    places = home()
    near = places.probabilities([2.1, 1.6, 0.8], np.diag([0.01, 0.01, 0.001]))
    assert places.word(near) == ("kitchen_table", pytest.approx(1.0, abs=0.02))
    vague = places.probabilities([2.1, 1.6, 0.8], np.diag([1.0, 1.0, 0.01]))
    name, probability = places.word(vague)
    assert name == "kitchen"
    assert 0.5 < probability < 1.0
    under = places.probabilities([2.1, 1.6, 0.1], np.diag([0.01, 0.01, 0.001]))
    assert places.word(under)[0] == "kitchen"
    assert places.word(places.probabilities([50.0, 50.0, 0.0], 0.01 * np.eye(3))) == ("", 0.0)


def test_something_anywhere_in_a_box_is_somewhere() -> None:
    shares = home().shares(((0.0, 9.5), (0.0, 8.5), (0.0, 2.5)))
    rooms = sum(shares[room.name] for room in home().rooms)
    assert rooms == pytest.approx(sum(room.area for room in home().rooms) / (9.5 * 8.5))
    assert shares["kitchen_table"] == pytest.approx(1.4 * 0.8 * 0.7 / (9.5 * 8.5 * 2.5))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("places: {a: {polygon: [[0, 0], [1, 0]]}}", "at least three corners"),
        ("places: {a: {polygon: [[0, 0], [1, 1], [1, 0], [0, 1]]}}", "cross itself"),
        ("places: {a: {polygon: [[0, 0], [1, 1], [2, 2]]}}", "an area"),
        ("places: {a: {polygon: [[0, 0], [1, .nan], [1, 0]]}}", "finite"),
        ("places: {a: {polygon: [[0, 0], [1, 0], [1, 1]], hight: [0, 1]}}", "unknown fields: hight"),
        ("places: {a: {polygon: [[0, 0], [1, 0], [1, 1]], height: [2, 1]}}", "ascending"),
        ("places: {a: {polygon: [[0, 0], [1, 0], [1, 1]], kind: cave}}", "room, furniture"),
        ("places: {a: {polygon: hello}}", "numbers"),
        ("places: {a: {kind: room}}", "no polygon"),
        ("places: {a: {polygon: [[0, 0], [1, 0], [1, 1]]}, a: {polygon: []}}", "given twice"),
        ("rooms: {}", "mapping of names"),
        ("places: [", "cannot be read"),
    ],
)
def test_what_is_wrong_with_a_file_is_said(tmp_path: Path, text: str, expected: str) -> None:
    path = tmp_path / "home.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=expected) as caught:
        Places.load(path)
    assert str(path) in str(caught.value)


def test_a_missing_file_and_unknown_places_are_named(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="nowhere"):
        Places.load(tmp_path / "nowhere.yaml")
    with pytest.raises(InputError, match="attic"):
        home()["attic"]


def test_corners_may_go_round_either_way_and_be_a_list() -> None:
    square = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]
    one, other = Place("a", square), Place("a", square[::-1])  # type: ignore[arg-type]
    assert one.area == other.area == pytest.approx(1.0)
    chances = [place.probability([0.4, 0.7], 0.1 * np.eye(2)) for place in (one, other)]
    assert chances[0] == pytest.approx(chances[1])
    assert 0.0 < chances[0] < 1.0


@pytest.mark.parametrize(
    ("call", "named"),
    [
        (lambda p: p.probability([0.5, 0.5], -np.eye(2)), "covariance"),
        (lambda p: p.probability([0.5, 0.5], [[1.0, 0.5], [0.0, 1.0]]), "covariance"),
        (lambda p: p.contains(0.5), "points"),
        (lambda p: p.share([[0.0, 1.0]]), "box"),
        (lambda p: Places({"a": p}).room_of([[0.5, 0.5]]), "position"),
        (lambda p: Place("b", p.polygon, "shed"), "kind"),
        (lambda p: Place("b", p.polygon[:2]), "corners"),
    ],
)
def test_what_is_no_position_or_place_is_named(call: Any, named: str) -> None:
    with pytest.raises(InputError, match=named):
        call(Place("a", np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])))
