"""Settings of maintenance, and what each look at each object is expected to bring by looking ahead: (3.6), (3.9)."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from estimation.checks import FloatArray
from estimation.errors import InputError
from estimation.settings import check_settings, setting
from world_model.tasks.looks import Looks
from world_model.tasks.maintenance_kernels import path_gain, shortest_way, single_gains
from world_model.tasks.ways import Way, Ways

NEARER = 0.6  # of the stand-off after each look that was in vain
EXACT = 64  # actions that are looked ahead for; of more, those that promise most
TOUR = 10  # objects on a tour at most: the shortest way through more takes too long to find
View = float | Mapping[str, Any] | Callable[[FloatArray], bool]
# Table 3.1: before grabbing or going to an object its position is refined; going to a place or letting go needs none.
VERIFIED_ACTIONS = ("grab", "navigate_to_object")


@dataclass(frozen=True)
class MaintenanceConfig:
    """Settings of `Maintenance`; each field's metadata has its unit, meaning and allowed range.

    class_thresholds, class_weights : {class: value} that replace the threshold and multiply the gain.
    verified_actions : names of actions before which their object is looked at (Table 3.1).
    """

    information_gain_threshold: float = setting(
        8.0, "nat", "actions that gain less than this are not taken", 0.0, 1e6
    )
    weight: float = setting(0.75, "", "weight of the cost against the gain (ω)", 0.0, 1e6)
    information_gain_norm: float = setting(
        5.0, "nat", "information gain that has utility 1 (IG_norm)", 1e-6, 1e6
    )
    cost_scale: float = setting(
        10.0, "m", "distance that costs 1 (C_scale); use the room's length", 1e-3, 1e6
    )
    speed: float = setting(0.5, "m/s", "mean speed of the robot", 1e-3, 100.0)
    time_step: float = setting(0.5, "s", "time between observations on the way", 1e-3, 3600.0)
    company: float = setting(0.1, "", "how much objects seen on the way add to an action's utility", 0.0, 1.0)
    tour: float = setting(
        0.35,
        "",
        "an object joins a tour from this share of the threshold on; 0 plans one object at a time",
        0.0,
        1.0,
    )
    anticipation: float = setting(
        0.75, "", "share of the entropy's growth until the observation that counts as gain", 0.0, 1.0
    )
    standoff: float = setting(
        0.82, "", "distance at which to observe an object, as share of the sensor's range", 0.05, 1.0
    )
    retry_after: float = setting(5.0, "s", "an occluded object is left alone for this long", 0.0, 1e6)
    process_noise: float = setting(
        1e-4, "m²/s", "growth of the position's variance for objects that state none", 0.0, 1e3
    )
    verified_actions: tuple[str, ...] = VERIFIED_ACTIONS
    class_thresholds: Mapping[str, float] = field(default_factory=dict)
    class_weights: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        check_settings(self)
        for name in ("class_thresholds", "class_weights"):
            for label, value in getattr(self, name).items():
                if not (math.isfinite(value) and value >= 0.0):
                    raise InputError(f"{name}[{label!r}]: a number of at least 0 expected, got {value!r}")


class Option(NamedTuple):
    """One action: to look at an object with a sensor, both by index. own, gain : nat, of that object and of all objects
    seen; seen : how many those are. length : m to drive. goal : (3,) x, y, yaw. utility : (3.9)."""

    item: int
    sensor: int
    own: float
    gain: float
    seen: int
    length: float
    goal: FloatArray
    utility: float


def options(
    config: MaintenanceConfig,
    looks: Looks,
    ways: Ways,
    able: Sequence[int],
    view: View | None,
    base_available: bool,
    misses: Mapping[str, int],
) -> list[Option]:
    """Actions for the objects `able`, by index, the most useful first; of very many only those that promise most.

    misses : by object id, looks in a row that were in vain: it is looked at from nearer and another side.
    """
    pairs = [(k, s) for k in able for s in range(len(looks.sensors))]
    if not base_available:
        here = ways.pose
        pairs = [(k, s) for k, s in pairs if looks.reaches(k, s, here) and looks.in_view(k, here, view)]
    if len(pairs) > EXACT:
        promise = _single_looks(config, looks, ways)
        pairs = sorted(pairs, key=lambda pair: -promise[pair])[:EXACT]
    opening, found = looks.opening(view), []
    for k, s in pairs:
        item, sensor = looks.objects[k], looks.sensors[s]
        low, high, vain = sensor.range_min, sensor.range_max, misses.get(item.id, 0)
        way: Way | None = ways.stay()
        if base_available:
            way = ways.to_see(looks.positions[k, :2], low, high, NEARER**vain * config.standoff, vain > 0)
        if way is None:
            continue
        own, gain, seen = path_gain(
            k, way.sampled(config.speed * config.time_step), looks.positions, looks.P, looks.Q, looks.R[s], low, high,
            opening, config.time_step, config.anticipation,
        )  # fmt: skip
        if own > 0.0:
            worth = config.class_weights.get(item.most_probable("class"), 1.0) * own
            worth += config.company * (gain - own)
            cost = config.weight * (way.length + sensor.cost) / config.cost_scale
            utility = worth / config.information_gain_norm - cost
            found.append(Option(k, s, own, gain, seen, way.length, way.goal, utility))
    return sorted(found, key=lambda option: -option.utility)


def looked_at_now(looks: Looks) -> FloatArray:
    """(N,) nat: what one look at each object would bring here and now, by the sensor that brings most."""
    none = np.zeros(len(looks.objects))
    return np.max([single_gains(none, looks.P, looks.Q, R, 1.0, 1.0) for R in looks.R], axis=0)


def tour(looks: Looks, here: FloatArray, items: Sequence[int]) -> list[int]:
    """Objects, by index, in the order of the shortest way from `here` (2,) through them."""
    order = shortest_way(here[0], here[1], np.ascontiguousarray(looks.positions[list(items), :2]))
    return [items[k] for k in order]


def _single_looks(config: MaintenanceConfig, looks: Looks, ways: Ways) -> FloatArray:
    """Utility (N, S) of a single look at each object with each sensor after a straight drive."""
    away = np.hypot(*(looks.positions[:, :2] - ways.pose[:2]).T)
    utility = np.empty((len(looks.objects), len(looks.sensors)))
    for s, sensor in enumerate(looks.sensors):
        drive = np.maximum(away - config.standoff * sensor.range_max, 0.0)
        own = single_gains(drive, looks.P, looks.Q, looks.R[s], config.speed, config.anticipation)
        cost = (drive + sensor.cost) / config.cost_scale
        utility[:, s] = own / config.information_gain_norm - config.weight * cost
    return utility
