"""Compiles, or loads from the cache, what maintenance runs, so that its first decision is as fast as others."""

from __future__ import annotations

from functools import cache

import numpy as np

from estimation.geometry.grid import OccupancyGrid
from world_model.state import WorldObject, WorldState
from world_model.tasks.looks import Sensor
from world_model.tasks.maintenance import Maintenance, MaintenanceConfig


@cache
def warm_up() -> None:
    """Let a throw-away maintenance plan a tour, on an empty floor and around what a map has; once per process."""
    objects = tuple(
        WorldObject(str(k), np.array([1.0 + k, 1.0, 0.0]), np.zeros(3), np.eye(3), {}, 1.0, False, 0.0)
        for k in range(3)
    )
    grid = OccupancyGrid.from_values(np.zeros((50, 50), dtype=np.int64), 0.1)
    for floor in (None, grid):
        maintenance = Maintenance(MaintenanceConfig(information_gain_threshold=0.1))
        pose, sensor = np.array([0.5, 1.0, 0.0]), Sensor("any", 0.1, 0.5, 0.01 * np.eye(3))
        maintenance.next_task(WorldState(objects, 1.0, 3.0, 0.0), pose, [sensor], grid=floor)
