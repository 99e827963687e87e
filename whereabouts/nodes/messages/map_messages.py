"""Maps, trajectories and closures as messages."""

from __future__ import annotations

import struct
from collections.abc import Sequence

import numpy as np
from map_msgs.msg import OccupancyGridUpdate
from nav_msgs.msg import OccupancyGrid as GridMessage
from nav_msgs.msg import Path as PathMessage
from numpy.typing import NDArray
from rclpy.serialization import serialize_message
from std_msgs.msg import Header
from visualization_msgs.msg import Marker, MarkerArray

from estimation.checks import FloatArray as Array
from estimation.geometry.poses import (
    compound,
    compound_covariance,
    inverse,
    pose_from_matrix,
    pose_to_quaternion,
)
from estimation.geometry.tiles import TiledGrid, TileView
from loop_closure.motions import positions
from loop_closure.slam.loop_closer import Closure
from loop_closure.slam.trajectory import Slam
from whereabouts.nodes.messages.conversions import array_of, fill_pose, spatial, spatial_covariance
from whereabouts.nodes.messages.markers import COLOURS, colour, marker, point
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import frame_name
from whereabouts_msgs.msg import LoopClosure

CDR_LENGTH = 4  # bytes of a number of items, of an encapsulation, and of either part of a stamp


def closure_message(
    closure: Closure, numbers: tuple[int, int], mounting: Array, base_frame: str
) -> LoopClosure:
    """A closure between robot poses.

    numbers : of the earlier and later keyframe, whatever was taken out since. mounting : (3,) pose of the planar
    sensor in the robot frame.
    """
    message = LoopClosure()
    later = round(closure.later_stamp * NANOSECONDS)
    message.header = Header(stamp=time_message(later), frame_id=frame_name(base_frame))
    message.earlier_stamp = time_message(round(closure.earlier_stamp * NANOSECONDS))
    message.earlier_id, message.later_id = numbers
    if closure.relative.shape == (3,):
        nothing, back = np.zeros((3, 3)), inverse(mounting)
        inner = compound(closure.relative, back)
        moved = compound_covariance(closure.relative, closure.covariance, back, nothing)
        relative = spatial(compound(mounting, inner))
        covariance = spatial_covariance(np.asarray(compound_covariance(mounting, nothing, inner, moved)))
    else:
        relative = pose_from_matrix(closure.relative)
        covariance = closure.covariance.reshape(36)
    fill_pose(message.relative.pose, relative)
    message.relative.covariance = covariance
    message.likelihood, message.fitness = closure.likelihood, closure.fitness
    message.accepted, message.reason = True, closure.reason
    return message


def packed_path(header: Header, stamps: Sequence[float], poses: Array) -> bytes:
    """A nav_msgs/Path of poses (N, 6) with their stamps, seconds, as it is sent.

    Made as bytes: Python objects for every pose of a long way would take longer than all else that a map costs.
    """
    start = serialize_message(PathMessage(header=header))[:-CDR_LENGTH]
    frame = header.frame_id.encode() + b"\0"
    position, quaternion = pose_to_quaternion(np.asarray(poses, dtype=np.float64).reshape(-1, 6))
    nanoseconds = np.rint(np.asarray(stamps, dtype=np.float64) * NANOSECONDS).astype(np.int64)
    # Doubles are aligned to 8 bytes from the end of the encapsulation, so the first pose may have other padding.
    named = 3 * CDR_LENGTH + len(frame)
    first, further = -(len(start) + named) % 8, -named % 8
    item = np.dtype(
        [("sec", "<i4"), ("nanosec", "<u4"), ("length", "<u4"), ("frame", f"S{len(frame)}")]
        + [("padding", f"V{further}")] * (further > 0)
        + [("pose", "<f8", 7)]
    )
    items = np.zeros(len(poses), dtype=item)
    items["sec"], items["nanosec"] = np.divmod(nanoseconds, NANOSECONDS)
    items["length"], items["frame"] = len(frame), frame
    items["pose"][:, :3], items["pose"][:, 3:] = position, quaternion
    data = items.tobytes()
    if len(items):
        data = data[:named] + bytes(first) + data[named + further :]
    return bytes(start) + struct.pack("<I", len(items)) + data


def grid_message(header: Header, tiles: TiledGrid, view: TileView) -> GridMessage:
    """Occupancy of a view as nav2 takes it: 0 free, 100 occupied, -1 unknown."""
    values, origin = tiles.values(view), tiles.origin(view)
    message = GridMessage(header=header)
    message.info.map_load_time = header.stamp
    message.info.resolution = tiles.resolution
    message.info.height, message.info.width = values.shape
    message.info.origin.position.x, message.info.origin.position.y = (float(v) for v in origin)
    message.info.origin.orientation.w = 1.0
    message.data = array_of("b", values)
    return message


def update_message(header: Header, offset: tuple[int, int], values: NDArray[np.int8]) -> OccupancyGridUpdate:
    """New occupancy `values` (H, W) for a box of a map; `offset` : column and row of its first cell there."""
    message = OccupancyGridUpdate(header=header)
    message.x, message.y = offset
    message.height, message.width = values.shape
    message.data = array_of("b", values)
    return message


def marker_messages(header: Header, slam: Slam) -> MarkerArray:
    """The graph for RViz: the path as a line, closures as lines across it."""
    where = positions(slam.graph.poses)
    path = marker(header, "path", Marker.LINE_STRIP, colour(COLOURS[0]), 0.05)
    path.points = [point(at) for at in where]
    closures = marker(header, "closures", Marker.LINE_LIST, colour(COLOURS[3]), 0.03)
    for closure in slam.closures:
        closures.points += [point(where[closure.earlier]), point(where[closure.later])]
    return MarkerArray(markers=[path, closures])
