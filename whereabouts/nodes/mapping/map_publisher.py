"""What is sent of a map: its frame on tf, the path, points, markers for listeners, and the grid as nav2 takes it: whole
on `map`, and on `map_updates` what has changed of that since."""

from __future__ import annotations

import numpy as np
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid as GridMessage
from nav_msgs.msg import Path as PathMessage
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.grid_kernels import TILE
from estimation.geometry.poses import compound, inverse, pose_from_matrix, pose_to_quaternion
from estimation.geometry.tiles import VIEW_CELLS, TileView
from loop_closure.maps.map_grid import MapGrid, map_points
from whereabouts.nodes.mapping.map_in_use import MapInUse
from whereabouts.nodes.messages.conversions import cloud_message, spatial
from whereabouts.nodes.messages.map_messages import grid_message, marker_messages, packed_path, update_message
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import frame_name, transform_message
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.ros.qos import LATCHED

NOTHING = 1e-6  # metres and radians by which a correction may change without being a new one


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
        self._node, self._map, self._output = node, made, MapOutput(node)
        self._frame = frame_name(node.settings.map_frame)
        self._path = node.add_output(PathMessage, "trajectory", LATCHED)
        self._points = node.add_output(PointCloud2, "map_points", LATCHED)
        self._markers = node.add_output(MarkerArray, "~/markers", LATCHED)
        self._markers_due = False

    def forget(self) -> None:
        self._markers_due = False

    def send(self) -> None:
        """All of a map that has changed."""
        made = self._map
        slam, flat = made.slam, made.flat
        if made.stamp is None:
            return
        if not made.changed and not (flat and self._output.outdated(made.grid, made.place)):
            return
        header = self._header(made.stamp)
        stamps = [slam.keyframes[k].stamp for k in range(len(slam.keyframes))]
        self._path.publish(packed_path(header, stamps, self._base_poses()))
        if flat:
            made.draw()
            self._output.send(header, made.grid, made.place)
        self._points.publish(cloud_message(header, map_points(slam, made.grid.tiles)))
        made.changed = False
        self._markers_due = True

    def send_markers(self) -> None:
        """For those who look on, whenever they begin to."""
        made = self._map
        if self._markers_due and self._markers.wanted and made.stamp is not None:
            self._markers_due = False
            self._markers.publish(marker_messages(self._header(made.stamp), made.slam))

    def send_changes(self) -> None:
        made = self._map
        if made.changed and made.stamp is not None and self._output.updates_wanted(made.grid):
            made.draw()
            self._output.send_changes(self._header(made.stamp), made.grid, made.place)

    def message(self) -> GridMessage:
        """The grid with all that is known, for one who asks. Raises InputError where there is none yet."""
        made = self._map
        if not made.flat:
            raise InputError("there is no map of scans yet")
        made.grid.update(made.slam)
        header = self._header(self._node.now if made.stamp is None else made.stamp)
        return self._output.message(header, made.grid, made.place)

    def _header(self, stamp: int) -> Header:
        return Header(stamp=time_message(stamp), frame_id=self._frame)

    def _base_poses(self) -> Array:
        """(N, 6) poses of the robot at the keyframes."""
        poses = self._map.slam.graph.poses
        if poses.ndim == 3:
            return pose_from_matrix(poses)
        return spatial(compound(poses, inverse(self._map.mounting)))


class MapTransform:
    """Sends the correction of a map on tf: when it says something new, and for those who come late."""

    def __init__(self, node: SuiteNode, made: MapInUse) -> None:
        self._node, self._map = node, made
        self._output = node.broadcaster()
        self.forget()

    def forget(self) -> None:
        self._told = 0  # ns of the node's clock when the correction was last sent
        self._told_correction: Array | None = None
        self._told_until = self._stamp_before = 0  # ns up to which it is valid; of the scan before

    def tell(self) -> None:
        """Send the correction if it is a new one, or would not be valid any more when the next scan comes.

        Every node listens to tf: what says nothing new costs each of them time.
        """
        correction, stamp = self._map.correction, self._map.stamp
        if correction is None or stamp is None:
            return
        period, self._stamp_before = stamp - self._stamp_before, stamp
        same = self._told_correction is not None and np.allclose(
            correction, self._told_correction, rtol=0.0, atol=NOTHING
        )
        if not (same and period > 0 and stamp + period <= self._told_until):
            self.publish()

    def publish(self) -> None:
        """Send it, for the last scan."""
        settings, correction, stamp = self._node.settings, self._map.correction, self._map.stamp
        if not settings.publish_tf or stamp is None or correction is None:
            return
        until = stamp + round(settings.transform_tolerance * NANOSECONDS)
        position, quaternion = pose_to_quaternion(correction)
        transform = transform_message(
            frame_name(settings.map_frame), frame_name(settings.odom_frame), until, (*position, *quaternion)
        )
        self._output.publish(TFMessage(transforms=[transform]))
        self._told = self._node.get_clock().now().nanoseconds
        self._told_correction, self._told_until = correction, until

    def repeat(self) -> None:
        """For those who come late and while no scans come; each scan's own was just sent otherwise.

        In lock-step nobody comes late, and what the clock says of the time between two scans is none.
        """
        if self._node.replayed:
            return
        period = self._node.settings.tf_period * NANOSECONDS
        if self._node.get_clock().now().nanoseconds - self._told >= period:
            self.publish()
