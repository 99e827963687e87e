"""Pairwise, global and spatial registration: success, accuracy, time and honesty beside other libraries.

Simulated rooms (σ = 1 cm), zero initial guess; success is less than 5 cm and 1° off. The pairs are those of
`evaluation.scenes.scan_pairs`: easy up to 0.2 m and 10°, hard up to 0.6 m and 35°, crowded as easy
with 8 moving people and things. Recorded clouds (`scans_3d`) are registered from identity and after a random turn.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from estimation.geometry.poses import wrap_angle
from estimation.metrics.statistics import anees_bounds
from evaluation.registration.registration_data import read_3dtk, read_ply
from evaluation.registration.registration_others import extruded_gicp, kiss_icp, open3d_point_to_plane
from evaluation.registration.registration_pictures import draw_cloud, draw_icp, draw_uncertainty
from evaluation.report import Part, Report, RunOptions, slug
from evaluation.scenes.labelled_pairs import random_labelled_pairs
from evaluation.scenes.scan_pairs import CROWDED, EASY, HARD, Pair, free_pose, random_pair
from registration import Registration, Scan, align, align_globally
from registration.laser.prepared import prepared
from registration.placement.align import agreements, settle
from registration.placement.align_globally import METHODS as GLOBAL
from registration.placement.judgement import judged
from registration.placement.refine import refine
from whereabouts.simulation import Lidar, corridor, random_room
from whereabouts.simulation.robot import relative
from whereabouts.system.progress import track

LIDARS = {
    "361 beams, 360°": Lidar(361, 2.0 * np.pi * 360 / 361),
    "1081 beams, 270°": Lidar(1081, np.deg2rad(270.0)),
}
COMPARED = 60  # pairs of each kind in all that the other methods, most of them slower, are measured on
DIFFICULTIES = {"easy": EASY, "hard": HARD, "movers": CROWDED}
Aligner = Callable[[Scan, Scan], Registration]


@dataclass
class RegistrationTally:
    """Errors of one method on one kind of pair: metres, radians, squares, seconds."""

    away: list[float]
    turn: list[float]
    squares: list[float]
    seconds: list[float]
    converged: list[bool]

    def row(self) -> list[float]:
        away, turn = np.array(self.away), np.array(self.turn)
        good = (away < 0.05) & (turn < np.deg2rad(1.0))
        wrong = np.mean(np.array(self.converged) & ~good)
        return [100.0 * good.mean(), 1e3 * np.median(away), 1e3 * np.median(self.seconds), 100.0 * wrong]


def methods() -> dict[str, Aligner]:
    """Ours, the reference's own methods, and the libraries that are installed."""
    ours: dict[str, Aligner] = {
        "robust": align,
        "robust, no search": lambda source, target: _refined(source, target, False),
        "robust, movers stay": lambda source, target: _refined(source, target, True),
    }
    for name in ("icp", "point_to_line", "ndt"):
        ours[name] = lambda source, target, method=name: align(source, target, method=method)  # type: ignore[misc]
    others = {
        "small_gicp, extruded": extruded_gicp(),
        "KISS-ICP": kiss_icp(),
        "Open3D": open3d_point_to_plane(),
    }
    return ours | {name: aligner for name, aligner in others.items() if aligner is not None}


def _refined(source: Scan, target: Scan, searched: bool) -> Registration:
    """Lines once more from where `align` ends, with all that moved; or from the guess, without it."""
    moving, still = prepared(source), prepared(target)
    begun = align(source, target).transform if searched else np.zeros(3)
    refined = refine(moving.surface, still.target, begun.copy(), 0.15)
    views = agreements(moving, still, refined.pose)
    if not searched:
        refined, views = settle(moving, still, refined, views)
    return judged(moving, still, refined, np.zeros(3), views)


def measure(aligner: Aligner, pairs: list[Pair]) -> RegistrationTally:
    """Errors and times of one method."""
    tally = RegistrationTally([], [], [], [], [])
    aligner(pairs[0].source.scan, pairs[0].target.scan)  # compilation is no part of the time
    for pair in pairs:
        begun = time.perf_counter()
        found = aligner(pair.source.scan, pair.target.scan)
        tally.seconds.append(time.perf_counter() - begun)
        error = found.transform - pair.motion
        error[2] = wrap_angle(error[2])
        tally.away.append(float(np.hypot(error[0], error[1])))
        tally.turn.append(abs(float(error[2])))
        tally.converged.append(found.converged)
        if np.isfinite(found.covariance).all():
            tally.squares.append(float(error @ np.linalg.solve(found.covariance, error)))
    return tally


def _pairs(options: RunOptions, report: Report) -> None:
    count = options.share(400, 40)
    columns = ["method"] + [
        f"{kind}: {what}"
        for kind in DIFFICULTIES
        for what in ("success, % ↑", "median, mm ↓", "median, ms ↓", "accepted but wrong, % ↓")
    ]
    for label, lidar in LIDARS.items():
        rng = np.random.default_rng([options.seed, 0])
        sets = {
            kind: [random_pair(rng, lidar, difficulty) for _ in range(count)]
            for kind, difficulty in DIFFICULTIES.items()
        }
        compared = options.share(COMPARED, COMPARED)
        rows = []
        for name, aligner in track(methods().items(), label):
            row: list[object] = [name]
            for pairs in sets.values():
                row += measure(aligner, pairs if name == "robust" else pairs[:compared]).row()
            rows.append(row)
        covered = np.mean(
            [np.mean(scan.owners > 0) for pair in sets["movers"] for scan in (pair.source, pair.target)]
        )
        note = (
            f"Movers cover {covered:.0%} of the beams. Success: less than 5 cm and 1° off. No search and movers stay: "
            "ours without a stage. icp, point_to_line and ndt are the text's, which prints no figures of them."
        )
        report.add(
            f"Pairwise registration, {label}",
            columns,
            rows,
            note,
            f"pairs-{slug(label)}",
            data="simulated",
            samples={str(row[0]): count if row[0] == "robust" else min(compared, count) for row in rows},
        )


def _honesty(options: RunOptions, report: Report) -> None:
    """NEES in rooms and corridors, and what becomes of scans of different rooms."""
    count = options.share(500, 100)
    rows: list[list[object]] = []
    strange: list[list[object]] = []
    for label, lidar in LIDARS.items():
        rng = np.random.default_rng([options.seed, 1])
        cases: dict[str, tuple[list[Pair], int]] = {
            kind: ([random_pair(rng, lidar, d) for _ in range(count)], 3)
            for kind, d in (("rooms", EASY), ("rooms with movers", CROWDED))
        }
        cases["corridor"] = ([_corridor_pair(rng, lidar) for _ in range(count)], 3)
        for kind, (pairs, dimension) in cases.items():
            mean = float(np.mean(measure(align, pairs).squares)) / dimension
            low, high = (bound / dimension for bound in anees_bounds(count, dimension))
            rows.append([label, kind, mean, f"{low:.2f} to {high:.2f}"])
        strangers = [random_pair(rng, lidar, EASY).target.scan for _ in range(2 * count)]
        believed = np.mean(
            [align(a, b).converged for a, b in zip(strangers[::2], strangers[1::2], strict=True)]
        )
        strange.append([label, 100.0 * float(believed)])
    columns = ["scanner", "data", "NEES per dimension", "95 % of the time within"]
    note = "1 is right. The corridor's motion along it is drawn from the doubt stated for an unknown guess."
    report.add(
        "Are the covariances right?", columns, rows, note, "covariances", data="simulated", samples=count
    )
    report.add(
        "Scans of different rooms", ["scanner", "accepted, % ↓"], strange, "", "strangers",
        data="simulated", samples=count,
    )  # fmt: skip


def _corridor_pair(rng: np.random.Generator, lidar: Lidar) -> Pair:
    """Two scans of an endless corridor; along it, motion is as uncertain as `align` says of a missing guess."""
    first = np.array([0.0, rng.uniform(-0.6, 0.6), rng.uniform(-0.3, 0.3)])
    along = float(np.clip(0.5 * rng.standard_normal(), -2.0, 2.0))
    second = first + np.array([along, rng.uniform(-0.15, 0.15), rng.uniform(-0.15, 0.15)])
    scans = [lidar.scan(corridor(), pose, rng) for pose in (first, second)]
    return Pair(scans[0], scans[1], relative(first, second))


def _globally(options: RunOptions, report: Report) -> None:
    count = options.share(200, 30)
    rows = []
    for label, lidar in LIDARS.items():
        rng = np.random.default_rng([options.seed, 2])
        pairs = []
        for _ in range(count):
            room = random_room(rng)
            poses = [free_pose(room, rng, 2.5) for _ in range(2)]
            target, source = (lidar.scan(room, pose, rng) for pose in poses)
            pairs.append(Pair(target, source, relative(*poses)))
        for method in track(GLOBAL, f"global, {label}"):
            tally = measure(lambda a, b, method=method: align_globally(a, b, method), pairs)  # type: ignore[misc]
            success, _, milliseconds, wrong = tally.row()
            rows.append([label, method, success, 100.0 * np.mean(tally.converged), wrong, milliseconds])
    columns = [
        "scanner",
        "method",
        "success, % ↑",
        "accepted, % ↑",
        "accepted but wrong, % ↓",
        "median, ms ↓",
    ]
    note = (
        "Pairs of places up to 3.5 m from the middle of one room, any direction. Histogram: refined by ICP."
    )
    report.add("Registration without a guess", columns, rows, note, "global", data="simulated", samples=count)


def _spatial(options: RunOptions, report: Report) -> None:
    assert options.data is not None
    folder = options.data / "scans_3d"
    source, target = read_ply(folder / "source.ply"), read_ply(folder / "target.ply")
    truth = np.loadtxt(folder / "T_target_source.txt")
    rows: list[list[object]] = []
    rng = np.random.default_rng(3)
    cases = [("source.ply on target.ply", source, target, truth)]
    scans = [read_3dtk(folder / "3dtk" / f"scan{k:03d}.3d.gz") for k in range(3)]
    for k in (1, 2):
        # Their poses are odometry: what is compared to is the registration from identity.
        reference = align(scans[k], scans[k - 1]).transform
        cases.append(
            (f"3DTK {k} on {k - 1}, to its own result from identity", scans[k], scans[k - 1], reference)
        )
    for name, moving, still, expected in cases:
        runs = [("identity", align(moving, still), expected)]
        for _ in range(1 if options.quick else 5):
            turn = _about_vertical(rng.uniform(-np.pi, np.pi))
            found = align_globally(moving @ turn[:3, :3].T, still)
            runs.append(("globally, turned", found, expected @ turn.T))
        for _ in range(1 if options.quick else 5):
            start = expected @ _nearby(rng)
            runs.append(("ndt, from 0.3 m and 5° away", align(moving, still, start, method="ndt"), expected))
        for how, found, wanted in runs:
            off = np.linalg.inv(wanted) @ found.transform
            angle = np.rad2deg(np.linalg.norm(_skew_part(off)))
            away = 1e3 * float(np.linalg.norm(off[:3, 3]))
            rows.append([name, how, round(away, 3), round(float(angle), 5), found.converged, found.fitness])
    columns = ["clouds", "from", "off, mm ↓", "turned, ° ↓", "accepted", "fitness ↑"]
    report.add("Clouds", columns, rows, "", "clouds", data="left out", samples=1)


def _nearby(rng: np.random.Generator) -> np.ndarray:
    """A motion (4, 4) of 0.3 m and 5° any way."""
    way, axis = (vector / np.linalg.norm(vector) for vector in rng.normal(size=(2, 3)))
    motion = np.eye(4)
    motion[:3, :3] = Rotation.from_rotvec(np.deg2rad(5.0) * axis).as_matrix()
    motion[:3, 3] = 0.3 * way
    return motion


def _about_vertical(yaw: float) -> np.ndarray:
    turn = np.eye(4)
    turn[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    return turn


def _skew_part(motion: np.ndarray) -> np.ndarray:
    """Rotation vector of a small rotation."""
    rotation = motion[:3, :3]
    return 0.5 * np.array(
        [rotation[2, 1] - rotation[1, 2], rotation[0, 2] - rotation[2, 0], rotation[1, 0] - rotation[0, 1]]
    )


def _pictures(options: RunOptions, report: Report) -> None:
    """Figures of chapter 2 of the licentiate thesis, on simulated scans."""
    rng = np.random.default_rng(options.seed)
    (street,) = random_labelled_pairs(rng, "street", 1)
    pair = random_pair(rng, LIDARS["1081 beams, 270°"], EASY)
    report.pictures += [
        draw_uncertainty(options.out),
        draw_cloud(options.out, street.scan_b),
        draw_icp(options.out, pair.source.scan, pair.target.scan),
    ]


PARTS = {
    "pairs": Part(_pairs),
    "covariances": Part(_honesty),
    "without a guess": Part(_globally),
    "clouds": Part(_spatial, random=False, needs=("scans_3d/**/*",)),
    "pictures": Part(_pictures, random=False),
}
