"""Pairs of scans that one moving box fills in part: whether the background's motion is told, refused or wrong."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from evaluation.report import Report, RunOptions
from evaluation.scenes.labelled_pairs import SICK, LabelledPair, labelled
from evaluation.scenes.streets import SCENES
from registration.crf import JointModel
from whereabouts.simulation.lidar import Lidar
from whereabouts.simulation.movers import Mover
from whereabouts.system.progress import track

LIDARS = (SICK, Lidar(541, np.deg2rad(270.0)), Lidar(361, 2.0 * np.pi * 360 / 361))
SHARES = (0.2, 0.35, 0.5, 0.65, 1.0)  # of the returns, the upper ends of the rows
INTERVAL = 0.4  # seconds
WRONG, WRONG_TURN = 0.1, 0.05  # metres and radians off the truth from which a confident motion is wrong


def filled(options: RunOptions, report: Report) -> None:
    """Add the table."""
    model = JointModel.load()
    count = options.share(30, 10)
    answers = np.zeros((len(SHARES), 3), dtype=np.int64)
    for place in track(range(count), "filled scans"):
        for pair in _pairs(options.seed, place):
            share = float(np.mean(pair.moving[pair.valid]))
            estimate = model.infer(pair.scan_a, pair.scan_b)
            away = estimate.motions[0] - pair.motions[0]
            off = bool(np.hypot(*away[:2]) > WRONG or abs(away[2]) > WRONG_TURN)
            answers[np.searchsorted(SHARES, share), 1 + off if estimate.converged else 0] += 1
    rows: list[list[object]] = []
    low = 0.0
    for high, (refused, right, wrong) in zip(SHARES, answers.tolist(), strict=True):
        rows.append([f"{100.0 * low:.0f} to {100.0 * high:.0f} % of the beams", right, refused, wrong])
        low = high
    note = (
        f"A box moves 0.3 to 1 m away in streets, halls and offices. The columns count pairs. Wrong: accepted, but off "
        f"by more than {WRONG} m or {WRONG_TURN} rad."
    )
    report.add(
        "One box fills the scan",
        ["filled", "right ↑", "refused ↓", "wrong ↓"],
        rows,
        note,
        "filled",
        data="simulated",
        samples=int(answers.sum()),
    )


def _pairs(seed: int, number: int) -> Iterator[LabelledPair]:
    """One place of every kind, seen by every scanner, standing and moving."""
    for scene in ("office", "hall", "street"):
        rng = np.random.default_rng([seed, 10, number, len(scene)])
        place = SCENES[scene](rng)
        pose = np.array([*rng.uniform(-1.0, 1.0, 2), rng.uniform(-np.pi, np.pi)])
        bearing = pose[2] + rng.uniform(-0.7, 0.7)
        at = pose[:2] + rng.uniform(0.6, 1.3) * np.array([np.cos(bearing), np.sin(bearing)])
        if min(place.distance(at), place.distance(pose[:2])) < 0.5:
            continue
        course = rng.uniform(-np.pi, np.pi)
        velocity = rng.uniform(0.3, 1.2) * np.array([np.cos(course), np.sin(course)])
        start = np.array([*at, bearing + 0.5 * np.pi])
        thing = Mover("box", start, velocity, rng.uniform(-0.3, 0.3), rng.uniform(0.8, 3.0), width=0.5)
        for lidar in LIDARS:
            for second in (pose, pose + rng.uniform(-0.1, 0.1, 3)):
                yield labelled(place, [thing], (pose, second), (0.0, INTERVAL), lidar, rng)
