"""Behaviour models per class (M of section 2.4.2), from the settings or from `defaults/classes.yaml`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import yaml

from estimation.checks import FloatArray
from world_model.config import Motion

CARRY_SPEED = 0.7  # m/s: at which things are carried, standard deviation
FREE_RUN = 10.0
"""s: a mover seen for the first time has the speed that its accelerations add up to in this time."""


@cache
def default_motion() -> Mapping[str, Mapping[str, Any]]:
    """The shipped knowledge base: {class or "*": {...}}."""
    given: Mapping[str, Mapping[str, Any]] = yaml.safe_load(
        files("world_model").joinpath("defaults/classes.yaml").read_text(encoding="utf-8")
    )
    return given


def motion_of(name: str, motion: Mapping[str, Mapping[str, Any]] | None) -> Motion:
    """Behaviour of a class; "*" and unknown ones take the default."""
    known = default_motion() if motion is None else motion
    return Motion.checked(name, known.get(name, known.get("*", {})))


def motion_table(classes: Sequence[str], motion: Mapping[str, Mapping[str, Any]] | None) -> FloatArray:
    """(C + 1, 6) as `world_model.anchoring.loops.kernels` takes it: the default last."""
    rows = []
    for name in [*classes, "*"]:
        given = motion_of(name, motion)
        moves = given.model == "constant_velocity"
        speed = given.accel_sigma * np.sqrt(FREE_RUN) if moves else CARRY_SPEED
        own = [float(moves), given.accel_sigma, given.moved_per_second, speed]
        rows.append([*own, given.follows_prediction, given.turn_sigma])
    return np.array(rows)
