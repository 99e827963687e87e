"""Who walks is told by what has come and gone; what stands, slides along an edge or flickers is not."""

from __future__ import annotations

import numpy as np
import pytest
from people_scans import scan_of, wall, with_leg

from tracking import PeopleTracker
from tracking.people_changes import Changes, Past, least_speed
from tracking.people_sweep import Sweep


def past(
    ranges: np.ndarray, stamp: float, beams: slice, pose: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Past:
    """A scan whose `beams` are of the track 7."""
    place = np.array(pose)
    scan = scan_of(ranges, stamp)
    sweep = Sweep.of(scan, place, None, 0.1)
    bare = Past.of(scan, sweep, place, stamp)
    return Past(
        bare.stamp, bare.origin, bare.first, bare.step, bare.ranges, bare.points, {7: bare.points[beams]}
    )


def evidence(starts: list[int], fronts: list[float], robot: float = 0.0, step: float = 0.0) -> float:
    """Of a thing of eight beams that was seen from the beams `starts` on, in scans a tenth of a second apart.

    fronts : m, how far away it is in each. step : m by which walls come nearer from scan to scan.
    """
    changes, found = Changes(), 0.0
    for k, (start, front) in enumerate(zip(starts, fronts, strict=True)):
        ranges = np.full(361, 6.0 - step * k)
        mine = slice(start, start + 8)
        ranges[mine] = front
        now = past(ranges, 0.1 * k, mine)
        found = float(changes.walking(np.array([7]), now, ranges > 4.0, robot)[0])
        changes.remember(now)
    return found


def test_who_is_wholly_elsewhere_after_three_scans_walks() -> None:
    # 3 m away half a degree is 26 mm: 0.1 m in every tenth of a second.
    assert evidence([100, 104, 108], [3.0, 3.0, 3.0]) > 5.0
    # Straight away from the scanner, and towards it.
    assert evidence([100, 100, 100], [3.0, 3.1, 3.2]) > 5.0
    assert evidence([100, 100, 100], [3.2, 3.1, 3.0]) > 5.0


def test_what_stands_settles_or_jumps_does_not() -> None:
    assert evidence([100, 100, 100], [3.0, 3.01, 2.99]) == 0.0
    assert evidence([100, 104, 104], [3.0, 3.0, 3.0]) == 0.0
    assert evidence([100, 108, 100], [3.0, 3.0, 3.0]) == 0.0


def test_what_slides_past_an_edge_was_hidden_before() -> None:
    # Something long behind a gap: what is seen through the gap wanders, but stood hidden before, and is hidden now.
    changes, found = Changes(), []
    for k in range(4):
        ranges = np.full(361, 2.0)
        mine = slice(100 + 4 * k, 108 + 4 * k)
        ranges[mine] = 3.0
        now = past(ranges, 0.1 * k, mine)
        found.append(float(changes.walking(np.array([7]), now, np.zeros(361, dtype=bool), 0.0)[0]))
        changes.remember(now)
    assert found == [0.0] * 4


def test_where_walls_seem_to_move_nothing_is_told() -> None:
    walking = [100, 104, 108, 112, 116]
    sure = evidence(walking, [3.0] * 5)
    assert evidence(walking, [3.0] * 5, step=0.1) == 0.0
    # A robot that drives must have seen first that walls stay where they are.
    driving = [evidence(walking[:k], [3.0] * k, robot=0.8) for k in (3, 5)]
    assert driving[0] < driving[1] < sure


def test_progress_is_that_of_the_slowest_part() -> None:
    times = 0.1 * np.arange(4.0)
    assert least_speed(np.outer(times, [0.6, 0.8]), times) == pytest.approx(1.0)
    assert least_speed(np.array([[0.0, 0.0], [0.1, 0.0], [0.1, 0.0], [0.3, 0.0]]), times) == pytest.approx(
        0.0
    )
    assert least_speed(np.zeros((4, 2)), times) == 0.0


def test_somebody_who_walks_is_reported_from_the_third_scan_on() -> None:
    tracker, counts = PeopleTracker(), []
    for k in range(6):
        ranges = with_leg(with_leg(wall(), 2.4, -1.5 + 0.11 * k), 2.6, -1.4 + 0.11 * k)
        counts.append(len(tracker.step(scan_of(ranges, 0.1 * k), np.zeros(3), 0.1 * k)))
    assert counts[:2] == [0, 0]
    assert counts[3:] == [1, 1, 1]
