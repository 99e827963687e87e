"""Local maps laid on local maps: right from any direction, silent about other places."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from estimation.geometry.poses import between, wrap_angle
from registration.laser.prepared import prepare_scan
from registration.laser.submap import FAR, Submap, fuse
from registration.placement import align_submaps as submaps
from registration.placement.align_submaps import align_submaps, ambiguous, place
from registration.placement.consistency import judge
from registration.placement.refine import Refined, refine
from whereabouts.simulation import Drive, Lidar, Shapes, box, corridor, joined, random_floor


def local(shapes: Shapes, poses: list[np.ndarray], rng: np.random.Generator) -> Submap:
    """Local map of scans at true poses, anchored at the last."""
    scans = [Lidar(181).scan(shapes, pose, rng).scan for pose in poses]
    return fuse(
        [prepare_scan(scan, FAR) for scan in scans], np.array([between(poses[-1], pose) for pose in poses])
    )


def walk(drive: Drive, start: float, end: float, count: int = 8) -> list[np.ndarray]:
    return [drive(t) for t in np.linspace(start, end, count)]


@pytest.mark.parametrize("turned", [False, True])
def test_the_same_corridor_from_either_end(turned: bool) -> None:
    rng = np.random.default_rng(3)
    right = 0
    for _ in range(16):
        shapes, _ = random_floor(rng, 3)
        there = Drive([(2.0, 0.1), (9.0, 0.1)], speed=0.5)
        back = Drive([(9.0, -0.2), (2.0, -0.2)] if turned else [(2.0, -0.2), (9.0, -0.2)], speed=0.5)
        first = walk(there, 0.0, there.duration)
        second = walk(back, 0.2 * back.duration, back.duration)
        target, source = local(shapes, first, rng), local(shapes, second, rng)
        truth = between(first[-1], second[-1])
        guess = truth + rng.normal(0.0, [0.5, 0.5, 0.1])
        found = align_submaps(source, target, guess, 1.8, 0.4)
        miss = found[0].pose - truth
        right += np.hypot(*miss[:2]) < 0.15
        if found[0].sure and not ambiguous(found):
            assert np.hypot(*miss[:2]) < 0.15
            assert abs(wrap_angle(miss[2])) < 0.04
            assert np.linalg.eigvalsh(found[0].covariance).min() > 0.0
    # From the other end 7 of 10 are right, over 48 floors; the others are not believed.
    assert right >= (10 if turned else 16)


def test_a_bare_corridor_is_not_believed() -> None:
    rng = np.random.default_rng(4)
    drive = Drive([(-4.0, 0.0), (4.0, 0.0)], speed=0.5)
    places = [local(corridor(), walk(drive, 0.0, drive.duration), rng) for _ in range(2)]
    found = align_submaps(places[1], places[0], np.zeros(3), 2.0, 0.3)
    assert not found or not found[0].sure or ambiguous(found)


def test_other_places_are_not_believed() -> None:
    rng = np.random.default_rng(5)
    believed = 0
    for _ in range(12):
        maps = []
        for _ in range(2):
            shapes, _ = random_floor(rng, 3)
            drive = Drive([(2.0, 0.0), (9.0, 0.0)], speed=0.5)
            maps.append(local(shapes, walk(drive, 0.0, drive.duration), rng))
        found = align_submaps(maps[1], maps[0], np.zeros(3), 3.0, np.pi)
        believed += bool(found) and found[0].sure and not ambiguous(found)
    assert believed <= 1


@pytest.mark.parametrize(
    ("changed", "reason"),
    [
        ({}, ""),
        ({"settled": False}, "settle"),
        ({"information": np.diag([30.0 / 0.2**2, 1e6, 1e6])}, "uncertain by 0.20 m"),
    ],
)
def test_what_slides_or_says_little_in_one_direction_is_not_believed(
    monkeypatch: pytest.MonkeyPatch, changed: dict[str, Any], reason: str
) -> None:
    rng = np.random.default_rng(3)
    shapes, _ = random_floor(rng, 3)
    drive = Drive([(2.0, 0.1), (9.0, 0.1)], speed=0.5)
    maps = [local(shapes, walk(drive, 0.0, drive.duration), rng) for _ in range(2)]

    def refined(*given: Any) -> Refined:
        return replace(refine(*given), **changed)

    monkeypatch.setattr(submaps, "refine", refined)
    placement = place(maps[1], maps[0], np.zeros(3), 0.25)
    assert placement.sure == (not reason)
    assert reason in placement.reason


def test_a_wall_in_seen_space_stands_and_what_was_not_seen_is_unknown() -> None:
    rng = np.random.default_rng(6)
    empty, furnished = box(8.0, 6.0), joined([box(8.0, 6.0), box(1.0, 1.0, (1.5, 0.0, 0.0))])
    seen = local(empty, [np.zeros(3)], rng)
    new = local(furnished, [np.zeros(3)], rng)
    verdict = judge(new, seen, np.zeros(3))
    assert verdict.standing > 0.6
    assert verdict.agreeing > 5.0
    assert judge(seen, seen, np.zeros(3)).standing == 0.0
    far = judge(new, seen, np.array([60.0, 0.0, 0.0]))
    assert far.agreeing == 0.0
    assert far.standing == 0.0


def test_too_little_is_no_answer() -> None:
    rng = np.random.default_rng(7)
    nothing = local(Shapes(), [np.zeros(3)], rng)
    assert align_submaps(nothing, nothing, np.zeros(3), 1.0, 0.3) == []
