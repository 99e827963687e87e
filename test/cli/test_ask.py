"""`whereabouts ask` on store files: what it prints, and how it ends."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

from whereabouts.cli.ask import stored
from whereabouts.cli.main import app

sys.path.append(str(Path(__file__).parents[1] / "world_model"))
from test_questions import lived


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("home") / "home.sqlite"
    lived(path).close()
    return path


def run(*words: object) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["ask", *map(str, words)])
    return result.exit_code, result.output


def test_the_first_argument_is_the_store(store: Path) -> None:
    code, text = run(store, "where is the red cup?")
    assert (code, text.count("\n")) == (0, 1)
    assert "on the kitchen table" in text
    assert run(store, "where", "is", "the", "red", "cup")[1] == text


def test_the_record_is_json(store: Path) -> None:
    code, text = run(store, "--json", "where is the cup")
    record = json.loads(text)
    assert code == 0
    assert record["choices"] == ["cup-1", "cup-2"]
    assert {"sentence", "probability", "stamp", "evidence", "alternatives"} <= record.keys()


def test_what_is_not_understood_ends_with_one_and_what_can_be_asked(store: Path) -> None:
    code, text = run(store, "please dance")
    assert code == 1
    assert "what is missing" in text


def test_without_a_store_it_ends_with_two(tmp_path: Path) -> None:
    code, text = run(tmp_path / "none.sqlite", "where is the cup")
    assert code == 2
    assert "no such store" in text
    other = tmp_path / "notes.txt"
    other.write_text("no store")
    assert run(other, "where is the cup")[0] == 2


def test_places_that_are_not_there_are_named_with_what_to_do(store: Path) -> None:
    for words in ((store, "where is the cup"), ("where is the cup",)):
        code, text = run("--places", "nope.yaml", *words)
        assert code == 2
        assert "--places nope.yaml: there is no such file" in text
        assert "leave --places out" in text


def test_what_is_not_known_is_said_without_an_article(store: Path) -> None:
    assert 'no "cup\'s handle"' in run(store, "where is the cup's handle")[1]


def test_a_question_may_look_like_a_path() -> None:
    assert stored(["where is /home/me"]) == (None, "where is /home/me")
    assert stored(["x" * 5000, "y"])[0] is None
