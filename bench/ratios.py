"""What the libraries cost beside libraries that many use: `python bench/ratios.py` writes `bench/ratios.json`.

Both sides of a pair do the same piece of work by turns in one process, pinned to one core, and each turn gives a
ratio of processor times; median and quartiles of these are kept. `make bench-check` measures again and fails where a
ratio got worse by more than the spread of both. Accuracy is no matter here: `whereabouts experiment peers` has it.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections.abc import Callable, Iterator
from importlib.util import find_spec
from pathlib import Path
from time import process_time

# Before numpy starts its threads: one core is what is measured.
os.environ["OMP_NUM_THREADS"] = os.environ["OPENBLAS_NUM_THREADS"] = "1"
os.environ["NUMBA_NUM_THREADS"] = "1"
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from bench_estimation import murty_by_scipy
from bench_loop_closure import training_pairs
from bench_tracking import scene
from scipy.spatial import cKDTree

from estimation.filters.assignment import k_best
from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.experiments.odometry import simulated_floor
from evaluation.peers.nearest_neighbour import NearestNeighbour
from evaluation.peers.point_to_line import PointToLine, match
from evaluation.peers.stone_soup_phd import StoneSoupPhd
from evaluation.scenes.people_scenes import crowded_room
from evaluation.scenes.scan_pairs import EASY, random_pair
from loop_closure import AdaBoost
from registration import Odometry, align
from tracking import ExtendedTargetPhd, PeopleTracker
from whereabouts.simulation import Lidar

KEPT = Path(__file__).with_suffix(".json")
TURNS = 15
Work = Callable[[], object]
Pair = tuple[str, Work, str, Work]
"""Name, our work, name of the other, its work."""


def pairs() -> Iterator[Pair]:
    """All pairs; each does once what it is measured at."""
    lidar, rng = Lidar(361, 2.0 * np.pi * 360 / 361), np.random.default_rng(0)
    yield of_scans(rng, lidar)
    yield of_odometry(lidar)
    yield from of_clouds(rng)
    yield from of_learning()
    yield from of_targets()
    yield of_people(rng)
    costs = rng.uniform(0.0, 10.0, (20, 20))
    yield (
        "100 best assignments of 20 × 20",
        lambda: k_best(costs, 100),
        "Murty on scipy's assignment",
        lambda: murty_by_scipy(costs, 100),
    )


def of_scans(rng: np.random.Generator, lidar: Lidar) -> Pair:
    """Laying scans on each other."""
    laid = [random_pair(rng, lidar, EASY) for _ in range(20)]
    trees = [cKDTree(pair.target.scan.points()) for pair in laid]
    return (
        "lay a scan of 361 beams on another, 20 pairs",
        lambda: [align(pair.source.scan, pair.target.scan) for pair in laid],
        "trimmed point-to-line ICP on scipy's tree",
        lambda: [
            match(p.source.scan.points(), tree, np.zeros(3)) for p, tree in zip(laid, trees, strict=True)
        ],
    )


def of_odometry(lidar: Lidar) -> Pair:
    """Following a scanner through a floor."""
    records = simulated_floor(0, 3, lidar)[0][:150]

    def followed(odometry: Odometry | PointToLine) -> None:
        for record in records:
            odometry.register(record.scan, record.stamp)

    return (
        "odometry, 150 scans",
        lambda: followed(Odometry()),
        "the same ICP",
        lambda: followed(PointToLine()),
    )


def of_clouds(rng: np.random.Generator) -> Iterator[Pair]:
    """Laying clouds on each other, where small_gicp is installed."""
    cloud = np.column_stack((rng.uniform(-30.0, 30.0, (20_000, 2)), np.zeros(20_000)))
    cloud[::2, 2], cloud[::4, 0] = rng.uniform(0.0, 5.0, 10_000), 12.0
    moved = cloud + np.array([0.1, -0.05, 0.0]) + rng.normal(0.0, 0.01, cloud.shape)
    if find_spec("small_gicp"):
        import small_gicp

        yield (
            "lay a cloud of 20,000 points on another",
            lambda: align(moved, cloud),
            "small_gicp.align, leaves of 0.25 m",
            lambda: small_gicp.align(cloud, moved, num_threads=1),
        )


def of_learning() -> Iterator[Pair]:
    """What boosted classifiers say, of stumps and, where LightGBM is installed, of trees."""
    from sklearn.ensemble import AdaBoostClassifier
    from sklearn.tree import DecisionTreeClassifier

    features, labels = training_pairs(200)
    many = np.tile(features, (25, 1))
    boosted = AdaBoost(rounds=50).fit(features, labels)
    theirs = AdaBoostClassifier(DecisionTreeClassifier(max_depth=1), n_estimators=50).fit(features, labels)
    yield (
        "classify 10,000 pairs of places, 50 stumps",
        lambda: boosted.score(many),
        "scikit-learn's AdaBoost",
        lambda: theirs.decision_function(many),
    )
    if find_spec("lightgbm"):
        import lightgbm

        ours = GradientBoosting(rounds=100, depth=4).fit(features, labels)
        light = lightgbm.LGBMClassifier(n_estimators=100, max_depth=4, num_leaves=16, n_jobs=1, verbose=-1)
        light.fit(features, labels)
        yield (
            "log-odds of 10,000 rows, 100 trees of depth 4",
            lambda: ours.decision(many),
            "LightGBM, one thread",
            lambda: light.booster_.predict(many, raw_score=True),
        )


def of_targets() -> Iterator[Pair]:
    """The extended-target filter, where Stone Soup is installed."""
    config, scans = scene(10, 20, 10, 40, 1000.0)

    def tracked(tracker: ExtendedTargetPhd | StoneSoupPhd) -> None:
        for k, scan in enumerate(scans):
            tracker.step(scan, float(k))

    if find_spec("stonesoup"):
        yield (
            "10 extended targets, 40 scans",
            lambda: tracked(ExtendedTargetPhd(config)),
            "Stone Soup's GM-PHD on DBSCAN clusters",
            lambda: tracked(StoneSoupPhd(config)),
        )


def of_people(rng: np.random.Generator) -> Pair:
    """Following people in scans."""
    room = list(crowded_room(rng, 4, moving=True, duration=5.0).scans(rng))

    def watched(tracker: PeopleTracker | NearestNeighbour) -> None:
        for seen in room:
            tracker.step(seen.scan, seen.pose, seen.scan.stamp)

    return (
        "4 people, 5 s of scans",
        lambda: watched(PeopleTracker()),
        "nearest neighbours on scipy's assignment",
        lambda: watched(NearestNeighbour()),
    )


def measured(ours: Work, theirs: Work, turns: int = TURNS) -> tuple[float, float, float]:
    """Quartiles of our processor time as a share of theirs, over turns."""

    def spent(work: Work) -> float:
        begun = process_time()
        work()
        return process_time() - begun

    spent(ours), spent(theirs)  # what is loaded or compiled first
    ratios = [spent(ours) / max(spent(theirs), 1e-9) for _ in range(turns)]
    low, middle, high = np.quantile(ratios, [0.25, 0.5, 0.75])
    return float(low), float(middle), float(high)


def worse(now: list[float], before: list[float]) -> bool:
    """Whether the median is higher by more than the spread between quartiles of both together."""
    return now[1] - before[1] > (now[2] - now[0]) + (before[2] - before[0])


def main(arguments: list[str] | None = None) -> int:
    """Write the ratios, or hold new ones against those written."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--check", action="store_true", help="compare with ratios.json; exit status 1 if worse"
    )
    parser.add_argument("--turns", type=int, default=TURNS)
    options = parser.parse_args(arguments)
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    before = json.loads(KEPT.read_text(encoding="utf-8")) if options.check else {}
    found, failed = {}, []
    for name, ours, other, theirs in pairs():
        row = [round(value, 4) for value in measured(ours, theirs, options.turns)]
        known = before.get(name, {}).get("quartiles")
        note = "" if known is None else f"  was {known[1]:.3f}"
        if known is not None and worse(row, known):
            failed.append(name)
            note += ": worse"
        print(f"{name:48} {row[1]:7.3f} ({row[0]:.3f} to {row[2]:.3f}) of {other}{note}", flush=True)
        found[name] = {"beside": other, "quartiles": row}
    if not options.check:
        KEPT.write_text(json.dumps(found, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")
    if failed:
        print(f"worse by more than the spread: {'; '.join(failed)}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
