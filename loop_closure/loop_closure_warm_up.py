"""Compile what closing loops runs, before the first scan has to wait for it."""

from __future__ import annotations

import numpy as np

from estimation.geometry.tiles import TiledGrid
from loop_closure.graph.pose_graph import Edge, SmoothedGraph
from loop_closure.graph.uncertainty import Uncertainty
from loop_closure.keyframes import Keyframes
from loop_closure.slam.closure_hypotheses import LEAST, ClosureHypotheses, Guess
from loop_closure.slam.likeness import PlaceLikeness
from registration.laser.prepared import prepare_scan
from registration.laser.scan import Scan
from registration.laser.submap import fuse
from registration.placement.align_submaps import align_submaps


def warm_up() -> None:
    """Lay a local map of a simple room on itself; takes a moment once per machine, nothing afterwards."""
    bearings = np.linspace(-1.5, 1.5, 181)
    ranges = np.minimum(
        4.0 / np.maximum(np.cos(bearings), 0.1), 3.0 / np.maximum(np.abs(np.sin(bearings)), 0.1)
    )
    scans = [prepare_scan(Scan(ranges, -1.5, 3.0 / 180.0, 0.05, 30.0))] * 2
    place = fuse(scans, np.array([[0.0, 0.0, 0.0], [0.1, 0.0, 0.0]]))
    align_submaps(place, place, np.zeros(3), 0.5, 0.2)
    align_submaps(place, place, np.zeros(3), 3.0, 0.2)
    TiledGrid(0.1).integrate(np.zeros(3), place.points)
    graph, uncertainty = SmoothedGraph(), Uncertainty()
    graph.begin(np.zeros(3))
    graph.extend(np.array([1.0, 0.0, 0.0]), 0.01 * np.eye(3))
    uncertainty.learn(graph.edges)
    uncertainty.around(graph.poses, 1)
    edge = Edge(0, 1, np.array([1.0, 0.0, 0.0]), 0.01 * np.eye(3), True)
    waiting = ClosureHypotheses()
    for _ in range(LEAST):
        waiting.add(
            Guess(edge, 1.0, 1.0, 0.0), graph.poses, lambda i, j: (np.zeros(len(j)), np.zeros(len(j)))
        )
    waiting.decide(np.array([0.0, 1.0]))
    graph.close([edge])


def warm_up_recognition() -> None:
    """Compile what only robots run that have lost their place; nodes load it when they have."""
    keyframes, likeness = Keyframes(), PlaceLikeness()
    bearings = np.linspace(-1.5, 1.5, 181)
    for k in range(3):
        scan = Scan(4.0 + 0.5 * np.sin((3.0 + k) * bearings), -1.5, 3.0 / 180.0, 0.05, 30.0)
        keyframes.add_scan(scan, np.array([0.6 * k, 0.0, 0.0]), 25.0)
        likeness.of(k, keyframes, 1.0)
