"""The live demo from the day to the page; needs ROS, with nav2_msgs."""

from __future__ import annotations

from collections.abc import Callable, Collection
from pathlib import Path

from evaluation.demo.demo_suite import RECORDED
from evaluation.demo.files import begin_in
from evaluation.demo.live.live_log import LiveLog
from evaluation.demo.live.live_robot import LiveRobot
from evaluation.demo.live.live_story import Script, Story, Teller
from evaluation.demo.live.live_suite import live_parameters
from evaluation.demo.replay import CLOCK_PERIOD
from whereabouts.node_interfaces import interfaces_of
from whereabouts.nodes.runtime.suite_run import SuiteRun, replay_spec, run_suite
from whereabouts.simulation.home.live_apartment import LiveDay

LONGEST = 900.0
"""s of the day after which the demo ends, whatever has happened."""


def run_live(
    folder: Path,
    day: LiveDay,
    script: Script,
    nodes: Collection[str] | None = None,
    on_event: Callable[[str], None] = lambda text: None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> tuple[Story, LiveRobot]:
    """The day through the nodes in lock-step; what came of it, and the robot with the last map.

    nodes : executables, all eight by default. The bag in `folder` has what was measured, and the truth.
    Raises SuiteError, LogError, and InputError where nav2_msgs is not installed.
    """
    begin_in(folder)
    given = live_parameters(folder)
    specs = [replay_spec(name, **given[name]) for name in (given if nodes is None else nodes)]
    with LiveRobot(day) as robot:
        teller = Teller(robot, script)
        log = LiveLog(day, folder / "live.mcap", teller.go_on, LONGEST)
        run = SuiteRun(
            log,
            specs,
            folder / "logs",
            clock_period=CLOCK_PERIOD,
            record=_recorded([spec.executable for spec in specs]),
            output=folder / "recording.mcap",
            on_event=on_event,
            on_progress=on_progress,
        )

        def note(name: str) -> None:
            assert run.replayer is not None
            run.replayer.note(name)

        robot.note = note
        run_suite(run)
    return teller.story, robot


def _recorded(nodes: Collection[str]) -> list[tuple[str, str]]:
    """What is recorded of what these nodes say."""
    said = {item.name for name in nodes for item in interfaces_of(name) if item.way.startswith("out")}
    return [(topic, kind) for topic, kind in RECORDED if topic in said]
