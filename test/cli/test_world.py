"""`whereabouts world`: from a bag to worlds, events, a store, answers and learned settings."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Iterator
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from estimation.errors import InputError
from whereabouts.cli.main import app
from whereabouts.simulation.world_bag import EvidenceWriter
from world_model import ObjectEvidence, WorldEvidence

runner = CliRunner()
HOME = str(files("world_model").joinpath("defaults/home.yaml"))
ON_TABLE, ON_COUNTER, ON_DESK = (2.0, 1.6, 0.8), (0.3, 2.0, 1.0), (1.0, 8.0, 0.9)
SETTINGS = {
    "classes": ["cup", "bowl"],
    "colors": ["red", "green"],
    "region": [0.0, 9.5, 0.0, 8.5, 0.0, 2.5],
    "clutter_per_frame": 0.01,
}


def seen(position: tuple[float, ...], kind: str, color: str, rng: np.random.Generator) -> ObjectEvidence:
    attributes = {"class": {kind: 1.0}, "color": {color: 1.0}}
    return ObjectEvidence(rng.normal(position, 0.02), 4e-4 * np.eye(3), attributes)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A bag: a red cup on the table until t = 1007, on the desk from 1013; a bowl, detected in 80 % of the looks."""
    folder = tmp_path_factory.mktemp("world")
    rng = np.random.default_rng(6)
    view = {"pose": (4.0, 4.0, 1.2, 0.3), "range": 9.0, "angle": 6.28}
    with EvidenceWriter(folder / "evidence.mcap") as writer:
        for k in range(400):
            stamp = 1000.0 + 0.05 * k
            objects = [seen(ON_COUNTER, "bowl", "green", rng)] if rng.random() < 0.8 else []
            if stamp < 1007.0 or stamp >= 1013.0:
                objects.append(seen(ON_TABLE if stamp < 1010.0 else ON_DESK, "cup", "red", rng))
            writer.write(WorldEvidence(objects, view), stamp)
        writer.write(WorldEvidence([ObjectEvidence((1.0, 1.0, np.nan))], view), 1030.0)
    params = folder / "world.yaml"
    params.write_text(yaml.safe_dump({"/**": {"ros__parameters": SETTINGS}}))
    return folder / "evidence.mcap", params


@pytest.fixture(scope="module")
def short(recorded: tuple[Path, Path], tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A bag with three looks, and the same settings."""
    bag, rng = tmp_path_factory.mktemp("short") / "evidence.mcap", np.random.default_rng(1)
    with EvidenceWriter(bag) as writer:
        for k in range(3):
            writer.write(WorldEvidence([seen(ON_TABLE, "cup", "red", rng)]), 1000.0 + 0.05 * k)
    return bag, recorded[1]


def run(*arguments: object) -> str:
    result = runner.invoke(app, ["world", *map(str, arguments)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    return result.output


def test_from_bag_to_states_events_store_and_answers(recorded: tuple[Path, Path], tmp_path: Path) -> None:
    bag, params = recorded
    states, events, store, figures = (tmp_path / name for name in ("s.jsonl", "e.csv", "w.sqlite", "f.json"))
    settings = ("--params", params, "--places", HOME)
    files_ = ("--out", states, "--events", events, "--store", store, "--json", figures)
    output = run(bag, *settings, *files_)
    assert "400 messages" in output
    assert "objects[0]" in output
    assert "the red cup (cup-1): on the desk" in output
    lines = [json.loads(line) for line in states.read_text().splitlines()]
    assert [line["stamp"] for line in lines] == pytest.approx([1000.0 + 0.05 * k for k in range(400)])
    assert {item["id"] for item in lines[-1]["objects"]} == {"cup-1", "bowl-1"}
    assert {item["place"] for item in lines[-1]["objects"]} == {"desk", "counter"}
    with events.open() as file:
        rows = list(csv.DictReader(file))
    assert ("appeared", "cup-1") in {(row["event"], row["id"]) for row in rows}
    written = json.loads(figures.read_text())
    assert (written["messages"], written["objects"], written["runs"]) == (400, 2, 1)

    # The store answers on its own.
    output = run(store, *settings, "--id", "cup-1", "--at", 1005, "--json", figures)
    assert output.startswith("1.00  the red cup (cup-1): on the kitchen table, p = ")
    assert json.loads(figures.read_text())["answers"][0]["places"]["kitchen_table"] > 0.9
    assert "cup-1" in run(store, *settings, "--region", "kitchen_table", "--at", "last_seen")
    assert run(store, *settings, "--class", "cup", "--region", "kitchen_table") == "no object matches\n"
    # A second bag of the same time is another run.
    assert json.loads(figures.read_text())["answers"]
    output = run(bag, *settings, "--store", store, "--json", figures)
    assert json.loads(figures.read_text())["runs"] == 2


def test_looking_back_names_also_the_first_detections(tmp_path: Path) -> None:
    """Where false ones are frequent, an object has no symbol at its first detection; in the end that is its own."""
    bag, corrected, rng = tmp_path / "moving.mcap", tmp_path / "corrected.csv", np.random.default_rng(4)
    params = tmp_path / "world.yaml"
    params.write_text(yaml.safe_dump({"/**": {"ros__parameters": {**SETTINGS, "clutter_per_frame": 20.0}}}))
    with EvidenceWriter(bag) as writer:
        for k in range(60):
            pose = (4.0, 1.0 + 0.05 * k, 1.2, np.pi)
            objects = [seen(ON_TABLE, "cup", "red", rng), seen(ON_COUNTER, "bowl", "green", rng)]
            writer.write(
                WorldEvidence(objects, {"pose": pose, "range": 9.0, "angle": 6.28}), 1000.0 + 0.05 * k
            )
    run(bag, "--params", params, "--look-back", corrected)
    rows = list(csv.DictReader(corrected.open()))
    assert [row["stamp"] for row in rows[:2]] == ["1000.000000"] * 2
    assert {(row["detection"], row["id"]) for row in rows} == {("0", "cup-1"), ("1", "bowl-1")}
    assert len(rows) == 120


def test_the_past_can_be_asked_for_without_keeping_a_store(recorded: tuple[Path, Path]) -> None:
    bag, params = recorded
    output = run(bag, "--params", params, "--places", HOME, "--class", "cup", "--at", 1005.0)
    assert "on the kitchen table" in output


def test_learned_settings_are_those_the_log_was_made_with(
    recorded: tuple[Path, Path], tmp_path: Path
) -> None:
    bag, params = recorded
    learned, figures = tmp_path / "learned.yaml", tmp_path / "f.json"
    run(bag, "--params", params, "--learn", learned, "--json", figures)
    found = json.loads(figures.read_text())
    assert found["detection_probability_by_class"]["bowl"] == pytest.approx(0.8, abs=0.05)
    assert found["learned"]["measurement_sigma"] == pytest.approx(0.02, rel=0.15)
    given = yaml.safe_load(learned.read_text())["/**"]["ros__parameters"]
    assert given["classes"] == ["cup", "bowl"]
    assert given["measurement_sigma"] == found["learned"]["measurement_sigma"]
    assert "cup-1" in run(bag, "--params", learned)


def test_learning_says_how_far_it_is(
    recorded: tuple[Path, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bag, params = recorded
    told: list[tuple[str, int]] = []

    def track(items: Iterable[Any], description: str, total: int) -> Iterator[Any]:
        told.append((description, total))
        return iter(items)

    monkeypatch.setattr("whereabouts.system.progress.track", track)
    assert "400 observations, 2 objects" in run(bag, "--params", params, "--learn", tmp_path / "learned.yaml")
    assert set(told) == {("learning", 400)}


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--at", "tea time"], "--at: seconds"),
        (["--region", "attic"], "unknown place 'attic'"),
        (["--predicate", "shiny"], "unknown predicate 'shiny'"),
        (["--params", "/nowhere.yaml"], "/nowhere.yaml: cannot be read"),
        (["--places", "/nowhere.yaml"], "--places /nowhere.yaml: there is no such file; name"),
    ],
)
def test_what_makes_no_sense_is_refused_by_name(
    short: tuple[Path, Path], arguments: list[str], message: str
) -> None:
    bag, params = short
    given = arguments if "--params" in arguments else ["--params", str(params), *arguments]
    result = runner.invoke(app, ["world", str(bag), *given])
    assert result.exit_code != 0
    assert isinstance(result.exception, InputError)
    assert message in str(result.exception)


def test_a_bag_without_evidence_says_so(tmp_path: Path) -> None:
    empty = tmp_path / "empty.mcap"
    with EvidenceWriter(empty):
        pass
    result = runner.invoke(app, ["world", str(empty)])
    assert result.exit_code != 0
    assert "evidence" in str(result.exception)
