"""Node `loop_closure`: recognises places, closes loops, keeps a consistent map and says where in it the robot is."""

from __future__ import annotations

import time
from collections import OrderedDict
from typing import ClassVar

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import LaserScan, PointCloud2

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.poses import compound, pose_from_matrix, pose_to_matrix
from loop_closure.graph.smoother_process import SmootherProcess
from loop_closure.loop_closure_warm_up import warm_up
from loop_closure.slam.trajectory import SlamUpdate
from registration.laser.mounting import level_pose, seen_from_robot, upright
from registration.laser.scan import Scan
from whereabouts.nodes.mapping.map_editing import MapEditing
from whereabouts.nodes.mapping.map_files import MapFiles
from whereabouts.nodes.mapping.map_in_use import MapInUse
from whereabouts.nodes.mapping.map_publisher import MapPublisher, MapTransform
from whereabouts.nodes.mapping.odometry_source import OdometrySource
from whereabouts.nodes.messages.conversions import (
    PLANAR,
    points_from_message,
    pose_from_message,
    scan_from_message,
    spatial,
    stated_covariance,
)
from whereabouts.nodes.messages.map_messages import closure_message
from whereabouts.nodes.messages.stamps import NANOSECONDS
from whereabouts.nodes.messages.transforms import check_frame
from whereabouts.nodes.navigation.nav2_maps import Nav2Maps
from whereabouts.nodes.ros.base import SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.nodes.ros.footprint import settle
from whereabouts.parameters.loop_closure import LoopClosureParameters
from whereabouts_msgs.msg import LoopClosure

REMEMBERED = 200  # odometry messages kept for their covariance
SURE_SIGMA = 1.0  # metres, of an initial pose that comes without a covariance


class LoopClosureNode(SuiteNode):
    """A `map` frame that does not drift. aside : a process that smooths, if there is one."""

    parameters_model = LoopClosureParameters
    node_name = "loop_closure"
    sends_clouds = True
    settings: LoopClosureParameters
    aside: ClassVar[SmootherProcess | None] = None

    def setup(self) -> None:
        settings = self.settings
        self.listen_to_transforms()
        self._source = OdometrySource(settings.odometry_source, settings.base_frame)
        # Where the robot was at a scan and how sure that is: the message may come before the scan or after it.
        sure = self.add_input(
            OdometryMessage, "odometry", self._take_odometry,
            on_demand=True, awaited=settings.odometry_source != "tf",
        )  # fmt: skip
        # A person, not a sensor: its stamp says nothing about the run.
        self.add_input(PoseWithCovarianceStamped, "initialpose", self._take_initial_pose, sensor=False)
        warm_up()
        cloud_topic, scan_topic = settings.cloud_topic, settings.scan_topic
        kind, topic = (PointCloud2, cloud_topic) if cloud_topic else (LaserScan, scan_topic)
        self._range_input = self.add_input(
            kind, topic, self._take_view, frames=self._frames, companions=[sure]
        )
        self._closures_output = self.add_output(LoopClosure, "loop_closures", 100)
        self._map = MapInUse(self, self._for_tf, self.aside)
        self._publisher = MapPublisher(self, self._map)
        self._transform = MapTransform(self, self._map)
        files = MapFiles(self, self._map, self._finish_work)
        self._editing = MapEditing(self, self._map, self._publisher, self._transform)
        if settings.nav2_services:
            Nav2Maps(self, files, self._publisher, self._look_anew)
        self.add_timer(settings.tf_period, self._transform.repeat)
        self.add_timer(settings.tf_period, self._catch_up)
        self.add_timer(settings.map_period, self._publisher.send)
        self.add_timer(settings.map_period, self._publisher.send_markers)
        self.add_timer(settings.map_period / 4.0, self._publisher.send_changes)
        if settings.save_period > 0.0 and settings.map_file:
            self.add_timer(settings.save_period, files.save_regularly)

    def start_run(self) -> None:
        self._forget_live()
        self._map.start()

    def next_run(self) -> None:
        """The map stays. One that was being made is made anew until the robot is found in the one before."""
        self._forget_live()
        self._map.next_run()

    def _forget_live(self) -> None:
        self._transform.forget()
        self._publisher.forget()
        self._covariances: OrderedDict[int, Array] = OrderedDict()
        self._source.clear()
        self._caught_up: int | None = None  # the stamp when it was last looked whether scans come
        self._waiting = 0
        self._slowest = 0.0

    def health(self) -> Health:
        if not self.active or self._map.stamp is None:
            return Health("waiting for scans and odometry")
        figures: dict[str, object] = {
            "keyframes": len(self._map.slam.keyframes),
            "closures": len(self._map.slam.closures),
            "waiting closures": self._waiting,
            "keyframes to work on": self._map.slam.behind,
            "slowest step ms": round(1e3 * self._slowest, 1),
            "odometry by": self._source.kind,
        }
        if self._map.localizer is not None and not self._map.located:
            return Health("looking for the robot in the map", warning=True, figures=figures)
        if self._map.earlier is not None:
            figures["keyframes of the previous run"] = len(self._map.earlier.slam.keyframes)
            return Health("mapping; looking for the robot in the map of the previous run", figures=figures)
        mapping = "paused: scans are left out of the map" if self._editing.paused else "mapping"
        return Health("localising" if self._map.localizer is not None else mapping, figures=figures)

    # Inputs.

    def _frames(self, message: LaserScan | PointCloud2) -> list[tuple[str, str]]:
        settings = self.settings
        return [(settings.base_frame, message.header.frame_id), (settings.odom_frame, settings.base_frame)]

    def _take_odometry(self, message: OdometryMessage, stamp: int) -> None:
        self._covariances[stamp] = np.array(message.pose.covariance)
        while len(self._covariances) > REMEMBERED:
            self._covariances.popitem(last=False)
        self._source.take(message, stamp)

    def _odometry(self, stamp: int) -> Array:
        """Pose (4, 4) of the robot by odometry."""
        by_tf = self.transforms.lookup(self.settings.odom_frame, self.settings.base_frame, stamp)
        return self._source.pose(stamp, by_tf, self.transforms)

    def _take_view(self, message: LaserScan | PointCloud2, stamp: int) -> None:
        begun = time.perf_counter()
        # A map is made along the path: what comes after others of a later stamp says nothing new. Those that came
        # while it waited for its transform are still to be taken.
        if self._range_input.behind(stamp) > 0 and stamp < (self._map.stamp or 0):
            raise InputError("its stamp is older than that of the previous message")
        view: Scan | Array
        is_scan = isinstance(message, LaserScan)
        view = scan_from_message(message) if is_scan else points_from_message(message)[0]
        mounting = self.transforms.lookup(self.settings.base_frame, message.header.frame_id, stamp)
        odometry, stated = self._odometry(stamp), self._covariances.pop(stamp, np.zeros(36))
        if isinstance(view, Scan):
            level = level_pose(mounting)
            if level is None:
                view, level = seen_from_robot((view, mounting)), np.zeros(3)
            else:
                view = upright(view, mounting)
            self._map.mounting = level
            odometry = compound(pose_from_matrix(odometry)[PLANAR], level)
            covariance = stated_covariance(stated, PLANAR)
        else:
            covariance = stated_covariance(stated)
            view = view @ mounting[:3, :3].T + mounting[:3, 3]
        self._advance(view, odometry, covariance, stamp)
        self._slowest = max(self._slowest, time.perf_counter() - begun)
        self._transform.tell()

    def _advance(self, view: Scan | Array, odometry: Array, covariance: Array | None, stamp: int) -> None:
        """Go on with a scan or cloud: in a map, or by making one."""
        made = self._map
        made.stamp = stamp
        if made.localizer is not None:
            made.locate(view, odometry)
        elif not self._editing.paused or not len(made.slam.keyframes):
            update = made.slam.process(view, odometry, covariance, stamp / NANOSECONDS)
            self._take_update(update)
            made.look_for_earlier(view, odometry, stamp / NANOSECONDS)
            made.take_correction()
            if isinstance(view, Scan) and (update.keyframe is not None or made.grid.behind):
                made.draw()

    def _take_update(self, update: SlamUpdate) -> None:
        self._waiting = update.waiting
        self._map.changed |= update.keyframe is not None or bool(update.closures)
        frames = self._map.slam.keyframes
        for closure in update.closures:
            numbers = frames[closure.earlier].number, frames[closure.later].number
            self._closures_output.publish(
                closure_message(closure, numbers, self._map.mounting, self.settings.base_frame)
            )

    def _take_initial_pose(self, message: PoseWithCovarianceStamped, stamp: int) -> None:
        map_frame = self.settings.map_frame
        check_frame("initialpose", message.header.frame_id or map_frame, map_frame)
        if self._map.localizer is None:
            self.complain("initialpose is ignored: this run builds the map, so the pose is known")
            return
        pose = pose_from_message(message.pose.pose)[PLANAR]
        variance = np.array(message.pose.covariance).reshape(6, 6)
        sigma = float(np.sqrt(max(variance[0, 0], variance[1, 1]))) or SURE_SIGMA
        turn = float(np.sqrt(variance[5, 5])) or 0.35
        self._map.localizer.place(compound(pose, self._map.mounting), sigma, turn)

    # Outputs.

    def _for_tf(self, correction: Array) -> Array:
        """The odometry frame of tf in the map, from the frame of the odometry in use there, (6,) each."""
        shift = self._source.shift
        if shift is None:
            return correction
        shifted = pose_from_matrix(pose_to_matrix(correction) @ shift)
        return shifted if self.settings.cloud_topic else spatial(shifted[PLANAR])

    def _catch_up(self) -> None:
        """While no scans come, go on with what they left over."""
        came, self._caught_up = self._map.stamp != self._caught_up, self._map.stamp
        if came or self._map.localizer is not None or not self._map.slam.behind:
            return
        self._take_update(self._map.slam.work())
        self._map.take_correction()

    def _look_anew(self) -> None:
        """Look for the robot in the whole map. Raises InputError where there is none yet."""
        if not len(self._map.slam.keyframes):
            raise InputError("there is no map yet")
        self._finish_work()
        self._map.look_anew()

    def _finish_work(self) -> None:
        while self._map.slam.behind:
            self._take_update(self._map.slam.work())


def main() -> None:
    # Forked here, as long as there are no threads.
    LoopClosureNode.aside = SmootherProcess(settle)
    exit_with(LoopClosureNode)


if __name__ == "__main__":
    main()
