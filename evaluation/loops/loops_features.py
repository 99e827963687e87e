"""Figures 4 and 10 and Tables 3 and 4: how many rounds, which features, how repetitive."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from evaluation.loops.place_evaluation import first_features, removal_errors, repetitiveness, round_curve
from evaluation.loops.place_training import Recording
from evaluation.report import Report, RunOptions
from loop_closure.places.pairs import PairRule, compare_pairs
from whereabouts.system.progress import track

RuleOf = Callable[[Recording, float], PairRule]
# Rounds in the first row, features removed in the second, of Tables 3 and 4.
THEIRS = {
    "killian": ("ken", "4 44 22 12 19", "21 22 4 44 35"),
    "intel": ("syd1", "38 23 17 40 4", "21 10 17 23 27"),
    "freiburg-079": ("syd2", "38 22 34 7 35", "34 6 43 42 29"),
    "clouds": ("hann2", "35 1 7 27 20", "21 8 10 28 35"),
}
ROUNDS = (1, 2, 5, 10, 20, 30, 50, 75, 100, 150, 200)


def training_rounds(
    options: RunOptions, report: Report, recordings: Mapping[str, Recording], rule_of: RuleOf
) -> None:
    """Figure 4: training and validation error against T, within one data set and on another place."""
    rows = []
    samples: dict[str, int] = {}
    for name in ("intel", "killian", "clouds"):
        if name not in recordings:
            continue
        recording = recordings[name]
        F, y = _pairs(recording, rule_of(recording, 2.0), options, 1500)
        samples[name] = len(y)
        half = np.random.default_rng(options.seed).permutation(len(y)) < len(y) // 2
        for rounds, train, validation in round_curve(ROUNDS, (F[half], y[half]), (F[~half], y[~half])):
            rows.append([name, f"T = {rounds}", 100.0 * train, 100.0 * validation])
    report.add(
        "Figure 4: error rate by number of training rounds",
        ["data set", "T", "training error, % ↓", "validation error, % ↓"],
        rows,
        "The text: validation errors stop decreasing after about 50 rounds.",
        "rounds",
        data="tuned on",
        samples=samples,
    )


def informative_features(
    options: RunOptions, report: Report, recordings: Mapping[str, Recording], rule_of: RuleOf
) -> None:
    """Tables 3 and 4: features chosen in the first five rounds, features whose removal costs most."""
    rows = []
    chosen = [name for name in THEIRS if name in recordings]
    for name in track(chosen, "informative features"):
        recording = recordings[name]
        F, y = _pairs(recording, rule_of(recording, 1.0), options, 400 if options.quick else 1200)
        first = " ".join(str(feature) for feature in first_features(F, y))
        folds = 3 if options.quick else 5
        missed = removal_errors(F, y, 50, folds, options.seed)[:5]
        removed = " ".join(f"{feature}" for feature, _ in missed)
        errors = " ".join(f"{100 * error:.1f}" for _, error in missed)
        rows.append([name, first, removed, errors, *THEIRS[name]])
    report.add(
        "Tables 3 and 4: most informative features (1 m; numbers of App. A.A)",
        ["data set", "test 1", "test 2", "error without, %", "theirs of", "test 1", "test 2"],
        rows,
        "As in the text, they differ from one data set to another.",
        "features",
    )


def repetitive_structure(
    options: RunOptions, report: Report, recordings: Mapping[str, Recording], rule_of: RuleOf
) -> None:
    """Figure 10: share of features whose ratios (25) and (26) are below 0.5, and those at 0.9 and above."""
    rows = []
    samples: dict[str, int] = {}
    for name, recording in recordings.items():
        F, y = _pairs(recording, rule_of(recording, 1.0), options, 2000)
        samples[name] = len(y)
        means, deviations = repetitiveness(F, y)
        alike = np.flatnonzero((means >= 0.9) | (deviations >= 0.9)) + 1
        low = [100.0 * float(np.mean(ratios < 0.5)) for ratios in (means, deviations)]
        rows.append([name, *low, " ".join(map(str, alike)) or "none"])
    report.add(
        "Figure 10: repetitive structure",
        ["data set", "means below 0.5, %", "deviations below 0.5, %", "features at 0.9 or more"],
        rows,
        "Ratios of means and of deviations, positive to negative pairs. The text: both below 0.5 in "
        "about 80 % of the cases, outdoors. Corridors repeat themselves more.",
        "repetition",
        data="tuned on",
        samples=samples,
    )


def _pairs(
    recording: Recording, rule: PairRule, options: RunOptions, most: int
) -> tuple[np.ndarray, np.ndarray]:
    """Pair features and labels, as many positive as negative ones."""
    pairs = recording.pairs(rule, most, most, options.seed)
    count = min(pairs.positives, len(pairs) - pairs.positives)
    kept = np.concatenate((np.flatnonzero(pairs.same == 1)[:count], np.flatnonzero(pairs.same == 0)[:count]))
    return compare_pairs(recording.places, pairs.take(kept)), pairs.same[kept]
