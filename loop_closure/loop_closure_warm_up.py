"""Compile what closing loops runs, before the first scan has to wait for it."""

from __future__ import annotations

import numpy as np

from estimation.geometry.tiles import TiledGrid
from loop_closure.graph.edges import Edge
from loop_closure.graph.pose_graph import SmoothedGraph
from loop_closure.graph.uncertainty import Uncertainty
from loop_closure.keyframes import Keyframes
from loop_closure.slam.closure_hypotheses import LEAST, ClosureHypotheses, Guess
from loop_closure.slam.likeness import PlaceLikeness
from registration.laser.prepared import prepare_scan
from registration.laser.submap import CELL, fuse
from registration.placement.align_submaps import align_submaps
from registration.registration_warm_up import room_scan


def warm_up() -> None:
    """Lay a local map of a simple room on itself; takes a moment once per machine, nothing afterwards."""
    scan = prepare_scan(room_scan(0.0))
    place = fuse([scan, scan], np.zeros((2, 3)))
    align_submaps(place, place, np.zeros(3), 0.5, 0.5)
    align_submaps(place, place, np.zeros(3), 3.0, 0.5)
    TiledGrid(CELL).integrate(np.zeros(3), place.points)
    graph, uncertainty = SmoothedGraph(), Uncertainty()
    graph.begin(np.zeros(3))
    graph.extend(np.array([1.0, 0.0, 0.0]), np.eye(3))
    uncertainty.learn(graph.edges)
    uncertainty.around(graph.poses, 1)
    edge = Edge(0, 1, np.array([1.0, 0.0, 0.0]), np.eye(3), True)
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
    for k in range(3):
        keyframes.add_scan(room_scan(float(k)), np.array([float(k), 0.0, 0.0]), np.inf)
        likeness.of(k, keyframes, 1.0)
