"""The closed loop over DDS: a search sends the robot, it drives, and the simulated world says what it has fetched."""

from __future__ import annotations

from pathlib import Path

import pytest

from evaluation.demo.live.live_demo import run_live
from evaluation.demo.live.live_library import Outcome
from evaluation.demo.live.live_report import LiveTold, figures, write
from evaluation.demo.live.live_story import Script, within_reach
from whereabouts.logs import open_raw
from whereabouts.simulation.home.live_apartment import REACH, LiveDay

NODES = ("scan_registration", "loop_closure", "world_model", "object_search")


@pytest.mark.timeout(240)
def test_a_search_drives_the_robot_to_the_right_one_of_two_books(tmp_path: Path) -> None:
    """Nothing is known at first: rooms and furniture lead there."""
    day = LiveDay(2, clouds=False)
    events: list[str] = []
    script = Script(0.0, "blue book", 200.0, toured=False, sought="")
    story, robot = run_live(tmp_path, day, script, NODES, events.append)

    steps = [search.steps for search in story.searches]
    assert story.fetched == "blue book", (events, story.failures, steps, story.goals)
    assert within_reach(story)
    assert day.taken == "blue book"
    # It has driven there by itself, through the action, and brings the book to where it began.
    kinds = [goal.kind for goal in story.goals]
    assert kinds[0] == "search"
    assert {"search", "fetch", "home"} == set(kinds)
    assert story.metres["search"] > 5.0
    assert day.away(day.robot.goal) < 0.2
    assert story.goals[-1].outcome == "reached"
    assert [name for _, name in story.phases] == ["search", "home"]
    assert all(reason for search in story.searches for _, reason in search.steps)

    with open_raw(tmp_path / "live.mcap") as bag:
        names = {topic.name for topic in bag.topics}
    assert {"/scan", "/wheel_odom", "/evidence", "/ground_truth/pose", "/ground_truth/objects"} <= names

    told = LiveTold(story, day, robot.map, Outcome(fetched="blue book"), Outcome())
    page = write(tmp_path, told)
    text = page.read_text(encoding="utf-8")
    assert "took the blue book, the right one" in text
    assert (tmp_path / "live.png").read_bytes().startswith(b"\x89PNG")
    assert figures(told)["reached_m"] <= REACH
