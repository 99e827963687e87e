"""Training of place models on logs, with the card that goes into the file."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from estimation.errors import InputError
from evaluation.loops.loops_data import Reading, read_recording, simulated
from evaluation.loops.place_training import (
    CascadeConfig,
    Examples,
    Recording,
    examples,
    fit_cascade,
    train_plain,
)
from evaluation.loops.roc import Roc, roc
from evaluation.loops.training_clouds import judge_by_node, judge_by_place, train_clouds
from evaluation.parallel import each
from loop_closure.places.outlines import LENGTH
from loop_closure.places.pairs import PairRule, Pairs
from loop_closure.places.place_model import PlaceModel

Say = Callable[[str], None]
# Simulated floors are always among what is trained on: they are not what is asked about.
SIMULATED = "simulated floor"
# Two single scans of opposite headings have nothing in common to learn from.
SCAN_TURN = math.radians(45.0)
# At which a model is judged, m, and by how many pairs at most.
DISTANCES, POSITIVES, NEGATIVES = (1.0, 2.0, 3.0), 2000, 12_000


def train_on_logs(
    logs: Sequence[str],
    rule: PairRule,
    method: str = "best",
    local_map: float = LENGTH,
    rounds: int = 50,
    simulation: int = 0,
    seed: int = 0,
    judged: bool = True,
    pairs: int = 1200,
    say: Say = lambda text: None,
    finished: Callable[[PlaceModel], None] = lambda model: None,
    jobs: int = 1,
) -> PlaceModel:
    """A trained model with its card.

    method : "plain", the text's, or "best", the cascade for scans and wide boosting for clouds.
    simulation : simulated floors to train on besides. judged : also leave out one place at a time, for the card; as
    many trainings more. pairs : positive ones from each log; negative ones are six times as many. finished : called
    with the model before it is judged. jobs : processes that judge.

    Raises
    ------
    InputError : logs of which nothing can be learned.
    """
    first = read_recording(logs[0], Reading(local_map=0.0))
    if first.dimension == 3:
        return _train_clouds(logs, rule, method, rounds, seed, judged)
    if method == "plain":
        recordings = _read(logs, 0.0, simulation, say)
        say("boosting")
        scans = replace(rule, max_turn=min(rule.max_turn, SCAN_TURN))
        model = train_plain(recordings, scans, rounds, seed=seed)
        return replace(model, card=_card(recordings, method, scans, 0.0))
    config = CascadeConfig(
        rule=rule, positives=pairs, negatives=4 * pairs, hard=2 * pairs, pool=32 * pairs, seed=seed
    )
    sets, recordings = prepare(logs, config, local_map, simulation, say)
    say("boosting")
    model = fit_cascade(sets, config)
    card = _card(recordings[: len(logs) + simulation], method, rule, local_map)
    card["grades_m"] = [round(share * rule.distance, 6) for share in config.grades]
    finished(replace(model, card=card))
    if judged and len({s.environment for s in sets} - {SIMULATED}) > 2:
        say("judging by leaving out one place at a time")
        card["left_out"] = left_out(sets, recordings, config, jobs=jobs)
    return replace(model, card=card)


def prepare(
    logs: Sequence[str],
    config: CascadeConfig,
    local_map: float,
    simulation: int,
    say: Say = lambda text: None,
) -> tuple[list[Examples], list[Recording]]:
    """Examples of single scans, and of local maps where `local_map` is above 0, of all logs and simulated floors."""
    sets: list[Examples] = []
    recordings: list[Recording] = []
    scans = replace(config, rule=replace(config.rule, max_turn=min(config.rule.max_turn, SCAN_TURN)))
    for length, settings in [(0.0, scans)] + [(local_map, config)] * (local_map > 0.0):
        for recording in _read(logs, length, simulation, say):
            say(f"comparing places of {recording.name}")
            sets.append(examples(recording, settings))
            recordings.append(recording)
    return sets, recordings


def left_out(
    sets: Sequence[Examples],
    recordings: Sequence[Recording],
    config: CascadeConfig,
    jobs: int = 1,
) -> list[dict[str, Any]]:
    """D in % at 0, 0.1 and 1 % FA on each recording, by a model trained without its environment.

    sets, recordings : as `prepare` gives them, single scans first. One model judges at all distances: its positive
    pairs are those nearer than each, its negative ones random pairs that are not. jobs : as of `parallel.each`.
    """
    single = len(recordings) // 2 if len({r.name for r in recordings}) < len(recordings) else len(recordings)
    environments = list(dict.fromkeys(s.environment for s in sets if s.environment != SIMULATED))
    calls = [
        (
            [s for s in sets if s.environment != environment],
            [(k < single, r) for k, r in enumerate(recordings) if r.environment == environment],
            config,
        )
        for environment in environments
    ]
    return [row for rows in each(_left_out_place, calls, jobs) for row in rows]


def _left_out_place(
    others: Sequence[Examples], own: Sequence[tuple[bool, Recording]], config: CascadeConfig
) -> list[dict[str, Any]]:
    """What a model trained on the other places reaches on those of one, each told whether it is of single scans."""
    model, found = fit_cascade(others, config), []
    for alone, recording in own:
        turn = SCAN_TURN if alone else config.rule.max_turn
        kinds = "scans, 45°" if alone else f"local maps, {math.degrees(turn):.0f}°"
        for distance, curve in zip(DISTANCES, _curves(model, recording, config, turn), strict=True):
            figures = {"log": recording.name, "places": kinds, "distance_m": distance}
            found.append({**figures, "positives": curve.positives, "detection": rates(curve)})
    return found


def _curves(model: PlaceModel, recording: Recording, config: CascadeConfig, turn: float) -> list[Roc]:
    """Curves at several distances; every pair is scored once. Negative are all pairs that are not positive."""
    rules = [replace(config.rule, distance=distance, max_turn=turn, apart=0.0) for distance in DISTANCES]
    near = [recording.pairs(rule, 0, POSITIVES, config.seed) for rule in rules]
    far = recording.pairs(rules[0], NEGATIVES, 0, config.seed)
    pairs = Pairs(
        *(np.concatenate([getattr(p, f) for p in (*near, far)]) for f in ("first", "second", "same"))
    )
    scores = model.score_pairs(recording.places, pairs)
    apart = np.linalg.norm(recording.poses[far.first, :2] - recording.poses[far.second, :2], axis=1)
    ends = np.cumsum([len(p) for p in near])
    curves = []
    for k, distance in enumerate(DISTANCES):
        true = scores[ends[k] - len(near[k]) : ends[k]]
        false = scores[ends[-1] :][apart >= distance]
        curves.append(roc(np.concatenate((true, false)), np.repeat([1, 0], [len(true), len(false)])))
    return curves


def rates(curve: Roc) -> list[float]:
    """D in %, one decimal, at 0, 0.1 and 1 % FA."""
    return [round(rate, 1) for rate in curve.rates]


def _read(logs: Sequence[str], length: float, simulation: int, say: Say) -> list[Recording]:
    reading = Reading(local_map=length)
    recordings = []
    for log in logs:
        say(f"reading {log}")
        recordings.append(read_recording(log, reading))
    for seed in range(simulation):
        say(f"simulating floor {seed}")
        recordings.append(simulated(seed, reading))
    return recordings


def _train_clouds(
    logs: Sequence[str], rule: PairRule, method: str, rounds: int, seed: int, judged: bool
) -> PlaceModel:
    recordings = [read_recording(log) for log in logs]
    if any(recording.dimension != 3 for recording in recordings):
        raise InputError("logs: scans and clouds cannot be mixed")
    rule = replace(rule, max_turn=math.pi)
    card = _card(recordings, method, rule, 0.0)
    if method == "plain":
        return replace(train_plain(recordings, rule, rounds, seed=seed), card=card)
    if len(recordings) > 1:
        raise InputError("logs: the model for clouds is trained on one log, cut into places")
    if judged:
        card["by_node"] = _summary(judge_by_node(recordings[0], rule, seed=seed))
        card["by_place"] = _summary(judge_by_place(recordings[0], rule, seed=seed))
    return replace(train_clouds(recordings[0], rule, seed=seed), card=card)


def _summary(found: dict[str, list[Roc]]) -> dict[str, Any]:
    return {
        name: {
            "mean": [round(float(value), 1) for value in np.mean([rates(c) for c in curves], axis=0)],
            "folds": [rates(curve) for curve in curves],
            "average_precision": round(float(np.mean([c.average_precision for c in curves])), 3),
        }
        for name, curves in found.items()
    }


def _card(recordings: Sequence[Recording], method: str, rule: PairRule, local_map: float) -> dict[str, Any]:
    return {
        "method": method,
        "trained_on": [recording.name for recording in recordings],
        "environments": list(dict.fromkeys(recording.environment for recording in recordings)),
        "places": [len(recording.places) for recording in recordings],
        "distance_m": rule.distance,
        "apart_m": max(rule.apart, rule.distance),
        "path_gap_m": rule.path_gap,
        "index_gap": rule.index_gap,
        "heading_deg": round(math.degrees(rule.max_turn), 1),
        "local_map_m": local_map,
    }
