"""Routines in the world model: where things are by now, learned while running, kept, and taken up again."""

from __future__ import annotations

from dataclasses import replace
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig, WorldObject
from world_model.describing import ago, named
from world_model.memory.household import DAYS, Household
from world_model.memory.routines import FEWEST_DAYS
from world_model.model import routines_path
from world_model.tasks.growth import Growth
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance import Maintenance
from world_model.tasks.relations import Relations
from world_model.tasks.search import ObjectSearch

HOME = Places.load(str(files("world_model").joinpath("defaults/home.yaml")))
REGION = ((0.0, 9.5), (0.0, 8.5), (0.0, 2.5))
TABLE, DESK, COUNTER = np.array([2.0, 1.6, 0.8]), np.array([1.0, 8.0, 0.9]), np.array([0.3, 2.0, 1.0])
HOUR, DAY = 3600.0, 86400.0
BREAKFAST = (7, 9)  # o'clock, between which the cup is on the kitchen table


def config() -> WorldModelConfig:
    motion = {"*": {"model": "static", "moved_per_second": 1e-6, "usual_place": 0.8}}
    return WorldModelConfig(
        classes=("cup", "book"), region=REGION, motion=motion, removed_per_second=1e-9, new_objects_per_second=1e-6
    )  # fmt: skip


def seen(model: WorldModel, stamp: float, **where: np.ndarray) -> None:
    """Verified: every thing named is at its place now."""
    found = [
        ObjectEvidence(p, 1e-4 * np.eye(3), {"class": {name.partition("_")[0]: 1.0}}, name.replace("_", "-"))
        for name, p in where.items()
    ]
    model.update(WorldEvidence(found, blocked=True), stamp)


def lived(path: Path | None, days: int = 8) -> WorldModel:
    """A cup that is on the kitchen table at breakfast and else on the desk; a book that stays on the counter."""
    model = WorldModel(config(), HOME, path)
    for k in range(3):
        both = [
            ObjectEvidence(p, 1e-4 * np.eye(3), {"class": {kind: 1.0}})
            for kind, p in (("cup", DESK), ("book", COUNTER))
        ]
        model.update(WorldEvidence(both, blocked=True), float(k))
    for day in range(days):
        for step in range(72):
            stamp = day * DAY + step * 1200.0 + 10.0
            table = BREAKFAST[0] <= step / 3 < BREAKFAST[1]
            seen(model, stamp, cup_1=TABLE if table else DESK, book_1=COUNTER)
    return model


def cup_of(objects: tuple[WorldObject, ...]) -> WorldObject:
    [cup] = [item for item in objects if item.id == "cup-1"]
    return cup


def test_what_nobody_has_seen_for_a_while_has_gone_its_way(tmp_path: Path) -> None:
    model = lived(tmp_path / "world.sqlite")
    seen(model, 8 * DAY + 7 * HOUR + 60.0, cup_1=TABLE, book_1=COUNTER)
    words = model.words
    soon = cup_of(model.propagate(8 * DAY + 7 * HOUR + 300.0).objects)
    assert soon.usual == {}
    assert words.described(soon).place == "kitchen_table"
    later = model.propagate(8 * DAY + 11 * HOUR)
    cup = cup_of(later.objects)
    assert not cup.lost
    assert words.where(cup)["desk"] > 0.7
    assert words.where(cup)["office"] >= words.where(cup)["desk"]
    assert words.where(cup)["kitchen_table"] < 0.3
    assert words.described(cup).place == "desk"
    assert "probably by now on the desk" in words.sentence(cup)
    # Where it was seen is still where it was seen.
    assert np.allclose(cup.position, TABLE, atol=0.05)
    [book] = [item for item in later.objects if item.id == "book-1"]
    assert book.usual == {}
    [answer] = model.query(stamp=8 * DAY + 11 * HOUR, class_name="cup", region="office", min_probability=0.3)
    assert answer.probability == pytest.approx(words.where(cup)["office"] * cup.existence, rel=0.05)
    assert "from kitchen_table to desk" in model.explain("cup-1")
    with pytest.raises(InputError, match="cup-9"):
        model.explain("cup-9")
    # It will be fetched for breakfast, and the book will not.
    seen(model, 9 * DAY + 6.8 * HOUR, cup_1=DESK, book_1=COUNTER)
    moves = model.household.moves(9 * DAY + 6.8 * HOUR, 1800.0)
    assert moves["cup-1"][0] == "kitchen_table"
    assert "book-1" not in moves


def test_what_was_learned_is_kept_and_taken_up_again(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    model = lived(path)
    seen(model, 8 * DAY + 7 * HOUR + 60.0, cup_1=TABLE)
    before = cup_of(model.propagate(8 * DAY + 11 * HOUR).objects).usual
    model.close()
    again = WorldModel(config(), HOME, path)
    assert again.household.kept.problem == ""
    assert cup_of(again.propagate(8 * DAY + 11 * HOUR).objects).usual == pytest.approx(before)
    lost = cup_of(again.report("cup-1", "not_found", 8 * DAY + 11 * HOUR).objects)
    assert lost.lost
    assert 0.5 < again.words.where(lost)["desk"] <= 0.8
    again.relabel("cup-1", new_object_id="grandmas")
    assert again.explain("grandmas").startswith("grandmas usually goes")
    again.close()


@pytest.mark.parametrize(
    ("spoil", "words"),
    [
        (lambda text: text[: len(text) // 2], "checksum"),
        (lambda text: text.replace("desk", "dusk"), "checksum"),
        (lambda text: "", "checksum"),
        (lambda text: "\x00\xff" * 50, "checksum"),
    ],
)
def test_a_damaged_file_is_set_aside_and_nothing_else_suffers(tmp_path: Path, spoil, words: str) -> None:  # type: ignore[no-untyped-def]
    path = tmp_path / "world.sqlite"
    model = lived(path, days=4)
    model.close()
    beside = routines_path(path)
    beside.write_text(spoil(beside.read_text(encoding="utf-8")), encoding="utf-8")
    again = WorldModel(config(), HOME, path)
    assert words in again.household.kept.problem
    assert beside.with_name(beside.name + ".damaged").exists()
    assert {item.id for item in again.propagate(again.stamp).objects} == {"cup-1", "book-1"}
    again.close()


def test_another_version_is_set_aside(tmp_path: Path) -> None:
    household = Household(HOME)
    kept = tmp_path / "kept"
    household.write(kept)
    assert Household(HOME, kept).kept.problem == ""
    household.routines.to_dict = lambda: {"format": "other"}  # type: ignore[method-assign]
    household.write(kept)
    assert "whereabouts.routines" in Household(HOME, kept).kept.problem


def test_things_that_stay_are_no_new_versions_while_nobody_looks() -> None:
    model = lived(None, days=4)
    seen(model, 4 * DAY + 7 * HOUR + 60.0, cup_1=TABLE, book_1=COUNTER)
    seen(model, 4 * DAY + 11 * HOUR, book_1=COUNTER)
    first = model.update(WorldEvidence([], blocked=True), 4 * DAY + 11 * HOUR + 10.0)
    second = model.update(WorldEvidence([], blocked=True), 4 * DAY + 11 * HOUR + 20.0)
    assert cup_of(first.objects).usual
    assert [id(a) for a in first.objects] == [id(b) for b in second.objects]


def test_few_days_and_things_at_an_edge_make_no_routine() -> None:
    model = lived(None, days=FEWEST_DAYS - 1)
    assert model.household.by_now("cup-1", model.stamp + 10.0 * HOUR) == {}
    household = Household(HOME)
    edge = WorldObject(
        "cup-1", TABLE, np.zeros(3), np.eye(3), {"class": {"cup": 1.0}}, 1.0, False, 0.0,
        place="kitchen_table", place_probability=0.9,
    )  # fmt: skip
    unsure = WorldObject(
        "cup-1", TABLE, np.zeros(3), np.eye(3), {"class": {"cup": 1.0}}, 1.0, False, 0.0,
        place="kitchen", place_probability=0.5,
    )  # fmt: skip
    for k in range(10 * DAYS):
        household.watch([unsure if k % 2 else edge], k * DAY / 10.0)
    assert household.by_now("cup-1", 10 * DAYS * DAY) == {}


def test_time_that_goes_back_teaches_nothing() -> None:
    model = lived(None, days=4)
    stamp = model.household.routines.to_stamp
    model.next_run()
    for k in range(5):
        seen(model, 100.0 + 200.0 * k, cup_1=DESK)
    assert model.household.routines.to_stamp == stamp


def test_the_search_begins_where_the_thing_probably_is_by_now() -> None:
    search = ObjectSearch(Relations(), places=HOME)
    pose = np.array([2.0, 3.0, 0.0])
    search.expect({"desk": 0.6, "kitchen_table": 0.4, "counter": 0.05, "office": 0.9})
    step = search.next_goal({}, "cup", pose)
    assert (step.kind, step.object) == ("place", "kitchen_table")  # less probable, and much nearer
    assert "on the kitchen table by now, p = 0.40" in step.reason
    search.reached()
    step = search.next_goal({}, "cup", pose)
    assert (step.kind, step.object, step.probability) == ("place", "desk", 0.6)
    search.reached()
    assert search.next_goal({}, "cup", pose).kind != "place"
    # Somebody sees it.
    assert search.next_goal({"cup": COUNTER}, "cup", pose).kind == "target"


def test_maintenance_looks_where_something_has_probably_moved_on() -> None:
    model = lived(None, days=4)
    seen(model, 4 * DAY + 7 * HOUR + 60.0, cup_1=TABLE, book_1=COUNTER)
    for hours, first in ((7.05, None), (11.0, "cup-1")):
        state = model.propagate(4 * DAY + hours * HOUR)
        told = replace(state, objects=tuple(model.words.described(item) for item in state.objects))
        ahead = Growth(1e-9).ahead(told, told.stamp)
        camera = Sensor("camera", 0.2, 4.0, 1e-4 * np.eye(3))
        task = Maintenance().next_task(ahead, np.array([1.5, 2.5, 0.0]), [camera], None)
        assert (None if task is None else task.object_id) == first


def test_what_rests_may_have_been_carried_away_the_longer_nobody_looked() -> None:
    model = lived(None, days=0)
    for second in range(5):
        seen(model, float(second), cup_1=TABLE)
    growth, spread = Growth(1e-4), []
    for stamp in (4.0, 104.0, 204.0, 1e6):
        state = model.propagate(stamp)
        growth.observe(state)
        [item] = growth.ahead(state, stamp + 10.0).objects
        [told] = state.objects
        spread.append(item.covariance[0, 0] - told.covariance[0, 0])
        assert item.process_noise[0, 0] >= 1e-4
    # 10 s, 110 s and 210 s after it was seen, and so long that a metre is all that can be said.
    assert spread[0] == pytest.approx(1e-3, rel=0.3)
    assert spread[1] == pytest.approx(1.1e-2, rel=0.1)
    assert spread[2] == pytest.approx(2.1e-2, rel=0.1)
    assert spread[3] == pytest.approx(1.0, rel=0.01)


def test_what_was_renamed_is_still_known_by_its_old_symbol(tmp_path: Path) -> None:
    model = lived(tmp_path / "world.sqlite", days=1)
    model.relabel("cup-1", new_object_id="grandmas")
    [answer] = model.query(object_id="cup-1")
    assert answer.object.id == "grandmas"
    assert answer.description.startswith("the cup (grandmas): on the desk, p = ")
    assert answer.description.endswith("seen now")
    # A verification that was asked for by the old symbol is of the same thing.
    seen(model, DAY + 60.0, cup_1=TABLE)
    assert {item.id for item in model.propagate(DAY + 60.0).objects} == {"grandmas", "book-1"}
    model.close()
    again = WorldModel(config(), HOME, tmp_path / "world.sqlite")
    assert again.query(object_id="cup-1")[0].object.id == "grandmas"
    again.relabel("grandmas", class_name="book")
    assert again.query(object_id="cup-1")[0].description.startswith(
        "the book (grandmas): on the kitchen table"
    )
    again.forget("cup-1")
    assert again.query(object_id="grandmas") == []
    again.close()


def test_words_for_objects() -> None:
    def bowl(**given: Any) -> WorldObject:
        return WorldObject("book-1", TABLE, np.zeros(3), np.eye(3), given, 1.0, False, 0.0)

    assert named(bowl(**{"class": {"bowl": 0.97}, "color": {"green": 0.8}})) == "the green bowl (book-1)"
    assert named(bowl(**{"class": {"bowl": 0.97}}), ["small", "bowl"]) == "the small bowl (book-1)"
    assert named(bowl(**{"class": {"bowl": 0.74}, "color": {"green": 0.4}})) == "the bowl, 0.74 (book-1)"
    assert named(bowl(**{"class": {"bowl": 0.3, "cup": 0.2}})) == named(bowl()) == "book-1"
    assert [ago(s) for s in (0.0, 40.0, 190.0, 7300.0, 3e5, np.inf)] == [
        "now", "40 s ago", "3 min ago", "2 h ago", "3 days ago", "long ago",
    ]  # fmt: skip
