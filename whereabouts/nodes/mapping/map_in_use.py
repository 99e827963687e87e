"""The map that a robot is in: being made, a saved one in which it is looked for, or both, one after the other."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.poses import compound, pose_from_matrix, pose_to_matrix
from loop_closure.graph.smoother_process import SmootherProcess
from loop_closure.maps.localization import Localizer
from loop_closure.maps.map_file import read_map, write_map
from loop_closure.maps.map_grid import MapGrid
from loop_closure.maps.merging import EarlierMap
from loop_closure.motions import planar
from loop_closure.slam.trajectory import Slam
from registration.laser.scan import Scan
from whereabouts.nodes.messages.conversions import spatial
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.system.atomic import atomic_path
from whereabouts.system.counting import counted

DRAWN = 12  # keyframes drawn into the map's grid with one scan
PACE = 8.0  # ms of closing loops with one scan, about; the rest of the work goes on with the next ones


class MapInUse:
    """A node's map.

    slam : it; grid : drawn. localizer : looks for the robot where the map is a saved one; extend : whether it goes on
    once the robot is found. earlier : the map of the run before. place (2,) : of the sensor, where that is known.
    mounting (3,) : of the sensor on the robot. correction (6,) : of the odometry frame of tf. located : whether the
    robot is found. changed : whether anything has to be published anew. stamp : of the last scan, ns, None before it.

    for_tf : takes a correction of the odometry in use to that of tf. aside : a process that smooths.
    """

    def __init__(
        self, node: SuiteNode, for_tf: Callable[[Array], Array], aside: SmootherProcess | None = None
    ) -> None:
        self._node, self._for_tf, self._aside = node, for_tf, aside
        self.earlier: EarlierMap | None = None

    def start(self) -> None:
        """Begin with the saved map, if there is one."""
        self._forget_live()
        self._begin()
        self.earlier = None
        stem = self._node.settings.map_file
        if stem and Path(f"{stem}.npz").exists():
            self.begin_with(Path(f"{stem}.npz"), self._node.settings.localization_only, None)

    def _forget_live(self) -> None:
        self.correction: Array | None = None
        self.located = True
        self.mounting: Array = np.zeros(3)
        self.changed = False
        self.stamp: int | None = None

    def _begin(self) -> None:
        settings = self._node.settings
        self.slam = Slam(settings.slam, proposals=settings.proposals, thin=True, pace=PACE, aside=self._aside)
        self.localizer: Localizer | None = None
        self.extend = True
        self.grid = MapGrid(settings.resolution)
        self.place: Array | None = None  # (2,) of the sensor in the map, where it is known

    def next_run(self) -> None:
        """The map stays. One that was being made is made anew until the robot is found in the one before."""
        slam, earlier = self.slam, self.earlier
        looking, extend = self.localizer is not None, self.extend
        self._forget_live()
        if looking:
            self._look_in(slam, extend)
            return
        if earlier is not None:
            slam = earlier.slam
        self._begin()
        self.earlier = EarlierMap(slam) if len(slam.keyframes) else None

    def take_correction(self) -> None:
        """Where odometry begins, by the map that is being made."""
        self._correct(self.slam.correction, self.slam.pose)

    def _correct(self, correction: Array, pose: Array) -> None:
        """The correction and the pose of the sensor are known."""
        flat = planar(correction)
        self.correction = self._for_tf(spatial(correction) if flat else pose_from_matrix(correction))
        if flat:
            self.place = pose[:2]

    def locate(self, scan: Scan | Array, odometry: Array) -> None:
        """Where the robot is in a saved map, by its next scan or cloud."""
        assert self.localizer is not None
        located, correction = self.localizer.process(scan, odometry), self.localizer.correction
        self.located = located.pose is not None
        if located.pose is None or correction is None:
            self.correction = None
            return
        self._correct(correction, located.pose)
        if located.sure and self.extend:
            self._node.get_logger().info("the robot was found in the map, which is extended from here on")
            self.slam.resume(correction)
            self.localizer = None

    def look_for_earlier(self, scan: Scan | Array, odometry: Array, stamp: float) -> None:
        """Go on with the map of the previous run once the robot is found in it; give it up once this one is larger."""
        if self.earlier is None:
            return
        slam = self.earlier.slam
        if self.earlier.found(scan, odometry, stamp):
            self._node.get_logger().info(
                "the robot was found in the map of the previous run, which is extended from here on"
            )
            self.slam, self.grid, self.earlier = slam, MapGrid(self._node.settings.resolution), None
            self.changed = True
        elif len(self.slam.keyframes) > len(slam.keyframes):
            self.earlier = None
            kept = ""
            if self._node.settings.map_file:
                path = Path(f"{self._node.settings.map_file}.before.npz")
                with atomic_path(path) as temporary, temporary.open("wb") as file:
                    write_map(slam, file)
                kept = f". It is kept in {path}"
            self._node.alarm(
                f"the robot was not found in the map of the previous run. The new map replaces it{kept}"
            )

    def begin_with(self, path: Path, localization_only: bool, initial: Array | None) -> int:
        """Take a saved map; the robot is looked for in it, around `initial` (3,) of the robot where given."""
        slam = read_map(path, self._node.settings.slam, thin=True, aside=self._aside)
        slam.pace = PACE
        kind, other = ("clouds", "scans") if self._node.settings.cloud_topic else ("scans", "clouds")
        if not len(slam.keyframes) or (slam.keyframes[0].scan is None) != (kind == "clouds"):
            raise InputError(f"{path}: a map of {kind} expected; it is empty or was made of {other}")
        self.earlier = None
        self._look_in(slam, not localization_only, initial)
        self._node.get_logger().info(
            f"{path}: {counted(len(slam.keyframes), 'keyframe')}; looking for the robot in them"
        )
        return len(slam.keyframes)

    def _look_in(self, slam: Slam, extend: bool, initial: Array | None = None) -> None:
        self.slam = slam
        self.grid, self.place = MapGrid(self._node.settings.resolution), None
        start = None if initial is None else compound(initial, self.mounting)
        self.localizer = Localizer(slam.keyframes, slam.graph.poses, start)
        self.extend = extend
        self.correction, self.located = None, False
        self.changed = True

    def look_anew(self) -> None:
        self.earlier = None
        self._look_in(self.slam, self.extend)

    def edited(self, before: Array) -> bool:
        """Somebody has changed the map, `before` being the last keyframe's pose until then: the robot goes with it.

        True where the correction is another.
        """
        self.changed = True
        if self.correction is None:
            return False
        after = self.slam.pose
        here, there = (pose_to_matrix(spatial(pose)) if planar(pose) else pose for pose in (after, before))
        self.correction = pose_from_matrix(here @ np.linalg.inv(there) @ pose_to_matrix(self.correction))
        if planar(after):
            self.place = after[:2]
        return True

    @property
    def flat(self) -> bool:
        """Whether there is a map of scans."""
        return len(self.slam.keyframes) > 0 and self.slam.keyframes[0].scan is not None

    def draw(self) -> None:
        """Draw some of what has changed; a map that was read is drawn at once."""
        self.grid.update(self.slam, DRAWN if len(self.grid.tiles) else None)
