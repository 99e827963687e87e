"""Whole recordings of which some legs are marked, each judged by a shape model that was trained without it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from evaluation.people.people_training import ClusterExamples, examples, marks_of, trained
from evaluation.report import Report, RunOptions
from tracking.people.people_shape import ShapeModel
from tracking.people.people_tracker import PeopleTracker
from whereabouts.logs import open_log
from whereabouts.recorded.people_tracks import track_people
from whereabouts.system.progress import track

Array = NDArray[np.float64]
FOLDER = "people/legs_training"
NAMES = tuple(f"positive_{k}" for k in range(1, 8))
MARKED = (
    f"{FOLDER}/positive_*.bag",
    f"{FOLDER}/negative_2.bag",
    "people/demo_stationary_simple_environment.bag",
    "carmen/fr079.clf.bz2",
    "carmen/intel.clf.bz2",
)
NEAR = 0.75  # metres between a marked leg and the person it is of


@dataclass
class Marked:
    """marks : legs marked. followed : those with a person near. elsewhere : people far from all marks, over `scans`."""

    marks: int = 0
    followed: int = 0
    elsewhere: int = 0
    scans: int = 0


def judge_marks(path: Path, marks: dict[float, Array], tracker: PeopleTracker) -> Marked:
    """Track a whole recording; `marks` (M, 2) by the stamp of their scan, in its frame. Scans without count too."""
    judged = Marked()
    with open_log(path) as log:
        for tracked in track_people(log, tracker=tracker):
            people = np.array([tracked.in_laser(target)[:2] for target in tracked.targets]).reshape(-1, 2)
            legs = marks.get(round(tracked.stamp, 3), np.zeros((0, 2)))
            gaps = np.linalg.norm(legs[:, None] - people[None], axis=2)
            judged.marks += len(legs)
            judged.followed += int(np.sum(gaps.min(axis=1, initial=np.inf) < NEAR))
            judged.elsewhere += int(np.sum(gaps.min(axis=0, initial=np.inf) >= NEAR))
            judged.scans += 1
    return judged


def marked_legs(options: RunOptions, report: Report) -> None:
    """The table: leave one recording out."""
    assert options.data is not None
    folder = options.data / FOLDER
    sources = examples(options.data)
    rows: list[list[object]] = []
    samples: dict[str, int] = {}
    total = Marked()
    for name in track(NAMES[:1] if options.quick else NAMES, "marked legs"):
        twin = folder / f"{name}_extracted.bag"
        marks = {round(scan.stamp, 3): legs for scan, legs in marks_of(twin)} if twin.exists() else {}
        tracker = PeopleTracker()
        tracker.shape = without(sources, twin.stem)
        judged = judge_marks(folder / f"{name}.bag", marks, tracker)
        rows.append([name, *_cells(judged)])
        samples[name] = judged.marks or judged.scans
        for field in vars(total):
            setattr(total, field, getattr(total, field) + getattr(judged, field))
    rows.append(["all", *_cells(total)])
    samples["all"] = total.marks
    note = (
        "People walk about among furniture; the shape model was trained anew without the recording that judges. "
        "Followed: a person within 0.75 m of the mark. Not everybody is marked, in 5 nobody: people elsewhere are "
        "false ones and unmarked ones."
    )
    columns = ["recording", "marked legs followed, % ↑", "people elsewhere, /scan", "marks", "scans"]
    report.add(
        "People walking, one recording left out of the training",
        columns,
        rows,
        note,
        "marked",
        data="left out",
        samples=samples,
    )


def without(sources: list[ClusterExamples], name: str) -> ShapeModel:
    """The shape model of all sources but those of one recording."""
    rest = [item for item in sources if item.source.partition("/")[0] != name]
    return ShapeModel(trained(rest))


def _cells(judged: Marked) -> list[object]:
    share: object = 100.0 * judged.followed / judged.marks if judged.marks else ""
    return [share, judged.elsewhere / max(judged.scans, 1), judged.marks, judged.scans]
