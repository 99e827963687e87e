"""From one place to another: the plain method trained elsewhere, and the choice of what it is trained on."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from estimation.learning.gradient_boosting import GradientBoosting
from evaluation.loops.place_evaluation import balanced, cross_environment
from evaluation.loops.place_training import Recording
from evaluation.loops.roc import roc
from evaluation.report import Figure, Report, RunOptions
from loop_closure import AdaBoost, shipped_model
from loop_closure.places.pairs import PairRule, compare_pairs
from loop_closure.places.place_model import NAMES

UNSEEN = "csail"  # which had no part in any choice
RuleOf = Callable[[Recording, float], PairRule]
Pairs = dict[str, tuple[np.ndarray, np.ndarray]]
# What each changes of the experiment's rule, which is headings within 45° and both classes 20 m of path apart.
PROTOCOLS: dict[str, dict[str, Any]] = {
    "45°": {},
    "all headings": {"max_turn": math.pi},
    "45°, loose": {"neighbours": True, "apart": 10.0},
}


def across_places(
    options: RunOptions, report: Report, recordings: Mapping[str, Recording], rule_of: RuleOf
) -> None:
    """Leave one environment out at 1, 2 and 3 m; then what the training set's size, balance and origin do."""
    scans = {name: recording for name, recording in recordings.items() if recording.dimension == 2}
    if len({recording.environment for recording in scans.values()}) < 2:
        report.notes.append("fewer than two places: nothing is judged across them")
        return
    rows: list[list[Any]] = []
    samples: dict[str, int] = {}
    for protocol, change in list(PROTOCOLS.items())[: 1 if options.quick else None]:
        for distance in (1.0, 2.0, 3.0):
            rules = {name: replace(rule_of(scan, distance), **change) for name, scan in scans.items()}
            sets = _sets(scans, rules, options)
            samples |= {name: int(np.sum(same)) for name, (_, same) in sets.items()} | {"mean": len(sets)}
            rows += _judged(scans, sets, protocol, f"{distance:g} m", options.seed)
            if distance == 2.0 and not change:
                _training_sets(report, sets, options.seed)
    report.add(
        "The text's features, trained on the other buildings",
        [
            "log", "pairs", "within", "method", "positives", "D at 0 % FA, % ↑", "D at 0.1 % FA, % ↑",
            "D at 1 % FA, % ↑",
        ],
        rows,
        "D: detection rate; FA: false alarm rate. Every building is judged by a classifier of the "
        "others; the features, the rules and the number of rounds were chosen on all but csail. "
        "infinite-corridor and killian are one building and are never on both sides. Loose: positive "
        "pairs may be near along the path, negative ones are at least 10 m apart.",
        "across",
        data={name: "left out" if name == UNSEEN else "model left out" for name in (*scans, "mean")},
        samples=samples,
    )  # fmt: skip


def _judged(
    scans: Mapping[str, Recording], sets: Pairs, protocol: str, within: str, seed: int
) -> list[list[Any]]:
    """Rows of each log and their mean, judged by the text's method and by gradient boosting."""
    grouped: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {}
    order: dict[str, list[str]] = {}
    for name, pairs in sets.items():
        grouped.setdefault(scans[name].environment, []).append(pairs)
        order.setdefault(scans[name].environment, []).append(name)
    rows: list[list[Any]] = []
    for label, make in (
        ("AdaBoost", lambda: AdaBoost(50)),
        ("gradient boosting", lambda: GradientBoosting(150, 3)),
    ):
        found = cross_environment(make, grouped, 2000, seed)
        rates = []
        for environment, curves in found.items():
            for name, curve in zip(order[environment], curves, strict=True):
                rates.append(curve.rates)
                rows.append([name, protocol, within, label, curve.positives, *rates[-1]])
        mean = [float(value) for value in np.mean(rates, axis=0)]
        rows.append(["mean", protocol, within, label, "", *mean])
    return rows


def _sets(recordings: Mapping[str, Recording], rules: Mapping[str, PairRule], options: RunOptions) -> Pairs:
    negatives, found = 4000 if options.quick else 20_000, {}
    for name, recording in recordings.items():
        pairs = recording.pairs(rules[name], negatives, 3000, options.seed)
        found[name] = (compare_pairs(recording.places, pairs), pairs.same)
    return found


def _training_sets(report: Report, sets: Pairs, seed: int) -> None:
    """Size, balance and origin of the training set: D at 1 % FA on freiburg-079 at 2 m."""
    if not {"intel", "killian", "freiburg-079"} <= sets.keys():
        return
    judged, labels = sets["freiburg-079"]
    rows = []

    def row(label: str, F: np.ndarray, y: np.ndarray) -> None:
        curve = roc(AdaBoost(50).fit(F, y).score(judged), labels)
        rows.append([label, int(y.sum()), int((y == 0).sum()), *curve.rates[1:]])

    both = [sets["intel"], sets["killian"]]
    for most in (8, 25, 100, 400, 1500):
        row(f"intel and killian, {2 * most} of each class", *balanced(both, most, seed))
    F, y = balanced(both, 1500, seed)
    for ratio in (3, 20):
        few = np.concatenate((np.flatnonzero(y == 1)[::ratio], np.flatnonzero(y == 0)))
        row(f"one positive pair in {ratio} kept", F[few], y[few])
    for name in sets:
        if name != "freiburg-079":
            row(f"{name} alone", *balanced([sets[name]], 1500, seed))
    report.add(
        "Choice of the training set, judged on freiburg-079 within 2 m",
        ["trained on", "positives", "negatives", "D at 0.1 % FA, % ↑", "D at 1 % FA, % ↑"],
        rows,
        "The text: 16 positive pairs out of hann2 give 72 ± 19 % at 0 % FA where all give 63 ± 6.",
        "training-sets",
        data="tuned on",
    )


def shipped_models(report: Report) -> None:
    """What the cards of the shipped models say: D on each place by a model trained on the others."""
    rows = []
    for name in NAMES:
        card = shipped_model(name).card
        for entry in card.get("left_out", []):
            what = f"{entry['log']}, {entry['places']}"
            figures = [
                Figure(value, "%", "higher", "model left out", entry["positives"])
                for value in entry["detection"]
            ]
            rows.append([name, what, f"{entry['distance_m']:g} m", *figures])
        for method, entry in card.get("by_place", {}).items():
            rows.append(
                [name, f"{card['trained_on'][0]}, {method}", f"{card['distance_m']:g} m", *entry["mean"]]
            )
    report.add(
        "Shipped models: each place judged by a model trained without it",
        ["model", "judged on", "within", "D at 0 % FA, % ↑", "D at 0.1 % FA, % ↑", "D at 1 % FA, % ↑"],
        rows,
        "From the cards of the shipped models; docs/loop_closure_models.md has the commands. Features, depth and "
        "grades were chosen with these buildings in view.",
        "shipped",
        data="model left out",
        samples={name: max(shipped_model(name).card.get("places", [0])) for name in NAMES},
    )
