"""The measures of the experiment `routines` on a household whose days are all alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.experiments import routines as experiment
from evaluation.report import RunOptions


def clockwork() -> experiment.HomerHome:
    """Two things for 70 days: one goes from place 3 to 5 at 9:00 and back at 17:00, one rests at place 4."""
    minutes = np.tile(np.arange(360, 1441, 10), (70, 1))
    out = np.where((minutes >= 540) & (minutes < 1020), 5, 3)
    return experiment.HomerHome(np.stack([out, np.full_like(out, 4)], axis=2), minutes)


@pytest.mark.parametrize("views", [0, 2])
def test_days_that_are_alike_are_foretold(tmp_path: Path, views: int) -> None:
    judged = experiment.run(
        clockwork(), experiment.METHODS["routines"], RunOptions(tmp_path, quick=True), views
    )
    for hours in experiment.HOURS:
        right, moved, brier = judged.row(hours)
        assert right > (99.0 if views == 0 else 95.0)
        assert moved > (99.0 if views == 0 else 85.0)
        assert brier < 0.1
    if views == 0:
        assert judged.scores()[3] > 0.8


def test_last_seen_is_wrong_about_what_moves(tmp_path: Path) -> None:
    judged = experiment.run(clockwork(), None, RunOptions(tmp_path, quick=True))
    right, moved, brier = judged.row(3)
    share = judged.moved[3] / judged.all[3]
    assert right == pytest.approx(100.0 * (1.0 - share))
    assert moved == 0.0
    assert brier == pytest.approx(2.0 * share)
    assert not judged.scores().any()


def test_a_wrong_place_is_false_and_missed() -> None:
    judged = experiment.JudgedRoutines()
    judged.move(("sink", 0.4), "table")
    judged.move(("sink", 0.4), "sink")
    judged.move(("sink", 0.4), None)
    judged.move(None, "sink")
    low, high = 0, len(experiment.THRESHOLDS) - 1
    assert (judged.hits[low], judged.false[low], judged.missed[low]) == (1, 2, 2)
    assert (judged.hits[high], judged.false[high], judged.missed[high]) == (0, 0, 3)
    assert judged.scores()[low] == pytest.approx(1.0 / 3.0)


def test_in_hindsight_the_more_frequent_way_is_right() -> None:
    home = clockwork()
    # On three of the days that are judged, of which there are five, it stays.
    home.place[[65, 67, 69], :, 0] = 3
    right, moved = experiment.hindsight(home, 3)
    steps = np.arange(0, home.place.shape[1] - 18, 3)
    before, after = home.place[65:, steps, 0], home.place[65:, steps + 18, 0]
    goes = (before[1] == 3) & (after[1] == 5)  # where two of five days differ from the other three
    assert right == pytest.approx(100.0 * (1.0 - 2 * goes.sum() / (2 * before.size)))
    assert moved == pytest.approx(100.0 * (1.0 - 2 * goes.sum() / (before != after).sum()))
