"""Parameters of the node `world_model`."""

from __future__ import annotations

from pathlib import Path

from pydantic import field_validator

from estimation.errors import InputError
from estimation.geometry.places import Places
from whereabouts.parameter_file import read_yaml
from whereabouts.parameters.parameter_base import BaseFrame, FileParameters, MapFrame, setting, setting_of
from whereabouts.system.clocks import NANOSECONDS, TOLERANCE
from world_model import WorldModelConfig
from world_model.symbols import Symbols, default_symbols

# s: what comes later than that is not of the node's time (`whereabouts.system.clocks`).
LATEST = 2 * TOLERANCE / NANOSECONDS


class WorldModelParameters(MapFrame, BaseFrame, FileParameters):
    """Parameters of `world_model`."""

    public = (
        "classes", "colors", "region", "places_file", "behaviors_file", "store_path", "depth_from_scan", "rate_hz",
        "detection_probability", "clutter_per_frame", "class_accuracy", "measurement_sigma",
    )  # fmt: skip

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
    detections_topic: str = setting("detections", "topic of detections in space", fixed=True)
    detections_2d_topic: str = setting("detections_2d", "topic of boxes in the camera's image", fixed=True)
    camera_info_topic: str = setting("camera_info", "topic of the camera's lens", fixed=True)
    depth_topic: str = setting("depth", "topic of depth images, registered to the camera's image", fixed=True)
    depth_from_scan: bool = setting(
        False,
        "how far away things are, and what hides them, comes from scan_topic, not depth_topic",
        fixed=True,
    )
    scan_topic: str = setting("scan", "topic of the planar scanner, for depth_from_scan", fixed=True)
    camera_rectified: bool = setting(
        False, "detections are in straightened images: of camera_info counts P alone", fixed=True
    )

    rate_hz: float = setting_of(WorldModelConfig, "rate_hz")
    detection_probability: float = setting_of(WorldModelConfig, "detection_probability")
    clutter_per_frame: float = setting_of(WorldModelConfig, "clutter_per_frame")
    class_accuracy: float = setting_of(WorldModelConfig, "class_accuracy")
    measurement_sigma: float = setting_of(WorldModelConfig, "measurement_sigma")
    missed_run_frames: float = setting_of(WorldModelConfig, "missed_run_frames")
    new_objects_per_second: float = setting_of(WorldModelConfig, "new_objects_per_second")
    removed_per_second: float = setting_of(WorldModelConfig, "removed_per_second")

    @field_validator("region")
    @classmethod
    def six_numbers(cls, region: list[float]) -> list[float]:
        if len(region) != 6:
            raise ValueError("six numbers expected: x from, x to, y from, y to, z from, z to")
        return region

    def check(self) -> None:
        """Raises InputError for what the library says about all of them."""
        _ = self.world

    @property
    def world(self) -> WorldModelConfig:
        """The library's settings. Raises InputError, also for a file that cannot be read."""
        x0, x1, y0, y1, z0, z1 = self.region
        return self.config_of(
            WorldModelConfig,
            classes=[name for name in self.classes if name],
            colors=[name for name in self.colors if name],
            attributes=[name for name in self.attributes if name],
            region=((x0, x1), (y0, y1), (z0, z1)),
            motion=read_yaml(Path(self.behaviors_file), InputError) if self.behaviors_file else None,
            late_window=LATEST,
        )

    @property
    def places(self) -> Places:
        """Rooms and furniture. Raises InputError naming file and place."""
        return Places.load(self.places_file) if self.places_file else Places()

    @property
    def symbols(self) -> Symbols:
        """Raises InputError naming file and symbol."""
        return Symbols.load(self.predicates_file) if self.predicates_file else default_symbols()
