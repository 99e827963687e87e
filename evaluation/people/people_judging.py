"""How tracks of people are judged: by recorded labels, by the truth of simulated scenes, by their absence."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from estimation.geometry.poses import compound
from estimation.metrics.statistics import ospa
from evaluation.scenes.people_scenes import PeopleScene
from tracking.mixture.components import Components
from tracking.mixture.phd_models import Sight
from tracking.people.cluster_model import ScanDetection
from tracking.people.people_tracker import PeopleTracker, Person
from whereabouts.logs import Log, MessageRecord, Record, ScanRecord, open_log
from whereabouts.recorded.people_tracks import track_people
from whereabouts.simulation.home.apartment_day import LASER_MOUNT, SCAN_RATE, ApartmentDay

Array = NDArray[np.float64]
GATE = 0.75  # metres between a label and the person it is of
NEAR = 1.0  # metres between a simulated person and its estimate
FORGIVEN = 3.0  # seconds after which nobody can know where a hidden person is
SEEN_FOR, RETURNS = (
    1.5,
    3,
)  # seconds in plain view, and returns of a scan that make it so, after which one is known


SCENE = ["error, m ↓", "missed, /scan ↓", "false, /scan ↓", "label changes ↓", "hidden and kept, % ↑"]


class Constant(PeopleTracker):
    """The tracker with a constant detection probability: it knows nothing of occlusion."""

    def _detection(self) -> ScanDetection:
        return _Always(self.config.detection_probability, self.config.max_range)


class _Always(ScanDetection):
    """Nothing is ever in the way."""

    def in_scene(
        self, components: Components, weights: Array, tracks: int, sensor_pose: Array | None
    ) -> Sight:
        return Sight.plain(self(components.means, sensor_pose), components)


@dataclass
class PeopleJudgement:
    """labelled : scans with a label. tracked : those in which the person was. changes : of its label.

    false : people who are not there, over all labelled scans.
    """

    labelled: int = 0
    tracked: int = 0
    changes: int = 0
    false: int = 0

    @property
    def share(self) -> float:
        return self.tracked / max(self.labelled, 1)

    @property
    def false_per_scan(self) -> float:
        return self.false / max(self.labelled, 1)


def shaken(log: Iterable[Record], rng: np.random.Generator | None, sigma: float = 0.001) -> Iterator[Record]:
    """The records of a log, with noise of `sigma` m on its ranges; as they are without `rng`.

    Targets that are hardly people come and go with it: a single run says little of how many there are.
    """
    for record in log:
        if rng is not None and isinstance(record, ScanRecord):
            ranges = record.scan.ranges + rng.normal(0.0, sigma, len(record.scan))
            record = replace(record, scan=replace(record.scan, ranges=ranges))
        yield record


def follow_person(
    path: Path,
    scans: str,
    labels: str,
    most: int | None = None,
    tracker: PeopleTracker | None = None,
    rng: np.random.Generator | None = None,
) -> PeopleJudgement:
    """One labelled person, labels in the scanner's frame; each belongs to the scan recorded before it.

    rng : of the noise of `shaken`.
    """
    truth: dict[float, Array] = {}
    found: list[tuple[float, list[tuple[int, Array]]]] = []

    def records(log: Iterable[Record]) -> Iterator[Record]:
        stamp: float | None = None
        for record in log:
            if isinstance(record, MessageRecord) and stamp is not None:
                spot = record.message.pose.position
                truth[stamp] = np.array([spot.x, spot.y])
            elif isinstance(record, ScanRecord):
                stamp = record.stamp
                yield record

    with open_log(path, topics=[scans, labels]) as log:
        for count, tracked in enumerate(track_people(cast(Log, shaken(records(log), rng)), tracker=tracker)):
            people = [(target.label, tracked.in_laser(target)[:2]) for target in tracked.targets]
            found.append((tracked.stamp, people))
            if most is not None and count >= most:
                break
    judged, last = PeopleJudgement(), None
    for stamp, people in found:
        if stamp not in truth:
            continue
        judged.labelled += 1
        gaps = {label: float(np.linalg.norm(spot - truth[stamp])) for label, spot in people}
        near = [label for label, gap in gaps.items() if gap < GATE]
        judged.false += len(people) - min(len(near), 1)
        if not near:
            continue
        judged.tracked += 1
        label = last if last in near else min(near, key=lambda name: gaps[name])
        judged.changes += last is not None and label != last
        last = label
    return judged


def phantoms(path: Path, topic: str, rng: np.random.Generator | None = None) -> float:
    """People per scan where there are none; rng : of the noise of `shaken`."""
    with open_log(path) as log:
        tracks = track_people(cast(Log, shaken(log, rng)), topic=topic)
        return float(np.mean([len(tracked.targets) for tracked in tracks]))


@dataclass
class SceneJudgement:
    """What became of a simulated scene, scan by scan.

    ospa (c = 1 m, p = 1), missed, false : per scan. hidden : for every hidden person and scan whether it was kept.
    labels (scans, people) : -1 where nobody was found. returns (scans, people). errors : metres, of who was found.
    """

    ospa: list[float] = field(default_factory=list)
    missed: list[int] = field(default_factory=list)
    false: list[int] = field(default_factory=list)
    hidden: list[bool] = field(default_factory=list)
    labels: list[NDArray[np.int64]] = field(default_factory=list)
    returns: list[NDArray[np.int64]] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)

    @property
    def switches(self) -> int:
        """How often a person's label changed."""
        count = 0
        for person in np.array(self.labels).T:
            given = person[person >= 0]
            count += int(np.sum(given[1:] != given[:-1]))
        return count


class Expected:
    """Who has to be known: whoever was in plain view for 1.5 s, until he has been hidden for 3 s, and then anew."""

    def __init__(self, count: int) -> None:
        self._seen, self._last = np.zeros(count), np.full(count, -np.inf)

    def look(self, returns: NDArray[np.int64], stamp: float, dt: float) -> NDArray[np.bool_]:
        """Of people (P,) with their returns in the scan at `stamp`, `dt` seconds after the last one."""
        in_sight = returns >= RETURNS
        self._seen[stamp - self._last >= FORGIVEN] = 0.0
        self._last[in_sight] = stamp
        self._seen += in_sight * dt
        return np.asarray((self._seen >= SEEN_FOR) & (stamp - self._last < FORGIVEN))


def judge_home(seed: int, duration: float | None = None) -> SceneJudgement:
    """The people of a day in the apartment, from the robot's true poses."""
    tracker, judged = PeopleTracker(), SceneJudgement()
    expected: Expected | None = None
    for moment in ApartmentDay(seed=seed).moments(duration):
        if moment.scan is None:
            continue
        pose = compound(moment.pose, LASER_MOUNT)
        targets = tracker.step(moment.scan, pose, moment.time)
        expected = expected or Expected(len(moment.people))
        known = expected.look(moment.returns, moment.time, 1.0 / SCAN_RATE)
        judge_people(judged, moment.people, moment.returns, *_told(targets), known)
    return judged


def judge_scene(
    scene: PeopleScene,
    rng: np.random.Generator,
    tracker: PeopleTracker | None = None,
    everybody: bool = False,
) -> SceneJudgement:
    """Track a scene. Expected are people who were in plain view for 1.5 s, and hidden for at most `FORGIVEN`.

    everybody : all in the scanner's range and opening instead, hidden or not, from the first scan on.
    """
    tracker = tracker or PeopleTracker()
    judged = SceneJudgement()
    count = len(scene.people)
    seen, last = np.zeros(count), np.full(count, -np.inf)
    for scan in scene.scans(rng):
        targets = tracker.step(scan.scan, scan.pose, scan.scan.stamp)
        in_sight = scan.returns >= RETURNS
        last[in_sight] = scan.scan.stamp
        seen += in_sight / scene.rate
        known = scan.in_view if everybody else (seen >= SEEN_FOR) & (scan.scan.stamp - last < FORGIVEN)
        judge_people(judged, scan.people, scan.returns, *_told(targets), known)
    return judged


def _told(targets: list[Person]) -> tuple[NDArray[np.int64], Array]:
    """Labels (T,) and places (T, 2)."""
    spots = np.array([target.mean[:2] for target in targets]).reshape(-1, 2)
    return np.array([target.label for target in targets], dtype=np.int64), spots


def judge_people(
    judged: SceneJudgement,
    people: Array,
    returns: NDArray[np.int64],
    names: NDArray[np.int64],
    spots: Array,
    expected: NDArray[np.bool_],
) -> None:
    """One scan: true people (P, 2) with their returns (P,), tracked ones by label (T,) at spots (T, 2), all in m.

    expected (P,) : who has to be found. Who is found before or longer than he must be is no error.
    """
    gaps = np.linalg.norm(people[:, None] - spots[None], axis=2)
    labels = np.full(len(people), -1, dtype=np.int64)
    used = np.zeros(len(spots), dtype=bool)
    for person, k in zip(*linear_sum_assignment(np.minimum(gaps, NEAR)), strict=True):
        if gaps[person, k] < NEAR:
            labels[person], used[k] = names[k], True
            judged.errors.append(float(gaps[person, k]))
    excused = np.isin(names, labels[~expected & (labels >= 0)])
    judged.labels.append(labels)
    judged.returns.append(returns)
    if expected.any() or len(spots):
        judged.ospa.append(ospa(spots[~excused], people[expected], 1.0, 1.0))
    judged.missed.append(int(np.sum(labels[expected] < 0)))
    judged.false.append(int(np.sum(~used)))
    judged.hidden += (labels[expected & (returns == 0)] >= 0).tolist()


def figures_of_scenes(judged: Sequence[SceneJudgement]) -> list[float]:
    """OSPA and the columns of `SCENE`, over some scenes."""

    def mean(name: str) -> float:
        return float(np.mean([value for item in judged for value in getattr(item, name)]))

    changes = float(np.mean([item.switches for item in judged])) / 4 * 3
    return [mean("ospa"), mean("errors"), mean("missed"), mean("false"), changes, 100.0 * mean("hidden")]


def crossing_kept(judged: SceneJudgement) -> bool:
    """Whether both people have the label after the crossing, at half time, that they had before."""
    labels = np.array(judged.labels)
    middle = len(labels) // 2
    for person in labels.T:
        before, after = person[: middle - 8], person[middle + 15 :]
        before, after = before[before >= 0], after[after >= 0]
        if not len(before) or not len(after) or before[-1] != after[0]:
            return False
    return True


def hidden_kept(judged: SceneJudgement, person: int = 0, scans: int = 10) -> tuple[bool, bool] | None:
    """Whether the person was kept for the first `scans` of being hidden, and had its label when seen again.

    None where it was not hidden for as long, or not known before.
    """
    labels, returns = np.array(judged.labels)[:, person], np.array(judged.returns)[:, person]
    gone = np.flatnonzero(returns == 0)
    runs = np.split(gone, np.flatnonzero(np.diff(gone) > 1) + 1)
    run = max(runs, key=len)
    if len(run) < scans or run[0] == 0 or labels[run[0] - 1] < 0:
        return None
    label = labels[run[0] - 1]
    back = labels[run[-1] + 5 : run[-1] + 12]
    return bool((labels[run[:scans]] == label).all()), bool((back == label).any())
