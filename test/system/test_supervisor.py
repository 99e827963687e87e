"""Who is started again, and when that is given up."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import pytest

from whereabouts.nodes.runtime import supervisor as module
from whereabouts.nodes.runtime.supervisor import NodeSpec, SuiteError, Supervisor

ACTIVE = "import os, pathlib, sys; pathlib.Path(os.environ['WHEREABOUTS_ACTIVE_MARK']).touch(); "


@dataclass(frozen=True)
class ScriptSpec(NodeSpec):
    """A process that does what a line of Python says."""

    line: str = field(default="")

    def command(self) -> list[str]:
        return [sys.executable, "-c", self.line]


def watch(supervisor: Supervisor, enough: Callable[[], bool]) -> None:
    while not enough():
        supervisor.check()
        time.sleep(0.01)


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BACK_OFF", 1e-3)
    monkeypatch.setattr(module, "LONGEST_BACK_OFF", 2e-3)


@pytest.mark.parametrize("code", [1, 2])
def test_a_node_that_ends_before_it_was_active_could_not_start(tmp_path: Path, code: int) -> None:
    with Supervisor(tmp_path, patient=True) as supervisor:
        supervisor.start(ScriptSpec("one", line=f"print('why'); raise SystemExit({code})"))
        with pytest.raises(SuiteError, match=r"(?s)/one could not start.*why"):
            watch(supervisor, lambda: False)


@pytest.mark.parametrize("end", ["raise SystemExit(1)", "sys.exit(7)", "os.abort()", "1 / 0"])
def test_once_it_was_active_it_is_started_again_whatever_its_end(tmp_path: Path, end: str) -> None:
    events: list[str] = []
    with Supervisor(tmp_path, on_event=events.append, patient=True) as supervisor:
        other = supervisor.start(ScriptSpec("other", line="import time; time.sleep(1000)"))
        node = supervisor.start(ScriptSpec("one", line=ACTIVE + end))
        # More often than an impatient one would bear.
        watch(supervisor, lambda: node.restarts > 2 * module.RESTART_LIMIT)
        assert other.running
    assert all("was started again" in event for event in events[: node.restarts])


def test_without_patience_a_node_that_keeps_dying_is_given_up(tmp_path: Path) -> None:
    with Supervisor(tmp_path) as supervisor:
        node = supervisor.start(ScriptSpec("one", line=ACTIVE + "raise SystemExit(1)"))
        with pytest.raises(SuiteError, match=r"/one died \d+ times"):
            watch(supervisor, lambda: False)
        assert node.restarts == module.RESTART_LIMIT


def test_a_node_that_fails_to_start_after_it_was_active_once_is_tried_again(tmp_path: Path) -> None:
    line = (
        "import os, pathlib; mark = pathlib.Path(os.environ['WHEREABOUTS_ACTIVE_MARK']); "
        "seen = mark.exists(); mark.touch(); os.abort() if not seen else os._exit(1)"
    )
    with Supervisor(tmp_path, patient=True) as supervisor:
        node = supervisor.start(ScriptSpec("one", line=line))
        watch(supervisor, lambda: node.restarts >= 3)


def test_waits_grow_from_death_to_death(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "BACK_OFF", 0.5)
    monkeypatch.setattr(module, "LONGEST_BACK_OFF", 3.0)
    with Supervisor(tmp_path) as supervisor:
        node = supervisor.start(ScriptSpec("one", line="import time; time.sleep(1000)"))
        waits = []
        for _ in range(6):
            node.died()
            assert node.due is not None
            waits.append(node.due - node.deaths[-1])
        node.due = None
    assert waits == pytest.approx([0.0, 0.5, 1.0, 2.0, 3.0, 3.0])


def test_with_security_each_node_has_its_enclave(monkeypatch: pytest.MonkeyPatch) -> None:
    spec = NodeSpec("verifier", namespace="/robot1")
    assert "--enclave" not in spec.command()
    monkeypatch.setenv("ROS_SECURITY_ENABLE", "true")
    command = spec.command()
    assert command[command.index("--enclave") + 1] == "/robot1/verifier"
