"""A plain way to close loops, as a peer: proximity search, small_gicp on single scans, gtsam.

Each keyframe is laid on the nearest earlier one that looks the same way. What GICP explains is believed. Odometry, the
distance between keyframes and the back end are ours.
"""

from __future__ import annotations

import time

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound, wrap_angle
from evaluation.slam.slam_as_node import Driven
from evaluation.slam.slam_direct import Direct
from evaluation.slam.slam_judging import Closed, Followed
from loop_closure.graph.edges import Edge
from loop_closure.graph.pose_graph import SmoothedGraph

Array = NDArray[np.float64]
KIND = "proximity search, small_gicp, gtsam"
STEP, TURN = 0.5, 0.5  # metres and radians between keyframes
NEAR, APART = 2.0, 20.0  # metres to an earlier keyframe, and of path since
ALIKE = np.deg2rad(45.0)
MEASURED = np.diag([0.05**2, 0.05**2, 0.02**2])  # covariance of a step of odometry, and of a closure


def driven(log: Followed) -> Driven:
    """A log with its loops closed that way."""
    begun = time.perf_counter()
    direct, graph = Direct([record.scan for record in log.records]), SmoothedGraph()
    kept, paths, closures = [0], [0.0], []
    graph.begin(log.poses[0])
    at = np.zeros(len(log.poses), dtype=np.int64)
    for number in range(1, len(log.poses)):
        step = between(log.poses[kept[-1]], log.poses[number])
        if np.hypot(step[0], step[1]) >= STEP or abs(step[2]) >= TURN:
            kept.append(number)
            paths.append(paths[-1] + float(np.hypot(step[0], step[1])))
            graph.extend(step, MEASURED)
            closures += _close(graph, direct, kept, paths)
        at[number] = len(kept) - 1
    graph.settle()
    offsets = between(log.poses[np.array(kept)[at]], log.poses)
    estimate = np.asarray(compound(graph.poses[at], offsets))
    return Driven(estimate, kept, paths, closures, len(kept), time.perf_counter() - begun + log.seconds)


def _close(graph: SmoothedGraph, direct: Direct, kept: list[int], paths: list[float]) -> list[Closed]:
    """The closure of the newest keyframe, if it has one."""
    poses, k = graph.poses, len(kept) - 1
    away = np.hypot(*(poses[:k, :2] - poses[k, :2]).T)
    alike = np.abs(wrap_angle(poses[:k, 2] - poses[k, 2])) < ALIKE
    there = np.flatnonzero((away < NEAR) & alike & (np.array(paths[:k]) < paths[k] - APART))
    if not len(there):
        return []
    j = int(there[np.argmin(away[there])])
    found = direct.relative(kept[j], kept[k], [between(poses[j], poses[k])])
    if found is None:
        return []
    graph.close([Edge(j, k, found, MEASURED, True)])
    return [(kept[j], kept[k], found)]
