"""Closures that wait: which group wins, and what speaks against it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from estimation.geometry.poses import between, compound, inverse, pose_to_matrix
from loop_closure.graph.edges import Edge
from loop_closure.graph.uncertainty import Uncertainty, apart
from loop_closure.keyframes import Keyframes
from loop_closure.slam.closure_hypotheses import MOST, ClosureHypotheses, Guess, consistent
from registration import Scan

FAR = 30  # keyframes, 1 m apart, of a straight path that is driven twice
PATHS = np.arange(2.0 * FAR)
POSES = np.array([[float(k % FAR), 0.1 * (k // FAR), 0.0] for k in range(2 * FAR)])


def near(i: int, j: np.ndarray) -> tuple[float, float]:
    """Along the path all is known to centimetres."""
    return 0.03, 0.01


def guess(k: int, shift: float, merit: float = 20.0, missed: float = 0.1) -> Guess:
    """Keyframe `k` of the second round lies on that of the first, `shift` metres along the path."""
    edge = Edge(k, k + FAR, np.array([shift, 0.0, 0.0]), 1e-3 * np.eye(3), True)
    return Guess(edge, merit, 0.97, 0.0, 1.0, True, missed)


def waiting(guesses: list[Guess], spread=near) -> ClosureHypotheses:
    hypotheses = ClosureHypotheses()
    for item in guesses:
        hypotheses.add(item, POSES, spread)
    return hypotheses


def test_a_group_along_the_path_wins_and_then_nothing_waits() -> None:
    hypotheses = waiting([guess(k, 0.0) for k in range(8)])
    assert [g.edge.a for g in hypotheses.decide(PATHS)] == list(range(8))
    assert hypotheses.waiting == []


def test_too_short_a_path_decides_nothing() -> None:
    assert waiting([guess(k, 0.0) for k in range(4)]).decide(PATHS) == []


def test_pairs_far_apart_prove_nothing_to_each_other() -> None:
    """Two keyframes at either end of fifteen metres of path agree with each other within what odometry drifts."""
    assert waiting([guess(k, 0.0) for k in (0, 1, 16, 17)]).decide(PATHS) == []
    found = waiting([guess(k, 0.0) for k in (0, 1, 2, 14, 15, 16, 28)]).decide(PATHS)
    assert [g.edge.a for g in found] == [0, 1, 2, 14, 15, 16]


def test_a_few_beyond_a_guessed_step_are_not_believed_along_with_the_rest() -> None:
    group = [guess(k, 0.0) for k in range(11)]
    parts = (np.arange(2 * FAR) >= FAR + 8).astype(np.int64)
    assert [g.edge.a for g in waiting(group).decide(PATHS, parts=parts)] == list(range(8))
    assert [g.edge.a for g in waiting(group).decide(PATHS)] == list(range(11))
    torn = np.arange(2 * FAR) // 3
    assert waiting(group).decide(PATHS, parts=torn) == []


def test_what_waited_for_too_long_is_named() -> None:
    long = np.arange(2.0 * FAR) * 10.0
    hypotheses = waiting([guess(k, 0.0) for k in range(4)])
    assert hypotheses.keys == {FAR, FAR + 1, FAR + 2, FAR + 3}
    assert hypotheses.forget(long, FAR + 8) == {FAR, FAR + 1}
    assert hypotheses.keys == {FAR + 2, FAR + 3}


def test_where_only_looks_led_it_takes_more() -> None:
    some = [guess(k, 0.0) for k in range(12)]
    assert waiting(some).decide(PATHS, farthest=2.0)
    assert waiting(some).decide(PATHS, farthest=0.5) == []
    assert waiting([guess(k, 0.0) for k in range(22)]).decide(PATHS, farthest=0.5)


@pytest.mark.parametrize(
    ("rivals", "missed", "wins"),
    [(3, 5.0, True), (3, 0.1, False), (1, 0.1, True), (7, 5.0, False)],
)
def test_a_rival_that_agrees_with_odometry_takes_less(rivals: int, missed: float, wins: bool) -> None:
    """A shift by one door against what odometry says, of which fewer closures were found."""
    best = [guess(k, 4.8, missed=4.8) for k in range(8)]
    others = [guess(k, 0.0, merit=15.0, missed=missed) for k in range(rivals)]
    assert bool(waiting(best + others).decide(PATHS)) == wins


@pytest.mark.parametrize(("shift", "wins"), [(0.1, True), (4.8, False)])
def test_what_puts_the_path_at_the_same_place_is_no_rival(shift: float, wins: bool) -> None:
    """Two earlier passes that nothing has tied together: what one says of the third the other may say as well."""

    def untied(i: int, j: np.ndarray) -> tuple[np.ndarray, float]:
        return np.where(i // FAR != j // FAR, 2.0, 0.03), 0.01

    paths = np.arange(3.0 * FAR)
    poses = np.array([[float(k % FAR), 0.1 * (k // FAR), 0.0] for k in range(3 * FAR)])
    hypotheses = ClosureHypotheses()
    for k in range(8):
        for earlier, along, merit in ((k, 0.0, 20.0), (k + FAR, shift, 18.0)):
            motion = between(poses[earlier], poses[k + 2 * FAR]) + np.array([along, 0.0, 0.0])
            edge = Edge(earlier, k + 2 * FAR, motion, 1e-3 * np.eye(3), True)
            hypotheses.add(Guess(edge, merit, 0.97, 0.0, 1.0, True, 0.1), poses, untied)
    assert hypotheses.decide(paths) == []
    found = hypotheses.decide(paths, poses=poses)
    assert [g.edge.a for g in found] == (list(range(8)) if wins else [])


def test_what_the_estimate_forbids_cannot_win_but_speaks_against_others() -> None:
    outside = [replace(guess(k, 4.8), expected=False) for k in range(8)]
    assert waiting(outside).decide(PATHS) == []
    assert waiting([*outside, *(guess(k, 0.0, merit=18.0) for k in range(8))]).decide(PATHS) == []


def test_nothing_agrees_across_a_step_that_nobody_knows() -> None:
    def torn(i: int, j: np.ndarray) -> tuple[np.ndarray, float]:
        return np.where((i % FAR < 4) != (j % FAR < 4), 2.0, 0.03), 0.01

    assert waiting([guess(k, 0.0) for k in range(8)], torn).decide(PATHS) == []


def test_guessed_steps_add_up_between_keyframes() -> None:
    keyframes = Keyframes()
    for k in range(6):
        keyframes.add_scan(Scan(np.full(90, 3.0), -1.5, 3.0 / 90.0), np.array([float(k), 0.0, 0.0]), 25.0)
        if k in (2, 4):
            keyframes.break_off(0.3 if k == 2 else 0.4)
    assert keyframes.slack(0, 1) == 0.0
    assert keyframes.slack(1, 2) == pytest.approx(0.3)
    assert keyframes.slack(5, 0) == pytest.approx(0.5)
    np.testing.assert_allclose(keyframes.slack(1, [0, 2, 5]), [0.0, 0.3, 0.5])
    assert set(keyframes.breaks) == {2, 4}
    assert keyframes.window(3, 10.0, 10.0) == (2, 3)


def test_closures_tie_together_what_a_guessed_step_left_open() -> None:
    """Two rounds with a guessed step between: a third round may lie on both at once only after they were closed."""
    keyframes, uncertainty = Keyframes(), Uncertainty()
    tight, loose = 1e-4 * np.eye(3), np.diag([4.0, 4.0, 1e-4])
    edges = []
    for k in range(2 * FAR):
        keyframes.add_scan(Scan(np.full(90, 3.0), -1.5, 3.0 / 90.0), POSES[k], 25.0, float(k))
        if k:
            step = between(POSES[k - 1], POSES[k])
            edges.append(Edge(k - 1, k, step, loose if k == FAR else tight))
    keyframes.breaks[FAR] = 2.0
    others = np.array([6, FAR + 4, FAR + 6])
    uncertainty.learn(edges)
    before, _ = apart(keyframes, uncertainty, POSES, 5, others)
    assert before[0] < 0.1
    np.testing.assert_allclose(before[1:], 2.0, atol=0.1)
    edges.append(Edge(5, FAR + 5, between(POSES[5], POSES[FAR + 5]), tight, True))
    uncertainty.learn(edges)
    after, _ = apart(keyframes, uncertainty, POSES, 5, others)
    assert after[0] == before[0]
    # By way of the closure and one step: two edges of a centimetre; what the path itself adds is up to 0.33 m.
    assert after[1:].max() < 0.35


def test_many_keyframes_on_the_spot_do_not_push_out_the_path_before_them() -> None:
    """Ten closures of each keyframe that say the same: of too many the weightiest of each stay."""
    hypotheses = ClosureHypotheses()
    for k in range(FAR):
        for step in range(10):
            a = max(k - step, 0)
            edge = Edge(a, k + FAR, np.array([float(k - a), 0.0, 0.0]), 1e-3 * np.eye(3), True)
            hypotheses.add(Guess(edge, 20.0 - step, 0.97, 0.0, 15.0), POSES, near)
        hypotheses.forget(PATHS, k + FAR)
    assert len(hypotheses.waiting) <= MOST
    assert {guess.edge.b for guess in hypotheses.waiting} == set(range(FAR, 2 * FAR))
    assert len({guess.edge.b for guess in hypotheses.decide(PATHS)}) == FAR


def test_agreement_of_many_is_that_of_each_composed_by_hand() -> None:
    rng = np.random.default_rng(0)
    poses = np.cumsum(rng.normal(0.0, [0.5, 0.5, 0.2], (40, 3)), axis=0)
    edges = []
    for _ in range(60):
        a, b = (int(k) for k in np.sort(rng.choice(40, 2, replace=False)))
        edges.append(Edge(a, b, between(poses[a], poses[b]) + rng.normal(0.0, [0.2, 0.2, 0.05]), np.eye(3)))
    first = edges[0]
    expected = []
    for other in edges:
        # By `first`, along the later path and back over `other`, against along the earlier path.
        way = compound(compound(first.motion, between(poses[first.b], poses[other.b])), inverse(other.motion))
        miss = between(between(poses[first.a], poses[other.a]), way)
        far = 0.02 * np.linalg.norm(poses[other.b, :2] - poses[first.b, :2])
        expected.append(
            np.hypot(*miss[:2]) < 0.2 + 2.5 * np.hypot(0.03, 0.03) + far
            and abs(miss[2]) < 0.06 + 2.5 * np.hypot(0.01, 0.01)
        )
    assert 3 < sum(expected) < 57
    assert consistent(first, edges, poses, near).tolist() == expected
    matrices = pose_to_matrix(np.column_stack([poses[:, :2], np.zeros((40, 3)), poses[:, 2]]))
    spatial = [
        replace(e, motion=pose_to_matrix(np.array([*e.motion[:2], 0.0, 0.0, 0.0, e.motion[2]])))
        for e in edges
    ]
    assert consistent(spatial[0], spatial, matrices, near).tolist() == expected
