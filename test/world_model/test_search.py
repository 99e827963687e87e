"""Object search: the text's own example, what each step says, and whole searches in recipe rooms."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.places import Places
from evaluation.scenes.recipe_rooms import driven, learning_frames, recipe_room
from world_model.tasks.relations import Relations
from world_model.tasks.search import ObjectSearch, SearchConfig

HERE = np.zeros(3)


def example() -> Relations:
    """Figure 5.1: p(T | A) = p(T | D) = 0.45, p(T | B) = 0.1, p(T | C) = 0; D is also next to C."""
    frames = [["t", "a"]] * 45 + [["a"]] * 55 + [["t", "d"]] * 45 + [["c", "d"]] * 40 + [["d"]] * 15
    return Relations.from_frames(frames + [["t", "b"]] * 10 + [["b"]] * 90 + [["c"]] * 20, smoothing=1e-3)


@pytest.mark.parametrize("method", ["chain", "belief"])
def test_the_example_of_the_text_finds_the_target_over_an_intermediate_object(method: str) -> None:
    search = ObjectSearch(example(), SearchConfig(method=method, weight=0.02))
    view = {"a": [4.0, 1.0], "b": [4.0, -2.5], "c": [8.0, 4.0]}
    visited = []
    for _ in range(3):
        step = search.next_goal(view, "t", HERE)
        assert step.kind == "intermediate"
        visited.append(step.object)
        if step.object == "c":
            break
        search.reached(step.goal)
    # Both direct leads first, or the strong one; then C, which is no neighbour of T itself.
    assert visited[0] == "a"
    assert visited[-1] == "c"
    # On the way to C, D comes into view and is gone to.
    step = search.next_goal({**view, "d": [9.0, 4.5]}, "t", [7.0, 3.0, 0.0])
    assert step.object == "d"
    step = search.next_goal({**view, "d": [9.0, 4.5], "t": [9.5, 5.0]}, "t", [8.0, 4.0, 0.0])
    assert step.kind == "target"
    np.testing.assert_allclose(np.asarray(step.goal), [9.5, 5.0])


def test_a_robot_that_comes_in_from_outside_searches_the_rooms_and_no_more() -> None:
    rooms = {"flat": {"polygon": [[0, 0], [6, 0], [6, 6], [0, 6]]}}
    search, pose, goals = ObjectSearch(example(), places=Places.from_mapping({"places": rooms})), [30, 20], []
    for _ in range(40):
        step = search.next_goal({}, "t", pose)
        if step.goal is None:
            break
        goals.append(step.goal)
        pose = step.goal
        search.reached()
    assert step.kind == "none"
    assert np.min(goals) >= 0.0
    assert np.max(goals) <= 6.0


def test_what_cannot_be_a_probability_or_places_is_refused() -> None:
    for expected in ({"flat": 9.0}, {"flat": np.nan}, None):
        with pytest.raises(InputError, match=r"probability|places"):
            ObjectSearch(example()).expect(expected)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="places must be a Places"):
        ObjectSearch(example(), places={"flat": [[0, 0], [6, 0], [6, 6]]})  # type: ignore[arg-type]


def test_dead_ends_are_not_tried_again_and_a_new_target_starts_afresh() -> None:
    search = ObjectSearch(example())
    view = {"a": [2.0, 0.0], "d": [0.0, 3.0]}
    first = search.next_goal(view, "t", HERE)
    search.reached(first.goal)
    second = search.next_goal(view, "t", HERE)
    assert {first.object, second.object} == {"a", "d"}
    assert search.tried(first.object, first.goal)
    search.next_goal(view, "c", HERE)
    assert not search.tried(first.object, first.goal)


def test_another_object_of_the_same_name_elsewhere_is_no_dead_end() -> None:
    search = ObjectSearch(example())
    first = search.next_goal({"a": [2.0, 0.0]}, "t", HERE)
    assert first.object == "a"
    # It stopped half a metre short of it.
    search.reached([1.5, 0.0])
    assert search.tried("a", [2.0, 0.0])
    assert not search.tried("a", [2.0, 5.0])
    second = search.next_goal({"a": [2.0, 5.0], "c": [-1.0, 0.0]}, "t", [1.5, 0.0, 0.0])
    assert second.object == "a"
    search.reached(second.goal)
    assert search.tried("a", [2.0, 5.0])
    assert search.tried("a", [2.0, 0.0])
    third = search.next_goal({"a": [2.0, 5.0], "c": [-1.0, 0.0]}, "t", [2.0, 5.0, 0.0])
    assert third.object != "a"


def test_without_any_lead_the_floor_is_covered_and_then_it_says_so() -> None:
    values = np.zeros((60, 80), dtype=int)
    values[0], values[-1], values[:, 0], values[:, -1] = 100, 100, 100, 100
    grid = OccupancyGrid.from_values(values, 0.1)
    search = ObjectSearch(example(), grid=grid)
    place, kinds = np.array([1.0, 1.0, 0.0]), []
    for _ in range(60):
        step = search.next_goal({}, "t", place)
        kinds.append(step.kind)
        if step.goal is None:
            break
        assert grid.lookup(step.goal) < 0.0
        search.reached(step.goal)
        place = np.array([*step.goal, 0.0])
    assert kinds[0] == "room"
    assert kinds[-1] == "none"
    assert "random" in kinds
    # 8 m by 6 m seen from 2 m around takes a handful of places, not dozens.
    assert len(kinds) < 14


def test_the_most_likely_room_is_gone_to_first_and_the_next_one_after_it_failed() -> None:
    relations = example()
    for _ in range(20):
        relations.observe(["t"], room="kitchen")
        relations.observe(["a"], room="office")
    square = [[0.0, 0.0], [8.0, 0.0], [8.0, 4.0], [0.0, 4.0]]
    away = [[x + 10.0, y] for x, y in square]
    places = Places.from_mapping(
        {
            "places": {
                "study": {"polygon": square, "type": "office"},
                "kitchen": {"polygon": away, "type": "kitchen"},
            }
        }
    )
    search = ObjectSearch(relations, places=places)
    step = search.next_goal({"a": [1.0, 1.0]}, "t", [2.0, 2.0, 0.0])
    assert step.kind == "room"
    np.testing.assert_allclose(np.asarray(step.goal), [14.0, 2.0])
    stops = []
    while not step.object:
        assert step.kind == "room"
        assert step.goal is not None
        stops.append(step.goal)
        search.reached()
        step = search.next_goal({"a": [1.0, 1.0]}, "t", [*stops[-1], 0.0])
    # Not before the kitchen has been looked at, to both sides of its middle; then to A in the study.
    assert step.object == "a"
    seen = np.array([stop[0] for stop in stops if stop[0] > 10.0])
    assert seen.min() < 13.0
    assert seen.max() > 15.0
    assert len(stops) < 8
    assert [stop[0] > 10.0 for stop in stops] == sorted((stop[0] > 10.0 for stop in stops), reverse=True)


def two_rooms(kitchen: list[list[float]]) -> tuple[Relations, Places]:
    """Relations by which T is in the kitchen, that kitchen, and a study far on its right."""
    relations = example()
    for _ in range(20):
        relations.observe(["t"], room="kitchen")
        relations.observe(["a"], room="office")
    study = [[10.0, 0.0], [14.0, 0.0], [14.0, 4.0], [10.0, 4.0]]
    rooms = {
        "kitchen": {"polygon": kitchen, "type": "kitchen"},
        "study": {"polygon": study, "type": "office"},
    }
    return relations, Places.from_mapping({"places": rooms})


def test_a_room_that_cannot_be_entered_is_given_up_after_one_drive() -> None:
    relations, places = two_rooms([[0.0, 0.0], [4.0, 0.0], [4.0, 4.0], [0.0, 4.0]])
    search = ObjectSearch(relations, places=places)
    step = search.next_goal({}, "t", [12.0, 2.0, 0.0])
    assert "kitchen" in step.reason
    # The robot never gets there, and says so.
    search.reached(step.goal)
    for _ in range(60):
        step = search.next_goal({}, "t", [12.0, 2.0, 0.0])
        assert "kitchen" not in step.reason
        if step.goal is None:
            break
        search.reached(step.goal)
    assert step.kind == "none"


def test_a_room_is_entered_where_it_is_and_not_in_the_middle_of_its_box() -> None:
    corner = [[0.0, 0.0], [8.0, 0.0], [8.0, 2.0], [2.0, 2.0], [2.0, 8.0], [0.0, 8.0]]
    relations, places = two_rooms(corner)
    search, place = ObjectSearch(relations, places=places), np.array([12.0, 2.0, 0.0])
    for _ in range(2):
        step = search.next_goal({}, "t", place)
        if "kitchen" in step.reason:
            assert places["kitchen"].contains(np.asarray(step.goal))
            place = np.array([*step.goal, 0.0])
            search.reached()
    assert places["kitchen"].contains(place[:2])


@pytest.mark.parametrize("door", [False, True])
def test_a_room_that_the_map_shows_closed_is_not_driven_to(door: bool) -> None:
    relations, places = two_rooms([[1.0, 0.5], [4.0, 0.5], [4.0, 3.5], [1.0, 3.5]])
    values = np.zeros((50, 160), dtype=int)
    values[:, 45:47] = 100
    if door:
        values[15:30, 45:47] = 0
    values[10:30, 20:30] = 100  # a table, in the middle of the kitchen
    grid = OccupancyGrid.from_values(values, 0.1)
    step = ObjectSearch(relations, places=places, grid=grid).next_goal({}, "t", [12.0, 2.0, 0.0])
    assert ("kitchen" in step.reason) == door
    if door:
        assert places["kitchen"].contains(np.asarray(step.goal))
        assert grid.lookup(step.goal) < 0.0


def test_a_robot_that_is_off_the_map_drives_to_rooms_all_the_same() -> None:
    relations, places = two_rooms([[1.0, 0.5], [4.0, 0.5], [4.0, 3.5], [1.0, 3.5]])
    grid = OccupancyGrid.from_values(np.zeros((50, 100), dtype=int), 0.1)
    step = ObjectSearch(relations, places=places, grid=grid).next_goal({}, "t", [30.0, 30.0, 0.0])
    assert "kitchen" in step.reason


def test_a_map_that_comes_while_it_searches_is_heeded() -> None:
    relations, places = two_rooms([[1.0, 0.5], [4.0, 0.5], [4.0, 3.5], [1.0, 3.5]])
    values = np.zeros((50, 160), dtype=int)
    values[:, 45:47] = 100
    open_floor = OccupancyGrid.from_values(0 * values, 0.1)
    search = ObjectSearch(relations, SearchConfig(view=10.0), places, open_floor)
    here = [4.9, 2.0, 0.0]
    # On one floor without walls it is in view at once.
    assert "kitchen" not in search.next_goal({}, "t", here).reason
    search.grid = OccupancyGrid.from_values(values, 0.1)
    assert "kitchen" not in search.next_goal({}, "t", here).reason
    # What was taken for looked at, through what turns out to be a wall with a door at its end, was not.
    values[5:15, 45:47] = 0
    search.grid = OccupancyGrid.from_values(values, 0.1)
    assert "kitchen" in search.next_goal({}, "t", here).reason


def test_a_class_nobody_has_heard_of_is_looked_for_all_the_same() -> None:
    search = ObjectSearch(example())
    step = search.next_goal({"a": [2.0, 0.0]}, "unicorn", HERE)
    assert step.goal is not None
    assert "unicorn" in step.reason
    assert "unknown word" in step.reason
    assert ObjectSearch(Relations()).next_goal({}, "cup", HERE).goal is not None


@pytest.mark.parametrize(("view_scale", "outline"), [(4.0, True), (6.0, True), (5.0, False)])
def test_searches_in_rooms_of_another_design_end_without_a_random_search(
    view_scale: float, outline: bool
) -> None:
    relations = Relations.from_frames(learning_frames(np.random.default_rng(0), rooms=12))
    square = [[0.0, 0.0], [18.0, 0.0], [18.0, 18.0], [0.0, 18.0]]
    places = Places.from_mapping({"places": {"living room": {"polygon": square, "type": "living room"}}})
    for seed in range(5):
        room = recipe_room(np.random.default_rng(seed), redesigned=True)
        for corner in room.corners()[::2]:
            search = ObjectSearch(relations, places=places if outline else None)

            def next_goal(
                known: Mapping[str, np.ndarray], place: np.ndarray, search: ObjectSearch = search
            ) -> np.ndarray | None:
                step = search.next_goal(known, "remote control", [*place, 0.0])
                return None if step.kind in ("random", "none") else step.goal

            run = driven(room, corner, "remote control", view_scale, next_goal, search.reached)
            assert not run.failed


def test_what_is_in_view_everywhere_is_no_lead() -> None:
    frames = (
        [["sofa", "table", "t"]] * 20 + [["sofa", "table"]] * 10 + [["sofa"]] * 60 + [["sofa", "lamp"]] * 10
    )
    search = ObjectSearch(Relations.from_frames(frames))
    step = search.next_goal({"sofa": [1.0, 0.0], "table": [6.0, 0.0], "lamp": [0.0, 1.0]}, "t", HERE)
    assert step.object == "table"


def test_on_a_floor_nobody_knows_a_robot_that_gets_nowhere_is_not_sent_there_for_ever() -> None:
    search = ObjectSearch(example())
    kinds = []
    for _ in range(60):
        step = search.next_goal({"b": [3.0, 1.0]}, "t", HERE)
        kinds.append(step.kind)
        if step.goal is None or step.kind == "random":
            break
        search.reached(step.goal)
    assert kinds[0] == "room"
    assert kinds[-1] == "random"
    # 12 m by 15 m seen from 4 m around.
    assert len(kinds) < 15


def test_chains_are_chosen_by_the_inverted_relation() -> None:
    relations = example()
    search = ObjectSearch(relations, SearchConfig(method="chain", weight=0.0, threshold=0.0))
    step = search.next_goal({"a": [2.0, 0.0], "b": [1.0, 0.0], "c": [1.0, 1.0]}, "t", HERE)
    # (5.2) by hand: p(t|a) N(a) against p(t|b) N(b) and p(t|c) N(c), of 100, 100 and 60 frames.
    assert step.object == "a"
    assert step.probability == pytest.approx(45.0 / 55.0, abs=1e-3)


def test_bad_input_is_named() -> None:
    search = ObjectSearch(example())
    with pytest.raises(InputError, match="robot_pose"):
        search.next_goal({}, "t", [0.0, np.nan, 0.0])
    with pytest.raises(InputError, match="position of 'a'"):
        search.next_goal({"a": [np.inf, 0.0]}, "t", HERE)
    with pytest.raises(InputError, match="target"):
        search.next_goal({}, "  ", HERE)
    with pytest.raises(InputError, match="method"):
        SearchConfig(method="luck")
    with pytest.raises(InputError, match="robot_pose"):
        search.next_goal({}, "t", np.zeros((2, 3)))
    with pytest.raises(InputError, match="observed"):
        search.next_goal({3: [0.0, 0.0]}, "t", HERE)  # type: ignore[dict-item]


def test_what_is_refused_does_not_begin_another_search() -> None:
    search = ObjectSearch(example())
    seen = {"a": np.array([1.0, 0.0])}
    step = search.next_goal(seen, "t", HERE)
    assert step.object == "a"
    search.reached()
    assert search.tried("a", [1.0, 0.0])
    with pytest.raises(InputError, match="position of 'a'"):
        search.next_goal({"a": "there"}, "b", HERE)  # type: ignore[dict-item]
    assert search.tried("a", [1.0, 0.0])


def test_what_was_told_and_given_is_no_handle_on_the_search() -> None:
    search = ObjectSearch(example())
    seen = {"a": np.array([1.0, 0.0])}
    step = search.next_goal(seen, "t", HERE)
    assert step.goal is not None
    step.goal[:] = 9.0
    seen["a"][:] = 7.0
    search.reached()
    assert search.tried("a", [1.0, 0.0])
