"""Work in steps: the allowance is kept, nothing is lost, and the same scans give the same map."""

from __future__ import annotations

import numpy as np
import pytest

from estimation.errors import InputError
from loop_closure.graph.edges import Edge
from loop_closure.graph.marginal import renumbered, without
from loop_closure.graph.pose_graph import SmoothedGraph
from loop_closure.places.features import features_2d
from loop_closure.places.recognizer import PlaceRecognizer
from loop_closure.slam.trajectory import Slam
from loop_closure.work import Allowance, Job, Steps, at_once
from registration import Scan


def counted(costs: list[float], done: list[int]) -> Steps[None]:
    for number, cost in enumerate(costs):
        yield cost
        done.append(number)


def test_steps_are_done_while_there_is_allowance_and_a_large_one_alone() -> None:
    done: list[int] = []
    job = Job(counted([3.0, 3.0, 3.0, 50.0, 1.0], done))
    counts = []
    while not job.done:
        job.go_on(Allowance(8.0))
        counts.append(len(done))
    assert counts == [2, 3, 4, 5]
    again: list[int] = []
    at_once(counted([3.0] * 5, again))
    assert again == done


def scans(count: int) -> tuple[list[Scan], np.ndarray]:
    """Twice round a square room, 0.6 m a scan; odometry that turns a little too far."""
    bearings = np.linspace(-np.pi, np.pi, 181)
    side, around = 6.0, 24.0
    made, poses = [], []
    for k in range(count):
        s = (0.6 * k) % around
        edge, along = int(s // side), s % side
        corner = np.array([(-3.0, -3.0), (3.0, -3.0), (3.0, 3.0), (-3.0, 3.0)][edge])
        yaw = 0.5 * np.pi * edge
        at = corner + along * np.array([np.cos(yaw), np.sin(yaw)])
        c, n = np.cos(bearings + yaw), np.sin(bearings + yaw)
        # A room of 10 x 9 m, and a pillar in the middle of it.
        with np.errstate(divide="ignore"):
            ranges = np.minimum(
                np.where(c > 0, (5.0 - at[0]) / c, (-5.0 - at[0]) / c),
                np.where(n > 0, (4.5 - at[1]) / n, (-4.5 - at[1]) / n),
            )
        b = at[0] * c + at[1] * n
        inside = b**2 - (at @ at - 1.5**2)
        hit = (inside > 0) & (b < 0)
        ranges = np.where(hit, np.minimum(ranges, -b - np.sqrt(np.maximum(inside, 0.0))), ranges)
        made.append(Scan(ranges, -np.pi, 2.0 * np.pi / 180.0, 0.05, 30.0, float(k)))
        poses.append([*at, yaw + 1e-3 * k])
    return made, np.array(poses)


def driven(pace: float | None, thin: bool = False) -> tuple[Slam, list[int], list[int]]:
    slam = Slam(pace=pace, thin=thin, every_scan=True)
    behind, made = [], []
    for scan, pose in zip(*scans(90), strict=True):
        update = slam.process(scan, pose)
        behind.append(update.behind)
        made.append(len(update.closures))
        frames = len(slam.keyframes)
        assert all(0 <= c.earlier < c.later < frames for c in update.closures)
    return slam, behind, made


@pytest.mark.parametrize("thin", [False, True])
def test_a_pace_puts_work_off_and_loses_none(thin: bool) -> None:
    slam, behind, made = driven(3.0, thin)
    whole, none, _ = driven(None, thin)
    assert max(none) == 0
    assert max(behind) > 0
    before = sum(made)
    if slam.behind:
        slam.work()
    estimate, expected = slam.trajectory(), whole.trajectory()
    assert slam.behind == 0
    assert 0 < before <= len(slam.closures) + 60
    assert len(slam.closures) > 0.9 * len(whole.closures) > 10
    assert np.abs(estimate[:, 1:3] - expected[:, 1:3]).max() < 0.02


def test_the_same_scans_at_the_same_pace_give_the_same_map() -> None:
    first, second = driven(1.0), driven(1.0)
    assert first[1:] == second[1:]
    assert np.array_equal(first[0].trajectory(), second[0].trajectory())


def test_a_pace_is_above_nothing() -> None:
    with pytest.raises(InputError, match="pace"):
        Slam(pace=0.0)


def test_a_graph_without_some_nodes_is_smoothed_as_one_made_anew() -> None:
    rng = np.random.default_rng(0)
    graph = SmoothedGraph()
    graph.begin(np.zeros(3))
    for n in range(1, 120):
        step = np.array([0.5, 0.0, 2.0 * np.pi / 40]) + rng.normal(0.0, [0.005, 0.005, 0.002])
        graph.extend(step, np.diag([1e-4, 1e-4, 1e-5]))
        if n > 40 and n % 3 == 0:
            graph.close([Edge(n - 40, n, rng.normal(0.0, 0.005, 3), 1e-3 * np.eye(3), True)])
    gone, count = {15, 50, 51, 77}, len(graph.poses)
    stay = np.isin(np.arange(count), list(gone), invert=True)
    number = np.where(stay, np.cumsum(stay) - 1, -1)
    left = without(graph.edges, gone, count)
    poses, edges = graph.poses[stay], renumbered(left, number)
    other = SmoothedGraph()
    other.restore(poses, renumbered(left, number))
    graph.take_out(number, left, edges)
    assert np.array_equal(graph.poses, poses)
    last = len(poses) - 1
    for one in (graph, other):
        one.extend(np.array([0.5, 0.0, 0.15]), np.diag([1e-4, 1e-4, 1e-5]))
        one.close([Edge(last - 38, last + 1, np.zeros(3), 1e-3 * np.eye(3), True)])
    assert len(graph.poses) == last + 2
    assert np.abs(graph.poses - other.poses).max() < 0.01


def test_places_that_are_kept_are_recognised_as_if_the_others_had_never_been() -> None:
    made, _ = scans(40)
    places = [features_2d(scan, 50.0) for scan in made]
    stay = np.arange(40) % 3 != 0
    whole, fewer = PlaceRecognizer(), PlaceRecognizer()
    for k, place in enumerate(places):
        whole.add(place, float(k))
        if stay[k]:
            fewer.add(place, float(k))
    whole.keep(stay)
    assert len(whole) == len(fewer) == stay.sum()
    assert whole.query(places[7], 5) == fewer.query(places[7], 5)
    assert whole.stamp(3) == fewer.stamp(3)
    whole.add(places[0], 50.0)
    assert len(whole) == len(fewer) + 1
    with pytest.raises(InputError, match="stay"):
        whole.keep(stay)
