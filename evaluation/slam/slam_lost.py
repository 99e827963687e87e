"""A lost robot in a map of the first half of a log: found where it was mapped, and nowhere else."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound
from evaluation.report import Report, RunOptions
from evaluation.slam.slam_following import followed_log
from evaluation.slam.slam_judging import Followed, keyframe_truth, true_poses
from loop_closure.keyframes import Keyframes
from loop_closure.maps.localization import Localizer
from loop_closure.slam.trajectory import Slam
from whereabouts.logs import ScanRecord
from whereabouts.simulation import Drive, Lidar, random_floor
from whereabouts.system.progress import track

Array = NDArray[np.float64]
# Left out of the choices of how long a path has to agree, and how well, which were made on fr079.
LOGS = ("freiburg-101-corrected.log.gz", "belgioioso-corrected.log.gz", "mit-csail.clf.bz2")
STARTS, MOST = 12, 10.0  # drives of a log, in its second half, and metres of each
NEAR = 3.0  # metres from a keyframe of the map within which a place is mapped
WRONG = (1.0, 0.3)  # metres and radians
SEED, FLOORS = 78, 6  # register 77 was looked at when the localizer was made
COLUMNS = [
    "log", "drives", "in the map", "found there, % ↑", "after, m ↓", "elsewhere", "believed there", "wrong ↓",
    "told wrong, m ↓",
]  # fmt: skip
NOTE = (
    "In the map: at least four fifths of the drive within 3 m of a mapped place; elsewhere: less than a fifth. Found "
    "after: metres of path, mean. Wrong: more than 1 m or 0.3 rad off, by the reference, when a pose is first "
    "confirmed; told wrong: metres of all drives on which such a pose was told. A local map shows places farther than "
    "3 m from any keyframe, so that one may be believed there and be right. Rooms of the simulated floors look alike."
)


@dataclass(frozen=True)
class LostDrive:
    """What became of one. mapped : share of it. found : metres until a pose was confirmed, and whether it was wrong.
    wrong : metres on which a wrong pose was told."""

    mapped: float
    found: tuple[float, bool] | None
    wrong: float


def table(options: RunOptions, report: Report) -> None:
    """Drives that begin without a pose."""
    assert options.data is not None
    folder, drives = options.data / "carmen", {}
    for name in track(LOGS[: 2 if options.quick else None], "lost in half a map"):
        drives[name] = _drives(followed_log(folder, name))
    drives["simulated floors"] = [drive for seed in range(FLOORS) for drive in _drives(_floor(seed))]
    rows = [_row(name, some) for name, some in drives.items()]
    samples = {name: len(some) for name, some in drives.items()}
    report.add("Lost in half a map", COLUMNS, rows, NOTE, "lost", data="left out", samples=samples)


def _row(name: str, drives: list[LostDrive]) -> list[object]:
    known = [drive.found for drive in drives if drive.mapped >= 0.8]
    elsewhere = [drive.found for drive in drives if drive.mapped < 0.2]
    after = [found[0] for found in known if found is not None]
    return [
        name, len(drives), len(known), 100.0 * len(after) / len(known) if known else "",
        float(np.mean(after)) if after else "", len(elsewhere), sum(found is not None for found in elsewhere),
        sum(drive.found is not None and drive.found[1] for drive in drives), sum(drive.wrong for drive in drives),
    ]  # fmt: skip


def _floor(seed: int) -> Followed:
    """A drive through the rooms of a simulated office, which look alike; odometry is the truth."""
    rng = np.random.default_rng([SEED, seed])
    shapes, waypoints = random_floor(rng)
    path, lidar = Drive(waypoints, speed=0.6), Lidar(271, 1.5 * np.pi)
    stamps = np.arange(0.0, path.duration, 0.25).tolist()
    poses = np.array([path(stamp) for stamp in stamps])
    records = [
        ScanRecord(lidar.scan(shapes, pose, rng, stamp).scan, stamp, pose=pose)
        for pose, stamp in zip(poses, stamps, strict=True)
    ]
    covariances = np.broadcast_to(1e-4 * np.eye(3), (len(poses), 3, 3))
    return Followed(records, poses, covariances, poses, 0.0)


def _drives(log: Followed) -> list[LostDrive]:
    """What became of each drive in the second half of a log, in the map of its first."""
    half = len(log.records) // 2
    slam = Slam(thin=True, every_scan=True)
    for record, pose, covariance in zip(
        log.records[:half], log.poses[:half], log.covariances[:half], strict=True
    ):
        slam.process(record.scan, pose, covariance)
    slam.finish()
    truth, poses = keyframe_truth(slam, log), slam.graph.poses
    starts = np.linspace(half, 0.97 * len(log.records), STARTS).astype(int).tolist()
    return [_driven(slam.keyframes, poses, truth, log, start) for start in starts]


def _driven(places: Keyframes, poses: Array, truth: Array, log: Followed, start: int) -> LostDrive:
    """A drive from scan `start` on.

    poses, truth (N, 3) : of the map's keyframes, in the map and by the reference.
    """
    localizer, path, mapped = Localizer(places, poses), 0.0, []
    found: tuple[float, bool] | None = None
    wrong = 0.0
    for k in range(start, len(log.records)):
        step = float(np.hypot(*between(log.poses[k - 1], log.poses[k])[:2])) if k > start else 0.0
        path += step
        if path > MOST:
            break
        there = true_poses(log, [k])[0]
        away = np.hypot(*(truth[:, :2] - there[:2]).T)
        mapped.append(float(away.min()) < NEAR)
        said = localizer.process(log.records[k].scan, log.poses[k])
        if said.pose is not None:
            nearest = int(np.argmin(away))
            off = between(compound(poses[nearest], between(truth[nearest], there)), said.pose)
            far = bool(np.hypot(*off[:2]) > WRONG[0] or abs(off[2]) > WRONG[1])
            wrong += far * step
            found = (path, far) if found is None and said.sure else found
    return LostDrive(float(np.mean(mapped)), found, wrong)
