"""What is sent of a map: the path, points, markers for listeners, and the grid as nav2 takes it: whole on `map`, and on
`map_updates` what has changed of that since."""

from __future__ import annotations

import numpy as np
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid as GridMessage
from nav_msgs.msg import Path as PathMessage
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from estimation.errors import InputError
from estimation.geometry.grid_kernels import TILE
from estimation.geometry.poses import compound, inverse, pose_from_matrix
from estimation.geometry.tiles import VIEW_CELLS, TileView
from loop_closure.maps.map_grid import MapGrid, map_points
from whereabouts.nodes.mapping.map_in_use import MapInUse
from whereabouts.nodes.messages.conversions import cloud_message, spatial
from whereabouts.nodes.messages.map_messages import grid_message, marker_messages, packed_path, update_message
from whereabouts.nodes.messages.stamps import time_message
from whereabouts.nodes.messages.transforms import frame_name
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.ros.qos import LATCHED

Array = NDArray[np.float64]


class MapOutput:
    """Bounded views of a map's grid, of `most` cells; what has to be left out of one is said."""

    def __init__(self, node: SuiteNode, most: int = VIEW_CELLS) -> None:
        self._node = node
        self._most = most
        self._whole = node.add_output(GridMessage, "map", LATCHED)
        self._updates = node.add_output(OccupancyGridUpdate, "map_updates")
        self._sent: tuple[MapGrid, TileView] | None = None  # last

    def _shown(self, grid: MapGrid) -> TileView | None:
        """What was sent last of a grid; None of one that is new."""
        return self._sent[1] if self._sent is not None and self._sent[0] is grid else None

    def updates_wanted(self, grid: MapGrid) -> bool:
        """Whether somebody listens to what changes of a map that was sent."""
        return self._shown(grid) is not None and self._updates.wanted

    def outdated(self, grid: MapGrid, around: Array | None) -> bool:
        """Whether another part of an unchanged map has to be shown, as the robot has moved on."""
        view = self._shown(grid)
        return view is not None and view.left_out > 0 and grid.tiles.view(around, self._most) != view

    def send(self, header: Header, grid: MapGrid, around: Array | None) -> None:
        """Send the map whole; `around` (2,) : where the robot is, metres, if that is known."""
        view = grid.tiles.view(around, self._most)
        self._sent = grid, view
        grid.changed()
        self._whole.publish(grid_message(header, grid.tiles, view))
        if left_out := grid.left_out(view):
            self._node.complain(f"map: {left_out}", key="map left out")

    def message(self, header: Header, grid: MapGrid, around: Array | None) -> GridMessage:
        """The map as a message for one who asks; `around` as for `send`."""
        return grid_message(header, grid.tiles, grid.tiles.view(around, self._most))

    def send_changes(self, header: Header, grid: MapGrid, around: Array | None) -> None:
        """Send the box of what has changed; the whole map if another part of it is to be shown."""
        view, shown = grid.tiles.view(around, self._most), self._shown(grid)
        if shown is None or (view.low, view.shape) != (shown.low, shown.shape):
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


class MapPublisher:
    """Outputs of a map, in its frame."""

    def __init__(self, node: SuiteNode, made: MapInUse) -> None:
        self._map, self._output = made, MapOutput(node)
        self._frame = frame_name(node.settings.map_frame)
        self._path = node.add_output(PathMessage, "trajectory", LATCHED)
        self._points = node.add_output(PointCloud2, "map_points", LATCHED)
        self._markers = node.add_output(MarkerArray, "~/markers", LATCHED)
        self._markers_due = False

    def forget(self) -> None:
        """A new run."""
        self._markers_due = False

    def send(self, stamp: int) -> None:
        """All of a map that has changed. stamp : of the last scan, ns."""
        made = self._map
        slam, flat = made.slam, made.flat
        if not made.changed and not (flat and self._output.outdated(made.grid, made.place)):
            return
        header = self._header(stamp)
        stamps = [slam.keyframes[k].stamp for k in range(len(slam.keyframes))]
        self._path.publish(packed_path(header, stamps, self._base_poses()))
        if flat:
            made.draw()
            self._output.send(header, made.grid, made.place)
        self._points.publish(cloud_message(header, map_points(slam, made.grid.tiles)))
        made.changed = False
        self._markers_due = True

    def send_markers(self, stamp: int | None) -> None:
        """For those who look on, whenever they begin to."""
        if self._markers_due and self._markers.wanted and stamp is not None:
            self._markers_due = False
            self._markers.publish(marker_messages(self._header(stamp), self._map.slam))

    def send_changes(self, stamp: int | None) -> None:
        """What has changed of the grid."""
        made = self._map
        if made.changed and stamp is not None and self._output.updates_wanted(made.grid):
            made.draw()
            self._output.send_changes(self._header(stamp), made.grid, made.place)

    def message(self, stamp: int) -> GridMessage:
        """The grid with all that is known, for one who asks. Raises InputError where there is none yet."""
        made = self._map
        if not made.flat:
            raise InputError("there is no map of scans yet")
        made.grid.update(made.slam)
        return self._output.message(self._header(stamp), made.grid, made.place)

    def _header(self, stamp: int) -> Header:
        return Header(stamp=time_message(stamp), frame_id=self._frame)

    def _base_poses(self) -> Array:
        """(N, 6) poses of the robot at the keyframes."""
        poses = self._map.slam.graph.poses
        if poses.ndim == 3:
            return pose_from_matrix(poses)
        return spatial(compound(poses, inverse(self._map.mounting)))
