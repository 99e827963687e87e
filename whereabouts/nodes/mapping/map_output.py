"""The map as nav2 takes it: whole on `map`, and on `map_updates` what has changed of that since."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid as GridMessage
from numpy.typing import NDArray
from std_msgs.msg import Header

from estimation.geometry.grid_kernels import TILE
from estimation.geometry.tiles import VIEW_CELLS, TileView
from loop_closure.maps.map_grid import MapGrid
from whereabouts.nodes.messages.map_messages import grid_message, update_message
from whereabouts.nodes.ros.qos import LATCHED

if TYPE_CHECKING:
    from whereabouts.nodes.ros.base import SuiteNode

Array = NDArray[np.float64]


class MapOutput:
    """Bounded views of a map's grid, of `most` cells; what has to be left out of one is said."""

    def __init__(self, node: SuiteNode, most: int = VIEW_CELLS) -> None:
        self._node = node
        self._most = most
        self._whole = node.add_output(GridMessage, "map", LATCHED)
        self._updates = node.add_output(OccupancyGridUpdate, "map_updates")
        self._view: TileView | None = None  # that was sent last

    def forget(self) -> None:
        """Begin anew: the next map is sent whole."""
        self._view = None

    @property
    def updates_wanted(self) -> bool:
        """Whether somebody listens to what changes of a map that was sent."""
        return self._view is not None and self._updates.wanted

    def outdated(self, grid: MapGrid, around: Array | None) -> bool:
        """Whether another part of an unchanged map has to be shown, as the robot has moved on."""
        view = self._view
        return view is not None and view.left_out > 0 and grid.tiles.view(around, self._most) != view

    def send(self, header: Header, grid: MapGrid, around: Array | None) -> None:
        """Send the map whole; `around` (2,) : where the robot is, metres, if that is known."""
        self._view = grid.tiles.view(around, self._most)
        grid.changed()
        self._whole.publish(grid_message(header, grid.tiles, self._view))
        left_out = grid.left_out(self._view)
        if left_out:
            self._node.complain(f"map: {left_out}", key="map left out")

    def message(self, header: Header, grid: MapGrid, around: Array | None) -> GridMessage:
        """The map as a message for one who asks; `around` as for `send`."""
        return grid_message(header, grid.tiles, grid.tiles.view(around, self._most))

    def send_changes(self, header: Header, grid: MapGrid, around: Array | None) -> None:
        """Send the box of what has changed; the whole map if another part of it is to be shown."""
        view = grid.tiles.view(around, self._most)
        if self._view is None or (view.low, view.shape) != (self._view.low, self._view.shape):
            self.send(header, grid, around)
            return
        changed = np.array(list(grid.changed()), dtype=np.int64).reshape(-1, 2) - view.low
        inside = changed[((changed >= 0) & (changed < view.shape)).all(axis=1)]
        if len(inside):
            low = inside.min(axis=0)
            rows, columns = (inside.max(axis=0) + 1 - low).tolist()
            box = TileView((int(low[0]) + view.low[0], int(low[1]) + view.low[1]), (rows, columns))
            offset = int(low[1]) * TILE, int(low[0]) * TILE
            self._updates.publish(update_message(header, offset, grid.tiles.values(box)))
