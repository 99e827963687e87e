"""`whereabouts loops` on short recordings."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner

from estimation.errors import InputError
from evaluation.datasets import recording
from loop_closure import PlaceModel
from whereabouts.cli.main import app

runner = CliRunner()


def log(name: str) -> str:
    path = recording(name)
    if path is None:
        pytest.skip(f"{name} is not here: set WHEREABOUTS_DATA to the folder of recordings")
    return str(path)


def invoke(*arguments: str) -> str:
    result = runner.invoke(app, ["loops", *arguments])
    assert result.exit_code == 0, result.output + str(result.exception)
    return result.output


def test_the_plain_method_is_trained_on_one_place_and_judged_on_another(tmp_path: Path) -> None:
    here, there = log("carmen/freiburg-101-corrected.log.gz"), log("carmen/belgioioso-corrected.log.gz")
    model, figures = tmp_path / "m.json", tmp_path / "f.json"
    invoke("train", here, "--method", "plain", "--distance", "2", "--heading", "45", "--out", str(model))
    assert PlaceModel.load(model).card["trained_on"] == ["freiburg-101"]
    options = ["--local-map", "0", "--heading", "45", "--negatives", "2000", "--json", str(figures)]
    output = invoke("evaluate", there, "--model", str(model), *options)
    assert "belgioioso" in output
    results = json.loads(figures.read_text())["results"]
    assert [row["distance_m"] for row in results] == [1.0, 2.0, 3.0]
    assert all(row["negatives"] == 2000 and row["area"] > 60.0 for row in results)
    picture = tmp_path / "roc.png"
    invoke(
        "evaluate", here, there, "--protocol", "cross", *options, "--roc", str(picture), "--distances", "2"
    )
    assert len(json.loads(figures.read_text())["results"]) == 2
    assert picture.stat().st_size > 1000


def test_cross_validation_has_a_spread_and_inspect_names_features(tmp_path: Path) -> None:
    here, figures = log("carmen/freiburg-101-corrected.log.gz"), tmp_path / "f.json"
    options = ["--local-map", "0", "--distances", "3", "--folds", "3", "--repetitions", "2", "--rounds", "5"]
    invoke("evaluate", here, "--protocol", "k-fold", *options, "--json", str(figures))
    spread = json.loads(figures.read_text())["results"][0]["spread_at_1_percent"]
    assert 0.0 <= spread[2] <= spread[0] <= spread[3] <= 100.0
    output = invoke(
        "inspect", here, "--distance", "3", "--rounds", "5", "--pairs", "100", "--json", str(figures)
    )
    assert "test 1" in output
    found = json.loads(figures.read_text())["results"][0]
    assert len(found["chosen_first"]) == 5
    assert all(1 <= feature <= 44 for feature in found["chosen_first"])


def test_clouds_are_read_from_their_table(tmp_path: Path) -> None:
    table, figures = log("loop_pairs_3d/raw_training_data.csv"), tmp_path / "f.json"
    options = ["--path-gap", "0", "--index-gap", "20", "--distances", "3", "--negatives", "2000"]
    invoke("evaluate", table, "--model", "plain", *options, "--json", str(figures))
    assert json.loads(figures.read_text())["results"][0]["positives"] == 3000


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("stamp,x,y\n1,2,3\n", "is no table of 3D features, which a .csv is taken for"),
        ("sizes:,1,2,3,4,5,6,7,8,9,10\nx,y,z\n1,2,x\n", "could not convert string 'x'"),
        ("sizes:,1,2,3,4,5,6,7,8,9,10\nx,y,z\n" + "1," * 57 + "1\n", "two places or more of 58 columns"),
        ("", "two places or more of 3 columns"),
    ],
)
def test_a_table_of_something_else_is_one_sentence(tmp_path: Path, text: str, message: str) -> None:
    table = tmp_path / "other.csv"
    table.write_text(text)
    result = runner.invoke(app, ["loops", "evaluate", str(table)])
    assert isinstance(result.exception, InputError)
    assert str(result.exception).startswith(f"{table}: ")
    assert message in str(result.exception)


def test_what_cannot_be_done_is_said_in_a_sentence(tmp_path: Path) -> None:
    here = log("carmen/freiburg-101-corrected.log.gz")
    for arguments, message in (
        (["evaluate", here, "--protocol", "cross"], "two places"),
        (["evaluate", here, "--protocol", "other"], "protocol"),
        (["evaluate", here, "--distances", "near"], "distances"),
        (["train", here, "--method", "other", "--out", str(tmp_path / "m.json")], "method"),
    ):
        result = runner.invoke(app, ["loops", *arguments])
        assert result.exit_code != 0
        assert message in str(result.exception)
