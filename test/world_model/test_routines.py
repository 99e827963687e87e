"""Routines: forecasts against counts made by hand, learning, forgetting, memory, views of a few places."""

from __future__ import annotations

import itertools
import json
import math
import zlib
from collections import Counter
from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest

from estimation.errors import InputError
from world_model import Routines, RoutinesConfig
from world_model.memory.remembered import Remembered
from world_model.memory.routine_kernels import recall

HOUR, DAY = 3600.0, 86400.0
PLACES = ("cupboard", "table", "sink", "shelf")
FLAT = RoutinesConfig(half_life=1e9, window=0.0, clock=1e9, differs=0.0, stay=1e9, prior=1e-9, threshold=0.0)
"""Every day at the same time of day counts the same: forecasts are plain counts."""


def household(days: int, seed: int = 0) -> list[tuple[float, dict[str, str]]]:
    """Stamps and where all is, each ten minutes of whole days: a mug with three possible days, a book that rests."""
    rng = np.random.default_rng(seed)
    rows = []
    for day in range(days):
        kind = rng.choice(3, p=[0.6, 0.25, 0.15])
        start = 8.0 + rng.integers(3) / 6.0
        for tick in range(144):
            hour = tick / 6.0
            mug = "cupboard"
            if kind < 2 and start <= hour < start + 0.5:
                mug = "table"
            elif kind == 0 and start + 0.5 <= hour < 20.0:
                mug = "sink"
            rows.append((day * DAY + tick * 600.0, {"mug": mug, "book": "shelf"}))
    return rows


def at(
    rows: Iterable[tuple[float, dict[str, str]]], routines: Routines, places: Iterable[str] = PLACES
) -> None:
    """Look at all given places at every row."""
    for stamp, where in rows:
        for place in places:
            routines.look(place, [name for name, held in where.items() if held == place], stamp)


def learned(days: int, config: RoutinesConfig | None = None, until: float = 0.0) -> tuple[Routines, Any]:
    """Routines after whole days and a part of the next (until, s), and all rows of these days and of the next."""
    rows = household(days + 1)
    routines = Routines(config)
    at([row for row in rows if row[0] <= days * DAY + until], routines)
    return routines, rows


@pytest.mark.parametrize("hours", [1.0, 3.0, 11.5])
def test_forecast_is_the_count_of_like_days(hours: float) -> None:
    routines, rows = learned(40, FLAT, 9.0 * HOUR)
    where = dict(rows)
    now = 40 * DAY + 9.0 * HOUR
    counts: Counter[str] = Counter()
    for day in range(40):
        then = day * DAY + 9.0 * HOUR
        if where[then]["mug"] == where[now]["mug"]:
            counts[where[then + hours * HOUR]["mug"]] += 1
    found = routines.where("mug", now + hours * HOUR)
    assert set(found) == set(PLACES)
    assert sum(found.values()) == pytest.approx(1.0)
    for place in PLACES:
        assert found[place] == pytest.approx(counts[place] / counts.total(), abs=1e-6)


def test_first_move_is_the_count_of_first_moves() -> None:
    routines, rows = learned(40, FLAT, 8.0 * HOUR - 600.0)
    where = dict(rows)
    counts: Counter[str] = Counter()
    for day in range(40):
        places = [where[day * DAY + 8.0 * HOUR + 600.0 * k]["mug"] for k in range(-1, 3)]
        counts[next((place for place in places if place != places[0]), "stays")] += 1
    place, chance = routines.moves(40 * DAY + 8.0 * HOUR - 600.0, 1800.0)["mug"]
    assert place == "table"
    assert chance == pytest.approx(counts["table"] / 40.0, abs=1e-6)


def test_moves_asked_later_than_the_newest_look_count_from_then() -> None:
    routines, _ = learned(30, None, 6.0 * HOUR)
    now = 30 * DAY + 6.0 * HOUR
    assert routines.moves(now, 1800.0) == {}
    assert routines.moves(now + 2.0 * HOUR - 600.0, 1800.0)["mug"][0] == "table"
    before = routines.to_dict()
    assert routines.moves(now + 2.0 * HOUR - 600.0, 1800.0)
    assert routines.to_dict() == before
    routines.look("table", [], now + 600.0)  # a question does not move time


def test_before_anything_is_learned_things_stay_where_they_were_seen() -> None:
    routines = Routines()
    assert routines.where("mug", 0.0) == {}
    assert routines.moves(0.0, 1800.0) == {}
    assert "not been seen" in routines.explain("mug", 0.0)
    routines.look("table", ["mug"], 0.0)
    assert routines.where("mug", 5.0 * DAY) == {"table": 1.0}
    routines.look("sink", [], 1.0)
    soon, late = routines.where("mug", HOUR), routines.where("mug", 12.0 * HOUR)
    assert soon["table"] > late["table"] > 0.5
    assert routines.where("cup", HOUR) == {}


def test_two_days_are_not_yet_certain() -> None:
    one, many = learned(2)[0], learned(60)[0]
    assert one.where("book", 2 * DAY + HOUR)["shelf"] < many.where("book", 60 * DAY + HOUR)["shelf"]
    assert one.where("mug", 2 * DAY + HOUR)["cupboard"] < 1.0


def test_what_is_absent_has_gone_until_it_is_seen() -> None:
    routines = Routines()
    routines.look("table", ["mug", "plate"], 0.0)
    routines.look("sink", [], 0.0)
    routines.look("shelf", [], 0.0)
    routines.look("table", ["plate"], 3600.0)
    now = routines.where("mug", 3600.0)
    assert now["table"] == pytest.approx(0.0, abs=1e-9)
    assert sum(now.values()) == pytest.approx(1.0)
    assert routines.where("plate", 3600.0)["table"] == 1.0
    routines.look("shelf", ["mug"], 3700.0)
    assert routines.where("mug", 3700.0)["shelf"] == 1.0


def test_unseen_places_keep_what_was_last_seen_there() -> None:
    routines = Routines()
    routines.look("table", ["mug"], 0.0)
    routines.look("sink", ["cup"], 7200.0)
    found = routines.where("mug", 7200.0)
    assert max(found, key=lambda place: found[place]) == "table"


def test_views_of_one_place_at_a_time_learn_the_same_habit() -> None:
    rows = household(40)
    rng = np.random.default_rng(1)
    routines = Routines()
    for row in rows:
        at([row], routines, [str(rng.choice(PLACES))])
    at([rows[-1]], routines)
    found = routines.where("mug", 40 * DAY + 13.0 * HOUR)
    assert max(found, key=lambda place: found[place]) == "sink"


def test_old_habits_are_forgotten() -> None:
    routines = Routines(RoutinesConfig(half_life=5.0))
    for day in range(60):
        usual = "sink" if day < 40 else "shelf"
        for tick in range(0, 144, 3):
            place = usual if tick >= 60 else "cupboard"
            at([(day * DAY + tick * 600.0, {"mug": place})], routines)
    found = routines.where("mug", 60 * DAY + 12.0 * HOUR)
    assert max(found, key=lambda place: found[place]) == "shelf"
    assert found["sink"] < 0.1


def test_memory_stays_flat() -> None:
    config = RoutinesConfig(days=5, slot=1800.0)
    routines = Routines(config)
    sizes = []
    for day in range(30):
        for tick in range(48):
            stamp = day * DAY + tick * 1800.0
            routines.look("table", ["mug", f"visitor-{day}"] if tick % 2 else ["mug"], stamp)
            routines.look("sink", ["cup"] if tick > 20 else [], stamp)
        sizes.append((routines._known.history.place.size, len(json.dumps(routines.to_dict()))))
    assert len({size for size, _ in sizes[10:]}) == 1
    assert max(text for _, text in sizes[10:]) < 1.2 * min(text for _, text in sizes[10:])
    assert "visitor-3" not in routines.objects
    assert {"mug", "cup", "visitor-29"} <= set(routines.objects)


def test_a_long_pause_forgets_but_does_not_fail() -> None:
    routines, _ = learned(10)
    routines.look("table", ["mug"], 2000 * DAY)
    assert routines.where("mug", 2000 * DAY)["table"] == 1.0
    assert routines.moves(3000 * DAY, 1800.0).keys() <= {"mug", "book"}


def test_restored_answers_and_learns_the_same() -> None:
    rows = household(35)
    routines = Routines(RoutinesConfig(days=12))
    at(rows[: 144 * 30 + 50], routines)
    again = Routines.from_dict(json.loads(json.dumps(routines.to_dict())))
    assert again.to_dict() == routines.to_dict()
    at(rows[144 * 30 + 50 : 144 * 32 + 48], routines)
    at(rows[144 * 30 + 50 : 144 * 32 + 48], again)
    now = rows[144 * 32 + 48][0]
    assert again.to_dict() == routines.to_dict()
    assert again.moves(now, 1800.0) == routines.moves(now, 1800.0)
    for hours in (0.0, 0.5, 3.0, 50.0):
        stamp = now + hours * HOUR
        assert again.where("mug", stamp) == pytest.approx(routines.where("mug", stamp))
    assert Routines.from_dict(json.loads(json.dumps(Routines().to_dict()))).places == ()


def test_same_looks_give_same_answers() -> None:
    first, second = (learned(20, None, 8.0 * HOUR)[0] for _ in range(2))
    stamp = 20 * DAY + 10.0 * HOUR
    assert first.where("mug", stamp) == second.where("mug", stamp)
    assert first.moves(stamp, 1800.0) == second.moves(stamp, 1800.0)


def test_order_of_places_in_one_round_does_not_matter() -> None:
    rows = household(15)
    one, other = Routines(), Routines()
    at(rows, one)
    at(rows, other, PLACES[::-1])
    stamp = rows[-1][0] + 9.0 * HOUR
    assert one.where("mug", stamp) == pytest.approx(other.where("mug", stamp))


def test_explains_in_one_sentence() -> None:
    routines, _ = learned(50, None, 8.0 * HOUR + 1200.0)
    said = routines.explain("mug", 50 * DAY + 8.0 * HOUR + 1200.0)
    assert said.count(".") == 1
    assert "mug usually goes from" in said
    assert "days" in said
    assert "too few" in routines.explain("book", 51 * DAY)


@pytest.mark.parametrize("stamp", [math.nan, math.inf, -math.inf])
def test_stamps_must_be_finite(stamp: float) -> None:
    routines = Routines()
    for ask in (
        lambda: routines.look("table", [], stamp),
        lambda: routines.where("mug", stamp),
        lambda: routines.moves(stamp, 1800.0),
        lambda: routines.explain("mug", stamp),
        lambda: routines.moves(0.0, stamp),
    ):
        with pytest.raises(InputError):
            ask()


def test_bad_input_is_refused_and_changes_nothing() -> None:
    routines = Routines()
    routines.look("table", ["mug"], 100.0)
    before = routines.to_dict()
    for place, objects, stamp in (
        ("", ["mug"], 200.0),
        ("table", [""], 200.0),
        ("table", "mug", 200.0),
        ("table", [3], 200.0),
        ("table", ["mug"], 99.0),
        ("table", ["mug"], 1.7e12),
        ("table", ["mug"], "200"),
    ):
        with pytest.raises(InputError):
            routines.look(place, objects, stamp)  # type: ignore[arg-type]
    with pytest.raises(InputError):
        routines.where("mug", 99.0)
    with pytest.raises(InputError):
        routines.moves(100.0, -1.0)
    assert routines.to_dict() == before
    for name in ("window", "differs", "threshold"):
        with pytest.raises(InputError, match=name):
            RoutinesConfig(**{name: math.nan})
    with pytest.raises(InputError):
        Routines.from_dict({"format": "else"})
    with pytest.raises(InputError):
        Routines.from_dict({**before, "objects": [{}]})


def test_what_nobody_saw_happened_when_it_usually_does() -> None:
    routines = Routines()
    for day in range(10):
        for tick in range(48, 60):
            at([(day * DAY + tick * 600.0, {"mug": "table" if tick < 54 else "sink"})], routines)
    seen = 10 * DAY + 8.0 * HOUR
    at([(seen, {"mug": "table"}), (seen + 1.75 * HOUR, {"mug": "sink"})], routines)
    [*_, table, sink] = routines.to_dict()["objects"][0]["stays"]
    assert routines.places[table[2]] == "table"
    assert routines.places[sink[2]] == "sink"
    assert sink[1] == (10 * 144) + 54
    fresh = Routines()
    at([(seen, {"mug": "table"}), (seen + HOUR, {"mug": "sink"})], fresh)
    [*_, sink] = fresh.to_dict()["objects"][0]["stays"]
    assert sink[1] == (10 * 144) + 48 + 3


def test_what_left_and_came_at_different_times_was_at_neither_place_when_somebody_looked() -> None:
    routines = Routines()
    at([(0.0, {"mug": "table"})], routines)
    routines.look("table", [], 2400.0)
    routines.look("sink", [], 4800.0)
    routines.look("sink", ["mug"], 7200.0)
    stays = routines.to_dict()["objects"][0]["stays"]
    where = [[row[2] for row in stays if row[0] <= slot][-1] for slot in range(13)]
    table, sink = (routines.places.index(name) for name in ("table", "sink"))
    assert (where[0], where[12]) == (table, sink)
    assert where[4] != table
    assert where[8] != sink


def test_what_came_back_was_away_when_somebody_looked() -> None:
    routines = Routines()
    at([(0.0, {"mug": "table"})], routines)
    routines.look("table", [], 2400.0)
    routines.look("table", ["mug"], 4800.0)
    [before, away, back] = routines.to_dict()["objects"][0]["stays"]
    assert before[2] == back[2]
    assert away[2] == -1
    assert before[0] < away[0] <= 4 < back[0] <= 8


def test_courses_are_drawn_as_probably_as_they_are() -> None:
    """Against all courses of a gap, one by one: their moves by other days, without where somebody looked in vain."""
    config = RoutinesConfig(days=3, prior=2.0)
    known = Remembered(config)
    for name in PLACES[:3]:
        known.place(name)
    thing = known.column("mug")
    rng = np.random.default_rng(4)
    low, last = 2 * 144 + 50, 2 * 144 + 54
    for slot in range(low + 1):
        known.advance(600.0 * slot)
        busy = 45 < slot % 144 < 60
        if slot == 0 or (busy and rng.random() < 0.4):
            known.set(thing, int(rng.integers(3)))
        known.history.sure[slot, thing] = True
        known.seen[thing] = known.stamp
    known.set(thing, 0)
    known.advance(600.0 * last)
    known.set(thing, 1)
    known.history.sure[last, thing] = known.looked[low + 2, 2] = True
    where, rate = known.history.place[:, thing].copy(), 0.1

    def chance(slot: int, was: int, to: int) -> float:
        found = np.zeros((4, 4))
        for day in (1, 2):
            for off in range(-config.reach, config.reach + 1):
                other = slot - 144 * day + off
                weight = 0.5 ** (day / config.half_life) * math.exp(-0.5 * (off / config.spread) ** 2)
                found[where[other - 1], where[other]] += weight
        prior = np.where(np.eye(4, dtype=bool), 1.0 - rate, rate / 3.0)
        row = found[was] + config.prior * prior[was]
        return float(row[to] / row.sum())

    expected = {}
    for middle in itertools.product(range(-1, 3), repeat=3):
        course = (0, *middle, 1)
        steps = itertools.pairwise(course)
        expected[middle] = math.prod(chance(low + 1 + k, *step) for k, step in enumerate(steps))
        expected[middle] *= middle[1] != 2
    total = sum(expected.values())
    drawn = Counter[tuple[int, ...]]()
    count = 4000
    chain = known.chain(thing)._replace(rate=rate)
    for number in range(count):
        seed = zlib.crc32(f"mug {number} {last}".encode())
        recall(known.history, known.looked, chain, low, last, 0, seed)
        drawn[tuple(known.history.place[low + 1 : last, thing].tolist())] += 1
    assert all(expected[course] > 0.0 for course in drawn)
    for course, weight in expected.items():
        p = weight / total
        assert drawn[course] / count == pytest.approx(p, abs=4.0 * math.sqrt(p * (1.0 - p) / count) + 1e-9)


@pytest.mark.parametrize("every", [1, 400])
def test_what_is_derived_from_a_course_fits_it(every: int) -> None:
    """Since, after many gaps were filled anew, is what the places alone say; looks may be days apart."""
    rng = np.random.default_rng(7)
    routines = Routines()
    for number, row in enumerate(household(30)):
        if number % every == 0:
            at([row], routines, [str(rng.choice(PLACES))] if every == 1 else PLACES)
    mug = routines._known.things["mug"]
    place, since, _ = (each[:, mug] for each in routines._known.history)
    last = routines._known.last
    moves = 0
    for slot in range(routines._known.first + 1, last + 1):
        if place[slot] == place[slot - 1]:
            assert since[slot] == since[slot - 1]
        else:
            moves += 1
            assert since[slot] == slot
    assert moves > 30
    assert not routines._known.history.sure[last + 1 :].any()


@pytest.mark.parametrize(
    "wrong", [{"slot": 0.0}, {"slot": 7.0 * HOUR}, {"days": 0}, {"clock": -1.0}, {"prior": 0.0}]
)
def test_wrong_settings_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        RoutinesConfig(**wrong)


def test_explanation_says_where_when_and_how_often() -> None:
    routines = Routines()
    for day in range(6):
        for tick in range(40, 70):
            late = 2 if day % 2 else 0
            place = "table" if 48 + late <= tick < 50 + late else "sink" if tick >= 50 + late else "cupboard"
            at([(day * DAY + tick * 600.0, {"mug": place})], routines)
    now = 6 * DAY + 49 * 600.0
    at([(now, {"mug": "table"})], routines)
    said = "mug usually goes from table to sink about 20 min after it came; 6 of 6 days."
    assert routines.explain("mug", now) == said


def test_what_older_versions_kept_is_read() -> None:
    """They named more weights, and of each stay the place before, which had no effect."""
    routines, _ = learned(5)
    kept = routines.to_dict()
    older = {**kept, "config": {**kept["config"], "recent": 0.0, "moved": 36000.0, "origin": 1.2}}
    older["objects"] = [each | {"stays": [[*stay, -1] for stay in each["stays"]]} for each in kept["objects"]]
    assert Routines.from_dict(older).to_dict() == kept
    with pytest.raises(InputError, match="half_life"):
        Routines.from_dict({**kept, "config": {}} | {"config": {"slot": 600.0, "days": 5}})


def test_what_older_versions_kept_is_not_drawn_anew() -> None:
    """They say where a thing was, not when it was seen: a gap after them is filled, not they."""
    routines, rows = learned(12)
    kept = routines.to_dict()
    older = {name: value for name, value in kept.items() if name != "looks"}
    older["objects"] = [
        {name: value for name, value in known.items() if name != "sure"} for known in kept["objects"]
    ]
    again = Routines.from_dict(json.loads(json.dumps(older)))
    mug, last = again._known.things["mug"], again._known.last
    before = again._known.history.place[: last + 1, mug].copy()
    for hours in range(2, 12, 2):
        at([rows[12 * 144 + 6 * hours]], again)
    assert (again._known.history.place[: last + 1, mug] == before).all()


def test_what_has_left_goes_its_way_and_may_be_back_but_has_not_stayed() -> None:
    """A mug goes from the table to the sink at eight and back at ten; it is missed at different times."""
    routines = Routines()
    for day in range(10):
        for tick in range(144):
            place = "sink" if 48 <= tick < 60 else "table"
            at([(day * DAY + tick * 600.0, {"mug": place})], routines)
    morning = 10 * DAY + 7.5 * HOUR
    at([(morning, {"mug": "table"})], routines)
    assert routines.where("mug", morning)["table"] == 1.0
    gone = routines.goes("mug", morning)
    assert max(gone, key=gone.__getitem__) == "sink"
    assert gone["table"] == 0.0
    assert routines.goes("mug", morning + HOUR)["sink"] > 0.8
    assert routines.goes("mug", morning + 4.0 * HOUR)["table"] > 0.8
    assert sum(routines.where("mug", morning + HOUR, left=True).values()) == pytest.approx(1.0)
    assert routines.goes("cup", morning) == {}
    assert routines.goes("cup", morning + HOUR, ["mug"])["sink"] > 0.3
    routines.know(["shelf"])
    assert 0.0 <= routines.goes("mug", morning)["shelf"] < 0.1
