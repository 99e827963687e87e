"""Scenes by which any tracker of people can be measured: recall, phantoms, identity and OSPA, side by side.

A robot that drives among people of whom some stand; people who hide each other on an empty floor; places in which there
is nobody. A tracker is whatever has `step(scan, pose, stamp)`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from estimation.metrics.statistics import ospa
from evaluation.peers.nearest_neighbour import NearestNeighbour
from evaluation.people.people_judging import RETURNS
from evaluation.scenes.people_scenes import PeopleScene
from registration.laser.scan import Scan
from tracking.mixture.target import Target
from tracking.people.people_tracker import PeopleTracker
from whereabouts.logs import open_log
from whereabouts.recorded.people_tracks import track_people

Array = npt.NDArray[np.float64]
NEAR = 0.75  # m between a person and its estimate
OPEN = (
    0.3  # m from walls and large furniture, whose corners may look like legs; thin things stand at open floor
)
FARTHEST = 10.0  # m, of people who have to be found: as far as the trackers look
SETTLED = 10  # scans after which the number of people can be known


class Tracker(Protocol):
    """Whatever follows people."""

    def step(self, scan: Scan, pose: npt.ArrayLike, stamp: float) -> Sequence[Target]:
        """People after a scan, in the frame of the poses."""


TRACKERS: dict[str, Callable[[], Any]] = {
    "people tracker": PeopleTracker,
    "plain nearest neighbour": NearestNeighbour,
}


@dataclass
class Yardstick:
    """What a tracker made of some scenes; add up over scenes with `+`.

    there, found (2,) : people expected and found over all scans, of those who walk and of those who stand.
    false, false_open : people told of who are not there, anywhere and at open floor. told : all told of, less those who
    are right though not expected, and less false ones off the open floor. switches : of labels. kept : scans on which a
    person has the label that is his for the whole scene (IDTP). ospa, ospa_all : m, per scan, of people and of targets
    of any class. scans : how many.
    """

    there: Array = field(default_factory=lambda: np.zeros(2))
    found: Array = field(default_factory=lambda: np.zeros(2))
    false: int = 0
    false_open: int = 0
    told: int = 0
    switches: int = 0
    kept: int = 0
    ospa: list[float] = field(default_factory=list)
    ospa_all: list[float] = field(default_factory=list)
    scans: int = 0

    def __add__(self, other: Yardstick) -> Yardstick:
        return Yardstick(*(getattr(self, name) + getattr(other, name) for name in vars(self)))

    @property
    def recall(self) -> float:
        """Share of the expected who were found."""
        return float(self.found.sum() / max(self.there.sum(), 1.0))

    @property
    def mota(self) -> float:
        """1 less misses, false ones at open floor and switches, by the expected (Bernardin, Stiefelhagen 2008)."""
        missed = self.there.sum() - self.found.sum()
        return float(1.0 - (missed + self.false_open + self.switches) / max(self.there.sum(), 1.0))

    @property
    def idf1(self) -> float:
        """2 IDTP / (expected + told) (Ristani and others 2016)."""
        return float(2.0 * self.kept / max(self.there.sum() + self.told, 1.0))


def measure(
    scene: PeopleScene, rng: np.random.Generator, tracker: Tracker, everybody: bool = False
) -> Yardstick:
    """Track a scene.

    Expected are people up to 10 m away with three returns in the scan; with `everybody` all in the scanner's range and
    opening, hidden or not. Others are no error, found or not.
    """
    marks = Yardstick()
    standing = scene.standing.astype(np.int64)
    last: dict[int, int] = {}
    carried: dict[int, int] = {}
    together: dict[tuple[int, int], int] = {}
    for scan in scene.scans(rng):
        targets = tracker.step(scan.scan, scan.pose, scan.scan.stamp)
        within = np.linalg.norm(scan.people - scan.pose[:2], axis=1) < FARTHEST
        expected = within & (scan.in_view if everybody else scan.returns >= RETURNS)
        spots = np.array([target.mean[:2] for target in targets]).reshape(-1, 2)
        names = [int(target.label) for target in targets]
        gaps = np.linalg.norm(scan.people[:, None] - spots[None], axis=2).reshape(
            len(scan.people), len(spots)
        )
        pairs = matched(gaps, names, last)
        excused = np.array(
            [any(k == t and not expected[p] for p, k in pairs.items()) for t in range(len(spots))]
        )
        last.update({person: names[t] for person, t in pairs.items()})
        for person in np.flatnonzero(expected).tolist():
            marks.there[standing[person]] += 1
            if person in pairs:
                marks.found[standing[person]] += 1
                label = names[pairs[person]]
                marks.switches += int(carried.get(person, label) != label)
                carried[person] = label
            for t in np.flatnonzero(gaps[person] < NEAR).tolist():
                together[person, names[t]] = together.get((person, names[t]), 0) + 1
        wrong = [t for t in range(len(spots)) if t not in pairs.values()]
        at_open = sum(scene.room.distance(spots[t]) > OPEN for t in wrong)
        marks.false += len(wrong)
        marks.false_open += at_open
        marks.told += len(spots) - int(excused.sum()) - (len(wrong) - at_open)
        if marks.scans >= SETTLED:
            people = scan.people[expected]
            marks.ospa.append(ospa(spots[~excused.astype(bool)], people, 1.0, 2.0))
            every = getattr(tracker, "targets", targets)
            places = np.array([target.mean[:2] for target in every]).reshape(-1, 2)
            marks.ospa_all.append(ospa(places, people, 1.0, 2.0))
        marks.scans += 1
    marks.kept = best_identities(together)
    return marks


def matched(gaps: Array, names: list[int], last: dict[int, int]) -> dict[int, int]:
    """Column of the target of each person by `gaps` (P, T), m; a pair of the scan before stays one while it can."""
    cost = np.where(gaps < NEAR, gaps, 1e3)
    for person, label in last.items():
        if label in names and cost[person, names.index(label)] < NEAR:
            # A pair that goes on comes before any number of new ones.
            cost[person, names.index(label)] -= 1e2
    rows, columns = linear_sum_assignment(cost)
    return {int(p): int(t) for p, t in zip(rows, columns, strict=True) if cost[p, t] < NEAR}


def best_identities(together: dict[tuple[int, int], int]) -> int:
    """Most scans on which persons can have labels if each has one for good; scans by (person, label)."""
    if not together:
        return 0
    people, labels = (sorted({key[k] for key in together}) for k in range(2))
    table = np.zeros((len(people), len(labels)))
    for (person, label), count in together.items():
        table[people.index(person), labels.index(label)] = count
    return int(table[linear_sum_assignment(-table)].sum())


def nobody_there(scene: PeopleScene, rng: np.random.Generator, tracker: Tracker) -> list[int]:
    """People told of per scan of a scene without people."""
    return [len(tracker.step(scan.scan, scan.pose, scan.scan.stamp)) for scan in scene.scans(rng)]


def nobody_recorded(
    path: Path,
    tracker: PeopleTracker,
    others: dict[str, Tracker],
    topic: str | None = None,
    most: int | None = None,
) -> dict[str, float]:
    """People told of per scan of a recording: by `tracker` as "", and by others, which are given the same poses."""
    told: dict[str, list[int]] = {name: [] for name in ("", *others)}
    with open_log(path) as log:
        for count, tracked in enumerate(track_people(log, topic=topic, tracker=tracker)):
            if most is not None and count >= most:
                break
            told[""].append(len(tracked.targets))
            for name, other in others.items():
                told[name].append(len(other.step(tracked.scan, tracked.pose, tracked.stamp)))
    return {name: float(np.mean(counts)) for name, counts in told.items()}
