"""A demo of weeks: what a world model has learnt after a simulated month at home, from its memory alone; no ROS.

A robot looks at one piece of furniture every six minutes of the day. Things are moved by habits and forgotten, people
sit down here and there. Then it is asked, and what it says is held against the truth.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from evaluation.demo.files import begin_in, files_of
from evaluation.demo.page import Page, Row
from evaluation.demo.screen import BELIEVED, Screen, place_around
from evaluation.experiments.questions import (
    BEGIN,
    DAY,
    FRAMES,
    HOME,
    THINGS,
    AskedHome,
    kind_of,
    look,
    looks_of,
    settings,
)
from world_model import WorldModel, WorldState
from world_model.memory.store import Store
from world_model.questions import Answer, ask

DAYS = 28
EVERY = 3
"""Of the looks of the experiment on questions."""
PERSON = "person"
ASKED = (
    "where is the red cup", "where is the laptop usually", "what is usually on the low table", "what is on the sofa",
    "what is missing", "what has changed since this morning", "how often was the book moved this week",
    "how long has the red cup been there", "who was on the sofa today", "what will be needed next",
    "what happened to the white plate since yesterday",
)  # fmt: skip
"""What is asked on the last evening."""


@dataclass
class Month:
    """What came of it. right : share of looks at which the thing's place was believed right, by thing. seconds : of an
    answer."""

    days: int
    screen: Screen
    answers: list[tuple[str, Answer, float]] = field(default_factory=list)
    right: dict[str, list[bool]] = field(default_factory=dict)


def live_through(folder: Path, days: int, seed: int, on_progress: Callable[[float], None]) -> Month:
    """So many days at home; the memory is `world.sqlite` in the folder."""
    memory = begin_in(folder)
    rng = np.random.default_rng([seed, DAYS])
    home = AskedHome.living(days, rng)
    screen = Screen(BEGIN, BEGIN + days * DAY, HOME, days=True, fresh=900.0)
    screen.nobody = "Nobody in the last quarter of an hour."
    month = Month(days, screen)
    with Store(memory) as store:
        model = WorldModel(settings(), HOME, store, looks_back=False)
        looks = list(looks_of(days))[::EVERY]
        for number, (stamp, place) in enumerate(looks):
            for again in range(5 if home.is_visited(place, stamp) else FRAMES):
                state = model.update(look(home, place, stamp, rng), stamp + again)
            _note(screen, state)
            if number % 15 == 0:
                _judge(month, home, state)
                on_progress(number / len(looks))
        screen.end = looks[-1][0]
        month.answers = _interview(store)
    _tell_truth(screen, home)
    screen.tell_things()
    screen.chosen = next((name for name, rows in screen.things.items() if rows[-1].name == "red cup"), "")
    return month


def _note(screen: Screen, state: WorldState) -> None:
    """What was known after a look."""
    for item in state.objects:
        if item.most_probable("class") != PERSON or item.existence < BELIEVED:
            continue
        if item.last_seen >= state.stamp - 1.0:
            x, y = item.position[:2].tolist()
            row = (state.stamp, x, y, False, False)
            screen.people.setdefault(item.id.replace("-", " "), []).append(row)
    screen.take(state.stamp, state.objects, lambda item: place_around(HOME, item.position))


def _judge(month: Month, home: AskedHome, state: WorldState) -> None:
    """Whether each thing is believed to be where it is: at its place, or at none."""
    for name in THINGS:
        place, _ = home.at(name, state.stamp)
        color = name.split()[0] if " " in name else ""
        found = [
            place_around(HOME, item.position)
            for item in state.objects
            if item.most_probable("class") == kind_of(name) and not item.lost and item.existence >= BELIEVED
            if not color or item.most_probable("color") == color
        ]
        month.right.setdefault(name, []).append(found == [place] if place else not found)


def _interview(store: Store) -> list[tuple[str, Answer, float]]:
    from time import perf_counter

    told = []
    for question in ASKED:
        begun = perf_counter()
        answer = ask(store, question)
        told.append((question, answer, perf_counter() - begun))
    return told


def _tell_truth(screen: Screen, home: AskedHome) -> None:
    for name, moves in home.moves.items():
        screen.true_things[name] = [(stamp, spot if place else None) for stamp, place, spot in moves]


def figures(month: Month) -> dict[str, Any]:
    """All figures by name, for --json."""
    right = [each for rows in month.right.values() for each in rows]
    return {
        "days": month.days,
        "things": len(month.right),
        "places_right_percent": 100.0 * float(np.mean(right)) if right else float("nan"),
        "slowest_answer_ms": 1e3 * max((spent for _, _, spent in month.answers), default=0.0),
        "answered": sum(answer.understood for _, answer, _ in month.answers),
        "asked": len(month.answers),
    }


def summary(month: Month) -> list[Row]:
    """What was wanted, and what came of it."""
    found = figures(month)
    slowest = found["slowest_answer_ms"]
    return [
        Row(
            "places of things that are believed right, every 90 min", f"{found['places_right_percent']:.1f} %"
        ),
        Row(
            "questions answered",
            f"{found['answered']} of {found['asked']}",
            "all",
            found["answered"] == found["asked"],
        ),
        Row("slowest answer", f"{slowest:.0f} ms", "≤ 50 ms", slowest <= 50.0),
    ]


def write(folder: Path, month: Month) -> Path:
    """index.html in `folder`; returns its path."""
    found = figures(month)
    evening = datetime.fromtimestamp(month.screen.end)
    page = Page(
        f"{month.days // 7} weeks at home, remembered" if month.days >= 14 else "A week at home, remembered",
        f"Ten things, two people, one look in six minutes: {found['places_right_percent']:.0f} % of the time the robot "
        "knew where a thing was.",
        month.screen,
    )
    page.heading(f"Asked on the last evening, {evening:%A at %H:%M}")
    page.table(
        ("question", "answer"), [(f"{question}?", answer.sentence) for question, answer, _ in month.answers]
    )
    page.heading("Files of this run")
    page.files(files_of(folder))
    page.heading("For engineers: what was wanted, and what came of it")
    page.summary(summary(month))
    rows = [(name, f"{100.0 * float(np.mean(each)):.1f}") for name, each in sorted(month.right.items())]
    page.table(("thing", "place believed right, %"), rows, numbers=True)
    return page.write(folder / "index.html")
