"""The first screen of the reports, in a browser: the slider of time, the four questions, and names that are code."""

from __future__ import annotations

import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from estimation.geometry.places import Places
from evaluation.browser import CHROMIUM, Browser
from evaluation.demo.page import Page
from evaluation.demo.reasons import plain
from evaluation.demo.screen import GONE, HERE, LOST, KnownThing, Screen, at_place, place_around, thinned

KITCHEN = {"polygon": [[0, 0], [4, 0], [4, 3], [0, 3]], "kind": "room"}
COUNTER = {
    "polygon": [[0, 0], [1, 0], [1, 1], [0, 1]], "kind": "furniture", "preposition": "on", "height": [0.5, 1.5],
}  # fmt: skip
HOME = Places.from_mapping({"frame": "map", "places": {"kitchen": KITCHEN, "counter": COUNTER}})
EVIL = "</script><img src=x onerror=\"document.title='broken'\">"


def known(
    stamp: float, state: str, x: float = 0.5, name: str = "red cup", place: str = "on the counter"
) -> KnownThing:
    return KnownThing(stamp, name, np.array([x, 0.5, 0.9]), 0.97, state, place, stamp)


@pytest.fixture
def screen() -> Screen:
    made = Screen(100.0, 200.0, HOME)
    made.robot = [(100.0, 3.0, 1.0, 0.0), (150.0, 3.0, 2.0, 1.5), (200.0, 3.0, 2.0, 1.5)]
    made.people = {
        "person 1": [(150.0, 2.0, 2.0, False, False)],
        "person 2": [(150.0, 3.5, 0.5, False, True)],
    }
    made.note("cup-1", known(110.0, HERE))
    made.note("cup-1", known(110.5, HERE))
    made.note("cup-1", known(160.0, LOST))
    made.note("bag-1", known(120.0, HERE, 3.0, EVIL, "in the kitchen"))
    made.tell_things()
    return made


def test_only_news_is_kept_and_told(screen: Screen) -> None:
    assert [row.stamp for row in screen.things["cup-1"]] == [110.0, 160.0]
    told = [(stamp, text) for stamp, text, name in screen.events if name == "cup-1"]
    assert told == [
        (110.0, "found the red cup on the counter"),
        (160.0, "the red cup is no longer on the counter"),
    ]
    screen.note("cup-1", known(170.0, GONE))
    assert screen.things["cup-1"][-1].state == GONE


def test_words_for_places_and_moments() -> None:
    assert at_place(HOME, "counter") == "on the counter"
    assert at_place(HOME, "") == ""
    assert place_around(HOME, np.array([0.5, 0.5, 0.9])) == "counter"
    assert place_around(HOME, np.array([0.5, 0.5, 0.1])) == "kitchen"
    assert place_around(HOME, np.array([9.0, 0.5, 0.1])) == ""
    assert thinned([0.0, 0.1, 0.5, 0.9, 1.0, 1.2], 0.5) == [0.0, 0.5, 1.0, 1.2]


@pytest.mark.parametrize(
    ("reason", "said"),
    [
        ("Driving 0.2 m should gain 5.7 nat from cup-1.", "looked again at the cup: not seen for 6 min, on the way"),
        (
            "Driving 2.8 m should gain 9.0 nat: 5.7 nat from cup-1, the rest from 2 more on the way.",
            "looked again at the cup: not seen for 6 min, 3 m away, others on the way",
        ),
        ("grasping asked for it.", "looked again at the cup, asked for by grasping"),
    ],
)  # fmt: skip
def test_reasons_in_plain_words(reason: str, said: str) -> None:
    assert plain(reason, "cup", 360.0) == said


@pytest.fixture
def page(screen: Screen, tmp_path: Path) -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no browser here: install Debian's chromium")
    written = Page("A day", "What it was.", screen).write(tmp_path / "index.html")
    with Browser(tmp_path / "profile") as browser:
        browser.open(f"file://{written}")
        until(browser, "!!document.querySelector('#picture svg text')")
        yield browser


def until(browser: Browser, script: str) -> None:
    end = time.monotonic() + 60.0
    while not browser.run(script):
        assert time.monotonic() < end, script
        time.sleep(0.05)


def go(browser: Browser, share: float) -> None:
    slider = "document.getElementById('moment')"
    browser.run(f"({slider}.value = {1000 * share}, {slider}.dispatchEvent(new Event('input')))")


def text(browser: Browser, name: str) -> str:
    return str(browser.run(f"document.getElementById('{name}').textContent"))


def test_the_slider_tells_who_was_where_and_what_happened(page: Browser) -> None:
    go(page, 0.5)
    assert text(page, "then") == "0:50"
    assert "person 1" in text(page, "who")
    assert "person 2 in the kitchen: a false person, nobody is there" in text(page, "who")
    assert "On the counter: red cup" in text(page, "what")
    assert "found the red cup on the counter" in text(page, "story")
    assert "no longer" not in text(page, "story")
    assert "The robot is in the kitchen and has driven 1 m." in text(page, "where")
    go(page, 1.0)
    assert "Nobody" in text(page, "who")
    assert "the red cup is no longer on the counter" in text(page, "story")
    page.run("(() => { const w = document.getElementById('wanted'); w.value = 'cup-1'; w.onchange(); })()")
    assert "is lost: it is no longer on the counter" in text(page, "where")
    go(page, 0.0)
    assert "Not known of yet" in text(page, "where")


def test_names_are_text_and_nothing_is_fetched(page: Browser) -> None:
    assert EVIL in text(page, "what")
    assert page.run("document.title") == "A day"
    assert page.run("document.images.length") == 0
    assert page.run("performance.getEntriesByType('resource').length") == 0


@pytest.mark.parametrize("width", [360, 1280])
def test_the_page_is_as_wide_as_its_window(page: Browser, width: int) -> None:
    page._call(
        "Emulation.setDeviceMetricsOverride", width=width, height=800, deviceScaleFactor=1, mobile=width < 500
    )
    until(page, f"innerWidth === {width}")
    assert page.run("document.documentElement.scrollWidth") <= width
    until(
        page,
        "document.querySelector('#picture svg').clientWidth <= document.getElementById('picture').clientWidth",
    )
