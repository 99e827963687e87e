"""The first screen of the live demo's report: what the nodes said, and what the robot did with it."""

from __future__ import annotations

from pathlib import Path

from estimation.geometry.places import Places
from evaluation.demo.live.live_story import Story
from evaluation.demo.reading import Said, read_said, read_truth
from evaluation.demo.report_screen import screen_of, told_task
from evaluation.demo.screen import Screen
from whereabouts.simulation.home.apartment_bag import START
from whereabouts.simulation.home.floor_plan import places_file

DOING = {
    "tour": "sees the rooms",
    "maintenance": "looks again",
    "search": "searches",
    "fetch": "fetches",
    "home": "home",
}


def live_screen(recording: Path, bag: Path, story: Story) -> Screen:
    """From what the nodes said (`recording`), the truth (`bag`), and the story, whose times are s of the day."""
    said, truth = read_said(recording), read_truth(bag)
    tasks, said.tasks = said.tasks, []
    screen = screen_of(said, truth, Places.load(str(places_file())))
    said.tasks = tasks
    _goals(screen, story)
    for task in tasks:
        screen.events.append((task.stamp, told_task(task, said), task.object_id))
    asked = {"sought": story.script.sought, "search": story.script.asked}
    for begin, name in story.phases:
        if name in asked:
            screen.events.append((START + begin, f"somebody asks for the {asked[name]}", ""))
    for search in story.searches:
        screen.events += [(START + when, reason, "") for when, reason in search.steps]
    if story.fetched is not None:
        home = [begin for begin, name in story.phases if name == "home"]
        when = START + (home[0] if home else story.ended)
        screen.events.append((when, f"the robot takes the {story.fetched}", ""))
    screen.chosen = _asked_for(said, story)
    screen.events.sort(key=lambda event: event[0])
    return screen


def _goals(screen: Screen, story: Story) -> None:
    ends = [goal.stamp for goal in story.goals[1:]] + [story.ended]
    for goal, end in zip(story.goals, ends, strict=True):
        x, y = goal.place.tolist()
        screen.goals.append((START + goal.stamp, START + end, x, y, DOING.get(goal.kind, goal.kind)))


def _asked_for(said: Said, story: Story) -> str:
    """The object that the search ended with, "" where there is none."""
    ended = [search.result for search in story.searches if search.result is not None and search.result.object]
    return str(ended[-1].object[0].id) if ended else ""
