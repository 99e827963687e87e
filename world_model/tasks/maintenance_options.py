"""What each look at each object is expected to bring, by looking ahead along the way there (3.6), (3.9)."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from estimation.checks import FloatArray
from world_model.tasks.looks import Looks
from world_model.tasks.maintenance_config import MaintenanceConfig
from world_model.tasks.maintenance_kernels import path_gain, shortest_way, single_gains
from world_model.tasks.ways import Ways

NEARER = 0.6  # of the stand-off after each look that was in vain
EXACT = 64  # actions that are looked ahead for; of more, those that promise most
TOUR = 10  # objects on a tour at most: the shortest way through more takes too long to find
View = float | Mapping[str, Any] | Callable[[FloatArray], bool]
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Options:
    """M actions. items, sensors : (M,) indices. own, gain : (M,) nat, of the object gone for and of all objects seen.

    seen : (M,) how many those are. lengths : (M,) m. goals : (M, 3) x, y, yaw. utility : (M,).
    """

    items: IntArray
    sensors: IntArray
    own: FloatArray
    gain: FloatArray
    seen: FloatArray
    lengths: FloatArray
    goals: FloatArray
    utility: FloatArray

    def __len__(self) -> int:
        return len(self.items)

    def best(self, able: npt.NDArray[np.bool_] | None = None) -> int:
        """Index of the largest utility, of those that are `able` (M,)."""
        worth = self.utility if able is None else np.where(able, self.utility, -np.inf)
        return int(np.argmax(worth))


def options(
    config: MaintenanceConfig,
    looks: Looks,
    ways: Ways,
    able: Sequence[int],
    view: View | None,
    base_available: bool,
    misses: Mapping[str, int],
) -> Options:
    """Actions for the objects `able`, by index; of very many only those that promise most.

    misses : by object id, looks in a row that were in vain: it is looked at from nearer and another side.
    """
    count = len(looks.sensors)
    items = np.repeat(np.asarray(able, dtype=np.int64), count)
    kinds = np.tile(np.arange(count), len(able))
    if not base_available:
        keep = [
            looks.reaches(k, s, ways.pose) and looks.in_view(k, ways.pose, view)
            for k, s in zip(items.tolist(), kinds.tolist(), strict=True)
        ]
        items, kinds = items[np.array(keep, dtype=bool)], kinds[np.array(keep, dtype=bool)]
    if len(items) > EXACT:
        items, kinds = _promising(config, looks, ways, items, kinds)
    vain = np.array([misses.get(looks.objects[k].id, 0) for k in items], dtype=np.int64)
    found, goals, lengths = _gains(config, looks, ways, items, kinds, vain, view, base_available)
    good = found[:, 0] > 0.0
    items, kinds, found, goals, lengths = items[good], kinds[good], found[good], goals[good], lengths[good]
    costs = np.array([sensor.cost for sensor in looks.sensors])[kinds]
    weights = np.array(
        [config.class_weights.get(looks.objects[k].most_probable("class"), 1.0) for k in items]
    )
    own, gain = found[:, 0], found[:, 1]
    worth = weights * own + config.company * (gain - own)
    utility = worth / config.information_gain_norm - config.weight * (lengths + costs) / config.cost_scale
    return Options(items, kinds, own, gain, found[:, 2], lengths, goals, utility)


def looked_at_now(looks: Looks) -> FloatArray:
    """(N,) nat: what one look at each object would bring here and now, by the sensor that brings most."""
    none = np.zeros(len(looks.objects))
    return np.max([single_gains(none, looks.P, looks.Q, R, 1.0, 1.0) for R in looks.R], axis=0)


def tour(looks: Looks, here: FloatArray, items: Sequence[int]) -> list[int]:
    """Objects, by index, in the order of the shortest way from `here` (2,) through them."""
    order = shortest_way(here[0], here[1], np.ascontiguousarray(looks.positions[list(items), :2]))
    return [items[k] for k in order]


def _gains(
    config: MaintenanceConfig, looks: Looks, ways: Ways, items: IntArray, kinds: IntArray, vain: IntArray,
    view: View | None, base_available: bool,
) -> tuple[FloatArray, FloatArray, FloatArray]:  # fmt: skip
    """Gains and how many are seen (M, 3), goals (M, 3), metres (M,); what cannot be seen brings nothing."""
    found, goals, lengths = np.zeros((len(items), 3)), np.zeros((len(items), 3)), np.zeros(len(items))
    opening = looks.opening(view)
    for m, (k, s) in enumerate(zip(items.tolist(), kinds.tolist(), strict=True)):
        low, high = looks.sensors[s].range_min, looks.sensors[s].range_max
        way = ways.stay()
        if base_available:
            share = NEARER ** int(vain[m]) * config.standoff
            there = ways.to_see(looks.positions[k, :2], low, high, share, bool(vain[m]))
            if there is None:
                continue
            way = there
        points = way.sampled(config.speed * config.time_step)
        found[m] = path_gain(
            k, points, looks.positions, looks.P, looks.Q, looks.R[s], low, high, opening, config.time_step,
            config.anticipation,
        )  # fmt: skip
        goals[m], lengths[m] = way.goal, way.length
    return found, goals, lengths


def _promising(
    config: MaintenanceConfig, looks: Looks, ways: Ways, items: IntArray, kinds: IntArray
) -> tuple[IntArray, IntArray]:
    """The `EXACT` actions of largest utility by a single look after a straight drive."""
    away = np.hypot(*(looks.positions[:, :2] - ways.pose[:2]).T)
    utility = np.empty((len(looks.objects), len(looks.sensors)))
    for s, sensor in enumerate(looks.sensors):
        drive = np.maximum(away - config.standoff * sensor.range_max, 0.0)
        own = single_gains(drive, looks.P, looks.Q, looks.R[s], config.speed, config.anticipation)
        cost = (drive + sensor.cost) / config.cost_scale
        utility[:, s] = own / config.information_gain_norm - config.weight * cost
    best = np.argsort(-utility[items, kinds], kind="stable")[:EXACT]
    return items[best], kinds[best]
