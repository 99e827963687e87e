"""Where things usually are at a time of day, learned from what is remembered."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldObject
from world_model.memory.habits import Habits

HOME = Places.load(str(files("world_model").joinpath("defaults/home.yaml")))
REGION = ((0.0, 9.5), (0.0, 8.5), (0.0, 2.5))
TABLE, DESK, COUNTER = np.array([2.0, 1.6, 0.8]), np.array([1.0, 8.0, 0.9]), np.array([0.3, 2.0, 1.0])
HOUR, DAY = 3600.0, 86400.0
KINDS = ("cup", "book")


def config(**more: Any) -> WorldModelConfig:
    motion = {"*": {"model": "static", "moved_per_second": 1e-4, "usual_place": 0.8}}
    given = {"motion": motion, "removed_per_second": 1e-9, **more}
    return WorldModelConfig(classes=KINDS, region=REGION, new_objects_per_second=1e-5, **given)


def thing(name: str, position: np.ndarray, stamp: float) -> WorldObject:
    kind = name.partition("-")[0]
    attributes = {"class": {kind: 1.0}}
    return WorldObject(name, position, np.zeros(3), 1e-4 * np.eye(3), attributes, 1.0, False, stamp, 0.0)


def seen(model: WorldModel, stamp: float, **where: np.ndarray) -> None:
    """Verified: every thing named is at its place now."""
    found = [
        ObjectEvidence(p, 1e-4 * np.eye(3), {"class": {name.partition("_")[0]: 1.0}}, name.replace("_", "-"))
        for name, p in where.items()
    ]
    model.update(WorldEvidence(found, blocked=True), stamp)


def lived(path: Path, days: int = 5) -> WorldModel:
    """A cup that is on the table until noon and on the desk afterwards; a book that stays on the counter."""
    model = WorldModel(config(), HOME, path)
    for k in range(3):
        both = [
            ObjectEvidence(p, 1e-4 * np.eye(3), {"class": {kind: 1.0}})
            for kind, p in (("cup", TABLE), ("book", COUNTER))
        ]
        model.update(WorldEvidence(both, blocked=True), float(k))
    for day in range(days):
        for hour in range(24):
            stamp = day * DAY + hour * HOUR + 10.0
            seen(model, stamp, cup_1=TABLE if hour < 12 else DESK, book_1=COUNTER)
    return model


def test_lost_object_is_where_it_usually_is_at_that_time(tmp_path: Path) -> None:
    model = lived(tmp_path / "world.sqlite")
    model.store.close()  # type: ignore[union-attr]
    for hour, usual, other in ((9, "kitchen_table", "desk"), (18, "desk", "kitchen_table")):
        again = WorldModel(config(), HOME, tmp_path / "world.sqlite")
        stamp = 5 * DAY + hour * HOUR
        state = again.report("cup-1", "not_found", stamp)
        [cup] = [item for item in state.objects if item.id == "cup-1"]
        assert cup.lost
        where = again.words.where(cup)
        assert 0.6 < where[usual] <= 0.8
        assert where[other] < 0.05
        room = {"kitchen_table": "kitchen", "desk": "office"}[usual]
        assert where[room] >= where[usual]
        described = again.words.described(cup)
        assert described.place == usual
        [answer] = again.query(class_name="cup", region=usual, min_probability=0.3)
        assert answer.probability == pytest.approx(where[usual] * cup.existence, rel=0.05)
        again.store.close()  # type: ignore[union-attr]


def test_without_a_history_it_may_be_anywhere_in_the_region() -> None:
    model = WorldModel(config(), HOME)
    for k in range(3):
        one = ObjectEvidence(TABLE, 1e-4 * np.eye(3), {"class": {"cup": 1.0}})
        model.update(WorldEvidence([one], blocked=True), float(k))
    [cup] = model.report("cup-1", "not_found", 4.0).objects
    assert cup.usual == {} or cup.usual["kitchen_table"] < 0.2


def test_histogram_against_plain_counting() -> None:
    """Seconds in the hour and, at half weight, in its neighbours."""
    habits = Habits(HOME)
    rng = np.random.default_rng(0)
    spots = {"kitchen_table": TABLE, "desk": DESK}
    counted = {name: np.zeros(24) for name in spots}
    stamp = 0.0
    for _ in range(300):
        name = str(rng.choice(list(spots)))
        until = stamp + float(rng.uniform(60.0, 4 * HOUR))
        habits.add(thing("cup-1", spots[name], stamp), stamp, until)
        for second in np.arange(stamp, until, 1.0):
            counted[name][int(second % DAY // HOUR)] += 1.0
        stamp = until
    for hour in range(24):
        near = {n: 0.5 * c[hour - 1] + c[hour] + 0.5 * c[(hour + 1) % 24] for n, c in counted.items()}
        shares, believed = habits.shares("cup-1", "cup", 7 * DAY + hour * HOUR + 1.0)
        for name, seconds in near.items():
            assert shares[name] == pytest.approx(seconds / sum(near.values()), abs=0.02)
        assert 0.5 < believed < 1.0
    # Another cup has the habits of its class, with less trust; a book has none.
    assert habits.shares("cup-2", "cup", 0.0)[0] == pytest.approx(habits.shares("cup-1", "cup", 0.0)[0])
    assert habits.shares("cup-2", "cup", 0.0)[1] < habits.shares("cup-1", "cup", 0.0)[1]
    assert habits.shares("book-1", "book", 0.0) == ({}, 0.0)


def test_habits_decide_which_of_two_lost_things_was_found() -> None:
    model = WorldModel(config(), HOME)
    both = [
        ObjectEvidence(p, 1e-4 * np.eye(3), {"class": {"cup": 1.0}})
        for p in (COUNTER, COUNTER + np.array([0.0, 0.5, 0.0]))
    ]
    for k in range(3):
        model.update(WorldEvidence(both, blocked=True), float(k))
    for day in range(10):
        model.habits.add(thing("cup-1", TABLE, 0.0), day * DAY, day * DAY + 12 * HOUR)
        model.habits.add(thing("cup-2", DESK, 0.0), day * DAY, day * DAY + 12 * HOUR)
    stamp = 10 * DAY + 6 * HOUR
    for name in ("cup-1", "cup-2"):
        model.report(name, "not_found", stamp)
    for k in range(5):
        one = ObjectEvidence(DESK, 1e-4 * np.eye(3), {"class": {"cup": 1.0}})
        state = model.update(WorldEvidence([one], blocked=True), stamp + 1.0 + k)
    [found] = [item for item in state.objects if not item.lost]
    assert found.id == "cup-2"
    assert np.allclose(found.position, DESK, atol=0.05)


def test_trust_is_a_setting_by_class() -> None:
    with pytest.raises(InputError, match="usual_place"):
        config(motion={"cup": {"model": "static", "usual_place": 2.0}})
