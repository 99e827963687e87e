"""The judges of the experiment `questions`: right answers pass, wrong ones do not."""

from __future__ import annotations

import inspect
from pathlib import Path

import numpy as np
import pytest

from evaluation.experiments import questions as experiment
from evaluation.report import RunOptions
from world_model.questions import Answer, Recall, ask, recall

DAY, HOUR = 86400.0, 3600.0


def home() -> experiment.AskedHome:
    rng = np.random.default_rng(5)
    return experiment.AskedHome.living(6, rng)


def test_the_truth_of_a_household_is_its_moves() -> None:
    known = home()
    for name, moves in known.moves.items():
        for (begin, place, _), (end, *_) in zip(moves, [*moves[1:], (np.inf,)], strict=True):
            assert known.at(name, begin)[0] == place
            assert known.at(name, min(end, begin + 1e6) - 1.0)[0] == place
    assert known.times("black box", 0.0, np.inf) == 0


@pytest.mark.parametrize(
    "kind", ["where is", "where was", "is it there", "how often", "what is there", "missing"]
)
def test_wrong_answers_are_found_out(kind: str) -> None:
    known, rng = home(), np.random.default_rng(1)
    now = experiment.BEGIN + 5 * DAY + 20 * HOUR
    asked = 0
    while asked < 5:
        made = experiment.QUESTIONS[kind](known, now, rng)
        if made is None:
            continue
        asked += 1
        _, check = made
        wrong = {"is it there": None, "how often": 99}.get(kind, ["unicorn-1"])
        assert not check(Answer("", "where_is", 1.0, "", wrong))


def test_a_day_is_answered(tmp_path: Path) -> None:
    tallies = experiment.two_weeks(RunOptions(tmp_path, seed=3), 1, 40)
    right = [each for tally in tallies.values() for each in tally.right]
    assert len(right) == 40
    assert np.mean(right) > 0.85


@pytest.mark.parametrize("kind", experiment.PUZZLES)
def test_nothing_wrong_is_told_as_sure(kind: str) -> None:
    ghosts, swaps, asked = experiment._puzzle(kind, 7)
    assert (ghosts, swaps) == (0, 0)
    assert asked >= 4


@pytest.mark.parametrize("kind", experiment.KINDS)
def test_every_question_whose_time_is_taken_is_understood(tmp_path: Path, kind: str) -> None:
    rng = np.random.default_rng(2)
    costs = experiment.Costs(experiment.year(tmp_path / "days.sqlite", rng, 2), rng)
    before = costs.now
    for form in experiment.KINDS[kind]:
        times = costs.of(experiment.worded(form, costs.now, rng))
        assert all(each > 0.0 for each in times)
    assert costs.now > before
    costs.reader.recalled = None
    assert recall(costs.reader).now == costs.now, "messages between questions are in the file"
    costs.close()


def test_what_has_left_is_the_same_however_much_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    since = ["2026-11-03", "2026-11-20", "2026-11-30", "yesterday"]
    asked = [f"what has left the {place} since {day}" for day in since for place in ("desk", "sofa")]
    told = []
    with experiment.year(tmp_path / "days.sqlite", np.random.default_rng(3), 30) as store:
        for first in (0.5 * DAY, np.inf):
            monkeypatch.setattr(inspect.getmodule(Recall), "LATELY", first)
            store.recalled = None
            told.append([ask(store, question) for question in asked])
    assert told[0] == told[1]
    assert all(answer.kind == "what_left" and answer.value for answer in told[0])
