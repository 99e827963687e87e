"""Speed and quality beside other libraries in the same run: small_gicp, KISS-ICP, KISS-SLAM, and others.

Repetitions are interleaved, ours and theirs in turn, in processor time, so that what else a machine does meets both;
the ratio is the median over the repetitions. A library that is not installed is left out, and the report says so
(`python compat/bootstrap.py evaluation` installs all of them). Speeds of one machine are figures of that machine.
"""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from functools import partial
from importlib.util import find_spec
from typing import Any

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between
from estimation.learning.boosting import AdaBoost
from estimation.learning.gradient_boosting import GradientBoosting
from estimation.metrics.statistics import absolute_trajectory_error, ospa
from evaluation.experiments.odometry import simulated_floor
from evaluation.peers.kiss_slam_peer import installed, kiss_slam
from evaluation.peers.stone_soup_phd import StoneSoupPhd
from evaluation.phd.phd_recorded import config_of
from evaluation.phd.target_scores import positions
from evaluation.registration.registration_data import read_ply
from evaluation.report import Part, Report, RunOptions
from evaluation.scenes.outdoor import SpinningLidar, random_neighbourhood, round_trip
from evaluation.scenes.scan_pairs import free_pose
from loop_closure import features_2d, pair_features
from loop_closure.slam.trajectory import Slam
from registration import Odometry, OdometryConfig, align
from tracking import ExtendedTargetPhd
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.rooms import random_room

Array = NDArray[np.float64]
ROUND = "200 clouds along 206 m. Local maps of KISS-SLAM are 100 m long by default: there are few to close loops with."
COLUMNS = ["what", "ours, ms ↓", "peer, ms", "peer's time over ours, × ↑"]
NOISY_LABELS = 0.05
"""Share of labels that are turned round, so that no stump separates the classes."""


def in_turn(ours: Callable[[], object], theirs: Callable[[], object], rounds: int) -> list[float]:
    """Milliseconds of ours, of theirs, and the ratio: medians over interleaved rounds."""
    ours(), theirs()
    taken = np.array([[_milliseconds(each) for each in (ours, theirs)] for _ in range(rounds)])
    return [*np.median(taken, axis=0).tolist(), float(np.median(taken[:, 1] / taken[:, 0]))]


def _milliseconds(function: Callable[[], object]) -> float:
    begun = time.process_time()
    function()
    return 1e3 * (time.process_time() - begun)


def _clouds(options: RunOptions, report: Report) -> None:
    """The two recorded clouds with a known transform."""
    import small_gicp

    assert options.data is not None
    folder = options.data / "scans_3d"
    source, target = read_ply(folder / "source.ply"), read_ply(folder / "target.ply")
    truth = np.loadtxt(folder / "T_target_source.txt")

    def theirs() -> Array:
        return np.asarray(small_gicp.align(target, source, registration_type="GICP").T_target_source)

    def off(found: Array) -> float:
        return 1e3 * float(np.linalg.norm((np.linalg.inv(truth) @ found)[:3, 3]))

    numbers = in_turn(lambda: align(source, target), theirs, options.share(25, 4))
    rows = [["two clouds, GICP of small_gicp", *numbers, off(align(source, target).transform), off(theirs())]]
    _add(
        report,
        "Clouds: off the true transform, mm",
        "clouds",
        rows,
        "left out",
        "Ours refines by small_gicp too.",
        options.share(25, 4),
    )


def _scans(options: RunOptions, report: Report) -> None:
    """Odometry of a simulated floor from the same scans and wheels."""
    records, truth = simulated_floor(options.seed, 3, Lidar(361))
    records, truth = records[: options.share(3000, 1000)], truth[: options.share(3000, 1000)]
    wheels = np.array([record.odometry for record in records])
    steps: list[Array | None] = [None, *map(between, wheels[:-1], wheels[1:])]

    def follow(method: str) -> tuple[Array, float]:
        odometry, poses = Odometry(OdometryConfig(scan_method=method)), []
        begun = time.process_time()
        for k, record in enumerate(records):
            poses.append(odometry.register(record.scan, record.stamp, steps[k]))
        return np.array(poses), 1e3 * (time.process_time() - begun) / len(records)

    times = {name: [follow(name)[1] for _ in range(2)] for name in ("local_map", "kiss_icp")}
    errors = {
        name: 1e3 * absolute_trajectory_error(follow(name)[0][:, :2], truth[:, :2]).rmse for name in times
    }
    least = [min(times[name]) for name in ("local_map", "kiss_icp")]
    rows = [
        ["scan to odometry, KISS-ICP", *least, least[1] / least[0], errors["local_map"], errors["kiss_icp"]]
    ]
    _add(report, "Odometry of planar scans: ATE, mm", "scans", rows, "simulated", "", len(records))


def _clouds_around(options: RunOptions, report: Report) -> None:
    """A simulated outdoor round, closed at its end."""
    if not installed():
        report.notes.append(
            "KISS-SLAM is not installed, or cannot be imported: left out; `make peers` installs it"
        )
        return
    rng = np.random.default_rng([options.seed, 12])
    world, poses, lidar = random_neighbourhood(rng), round_trip(), SpinningLidar()
    clouds = [lidar.cloud(world, pose, rng) for pose in poses]
    truth = (np.linalg.inv(poses[0]) @ poses)[:, :3, 3]
    odometry, slam = Odometry(), Slam()
    begun = time.process_time()
    for number, cloud in enumerate(clouds):
        slam.process(cloud, odometry.register(cloud, 0.5 * number), odometry.covariance, 0.5 * number)
    ours = slam.trajectory()[:, 1:4]
    taken = [1e3 * (time.process_time() - begun) / len(clouds)]
    theirs, seconds, closures = kiss_slam(clouds)
    taken.append(1e3 * seconds / len(clouds))
    errors = [absolute_trajectory_error(each, truth).rmse for each in (ours, theirs[:, :3, 3])]
    row = ["clouds to map, KISS-SLAM", *taken, taken[1] / taken[0], *errors, len(slam.closures), closures]
    columns = [*COLUMNS, "ours: ATE, m ↓", "peer: ATE, m ↓", "ours: closures", "peer: closures"]
    report.add("A round of clouds", columns, [row], ROUND, "round", data="simulated", samples=len(clouds))


def _places(seed: int, count: int) -> tuple[Array, Array]:
    """Pair features (2 count, 44) of rooms seen twice and of different rooms, with labels of which some are wrong."""
    rng, lidar = np.random.default_rng([seed, 11]), Lidar(361)
    seen = []
    for _ in range(count):
        room = random_room(rng)
        pose = free_pose(room, rng, 2.5)
        near = pose + np.array([*rng.normal(0.0, 0.3, 2), rng.normal(0.0, 0.3)])
        seen.append([features_2d(lidar.scan(room, at, rng).scan, 30.0) for at in (pose, near)])
    same = [pair_features(a, b) for a, b in seen]
    other = [pair_features(a, seen[(k + 1) % count][1]) for k, (a, _) in enumerate(seen)]
    labels = np.repeat([1, 0], count)
    return np.array(same + other), np.where(rng.random(2 * count) < NOISY_LABELS, 1 - labels, labels)


def _classifiers(options: RunOptions, report: Report) -> None:
    """Learning and scoring pairs of places; quality is the share of held-out pairs told right."""
    count = options.share(2000, 600)
    (F, y), (G, z) = _places(options.seed, count), _places(options.seed + 1000, count)
    many = np.tile(G, (max(20_000 // len(G), 1), 1))
    rounds = options.share(50, 15)

    def right(scores: Array) -> float:
        return 100.0 * float(np.mean((scores > 0.5) == (z == 1)))

    rows: list[list[object]] = []
    for name, ours, theirs in _learners(options.seed):
        learn = in_turn(partial(ours.fit, F, y), partial(theirs.fit, F, y), rounds)
        score = in_turn(partial(ours.score, many), partial(theirs.predict_proba, many), rounds)
        quality = [right(ours.score(G)), right(theirs.predict_proba(G)[:, 1])]
        rows.append([f"learn {len(F)} pairs, {name}", *learn, *quality])
        rows.append([f"score {len(many)} pairs, {name}", *score, *quality])
    note = f"Times are medians over {rounds} rounds."
    _add(
        report, "Classifiers: held-out pairs told right, % ↑", "classifiers", rows, "simulated", note, len(G)
    )


def _learners(seed: int) -> list[tuple[str, AdaBoost | GradientBoosting, Any]]:
    found: list[tuple[str, AdaBoost | GradientBoosting, Any]] = []
    if find_spec("sklearn"):
        from sklearn.ensemble import AdaBoostClassifier
        from sklearn.tree import DecisionTreeClassifier

        stumps = AdaBoostClassifier(DecisionTreeClassifier(max_depth=1), n_estimators=50, random_state=seed)
        found.append(("AdaBoost of scikit-learn", AdaBoost(50), stumps))
    if find_spec("lightgbm"):
        from lightgbm import LGBMClassifier

        trees = LGBMClassifier(
            n_estimators=150, max_depth=3, num_leaves=8, learning_rate=0.1, subsample=0.7, subsample_freq=1,
            colsample_bytree=0.6, random_state=seed, n_jobs=1, verbose=-1,
        )  # fmt: skip
        found.append(("trees of LightGBM", GradientBoosting(150, 3, seed=seed), trees))
    return found


def _targets(options: RunOptions, report: Report) -> None:
    """Recorded scans of extended targets, other realisations for each seed."""
    assert options.data is not None
    rows: list[list[object]] = []
    scans: dict[str, int] = {}
    for scene in ("cross_spawn", "parallel", "six", "six_pd09"):
        with np.load(options.data / "extended_targets" / f"{scene}.npz") as data:
            truth, returns, given = data["truth"], data["meas"], json.loads(str(data["params"]))
        chosen = np.unique(returns[:, 0])[2 * options.seed % 10 :][: options.share(10, 5)]
        errors: tuple[list[float], list[float]] = ([], [])
        times: tuple[list[float], list[float]] = ([], [])
        for realisation in chosen:
            mine = returns[returns[:, 0] == realisation]
            filters: tuple[Any, Any] = (ExtendedTargetPhd(config_of(given)), StoneSoupPhd(config_of(given)))
            for k in range(1, given["K"] + 1):
                for which, filter_ in enumerate(filters):
                    begun = time.process_time()
                    found = filter_.step(mine[mine[:, 1] == k, 2:4], k * given["T"])
                    times[which].append(1e3 * (time.process_time() - begun))
                    spots = found if isinstance(found, np.ndarray) else positions(found)
                    true = truth[truth[:, 0] == k, 2:4]
                    errors[which].append(ospa(spots, true, given["ospa_c"], given["ospa_p"]))
        ratio = float(np.median(np.array(times[1]) / np.array(times[0])))
        means = [float(np.median(each)) for each in times] + [float(np.mean(each)) for each in errors]
        rows.append([f"{scene}, Stone Soup", *means[:2], ratio, *means[2:]])
        scans[f"{scene}, Stone Soup"] = len(times[0])
    _add(
        report,
        "Extended targets: OSPA, m",
        "targets",
        rows,
        "left out",
        "Stone Soup: GM-PHD on clusters of DBSCAN.",
        scans,
    )


def _add(
    report: Report,
    title: str,
    name: str,
    rows: list[list[object]],
    data: str,
    note: str,
    samples: int | Mapping[str, int],
) -> None:
    quality = title.partition(": ")[2]
    columns = [*COLUMNS, f"ours: {quality}", f"peer: {quality}"]
    report.add(title.partition(":")[0], columns, rows, note, name, data=data, samples=samples)


def _installed(
    module: str, part: Callable[[RunOptions, Report], None]
) -> Callable[[RunOptions, Report], None]:
    """The part, or a note where the library is not here."""

    def run(options: RunOptions, report: Report) -> None:
        if find_spec(module):
            part(options, report)
        else:
            report.notes.append(f"{module} is not installed: left out")

    return run


PARTS = {
    "clouds": Part(_installed("small_gicp", _clouds), quick_seeds=2, needs=("scans_3d/*.ply",)),
    "scans": Part(_installed("kiss_icp", _scans)),
    "round of clouds": Part(_clouds_around, quick_seeds=1),
    "classifiers": Part(_classifiers),
    "targets": Part(_installed("stonesoup", _targets), needs=("extended_targets/*.npz",)),
}
