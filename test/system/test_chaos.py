"""The chaos laboratory runs, and does not look away."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from evaluation.chaos.__main__ import Result, report
from evaluation.chaos.faults import Faults

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


WELL = {"inputs": 5, "defects": {}, "bytes_per_s": 0.0, "slowest": (0.1, "")}


@pytest.mark.parametrize(
    ("result", "shaken", "well"),
    [
        (Result("verifier", 1, 5, "", WELL), None, True),
        (Result("verifier", 1, 5, "exit status -11 at input 4"), None, False),
        (Result("verifier", 1, 5, "", {**WELL, "defects": {"/scan: KeyError": 1}}), None, False),
        (Result("verifier", 1, 5, "", WELL), Faults(inputs=9, facts=3, kills=3), True),
        (Result("verifier", 1, 5, "", WELL), Faults(facts=3, lost=1), False),
        (Result("verifier", 1, 5, "", WELL), Faults(deaths=1), False),
        (Result("verifier", 1, 5, "", WELL), Faults(stalled=["no diagnostics"]), False),
    ],
)
def test_deaths_errors_and_lost_facts_count(result: Result, shaken: Faults | None, well: bool) -> None:
    assert report([result], shaken) is well
