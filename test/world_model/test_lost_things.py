"""Where things have gone that are not where they were, by the routines of the home."""

from __future__ import annotations

from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldState
from world_model.memory.household import Household
from world_model.model import routines_path

HOME = Places.load(str(files("world_model").joinpath("defaults/home.yaml")))
REGION = ((0.0, 9.5), (0.0, 8.5), (0.0, 2.5))
TABLE, DESK, COUNTER = np.array([2.0, 1.6, 0.8]), np.array([1.0, 8.0, 0.9]), np.array([0.3, 2.0, 1.0])
BESIDE = np.array([0.0, 0.5, 0.0])
HOUR, DAY = 3600.0, 86400.0
KINDS = ("cup", "book")


def config(**more: Any) -> WorldModelConfig:
    motion = {"*": {"model": "static", "moved_per_second": 1e-4, "usual_place": 0.8}}
    given = {"motion": motion, "removed_per_second": 1e-9, **more}
    return WorldModelConfig(classes=KINDS, region=REGION, new_objects_per_second=1e-5, **given)


def seen(model: WorldModel, stamp: float, **where: np.ndarray) -> None:
    """Verified: every thing named is at its place now."""
    found = [
        ObjectEvidence(p, 1e-4 * np.eye(3), {"class": {name.partition("_")[0]: 1.0}}, name.replace("_", "-"))
        for name, p in where.items()
    ]
    model.update(WorldEvidence(found, blocked=True), stamp)


def met(model: WorldModel, **where: np.ndarray) -> None:
    """Three looks at things that nobody knows yet."""
    things = [
        ObjectEvidence(p, 1e-4 * np.eye(3), {"class": {name.partition("_")[0]: 1.0}})
        for name, p in where.items()
    ]
    for k in range(3):
        model.update(WorldEvidence(things, blocked=True), float(k))


def lived(path: Path, days: int = 5) -> WorldModel:
    """A cup that is on the table until noon and on the desk afterwards; a book that stays on the counter. On the last
    day they are seen until noon."""
    model = WorldModel(config(), HOME, path)
    met(model, cup_1=TABLE, book_1=COUNTER)
    for hour in range(24 * days + 12):
        seen(model, hour * HOUR + 10.0, cup_1=TABLE if hour % 24 < 12 else DESK, book_1=COUNTER)
    return model


def lost(model: WorldModel, name: str, stamp: float) -> WorldState:
    state = model.report(name, "not_found", stamp)
    assert next(item for item in state.objects if item.id == name).lost
    return state


def test_lost_object_is_where_it_goes_from_there(tmp_path: Path) -> None:
    model = lived(tmp_path / "world.sqlite")
    for stamp in (5 * DAY + 11.8 * HOUR, 5 * DAY + 18.0 * HOUR):
        state = lost(model, "cup-1", stamp)
        [cup] = [item for item in state.objects if item.id == "cup-1"]
        where = model.words.where(cup)
        assert 0.6 < where["desk"] <= 0.8
        assert where["kitchen_table"] < 0.1
        assert where["office"] >= where["desk"]
        assert model.words.described(cup).place == "desk"
        [answer] = model.query(class_name="cup", region="desk", min_probability=0.3)
        assert answer.probability == pytest.approx(where["desk"] * cup.existence, rel=0.05)
        seen(model, stamp + 1.0, cup_1=TABLE)


def test_a_store_without_kept_routines_teaches_them(tmp_path: Path) -> None:
    """As versions wrote it that kept none."""
    model = lived(tmp_path / "world.sqlite")
    model.close()
    kept, history = model.household, tmp_path / "world.sqlite"
    routines_path(history).unlink()
    again = WorldModel(config(), HOME, history)
    assert again.household.kept.problem == ""
    now = 5 * DAY + 15.0 * HOUR
    for learned in (kept, again.household):
        assert learned.by_now("cup-1", now)["desk"] > 0.8
        assert learned.gone_to("cup-1", "cup", now)["desk"] > 0.8
        assert learned.by_now("book-1", now) == {}
    again.close()


def test_without_a_history_it_may_be_anywhere_in_the_region() -> None:
    model = WorldModel(config(), HOME)
    met(model, cup_1=TABLE)
    [cup] = lost(model, "cup-1", 4.0).objects
    assert cup.usual == {}
    assert model.words.where(cup)["kitchen_table"] < 0.2


def test_what_is_little_known_goes_where_its_kind_goes(tmp_path: Path) -> None:
    household = lived(tmp_path / "world.sqlite").household
    now = 5 * DAY + 15.0 * HOUR
    fresh = household.gone_to("cup-2", "cup", now)
    assert max((name for name in fresh if HOME[name].kind == "furniture"), key=fresh.__getitem__) == "desk"
    assert fresh["desk"] < household.gone_to("cup-1", "cup", now)["desk"]
    assert household.gone_to("book-2", "book", now) == {}
    # By as much likelier on the desk than anywhere, and less likely elsewhere; never by more than its place is smaller.
    area, trust = 80.0, 0.5
    assert 1.0 < household.odds("cup-2", "cup", DESK, now, trust, area) <= area / HOME["desk"].area
    assert household.odds("cup-2", "cup", COUNTER, now, trust, area) < household.odds(
        "cup-2", "cup", DESK, now, trust, area
    )
    assert household.odds("cup-2", "cup", np.array([4.0, 4.0, 5.0]), now, trust, area) <= 1.0
    assert household.odds("book-2", "book", DESK, now, trust, area) == 1.0


@pytest.mark.parametrize("to_desk", [0, 1])
def test_routines_decide_which_of_two_lost_things_was_found(to_desk: int) -> None:
    model = WorldModel(config(), HOME)
    met(model, cup_1=COUNTER, cup_2=COUNTER + BESIDE)
    names = sorted(item.id for item in model.propagate(3.0).objects)
    away = {names[to_desk]: "desk", names[1 - to_desk]: "kitchen_table"}
    for hour in range(10 * 24 + 6):
        noon = hour % 24 >= 12
        for name, place in away.items():
            model.household.routines.look(place, [name] if noon else [], hour * HOUR + 600.0)
        model.household.routines.look("counter", [] if noon else sorted(away), hour * HOUR + 600.0)
    stamp = 10 * DAY + 6 * HOUR
    for name in away:
        lost(model, name, stamp)
    for k in range(5):
        one = ObjectEvidence(DESK, 1e-4 * np.eye(3), {"class": {"cup": 1.0}})
        state = model.update(WorldEvidence([one], blocked=True), stamp + 1.0 + k)
    [found] = [item for item in state.objects if not item.lost]
    assert found.id == names[to_desk]
    assert np.allclose(found.position, DESK, atol=0.05)


def test_trust_is_a_setting_by_class() -> None:
    with pytest.raises(InputError, match="usual_place"):
        config(motion={"cup": {"model": "static", "usual_place": 2.0}})


def test_an_empty_store_teaches_nothing(tmp_path: Path) -> None:
    model = WorldModel(config(), HOME, tmp_path / "world.sqlite")
    assert model.household.routines.objects == ()
    assert Household(HOME).gone_to("cup-1", "cup", 0.0) == {}
    model.close()
