"""The name by which users import `estimation.geometry.grid`."""

from estimation.geometry.grid import Mask, OccupancyGrid, is_grid_file

__all__ = ["Mask", "OccupancyGrid", "is_grid_file"]
