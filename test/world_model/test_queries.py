"""Questions to a world model with rooms and a memory."""

from __future__ import annotations

from collections.abc import Iterator
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.places import Place, Places
from world_model import ObjectEvidence, WorldEvidence, WorldModel, WorldModelConfig
from world_model.memory.store import Store
from world_model.queries import QueryAnswer
from world_model.questions import ask, recall

CONFIG = WorldModelConfig(
    classes=["cup", "bowl", "shoe", "table"],
    colors=["red", "green", "blue"],
    region=((0.0, 9.5), (0.0, 8.5), (0.0, 2.5)),
    clutter_per_frame=0.01,
)
ON_TABLE, ON_COUNTER, ON_DESK = (2.0, 1.6, 0.8), (0.3, 2.0, 1.0), (1.0, 8.0, 0.9)
KITCHEN = {"pose": (2.0, 3.0, 1.2, -1.57), "range": 6.0, "angle": 6.28}


def home() -> Places:
    return Places.load(str(files("world_model").joinpath("defaults/home.yaml")))


def seen(position: tuple[float, ...], kind: str, color: str, sure: float = 0.9) -> ObjectEvidence:
    def over(names: object, name: str) -> dict[str, float]:
        others = [other for other in names if other != name]  # type: ignore[attr-defined]
        return {name: sure, **{other: (1.0 - sure) / len(others) for other in others}}

    attributes = {"class": over(CONFIG.classes, kind), "color": over(CONFIG.colors, color)}
    return ObjectEvidence(position, 1e-4 * np.eye(3), attributes)


def look(model: WorldModel, start: float, looks: int, *objects: ObjectEvidence) -> float:
    stamp = start
    for _ in range(looks):
        model.update(WorldEvidence(objects, KITCHEN), stamp)
        stamp += 0.05
    return stamp


@pytest.fixture
def model(tmp_path: Path) -> Iterator[WorldModel]:
    """A red cup on the table until nine (t = 100), on the desk afterwards; a green bowl on the counter."""
    with Store(tmp_path / "world.sqlite") as store:
        made = WorldModel(CONFIG, home(), store)
        bowl = seen(ON_COUNTER, "bowl", "green")
        look(made, 90.0, 40, seen(ON_TABLE, "cup", "red"), bowl)
        look(made, 100.0, 80, bowl)
        look(made, 200.0, 40, seen(ON_DESK, "cup", "red"), bowl)
        yield made


def one(answers: list[QueryAnswer]) -> QueryAnswer:
    assert len(answers) == 1, answers
    return answers[0]


def test_where_is_and_where_was_the_cup(model: WorldModel) -> None:
    cup = model.query(class_name="cup", region="desk", min_probability=0.5)
    name = one(cup).object.id
    now, then = one(model.query(object_id=name)), one(model.query(class_name="cup", stamp=91.5))
    assert now.places["desk"] > 0.9
    likely = now.object.existence * now.places["desk"]
    assert now.description == f"the red cup ({name}): on the desk, p = {likely:.2f}, seen now"
    assert then.places["kitchen_table"] > 0.9
    assert then.object.place == "kitchen_table"
    assert "red" in then.object.predicates
    assert then.stamp == 91.5
    assert model.query(class_name="cup", stamp=50.0) == []


def test_what_was_on_the_table_when_it_was_last_seen(model: WorldModel) -> None:
    assert model.query(region="kitchen_table") == []
    answer = one(model.query(region="kitchen_table", stamp="last_seen"))
    assert answer.object.most_probable("class") == "cup"
    assert answer.stamp == pytest.approx(91.95)
    with pytest.raises(InputError, match="nothing was ever seen at 'bed'"):
        model.query(region="bed", stamp="last_seen")
    with pytest.raises(InputError, match="needs a region"):
        model.query(stamp="last_seen")


def test_restrictions_multiply(model: WorldModel) -> None:
    bowl = one(model.query(class_name="bowl", min_probability=0.5))
    item = bowl.object
    expected = item.existence * item.attributes["class"]["bowl"]
    assert bowl.probability == pytest.approx(expected)
    green = one(model.query(class_name="bowl", predicate="green", min_probability=0.5))
    assert green.probability == pytest.approx(expected * item.attributes["color"]["green"])
    both = one(model.query(predicate=["green", "dish"], region="kitchen", min_probability=0.5))
    dish = sum(item.attributes["class"].get(name, 0.0) for name in ("cup", "bowl"))
    assert both.probability == pytest.approx(
        item.existence * item.attributes["color"]["green"] * dish * bowl.places["kitchen"], rel=1e-6
    )
    assert model.query(class_name="bowl", predicate="red", min_probability=0.5) == []


def test_regions_by_corners_places_and_objects(model: WorldModel) -> None:
    corners = [(0.0, 1.5), (0.7, 1.5), (0.7, 2.5), (0.0, 2.5)]
    by_corners = one(model.query(region=corners, min_probability=0.5))
    by_place = one(model.query(region=Place.checked("x", {"polygon": corners}), min_probability=0.5))
    assert by_corners.object is by_place.object
    assert by_corners.object.most_probable("class") == "bowl"
    look(model, 210.0, 40, seen(ON_COUNTER, "bowl", "green"), seen((0.5, 2.2, 1.0), "shoe", "blue"))
    near = one(model.query(region=by_corners.object.id, min_probability=0.5))
    assert near.object.most_probable("class") == "shoe"


def test_answers_of_the_present_sum_over_all_hypotheses() -> None:
    model = WorldModel(CONFIG)
    for k in range(20):
        model.update(WorldEvidence([seen((1.0, 1.0, 1.0), "cup", "red")]), 0.05 * k)
    # Another cup, or the same one carried there: both are kept in mind for a while.
    model.update(WorldEvidence([seen((1.4, 1.0, 1.0), "cup", "red")]), 3.0)
    model.update(WorldEvidence([seen((1.4, 1.0, 1.0), "cup", "red")]), 3.05)
    worlds = model.hypotheses()
    assert len(worlds) > 1
    here = [(1.2, 0.8), (1.6, 0.8), (1.6, 1.2), (1.2, 1.2)]
    place = Place.checked("here", {"polygon": here})
    totals: dict[str, float] = {}
    for world in worlds:
        for item in world.objects:
            mass = item.existence * place.probability(item.position, item.covariance)
            totals[item.id] = totals.get(item.id, 0.0) + world.probability * mass
    answers = {
        answer.object.id: answer.probability for answer in model.query(region=here, min_probability=0.0)
    }
    assert answers == pytest.approx({name: p for name, p in totals.items() if p >= 1e-6})


def test_the_best_come_first_and_as_many_as_wanted(model: WorldModel) -> None:
    answers = model.query(min_probability=0.0)
    assert [a.probability for a in answers] == sorted((a.probability for a in answers), reverse=True)
    assert len(model.query(min_probability=0.0, limit=1)) == 1


def test_an_object_that_is_not_found_is_anywhere_in_its_room(model: WorldModel) -> None:
    name = one(model.query(class_name="bowl", min_probability=0.5)).object.id
    model.report(name, "not_found", 203.0)
    answer = one(model.query(object_id=name))
    places = home()
    assert answer.object.lost
    assert answer.object.region == ((0.0, 4.0), (0.0, 3.5), (0.0, 2.5))
    assert answer.places["kitchen"] == pytest.approx(1.0)
    assert answer.places["office"] == 0.0
    table = places["kitchen_table"]
    assert answer.places["kitchen_table"] == pytest.approx(table.area * 0.7 / (places["kitchen"].area * 2.5))
    assert answer.description.startswith(f"the green bowl ({name}): moved away, in the kitchen, p = ")
    assert model.store is not None
    last = model.store.history(name)[-1]  # type: ignore[attr-defined]
    assert (last.event, last.object.region) == ("lost", answer.object.region)
    # It comes to light on the table.
    look(model, 204.0, 40, seen(ON_TABLE, "bowl", "green"), seen(ON_DESK, "cup", "red"))
    found = one(model.query(class_name="bowl", min_probability=0.5))
    assert not found.object.lost
    assert found.object.place == "kitchen_table"


def test_a_restarted_model_remembers_symbols_and_answers_about_before(tmp_path: Path) -> None:
    path = tmp_path / "world.sqlite"
    first = WorldModel(CONFIG, home(), path)
    look(first, 10.0, 40, seen(ON_TABLE, "cup", "red"))
    cup = one(first.query(class_name="cup", min_probability=0.5)).object
    first.forget(cup.id)
    look(first, 20.0, 40, seen(ON_DESK, "cup", "blue"))
    second_cup = one(first.query(class_name="cup", min_probability=0.5)).object
    assert first.store is not None
    first.store.close()
    second = WorldModel(CONFIG, home(), path)
    assert second.store is not None
    assert [item.id for item in second.propagate(22.0).objects] == [second_cup.id]
    look(second, 30.0, 40, seen(ON_TABLE, "cup", "green"), seen(ON_DESK, "cup", "blue"))
    ids = {answer.object.id for answer in second.query(class_name="cup", min_probability=0.5)}
    assert len(ids) == 2
    assert second_cup.id in ids
    assert cup.id not in ids
    assert one(second.query(object_id=cup.id, stamp=11.5)).object.most_probable("color") == "red"
    # Time goes back: a new run, in which the old one can still be asked about.
    look(second, 5.0, 20, seen(ON_TABLE, "cup", "red"))
    assert second.epoch == 1
    assert second.store.history(cup.id, epoch=0)[0].event == "appeared"
    second.store.close()


def test_renamed_objects_are_found_by_either_time(model: WorldModel) -> None:
    bowl = one(model.query(class_name="bowl", min_probability=0.5)).object
    model.relabel(bowl.id, new_object_id="the-bowl-of-anna")
    assert one(model.query(object_id="the-bowl-of-anna", stamp=91.0)).object.position == pytest.approx(
        ON_COUNTER, abs=0.02
    )


@pytest.mark.parametrize(
    ("request_", "message"),
    [
        ({"predicate": "shiny"}, "unknown predicate 'shiny'"),
        ({"region": "attic"}, "unknown place 'attic'"),
        ({"region": [(0, 0), (1, 1)]}, "three corners"),
        ({"min_probability": 2.0}, "min_probability"),
        ({"limit": 0}, "limit"),
        ({"class_name": 3}, "class_name"),
        ({"predicate": [1]}, "predicate"),
        ({"stamp": float("nan")}, "stamp"),
        ({"stamp": "yesterday"}, "stamp"),
    ],
)
def test_questions_that_make_no_sense_are_refused_by_name(
    model: WorldModel, request_: dict[str, object], message: str
) -> None:
    with pytest.raises(InputError, match=message):
        model.query(**request_)


def test_without_a_store_the_past_is_not_known() -> None:
    model = WorldModel(CONFIG)
    look(model, 10.0, 3, seen(ON_TABLE, "cup", "red"))
    with pytest.raises(InputError, match="only a world model with a store"):
        model.query(stamp=9.0)
    assert model.query(region=[(0, 0), (1, 0), (1, 1)]) == []


@pytest.mark.parametrize(
    ("looks", "question", "start", "end", "probability"),
    [
        (30, "where is the bowl", "cup-1 (green bowl) is on the counter", "", 1.0),
        (30, "where is the cup", 'I know of no "cup" now', "", 0.9),
        (7, "where is the cup", "cup-1 (green bowl) is on the counter", "; it is a cup with p = 0.43.", 0.43),
        (
            7,
            "where is the cup on the counter",
            "cup-1 (green bowl) is on",
            "; it is a cup with p = 0.43.",
            0.43,
        ),
    ],
)
def test_what_turns_out_to_be_of_another_class_is_told_of_as_that(
    tmp_path: Path, looks: int, question: str, start: str, end: str, probability: float
) -> None:
    with Store(tmp_path / "world.sqlite") as store:
        model = WorldModel(CONFIG, home(), store)
        stamp = look(model, 90.0, 10, seen(ON_COUNTER, "cup", "green", 0.6))
        look(model, stamp, looks, seen(ON_COUNTER, "bowl", "green", 0.6))
        answer = ask(recall(store), question)
    assert answer.sentence.startswith(start)
    assert answer.sentence.endswith(end)
    assert answer.probability == pytest.approx(probability, abs=0.01)
