"""Settings of the world model: what a deployment may know about its objects, its sensor and its world.

Behaviour models per class (M of section 2.4.2) are in the settings or in `defaults/classes.yaml`.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from typing import Any

import numpy as np
import yaml

from estimation.checks import FloatArray, as_finite, require_kind
from estimation.errors import InputError
from estimation.settings import check_settings, setting
from world_model.calibration.sensor_bias import CONSTANT, NAMES
from world_model.state import Box

CARRY_SPEED = 0.7  # m/s: at which things are carried, standard deviation
MOST = 1e6  # Of rates and deviations
FREE_RUN = 10.0
"""s: a mover seen for the first time has the speed that its accelerations add up to in this time."""
SINGLE = 0.5  # Share of the misses of movers that come one at a time
SHORTEST, LONGEST = 5.0, 20.0
"""Looks that hide a mover in one run, mean: what passes before it decides, and a setting only within these bounds."""


@dataclass(frozen=True)
class Motion:
    """Behaviour of one class."""

    model: str = setting("static", "", "how it moves", choices=("static", "constant_velocity"))
    accel_sigma: float = setting(0.5, "m/s^1.5", "root of its white acceleration density", 0.0, MOST)
    moved_per_second: float = setting(1e-4, "1/s", "rate of being carried anywhere", 0.0, MOST)
    follows_prediction: float = setting(
        0.8, "", "probability that a mover keeps to the path that is predicted for it", 0.0, 1.0
    )
    usual_place: float = setting(
        0.5, "", "probability that what was taken away is where it usually is at that time of day", 0.0, 1.0
    )
    turn_sigma: float = setting(0.0, "rad/s^0.5", "diffusion of a mover's heading at its speed", 0.0, MOST)

    @classmethod
    def checked(cls, name: str, given: Mapping[str, Any]) -> Motion:
        """Raises InputError naming class and field."""
        if not isinstance(given, Mapping):
            raise InputError(f"motion[{name!r}] must be a mapping, not {given!r}")
        unknown = set(given) - set(cls.__dataclass_fields__)
        if unknown:
            raise InputError(f"motion[{name!r}] has unknown fields {sorted(unknown)}")
        # What moves by itself is carried by nobody, unless a deployment says so.
        carried = {} if given.get("model", "static") == "static" else {"moved_per_second": 0.0}
        made = cls(**{**carried, **given})
        try:
            check_settings(made)
        except InputError as error:
            raise InputError(f"motion[{name!r}].{error}") from error
        return made


@cache
def default_motion() -> Mapping[str, Mapping[str, Any]]:
    """The shipped knowledge base: {class or "*": {...}}."""
    return yaml.safe_load(files("world_model").joinpath("defaults/classes.yaml").read_text(encoding="utf-8"))


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


@dataclass(frozen=True)
class WorldModelConfig:
    """Settings of `WorldModel`; each field's metadata has its unit, meaning and allowed range.

    classes and colors : known names; () takes any name as it comes. region : ((x0, x1), (y0, y1), (z0, z1)) m.
    motion : {class or "*": {"model": "static" | "constant_velocity", "accel_sigma": m/s^1.5,
    "moved_per_second": 1/s, "follows_prediction": probability, "turn_sigma": rad/s^0.5}}; None takes
    `defaults/classes.yaml`. Raises InputError naming the field.
    """

    classes: Sequence[str] = setting((), "", "names of known classes; an empty list allows any")
    colors: Sequence[str] = setting((), "", "names of known colours; an empty list allows any")
    region: Box = field(
        default=((-10.0, 10.0), (-10.0, 10.0), (-0.5, 3.0)),
        metadata={"unit": "m", "description": "where objects and false detections can be, by axis"},
    )
    rate_hz: float = setting(20.0, "1/s", "observations per second", 0.01, 1000.0)
    detection_probability: float = setting(
        0.9, "", "probability that a visible object is detected", 0.01, 0.9999
    )
    clutter_per_frame: float = setting(0.2, "", "mean number of false detections per observation", 0.0, 1e4)
    # Both rates are set on days 300 to 307 of the simulated apartment. Lower ones change little more there, and of many
    # landmarks fewer are known again.
    new_objects_per_second: float = setting(
        5e-3, "1/s", "mean number of objects that appear in the region per second", 1e-9, 1e4
    )
    removed_per_second: float = setting(1e-4, "1/s", "rate at which an object is taken away", 0.0, 100.0)
    initial_objects: float = setting(
        10.0, "", "expected number of objects in the region at the start", 1e-6, 1e5
    )
    measurement_sigma: float = setting(
        0.03, "m", "standard deviation of a detection without covariance", 1e-4, 100.0
    )
    class_accuracy: float = setting(
        0.9, "", "share of detections whose most probable class is right", 0.05, 1.0
    )
    missed_run_frames: float = setting(
        1.0,
        "",
        "mean number of observations in a row that miss a visible object; of movers, 5 to 20 count",
        1.0,
        1e4,
    )
    motion: Mapping[str, Mapping[str, Any]] | None = setting(None, "", "motion by class; * for all others")
    hypotheses: int = setting(100, "", "number of hypotheses that are kept", 1, 10000)
    late_window: float = setting(
        1.0,
        "s",
        "a stamp this far behind the newest is late and handled; further back is a new run",
        0.0,
        60.0,
    )
    attributes: Sequence[str] = setting(
        ("shape", "size", "material"), "", "discrete attributes besides class and color"
    )
    quantities: Mapping[str, tuple[float, float]] = field(
        default_factory=lambda: {"size": (0.3, 0.3), "ratio": (1.0, 0.7)}
    )
    """Continuous attributes: {name: (mean, standard deviation) over all objects}, SI units."""
    merged_detections: bool = setting(True, "", "one detection may come from two moving objects that touch")
    sensor_bias: Sequence[float] = setting(
        (0.0,) * CONSTANT,
        "",
        "systematic errors of detections at distance d and bearing b off the axis, (offset, scale, "
        "depth, turn, lean, stretch, bend, delay) or the first of them: offset + scale d + depth d b²/2 + lean d b "
        "along the line of sight, m, turn d + stretch d b + bend d b² across it, and their age at their stamp, s; "
        "where learning starts from",
    )
    learn_sensor_bias: bool = setting(
        True,
        "",
        "whether to watch a moving sensor for systematic errors in what it says about resting "
        "objects, and to correct them once several objects show them clearly; for one sensor",
    )

    def __post_init__(self) -> None:
        check_settings(self)
        if int(self.hypotheses) != self.hypotheses:
            raise InputError(f"hypotheses: a whole number expected, got {self.hypotheses!r}")
        for name in ("classes", "colors", "attributes"):
            values = getattr(self, name)
            require_kind(name, values, Collection)
            if isinstance(values, str) or not all(isinstance(value, str) and value for value in values):
                raise InputError(f"{name} must be a list of names, not {values!r}")
            if len(set(values)) != len(values):
                raise InputError(f"{name} must not repeat a name: {values!r}")
        shape = as_finite("sensor_bias", self.sensor_bias).shape
        if len(shape) != 1 or not 4 <= shape[0] <= CONSTANT:
            raise InputError(
                f"sensor_bias must be 4 to {CONSTANT} numbers, {', '.join(NAMES)}, not {self.sensor_bias!r}"
            )
        region = as_finite("region", self.region)
        if (
            region.shape != (3, 2)
            or (region[:, 0] > region[:, 1]).any()
            or (region[:2, 0] == region[:2, 1]).any()
        ):
            raise InputError(f"region must be ((x0, x1), (y0, y1), (z0, z1)), ascending, not {self.region!r}")
        require_kind("quantities", self.quantities, Mapping)
        for name, usual in self.quantities.items():
            pair = as_finite(f"quantities[{name!r}]", usual)
            if pair.shape != (2,) or pair[1] <= 0.0:
                raise InputError(
                    f"quantities[{name!r}] must be (mean, standard deviation above 0), not {usual!r}"
                )
        if self.motion is not None:
            if not isinstance(self.motion, Mapping):
                raise InputError(f"motion must be {{class or '*': {{...}}}}, not {self.motion!r}")
            for name, given in self.motion.items():
                Motion.checked(name, given)
                if self.classes and name != "*" and name not in self.classes:
                    raise InputError(f"motion names class {name!r}, which is not one of {list(self.classes)}")


def detector_table(config: WorldModelConfig) -> FloatArray:
    """(2, 5) as `world_model.anchoring.loops.gating.weigh` takes it: for what rests, and for what moves by itself.

    Columns: share of looks outside of runs of misses, p_D there, eigenvalue per look of the chain of the two states,
    looks per second, rate of removal, 1/s. In the long run p_D is `config.detection_probability`.
    """
    detection = config.detection_probability
    run = max(config.missed_run_frames, 1.0 / detection)
    hidden = max(min(max(run, SHORTEST), LONGEST), 1.0 / detection)
    rows = []
    for length, single in ((run, 0.0), (hidden, SINGLE)):
        apart = 1.0 - (1.0 - detection) * single
        share = detection / apart
        fade = 1.0 - 1.0 / length - (1.0 - share) / (share * length)
        rows.append([share, apart, fade, config.rate_hz, config.removed_per_second])
    return np.array(rows)
