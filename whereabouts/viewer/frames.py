"""Frames of tf as paths from the map down."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from whereabouts.messages.decode import transforms
from whereabouts.messages.records import BASE_FRAME, MAP_FRAME, ODOM_FRAME, strip_slash
from whereabouts.viewer.drawable import Array, PlaceShape

DEPTH = 32


class Frames:
    """Who is whose parent, as far as tf has said; REP-105 for the rest.

    Of what tf does not know, `odom` is in `map`, `base_link` in `odom`, a sensor at the origin of `base_link`, and any
    other frame at the origin of `map`.
    """

    def __init__(self) -> None:
        self._parents: dict[str, str] = {}
        self._told: set[str] = set()

    def knows(self, frame: str) -> bool:
        return strip_slash(frame) in self._told

    def take(self, message: Any, topic: str) -> Iterator[PlaceShape]:
        """Places of a tf2_msgs/TFMessage."""
        for record in transforms(message, topic):
            self._told.add(record.child_frame_id)
            yield self.put(record.child_frame_id, record.frame_id, record.transform, record.static)

    def put(self, child: str, parent: str, matrix: Array, static: bool = False) -> PlaceShape:
        """Note a frame, and where it is, (4, 4)."""
        self._parents[strip_slash(child)] = strip_slash(parent)
        return PlaceShape(self.path(child), np.asarray(matrix, dtype=np.float64), static)

    def path(self, frame: str, sensor: bool = False) -> str:
        """Path of a frame. sensor : one that tf does not know is on the robot, not in the map."""
        chain = [strip_slash(frame) or MAP_FRAME]
        while chain[-1] != MAP_FRAME and len(chain) < DEPTH:
            chain.append(self._parents.get(chain[-1]) or _usual_parent(chain[-1], sensor and len(chain) == 1))
        # Frames of several robots carry a prefix with a slash, which paths keep for their own use.
        return "/".join(name.replace("/", ".") for name in reversed(chain))


def _usual_parent(frame: str, sensor: bool) -> str:
    if frame == BASE_FRAME:
        return ODOM_FRAME
    return BASE_FRAME if sensor and frame != ODOM_FRAME else MAP_FRAME
