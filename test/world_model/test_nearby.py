"""What is near a thing or a piece of furniture, how far two things are apart, and what is elsewhere than at a place."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from importlib.resources import files

import numpy as np
import pytest

from estimation.geometry.places import Places
from world_model import WorldObject, WorldState, ask
from world_model.memory.store import Store

HOME = Places.load(str(files("world_model").joinpath("defaults/home.yaml")))
KITCHEN = HOME["kitchen"]
MONDAY = datetime(2026, 11, 16).timestamp()
NAMES = [f"cup-{k}" for k in range(1, 7)]


def thing(name: str, spot: np.ndarray, stamp: float) -> WorldObject:
    kind = {"class": {name.partition("-")[0]: 1.0}}
    return WorldObject(name, spot, np.zeros(3), 1e-4 * np.eye(3), kind, 0.99, False, stamp, MONDAY)


def floor(rng: np.random.Generator) -> dict[str, np.ndarray]:
    """Places of six cups in the kitchen, on no furniture, and of a book in the living room."""
    room = KITCHEN.polygon
    spots: dict[str, np.ndarray] = {"book-1": np.array([8.0, 0.6, 0.6])}
    while len(spots) < 7:
        spot = np.append(rng.uniform(room.min(0), room.max(0)), 0.1)
        others = [place for place in HOME if place.kind == "furniture"]
        if KITCHEN.contains(spot) and not any(place.contains(spot[:2]) for place in others):
            spots[NAMES[len(spots) - 1]] = spot
    return spots


@pytest.fixture(scope="module", params=range(3))
def world(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple]:
    """A store, and where everything is in it; an hour before the last look cup-1 and cup-2 were the other way round."""
    spots = floor(np.random.default_rng([71, request.param]))
    with Store(tmp_path_factory.mktemp("near") / "home.sqlite") as store:
        store.keep_places(HOME)
        for stamp in np.arange(0.0, 7201.0, 300.0):
            there = dict(spots)
            if stamp < 3600.0:
                there["cup-1"], there["cup-2"] = spots["cup-2"], spots["cup-1"]
            objects = [thing(name, spot, MONDAY + stamp) for name, spot in there.items()]
            store.record(WorldState(tuple(objects), 1.0, float(len(objects)), MONDAY + stamp))
        yield store, spots


def test_the_nearest_come_first_and_what_a_wall_parts_is_not_near(world: tuple) -> None:
    store, spots = world
    gaps = {name: np.linalg.norm(spots[name] - spots["cup-3"]) for name in NAMES if name != "cup-3"}
    answer = ask(store, "what is next to cup-3?")
    assert answer.value == sorted(gaps, key=gaps.__getitem__)
    assert f"{answer.value[0]}, {gaps[answer.value[0]]:.1f} m away" in answer.sentence
    assert answer.probability > 0.9


def test_what_was_near_then(world: tuple) -> None:
    store, spots = world
    spots = {**spots, "cup-1": spots["cup-2"], "cup-2": spots["cup-1"]}
    gaps = {name: np.linalg.norm(spots[name] - spots["cup-1"]) for name in NAMES if name != "cup-1"}
    answer = ask(store, "what was near cup-1 at 2026-11-16T00:31")
    assert answer.value == sorted(gaps, key=gaps.__getitem__)


def test_of_furniture_the_outline_counts(world: tuple) -> None:
    store, spots = world
    corners = HOME["kitchen_table"].polygon
    shares = np.linspace(0.0, 1.0, 2001)[:, None, None]
    edges = (corners + shares * (np.roll(corners, -1, axis=0) - corners)).reshape(-1, 2)
    gaps = {name: np.linalg.norm(edges - spots[name][:2], axis=1).min() for name in NAMES}
    answer = ask(store, "what is near the kitchen table?")
    assert answer.value == sorted(gaps, key=gaps.__getitem__)
    told = [option["distance"] for option in answer.alternatives]
    np.testing.assert_allclose(told, sorted(gaps.values()), atol=2e-3)


@pytest.mark.parametrize(
    "question",
    ["how far is cup-1 from the book", "how far apart are cup-1 and book-1", "is cup-1 next to the book?"],
)
def test_how_far(world: tuple, question: str) -> None:
    store, spots = world
    answer = ask(store, question)
    assert answer.kind == "how_far"
    assert answer.value == pytest.approx(np.linalg.norm(spots["cup-1"] - spots["book-1"]))


def test_those_that_are_elsewhere(world: tuple) -> None:
    store, _ = world
    assert ask(store, "which things are not in the kitchen?").value == ask(store, "where is the book").value
    assert sorted(ask(store, "which things are not in the living room?").value) == NAMES
    none = ask(store, "which cups are not in the kitchen?")
    assert (none.kind, none.value) == ("unknown", None)
    assert "not in the kitchen" in none.sentence


@pytest.mark.parametrize(
    ("question", "words"),
    [
        ("what was near cup-1 on monday", "moment"),
        ("what is next to the teapot", "teapot"),
        ("what is near the kitchen", "kitchen"),
        ("how far is cup-1 from the teapot", "teapot"),
        ("what is behind cup-1", "behind"),
    ],
)
def test_what_cannot_be_told(world: tuple, question: str, words: str) -> None:
    answer = ask(world[0], question)
    assert answer.kind in ("unknown", "not_understood")
    assert words in answer.sentence
