"""Recordings of two model cars: per-beam truth from motion capture, and moving beams from pairs and windows."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.geometry.poses import between
from evaluation.crf.crf_metrics import f1_of
from evaluation.report import Report, RunOptions
from registration import Odometry, Scan, align
from registration.crf import JointModel
from registration.crf.window import partners, segment
from whereabouts.system.progress import track

Array = NDArray[np.float64]
BACK, FRONT, ASIDE = (
    0.17,
    0.60,
    0.22,
)  # metres around the other car's marker, its outline and the 6 % of scale
MOVES = 0.15  # m/s from which the other car moves


@dataclass(frozen=True, eq=False)
class Recorded:
    """Scans of one recording, their sensor poses (M, 3) by odometry and which beams move, one (N,) per scan."""

    name: str
    scans: list[Scan]
    stamps: Array
    poses: Array
    moving: list[NDArray[np.bool_]]


def read_recording(path: Path) -> Recorded:
    """A bag of `moving_objects` with truth: beams within the other car's outline while it drives."""
    from whereabouts.logs import MessageRecord, ScanRecord, open_log

    ego: list[Array] = []
    other: list[Array] = []
    scans: list[Scan] = []
    with open_log(path, topics=("scan", "ego_pose", "red_pose")) as log:
        for record in log:
            if isinstance(record, ScanRecord):
                scans.append(record.scan)
            elif isinstance(record, MessageRecord):
                (ego if record.topic == "ego_pose" else other).append(_stamped_pose(record))
    track_ego, track_other = np.array(ego), np.array(other)
    for poses in (track_ego, track_other):
        poses[:, 3] = np.unwrap(poses[:, 3])
    odometry = Odometry()
    poses = np.array([odometry.register(scan, scan.stamp) for scan in scans])
    moving = [_moving(scan, track_ego, track_other) for scan in scans]
    return Recorded(path.stem, scans, np.array([scan.stamp for scan in scans]), poses, moving)


def _stamped_pose(record: object) -> Array:
    message = record.message  # type: ignore[attr-defined]
    q, p = message.pose.orientation, message.pose.position
    yaw = np.arctan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y * q.y + q.z * q.z))
    return np.array([record.stamp, p.x, p.y, yaw])  # type: ignore[attr-defined]


def _at(poses: Array, stamp: float) -> Array:
    return np.array([np.interp(stamp, poses[:, 0], poses[:, k]) for k in (1, 2, 3)])


def _moving(scan: Scan, ego: Array, other: Array) -> NDArray[np.bool_]:
    """(N,) beams on the other car, all False while it stands."""
    seen = between(_at(ego, scan.stamp), _at(other, scan.stamp))
    ends = _at(other, scan.stamp + 0.15)[:2] - _at(other, scan.stamp - 0.15)[:2]
    moving = np.zeros(len(scan), dtype=bool)
    if np.hypot(*ends) / 0.3 > MOVES:
        points = scan.points() - seen[:2]
        c, s = np.cos(seen[2]), np.sin(seen[2])
        along, aside = points @ np.array([c, s]), points @ np.array([-s, c])
        moving[scan.valid] = (along > -BACK) & (along < FRONT) & (np.abs(aside) < ASIDE)
    return moving


def recordings(options: RunOptions, report: Report) -> None:
    """Add the table of the recordings."""
    assert options.data is not None
    model = JointModel.load()
    rows: list[list[object]] = []
    samples: dict[str, int] = {}
    step = 4 if options.quick else 1
    pooled: dict[str, Array] = {}
    for path in sorted((options.data / "moving_objects").glob("*.bag")):
        recorded = read_recording(path)
        samples[recorded.name] = len(range(0, len(recorded.scans), step))
        for how, counts in (
            ("pair 0.6 s on", _pairs(recorded, model, 0.6, step, False)),
            ("pair 0.8 s on", _pairs(recorded, model, 0.8, step, False)),
            ("pair, odometry, 0.6 s back", _pairs(recorded, model, -0.6, step, True)),
            ("window", _window(recorded, model, step)),
        ):
            rows.append([recorded.name, how, *f1_of([tuple(counts)])])
            pooled[how] = pooled.get(how, np.zeros(3)) + counts
    rows += [["both", how, *f1_of([tuple(counts)])] for how, counts in pooled.items()]
    note = (
        "Truth is from motion capture. No recording was used in training, but the windows of scans and what the trees "
        "look at were chosen on these two."
    )
    report.add(
        "Moving beams, recordings",
        ["recording", "from", "F1 ↑", "precision ↑", "recall ↑"],
        rows,
        note,
        "recordings",
        data="tuned on",
        samples=samples,
    )


def _pairs(recorded: Recorded, model: JointModel, interval: float, step: int, known: bool) -> Array:
    """Counts over all scans, each compared with the one `interval` seconds on; `known` motion by odometry."""
    total = np.zeros(3)
    for index in range(0, len(recorded.scans), step):
        for other in partners(recorded.stamps, recorded.poses, index, (interval,)):
            scan, target = recorded.scans[index], recorded.scans[other]
            registration = None
            if known:
                guess = between(recorded.poses[other], recorded.poses[index])
                found = align(scan, target, guess)
                registration = found if found.converged else None
            total += _counts(recorded.moving[index], model.infer(scan, target, registration).moving)
    return total


def _window(recorded: Recorded, model: JointModel, step: int) -> Array:
    total = np.zeros(3)
    for index in track(range(0, len(recorded.scans), step), recorded.name):
        labels = segment(model, recorded.scans, recorded.stamps, recorded.poses, index)
        total += _counts(recorded.moving[index], labels > 0)
    return total


def _counts(truth: NDArray[np.bool_], said: NDArray[np.bool_]) -> Array:
    return np.array([np.sum(truth & said), np.sum(~truth & said), np.sum(truth & ~said)], dtype=np.float64)
