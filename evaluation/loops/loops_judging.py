"""Protocols of `whereabouts loops evaluate` and `inspect` on recordings."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from estimation.errors import InputError
from estimation.learning.boosting import AdaBoost
from evaluation.drawing import saved
from evaluation.loops.place_evaluation import (
    Validation,
    balanced,
    first_features,
    k_fold,
    removal_errors,
    repetitiveness,
    round_curve,
)
from evaluation.loops.place_training import CascadeConfig, Recording, train_cascade, train_plain
from evaluation.loops.roc import Roc, roc
from evaluation.parallel import each
from loop_closure.places.pairs import PairRule, compare_pairs
from loop_closure.places.place_model import PlaceModel

PROTOCOLS = ("model", "cross", "k-fold")


HEADING = f"{'log':28}{'within':>8}{'pairs +':>9}{'pairs -':>9}{'D@0%':>8}{'D@0.1%':>8}{'D@1%':>8}{'AP':>7}"


@dataclass(frozen=True)
class Judgement:
    """D of one recording at one distance; with k-fold the curve of the first permutation, and all."""

    name: str
    rule: PairRule
    curve: Roc
    validation: Validation | None = None

    def line(self) -> str:
        """Figures below `HEADING`, and with k-fold mean and deviation over permutations behind them."""
        rates = "".join(f"{rate:8.1f}" for rate in self.curve.rates)
        text = f"{self.name:28}{self.rule.distance:>6g} m{self.curve.positives:>9}{self.curve.negatives:>9}{rates}"
        text += f"{self.curve.average_precision:7.3f}"
        if self.validation is None:
            return text
        spreads = (f"{100 * s.mean:.1f} ± {100 * s.deviation:.1f}" for s in self.validation.spreads())
        return f"{text}   {', '.join(spreads)}"

    def as_dict(self) -> dict[str, Any]:
        spread = {}
        if self.validation is not None:
            spread = {
                f"spread_at_{100 * s.false_alarm:g}_percent": [
                    100.0 * value for value in (s.mean, s.deviation, s.least, s.most)
                ]
                for s in self.validation.spreads()
            }
        return {
            "log": self.name,
            "distance_m": self.rule.distance,
            "positives": self.curve.positives,
            "negatives": self.curve.negatives,
            **self.curve.as_dict(),
            **spread,
        }


@dataclass(frozen=True)
class JudgingPlan:
    """How recordings are judged.

    protocol : of PROTOCOLS. model : judged by protocol "model". method, rounds : what else is trained.
    positives, negatives : pairs at most, from each log. folds, repetitions : of k-fold.
    """

    protocol: str
    model: PlaceModel | None = None
    method: str = "plain"
    rounds: int = 50
    positives: int = 3000
    negatives: int = 20_000
    folds: int = 10
    repetitions: int = 5
    seed: int = 0


def judge(
    recordings: Sequence[Recording],
    rules: Sequence[PairRule],
    plan: JudgingPlan,
    jobs: int = 1,
    what: str = "",
) -> list[Judgement]:
    """D of every recording at every distance.

    jobs, what : as of `parallel.each`; the places at each distance are judged independently.

    Raises
    ------
    InputError : an unknown protocol, or nothing to train on.
    """
    protocol = plan.protocol
    if protocol not in PROTOCOLS:
        raise InputError(f"protocol: one of {', '.join(PROTOCOLS)} expected, got {protocol!r}")
    if protocol == "cross" and len({recording.environment for recording in recordings}) < 2:
        raise InputError("protocol cross: logs of at least two places are needed (LOG@PLACE names the place)")
    environments = list(dict.fromkeys(recording.environment for recording in recordings))
    calls = [(rule, environment, recordings, plan) for rule in rules for environment in environments]
    judged = [row for rows in each(_judged_place, calls, jobs, what) for row in rows]
    # As the recordings were given, also where those of one place were not given together.
    rank = {(rule, k): i for i, (rule, k) in enumerate(itertools.product(rules, range(len(recordings))))}
    return [row for _, row in sorted(judged, key=lambda item: rank[item[1].rule, item[0]])]


def _judged_place(
    rule: PairRule, environment: str, recordings: Sequence[Recording], plan: JudgingPlan
) -> list[tuple[int, Judgement]]:
    """Number and judgement of the recordings of one place, at one distance."""
    model, protocol = plan.model, plan.protocol
    if protocol == "cross" or (protocol != "k-fold" and model is None):
        others = [other for other in recordings if other.environment != environment]
        model = _trained(others, rule, plan)
    found = []
    for number, recording in enumerate(recordings):
        if recording.environment != environment:
            continue
        pairs = recording.pairs(rule, plan.negatives, plan.positives, plan.seed)
        if not 0 < pairs.positives < len(pairs):
            raise InputError(f"recording {recording.name}: no pairs of both classes within {rule.distance} m")
        if protocol == "k-fold":
            features = compare_pairs(recording.places, pairs)
            F, y = balanced([(features, pairs.same)], pairs.positives, plan.seed)
            boosted = partial(AdaBoost, plan.rounds)
            validation = k_fold(boosted, F, y, plan.folds, plan.repetitions, plan.seed)
            found.append((number, Judgement(recording.name, rule, validation.curves[0], validation)))
        else:
            assert model is not None
            curve = roc(model.score_pairs(recording.places, pairs), pairs.same)
            found.append((number, Judgement(recording.name, rule, curve)))
    return found


def _trained(recordings: Sequence[Recording], rule: PairRule, plan: JudgingPlan) -> PlaceModel:
    if plan.method == "plain":
        return train_plain(recordings, rule, plan.rounds, seed=plan.seed)
    return train_cascade(recordings, CascadeConfig(rule=rule, seed=plan.seed))


def draw_curves(found: Sequence[Judgement], path: Path) -> None:
    """ROC curves as a picture, false alarms on a logarithmic axis."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axes = figure.subplots()
    for k, row in enumerate(found):
        axes.plot(
            100 * np.maximum(row.curve.false_alarm, 1e-4),
            100 * row.curve.detection,
            # Ten colours are not enough for all data sets at all distances.
            linestyle=("-", "--", ":")[k // 10 % 3],
            label=f"{row.name}, {row.rule.distance:g} m",
        )
    axes.set(xscale="log", xlim=(0.01, 100), ylim=(0, 100), xlabel="FA, %", ylabel="D, %")
    axes.grid(True, alpha=0.3)
    figure.legend(fontsize=7, loc="outside right upper")
    saved(figure, path, 120)


def look_into(recording: Recording, rule: PairRule, rounds: int, most: int, seed: int) -> dict[str, Any]:
    """Tests 1 and 2 of Tables 3 and 4, the curve of Figure 4 and the ratios of Figure 10, of one recording."""
    pairs = recording.pairs(rule, most, most, seed)
    F = compare_pairs(recording.places, pairs)
    rng = np.random.default_rng(seed)
    half = rng.permutation(len(pairs)) < len(pairs) // 2
    counts = [t for t in (1, 2, 5, 10, 20, 30, 40, 50, 75, 100, 150, 200) if t <= max(rounds, 1)]
    means, deviations = repetitiveness(F, pairs.same)
    alike = [int(k) + 1 for k in np.flatnonzero((means > 0.9) & (deviations > 0.9))]
    return {
        "name": recording.name,
        "positives": pairs.positives,
        "negatives": len(pairs) - pairs.positives,
        "chosen_first": first_features(F, pairs.same),
        "missed_most": [
            (k, 100.0 * error) for k, error in removal_errors(F, pairs.same, rounds, seed=seed)[:5]
        ],
        "error_by_rounds": [
            (t, 100.0 * a, 100.0 * b)
            for t, a, b in round_curve(counts, (F[half], pairs.same[half]), (F[~half], pairs.same[~half]))
        ],
        "repetitive": alike,
        "mean_ratios": [None if np.isnan(value) else round(float(value), 3) for value in means],
        "deviation_ratios": [None if np.isnan(value) else round(float(value), 3) for value in deviations],
    }
