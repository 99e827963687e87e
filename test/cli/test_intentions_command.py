"""The command `intentions` as a user types it."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from evaluation.experiments.intentions import simulated_walks
from whereabouts.cli.main import app

runner = CliRunner()


@pytest.fixture(scope="module")
def table(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tracks") / "tracks.csv"
    lines = ["time,label,x,y"]
    for label, walk in enumerate([*simulated_walks(3, 30), np.array([[1.0, 1.0, 2000.0]])]):
        lines += [f"{t:.3f},{label},{x:.3f},{y:.3f}" for x, y, t in walk]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_learns_predicts_saves_and_goes_on(table: Path, tmp_path: Path) -> None:
    figures, saved, drawn = tmp_path / "f.json", tmp_path / "m.npz", tmp_path / "p.png"
    options = ["--json", str(figures), "--save", str(saved), "--picture", str(drawn)]
    result = runner.invoke(app, ["intentions", str(table), *options])
    assert result.exit_code == 0, result.output
    numbers = json.loads(figures.read_text())
    assert (numbers["learned"], numbers["predictions"]) == (30, 20)
    assert numbers["refused"] == {"one observation": 1}
    assert numbers["correct_0.85"] > 0.5
    assert drawn.stat().st_size > 10_000
    again = runner.invoke(app, ["intentions", str(table), "--load", str(saved), "--json", str(figures)])
    assert again.exit_code == 0, again.output
    assert json.loads(figures.read_text())["correct_0.85"] > 0.9


def test_plain_method_and_wrong_input(table: Path, tmp_path: Path) -> None:
    result = runner.invoke(app, ["intentions", str(table), "--method", "ghmm"])
    assert result.exit_code == 0, result.output
    assert "(ghmm)" in result.output
    figures = tmp_path / "printed.json"
    printed = ["--method", "printed", "--json", str(figures), "--horizon", "2"]
    result = runner.invoke(app, ["intentions", str(table), *printed])
    assert result.exit_code == 0, result.output
    # The same goals, and paths of their own.
    assert json.loads(figures.read_text())["predictions"] == 20
    result = runner.invoke(app, ["intentions", str(table), "--method", "oracle"])
    assert result.exit_code == 1
    assert "method" in str(result.exception)
    result = runner.invoke(app, ["intentions", str(tmp_path / "absent.csv")])
    assert "absent.csv" in str(result.exception)
