"""Who has to be known to the people tracker, and when."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from evaluation.people import people_marked
from evaluation.people.people_judging import Expected
from tracking.people.people_tracker import PeopleTracker


def test_expected_are_those_in_view_for_long_until_hidden_for_long_and_then_anew() -> None:
    expected = Expected(2)
    told = []
    for k in range(120):
        stamp = 0.1 * k
        # The first is in view for 3 s, hidden for 5 s, and back; the second shows two returns, too few, all the time.
        in_view = stamp < 3.0 or stamp >= 8.0
        told.append(expected.look(np.array([9 * in_view, 2]), stamp, 0.1))
    first, second = np.array(told).T
    assert not second.any()
    changes = 0.1 * (np.flatnonzero(np.diff(first.astype(int))) + 1)
    np.testing.assert_allclose(changes, [1.4, 5.9, 9.4], atol=0.11)


def test_marked_legs_are_followed_by_whoever_is_near_and_the_rest_is_elsewhere(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    def tracks(log: object, tracker: object) -> list[SimpleNamespace]:
        def scan(stamp: float, *spots: tuple[float, float]) -> SimpleNamespace:
            return SimpleNamespace(
                stamp=stamp, targets=[np.array(s) for s in spots], in_laser=lambda spot: spot
            )

        return [scan(0.1, (1.0, 0.0), (4.0, 0.0)), scan(0.2), scan(0.3, (2.0, 0.0))]

    monkeypatch.setattr(people_marked, "track_people", tracks)
    monkeypatch.setattr(people_marked, "open_log", lambda path: nullcontext())
    marks = {0.1: np.array([[1.0, 0.1], [1.0, -0.1]]), 0.2: np.array([[5.0, 5.0]])}
    judged = people_marked.judge_marks(tmp_path, marks, PeopleTracker())
    assert judged == people_marked.Marked(marks=3, followed=2, elsewhere=2, scans=3)
