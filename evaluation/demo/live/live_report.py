"""What the live demo came to: sentences, one picture, and figures beside a naive robot's."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.grid import OccupancyGrid
from evaluation.demo import pictures
from evaluation.demo.belief_judging import believed
from evaluation.demo.files import files_of
from evaluation.demo.live.live_library import Outcome
from evaluation.demo.live.live_screen import live_screen
from evaluation.demo.live.live_story import Story, within_reach
from evaluation.demo.page import Page, Row
from evaluation.demo.reading import Grid
from whereabouts.simulation.home.apartment_day import MOVED, THINGS
from whereabouts.simulation.home.live_apartment import LiveDay

Array = NDArray[np.float64]
PHASES = {
    "tour": ("#9aa7b1", "tour"),
    "maintenance": ("#1f77b4", "looking again where it pays"),
    "sought": ("#8c564b", f"looking for the {MOVED}"),
    "search": ("#ff7f0e", "looking for the cup, and fetching it"),
    "home": ("#2ca02c", "bringing it"),
}
MARKS = {"maintenance": ("D", "#1f77b4"), "search": ("*", "#ff7f0e"), "fetch": ("o", "#d62728")}
PEOPLE = "#7f3fbf"


@dataclass
class LiveTold:
    """All that the page tells. naive : the robot that patrols and searches directly, None where there is none."""

    story: Story
    day: LiveDay
    map: OccupancyGrid | None
    library: Outcome | None = None
    naive: Outcome | None = None
    wall: float = float("nan")


def figures(told: LiveTold) -> dict[str, Any]:
    """All figures by name, for --json."""
    story, robot = told.story, told.day.robot
    kept = _kept(story)
    found: dict[str, Any] = {
        "seed": told.day.seed,
        "day_s": story.ended,
        "wall_s": told.wall,
        "asked": story.script.asked,
        "fetched": story.fetched or "",
        "right": story.right,
        "reached": within_reach(story),
        "reached_m": story.reached,
        "failures": story.failures,
        "metres": robot.metres,
        **{f"{name}_m": metres for name, metres in story.metres.items()},
        "sought": story.script.sought,
        "sought_found_m": story.sought,
        "looks": len(story.tasks),
        "goals": len(story.goals),
        "goals_failed": sum(goal.outcome in ("failed", "no way") for goal in story.goals),
        "wrong_beliefs": _mean([len(one.wrong) for one in kept]),
        "unknown_things": _mean([len(one.unknown) for one in kept]),
        "moved_known_after_s": _known_after(told),
        "stood_for_people": len(robot.stands),
        "stood_for_people_s": robot.waited,
        "closest_to_people_m": robot.closest,
    }
    for name, outcome in (("library", told.library), ("naive", told.naive)):
        if outcome is not None:
            found |= {f"{name}_{key}": value for key, value in _of(outcome).items()}
    return found


def sentences(told: LiveTold) -> list[str]:
    """What happened, in plain words."""
    story, day = told.story, told.day
    found = figures(told)
    asked = f"Asked for the {story.script.asked}, the robot"
    search = found.get("search_m", 0.0)
    if story.fetched is None:
        said = [f"{asked} drove {search:.0f} m and came back without anything: {'; '.join(story.failures)}."]
    else:
        verdict = "the right one" if story.right else "which is the wrong one"
        said = [f"{asked} drove {search:.0f} m and took the {story.fetched}, {verdict}."]
        if story.failures:
            said.append(f"On the way: {'; '.join(story.failures)}.")
    moved = [(when, name) for when, name in day.household.moves if when <= story.ended]
    if moved:
        names = ", ".join(f"the {name} ({when:.0f} s)" for when, name in moved)
        said.append(f"People had carried {len(moved)} things elsewhere: {names}.")
    if story.script.sought:
        driven = found.get("sought_m", 0.0)
        way = f"found it after {driven:.0f} m" if driven > 0.5 else "knew"
        how = (
            f"{way}, {story.sought:.2f} m from where it truly lay"
            if story.sought < 1.0
            else "did not find it"
        )
        said.append(f"Asked where the {story.script.sought} is, it {how}.")
    after = found["moved_known_after_s"]
    if np.isfinite(after):
        said.append(f"Where the {MOVED} had gone was known {after:.0f} s after it was put down.")
    if "maintenance" in story.metres:
        said.append(
            f"Looking again where it pays took {len(story.tasks)} tasks and {story.metres['maintenance']:.0f} m; "
            f"meanwhile {found['wrong_beliefs']:.1f} things at a time were believed to be where they were not."
        )
    said.append(
        f"The robot stood {len(day.robot.stands)} times for people, {day.robot.waited:.0f} s in all. While it drove, "
        f"{day.robot.closest:.2f} m was the least between its middle and anybody's."
    )
    return said


def write(folder: Path, told: LiveTold) -> Path:
    """live.png and index.html in `folder`; returns the page's path."""
    story = told.story
    draw(folder / "live.png", told)
    said = sentences(told)
    recording, bag = folder / "recording.mcap", folder / "live.mcap"
    page = Page("A robot that acts on what it knows", said[0], live_screen(recording, bag, story))
    for sentence in said[1:]:
        page.text(sentence)
    page.heading("Files of this run")
    page.files(files_of(folder, bag, recording))
    page.heading("For engineers: the whole day in one picture")
    page.picture(
        "live.png",
        "The map, the robot's way by what it was doing, goals in the order of their numbers, where things truly are "
        "(crosses) and where they are believed to be (dots), and where people walked.",
    )
    page.heading("Beside a naive robot, same day")
    page.table(*_beside(told), numbers=True)
    page.text(
        "The robot of the middle column runs the libraries without ROS; it knows its pose and tracks nobody. The naive "
        "robot is one like it: it patrols with the metres that maintenance took, and searches where the thing was seen "
        "last and then from room to room, the nearest first."
    )
    page.heading("Where it was sent, and why")
    rows = [
        (str(number), f"{goal.stamp:.0f} s", goal.kind, f"{goal.place[0]:.1f}, {goal.place[1]:.1f}", goal.outcome,
         goal.reason)
        for number, goal in enumerate(story.goals, start=1)
    ]  # fmt: skip
    page.table(("", "after", "by", "to, m", "", "why"), rows)
    steps = [(f"{stamp:.0f} s", reason) for search in story.searches for stamp, reason in search.steps]
    if steps:
        page.heading("What the search said")
        page.table(("after", ""), steps)
    return page.write(folder / "index.html")


def summary(told: LiveTold) -> list[Row]:
    """What was wanted, and what came of it."""
    found = figures(told)
    rows = [
        Row("fetched", found["fetched"] or "nothing", found["asked"], bool(found["right"])),
        Row("day", f"{found['day_s']:.0f} s in {found['wall_s']:.0f} s"),
        Row("driven", f"{found['metres']:.0f} m"),
    ]
    if told.naive is not None and told.library is not None:
        rows.append(
            Row(
                "wrong beliefs at a time",
                f"{told.library.wrong:.2f}, patrol {told.naive.wrong:.2f} (libraries)",
                "fewer than patrol at equal metres",
                told.library.wrong < told.naive.wrong,
            )
        )
    return rows


def _beside(told: LiveTold) -> tuple[Sequence[str], list[Sequence[str]]]:
    found = figures(told)
    nodes = {
        "metres": found.get("maintenance_m", float("nan")), "wrong": found["wrong_beliefs"],
        "unknown": found["unknown_things"], "searched": found.get("search_m", float("nan")),
        "fetched": found["fetched"], "failures": len(found["failures"]), "closest": found["closest_to_people_m"],
    }  # fmt: skip
    columns = [nodes, *(_of(one) for one in (told.library, told.naive) if one is not None)]
    names = {
        "metres": "metres while keeping beliefs", "wrong": "wrong beliefs at a time",
        "unknown": "things nobody knows the place of", "searched": "metres of the search",
        "fetched": "fetched", "failures": "failures of the search", "closest": "nearest to a person, m",
    }  # fmt: skip
    rows: list[Sequence[str]] = [
        [label, *(_cell(column[key]) for column in columns)] for key, label in names.items()
    ]
    heads = ["", "whereabouts, live", "whereabouts, libraries", "patrol, direct search"]
    return heads[: len(columns) + 1], rows


def _of(outcome: Outcome) -> dict[str, Any]:
    return {
        "metres": outcome.metres, "wrong": outcome.wrong, "unknown": outcome.unknown,
        "searched": outcome.searched, "fetched": outcome.fetched or "nothing",
        "failures": len(outcome.failures), "closest": outcome.closest,
    }  # fmt: skip


def _cell(value: Any) -> str:
    return f"{value:.2f}" if isinstance(value, float) else str(value) or "nothing"


def _kept(story: Story) -> list[Any]:
    """Beliefs of the time of maintenance; of all of it where there was none."""
    begins = [begin for begin, name in story.phases if name == "maintenance"]
    ends = [begin for begin, name in story.phases if name == "search"]
    if not begins or not ends:
        return list(story.beliefs)
    return [one for one in story.beliefs if begins[0] <= one.stamp < ends[0]]


def _known_after(told: LiveTold) -> float:
    moved = [when for when, name in told.day.household.moves if name == MOVED]
    return told.story.moved_seen - moved[0] if moved else float("nan")


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


# The picture.


def draw(path: Path, told: LiveTold) -> None:
    """Map, way, goals, things and people on one picture."""
    story = told.story
    figure, ((axes,),) = pictures.canvas(1, 1, (10.0, 10.2))
    if told.map is not None:
        low = told.map.origin
        high = low + np.array(told.map.shape[::-1]) * told.map.resolution
        extent = (float(low[0]), float(high[0]), float(low[1]), float(high[1]))
        pictures.draw_floor(axes, Grid(told.map.values(), extent))
    pictures.draw_building(axes, told.day.home, names=True)
    _draw_people(axes, story)
    _draw_way(axes, story)
    _draw_goals(axes, story)
    _draw_things(axes, told)
    if told.day.robot.stands:
        spots = np.array(told.day.robot.stands)
        axes.plot(*spots.T, "s", color=PEOPLE, markersize=6, label="stood for somebody")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.04), ncol=3, fontsize=9, frameon=False)
    pictures.plain(axes, f"{story.ended:.0f} s of a simulated day")
    figure.savefig(path, format="png")


def _draw_people(axes: Any, story: Story) -> None:
    if not story.people:
        return
    trails = np.array([spots for _, spots in story.people])
    for k in range(trails.shape[1]):
        axes.plot(
            *trails[:, k].T, color=PEOPLE, linewidth=0.7, alpha=0.35, label="people" if k == 0 else None
        )
        axes.plot(*trails[-1, k], "o", color=PEOPLE, markersize=9, alpha=0.8)


def _draw_way(axes: Any, story: Story) -> None:
    way = np.array(story.way)
    ends = [begin for begin, _ in story.phases[1:]] + [np.inf]
    for (begin, name), end in zip(story.phases, ends, strict=True):
        part = way[(way[:, 0] >= begin - 0.5) & (way[:, 0] <= end)] if len(way) else way
        color, label = PHASES[name]
        if len(part):
            axes.plot(part[:, 1], part[:, 2], color=color, linewidth=2.0, alpha=0.85, label=label)


def _draw_goals(axes: Any, story: Story) -> None:
    numbers: dict[tuple[str, float, float], list[int]] = {}
    for number, goal in enumerate(story.goals, start=1):
        if goal.kind in MARKS:
            key = (goal.kind, *(round(float(value), 1) for value in goal.place))
            numbers.setdefault(key, []).append(number)  # type: ignore[arg-type]
    for (kind, x, y), found in numbers.items():
        mark, color = MARKS[kind]
        axes.plot(x, y, mark, color=color, markersize=11, markeredgecolor=pictures.INK, alpha=0.9)
        said = ", ".join(map(str, found[:4])) + (", ..." if len(found) > 4 else "")
        axes.annotate(said, (x, y), (7, 5), textcoords="offset points", fontsize=8, weight="bold")


def _draw_things(axes: Any, told: LiveTold) -> None:
    for spot in told.day.things.values():
        if spot is not None:
            axes.plot(*spot[:2], "+", color=pictures.TRUE, markersize=12, markeredgewidth=1.8)
    for item in believed(told.story.objects):
        x, y = item.position[:2]
        color = pictures.COLORS.get(item.most_probable("color"), pictures.QUIET)
        axes.plot(x, y, "o", color=color, markeredgecolor=pictures.INK, markersize=7)
        axes.annotate(
            f"{item.id}", (x, y), (8, -9), textcoords="offset points", fontsize=7.5, color=pictures.INK
        )
    axes.plot(
        [], [], "+", color=pictures.TRUE, markersize=10, label=f"where the {len(THINGS)} things truly are"
    )
    axes.plot([], [], "o", color=pictures.QUIET, label="where they are believed to be")
