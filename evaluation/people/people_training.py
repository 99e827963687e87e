"""How `tracking/people/models/people.json` was trained: `python -m evaluation.people.people_training`.

Positive clusters: the marked legs of `legs_training/positive_*`, what moves in front of the still background of the
stationary demo recording, and simulated legs and trunks. Negative: `negative_2` (a robot driving among furniture
without people), a part of the CARMEN logs fr079 and intel, and simulated rooms. Every recording is also used with
every second and every third beam, so that a coarser scanner looks no different from a distant leg.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from estimation.errors import InputError
from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.datasets import data_directory
from evaluation.scenes.scan_pairs import free_pose
from registration.laser.scan import Scan
from tracking.people.legs import FEATURES, clusters_of
from tracking.people.people_shape import CARD, MODEL
from whereabouts.simulation import Lidar, joined, outlines, random_room
from whereabouts.simulation.walkers import random_build, wander

Array = NDArray[np.float64]
SPARSE = (1, 2, 3)  # every how many-th beam is kept
NEAR_LABEL = 0.12  # metres from a marked leg to the cluster it marks
MOST = 12000  # clusters of one source
TREES, DEPTH = 120, 4
WIDE = 0.8  # metres; clusters wider than that are never asked about


@dataclass(frozen=True)
class ClusterExamples:
    """Features (M, n) of clusters of one source; positive (M,)."""

    source: str
    features: Array
    positive: NDArray[np.bool_]


def thinned(scan: Scan, every: int) -> Scan:
    """The scan of a scanner with fewer beams."""
    return Scan(
        scan.ranges[::every],
        scan.angle_min,
        scan.angle_increment * every,
        scan.range_min,
        scan.range_max,
        scan.stamp,
        scan.time_increment * every,
    )


def marks_of(path: Path) -> list[tuple[Scan, Array]]:
    """Scans of a recording with the legs (M, 2) that are marked in each, metres in the scanner's frame."""
    from whereabouts.logs import MessageRecord, ScanRecord, open_log

    scans: list[Scan] = []
    marks: list[Array] = []
    with open_log(path, topics=["training_scan", "leg_cluster_positions"]) as log:
        for record in log:
            if isinstance(record, ScanRecord):
                scans.append(record.scan)
            elif isinstance(record, MessageRecord):
                poses = record.message.poses
                marks.append(np.array([(p.position.x, p.position.y) for p in poses]).reshape(-1, 2))
    return list(zip(scans, marks, strict=True))


def marked(path: Path) -> list[ClusterExamples]:
    """Legs marked in a recording; unmarked clusters are left out, as not all people are marked."""
    rows: list[Array] = []
    for scan, legs in marks_of(path):
        for every in SPARSE:
            clusters = clusters_of(thinned(scan, every))
            gaps = np.linalg.norm(clusters.centres[:, None] - legs[None], axis=2)
            near = (gaps.min(1, initial=np.inf) < NEAR_LABEL) & (clusters.widths < WIDE)
            rows.append(clusters.features[near])
    features = np.concatenate(rows)
    return [ClusterExamples(path.stem, features, np.ones(len(features), bool))]


def unpeopled(path: Path, topics: list[str] | None, step: int = 1) -> list[ClusterExamples]:
    """All clusters of a recording in which there is nobody, or hardly ever anybody."""
    from whereabouts.logs import ScanRecord, open_log

    found: dict[str, list[Array]] = {}
    count = 0
    with open_log(path, topics=topics) as log:
        for record in log:
            if not isinstance(record, ScanRecord):
                continue
            count += 1
            if count % step:
                continue
            for every in SPARSE:
                clusters = clusters_of(thinned(record.scan, every))
                small = clusters.widths < WIDE
                found.setdefault(record.topic, []).append(clusters.features[small])
    return [
        ClusterExamples(f"{path.stem}/{topic}", F := np.concatenate(rows), np.zeros(len(F), bool))
        for topic, rows in found.items()
    ]


def moving(path: Path) -> list[ClusterExamples]:
    """What stands in front of the background of a scanner that stands still: people."""
    from whereabouts.logs import ScanRecord, open_log

    with open_log(path) as log:
        scans = [record.scan for record in log if isinstance(record, ScanRecord)]
    ranges = np.array([np.where(scan.valid, scan.ranges, np.nan) for scan in scans])
    bins = np.where(np.isfinite(ranges), ranges / 0.1, -1.0).astype(int)
    share = np.zeros((ranges.shape[1], bins.max() + 3))
    for beam in range(ranges.shape[1]):
        counts = np.bincount(bins[bins[:, beam] >= 0, beam], minlength=share.shape[1])
        share[beam] = counts / len(scans)
    often = share > 0.1
    for shift in (-1, 1):  # neighbouring beams and distances
        often |= np.roll(share > 0.1, shift, 0) | np.roll(share > 0.1, shift, 1)
    rows, others = [], []
    for scan, numbers in zip(scans, bins, strict=True):
        background = (numbers >= 0) & often[np.arange(len(numbers)), np.maximum(numbers, 0)]
        for every in SPARSE:
            clusters = clusters_of(thinned(scan, every))
            part = np.array(
                [
                    background[::every][clusters.labels == name].mean() if clusters.counts[name] else 1.0
                    for name in range(len(clusters))
                ]
            )
            small = (clusters.widths < WIDE) & (clusters.ranges < 0.95 * scan.range_max)
            rows.append(clusters.features[small & (part == 0.0)])
            others.append(clusters.features[small & (part > 0.9)])
    positive, negative = np.concatenate(rows), np.concatenate(others)
    return [
        ClusterExamples(path.stem, positive, np.ones(len(positive), bool)),
        ClusterExamples(path.stem + "/background", negative, np.zeros(len(negative), bool)),
    ]


def simulated(seed: int, scenes: int = 250) -> list[ClusterExamples]:
    """Rooms with walking and standing people, by scanners of every resolution and noise."""
    rng = np.random.default_rng(seed)
    rows, labels = [], []
    for _ in range(scenes):
        room = random_room(rng)
        lidar = Lidar(
            int(rng.choice([181, 361, 541, 721])),
            float(rng.choice([np.pi, 1.5 * np.pi])),
            sigma=rng.uniform(0.003, 0.03),
            range_max=float(rng.choice([6.0, 12.0, 30.0])),
            resolution=float(rng.choice([0.0, 0.001, 0.01])),
            dropout=float(rng.choice([0.0, 0.02])),
        )
        bodies = rng.choice(["legs", "legs", "trunk", "skirt"], 5)
        people = [wander(rng, room, (4.0, 4.0), 8.0, random_build(rng, str(body))) for body in bodies]
        for time in rng.uniform(0.0, 8.0, 4):
            shapes = joined([room, outlines(people, float(time))])
            simulated = lidar.scan(shapes, free_pose(shapes, rng, 3.0), rng)
            clusters = clusters_of(simulated.scan)
            for name in np.flatnonzero(clusters.widths < WIDE):
                owners = simulated.owners[clusters.labels == name]
                if (owners > 0).all() or (owners <= 0).all():
                    rows.append(clusters.features[name])
                    labels.append(owners[0] > 0)
    return [ClusterExamples("simulated", np.array(rows), np.array(labels, dtype=bool))]


@cache
def examples(folder: Path, seed: int = 0) -> list[ClusterExamples]:
    """All training examples by source."""
    people = folder / "people"
    found: list[ClusterExamples] = []
    for path in sorted((people / "legs_training").glob("positive_*_extracted.bag")):
        found += marked(path)
    found += moving(people / "demo_stationary_simple_environment.bag")
    found += unpeopled(people / "legs_training" / "negative_2.bag", None)
    found += unpeopled(folder / "carmen" / "fr079.clf.bz2", None, 12)
    found += unpeopled(folder / "carmen" / "intel.clf.bz2", None, 20)
    found += simulated(seed)
    return found


def trained(found: list[ClusterExamples], seed: int = 0) -> GradientBoosting:
    """Trees whose log odds are the log-likelihood ratio: both classes count alike, every source by at most `MOST`."""
    rng = np.random.default_rng(seed)
    parts, labels = [], []
    for item in found:
        chosen = np.sort(rng.permutation(len(item.features))[:MOST])
        parts.append(item.features[chosen])
        labels.append(item.positive[chosen])
    features, positive = np.concatenate(parts), np.concatenate(labels)
    return GradientBoosting(rounds=TREES, depth=DEPTH, seed=seed).fit(features, positive.astype(int))


def main() -> None:
    """Train, write the model and its card, and print the sources."""
    folder = data_directory()
    if folder is None:
        raise InputError("the recordings are absent; set WHEREABOUTS_DATA")
    found = examples(folder)
    sources = {}
    for item in found:
        print(f"{item.source:45} {len(item.features):7d} clusters, {item.positive.mean():.0%} of people")
        sources[item.source] = {
            "clusters": len(item.features),
            "of_people": round(float(item.positive.mean()), 3),
        }
    model = trained(found)
    models = Path(__file__).parents[2] / "tracking" / "people" / "models"
    model.save(models / MODEL)
    card = {
        "what": "log-likelihood ratio person : other of one laser cluster, by boosted trees",
        "trained_by": "python -m evaluation.people.people_training",
        "features": list(FEATURES),
        "trees": TREES,
        "most_clusters_per_source": MOST,
        "sources": sources,
        "terms": "legs_training, demo: A. Leigh, BSD-3; fr079, intel: Radish repository, CC-BY; the rest simulated",
        "limits": "scanners at 0.25 to 1.1 degrees; one cluster alone says little: tables have legs as well",
    }
    (models / CARD).write_text(json.dumps(card, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
