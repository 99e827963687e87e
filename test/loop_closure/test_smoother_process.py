"""Smoothing in a process of its own: the same answers, and none the fewer when it is killed."""

import os
import signal
from collections.abc import Iterator

import numpy as np
import pytest

from loop_closure.graph.edges import Edge
from loop_closure.graph.pose_graph import SmoothedGraph
from loop_closure.graph.smoother_process import FORGET, RemoteSmoother, SmootherProcess


@pytest.fixture
def aside() -> Iterator[SmootherProcess]:
    process = SmootherProcess()
    yield process
    process.end()


def drive(graph: SmoothedGraph, nodes: int = 90) -> None:
    rng = np.random.default_rng(3)
    graph.begin(np.zeros(3))
    for n in range(1, nodes):
        step = np.array([0.5, 0.0, 2.0 * np.pi / 40]) + rng.normal(0.0, [0.01, 0.01, 0.004])
        graph.extend(step, np.diag([1e-4, 1e-4, 1e-5]))
        if n > 40 and n % 7 == 0:
            graph.close([Edge(n - 40, n, rng.normal(0.0, 0.005, 3), 1e-3 * np.eye(3), True)])


def test_poses_are_those_of_smoothing_in_this_process_to_the_last_digit(aside: SmootherProcess) -> None:
    here, there, other = SmoothedGraph(), SmoothedGraph(aside), SmoothedGraph(aside)
    drive(here)
    drive(other, 50)
    drive(there)
    assert np.array_equal(here.poses, there.poses)
    for graph in (here, there):
        graph.settle({60})
        graph.extend(np.array([0.5, 0.0, 0.15]), np.diag([1e-4, 1e-4, 1e-5]))
        graph.close([Edge(50, 90, np.zeros(3), 1e-3 * np.eye(3), True)])
    assert np.array_equal(here.poses, there.poses)
    assert aside.alive


@pytest.mark.parametrize("when", ["before it begins", "on the way"])
def test_one_that_is_killed_is_done_without(aside: SmootherProcess, when: str) -> None:
    here, there = SmoothedGraph(), SmoothedGraph(aside)
    drive(here)
    if when == "on the way":
        drive(there)
    os.kill(aside.pid, signal.SIGKILL)
    os.waitid(os.P_PID, aside.pid, os.WEXITED | os.WNOWAIT)
    if when == "on the way":
        there.extend(np.array([0.5, 0.0, 0.15]), np.diag([1e-4, 1e-4, 1e-5]))
        there.close([Edge(50, 90, np.zeros(3), 1e-3 * np.eye(3), True)])
        here.extend(np.array([0.5, 0.0, 0.15]), np.diag([1e-4, 1e-4, 1e-5]))
        here.close([Edge(50, 90, np.zeros(3), 1e-3 * np.eye(3), True)])
    else:
        drive(there)
    assert not aside.alive
    assert np.abs(here.poses - there.poses).max() < 0.02
    assert not isinstance(there._smoother, RemoteSmoother)


def test_what_a_smoother_cannot_solve_is_said_with_the_next_answer(aside: SmootherProcess) -> None:
    from estimation.errors import InputError

    poses = np.zeros((3, 3))
    with pytest.raises(InputError, match="do not determine"):
        SmoothedGraph(aside).restore(poses, [Edge(1, 2, np.zeros(3), 1e-3 * np.eye(3))])
    graph = SmoothedGraph(aside)
    drive(graph, 50)
    assert np.isfinite(graph.poses).all()


def test_it_ends_with_those_who_give_orders() -> None:
    process = SmootherProcess()
    process.end()
    assert not process.alive
    with pytest.raises(ProcessLookupError):
        os.kill(process.pid, 0)


def test_smoothers_that_nobody_holds_any_more_are_forgotten(
    aside: SmootherProcess, monkeypatch: pytest.MonkeyPatch
) -> None:
    tell = aside.tell
    forgotten: list[int] = []

    def listen(smoother: int, order: str, *given: object) -> None:
        if order == FORGET:
            forgotten.append(smoother)
        tell(smoother, order, *given)

    monkeypatch.setattr(aside, "tell", listen)
    graph = SmoothedGraph(aside)
    drive(graph, 50)
    assert forgotten == []
    graph.settle()
    assert forgotten == [1]
    drive(graph, 60)
    assert forgotten == [1, 2]
    assert aside.alive
