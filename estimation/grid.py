"""The name by which users import `estimation.geometry.grid`."""

from estimation.geometry.grid import (
    FARTHEST,
    FARTHEST_CELL,
    MOST_CELLS,
    ROOM,
    SIGNATURE,
    Mask,
    OccupancyGrid,
    is_grid_file,
    placed_scan,
)

__all__ = [
    "FARTHEST",
    "FARTHEST_CELL",
    "MOST_CELLS",
    "ROOM",
    "SIGNATURE",
    "Mask",
    "OccupancyGrid",
    "is_grid_file",
    "placed_scan",
]
