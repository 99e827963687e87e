"""How `tracking/people/models/people_densities.json` was learned: `python -m
evaluation.people.people_density_training`.

Densities of clutter, of new people and of new things, over places that were empty, where something stood, where nobody
has looked, and in between: the likeliest log-linear ones for what came up in simulated scenes with known people and in
recordings without any. New is what is seen for the first time; a thing is what goes on to be seen where it came up.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import numpy.typing as npt

from estimation.errors import InputError
from evaluation.datasets import data_directory
from evaluation.people.people_class_training import SEED, undecided
from evaluation.scenes.occlusion_scenes import BODIES, LAYOUTS, MOTIONS, OcclusionKind, occlusions
from evaluation.scenes.people_scenes import PeopleScene, crowded_room
from evaluation.scenes.varied_floors import varied_floor
from registration.laser.scan import Scan
from tracking.people.cluster_model import DENSITIES, KINDS, kinds_of
from tracking.people.free_space import Background
from tracking.people.people_tracker import PERIOD, PeopleTracker
from whereabouts.logs import open_log
from whereabouts.recorded.people_tracks import track_people
from whereabouts.system.progress import track

Array = npt.NDArray[np.float64]
OURS = 0.4  # m to a true person within which a cluster is his
SAME = 0.25  # m within which two clusters are of one thing
SOON, OFTEN = 1.0, 0.5  # s in which, and share of scans on which, a thing is seen again
SCENES = 10  # of each kind
SPOTS = 100  # places of a scan at which the surroundings are looked up
PRIOR = 2.0  # nat by which densities of kinds of places differ, where nothing tells
CLASSES = ("clutter", "people", "things")


@dataclass
class Counted:
    """What came up: kinds of places (M, 4) by class; and kinds of all places in view with their m² and scans."""

    found: dict[str, list[Array]] = field(default_factory=lambda: {name: [] for name in CLASSES})
    places: dict[str, list[Array]] = field(default_factory=lambda: {name: [] for name in CLASSES})


@dataclass
class _Thing:
    """A place (2,) with a cluster: its kind, when it came up and how often it was seen since, and `looks` at it."""

    place: Array
    kind: Array
    stamp: float
    hits: list[Array] = field(default_factory=list)
    soon: int = 0
    scans: int = 0


def in_view(scan: Scan, pose: Array, reach: float, rng: np.random.Generator) -> tuple[Array, float]:
    """Places (SPOTS, 2), evenly over what a scan looks at, a returns' breadth behind its ends too, and its area, m²."""
    ranges = np.minimum(np.where(scan.valid, scan.ranges + 0.1, scan.range_max), reach)
    sectors = 0.5 * abs(scan.angle_increment) * ranges**2
    beams = rng.choice(len(ranges), SPOTS, p=sectors / sectors.sum())
    away = ranges[beams] * np.sqrt(rng.random(SPOTS))
    angles = scan.bearings[beams] + pose[2]
    return pose[:2] + away[:, None] * np.column_stack((np.cos(angles), np.sin(angles))), float(sectors.sum())


def count(
    tracker: PeopleTracker,
    scans: Iterable[tuple[Scan, Array, Array | None]],
    rng: np.random.Generator,
    into: Counted,
) -> None:
    """What comes up in scans with their poses (3,), and people (P, 2) where they are known."""
    known: set[int] = set()
    things: list[_Thing] = []
    last: float | None = None
    for scan, pose, people in scans:
        seen, stamp = tracker.seen, scan.stamp
        if seen is None or tracker.background.forgot:
            continue
        periods = 1.0 if last is None else min((stamp - last) / PERIOD, 10.0)
        last = stamp
        spots, area = in_view(scan, pose, tracker.config.max_range, rng)
        kinds = _kinds_at(tracker.background, spots, np.linalg.norm(spots - pose[:2], axis=1))
        for name, often in (("clutter", 1.0), ("people", periods), ("things", periods)):
            if name != "people" or people is not None:
                into.places[name].append(np.column_stack((kinds, np.full(SPOTS, often * area / SPOTS))))
        for thing in things:
            thing.scans += stamp - thing.stamp <= SOON
        for place, kind in zip(seen.places, seen.kinds, strict=True):
            gaps = np.zeros(0) if people is None else np.linalg.norm(people - place, axis=1)
            if len(gaps) and gaps.min() < OURS:
                person = int(gaps.argmin())
                if person not in known:
                    known.add(person)
                    into.found["people"].append(kind)
                continue
            _again(things, place, kind, stamp)
    for thing in things:
        if thing.soon >= OFTEN * thing.scans and thing.scans > 2:
            into.found["things"].append(thing.kind)
        else:
            into.found["clutter"] += thing.hits


def _again(things: list[_Thing], place: Array, kind: Array, stamp: float) -> None:
    """A cluster at a place: of the nearest thing, or of a new one."""
    near = [thing for thing in things if abs(thing.place - place).max() < SAME]
    if near:
        thing = min(near, key=lambda item: float(np.linalg.norm(item.place - place)))
        thing.soon += stamp - thing.stamp <= SOON
        thing.hits.append(kind)
    else:
        things.append(_Thing(place, kind, stamp, [kind]))


def _kinds_at(background: Background, spots: Array, ranges: Array) -> Array:
    return kinds_of(*background.evidence(spots, ranges))


def of_scene(scene: PeopleScene, rng: np.random.Generator, into: Counted) -> None:
    """What comes up in a simulated scene."""
    tracker = undecided()

    def steps() -> Iterator[tuple[Scan, Array, Array]]:
        for scan in scene.scans(rng):
            tracker.step(scan.scan, scan.pose, scan.scan.stamp)
            yield scan.scan, scan.pose, scan.people

    count(tracker, steps(), rng, into)


def of_recording(path: Path, topic: str | None, most: int, into: Counted) -> None:
    """What comes up in a recording with nobody, or hardly anybody, in it."""
    tracker = undecided()
    with open_log(path) as log:
        tracked = zip(range(most), track_people(log, topic=topic, tracker=tracker), strict=False)
        count(tracker, ((item.scan, item.pose, None) for _, item in tracked), np.random.default_rng(0), into)


def likeliest(found: Array, places: Array) -> Array:
    """Log-densities (4,) θ, exp(k θ) for a kind k, of what was found (M, 4) among places (P, 5): kinds, m² scans."""
    kinds, weights = places[:, :4], places[:, 4]
    usual = np.log((len(found) + 1.0) / weights.sum())
    theta = np.full(4, usual)
    for _ in range(100):
        expected = weights * np.exp(kinds @ theta)
        slope = found.sum(0) - kinds.T @ expected - (theta - usual) / PRIOR**2
        curve = (kinds * expected[:, None]).T @ kinds + np.eye(4) / PRIOR**2
        step = np.clip(np.linalg.solve(curve, slope), -1.0, 1.0)
        theta = theta + step
        if np.abs(step).max() < 1e-9:
            break
    return theta


def counted(folder: Path) -> Counted:
    """What comes up in all sources."""
    into = Counted()
    for k in track(range(SCENES), "simulated floors"):
        rng = np.random.default_rng([SEED, 3000 + k])
        of_scene(varied_floor(rng, 8 if k % 2 else 0), rng, into)
    for k in track(range(SCENES), "simulated rooms"):
        rng = np.random.default_rng([SEED, 3100 + k])
        kind = OcclusionKind(
            str(rng.choice(LAYOUTS)), str(rng.choice(MOTIONS)), str(rng.choice(BODIES)), k % 4 > 1
        )
        of_scene(occlusions(rng, kind) if k % 2 else crowded_room(rng, 4, k % 4 > 1), rng, into)
    for name, topic in (
        ("carmen/fr079.clf.bz2", None),
        ("carmen/intel.clf.bz2", None),
        ("people/legs_training/negative_2.bag", "rear_scan"),
    ):
        of_recording(folder / name, topic, 800, into)
    return into


def main() -> None:
    """Learn, write and print the densities."""
    folder = data_directory()
    if folder is None:
        raise InputError("the recordings are absent; set WHEREABOUTS_DATA")
    into = counted(folder)
    densities, card = {}, {}
    for name in CLASSES:
        found, places = np.array(into.found[name]).reshape(-1, 4), np.concatenate(into.places[name])
        theta = likeliest(found, places)
        usual = float(np.log((len(found) + 1.0) / places[:, 4].sum()))
        densities[name] = [round(value, 2) for value in (*theta.tolist(), usual)]
        card[name] = {
            "counted": len(found),
            "of_kinds": found.sum(0).round(1).tolist(),
            "m2_scans": (places[:, :4] * places[:, 4:]).sum(0).round(0).tolist(),
        }
        print(name, dict(zip(KINDS, densities[name], strict=True)), card[name])
    models = Path(__file__).parents[2] / "tracking" / "people" / "models"
    what = {
        "what": "log-densities, 1/m², of clutter per scan and of new people and things per 0.1 s",
        "learned_by": "python -m evaluation.people.people_density_training",
        "kinds": list(KINDS),
        "densities": densities,
        "from": card,
    }
    (models / DENSITIES).write_text(json.dumps(what, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
