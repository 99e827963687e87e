"""A session found in the map of an earlier one, and its scans in the same graph: live, or two saved maps made one."""

from __future__ import annotations

import numpy.typing as npt

from estimation.checks import FloatArray
from estimation.errors import InputError
from loop_closure.keyframes import Keyframe
from loop_closure.maps.localization import Localizer
from loop_closure.motions import compose, invert, planar
from loop_closure.slam.trajectory import Slam
from registration.laser.scan import Scan

# Keyframes over which the second session is followed once it is found: the place is then known better.
FOLLOWED = 10


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


def merge(first: Slam, second: Slam) -> int:
    """Add the keyframes of `second` to the map `first`, in whose frame they then are.

    No guess is needed: the second session is searched in the first as a lost robot is. From where it was found its
    scans are added forwards to its end, then backwards to its start, and close loops with those of the first.

    Returns the number of the keyframe of `second` at which it was found.

    Raises
    ------
    InputError : one map is empty, one is of scans and the other of clouds, or the second is nowhere found in the first.
    """
    if not len(first.keyframes) or not len(second.keyframes):
        raise InputError("a map without keyframes cannot be merged")
    poses = second.graph.poses
    if planar(poses) != planar(first.graph.poses):
        raise InputError("a map of scans and a map of clouds cannot be merged")
    found, correction = _find(first, second)
    before = len(first.keyframes)
    first.resume(correction)
    for k in range(found, len(second.keyframes)):
        _add(first, second.keyframes[k], poses[k])
    first.finish()
    # The closures have said better where the second session lies.
    first.resume(compose(first.graph.poses[before], invert(poses[found])))
    for k in range(found, -1, -1):
        _add(first, second.keyframes[k], poses[k])
    first.finish()
    return found


def _find(first: Slam, second: Slam) -> tuple[int, FloatArray]:
    """Keyframe of the second session that is sure to lie in the first, and the frame of the second there."""
    localizer = Localizer(first.keyframes, first.graph.poses)
    best: tuple[int, FloatArray] | None = None
    begun = 0
    for k in range(len(second.keyframes)):
        located = localizer.process(second.keyframes[k].measured, second.graph.poses[k])
        if located.sure and localizer.correction is not None:
            begun = k if best is None else begun
            best = k, localizer.correction
        if best is not None and k - begun >= FOLLOWED:
            break
    if best is not None:
        return best
    raise InputError("the second map was not found in the first: they have too little in common")


def _add(slam: Slam, frame: Keyframe, pose: FloatArray) -> None:
    slam.process(frame.measured, pose, None, frame.stamp)
