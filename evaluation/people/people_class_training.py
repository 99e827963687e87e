"""How `tracking/people/models/person_class.json` was trained: `python -m evaluation.people.people_class_training`.

Targets of the tracker itself, of any class, in simulated scenes and in recordings: those of true or marked people, and
those in places where there is nobody. Half of the scenes are seen from poses that are a little wrong, as odometry is.
Probabilities are calibrated on scenes and recordings that were left out. Scenes that judge are drawn from other seeds;
mit-csail, positive_7, the outdoor recording and the home take no part.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import numpy.typing as npt

from estimation.errors import InputError
from estimation.geometry.poses import compound, inverse
from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.datasets import data_directory
from evaluation.parallel import each
from evaluation.people.people_training import marks_of
from evaluation.scenes.occlusion_scenes import (
    BODIES,
    LAYOUTS,
    MOTIONS,
    OcclusionKind,
    occlusions,
    one_hardly_moves,
)
from evaluation.scenes.people_scenes import PeopleScene, crowded_room, empty_floor, peopled_floor
from evaluation.scenes.varied_floors import disturbed, things_stand_about, varied_floor
from registration.laser.scan import Scan
from tracking.people.people_tracker import PeopleTracker, Person
from tracking.people.person_class import CARD, MODEL, NAMES, ClassModel
from whereabouts.logs import open_log
from whereabouts.recorded.people_tracks import track_people

Array = npt.NDArray[np.float64]
SEED = 1000  # no scene that judges is drawn from it
EVERY = 4  # scans from one example of a target to the next
OURS, NOT_OURS = 0.4, 0.9  # m to a true person within which, and beyond which, a target is one or none
TREES, DEPTH = 300, 4
FOLDS = 3  # parts of which each is left out once for the calibration


class _Undecided(ClassModel):
    """Tells of nobody, so that what is learned from does not depend on what was learned before."""

    def odds(self, features: list[list[float]]) -> Array:
        return np.full(len(features), -9.0)


def undecided() -> PeopleTracker:
    """A tracker that follows everything and calls nothing a person."""
    return PeopleTracker(classes=_Undecided(GradientBoosting(), 1.0, 0.0))


@dataclass
class ClassExamples:
    """M looks at targets of one source.

    features (M, len(NAMES)); positive (M,); weights (M,) : many looks at one target count as their square root.
    parts (M,) : looks of different parts, scenes for instance, are independent. real : whether it is a recording.
    """

    source: str
    features: Array
    positive: npt.NDArray[np.bool_]
    weights: Array
    parts: npt.NDArray[np.int64]
    real: bool = False


class _Collector:
    """Gathers looks at targets of known class."""

    def __init__(self) -> None:
        self.rows: list[list[float]] = []
        self.whose: list[tuple[int, int, bool]] = []

    def take(self, tracker: PeopleTracker, people: Array | None, part: int, unmarked: bool = False) -> None:
        """Targets seen in the last scan; people (P, 2), or None where nobody is. `unmarked` : others may be people."""
        for target in tracker.targets:
            evidence = tracker.evidence[target.label]
            if evidence.looks == 0.0 or evidence.last_seen != tracker.stamp:
                continue
            gap = np.inf
            if people is not None:
                gap = float(np.linalg.norm(people - target.mean[:2], axis=1).min(initial=np.inf))
            if gap < OURS or (gap > NOT_OURS and not unmarked):
                self.rows.append(evidence.features(target))
                self.whose.append((part, target.label, gap < OURS))

    def examples(self, source: str, real: bool = False) -> ClassExamples:
        """What was gathered."""
        _, target, counts = np.unique(
            np.array(self.whose).reshape(-1, 3), axis=0, return_inverse=True, return_counts=True
        )
        return ClassExamples(
            source,
            np.array(self.rows).reshape(-1, len(NAMES)),
            np.array([positive for _, _, positive in self.whose], dtype=bool),
            np.asarray(1.0 / np.sqrt(counts[target.reshape(-1)]), dtype=np.float64),
            np.array([part for part, _, _ in self.whose], dtype=np.int64),
            real,
        )


def simulated(
    name: str,
    draw: Callable[[int], PeopleScene],
    count: int,
    seeds: tuple[int, int],
    wrong: tuple[int, ...],
    lost: bool = False,
) -> ClassExamples:
    """Targets in `count` simulated scenes; those whose number modulo 4 is in `wrong` are seen from wrong poses.

    lost : nobody knows where the scanner is, which is taken to stand.
    """
    found = _Collector()
    for k in range(count):
        rng, scene, tracker = np.random.default_rng([seeds[0], seeds[1] + k]), draw(k), undecided()
        errors = disturbed(rng, scene.rate, int(scene.duration * scene.rate) + 2) * float(k % 4 in wrong)
        for number, (scan, error) in enumerate(zip(scene.scans(rng), errors, strict=False)):
            if lost:
                error = inverse(scan.pose)
            c, s = np.cos(error[2]), np.sin(error[2])
            tracker.step(scan.scan, compound(error, scan.pose), scan.scan.stamp, pose_known=not lost)
            if number % EVERY == 0:
                found.take(tracker, scan.people @ np.array([[c, s], [-s, c]]) + error[:2], k)
    return found.examples(name)


class _Lost(PeopleTracker):
    """A scanner that is taken to stand, whatever its pose."""

    def step(self, scan: Scan, pose: npt.ArrayLike, stamp: float, *_: object, **__: object) -> list[Person]:
        return super().step(scan, np.zeros(3), stamp, pose_known=False)


def recorded(
    path: Path, topic: str | None, most: int, marks: dict[float, Array] | None = None, lost: bool = False
) -> ClassExamples:
    """Targets in a recording without people, or those near marked legs; `marks` (M, 2) by stamp, m, of the scanner."""
    found = _Collector()
    tracker = _Lost(classes=undecided().classes) if lost else undecided()
    with open_log(path) as log:
        for k, tracked in enumerate(track_people(log, topic=topic, tracker=tracker)):
            if k >= most:
                break
            if marks is None:
                if k % EVERY == 0:
                    found.take(tracker, None, 0)
                continue
            legs = marks.get(round(tracked.stamp, 3), np.zeros((0, 2)))
            place = np.zeros(3) if lost else tracked.pose
            c, s = np.cos(place[2]), np.sin(place[2])
            found.take(tracker, legs @ np.array([[c, s], [-s, c]]) + place[:2], 0, unmarked=True)
    named = f"{path.stem}/{topic}" if topic else path.stem
    return found.examples(f"{named}/pose withheld" if lost else named, real=True)


Source = Callable[[], ClassExamples]


def drawn(seed: int = SEED) -> list[Source]:
    """What gives targets in simulated scenes of all kinds."""

    def rng(k: int) -> np.random.Generator:
        return np.random.default_rng([seed, k])

    def hiding(k: int) -> PeopleScene:
        g = rng(300 + k)
        kind = OcclusionKind(
            str(g.choice(LAYOUTS)), str(g.choice(MOTIONS)), str(g.choice(BODIES)), k % 2 == 1
        )
        return occlusions(g, kind, 12.0)

    def varied(k: int) -> PeopleScene:
        most, standing = int(rng(650 + k).integers(1, 11)), float(rng(660 + k).choice([0.2, 0.4, 0.8]))
        return varied_floor(rng(600 + k), most, standing)

    def walking(k: int) -> PeopleScene:
        return peopled_floor(rng(k), standing=(0.4, 0.8)[k % 2])

    def staying(k: int) -> PeopleScene:
        g = rng(900 + k)
        scene = crowded_room(g, 3, k % 3 == 2, 40.0)
        people = [replace(one, rests=g.uniform(0.0, 20.0, len(one.waypoints))) for one in scene.people]
        return replace(scene, people=people)

    def source(
        name: str,
        draw: Callable[[int], PeopleScene],
        count: int,
        stream: int,
        wrong: tuple[int, ...],
        lost: bool = False,
    ) -> Source:
        return partial(simulated, name, draw, count, (seed, stream), wrong, lost)

    often, half, seldom = (1, 2, 3), (1, 3), (1,)
    return [
        source("varied empty floors", lambda k: varied_floor(rng(500 + k)), 16, 2500, often),
        source("people on varied floors", varied, 16, 2600, often),
        source("people on a floor", walking, 20, 2000, half),
        source("empty floors", lambda k: empty_floor(rng(100 + k)), 12, 2100, half),
        source("one hardly moves", lambda k: one_hardly_moves(rng(1200 + k)), 30, 2200, seldom),
        source("occlusions", hiding, 20, 2300, seldom),
        source("things stand about", lambda k: things_stand_about(rng(800 + k)), 60, 3000, seldom),
        source("crowded rooms", lambda k: crowded_room(rng(3400 + k), 4, k % 3 == 2), 48, 2400, seldom),
        source("people who stay in rooms", staying, 30, 3100, seldom),
        source("varied, pose withheld", lambda k: varied_floor(rng(700 + k), k % 4), 12, 2700, (), True),
        source("floors, pose withheld", lambda k: walking(20 + k), 8, 2800, (), True),
        source("empty, pose withheld", lambda k: empty_floor(rng(150 + k)), 6, 2900, (), True),
    ]


def of_recordings(folder: Path) -> list[Source]:
    """What gives targets in the recordings that may train: without people, and with marked legs."""
    legs, carmen = folder / "people" / "legs_training", folder / "carmen"
    found: list[Source] = [
        partial(recorded, carmen / "fr079.clf.bz2", None, 2500),
        partial(recorded, carmen / "intel.clf.bz2", None, 3000),
        *(
            partial(recorded, legs / "negative_2.bag", topic, 1500)
            for topic in ("left_scan", "rear_scan", "right_scan")
        ),
        partial(recorded, carmen / "fr079.clf.bz2", None, 1500, lost=True),
        partial(recorded, carmen / "intel.clf.bz2", None, 1500, lost=True),
        partial(recorded, legs / "negative_2.bag", "left_scan", 1500, lost=True),
    ]
    for name in ("positive_1", "positive_2", "positive_3", "positive_4", "positive_6"):
        marks = {round(scan.stamp, 3): spots for scan, spots in marks_of(legs / f"{name}_extracted.bag")}
        found.append(partial(recorded, legs / f"{name}.bag", None, 1500, marks))
        found.append(partial(recorded, legs / f"{name}.bag", None, 1500, marks, lost=True))
    return found


def examples(sources: list[Source], jobs: int = 1) -> list[ClassExamples]:
    """Targets of all sources, which are gone through by `jobs` processes; in order, the same for any number."""
    return each(_call, [(source,) for source in sources], jobs, "sources")


def _call(source: Source) -> ClassExamples:
    return source()


def folds(found: list[ClassExamples]) -> list[npt.NDArray[np.int64]]:
    """The fold (M,) of every look: a recording is in one as a whole, of simulated scenes each is in one."""
    names = sorted({item.source.partition("/")[0] for item in found if item.real})
    return [
        np.full(len(item.positive), names.index(item.source.partition("/")[0]) % FOLDS)
        if item.real
        else item.parts % FOLDS
        for item in found
    ]


def balanced(found: list[ClassExamples]) -> Array:
    """Weights (sum of M,) with which, of each class, recordings count as much as simulated scenes."""
    positive = np.concatenate([item.positive for item in found])
    real = np.concatenate([np.full(len(item.positive), item.real) for item in found])
    weights = np.concatenate([item.weights for item in found])
    for kind in (False, True):
        both = [weights[(positive == kind) & (real == recorded)].sum() for recorded in (False, True)]
        if min(both) > 0.0:
            weights[(positive == kind) & real] *= both[0] / both[1]
    return weights


def calibrated(odds: Array, positive: npt.NDArray[np.bool_], weights: Array) -> tuple[float, float]:
    """The likeliest scale and prior that make log-odds (M,) of trees probabilities (Platt 1999)."""
    F, x = np.column_stack((odds, np.ones(len(odds)))), np.zeros(2)
    for _ in range(50):
        p = 1.0 / (1.0 + np.exp(-F @ x))
        step = np.linalg.solve(
            (F * (weights * p * (1.0 - p))[:, None]).T @ F, F.T @ (weights * (p - positive))
        )
        x -= step
        if np.abs(step).max() < 1e-9:
            break
    return float(x[0]), float(x[1])


def trained(found: list[ClassExamples], seed: int = 0) -> tuple[ClassModel, dict[str, object]]:
    """Trees over all examples, calibrated by those that leave a part out each; and a card."""
    found = [item for item in found if len(item.positive)]
    features = np.concatenate([item.features for item in found])
    positive = np.concatenate([item.positive for item in found])
    weights = balanced(found)
    fold = np.concatenate(folds(found))

    def grown(chosen: npt.NDArray[np.bool_]) -> GradientBoosting:
        trees = GradientBoosting(rounds=TREES, depth=DEPTH, seed=seed)
        return trees.fit(features[chosen], positive[chosen].astype(int), weights[chosen])

    odds = np.zeros(len(positive))
    for k in range(FOLDS):
        odds[fold == k] = grown(fold != k).decision(features[fold == k])
    scale, prior = calibrated(odds, positive, weights)
    told = scale * odds + prior > 0.0
    bounds = np.cumsum([0, *(len(item.positive) for item in found)])
    card = {
        "what": "log-odds that a target of the tracker is a person, by boosted trees",
        "trained_by": "python -m evaluation.people.people_class_training",
        "features": list(NAMES),
        "scale": round(scale, 3),
        "prior": round(prior, 3),
        "sources": {
            item.source: {
                "looks": len(item.positive),
                "of_people": round(float(item.positive.mean()), 3),
                "right_when_left_out": round(float((told[a:b] == item.positive).mean()), 3),
            }
            for item, a, b in zip(found, bounds, bounds[1:], strict=False)
        },
        "limits": "legs and round bodies at one height; who stands is told from a table leg by shape only",
    }
    return ClassModel(grown(np.ones(len(positive), dtype=bool)), scale, prior), card


def main() -> None:
    """Train, write the model and its card, and print the sources."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--jobs", type=int, default=1, help="processes")
    jobs = parser.parse_args().jobs
    folder = data_directory()
    if folder is None:
        raise InputError("the recordings are absent; set WHEREABOUTS_DATA")
    found = examples(drawn() + of_recordings(folder), jobs)
    for item in found:
        print(f"{item.source:30} {len(item.positive):7d} looks, {item.positive.mean():.0%} of people")
    model, card = trained(found)
    models = Path(__file__).parents[2] / "tracking" / "people" / "models"
    model.trees.save(models / MODEL)
    (models / CARD).write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
