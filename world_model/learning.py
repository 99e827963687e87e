"""The probabilistic models from a recorded log: what section 2.7 asks for next.

The log is explained with the models known so far; what this says about every detection gives the models, and that is
repeated. Only what the log shows is learned: rates of events that never happened keep their setting.
"""

from __future__ import annotations

import itertools
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from world_model.anchoring.loops.kernels import clearance
from world_model.anchoring.unseen import sensor_array
from world_model.config import WorldModelConfig
from world_model.evidence import SensorCone, WorldEvidence
from world_model.model import WorldModel
from world_model.state import SURE, WorldObject

FEWEST_LOOKS = 20
MARGIN = 0.15  # m inside the field of view from which an object must have been visible
SETTLED_SECONDS = 2.0  # what appears later than this after the first look is new


@dataclass(frozen=True)
class Learned:
    """config : the settings with what was learned. covariances : (3, 3) m² of a detection by class.
    by_class : probability of detection by class. detections, objects, seconds : what it was learned from.
    """

    config: WorldModelConfig
    covariances: dict[str, FloatArray]
    by_class: dict[str, float]
    detections: int
    objects: int
    seconds: float


@dataclass
class _History:
    """One object through the log: its class and per look in view whether it was detected; residuals' sources."""

    kind: str
    first: float
    seen: list[bool] = field(default_factory=list)
    positions: list[FloatArray] = field(default_factory=list)
    moved: bool = False


def learn(
    looks: Sequence[tuple[float, WorldEvidence]], config: WorldModelConfig | None = None, rounds: int = 2
) -> Learned:
    """Detection probability, runs of misses, clutter, new-object rate and covariances from (stamp, evidence).

    Raises InputError for fewer than 20 looks.
    """
    if len(looks) < FEWEST_LOOKS:
        raise InputError(f"looks: at least {FEWEST_LOOKS} are needed to learn from, got {len(looks)}")
    learned = config or WorldModelConfig()
    for _ in range(max(rounds, 1)):
        result = _round(looks, learned)
        learned = result.config
    return result


def _round(looks: Sequence[tuple[float, WorldEvidence]], config: WorldModelConfig) -> Learned:
    model = WorldModel(config)
    histories: dict[str, _History] = {}
    false = detections = 0
    start = looks[0][0]
    for stamp, evidence in looks:
        state = model.update(evidence, stamp)
        found = {name: j for j, name in enumerate(state.associations) if name is not None}
        detections += len(state.associations)
        false += state.associations.count(None)
        view = None if evidence.sensor is None else sensor_array(SensorCone.checked(evidence.sensor))
        for item in state.objects:
            history = histories.setdefault(item.id, _History("", item.first_seen))
            history.kind = item.most_probable("class")
            history.moved |= item.behaviors.get("constant_velocity", 0.0) > 0.5
            if item.id in found:
                history.positions.append(np.asarray(evidence.objects[found[item.id]].position, dtype=float))
            if _must_be_visible(item, view, evidence):
                history.seen.append(item.id in found)
    lasting = [replace(h, seen=_until_last(h.seen)) for h in histories.values() if len(h.positions) >= 5]
    seconds = max(looks[-1][0] - start, 1e-9)
    seen = [hit for h in lasting for hit in h.seen]
    changes: dict[str, Any] = {}
    if len(seen) >= FEWEST_LOOKS:
        changes["detection_probability"] = _allowed("detection_probability", np.mean(seen))
        changes["missed_run_frames"] = _mean_run([h.seen for h in lasting])
    # Every lasting object was unnamed at its first detections, which were not clutter.
    unnamed = len(lasting) if config.clutter_per_frame > 1.0 else 0
    changes["clutter_per_frame"] = max(false - unnamed, 0) / len(looks)
    new = sum(h.first > start + SETTLED_SECONDS for h in lasting)
    if new:
        changes["new_objects_per_second"] = new / seconds
    changes["initial_objects"] = max(float(len(lasting) - new), 1.0)
    changes["sensor_bias"] = model.sensor_bias
    changes["rate_hz"] = _allowed("rate_hz", (len(looks) - 1) / seconds)
    covariances = _covariances(lasting)
    if covariances:
        spread = np.mean([np.trace(P) / 3.0 for P in covariances.values()])
        changes["measurement_sigma"] = _allowed("measurement_sigma", np.sqrt(spread))
    hits: defaultdict[str, Counter[bool]] = defaultdict(Counter)
    for history in lasting:
        hits[history.kind].update(history.seen)
    by_class = {kind: count[True] / count.total() for kind, count in hits.items() if count.total()}
    return Learned(replace(config, **changes), covariances, by_class, detections, len(lasting), seconds)


def _must_be_visible(item: WorldObject, view: FloatArray | None, evidence: WorldEvidence) -> bool:
    if evidence.blocked or item.lost:
        return False
    if evidence.view is not None:
        spread = np.sqrt(np.asarray(item.covariance).diagonal().max(keepdims=True))
        return bool(evidence.view.seen(item.position[None], spread, np.array([np.nan]))[0] > SURE)
    if view is None:
        return len(evidence.objects) > 0
    return min(clearance(item.position, view, True), clearance(item.position, view, False)) > MARGIN


def _until_last(seen: list[bool]) -> list[bool]:
    """Without the misses after the last detection: the object may have been gone."""
    last = max((k for k, hit in enumerate(seen) if hit), default=-1)
    return seen[: last + 1]


def _allowed(name: str, value: Any) -> float:
    """A number within the range of a setting."""
    about = WorldModelConfig.__dataclass_fields__[name].metadata
    return float(np.clip(value, about["low"], about["high"]))


def _mean_run(sequences: list[list[bool]]) -> float:
    """Mean length of the runs of misses, at least one look; each sequence ends with a hit."""
    runs = [sum(1 for _ in run) for seen in sequences for hit, run in itertools.groupby(seen) if not hit]
    return _allowed("missed_run_frames", np.mean(runs)) if runs else 1.0


def _covariances(histories: list[_History]) -> dict[str, FloatArray]:
    """Pooled scatter about each resting object's mean, by class; robust against a false association."""
    by_class: defaultdict[str, list[FloatArray]] = defaultdict(list)
    for history in histories:
        if history.moved or len(history.positions) < 10:
            continue
        positions = np.array(history.positions)
        off = positions - np.median(positions, axis=0)
        limit = 6.0 * np.maximum(np.median(np.abs(off), axis=0), 1e-6)
        kept = positions[(np.abs(off) < limit).all(1)]
        by_class[history.kind].append((kept - kept.mean(0)) * np.sqrt(len(kept) / max(len(kept) - 1, 1)))
    residuals = {kind: np.concatenate(parts) for kind, parts in by_class.items()}
    return {kind: off.T @ off / len(off) for kind, off in residuals.items()}
