"""Parameters of the node `world_model`."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path

import yaml
from pydantic import create_model, field_validator, model_validator

from estimation.errors import InputError
from estimation.geometry.places import Places
from whereabouts.parameters.from_config import settings_of
from whereabouts.parameters.parameter_base import FileParameters, setting
from whereabouts.system.clocks import SECOND, TOLERANCE
from world_model import WorldModelConfig
from world_model.memory.store import LIMIT
from world_model.symbols import Symbols, default_symbols

# s: what comes later than that is not of the node's time (`whereabouts.system.clocks`).
LATEST = 2 * TOLERANCE / SECOND
# Those that ROS cannot express as they are, or that all nodes have.
_OTHERWISE = ("classes", "colors", "attributes", "region", "motion", "late_window", "sensor_bias")
_taken = {name: made for name, made in settings_of(WorldModelConfig).items() if name not in _OTHERWISE}
_WithWorld = create_model("_WithWorld", __base__=FileParameters, **_taken)  # type: ignore[call-overload]


class WorldModelParameters(_WithWorld):  # type: ignore[valid-type, misc]
    """Parameters of `world_model`: its own, and the settings of `WorldModelConfig`."""

    public = (
        "map_frame", "base_frame", "classes", "colors", "region", "places_file", "store_path",
        "depth_from_scan", "rate_hz", "detection_probability", "clutter_per_frame", "class_accuracy",
    )  # fmt: skip

    map_frame: str = setting("map", "frame of everything that is stored and published", fixed=True)
    base_frame: str = setting("base_link", "frame of the robot", fixed=True)
    classes: list[str] = setting([""], "known classes; [''] takes any name", fixed=True)
    colors: list[str] = setting([""], "known colours; [''] takes any name", fixed=True)
    attributes: list[str] = setting(
        ["shape", "size", "material"], "attributes with named values, besides class and color", fixed=True
    )
    region: list[float] = setting(
        [-10.0, 10.0, -10.0, 10.0, -0.5, 3.0],
        "region that holds all objects, in m: x from, x to, y from, y to, z from, z to",
        fixed=True,
    )
    behaviors_file: str = setting(
        "", "YAML file with the motion of each class; empty: world_model/defaults/classes.yaml", fixed=True
    )
    predicates_file: str = setting(
        "", "YAML file that defines symbols; empty: world_model/defaults/predicates.yaml", fixed=True
    )
    places_file: str = setting(
        "", "YAML with rooms and furniture, as world_model/defaults/home.yaml; empty: none", fixed=True
    )
    store_path: str = setting(
        "", "database file that keeps the world; empty: the world is forgotten when the node ends", fixed=True
    )
    history_limit: int = setting(
        LIMIT, "rows of history in the store; older ones are thinned out", ge=100, le=100_000_000, fixed=True
    )
    people_from_targets: bool = setting(True, "once targets arrive, ignore people in other evidence")
    target_period: float = setting(
        0.5,
        "shortest time between targets that are used; they are filtered, so those in between are not independent",
        unit="s",
        ge=0,
        le=10,
    )
    position_sigma: float = setting(
        0.03,
        "standard deviation of the robot's position per axis, until robot_pose arrives",
        unit="m",
        ge=0.0,
        le=10.0,
    )
    heading_sigma: float = setting(
        0.01,
        "standard deviation of the robot's heading, until robot_pose arrives",
        unit="rad",
        ge=0.0,
        le=1.0,
    )
    depth_from_scan: bool = setting(
        False, "how far away things are, and what hides them, comes from `scan`, not from `depth`", fixed=True
    )
    depth_tolerance: float = setting(
        0.05, "largest time between detections and the depth image or scan of them", unit="s", ge=0.0, le=1.0
    )
    camera_rectified: bool = setting(
        False, "detections are in straightened images: of camera_info counts P alone", fixed=True
    )
    recognised_pixels: float = setting(
        16.0,
        "apparent size at which the detector is taken to find half of the things, until it has shown how many",
        unit="px",
        fixed=True,
        ge=1.0,
        le=1000.0,
    )
    absence_period: float = setting(
        0.2,
        "shortest time between images whose missing detections count: pictures of the same view miss the same things",
        unit="s",
        ge=0.0,
        le=10.0,
    )
    hypotheses_period: float = setting(0.2, "time between published hypotheses", unit="s", ge=0.0, le=60.0)
    published_hypotheses: int = setting(20, "largest number of hypotheses in a message", ge=1, le=1000)

    @field_validator("region")
    @classmethod
    def six_numbers(cls, region: list[float]) -> list[float]:
        if len(region) != 6:
            raise ValueError("six numbers expected: x from, x to, y from, y to, z from, z to")
        return region

    @model_validator(mode="after")
    def together(self) -> WorldModelParameters:
        """What the library says about all of them."""
        try:
            _ = self.world
        except InputError as error:
            raise ValueError(str(error)) from error
        return self

    @property
    def world(self) -> WorldModelConfig:
        """The library's settings. Raises InputError, also for a file that cannot be read."""
        given = {
            item.name: getattr(self, item.name) for item in fields(WorldModelConfig) if item.name in _taken
        }
        x0, x1, y0, y1, z0, z1 = self.region
        return WorldModelConfig(
            classes=[name for name in self.classes if name],
            colors=[name for name in self.colors if name],
            attributes=[name for name in self.attributes if name],
            region=((x0, x1), (y0, y1), (z0, z1)),
            motion=_yaml(self.behaviors_file) if self.behaviors_file else None,
            late_window=LATEST,
            **given,
        )

    @property
    def places(self) -> Places:
        """Rooms and furniture. Raises InputError naming file and place."""
        return Places.load(self.places_file) if self.places_file else Places()

    @property
    def symbols(self) -> Symbols:
        """Raises InputError naming file and symbol."""
        return Symbols.load(self.predicates_file) if self.predicates_file else default_symbols()


def _yaml(path: str) -> dict[str, dict[str, object]]:
    try:
        given: dict[str, dict[str, object]] = yaml.safe_load(Path(path).read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise InputError(f"{path}: cannot be read: {error}") from error
    return given
