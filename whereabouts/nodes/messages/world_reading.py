"""Worlds, predicted paths, maps and regions from messages, for the world model and the nodes that act upon it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from geometry_msgs.msg import PoseStamped
from nav_msgs.msg import OccupancyGrid as GridMessage
from numpy.typing import NDArray
from std_msgs.msg import Header

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.frame_tree import TransformError
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.poses import pose_from_matrix
from whereabouts.messages.world_objects import state_from_message
from whereabouts.nodes.messages.conversions import fill_pose, pose_from_message, spatial
from whereabouts.nodes.messages.markers import point, vector
from whereabouts.nodes.messages.packed import Packed
from whereabouts.nodes.messages.stamps import seconds
from whereabouts.nodes.messages.transforms import TransformBuffer, check_frame
from whereabouts_msgs.msg import (
    Attribute,
    DiscreteDistribution,
    GaussianDistribution,
    PredictedPathArray,
    Region,
)
from whereabouts_msgs.msg import WorldState as StateMessage
from world_model import WorldState
from world_model.predictions import Path


class LatestState:
    """The newest world state, read when somebody looks at it.

    refuse : called with the reason for a state that makes no sense; the one before then stays the newest.
    frame : of the map, in which a state has to be.
    on_read : called with each state that is read.
    """

    def __init__(
        self,
        refuse: Callable[[str], None],
        frame: str,
        on_read: Callable[[WorldState], None] = lambda state: None,
    ) -> None:
        self._refuse, self._frame = refuse, frame
        self._on_read = on_read
        self._news: Packed | None = None
        self._state: WorldState | None = None

    def take(self, message: Packed) -> None:
        self._news = message

    def forget(self) -> None:
        self._news = self._state = None

    @property
    def state(self) -> WorldState | None:
        """The newest state, None before the first."""
        news, self._news = self._news, None
        if news is not None:
            try:
                message: StateMessage = news.unpack()
                _check_said("world_state", message.header.frame_id, self._frame)
                self._state = state_from_message(message)
            except InputError as error:
                self._refuse(str(error))
            else:
                self._on_read(self._state)
        return self._state


def paths_from_message(message: PredictedPathArray, transform: Array) -> dict[int, Path]:
    """The most probable path of each target, by label, in the frame that `transform` (4, 4) leads to.

    Raises InputError: a path that makes no sense; names its label. One of a single point is left out.
    """
    start, turn = seconds(message.header.stamp), transform[:2, :2]
    found = {}
    for told in message.paths:
        if len(told.points) < 2:
            continue
        after = [seconds(p.time_from_start) for p in told.points]
        places = np.array([[p.position.x, p.position.y, p.position.z] for p in told.points])
        flat = (places @ transform[:3, :3].T + transform[:3, 3])[:, :2]
        spread = np.array([p.covariance for p in told.points]).reshape(-1, 2, 2)
        given = {
            "path": np.column_stack([flat, start + np.array(after)]),
            "covariances": turn @ spread @ turn.T,
        }
        found[int(told.label)] = Path.checked(f"path of target {told.label}", given)
    return found


def _check_said(what: str, said: str, frame: str) -> None:
    """`check_frame`; a message that says nothing of its frame is taken to be in the map's."""
    if said:
        check_frame(what, said, frame)


def grid_from_message(message: GridMessage, frame: str) -> OccupancyGrid:
    """A nav_msgs/OccupancyGrid of the map frame.

    Raises InputError: another frame, sizes that do not fit, a resolution that is not positive, a map turned against its
    axes.
    """
    _check_said("map", message.header.frame_id, frame)
    values, pose = grid_values(message), pose_from_message(message.info.origin)
    if abs(pose[5]) > 1e-6:
        raise InputError(f"map: turned by {pose[5]:.3f} rad against its axes")
    return OccupancyGrid.from_values(values, float(message.info.resolution), pose[:2])


def grid_values(message: GridMessage) -> NDArray[np.int8]:
    """Values (H, W) of a nav_msgs/OccupancyGrid.

    Raises InputError: sizes that do not fit, a resolution that is not positive.
    """
    info = message.info
    if not info.resolution > 0.0 or info.width * info.height != len(message.data):
        raise InputError(
            f"map: {info.width} x {info.height} cells of {info.resolution:g} m and {len(message.data)} values"
        )
    return np.frombuffer(message.data, dtype=np.int8).reshape(info.height, info.width)


def planar_pose(transforms: TransformBuffer, target: str, source: str) -> Array | None:
    """Newest pose (3,) of `source` in `target`; None while tf does not tell."""
    stamp = transforms.newest(target, source)
    if stamp is None:
        return None
    try:
        return pose_from_matrix(transforms.lookup(target, source, stamp))[[0, 1, 5]]
    except TransformError:
        return None


def pose_stamped(header: Header, pose: Array) -> PoseStamped:
    """A planar pose (3,) as a goal that nav2 takes."""
    message = PoseStamped(header=header)
    fill_pose(message.pose, spatial(pose))
    return message


def box_region(centre: Array, size: Array) -> Region:
    """A box along the axes of the frame; centre and size (3,) m."""
    region = Region()
    region.center.position = point(centre)
    region.center.orientation.w = 1.0
    region.size = vector(size)
    return region


def distribution_message(values: Mapping[str, float]) -> DiscreteDistribution:
    """{value: probability} as a message."""
    return DiscreteDistribution(
        values=list(values), probabilities=[min(max(float(p), 0.0), 1.0) for p in values.values()]
    )


def attribute_messages(
    attributes: Mapping[str, Mapping[str, float]], quantities: Mapping[str, tuple[float, float]]
) -> list[Attribute]:
    """All that is known of an object but its class; quantities : {name: (mean, variance)}."""
    words = [
        Attribute(name=name, discrete=distribution_message(values))
        for name, values in attributes.items()
        if name != "class"
    ]
    return words + [
        Attribute(name=name, continuous=GaussianDistribution(mean=[mean], covariance=[variance]))
        for name, (mean, variance) in quantities.items()
    ]
