"""What each stage adds: the same pairs of every scene, labelled from the same start, stage after stage."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from estimation.geometry.poses import compound
from evaluation.crf.crf_metrics import Scores, f1_of, scores
from evaluation.parallel import each
from evaluation.report import Report, RunOptions
from evaluation.scenes.labelled_pairs import LabelledPair, protocol, random_labelled_pairs
from registration.crf import JointModel
from registration.crf.as_printed import PrintedCrf
from registration.crf.estimate import JointEstimate, nothing
from registration.crf.setup import start
from registration.crf.window import segment

STAGES = ("start", "+ chains", "+ joint", "+ trees", "+ window")
SCENES = ("street protocol", "free streets", "halls", "offices", "crowds")
NAMES = {"free streets": "street", "halls": "hall", "offices": "office", "crowds": "crowd"}
LENGTH = 3  # pairs of a run
NEAREST = 10  # states of association: the text's own proposal (section VI)


def stages(options: RunOptions, report: Report) -> None:
    """Add the table."""
    rows: list[list[object]] = []
    runs_of_scene = options.share(200, 15)
    for scene in SCENES:
        runs = _runs(scene, options.seed, runs_of_scene)
        found = each(judged_run, [(run,) for run in runs], options.jobs, scene)
        for stage in STAGES:
            rows.append([scene, stage, *_row([one for run in found for one in run[stage]], stage)])
    note = (
        "Every method begins with the same registration and groups (`start`). Chains: CRF-Matching and CRF-Clustering "
        f"as printed, one after the other; joint: Algorithm 1 as printed; both with the {NEAREST} nearest states. "
        "Trees: the product, which is the start and the trees, without chains. Window: the product over all scans of a "
        "run, which decides on moving beams only."
    )
    columns = ["scene", "stage", "F1 ↑", "objects right, % ↑", "association, % ↑", "clustering, % ↑"]
    report.add("Stages", columns, rows, note, "stages", data="simulated", samples=LENGTH * runs_of_scene)


def _runs(scene: str, seed: int, count: int) -> list[list[LabelledPair]]:
    """Runs of consecutive pairs, about as many pairs in every scene."""
    if scene in NAMES:
        pairs = random_labelled_pairs(np.random.default_rng([seed, 7]), NAMES[scene], count, LENGTH)
    else:
        streets = [protocol(seed + 1000 * k) for k in range(-(-count * LENGTH // 31))]
        pairs = [pair for street in streets for pair in street][: count * LENGTH]
    runs: list[list[LabelledPair]] = []
    for pair in pairs:
        if runs and runs[-1][-1].sequence == pair.sequence:
            runs[-1].append(pair)
        else:
            runs.append([pair])
    return runs


def judged_run(run: list[LabelledPair]) -> dict[str, list[Scores]]:
    """Scores of every stage on the pairs of a run."""
    model, printed = JointModel.load(), PrintedCrf.load()
    scans = [pair.scan_a for pair in run] + [run[-1].scan_b]
    stamps = np.array([scan.stamp for scan in scans])
    # The pose of a scan in the frame of the one after it, and so on to the last.
    poses = [np.zeros(3)]
    for pair in reversed(run):
        poses.append(compound(poses[-1], pair.motions[0]))
    intervals = [float(k * run[0].interval) for k in (-2, -1, 1, 2)]
    found: dict[str, list[Scores]] = {stage: [] for stage in STAGES}
    for index, pair in enumerate(run):
        every = _stages(pair, model, printed)
        labels = segment(model, scans, stamps, np.array(poses[::-1]), index, intervals)
        every[STAGES[-1]] = _relabelled(every["+ trees"], labels)
        for stage, estimate in every.items():
            found[stage].append(scores(pair, estimate))
    return found


def _relabelled(estimate: JointEstimate, labels: np.ndarray) -> JointEstimate:
    """An estimate with other clusters, which have no motions."""
    motions = np.repeat(estimate.motions[:1], 1 + max(int(labels.max()), 0), axis=0)
    return replace(estimate, clusters=labels, motions=motions)


def _stages(pair: LabelledPair, model: JointModel, printed: PrintedCrf) -> dict[str, JointEstimate]:
    begun = start(pair.scan_a, pair.scan_b)
    if not begun.registration.converged:
        return dict.fromkeys(STAGES[:-1], nothing(len(pair.scan_a), begun.registration.reason))
    a, b = pair.scan_a, pair.scan_b
    return {
        STAGES[0]: JointModel().conclude(a, b, begun),
        STAGES[1]: printed.infer(a, b, begun, joined=False, nearest=NEAREST),
        STAGES[2]: printed.infer(a, b, begun, nearest=NEAREST),
        STAGES[3]: model.conclude(a, b, begun),
    }


def _row(every: Sequence[Scores], stage: str) -> list[object]:
    f1 = f1_of([one.counts for one in every])[0]
    if stage == STAGES[-1]:
        return [f1, "", "", ""]
    objects = sum(len(one.all_objects) for one in every)
    right = sum(len(one.objects) for one in every)
    return [
        f1,
        100.0 * right / max(objects, 1),
        100.0 * float(np.mean([one.association for one in every])),
        100.0 * float(np.mean([one.clustering for one in every])),
    ]
