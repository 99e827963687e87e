"""The demo of weeks, for one day of them: what is remembered, asked and shown."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
from typer.testing import CliRunner

from estimation.errors import InputError
from evaluation.demo.demo_weeks import figures, live_through, write
from evaluation.demo.files import begin_in
from whereabouts.cli.main import app


def test_a_day_at_home_becomes_a_report(tmp_path: Path) -> None:
    month = live_through(tmp_path, 1, 3, lambda share: None)
    text = write(tmp_path, month).read_text(encoding="utf-8")

    found = figures(month)
    assert found["answered"] == found["asked"]
    assert found["places_right_percent"] > 75.0
    told = json.loads(re.search(r'id="told">(.*?)</script>', text, re.S)[1])  # type: ignore[index]
    # Ten things, each under one name or more, at places with names.
    assert len({rows[-1][1] for rows in told["things"].values()}) >= 9
    places = {row[6] for rows in told["things"].values() for row in rows}
    assert {"on the counter", "on the desk"} <= places
    assert told["people"]
    assert 'href="world.sqlite"' in text


@pytest.mark.parametrize("given", [["--live", "--weeks", "1"], ["--weeks", "1", "--bag", "x.mcap"]])
def test_two_demos_at_once_are_refused(given: list[str], tmp_path: Path) -> None:
    result = CliRunner().invoke(app, ["demo", "--out", str(tmp_path / "out"), *given])
    assert result.exit_code != 0
    assert not (tmp_path / "out").exists()


def test_a_memory_that_no_demo_made_is_not_replaced(tmp_path: Path) -> None:
    store = tmp_path / "world.sqlite"
    store.write_bytes(b"a robot's")
    with pytest.raises(InputError, match=r"world\.sqlite: would be replaced"):
        begin_in(tmp_path)
    result = CliRunner().invoke(app, ["demo", "--weeks", "1", "--out", str(tmp_path)])
    assert result.exit_code != 0
    assert store.read_bytes() == b"a robot's"
    (tmp_path / "logs").mkdir()
    begin_in(tmp_path)
    assert not store.exists()
