"""Where people will be as a mask for nav2's costmap filters: KeepoutFilter takes it as it is."""

from __future__ import annotations

from collections.abc import Mapping
from importlib import import_module
from typing import Any

import numpy as np
from nav_msgs.msg import MapMetaData, OccupancyGrid
from numpy.typing import NDArray
from std_msgs.msg import Header

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.poses import pose_to_matrix
from tracking.intentions import Prediction
from whereabouts.nodes.messages.conversions import array_of, pose_from_message
from whereabouts.nodes.messages.intention_messages import PathMarkers
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.nodes.ros.qos import LATCHED

KEEPOUT = 0  # CostmapFilterInfo.type; base and multiplier have to be 0 and 1 with it
# Unknown: the filter leaves the costmap as it is. With 0 it would make free what is unknown there.
NOBODY = -1
PATIENCE = 2  # masks without people's news after which nobody is drawn


class PeopleMask:
    """The mask of a node that predicts; it lies over the map, cell by cell, and is sent where it has changed.

    Raises InputError: nav2_msgs is not installed.
    """

    def __init__(self, node: SuiteNode) -> None:
        try:
            self._kind = import_module("nav2_msgs.msg").CostmapFilterInfo
        except (ImportError, AttributeError) as error:
            raise InputError(f"publish_mask: nav2_msgs is not installed ({error})") from error
        self._info_output = node.add_output(self._kind, "people_filter_info", LATCHED)
        self._mask_output = node.add_output(OccupancyGrid, "people_mask", LATCHED)
        # The filter takes the mask's cells for the costmap's where it marks what has changed: they have to agree.
        self.map: MapMetaData | None = None
        self._sent: tuple[Any, ...] = ()
        self.forget()

    def forget(self) -> None:
        self._people: Mapping[int, Prediction] = {}
        self._stamp, self._silent = 0.0, 0

    def hear(self, people: Mapping[int, Prediction], stamp: float) -> None:
        """Predictions made at a stamp, s."""
        self._people, self._stamp, self._silent = dict(people), stamp, 0

    def send(self, header: Header, ways: PathMarkers, radius: float) -> None:
        """Send the mask, if there is a map and something has changed; arguments as of `mask_values`."""
        self._silent += 1
        if self._silent > PATIENCE:
            self._people = {}
        info = self.map
        if info is None:
            return
        values = mask_values(self._people, self._stamp, info, ways, radius)
        origin = info.origin.position
        new = (info.width, info.height, info.resolution, origin.x, origin.y, values.tobytes())
        if new == self._sent:
            return
        if not self._sent:
            topic = self._mask_output.topic
            self._info_output.publish(
                self._kind(header=header, type=KEEPOUT, filter_mask_topic=topic, base=0.0, multiplier=1.0)
            )
        self._sent = new
        mask = OccupancyGrid(header=header, info=info)
        mask.data = array_of("b", values)
        self._mask_output.publish(mask)


def mask_values(
    people: Mapping[int, Prediction], start: float, info: MapMetaData, ways: PathMarkers, radius: float
) -> NDArray[np.int8]:
    """Percent (H, W) with which somebody will be at a cell of a map; -1 where nobody will.

    start : s, from which on they are predicted. ways : what of the predictions is drawn. radius : metres around each
    place, that of the robot included. Where a person is now has 100.
    """
    values = np.full((info.height, info.width), NOBODY, dtype=np.int8)
    matrix = np.linalg.inv(pose_to_matrix(pose_from_message(info.origin)))
    size = radius / info.resolution
    for told in people.values():
        drawn = [
            (share, (places @ matrix[:2, :2].T + matrix[:2, 3]) / info.resolution)
            for share, places in ways.of(told, start)
        ]
        every = np.concatenate([cells for _, cells in drawn])
        low = np.clip(np.floor(every.min(axis=0) - size), 0, values.shape[::-1]).astype(np.int64)
        high = np.clip(np.ceil(every.max(axis=0) + size) + 1, 0, values.shape[::-1]).astype(np.int64)
        box = values[low[1] : high[1], low[0] : high[0]]
        if box.size:
            percent = _percent(box.shape, [(share, cells - low) for share, cells in drawn], size)
            box[:] = np.where(percent > 0, np.maximum(box, percent), box)
    return values


def _percent(shape: tuple[int, ...], ways: list[tuple[float, Array]], size: float) -> NDArray[np.int8]:
    """How probable it is that one person will be at a cell; `size` : radius in cells."""
    shares = np.zeros(shape)
    for share, cells in ways:
        there = np.zeros(shape, dtype=np.bool_)
        for place in cells:
            _disc(there, place, size)
        shares += share * there
    now = np.zeros(shape, dtype=np.bool_)
    _disc(now, ways[0][1][0], size)
    shares[now] = 1.0
    return np.rint(100.0 * np.minimum(shares, 1.0)).astype(np.int8)


def _disc(mask: NDArray[np.bool_], centre: Array, size: float) -> None:
    """Mark the cells within `size` cells of a place (2,), column and row."""
    low = np.maximum(np.floor(centre - size).astype(np.int64), 0)
    high = np.minimum(np.ceil(centre + size).astype(np.int64) + 1, mask.shape[::-1])
    if (high <= low).any():
        return
    columns, rows = (np.arange(low[k], high[k]) + 0.5 - centre[k] for k in (0, 1))
    near = rows[:, None] ** 2 + columns[None] ** 2 <= size**2
    mask[low[1] : high[1], low[0] : high[0]] |= near
