"""The console's page in a browser, where one is installed, before a source that says what the test wants."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest
from serving import served
from test_server import TOKEN, ScriptedSource

from evaluation.browser import CHROMIUM, Browser
from whereabouts.console.console_server import Console
from whereabouts.console.shown import empty

pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no browser here: install Debian's chromium")


def until(done: Callable[[], object], what: str) -> None:
    end = time.monotonic() + 60.0
    while not done():
        assert time.monotonic() < end, what
        time.sleep(0.05)


def test_what_a_button_has_said_stays_while_the_search_says_nothing_new(tmp_path: Path) -> None:
    source = ScriptedSource()

    def tell(text: str, stamp: float) -> None:
        source.now = {**empty(), "stamp": stamp, "search": {"name": "cup", "text": text, "done": False}}
        source.version += 1

    tell("looks at the desk", 1.0)
    with Browser(tmp_path / "browser") as browser, served(Console(source, TOKEN)) as port:

        def said() -> str:
            return str(browser.run("document.querySelector('#said').textContent"))

        browser.open(f"http://127.0.0.1:{port}/#token={TOKEN}")
        until(lambda: said() == "cup: looks at the desk", "the search is shown")
        browser.run("act('save_map', {name: 'here'})")
        until(lambda: said() == "done", "the answer is shown")
        before = browser.run("document.querySelector('#stamp').textContent")
        tell("looks at the desk", 100.0)
        until(lambda: browser.run("document.querySelector('#stamp').textContent") != before, "a new world")
        assert said() == "done"
        tell("drives to the kitchen", 101.0)
        until(lambda: said() == "cup: drives to the kitchen", "the search has something new to say")


def test_who_lacks_the_token_is_told_so(tmp_path: Path) -> None:
    console = Console(ScriptedSource(), TOKEN, open_to_all=False)
    with Browser(tmp_path / "browser") as browser, served(console) as port:
        browser.open(f"http://127.0.0.1:{port}/")
        until(
            lambda: "address with the token" in (browser.run("document.body?.innerText") or ""),
            "the page says what is missing",
        )
