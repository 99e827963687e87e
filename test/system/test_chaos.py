"""The chaos laboratory runs, and does not look away."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from evaluation.chaos.__main__ import ChaosResult, keep, report
from evaluation.chaos.faults import Faults
from evaluation.chaos.network import Link
from evaluation.chaos.times import FAULTS, Fault, Plays, play

ROOT = Path(__file__).resolve().parents[2]


def test_some_seconds_of_chaos_end_nothing() -> None:
    command = [sys.executable, "-m", "evaluation.chaos", "--minutes", "0.1", "--seed", "3"]
    answer = subprocess.run(
        [*command, "world_maintenance", "object_search"], capture_output=True, text=True, cwd=ROOT
    )
    assert answer.returncode == 0, answer.stdout + answer.stderr
    total = re.search(r"^(\d+) inputs, 0 process deaths, 0 kinds", answer.stdout, re.MULTILINE)
    assert total, answer.stdout
    assert int(total[1]) > 500
    # At least two kinds of faults of clocks and network were played, with as many new runs as expected.
    assert len(re.findall(r"^\S.{25} +\d+ +(\d+) +\1$", answer.stdout, re.MULTILINE)) >= 2, answer.stdout


WELL = {"inputs": 5, "defects": {}, "bytes_per_s": 0.0, "slowest": (0.1, "")}


@pytest.mark.parametrize(
    ("result", "shaken", "well"),
    [
        (ChaosResult("verifier", 1, 5, "", WELL), None, True),
        (ChaosResult("verifier", 1, 5, "exit status -11 at input 4"), None, False),
        (ChaosResult("verifier", 1, 5, "", {**WELL, "defects": {"/scan: KeyError": 1}}), None, False),
        (ChaosResult("verifier", 1, 5, "", WELL), Faults(inputs=9, facts=3, kills=3), True),
        (ChaosResult("verifier", 1, 5, "", WELL), Faults(facts=3, lost=1), False),
        (ChaosResult("verifier", 1, 5, "", WELL), Faults(deaths=1), False),
        (ChaosResult("verifier", 1, 5, "", WELL), Faults(runs=1), False),
        (ChaosResult("verifier", 1, 5, "", WELL), Faults(stalled=["no diagnostics"]), False),
    ],
)
def test_deaths_errors_and_lost_facts_count(result: ChaosResult, shaken: Faults | None, well: bool) -> None:
    assert report([result], shaken) is well


@pytest.mark.parametrize(("runs", "heard", "wrong"), [(0, True, ""), (1, True, "1"), (0, False, "nothing")])
def test_a_run_that_nothing_is_a_reason_for_counts(
    monkeypatch: pytest.MonkeyPatch, runs: int, heard: bool, wrong: str
) -> None:
    source = SimpleNamespace(_time=SimpleNamespace(newest=1))

    def happens(stage: Any) -> None:
        stage.node.epoch += runs
        source._time.newest += heard

    monkeypatch.setitem(FAULTS, "a test", Fault(happens))
    nothing = lambda *_: None  # noqa: E731
    stage: Any = SimpleNamespace(node=SimpleNamespace(epoch=3), sources=[source], begin=nothing, go=nothing)
    told: dict[str, Plays] = {}
    said = play(stage, "a test", told)
    assert wrong in said
    assert bool(said) == bool(wrong)
    assert told["a test"] == Plays(1, runs, 0)


def test_a_link_loses_doubles_and_delays_and_makes_nothing_up() -> None:
    link: Link[int] = Link(np.random.default_rng(1), lost=0.2, doubled=0.1, delayed=0.2, longest=5)
    came = [link.send(number) for number in range(2000)]
    arrived = [number for here in came for number in here] + link.rest()
    assert link.rest() == []
    assert set(arrived) <= set(range(2000))
    assert 0.15 < 1.0 - len(set(arrived)) / 2000 < 0.25
    assert 50 < len(arrived) - len(set(arrived)) < 250
    late = [now - number for now, here in enumerate(came) for number in here]
    assert min(late) == 0
    assert max(late) == 5


def test_all_runs_are_added_up(tmp_path: Path) -> None:
    path = tmp_path / "chaos.txt"
    for _ in range(2):
        keep(path, "verifier 5\n\n5 inputs, 1 process deaths, 0 kinds of internal errors\n")
    assert path.read_text().splitlines()[-2] == "so far: 10 inputs, 2 process deaths"
