"""`whereabouts parameters`: between them the two files hold every parameter once, and what they say is true."""

from __future__ import annotations

from pathlib import Path

import pytest
from typer.testing import CliRunner

from whereabouts.cli.main import app
from whereabouts.node_names import NODES
from whereabouts.parameter_file import parameters_for, problems_of_file
from whereabouts.parameters.parameter_base import SharedParameters, model_of
from whereabouts.system.counting import counted


def written(path: Path, *options: str) -> Path:
    answer = CliRunner().invoke(app, ["parameters", *options, "--out", str(path)])
    assert answer.exit_code == 0, answer.output
    return path


def test_one_thing_is_not_told_of_as_several(tmp_path: Path) -> None:
    answer = CliRunner().invoke(app, ["parameters", NODES[0], "--out", str(tmp_path / "one.yaml")])
    assert answer.output.endswith("parameters of 1 node\n")
    assert counted(0, "person", "people") == "0 people"


def test_two_files_hold_every_parameter_once_at_its_default(tmp_path: Path) -> None:
    usual, expert = written(tmp_path / "usual.yaml"), written(tmp_path / "expert.yaml", "--expert")
    assert problems_of_file(usual) == problems_of_file(expert) == []
    for node in NODES:
        here, there = parameters_for(usual, node), parameters_for(expert, node)
        assert not here.keys() & there.keys()
        assert 0 < len(here) - len(SharedParameters.public) <= 12
        model = model_of(node)
        known = {name: value for name, value in {**here, **there}.items() if name in model.model_fields}
        assert known == model().model_dump()


def test_it_prints_meaning_unit_and_range_of_the_nodes_that_are_named() -> None:
    said = CliRunner().invoke(app, ["parameters", "verifier", "--expert"]).output
    assert "# time between diagnostics (float from 0.1 to 60 s; while unconfigured)" in said
    assert "/**/verifier:" not in said, "all that only it has is for users"
    assert "loop_closure" not in said


@pytest.mark.parametrize(
    ("arguments", "sentence"), [(["verifer"], "no node is called verifer"), (["--out", "/no/x"], "/no")]
)
def test_what_cannot_be_written_is_said(arguments: list[str], sentence: str) -> None:
    answer = CliRunner().invoke(app, ["parameters", *arguments])
    assert answer.exit_code != 0
    assert sentence in str(answer.exception) + answer.output
