"""A lost robot in a map of the first half of a log: found where it was mapped, and nowhere else."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between, compound
from evaluation.experiments.odometry import RAW
from evaluation.report import Report, RunOptions
from evaluation.slam.slam_following import followed
from evaluation.slam.slam_judging import Followed, keyframe_truth, true_poses
from loop_closure.keyframes import Keyframes
from loop_closure.maps.localization import Localizer
from loop_closure.slam.trajectory import Slam
from whereabouts.system.progress import track

Array = NDArray[np.float64]
# Left out of the choice of how long a path has to agree, which was made on fr079.
LOGS = ("freiburg-101-corrected.log.gz", "belgioioso-corrected.log.gz", "mit-csail.clf.bz2")
STARTS, MOST = 12, 10.0  # drives of a log, in its second half, and metres of each
NEAR = 3.0  # metres from a keyframe of the map within which a place is mapped
WRONG = (1.0, 0.3)  # metres and radians
COLUMNS = [
    "log", "drives", "in the map", "found there, % ↑", "after, m ↓", "elsewhere", "believed there", "wrong ↓",
]  # fmt: skip
NOTE = (
    "In the map: at least four fifths of the drive within 3 m of a mapped place; elsewhere: less than a fifth. Found "
    "after: metres of path, mean. Wrong: more than 1 m or 0.3 rad off, by the reference, when a pose is first "
    "confirmed. A local map shows places farther than 3 m from any keyframe, so that a pose may be believed there and "
    "be right."
)


def table(options: RunOptions, report: Report) -> None:
    """Drives that begin without a pose."""
    assert options.data is not None
    folder, rows, samples = options.data / "carmen", [], {}
    for name in track(LOGS[: 2 if options.quick else None], "lost in half a map"):
        log = followed(folder / name, folder / RAW[name] if name in RAW else None, name in RAW)
        half = len(log.records) // 2
        slam = Slam(thin=True, every_scan=True)
        for record, pose, covariance in zip(
            log.records[:half], log.poses[:half], log.covariances[:half], strict=True
        ):
            slam.process(record.scan, pose, covariance)
        slam.finish()
        truth, poses = keyframe_truth(slam, log), slam.graph.poses
        starts = np.linspace(half, 0.97 * len(log.records), STARTS).astype(int).tolist()
        drives = [_driven(slam.keyframes, poses, truth, log, start) for start in starts]
        known = [found for share, found in drives if share >= 0.8]
        elsewhere = [found for share, found in drives if share < 0.2]
        after = [found[0] for found in known if found is not None]
        off = [found for _, found in drives if found is not None and found[1]]
        believed = sum(found is not None for found in elsewhere)
        share = 100.0 * len(after) / max(len(known), 1)
        rows.append([
            name, len(drives), len(known), share if known else "", float(np.mean(after)) if after else "",
            len(elsewhere), believed, len(off),
        ])  # fmt: skip
        samples[name] = len(drives)
    report.add("Lost in half a map", COLUMNS, rows, NOTE, "lost", data="left out", samples=samples)


def _driven(
    places: Keyframes, poses: Array, truth: Array, log: Followed, start: int
) -> tuple[float, tuple[float, bool] | None]:
    """Share of a drive from scan `start` on that is mapped; metres until a pose was confirmed and whether it is wrong.

    poses, truth (N, 3) : of the map's keyframes, in the map and by the reference.
    """
    localizer, path, mapped = Localizer(places, poses), 0.0, []
    found: tuple[float, bool] | None = None
    for k in range(start, len(log.records)):
        path += float(np.hypot(*between(log.poses[k - 1], log.poses[k])[:2])) if k > start else 0.0
        if path > MOST:
            break
        there = true_poses(log, [k])[0]
        away = np.hypot(*(truth[:, :2] - there[:2]).T)
        mapped.append(float(away.min()) < NEAR)
        if found is None and (said := localizer.process(log.records[k].scan, log.poses[k])).sure:
            assert said.pose is not None
            nearest = int(np.argmin(away))
            right = compound(poses[nearest], between(truth[nearest], there))
            off = between(right, said.pose)
            found = path, bool(np.hypot(*off[:2]) > WRONG[0] or abs(off[2]) > WRONG[1])
    return float(np.mean(mapped)), found
