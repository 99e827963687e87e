"""Questions as different people say them, about a home whose truth is written down beside them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import datetime
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from estimation.errors import InputError
from estimation.geometry.places import Places
from world_model import WorldObject, WorldState, ask
from world_model.memory.store import Store
from world_model.questions import (
    history,
    how_many,
    moment,
    recall,
    what_is_at,
    where_is,
    where_was,
    where_will_be,
)
from world_model.questions.moments import ahead, extract
from world_model.questions.wording import slip_of

HOME = Places.load(str(files("world_model").joinpath("defaults/home.yaml")))
SPOTS = {
    "table": (2.0, 1.6, 0.9),
    "counter": (3.0, 0.3, 1.1),
    "desk": (1.0, 8.0, 1.0),
    "sofa": (8.0, 0.6, 0.6),
}
HOUR, DAY = 3600.0, 86400.0
MONDAY = datetime(2026, 11, 16).timestamp()
NOW = MONDAY + 2 * DAY + 20 * HOUR
"""Wednesday, eight in the evening."""


def thing(name: str, place: str, stamp: float, **attributes: str) -> WorldObject:
    known = {"class": {name.rpartition("-")[0]: 1.0}}
    known |= {attribute: {value: 0.97} for attribute, value in attributes.items()}
    position = np.array(SPOTS[place])
    return WorldObject(name, position, np.zeros(3), 1e-4 * np.eye(3), known, 0.99, False, stamp, MONDAY)


@pytest.fixture(scope="module")
def home(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    """Three days, every ten minutes. The red cup is on the desk from nine to eleven, else on the counter, where the
    blue one stays; the laptop is on the desk by day, from 8:30 to 18:00, else on the sofa; the bag is gone since 14:00
    of wednesday. Jürgen is at the counter at eleven, for twenty minutes, and Anna on the sofa at 18:00."""
    with Store(tmp_path_factory.mktemp("home") / "home.sqlite") as store:
        store.keep_places(HOME)
        for step in range(round((NOW - MONDAY) / 600.0) + 1):
            stamp = MONDAY + 600.0 * step
            day, hour = divmod((stamp - MONDAY) / HOUR, 24.0)
            seen = [
                thing("cup-1", "desk" if 9 <= hour < 11 else "counter", stamp, color="red"),
                thing("cup-2", "counter", stamp, color="blue"),
                thing("laptop-1", "desk" if 8.5 <= hour < 18 else "sofa", stamp),
            ]
            if day < 2 or hour < 14:
                seen.append(thing("bag-1", "sofa", stamp, color="red"))
            for number, (begin, place, name) in enumerate(
                ((11, "counter", "Jürgen"), (18, "sofa", "Anna")), 1
            ):
                if begin <= hour < begin + 0.4:
                    person = thing(f"person-{2 * int(day) + number}", place, stamp, identity=name)
                    seen.append(replace(person, first_seen=MONDAY + day * DAY + begin * HOUR))
            store.record(WorldState(tuple(seen), 1.0, float(len(seen)), stamp))
        yield store


@pytest.mark.parametrize(
    ("question", "value"),
    [
        ("have you seen my laptop?", "sofa"),
        ("I can't find the red cup", "counter"),
        ("hey, could you please tell me where the red cup is?", "counter"),
        ("wheres teh red cup", "counter"),
        ("I'm looking for the blue mug", "counter"),
        ("which room is the laptop in?", "living_room"),
        ("where was the laptop on 17 November at 3pm", "desk"),
        ("where was the red cup yesterday at half past nine", "desk"),
        ("where was the laptop yesterday morning at ten to eleven", "desk"),
        ("where was the red cup at nine this morning", "desk"),
        ("where will the laptop be at 10 tomorrow", "desk"),
        ("is the red cup in its usual place?", True),
        ("was the red cup on the desk this morning?", True),
        ("was there a cup on the sofa yesterday?", False),
        ("where is the laptop usually at noon?", "desk"),
        ("where is the red cup usually on mondays at ten?", "desk"),
        ("is the laptop usually on the desk at night?", False),
        ("is the laptop in the kitchen or in the living room?", True),
        ("has the red cup been on the counter for eight hours?", True),
        ("has the red cup been on the counter for a day?", False),
        ("has the laptop been on the desk for an hour?", False),
        ("what was on the desk yesterday?", ["laptop-1", "cup-1"]),
        ("is anything on the desk?", []),
        ("what is on the couch?", ["laptop-1"]),
        ("how many cups do we have?", 2),
        ("list all the cups", ["cup-1", "cup-2"]),
        ("which things have disappeared since yesterday?", ["bag-1"]),
        ("what is no longer on the desk", {"cup-1": "counter", "laptop-1": "sofa"}),
        ("how long was the laptop on the desk yesterday?", pytest.approx(9.5 * HOUR, abs=600.0)),
        ("who moved the laptop?", ["person-6"]),
        ("what did Anna carry yesterday?", ["laptop-1"]),
        ("did Juergen move the laptop today?", []),
        ("what did Jurgen carry today", ["cup-1"]),
    ],
)
def test_what_people_say_is_answered_as_it_is_meant(home: Store, question: str, value: object) -> None:
    answer = ask(home, question)
    assert answer.value == value, answer.sentence


@pytest.mark.parametrize(
    ("question", "kind", "words"),
    [
        ("where did I leave my mug?", "choices", ["cup-1", "cup-2"]),
        ("where is the cup and the laptop", "where_is", ["cup-1", "cup-2", "laptop-1"]),
        ("where is Jürgen", "where_is", ["Jürgen", "seen last", "counter", "11:20"]),
        ("when was Anna here last?", "when_last_seen", ["18:20"]),
        ("has anybody been in the kitchen since ten?", "who_was_here", ["Jürgen"]),
        ("who was here yesterday between noon and seven?", "who_was_here", ["Anna"]),
        ("was Anna here yesterday?", "who_was_here", ["Anna"]),
        (
            "who was in the living room since monday?",
            "who_was_here",
            ["1 person was", "person-2", "person-6"],
        ),
        ("is anybody home?", "who_was_here", ["nobody", "last 5 min"]),
        ("when was the red cup last on the desk?", "when_last_seen", ["10:50"]),
        ("what happened in the kitchen today?", "what_moved", ["cup-1", "09:00", "11:00"]),
        ("has the bag been moved today?", "how_often", ["missing", "14:00"]),
        ("where's the lapotp", "where_is", ['"lapotp"', '"laptop"', "sofa"]),
    ],
)
def test_what_the_sentence_tells(home: Store, question: str, kind: str, words: list[str]) -> None:
    answer = ask(home, question)
    assert answer.kind == kind, answer.sentence
    assert all(word in answer.sentence for word in words), answer.sentence


@pytest.mark.parametrize(
    "question",
    [
        "where is the cup not?", "is the red cup not on the desk?", "what is under the sofa?", "where is the cap",
        "what was usually on the desk yesterday?", "where is the cup next to the sofa", "where is Peter",
        "what happened while I was away?", "where was the red cup tomorrow", "where will the red cup be yesterday",
        "have you seen the keys or the wallet?", "is the red cup to the left of the laptop?",
        "what's not on the desk", "who am I", "where is the grey lap top",
        "what did Peter carry today",
    ],
)  # fmt: skip
def test_what_is_not_known_is_not_made_up(home: Store, question: str) -> None:
    answer = ask(home, question)
    assert answer.kind in ("unknown", "not_understood"), answer.sentence
    assert answer.value is None


@pytest.mark.parametrize(
    ("words", "start", "end"),
    [
        ("two days ago", 0.0, DAY),
        ("two days ago at noon", 0.5 * DAY, 0.5 * DAY),
        ("an hour and a half ago", 2 * DAY + 18.5 * HOUR, 2 * DAY + 18.5 * HOUR),
        ("quarter of an hour ago", 2 * DAY + 19.75 * HOUR, 2 * DAY + 19.75 * HOUR),
        ("in the last twenty-five minutes", NOW - MONDAY - 1500.0, NOW - MONDAY),
        ("at ten past nine", 2 * DAY + 9 * HOUR + 600.0, 2 * DAY + 9 * HOUR + 600.0),
        ("at noon in the afternoon", 2 * DAY + 12 * HOUR, 2 * DAY + 12 * HOUR),
        ("at eight last night", DAY + 20 * HOUR, DAY + 20 * HOUR),
        ("last night at two", 2 * DAY + 2 * HOUR, 2 * DAY + 2 * HOUR),
        ("the 17th", DAY, 2 * DAY),
        ("nov 16th", 0.0, DAY),
        ("last weekend", -2 * DAY, 0.0),
        ("this week", 0.0, NOW - MONDAY),
        ("last week", -7 * DAY, 0.0),
        ("last month", -46 * DAY, -15 * DAY),
    ],
)
def test_more_times_in_words(words: str, start: float, end: float) -> None:
    span = moment(words, NOW)
    assert (span.start - MONDAY, span.end - MONDAY) == (start, end)


@pytest.mark.parametrize(
    ("question", "rest", "start"),
    [
        ("where will it be at 8 tomorrow", "where will it be", 3 * DAY + 8 * HOUR),
        ("where will it be in two hours", "where will it be", 2 * DAY + 22 * HOUR),
        ("where will it be on friday at nine", "where will it be", 4 * DAY + 9 * HOUR),
        ("where will it be at 9", "where will it be", 3 * DAY + 9 * HOUR),
    ],
)
def test_times_ahead(question: str, rest: str, start: float) -> None:
    text, span = ahead(question, NOW)
    assert span is not None
    assert (text, span.start - MONDAY) == (rest, start)


def test_only_what_cannot_be_another_word_is_a_slip() -> None:
    known = ["cup", "book", "bottle", "laptop", "glass"]
    assert slip_of("botle", known) == "bottle"
    assert slip_of("lapptop", known) == "laptop"
    assert [slip_of(word, known) for word in ("cap", "boot", "grass", "battle", "lap")] == [""] * 5


@pytest.mark.parametrize(
    ("question", "value"),
    [
        # Told in other words than those of the patterns.
        ("I cannot find my laptop, where is it?", "sofa"),
        ("help me find the blue cup", "counter"),
        ("Have you seen the laptop anywhere?", "sofa"),
        ("where have I put my laptop", "sofa"),
        ("can you tell me where I left the laptop?", "sofa"),
        ("laptop", "sofa"),
        ("laptop yesterday at noon", "desk"),
        ("where do we usually keep the blue cup?", "counter"),
        ("where should the blue cup be", "counter"),
        ("did I leave my laptop in the office?", False),
        ("how sure are you that the laptop is on the desk?", False),
        ("is the desk empty?", []),
        ("what is on the table in the kitchen?", []),
        ("which things have you seen today?", ["cup-1", "cup-2", "laptop-1", "bag-1"]),
        ("how many times did the laptop get moved today?", 2),
        ("did anything go missing yesterday?", []),
        ("did anything go missing today?", ["bag-1"]),
        ("was the red cup ever on the bed?", False),
        ("was the red cup ever on the desk?", True),
        ("how many cups were on the desk today?", 1),
        ("who was at the counter at ten past eleven?", [["person-5", *2 * ["2026-11-18T11:10"], []]]),
        # Of one time a part may be said for both its ends, and a clock with hands counts to twelve.
        ("where was the laptop between 9 and 10 this morning", "desk"),
        ("what was on the sofa between 5 and 8 pm yesterday", ["bag-1", "laptop-1"]),
        ("where was the laptop at quarter to five", "desk"),
        ("where was the laptop on 17.11. at 12:30", "desk"),
        ("what came to the desk today", ["laptop-1", "cup-1"]),
        ("what left the desk today", {"cup-1": "counter", "laptop-1": "sofa"}),
        ("is everything in its place?", {}),
    ],
)
def test_what_is_said_in_yet_other_words(home: Store, question: str, value: object) -> None:
    answer = ask(home, question)
    found = answer.value
    if answer.kind == "what_moved":
        found = [row[0] for row in found]
    if answer.kind == "who_was_here":
        found = [[name, begin[:16], end[:16], moved] for name, begin, end, moved in found]
    assert found == value, answer.sentence


@pytest.mark.parametrize(
    ("question", "kind", "words"),
    [
        ("how long was the laptop away yesterday?", "how_long_there", ["away for 0 s"]),
        ("is the bag missing?", "where_is", ["missing", "sofa", "13:50"]),
        (
            "where does the red cup go in the evening?",
            "where_usually",
            ["on the counter in the evening (100 %"],
        ),
        ("where is the laptop usually at 8?", "where_usually", ["at 8 (20:00)", "sofa"]),
        (
            "what is usually on the desk every morning?",
            "what_is_usually_here",
            ["in the morning: laptop-1 (58 %"],
        ),
        (
            "is the laptop on the desk or on the sofa?",
            "is_at",
            ["No, laptop-1", "desk", "Yes, laptop-1", "sofa"],
        ),
        ("have you seen the laptop or the wallet?", "where_is", ["sofa", 'no "wallet"']),
        ("is cup-1 red or blue?", "is_so", ["is red", "is not blue"]),
        ("which cup is on the counter?", "where_is", ["cup-1", "cup-2"]),
        ("was the laptop on the desk yesterday or today?", "not_understood", ["one time"]),
        ("where was the laptop at this time yesterday?", "where_was", ["sofa", "2026-11-17 20:00"]),
        ("where is the laptop usually between 9 and 11?", "where_usually", ["desk between 9 and 11 (100 %"]),
        ("where is the laptop on mondays?", "where_usually", ["on monday"]),
        ("where is the laptop usually at the weekend?", "unknown", ["not seen at the weekend"]),
        ("is the red cup on the desk in the mornings?", "is_usually_at", ["No, 33 %"]),
        ("which cup is nearest to cup-1?", "what_is_near", ["cup-2"]),
        ("who has my laptop?", "who_has", ["Nobody that I know of", "sofa"]),
        ("who's got the bag?", "who_has", ["missing", "saw nobody there"]),
        ("has the bag been moved for two days?", "how_often", ["since 2026-11-16 20:00"]),
        ("who was last on the sofa?", "who_was_here", ["1 person", "Anna", "2026-11-18 18:00"]),
        ("what is left of the laptop?", "unknown", ["from where one looks"]),
        ("is the kitchen tidy?", "unknown", ['"kitchen" is a place']),
        ("bring me the cup", "not_understood", ['"bring me the cup"']),
        ("what did I use yesterday?", "not_understood", ['"what did I use yesterday?"']),
        ("did anyone enter the kitchen today?", "who_was_here", ["Jürgen"]),
        ("take the red cup to the desk", "not_understood", []),
        ("did the laptop leave the sofa today?", "when_moved", ["from the sofa to the desk", "08:30"]),
        ("did the laptop leave the sofa this afternoon?", "when_moved", ["not moved from the sofa"]),
        (
            "when did the red cup arrive on the desk yesterday?",
            "when_moved",
            ["to the desk", "2026-11-17 09:00"],
        ),
        ("are all cups on the counter?", "is_at", ["Yes, 2 of 2"]),
        ("are both cups on the desk?", "is_at", ["No, 0 of 2"]),
        ("what was put on the desk today?", "what_moved", ["laptop-1", "cup-1"]),
        ("where was the laptop before?", "when_moved", ["from the desk to the sofa"]),
        ("who took the red cup from the desk?", "who_moved", ["Jürgen", "from the desk to the counter"]),
        ("who took the red cup from the sofa?", "who_moved", ["not moved on the sofa"]),
        ("when was the last time the laptop was on the desk?", "when_last_seen", ["17:50"]),
        ("when was anybody last on the sofa?", "who_was_here", ["Anna", "2026-11-18 18:00"]),
        ("where is everyone?", "who_was_here", ["nobody"]),
        ("where is the blue cup tomorrow at noon?", "where_will_be", ["counter", "2026-11-19 12:00"]),
        ("who was here tomorrow", "unknown", ["future"]),
        ("where was the laptop when I left?", "not_understood", []),
        ("where was the laptop before it was on the desk?", "not_understood", []),
    ],
)
def test_what_those_sentences_tell(home: Store, question: str, kind: str, words: list[str]) -> None:
    answer = ask(home, question)
    assert answer.kind == kind, answer.sentence
    assert all(word in answer.sentence for word in words), answer.sentence


def test_a_coming_moment_is_said_in_words_or_seconds_too(home: Store) -> None:
    world = recall(home)
    span = moment("tomorrow at noon", world.now)
    told = [where_will_be(world, "blue cup", when) for when in (span, "tomorrow at noon", span.start)]
    assert told[0] == told[1] == told[2]


@pytest.mark.parametrize("name", [None, 3.0, ["cup"]])
def test_names_and_times_that_are_none_are_named(home: Store, name: object) -> None:
    world = recall(home)
    for call in (where_is, history, what_is_at, how_many):
        with pytest.raises(InputError, match="must be a word"):
            call(world, name)  # type: ignore[operator]
    for when in (np.nan, np.inf, 1.7e12):
        with pytest.raises(InputError, match="time"):
            where_was(world, "blue cup", when)


@pytest.mark.parametrize(
    ("words", "start", "end"),
    [
        ("sunday night", -2 * HOUR, 6 * HOUR),
        ("the night before last", 20 * HOUR, DAY + 6 * HOUR),
        ("monday noon", 12 * HOUR, 12 * HOUR),
        ("monday at 7pm", 19 * HOUR, 19 * HOUR),
        ("at half ten", 2 * DAY + 10.5 * HOUR, 2 * DAY + 10.5 * HOUR),
        ("at quarter to two", 2 * DAY + 13.75 * HOUR, 2 * DAY + 13.75 * HOUR),
        ("at three in the night", 2 * DAY + 3 * HOUR, 2 * DAY + 3 * HOUR),
        ("yesterday at three", DAY + 15 * HOUR, DAY + 15 * HOUR),
        ("at 03:00", 2 * DAY + 3 * HOUR, 2 * DAY + 3 * HOUR),
        ("at 9.30 pm yesterday", DAY + 21.5 * HOUR, DAY + 21.5 * HOUR),
        ("first thing this morning", 2 * DAY + 6 * HOUR, 2 * DAY + 12 * HOUR),
        ("on the 16th of november at noon", 12 * HOUR, 12 * HOUR),
    ],
)
def test_times_are_made_of_a_day_a_part_and_a_clock(words: str, start: float, end: float) -> None:
    span = moment(words, NOW)
    assert (span.start - MONDAY, span.end - MONDAY) == (start, end)


@pytest.mark.parametrize(
    ("text", "start", "end"),
    [
        ("x between 5 and 7 pm yesterday", DAY + 17 * HOUR, DAY + 19 * HOUR),
        ("x between 9 and 10 this morning", 2 * DAY + 9 * HOUR, 2 * DAY + 10 * HOUR),
        ("x between 9 and 5 pm", 2 * DAY + 9 * HOUR, 2 * DAY + 17 * HOUR),
        ("x between yesterday noon and nine", DAY + 12 * HOUR, DAY + 21 * HOUR),
        ("x after lunch yesterday", DAY + 14 * HOUR, 2 * DAY),
        ("x since ten yesterday", DAY + 10 * HOUR, NOW - MONDAY),
    ],
)
def test_spans_of_time(text: str, start: float, end: float) -> None:
    rest, span, _ = extract(text, NOW)
    assert span is not None
    assert (rest, span.start - MONDAY, span.end - MONDAY) == ("x", start, end)


def test_hours_ago_are_hours_also_when_the_clocks_change(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TZ", "Europe/Berlin")
    time.tzset()
    try:
        now = datetime(2026, 10, 25, 12).timestamp()
        assert now - moment("twelve hours ago", now).start == 12 * HOUR
        today = moment("today", now)
        assert today.end - today.start == 13 * HOUR
    finally:
        monkeypatch.undo()
        time.tzset()


def test_names_with_blanks_lines_and_words_of_the_grammar(tmp_path: Path) -> None:
    with Store(tmp_path / "world.sqlite") as store:
        store.keep_places(HOME)
        names = {"coffee_mug-2": "desk", "left shoe-1": "sofa", "Lost_box-1": "counter"}
        made = [thing(name, place, MONDAY) for name, place in names.items()]
        store.record(WorldState(tuple(made), 1.0, 3.0, MONDAY))
        asked = ("coffee mug 2", "coffee_mug-2", "mug", "left shoe", "lost box")
        assert [ask(store, f"Where is my {name}?").value for name in asked] == [
            *3 * ["desk"],
            "sofa",
            "counter",
        ]
        assert ask(store, "is the left shoe on the sofa").value is True
