"""Time per keyframe of closing loops: local maps, laying them, uncertainty, smoothing beside the filter.

    python bench/bench_slam.py > bench/bench_slam.txt

Minimum of several runs on one core; simulated floors, no recordings.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from estimation.geometry.poses import between
from estimation.geometry.tiles import TiledGrid
from loop_closure.graph.edges import Edge
from loop_closure.graph.esdf import EsdfGraph
from loop_closure.graph.pose_graph import SmoothedGraph
from loop_closure.graph.uncertainty import Uncertainty
from loop_closure.loop_closure_warm_up import warm_up
from registration.laser.prepared import prepare_scan
from registration.laser.submap import FAR, fuse
from registration.placement.align_submaps import align_submaps
from whereabouts.simulation import Drive, Lidar, random_floor


def best(call: Callable[[], object], repeat: int = 7) -> float:
    """Least milliseconds of `repeat` calls."""
    times = []
    for _ in range(repeat):
        begun = time.perf_counter()
        call()
        times.append(1e3 * (time.perf_counter() - begun))
    return min(times)


def chain(nodes: int, closures: int) -> tuple[list[np.ndarray], list[Edge]]:
    """A drifting path round and round, and closures to the round before."""
    rng = np.random.default_rng(0)
    steps = [
        np.array([0.5, 0.0, 2.0 * np.pi / 200]) + rng.normal(0.0, [0.005, 0.005, 0.002]) for _ in range(nodes)
    ]
    later = rng.choice(np.arange(200, nodes), closures, replace=False)
    return steps, [Edge(int(k) - 200, int(k), np.zeros(3), 1e-3 * np.eye(3), True) for k in later]


def main() -> None:
    warm_up()
    rng = np.random.default_rng(1)
    shapes, _ = random_floor(rng, 3)
    drive = Drive([(2.0, 0.0), (10.0, 0.0)], speed=0.5)
    poses = [drive(t) for t in np.linspace(0.0, drive.duration, 16)]
    for beams in (181, 361, 1081):
        scans = [Lidar(beams).scan(shapes, pose, rng).scan for pose in poses]
        prepared = [prepare_scan(scan, FAR) for scan in scans]
        relative = np.array([between(poses[-1], pose) for pose in poses])
        place = fuse(prepared, relative)
        print(f"{beams} beams")
        print(f"  one scan made ready            {best(lambda s=scans: prepare_scan(s[0], FAR)):8.2f} ms")
        print(f"  local map of 16 scans          {best(lambda g=prepared, r=relative: fuse(g, r)):8.2f} ms")
        for reach, turn in ((0.5, 0.2), (2.0, 0.4), (5.0, 1.0), (4.0, np.pi)):
            spent = best(lambda p=place, r=reach, t=turn: align_submaps(p, p, np.zeros(3), r, t))
            print(f"  laid on another, ±{reach:.1f} m, ±{np.degrees(turn):3.0f}°   {spent:8.2f} ms")
        grid = TiledGrid(0.05)
        points = scans[0].points()
        print(
            f"  scan into the grid             {best(lambda g=grid, p=points: g.integrate(poses[0], p)):8.2f} ms"
        )
    steps, closures = chain(2000, 400)
    for kind in (SmoothedGraph, EsdfGraph):
        graph = kind()
        graph.begin(np.zeros(3))
        for step in steps:
            graph.extend(step, np.diag([1e-4, 1e-4, 1e-5]))
        begun = time.perf_counter()
        graph.close(closures)
        print(
            f"{kind.__name__}: 400 closures of 2000 nodes at once {1e3 * (time.perf_counter() - begun):8.1f} ms"
        )
        uncertainty = Uncertainty()
        uncertainty.learn(graph.edges)
        at = graph.poses
        print(
            f"  uncertainty of all nodes      {best(lambda u=uncertainty, p=at: u.around(p, 1999)):8.2f} ms"
        )


if __name__ == "__main__":
    main()
