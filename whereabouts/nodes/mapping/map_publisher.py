"""What is sent of a map: the path, the grid and what changes of it, points, and markers for listeners."""

from __future__ import annotations

import numpy as np
from nav_msgs.msg import OccupancyGrid as GridMessage
from nav_msgs.msg import Path as PathMessage
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from estimation.errors import InputError
from estimation.geometry.poses import compound, inverse, pose_from_matrix
from loop_closure.maps.map_grid import map_points
from whereabouts.nodes.mapping.map_in_use import MapInUse
from whereabouts.nodes.mapping.map_output import MapOutput
from whereabouts.nodes.messages.conversions import PLANAR, cloud_message
from whereabouts.nodes.messages.map_messages import marker_messages, packed_path
from whereabouts.nodes.messages.stamps import time_message
from whereabouts.nodes.messages.transforms import frame_name
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.ros.qos import LATCHED


class MapPublisher:
    """Outputs of a map, in its frame. output : of the grid."""

    def __init__(self, node: SuiteNode, made: MapInUse, output: MapOutput) -> None:
        self._map, self._output = made, output
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
        if made.changed and stamp is not None and self._output.updates_wanted:
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

    def _base_poses(self) -> NDArray[np.float64]:
        """(N, 6) poses of the robot at the keyframes."""
        poses = self._map.slam.graph.poses
        if poses.ndim == 3:
            return pose_from_matrix(poses)
        spatial_poses = np.zeros((len(poses), 6))
        spatial_poses[:, PLANAR] = compound(poses, inverse(self._map.mounting))
        return spatial_poses
