"""Who walked lately is about: a place with people is searched for them with less doubt than an empty one."""

from __future__ import annotations

import numpy as np
import pytest
from people_scans import scan_of, walk, wall, with_leg

from tracking import PeopleTracker
from tracking.people_company import LATELY, WALKED, Company
from tracking.people_tracks import Tracks


def standing(tracker: PeopleTracker, first: int, scans: int) -> list:
    """Somebody stands 2 m in front of the scanner, close before a cupboard; how many are reported in each scan."""
    room = wall()
    room[80:200] = np.minimum(room[80:200], 2.35)
    ranges = with_leg(with_leg(room, 2.0, -0.3, 0.09), 2.02, -0.52, 0.09)
    return [
        len(tracker.step(scan_of(ranges, 0.1 * k), np.zeros(3), 0.1 * k)) for k in range(first, first + scans)
    ]


def tracks_of(motion: list[float], shown: list[bool], shape: list[float]) -> Tracks:
    n = len(motion)
    found = Tracks.born(np.arange(n), np.zeros((n, 4)), np.tile(np.eye(4), (n, 1, 1)), 0.0)
    found.motion[:], found.shown[:], found.shape[:], found.looks[:] = motion, shown, shape, 10.0
    return found


def test_who_stands_where_somebody_went_lost_is_found_sooner_than_a_stranger() -> None:
    alone = PeopleTracker()
    assert sum(standing(alone, 0, 60)) == 0
    tracker = PeopleTracker()
    assert walk(tracker, 40)
    gone = [len(tracker.step(scan_of(wall(), 0.1 * k), np.zeros(3), 0.1 * k)) for k in range(40, 200)]
    assert gone[-1] == 0
    assert sum(standing(tracker, 200, 30)) > 20


def test_as_many_as_walked_are_looked_for_and_no_more() -> None:
    company = Company()
    company.meet(tracks_of([8.0, 8.0, 0.0], [True, True, True], [1.0, 1.0, 1.0]), 0.1)
    assert company.most == 2.0
    # One is known, so one is missing, for whoever else is there.
    tracks = tracks_of([8.0, 0.0, 0.0], [True, False, False], [1.0, 1.0, -1.0])
    assert company.unaccounted(tracks).tolist() == [1.0, 1.0, 1.0]
    # The one who is taken for him stays so; there is none left for others.
    tracks.shown[1] = True
    assert company.unaccounted(tracks).tolist() == [1.0, 1.0, 0.0]
    # Both known ones walk: what was taken for the second is nobody.
    tracks = tracks_of([8.0, 0.0, 8.0], [True, True, True], [1.0, 1.0, 1.0])
    assert company.unaccounted(tracks).tolist() == [1.0, 0.0, 1.0]
    assert company.prior(tracks, -5.0)[1] < company.prior(tracks, -5.0)[0]


def test_people_who_went_are_expected_for_a_while_only() -> None:
    company = Company()
    assert company.prior(tracks_of([0.0], [False], [0.0]), -5.0)[0] == -5.0
    company.meet(tracks_of([WALKED - 0.1], [True], [0.0]), 0.1)
    assert company.most == 0.0
    company.meet(tracks_of([8.0], [True], [0.0]), 0.1)
    nobody = tracks_of([0.0], [False], [0.0])
    odds = []
    for _ in range(20):
        company.meet(nobody, 0.25 * LATELY)
        odds.append(company.prior(nobody, -5.0)[0])
    assert odds == sorted(odds, reverse=True)
    assert odds[-1] == pytest.approx(-5.0, abs=0.05)
