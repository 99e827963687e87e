"""Who is who and what moves between two scans: Tables I to III beside the text's, stages, moving beams, timing."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from evaluation.crf.crf_baselines import free_space, icp_kmeans, matching_kmeans
from evaluation.crf.crf_filled import filled
from evaluation.crf.crf_metrics import Scores, f1_of, scores
from evaluation.crf.crf_pictures import busiest, draw_associations, draw_clusters
from evaluation.crf.crf_recordings import recordings
from evaluation.crf.crf_stages import NEAREST, stages
from evaluation.parallel import each
from evaluation.report import Figure, Part, Printed, Report, RunOptions, heading
from evaluation.scenes.labelled_pairs import LabelledPair, protocol, random_labelled_pairs
from registration import Scan, align
from registration.crf import JointEstimate, JointModel
from registration.crf.as_printed import PrintedCrf
from registration.crf.estimate import nothing
from registration.crf.setup import Start, start
from whereabouts.simulation.lidar import Lidar

Inference = Callable[[Scan, Scan, Start | None], JointEstimate]
PRINTED = ("ICP, K-means", "CRF-Matching, K-means", "CRF-Matching, CRF-Clustering", "joint CRF")
HERE = ("free-space violation", "ours without trees", "ours")
BLIND, SAME = "as printed, blind", "our start"
# Accuracy %, string edit distance, outliers %, share of the true ones found %: Tables I and II.
THEIRS_I = {
    PRINTED[0]: (69.19, 119.10, 34.60, 89.79),
    PRINTED[1]: (71.03, 116.16, 13.01, 57.93),
    PRINTED[2]: (71.03, 116.16, 13.01, 57.93),
    PRINTED[3]: (74.13, 96.13, 12.96, 73.37),
}
THEIRS_II = {
    PRINTED[0]: (43.16, 243.87, 34.60, 89.79),
    PRINTED[1]: (60.42, 215.55, 13.01, 57.93),
    PRINTED[2]: (60.04, 190.03, 24.35, 55.64),
    PRINTED[3]: (83.22, 79.61, 13.12, 73.37),
}
THEIRS_III = {
    PRINTED[0]: (0.02, 1.01),
    PRINTED[1]: (0.04, 0.77),
    PRINTED[2]: (0.05, 0.88),
    PRINTED[3]: (0.03, 0.56),
}
LIDARS = {
    "361 beams, 180°": Lidar(361, np.pi, range_max=40.0),
    "361 beams, 360°": Lidar(361, 2.0 * np.pi * 360 / 361),
    "1081 beams, 270°": Lidar(1081, np.deg2rad(270.0)),
}
CROWDS = tuple(range(7100, 7110))  # seeds


def techniques() -> dict[tuple[str, str], Inference]:
    """Every technique by its name and what it begins with; none is learned from the pairs that judge it."""
    printed, model, groups = PrintedCrf.load(), JointModel.load(), JointModel()

    def given(begun: Start | None) -> Start:
        assert begun is not None
        return begun

    def states(begun: Start | None) -> int | None:
        """Blind with all M states; from the start the nearest are enough."""
        return None if begun is None else NEAREST

    of_text: tuple[Inference, ...] = (
        icp_kmeans,
        lambda a, b, begun: matching_kmeans(printed, a, b, begun, states(begun)),
        lambda a, b, begun: printed.infer(a, b, begun, joined=False, nearest=states(begun)),
        lambda a, b, begun: printed.infer(a, b, begun, nearest=states(begun)),
    )
    of_here: tuple[Inference, ...] = (
        lambda a, b, begun: free_space(a, b, given(begun)),
        lambda a, b, begun: groups.conclude(a, b, given(begun)),
        lambda a, b, begun: model.conclude(a, b, given(begun)),
    )
    rows = {(name, begin): one for begin in (BLIND, SAME) for name, one in zip(PRINTED, of_text, strict=True)}
    return rows | {(name, SAME): one for name, one in zip(HERE, of_here, strict=True)}


def judged(pair: LabelledPair) -> dict[tuple[str, str], Scores]:
    """Scores of every technique on a pair."""
    begun = start(pair.scan_a, pair.scan_b)
    found = {}
    for (name, begin), infer in techniques().items():
        if begin == SAME and not begun.registration.converged:
            estimate = nothing(len(pair.scan_a), begun.registration.reason)
        else:
            estimate = infer(pair.scan_a, pair.scan_b, begun if begin == SAME else None)
        found[name, begin] = scores(pair, estimate)
    return found


def _tables(options: RunOptions, report: Report) -> None:
    pairs = protocol(options.seed)
    chosen = np.random.default_rng([options.seed, 11]).permutation(len(pairs))
    left = sorted(chosen[: options.share(5 * len(pairs), 3)].tolist())
    every = each(judged, [(pairs[index],) for index in left], options.jobs, "pairs of the tables")
    found = {key: [one[key] for one in every] for key in every[0]}
    names = ["accuracy, % ↑", "SED ↓", "outliers, %", "outliers found, % ↑"]
    note = (
        "Simulated pairs of streets as the text describes them. As printed: M + 1 states, D = 5, Algorithm 1, learned "
        "by pseudo-likelihood from 31 pairs of another seed. Our start: the same methods from our registration and "
        f"groups, with the {NEAREST} nearest states (all M gave the same on four pairs). SED: string edit distance."
    )
    for title, kind, theirs in (
        ("Table I: association", "association", THEIRS_I),
        ("Table II: clustering", "clustering", THEIRS_II),
    ):
        rows: list[list[object]] = []
        for (name, begin), of_pairs in found.items():
            numbers = [
                100.0 * _mean(of_pairs, kind),
                _mean(of_pairs, f"{kind}_sed"),
                100.0 * _mean(of_pairs, f"outliers_{kind}"),
                100.0 * _mean(of_pairs, f"found_{kind}"),
            ]
            rows.append([name, begin, *numbers, *_theirs(theirs, name, begin, 4)])
        texts = {f"text: {heading(name)[0]}": title.partition(":")[0] for name in names}
        columns = ["technique", "begins", *names, *texts]
        report.add(title, columns, rows, note, kind, printed=texts, data="simulated", samples=len(left))
    true = 100.0 * float(np.mean([each.true_outliers for each in found[HERE[2], SAME]]))
    report.figures["true outliers"] = Figure(
        true, "%", data="simulated", samples=len(left), printed=Printed(11.07, "Section VI")
    )
    _table_of_motions(found, report)


def _theirs(
    printed: Mapping[str, tuple[float, ...]], name: str, begin: str, count: int
) -> tuple[float | str, ...]:
    """The text's figures of a technique as it is printed."""
    return printed[name] if begin == BLIND else ("",) * count


def _table_of_motions(found: dict[tuple[str, str], list[Scores]], report: Report) -> None:
    rows: list[list[object]] = []
    total = sum(len(one.all_objects) for one in found[HERE[2], SAME])
    for (name, begin), every in found.items():
        if name == HERE[0]:
            continue
        backgrounds = [one.background for one in every]
        right = [error for one in every for error in one.objects.values()]
        everything = [error for one in every for error in one.all_objects]
        row: list[object] = [name, begin]
        for errors in (right + backgrounds, right, everything + backgrounds):
            row += map(float, np.mean(errors, axis=0)) if errors else (float("nan"),) * 2
        rows.append([*row, 100.0 * len(right) / max(total, 1), *_theirs(THEIRS_III, name, begin, 2)])
    columns = ["technique", "begins"]
    for kind in ("", "objects, ", "all, "):
        columns += [f"{kind}rotation, rad ↓", f"{kind}translation, m ↓"]
    columns += ["objects right, % ↑"]
    texts = {"text: rotation": "Table III", "text: translation": "Table III"}
    note = (
        "Mean errors of motions; translations are at the object. The first two columns are of the background and the "
        "correctly clustered objects, the next two of these objects alone. All: of the background and all objects; an "
        f"object that was not found counts as stationary. The first seed has {total} objects."
    )
    columns = [*columns, *texts]
    report.add(
        "Table III: motions", columns, rows, note, "motions", printed=texts, data="simulated", samples=total
    )


def _mean(every: Sequence[Scores], name: str) -> float:
    return float(np.nanmean([getattr(one, name) for one in every]))


def _moving(options: RunOptions, report: Report) -> None:
    """Moving beams with the shipped model, every pair of other seeds than its training."""
    model = JointModel.load()
    count = options.share(120, 15)
    rows: list[list[object]] = []
    for scene in ("protocol", "street", "hall", "office", "crowd"):
        for label, lidar in LIDARS.items():
            if scene == "protocol":
                if lidar is not LIDARS["361 beams, 180°"]:
                    continue
                pairs = protocol(options.seed)[: options.share(5 * 31, 5 * 6)]
            else:
                rng = np.random.default_rng([options.seed, 7])
                pairs = random_labelled_pairs(rng, scene, count, lidar=lidar)
            ours = [scores(pair, model.infer(pair.scan_a, pair.scan_b)).counts for pair in pairs]
            theirs = [scores(pair, _free_space(pair)).counts for pair in pairs]
            rows.append([scene, label, *f1_of(ours), f1_of(theirs)[0]])
    columns = ["scene", "scanner", "F1 ↑", "precision ↑", "recall ↑", "F1 of free-space violation ↑"]
    note = (
        "The shipped model, which was trained on other seeds of such scenes. Protocol: the pairs of Table I."
    )
    report.add("Moving beams, simulation", columns, rows, note, "moving", data="simulated", samples=count)


def _crowds(options: RunOptions, report: Report) -> None:
    """Crowds seen by half a circle, seed by seed: seeds that took no part in any choice."""
    model = JointModel.load()
    rows: list[list[object]] = []
    for seed in CROWDS:
        rng = np.random.default_rng([seed, 7])
        pairs = random_labelled_pairs(rng, "crowd", 122, lidar=LIDARS["361 beams, 180°"])
        found = [model.infer(pair.scan_a, pair.scan_b) for pair in pairs]
        counts = [scores(pair, estimate).counts for pair, estimate in zip(pairs, found, strict=True)]
        rows.append([f"seed {seed}", *f1_of(counts), sum(not one.converged for one in found)])
    columns = ["crowds of", "F1 ↑", "precision ↑", "recall ↑", "pairs refused ↓"]
    note = "122 pairs of each seed. All moving beams of a refused pair count as missed."
    title = "Crowds, 361 beams over 180°, seed by seed"
    report.add(title, columns, rows, note, "crowds", data="simulated", samples=122)


def _free_space(pair: LabelledPair) -> JointEstimate:
    return free_space(pair.scan_a, pair.scan_b, start(pair.scan_a, pair.scan_b))


def _poses(options: RunOptions, report: Report) -> None:
    """The background's motion without what moves beside plain registration, by how much of the view moves."""
    model = JointModel.load()
    count = options.share(120, 50)
    rows: list[list[object]] = []
    methods: dict[str, Callable[[Scan, Scan], np.ndarray]] = {
        "without movers": lambda a, b: model.infer(a, b).motions[0],
        "robust": lambda a, b: align(a, b).transform,
    }
    for name in ("icp", "point_to_line", "ndt"):
        methods[name] = lambda a, b, method=name: align(a, b, method=method).transform  # type: ignore[misc]
    rng = np.random.default_rng([options.seed, 8])
    pairs = random_labelled_pairs(rng, "crowd", count, lidar=LIDARS["361 beams, 360°"])
    pairs = [pair for pair in pairs if align(pair.scan_a, pair.scan_b).converged]
    covered = np.array([np.mean(pair.moving[pair.valid]) for pair in pairs])
    for name, method in methods.items():
        away = np.array([np.hypot(*(method(p.scan_a, p.scan_b) - p.motions[0])[:2]) for p in pairs])
        row: list[object] = [name]
        for chosen in (covered <= 0.25, covered > 0.25):
            row += [
                1e3 * float(np.median(away[chosen])) if chosen.any() else float("nan"),
                1e3 * float(np.mean(np.minimum(away[chosen], 0.5))) if chosen.any() else float("nan"),
            ]
        rows.append(row)
    columns = ["method"] + [
        f"{kind}, {what}, mm ↓" for kind in ("few move", "many move") for what in ("median", "mean")
    ]
    note = (
        "Crowds in which `align` accepts the placement. Many: movers cover over a quarter of the view. "
        "An error above 0.5 m counts as 0.5 m."
    )
    report.add("Pose among movers", columns, rows, note, "poses", data="simulated", samples=len(pairs))


def _timing(options: RunOptions, report: Report) -> None:
    model, printed = JointModel.load(), PrintedCrf.load()
    rows: list[list[object]] = []
    count = options.share(60, 4)
    for label, lidar in LIDARS.items():
        rng = np.random.default_rng([options.seed, 9])
        pairs = random_labelled_pairs(rng, "office", count, lidar=lidar)
        pairs += random_labelled_pairs(rng, "crowd", count, lidar=lidar)
        for name, infer in (("ours", model.infer), ("as printed", printed.infer)):
            chosen = pairs if name == "ours" else pairs[:2]
            if name != "ours" and lidar.beams > 361:
                continue
            infer(chosen[0].scan_a, chosen[0].scan_b)
            seconds = []
            for pair in chosen:
                begun = time.process_time()
                infer(pair.scan_a, pair.scan_b)
                seconds.append(time.process_time() - begun)
            late = 1e3 * float(np.percentile(seconds, 99))
            rows.append([label, name, 1e3 * float(np.median(seconds)), late])
    columns = ["scanner", "method", "median, ms ↓", "99 % within, ms ↓"]
    note = "One core, offices and crowds. The text takes up to 4 minutes."
    report.add("Time of a pair", columns, rows, note, "time", data="simulated", samples=2 * count)


def _pictures(options: RunOptions, report: Report) -> None:
    """Figures 3 and 4 on the pairs of a street in which an object is on the most beams."""
    run = busiest(protocol(options.seed), 3)
    found: dict[tuple[str, str], list[JointEstimate]] = {}
    for pair in run:
        begun = start(pair.scan_a, pair.scan_b)
        for (name, begin), infer in techniques().items():
            estimate = infer(pair.scan_a, pair.scan_b, begun if begin == SAME else None)
            found.setdefault((name, begin), []).append(estimate)
    last = {"joint CRF, our start": found[PRINTED[3], SAME], HERE[2]: found[HERE[2], SAME]}
    # CRF-Matching is the association of both techniques that have it.
    of_text = dict(zip(("ICP", "CRF-Matching", "joint CRF"), (PRINTED[0], *PRINTED[2:]), strict=True))
    matched = {name: found[key, BLIND] for name, key in of_text.items()} | last
    clustered = {name: found[name, BLIND] for name in PRINTED} | last
    partners = {name: [one.associations for one in every] for name, every in matched.items()}
    partners["truth"] = [pair.associations for pair in run]
    clusters = {name: every[-1].clusters for name, every in clustered.items()}
    clusters["truth"] = run[-1].clusters
    report.pictures += [
        draw_associations(options.out, run, partners),
        draw_clusters(options.out, run[-1], clusters),
    ]


PARTS = {
    "tables": Part(_tables, quick_seeds=3),
    "stages": Part(stages, quick_seeds=5),
    "moving": Part(_moving),
    "crowds": Part(_crowds, random=False),
    "filled": Part(filled),
    "poses": Part(_poses),
    "recordings": Part(recordings, random=False, needs=("moving_objects/*.bag",)),
    "time": Part(_timing, quick_seeds=2),
    "pictures": Part(_pictures, random=False),
}
