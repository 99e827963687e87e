"""The measures by which trackers of people are compared, against perfect and spoilt trackers and brute force."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest

from evaluation.peers.nearest_neighbour import NearestNeighbour, detections
from evaluation.people.people_sensitivity import NUMBERS
from evaluation.people.people_yardsticks import Yardstick, best_identities, matched, measure
from evaluation.scenes.occlusion_scenes import one_hardly_moves
from evaluation.scenes.people_scenes import PeopleScene, empty_floor
from tracking.mixture.target import Target
from whereabouts.simulation.shapes import box
from whereabouts.simulation.walkers import Build, SimulatedWalker


def _target(label: int, spot: np.ndarray) -> Target:
    return Target(label, np.array([*spot, 0.0, 0.0]), np.eye(4), 1.0, np.eye(2), 1.0)


class _Knowing:
    """Tells the truth, less `without`, with labels changed at scan `swap` and a phantom at a place."""

    def __init__(
        self, scene: PeopleScene, without: int = -1, swap: int = 10**9, phantom: object = None
    ) -> None:
        self.scene, self.without, self.swap, self.phantom = scene, without, swap, phantom
        self.count = 0

    def step(self, scan: object, pose: object, stamp: float) -> list[Target]:
        shift = 100 if self.count >= self.swap else 0
        self.count += 1
        found = [
            _target(k + shift, person.position(stamp))
            for k, person in enumerate(self.scene.people)
            if k != self.without
        ]
        return found if self.phantom is None else [*found, _target(999, np.array(self.phantom))]


def _scene() -> PeopleScene:
    walkers = [
        SimulatedWalker(np.array([[2.0, -1.5], [2.0, 1.5]]), 1.0),
        SimulatedWalker(np.array([[4.0, 1.0], [4.0, -1.0]]), 1.0),
        SimulatedWalker(np.array([[3.0, 2.0]])),
    ]
    return PeopleScene(box(12.0, 10.0), walkers, 4.0)


def _measured(**spoilt: object) -> Yardstick:
    scene = _scene()
    return measure(scene, np.random.default_rng(0), _Knowing(scene, **spoilt), everybody=True)  # type: ignore[arg-type]


def test_a_tracker_that_tells_the_truth_has_no_errors() -> None:
    marks = _measured()
    assert (marks.recall, marks.mota, marks.idf1) == (1.0, 1.0, 1.0)
    assert max(marks.ospa) == max(marks.ospa_all) == 0.0
    assert marks.scans == 41
    assert marks.there.tolist() == [82.0, 41.0]


def test_who_is_missing_is_missed_by_kind_and_a_phantom_counts_where_the_floor_is_open() -> None:
    marks = _measured(without=2)
    assert (marks.found / marks.there).tolist() == [1.0, 0.0]
    assert marks.mota == pytest.approx(2.0 / 3.0)
    # One of three is missing at c = 1 m and p = 2.
    assert marks.ospa[0] == pytest.approx(np.sqrt(1.0 / 3.0))
    marks = _measured(phantom=(1.0, -3.0))
    assert (marks.false, marks.false_open) == (41, 41)
    assert marks.mota == pytest.approx(2.0 / 3.0)
    marks = _measured(phantom=(5.9, 0.0))
    assert (marks.false, marks.false_open, marks.mota) == (41, 0, 1.0)


def test_labels_that_change_cost_switches_and_identity() -> None:
    marks = _measured(swap=20)
    assert marks.switches == 3
    assert marks.recall == 1.0
    assert marks.idf1 == pytest.approx(21.0 / 41.0)


def test_identities_are_those_of_the_best_assignment() -> None:
    rng = np.random.default_rng(1)
    for _ in range(20):
        table = rng.integers(0, 20, (3, 4))
        together = {(p, t): int(table[p, t]) for p in range(3) for t in range(4) if table[p, t]}
        best = max(sum(table[p, t] for p, t in enumerate(order)) for order in permutations(range(4), 3))
        assert best_identities(together) == best


def test_a_pair_stays_while_it_can_even_if_another_one_is_nearer() -> None:
    gaps = np.array([[0.5, 0.1]])
    assert matched(gaps, [7, 8], {}) == {0: 1}
    assert matched(gaps, [7, 8], {0: 7}) == {0: 0}
    assert matched(np.array([[0.9, 0.1]]), [7, 8], {0: 7}) == {0: 1}


def test_the_plain_tracker_finds_a_trunk_and_keeps_its_label() -> None:
    scene = _scene()
    rng = np.random.default_rng(3)
    tracker = NearestNeighbour()
    trunk = replace(scene.people[0], build=Build("trunk"))
    marks = measure(PeopleScene(scene.room, [trunk], 4.0), rng, tracker)
    assert marks.recall > 0.85
    assert marks.switches == 0
    assert not len(detections(next(iter(PeopleScene(scene.room, [], 0.0).scans(rng))).scan))


def test_nobody_is_on_an_empty_floor_and_the_one_goes_less_than_half_a_metre_among_people_who_hide() -> None:
    rng = np.random.default_rng(5)
    scene = empty_floor(rng, duration=1.0)
    assert not scene.people
    assert len(scene.things.circles)
    scene = one_hardly_moves(rng)
    ways = [np.linalg.norm(person.position(20.0) - person.position(0.0)) for person in scene.people]
    assert ways[3] == pytest.approx(0.4)
    assert scene.standing.tolist() == [False, False, False, True]
    scans = list(scene.scans(rng))
    assert sum(int((scan.in_view & (scan.returns == 0)).sum()) for scan in scans) >= 3


def test_every_number_of_the_sensitivity_table_is_there() -> None:
    missing = [f"{module.__name__}.{name}" for module, name in NUMBERS if not hasattr(module, name)]
    assert missing == []
