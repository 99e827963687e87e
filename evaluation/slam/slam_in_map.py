"""A robot in a saved map of clouds: found without a pose and from a said one, and not where it is not."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from evaluation.report import Report, RunOptions
from evaluation.scenes.outdoor import (
    Neighbourhood,
    SpinningLidar,
    random_neighbourhood,
    round_trip,
)
from loop_closure.keyframes import Keyframes
from loop_closure.maps.localization import Localizer
from loop_closure.slam.trajectory import Slam
from whereabouts.system.progress import track

Array = NDArray[np.float64]
PLACES = 5  # over all seeds
MAPPED = 120  # clouds of the map, along 124 m
STARTS = (10, 70)  # clouds at which the drives begin
LENGTH = 12  # clouds of each, a metre apart
LIDAR = SpinningLidar()
BACK = np.diag([-1.0, -1.0, 1.0, 1.0])  # turned round on the spot


def table(options: RunOptions, report: Report) -> None:
    """Drives beside the mapped way, back along it, from a pose that is off, and in another neighbourhood."""
    if options.quick:
        return
    outcomes: dict[str, list[tuple[float, float, int]]] = {}
    for place in track(range(options.share(PLACES, PLACES)), "neighbourhoods"):
        rng = np.random.default_rng([options.seed, 1, place])
        here, elsewhere, way = random_neighbourhood(rng), random_neighbourhood(rng), round_trip()
        slam = Slam()
        for k, odometry in enumerate(drifting(way[:MAPPED], rng)):
            slam.process(LIDAR.cloud(here, way[k], rng), odometry, None, 0.5 * k)
        slam.finish()
        places, poses = slam.keyframes, way[0] @ slam.graph.poses
        for start in STARTS:
            ahead = way[start : start + LENGTH]
            kinds = {
                "1.5 m beside the way": (here, _beside(ahead, 1.5), False),
                "1 m beside it, the other way": (here, _beside(ahead, -1.0)[::-1] @ BACK, False),
                "from a pose 0.8 m and 0.2 rad off": (here, _beside(ahead, 0.7), True),
                "another neighbourhood": (elsewhere, ahead, False),
                "another neighbourhood, a pose given": (elsewhere, ahead, True),
            }  # fmt: skip
            for name, (world, drive, said) in kinds.items():
                outcomes.setdefault(name, []).append(driven(places, poses, world, drive, said, rng))
    rows: list[list[object]] = []
    for name, found in outcomes.items():
        after, worst, sure = (np.array(column) for column in zip(*found, strict=True))
        known = np.isfinite(after)
        rows.append(
            [
                name,
                100.0 * float(known.mean()),
                float(after[known].max()) if known.any() else "",
                float(worst[known].max()) if known.any() else "",
                int(sure.sum()),
            ]
        )
    columns = [
        "drive",
        "confirmed, %",
        "confirmed after at most, m ↓",
        "largest error from then on, m ↓",
        "clouds confirmed",
    ]
    note = "A map of 120 clouds along 124 m; drives of 12 clouds. Nothing is to be confirmed in another neighbourhood."
    report.add(
        "In a saved map of clouds",
        columns,
        rows,
        note,
        "in-a-map",
        data="simulated",
        samples=len(STARTS) * options.share(PLACES, PLACES),
    )


def driven(
    places: Keyframes, poses: Array, world: Neighbourhood, way: Array, said: bool, rng: np.random.Generator
) -> tuple[float, float, int]:
    """Metres until a pose was confirmed (inf: never), the greatest error from then on, and clouds that confirmed it."""
    localizer = Localizer(places, poses)
    if said:
        heading = float(np.arctan2(way[0, 1, 0], way[0, 0, 0]))
        localizer.place([way[0, 0, 3] + 0.6, way[0, 1, 3] - 0.5, heading + 0.2])
    after, worst, sure, path = np.inf, 0.0, 0, 0.0
    for k, odometry in enumerate(drifting(way, rng)):
        path += float(np.linalg.norm(way[k, :3, 3] - way[k - 1, :3, 3])) if k else 0.0
        outcome = localizer.process(LIDAR.cloud(world, way[k], rng), odometry)
        sure += outcome.sure
        if outcome.sure and not np.isfinite(after):
            after = path
        if np.isfinite(after):
            off = np.inf if outcome.pose is None else np.linalg.norm(outcome.pose[:3, 3] - way[k, :3, 3])
            worst = max(worst, float(off))
    return after, worst, sure


def drifting(way: Array, rng: np.random.Generator) -> list[Array]:
    """Odometry (4, 4) along a way: every step off by a centimetre and a milliradian; it begins at its own origin."""
    made = [np.eye(4)]
    for k in range(1, len(way)):
        off = np.eye(4)
        off[:3, :3] = Rotation.from_rotvec(0.001 * rng.standard_normal(3)).as_matrix()
        off[:3, 3] = 0.01 * rng.standard_normal(3)
        made.append(made[-1] @ np.linalg.inv(way[k - 1]) @ way[k] @ off)
    return made


def _beside(way: Array, metres: float) -> Array:
    moved = way.copy()
    moved[:, :3, 3] += metres * way[:, :3, 1]
    return moved
