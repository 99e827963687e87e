"""Parameters of the node `world_maintenance`."""

from __future__ import annotations

import numpy as np

from estimation.errors import InputError
from whereabouts.parameters.parameter_base import BaseFrame, MapFrame, setting, setting_of
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance import MaintenanceConfig


class WorldMaintenanceParameters(MapFrame, BaseFrame):
    """Parameters of `world_maintenance`."""

    public = (
        "navigate", "search_for_lost", "information_gain_threshold", "cost_scale", "speed", "standoff",
        "arrival_distance", "task_timeout", "sensors", "sensor_range_min", "sensor_range_max", "opening",
    )  # fmt: skip

    navigate: bool = setting(False, "send goals to nav2's navigate_to_pose as well", fixed=True)
    search_for_lost: bool = setting(False, "ask object_search to find lost objects", fixed=True)
    information_gain_threshold: float = setting_of(MaintenanceConfig, "information_gain_threshold")
    cost_scale: float = setting_of(MaintenanceConfig, "cost_scale")
    speed: float = setting_of(MaintenanceConfig, "speed")
    standoff: float = setting_of(MaintenanceConfig, "standoff")
    arrival_distance: float = setting(
        0.3, "a goal counts as reached within this distance", unit="m", ge=0.05, le=5.0
    )
    task_timeout: float = setting(
        120.0, "a goal not reached in this time is given up for a while", unit="s", ge=1.0, le=3600.0
    )
    sensors: list[str] = setting(["camera"], "names of the sensors that can verify", fixed=True)
    sensor_range_min: list[float] = setting([0.4], "shortest range of each sensor, m", fixed=True)
    sensor_range_max: list[float] = setting([2.0], "longest range of each sensor, m", fixed=True)
    opening: float = setting(
        6.2832, "field of view of the sensors (full angle)", unit="rad", ge=0.05, le=6.2832, fixed=True
    )
    sensor_sigma: list[float] = setting(
        [0.05], "standard deviation of each sensor's positions per axis, m", fixed=True
    )
    company: float = setting_of(MaintenanceConfig, "company")
    tour: float = setting_of(MaintenanceConfig, "tour")
    anticipation: float = setting_of(MaintenanceConfig, "anticipation")
    class_names: list[str] = setting([""], "classes with a threshold of their own", fixed=True)
    class_values: list[float] = setting([0.0], "their thresholds, nat", fixed=True)
    rate: float = setting(1.0, "decisions per second", unit="Hz", ge=0.05, le=20.0, fixed=True)
    verify_timeout: float = setting(5.0, "time limit for the verifier", unit="s", ge=0.1, le=120.0)

    def check(self) -> None:
        """Raises InputError: lists of several lengths, and for what the library says about all of them."""
        count = len(self.sensors)
        for name in ("sensor_range_min", "sensor_range_max", "sensor_sigma"):
            if len(getattr(self, name)) != count:
                raise InputError(f"{name}: {count} numbers expected, one for each of sensors")
        if len(self.class_names) != len(self.class_values):
            raise InputError("class_names, class_values: as many of one as of the other expected")
        _ = self.maintenance, self.sensor_models

    @property
    def maintenance(self) -> MaintenanceConfig:
        """The library's settings. Raises InputError."""
        own = {name: value for name, value in zip(self.class_names, self.class_values, strict=True) if name}
        return self.config_of(MaintenanceConfig, class_thresholds=own)

    @property
    def sensor_models(self) -> list[Sensor]:
        """Raises InputError."""
        return [
            Sensor(name, low, high, sigma**2 * np.eye(3))
            for name, low, high, sigma in zip(
                self.sensors, self.sensor_range_min, self.sensor_range_max, self.sensor_sigma, strict=True
            )
        ]
