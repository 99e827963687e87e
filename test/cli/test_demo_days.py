"""Several live days, one after the other; the days themselves are made up here."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

import evaluation.demo.demo_runs as demo
from whereabouts.cli.main import app


@pytest.mark.parametrize(("wrong", "status"), [((), 0), ((4,), 1)])
def test_days_are_lived_one_after_the_other_and_counted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, wrong: tuple[int, ...], status: int
) -> None:
    lived: list[Path] = []

    def day(out: Path, seed: int) -> dict[str, Any]:
        lived.append(out)
        right = seed not in wrong
        return {
            "seed": seed, "asked": "red cup", "fetched": "red cup" if right else "", "right": right, "search_m": 6.0,
            "wrong_beliefs": 1.3, "library_wrong": 1.5, "naive_wrong": 1.8,
        }  # fmt: skip

    monkeypatch.setattr(demo, "live_day", day)
    given = ["demo", "--live", "--seed", "3", "--days", "3", "--out", str(tmp_path / "out"), "--json"]
    result = CliRunner().invoke(app, [*given, str(tmp_path / "days.json")])
    assert result.exit_code == status, result.output
    assert lived == [tmp_path / "out" / f"day-{seed}" for seed in (3, 4, 5)]
    told = json.loads((tmp_path / "days.json").read_text())
    assert (told["days_right"], len(told["days"])) == (3 - len(wrong), 3)
    assert f"on {3 - len(wrong)} of 3 days" in result.output
    assert ("fetched nothing" in result.output) == bool(wrong)


def test_days_go_with_a_robot_that_acts(tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["demo", "--days", "3", "--out", str(tmp_path)])
    assert result.exit_code
    assert "--live" in str(result.exception)
