"""The demo from the bag to the page; needs ROS."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from evaluation.demo.demo_report import DemoRun
from evaluation.demo.demo_suite import RECORDED, parameters
from evaluation.demo.files import begin_in
from evaluation.demo.live.demo_director import Director
from evaluation.process_usage import UsageMeter
from whereabouts.logs import RawMessage
from whereabouts.nodes.runtime.suite_run import SuiteRun, replay_spec, run_suite
from whereabouts.nodes.runtime.supervisor import SuiteError
from whereabouts.simulation.home.apartment_bag import START
from whereabouts.simulation.home.apartment_day import MOVED, THINGS, stop

CLOCK_PERIOD = 0.25
"""s of the bag: as exact as timers of a second and more need."""
SEARCH_AFTER = 13.0
"""s after the request to verify: two looks in vain, with a rest between, take about ten."""


@dataclass(frozen=True)
class DemoScript:
    """What is asked for while the bag plays: class of the thing, and s of the bag at which it is verified, searched."""

    wanted: str
    verify_at: float
    search_at: float


def full_script() -> DemoScript:
    """Verify the moved thing where it was, from the stop in the hall, and then look for it."""
    return DemoScript(THINGS[MOVED][0].kind, START + stop(), START + stop() + SEARCH_AFTER)


def replay(
    bag: Path,
    folder: Path,
    rate: float | None = None,
    script: DemoScript | None = None,
    on_event: Callable[[str], None] = lambda text: None,
    on_progress: Callable[[float], None] = lambda share: None,
) -> tuple[Path, DemoRun]:
    """The apartment's bag through all nodes; returns the recording of what they said, and an account.

    rate : multiple of the recorded speed, None for lock-step. Nothing is told of what was asked where the bag ends
    before it. Raises LogError, and SuiteError, also where a node took in nothing.
    """
    begin_in(folder)
    recording = folder / "recording.mcap"
    specs = [replay_spec(name, **given) for name, given in parameters(folder).items()]
    meter = UsageMeter()
    script = script or full_script()
    with Director(script.wanted, script.verify_at, script.search_at) as director:
        run = SuiteRun(
            bag,
            specs,
            folder / "logs",
            rate=rate,
            clock_period=CLOCK_PERIOD,
            record=RECORDED,
            output=recording,
            on_event=on_event,
            on_progress=on_progress,
        )

        def between(message: RawMessage) -> None:
            assert run.supervisor is not None
            assert run.replayer is not None
            replayer = run.replayer
            director.note = replayer.note
            if rate is None:
                director.is_over = lambda name: replayer.flow.published(name) > 0
            director.look(message)
            nodes = run.supervisor.nodes.items()
            meter.look({name: node.process.pid for name, node in nodes})

        run.on_message = between
        account = run_suite(run)
    silent = [spec.full_name for spec in specs if not account.processed[spec.full_name]]
    if silent:
        raise SuiteError(f"{', '.join(silent)} took in nothing of {bag}; the logs say why: {folder / 'logs'}")
    asked = director.account.verified_at is not None or director.account.started is not None
    return recording, DemoRun(account, director.account if asked else None, meter.usage)
