"""Parameters of the node `world_maintenance`."""

from __future__ import annotations

from dataclasses import fields

import numpy as np
from pydantic import create_model, model_validator

from estimation.errors import InputError
from whereabouts.parameters.from_config import settings_of
from whereabouts.parameters.parameter_base import NodeParameters, setting
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance import MaintenanceConfig

_taken = settings_of(MaintenanceConfig)
_WithMaintenance = create_model("_WithMaintenance", __base__=NodeParameters, **_taken)  # type: ignore[call-overload]


class WorldMaintenanceParameters(_WithMaintenance):  # type: ignore[valid-type, misc]
    """Parameters of `world_maintenance`: its own, and the settings of `MaintenanceConfig`."""

    public = (
        "map_frame", "base_frame", "navigate", "search_for_lost", "information_gain_threshold", "speed",
        "standoff", "arrival_distance", "task_timeout", "sensors", "sensor_range_max", "opening",
    )  # fmt: skip

    map_frame: str = setting("map", "frame of the world state, the map and the goals", fixed=True)
    base_frame: str = setting("base_link", "frame of the robot", fixed=True)
    rate: float = setting(1.0, "decisions per second", unit="Hz", ge=0.05, le=20.0, fixed=True)
    sensors: list[str] = setting(["camera"], "names of the sensors that can verify", fixed=True)
    sensor_range_min: list[float] = setting([0.4], "shortest range of each sensor, m", fixed=True)
    sensor_range_max: list[float] = setting([2.0], "longest range of each sensor, m", fixed=True)
    sensor_sigma: list[float] = setting(
        [0.05], "standard deviation of each sensor's positions per axis, m", fixed=True
    )
    sensor_cost: list[float] = setting(
        [0.0], "cost of an observation by each sensor, in metres of driving", fixed=True
    )
    opening: float = setting(
        6.2832, "field of view of the sensors (full angle)", unit="rad", ge=0.05, le=6.2832, fixed=True
    )
    class_names: list[str] = setting([""], "classes with a threshold and a weight of their own", fixed=True)
    class_values: list[float] = setting([0.0], "their thresholds, nat", fixed=True)
    class_weights: list[float] = setting([1.0], "their weights on the gain", fixed=True)
    arrival_distance: float = setting(
        0.3, "a goal counts as reached within this distance", unit="m", ge=0.05, le=5.0
    )
    task_timeout: float = setting(
        120.0, "a goal not reached in this time is given up for a while", unit="s", ge=1.0, le=3600.0
    )
    verify_timeout: float = setting(5.0, "time limit for the verifier", unit="s", ge=0.1, le=120.0)
    looks_before_lost: int = setting(
        2, "an object is lost after this many failed observations, each from nearer", ge=1, le=10
    )
    search_for_lost: bool = setting(False, "ask object_search to find lost objects", fixed=True)
    navigate: bool = setting(False, "send goals to nav2's navigate_to_pose as well", fixed=True)

    @model_validator(mode="after")
    def together(self) -> WorldMaintenanceParameters:
        """Lists of one length, and what the library says."""
        count = len(self.sensors)
        for name in ("sensor_range_min", "sensor_range_max", "sensor_sigma", "sensor_cost"):
            if len(getattr(self, name)) != count:
                raise ValueError(f"{name}: {count} numbers expected, one for each of sensors")
        if not len(self.class_names) == len(self.class_values) == len(self.class_weights):
            raise ValueError(
                "class_names, class_values, class_weights: as many of one as of the others expected"
            )
        try:
            _ = self.maintenance, self.sensor_models
        except InputError as error:
            raise ValueError(str(error)) from error
        return self

    @property
    def maintenance(self) -> MaintenanceConfig:
        """The library's settings. Raises InputError."""
        own = {name: value for name, value in zip(self.class_names, self.class_values, strict=True) if name}
        weights = {
            name: value for name, value in zip(self.class_names, self.class_weights, strict=True) if name
        }
        given = {
            item.name: getattr(self, item.name) for item in fields(MaintenanceConfig) if item.name in _taken
        }
        return MaintenanceConfig(class_thresholds=own, class_weights=weights, **given)

    @property
    def sensor_models(self) -> list[Sensor]:
        """Raises InputError."""
        return [
            Sensor(name, low, high, sigma**2 * np.eye(3), cost)
            for name, low, high, sigma, cost in zip(
                self.sensors, self.sensor_range_min, self.sensor_range_max, self.sensor_sigma, self.sensor_cost,
                strict=True,
            )
        ]  # fmt: skip
