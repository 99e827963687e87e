"""Nodes brought up in order, by the executable of the launch files and by `whereabouts run`."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib.resources import files
from pathlib import Path

import pytest
import yaml
from harness import Graph
from lifecycle_msgs.msg import State, Transition

from whereabouts.nodes.runtime.bring_up import bring_up
from whereabouts.nodes.runtime.supervisor import SuiteError

UNCONFIGURED, INACTIVE = State.PRIMARY_STATE_UNCONFIGURED, State.PRIMARY_STATE_INACTIVE
ACTIVE, ASKED = State.PRIMARY_STATE_ACTIVE, -1


class Pretender:
    """A node that takes its time: each answer but every third is that it is busy."""

    def __init__(self, name: str, steps: list[tuple[str, int]], state: int) -> None:
        self.name, self._steps, self._state, self._asked = name, steps, state, 0

    @property
    def present(self) -> bool:
        return self.name != "dead"

    def state(self, wait: float = 1.0) -> int:
        self._asked += 1
        return State.PRIMARY_STATE_UNKNOWN if self._asked % 3 else self._state

    def ask(self, state: int) -> None:
        assert state == self._state == UNCONFIGURED
        self._steps.append((self.name, ASKED))

    def advance(self, state: int) -> None:
        assert state == self._state
        self._state = INACTIVE if state == UNCONFIGURED else ACTIVE
        self._steps.append((self.name, self._state))


def test_all_are_asked_to_configure_at_once_and_are_configured_before_the_first_is_active() -> None:
    steps: list[tuple[str, int]] = []
    states = {"a": UNCONFIGURED, "b": INACTIVE, "c": UNCONFIGURED, "d": ACTIVE}
    bring_up([Pretender(name, steps, state) for name, state in states.items()])  # type: ignore[misc]
    asked, configured = [("a", ASKED), ("c", ASKED)], [("a", INACTIVE), ("c", INACTIVE)]
    assert steps == [*asked, *configured, ("a", ACTIVE), ("b", ACTIVE), ("c", ACTIVE)]


def test_waiting_ends_and_says_for_whom() -> None:
    with pytest.raises(SuiteError, match="dead is not active after 0 s"):
        bring_up([Pretender("dead", [], State.PRIMARY_STATE_UNKNOWN)], timeout=0.0)  # type: ignore[list-item]


def test_one_that_compiles_is_waited_for_and_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("whereabouts.nodes.runtime.bring_up.SAY_AFTER", 0.0)
    told: list[str] = []
    slow = Pretender("slow", [], UNCONFIGURED)
    bring_up([slow], timeout=0.0, tell=told.append)  # type: ignore[list-item]
    assert ACTIVE in {slow.state() for _ in range(3)}
    (sentence,) = told
    assert sentence.startswith("waiting for slow: the first start after an installation compiles")


@pytest.mark.parametrize("name", ["world_model", "object_search"])
def test_a_node_that_cannot_be_configured_is_named(graph: Graph, name: str) -> None:
    home = str(files("world_model").joinpath("defaults/home.yaml"))
    graph.start(name, wait=False, autostart=False, places_file=home, map_frame="elsewhere")
    command = [sys.executable, "-m", "whereabouts.nodes.runtime.bring_up", name]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    graph.until(lambda: process.poll() is not None, "bring_up ends")
    assert process.returncode == 1
    assert f"/{name} could not be configured" in process.communicate()[0]


def test_run_with_a_file_brings_up_what_it_names(graph: Graph, tmp_path: Path) -> None:
    path = tmp_path / "suite.yaml"
    content = {
        "namespace": "/robot1",
        "nodes": {"object_search": None, "verifier": {"parameters": {"frames": 5}}},
    }
    path.write_text(yaml.safe_dump({**content, "logs": str(tmp_path / "run")}))
    command = [sys.executable, "-m", "whereabouts.cli.main", "run", "--config", str(path)]
    with (tmp_path / "output").open("w") as output:
        process = subprocess.Popen(
            command, stdout=output, stderr=subprocess.STDOUT, env={**os.environ, "PYTHONUNBUFFERED": "1"}
        )
    try:
        text = (tmp_path / "output").read_text
        graph.until(lambda: "all are active" in text() or process.poll() is not None, "all are active")
        assert "starting /robot1/verifier, /robot1/object_search" in text()
        assert "all are active" in text(), text()
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()
    assert process.returncode == 0


def test_watching_brings_up_again_what_was_started_again(graph: Graph) -> None:
    specs = [graph.start(name, wait=False, autostart=False) for name in ("verifier", "object_search")]
    command = [
        sys.executable,
        "-m",
        "whereabouts.nodes.runtime.bring_up",
        "--watch",
        "verifier",
        "object_search",
    ]
    # As a shell starts what is to run in the background.
    process = subprocess.Popen(
        command,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_IGN),
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        for spec in specs:
            graph.until(lambda s=spec: graph.state(s) == ACTIVE, f"{spec.executable} is active")  # type: ignore[misc]
        assert process.stdout is not None
        assert any("object_search was started again" in line for line in process.stdout)
        # What a person takes down, to set a parameter, stays down; what died comes back.
        graph.change(specs[1], Transition.TRANSITION_DEACTIVATE)
        graph.kill(specs[0])
        graph.supervisor.nodes[specs[0].full_name].restart()
        graph.until(lambda: graph.state(specs[0]) == ACTIVE, "it is active again")
        assert graph.state(specs[1]) == INACTIVE
    finally:
        process.send_signal(signal.SIGINT)
        process.wait()
    assert process.returncode == 0
