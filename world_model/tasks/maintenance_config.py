"""Settings of maintenance."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from estimation.errors import InputError
from estimation.settings import check_settings, setting

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
