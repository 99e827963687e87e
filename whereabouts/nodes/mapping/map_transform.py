"""The transform from the map to the odometry frame: sent when it says something new, and for those who come late."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from tf2_msgs.msg import TFMessage

from estimation.geometry.poses import pose_to_quaternion
from whereabouts.nodes.mapping.map_in_use import MapInUse
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.messages.transforms import frame_name, transform_message
from whereabouts.nodes.ros.base import SuiteNode

NOTHING = 1e-6  # metres and radians by which a correction may change without being a new one


class MapTransform:
    """Sends the correction of a map on tf."""

    def __init__(self, node: SuiteNode, made: MapInUse) -> None:
        self._node, self._map = node, made
        self._output = node.broadcaster()
        self.forget()

    def forget(self) -> None:
        """A new run."""
        self._told = 0  # ns of the node's clock when the correction was last sent
        self._told_correction: NDArray[np.float64] | None = None
        self._told_until = self._stamp_before = 0  # ns up to which it is valid; of the scan before

    def tell(self, stamp: int) -> None:
        """Send the correction if it is a new one, or would not be valid any more when the next scan comes.

        Every node listens to tf: what says nothing new costs each of them time.
        """
        correction = self._map.correction
        if correction is None:
            return
        period, self._stamp_before = stamp - self._stamp_before, stamp
        same = self._told_correction is not None and np.allclose(
            correction, self._told_correction, rtol=0.0, atol=NOTHING
        )
        if not (same and period > 0 and stamp + period <= self._told_until):
            self.publish(stamp)

    def publish(self, stamp: int | None) -> None:
        """Send it, for a scan of this stamp."""
        settings, correction = self._node.settings, self._map.correction
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

    def repeat(self, stamp: int | None) -> None:
        """For those who come late and while no scans come; each scan's own was just sent otherwise.

        In lock-step nobody comes late, and what the clock says of the time between two scans is none.
        """
        if self._node.replayed:
            return
        period = self._node.settings.tf_period * NANOSECONDS
        if self._node.get_clock().now().nanoseconds - self._told >= period:
            self.publish(stamp)
