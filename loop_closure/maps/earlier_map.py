"""The map of a run that has ended, which the robot may be found in again."""

from __future__ import annotations

import numpy.typing as npt

from loop_closure.maps.localization import Localizer
from loop_closure.slam.trajectory import Slam
from registration.laser.scan import Scan


class EarlierMap:
    """Looks for the robot in the map of an earlier run, whose odometry frame has nothing to do with today's.

    slam : that map, with one keyframe at least.
    """

    def __init__(self, slam: Slam) -> None:
        self.slam = slam
        self._localizer = Localizer(slam.keyframes, slam.graph.poses)

    def found(self, scan: Scan | npt.ArrayLike, odometry: npt.ArrayLike, stamp: float) -> bool:
        """Take the next scan, or cloud, with the sensor's pose by odometry, at `stamp`, s.

        True once the robot is found: `slam` then goes on with this scan.
        """
        if not self._localizer.process(scan, odometry).sure or self._localizer.correction is None:
            return False
        self.slam.resume(self._localizer.correction)
        self.slam.process(scan, odometry, None, stamp)
        return True
