"""The examples run, and what they print is true of the worlds that they simulate."""

from __future__ import annotations

import re
import runpy
from pathlib import Path

import pytest

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
# Needs a detector's own messages, which are not on PyPI; the camera's page shows it.
NEEDS_MORE = {"yolo_adapter"}


def said(name: str, capsys: pytest.CaptureFixture[str]) -> str:
    runpy.run_path(str(EXAMPLES / f"{name}.py"), run_name="__main__")
    return capsys.readouterr().out


def numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]


def test_a_scanner_is_followed(capsys: pytest.CaptureFixture[str]) -> None:
    error, duration = numbers(said("follow_a_scanner", capsys).splitlines()[1])
    assert error < 0.1
    assert duration > 30.0


def test_two_scans_are_laid_on_each_other_and_another_place_is_refused(
    capsys: pytest.CaptureFixture[str],
) -> None:
    near, anywhere, other = said("lay_two_scans", capsys).splitlines()
    # 0.4 and 0.2 m in the world, seen from a heading of 0.3 rad; turned by 0.9 rad.
    assert numbers(near)[:3] == pytest.approx([0.4412, 0.0729, 0.9], abs=0.02)
    assert numbers(anywhere)[:3] == pytest.approx(numbers(near)[:3], abs=0.01)
    assert "refused" in other


def test_a_robot_finds_itself_in_a_saved_map(capsys: pytest.CaptureFixture[str]) -> None:
    made, found = said("map_and_find_again", capsys).splitlines()
    assert numbers(made)[0] > 0
    assert numbers(found)[0] < 30.0


def test_beams_on_a_person_who_walks_move(capsys: pytest.CaptureFixture[str]) -> None:
    beams, first = said("what_moves", capsys).splitlines()[:2]
    moving, _, on_person = numbers(beams)
    assert moving == pytest.approx(on_person, abs=6)
    assert numbers(first)[2:4] == pytest.approx([0.0, -0.5], abs=0.1)


def test_people_are_where_they_walk(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("follow_people", capsys)
    places = [numbers(line.partition(" at ")[2])[:2] for line in text.splitlines()[:-1]]
    assert len(places) == 2
    for truth in ((1.5, 0.74), (0.64, 1.2)):
        assert min(abs(x - truth[0]) + abs(y - truth[1]) for x, y in places) < 0.3


def test_what_is_taken_away_is_no_longer_there(capsys: pytest.CaptureFixture[str]) -> None:
    text = said("remember_objects", capsys)
    assert "now there: cup-1\n" in text
    assert "cup-1 (red) is at (1.5" in text


def test_every_example_is_run() -> None:
    names = {path.stem for path in EXAMPLES.glob("*.py")} - NEEDS_MORE
    tests = Path(__file__).read_text(encoding="utf-8")
    assert {name for name in names if f'said("{name}"' not in tests} == set()
