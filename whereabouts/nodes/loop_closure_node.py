"""Node `loop_closure`: recognises places, closes loops, keeps a consistent map and says where in it the robot is.

In: `scan` (LaserScan) or `points` (PointCloud2), `odometry` (Odometry: where the robot was at a scan, and how sure that
is), tf odom -> base_link -> sensor, `initialpose`. Out: `loop_closures`, `trajectory`, `map`, `map_points`, markers, tf
map -> odom.
"""

from __future__ import annotations

import time
from collections import OrderedDict
from pathlib import Path

import numpy as np
from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import OccupancyGrid as GridMessage
from nav_msgs.msg import Odometry as OdometryMessage
from nav_msgs.msg import Path as PathMessage
from numpy.typing import NDArray
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import MarkerArray

from estimation.errors import InputError
from estimation.geometry.grid import is_grid_file
from estimation.geometry.poses import compound, inverse, pose_from_matrix, pose_to_matrix, pose_to_quaternion
from loop_closure.loop_closure_warm_up import warm_up
from loop_closure.maps.earlier_map import EarlierMap
from loop_closure.maps.localization import Localizer
from loop_closure.maps.map_file import is_map, read_map, write_map
from loop_closure.motions import planar
from loop_closure.slam.trajectory import Closure, Slam
from registration.laser.mounting import level_pose, seen_from_robot, upright
from registration.laser.scan import Scan
from whereabouts.nodes.mapping.map_editing import MapEditing
from whereabouts.nodes.mapping.map_output import MapOutput
from whereabouts.nodes.mapping.odometry_source import OdometrySource
from whereabouts.nodes.messages.conversions import (
    PLANAR,
    cloud_message,
    points_from_message,
    pose_from_message,
    scan_from_message,
    spatial,
)
from whereabouts.nodes.messages.map_messages import closure_message, marker_messages, packed_path
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import frame_name, transform_message
from whereabouts.nodes.navigation.nav2_maps import Nav2Maps
from whereabouts.nodes.ros.base import LATCHED, SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.parameters.loop_closure import LoopClosureParameters
from whereabouts.recorded.mapping import MapGrid, map_points
from whereabouts.system.atomic import atomic_path
from whereabouts.system.state_files import StateFiles, keep_foreign
from whereabouts_msgs.msg import LoopClosure
from whereabouts_msgs.srv import LoadMap, SaveMap

Array = NDArray[np.float64]
REMEMBERED = 200  # odometry messages kept for their covariance
NOTHING = 1e-6  # metres and radians by which a correction may change without being a new one
SURE_SIGMA = 1.0  # metres, of an initial pose that comes without a covariance
DRAWN = 12  # keyframes drawn into the map's grid with one scan
PACE = 8.0  # ms of closing loops with one scan, about; the rest of the work goes on with the next ones


class LoopClosureNode(SuiteNode):
    """A `map` frame that does not drift."""

    parameters_model = LoopClosureParameters
    node_name = "loop_closure"
    settings: LoopClosureParameters

    def setup(self) -> None:
        settings = self.settings
        self.listen_to_transforms()
        self._source = OdometrySource(settings.odometry_source, settings.base_frame)
        # Where the robot was at a scan and how sure that is: the message may come before the scan or after it.
        sure = [
            self.add_input(
                OdometryMessage,
                "odometry",
                self._take_odometry,
                on_demand=True,
                awaited=settings.odometry_source != "tf",
            )
        ]
        # A person, not a sensor: its stamp says nothing about the run.
        self.add_input(PoseWithCovarianceStamped, "initialpose", self._take_initial_pose, sensor=False)
        warm_up()
        kind, topic, take = (
            (PointCloud2, settings.cloud_topic, self._take_cloud)
            if settings.cloud_topic
            else (LaserScan, settings.scan_topic, self._take_scan)
        )
        self._range_input = self.add_input(kind, topic, take, frames=self._frames, companions=sure)
        self._closures_output = self.add_output(LoopClosure, "loop_closures", 100)
        self._path_output = self.add_output(PathMessage, "trajectory", LATCHED)
        self._maps = MapOutput(self)
        self._points_output = self.add_output(PointCloud2, "map_points", LATCHED)
        self._marker_output = self.add_output(MarkerArray, "~/markers", LATCHED)
        self._tf_output = self.broadcaster()
        self.add_service(SaveMap, "~/save_map", self._save)
        self.add_service(LoadMap, "~/load_map", self._load)
        self._editing = MapEditing(self, self, settings.map_frame)
        if settings.nav2_services:
            Nav2Maps(self, self)
        self.add_timer(settings.tf_period, self._repeat_transform)
        self.add_timer(settings.tf_period, self._catch_up)
        self.add_timer(settings.map_period, self._publish_map)
        self.add_timer(settings.map_period, self._publish_markers)
        self.add_timer(settings.map_period / 4.0, self._publish_changes)
        if settings.save_period > 0.0 and settings.map_file:
            self.add_timer(settings.save_period, self._save_regularly)

    def start_run(self) -> None:
        self._forget_live()
        self._begin_map()
        self._earlier: EarlierMap | None = None
        stem = self.settings.map_file
        if stem and Path(f"{stem}.npz").exists():
            self._begin_with(Path(f"{stem}.npz"), self.settings.localization_only, None)

    def next_run(self) -> None:
        """The map stays. One that was being made is made anew until the robot is found in the one before."""
        slam, earlier = self._slam, self._earlier
        looking, extend = self._localizer is not None, self._extend
        self._forget_live()
        if looking:
            self._look_in(slam, extend)
            return
        if earlier is not None:
            slam = earlier.slam
        self._begin_map()
        self._earlier = EarlierMap(slam) if len(slam.keyframes) else None

    def _begin_map(self) -> None:
        settings = self.settings
        self._slam = Slam(settings.slam, proposals=settings.proposals, thin=True, pace=PACE)
        self._localizer: Localizer | None = None
        self._extend = True
        self._grid = MapGrid(self.settings.resolution)
        self._maps.forget()
        self._place: Array | None = None  # (2,) of the sensor in the map, where it is known

    def _forget_live(self) -> None:
        self._correction: Array | None = None  # (6,) of the odometry frame in the map
        self._located = True
        self._told = 0  # ns of the node's clock when the correction was last sent
        self._told_correction: Array | None = None
        self._told_until = self._stamp_before = 0  # ns up to which it is valid; of the scan before
        self._covariances: OrderedDict[int, Array] = OrderedDict()
        self._source.clear()
        self._mounting: Array = np.zeros(3)
        self._stamp: int | None = None
        self._caught_up: int | None = None  # the stamp when it was last looked whether scans come
        self._waiting = 0
        self._changed = self._moved = False
        self._markers_due = False
        self._slowest = 0.0

    def health(self) -> Health:
        if not self.active or self._stamp is None:
            return Health("waiting for scans and odometry")
        figures: dict[str, object] = {
            "keyframes": len(self._slam.keyframes),
            "closures": len(self._slam.closures),
            "waiting closures": self._waiting,
            "keyframes to work on": self._slam.behind,
            "slowest step ms": round(1e3 * self._slowest, 1),
            "odometry by": self._source.kind,
        }
        if self._localizer is not None and not self._located:
            return Health("looking for the robot in the map", warning=True, figures=figures)
        if self._earlier is not None:
            figures["keyframes of the previous run"] = len(self._earlier.slam.keyframes)
            return Health("mapping; looking for the robot in the map of the previous run", figures=figures)
        mapping = "paused: scans are left out of the map" if self._editing.paused else "mapping"
        return Health("localising" if self._localizer is not None else mapping, figures=figures)

    # Inputs.

    def _frames(self, message: LaserScan | PointCloud2) -> list[tuple[str, str]]:
        settings = self.settings
        return [(settings.base_frame, message.header.frame_id), (settings.odom_frame, settings.base_frame)]

    def _take_odometry(self, message: OdometryMessage, stamp: int) -> None:
        covariance = np.array(message.pose.covariance).reshape(6, 6)
        if np.isfinite(covariance).all() and covariance.any():
            self._covariances[stamp] = covariance
        while len(self._covariances) > REMEMBERED:
            self._covariances.popitem(last=False)
        self._source.take(message, stamp)

    def _odometry(self, stamp: int) -> Array:
        """Pose (4, 4) of the robot by odometry."""
        by_tf = self.transforms.lookup(self.settings.odom_frame, self.settings.base_frame, stamp)
        return self._source.pose(stamp, by_tf, self.transforms)

    def _take_scan(self, message: LaserScan, stamp: int) -> None:
        begun = time.perf_counter()
        self._check_order(stamp)
        scan = scan_from_message(message)
        mounting = self.transforms.lookup(self.settings.base_frame, message.header.frame_id, stamp)
        base = pose_from_matrix(self._odometry(stamp))
        level = level_pose(mounting)
        if level is None:
            scan, level = seen_from_robot((scan, mounting)), np.zeros(3)
        else:
            scan = upright(scan, mounting)
        self._mounting = level
        odometry = compound(base[PLANAR], level)
        covariance = self._covariances.pop(stamp, None)
        known = None if covariance is None else covariance[np.ix_(PLANAR, PLANAR)]
        self._stamp = stamp
        if self._localizer is not None:
            self._locate(scan, odometry)
        elif not self._editing.paused or not len(self._slam.keyframes):
            update = self._slam.process(scan, odometry, known, stamp / NANOSECONDS)
            self._take_update(update.closures, update.keyframe is not None, update.waiting)
            self._look_for_earlier(scan, odometry, stamp)
            self._take_correction()
            if update.keyframe is not None or self._grid.behind:
                self._draw()
        self._slowest = max(self._slowest, time.perf_counter() - begun)
        self._tell_correction()

    def _take_cloud(self, message: PointCloud2, stamp: int) -> None:
        begun = time.perf_counter()
        self._check_order(stamp)
        points, _ = points_from_message(message)
        settings = self.settings
        mounting = self.transforms.lookup(settings.base_frame, message.header.frame_id, stamp)
        base = self._odometry(stamp)
        cloud = points @ mounting[:3, :3].T + mounting[:3, 3]
        covariance = self._covariances.pop(stamp, None)
        self._stamp = stamp
        if self._localizer is not None:
            self._locate(cloud, base)
        elif not self._editing.paused or not len(self._slam.keyframes):
            update = self._slam.process(cloud, base, covariance, stamp / NANOSECONDS)
            self._take_update(update.closures, update.keyframe is not None, update.waiting)
            self._look_for_earlier(cloud, base, stamp)
            self._take_correction()
        self._slowest = max(self._slowest, time.perf_counter() - begun)
        self._tell_correction()

    def _check_order(self, stamp: int) -> None:
        """A map is made along the path: what comes after others of a later stamp says nothing new."""
        if self._range_input.behind(stamp) > 0:
            raise InputError("its stamp is older than that of the previous message")

    def _take_update(self, closures: list[Closure], kept: bool, waiting: int) -> None:
        self._waiting = waiting
        self._changed = self._changed or kept
        if closures:
            self._moved = True
        frames = self._slam.keyframes
        for closure in closures:
            numbers = frames[closure.earlier].number, frames[closure.later].number
            self._closures_output.publish(
                closure_message(closure, numbers, self._mounting, self.settings.base_frame)
            )

    def _take_correction(self) -> None:
        correction = self._slam.correction
        flat = planar(correction)
        self._correction = self._for_tf(spatial(correction) if flat else pose_from_matrix(correction))
        if flat:
            self._place = self._slam.pose[:2]

    def _locate(self, scan: Scan | Array, odometry: Array) -> None:
        assert self._localizer is not None
        located = self._localizer.process(scan, odometry)
        self._located = located.pose is not None
        if located.pose is not None and planar(located.pose):
            self._place = located.pose[:2]
        correction = self._localizer.correction
        if correction is None:
            self._correction = None
            return
        spread = spatial(correction) if planar(correction) else pose_from_matrix(correction)
        self._correction = self._for_tf(spread)
        if located.sure and self._extend:
            self.get_logger().info("the robot was found in the map, which is extended from here on")
            self._slam.resume(correction)
            self._localizer = None

    def _look_for_earlier(self, scan: Scan | Array, odometry: Array, stamp: int) -> None:
        """Go on with the map of the previous run once the robot is found in it; give it up once this one is larger."""
        if self._earlier is None:
            return
        slam = self._earlier.slam
        if self._earlier.found(scan, odometry, stamp / NANOSECONDS):
            self.get_logger().info(
                "the robot was found in the map of the previous run, which is extended from here on"
            )
            self._slam, self._grid, self._earlier = slam, MapGrid(self.settings.resolution), None
            self._changed = self._moved = True
        elif len(self._slam.keyframes) > len(slam.keyframes):
            self._earlier = None
            kept = ""
            if self.settings.map_file:
                path = Path(f"{self.settings.map_file}.before.npz")
                with atomic_path(path) as temporary, temporary.open("wb") as file:
                    write_map(slam, file)
                kept = f". It is kept in {path}"
            self.alarm(
                f"the robot was not found in the map of the previous run. The new map replaces it{kept}"
            )

    def _take_initial_pose(self, message: PoseWithCovarianceStamped, stamp: int) -> None:
        if frame_name(message.header.frame_id) not in ("", frame_name(self.settings.map_frame)):
            raise InputError(
                f"initialpose in frame {message.header.frame_id!r}: {self.settings.map_frame!r} expected"
            )
        if self._localizer is None:
            self.complain("initialpose is ignored: this run builds the map, so the pose is known")
            return
        pose = pose_from_message(message.pose.pose)[PLANAR]
        variance = np.array(message.pose.covariance).reshape(6, 6)
        sigma = float(np.sqrt(max(variance[0, 0], variance[1, 1]))) or SURE_SIGMA
        turn = float(np.sqrt(variance[5, 5])) or 0.35
        self._localizer.place(compound(pose, self._mounting), sigma, turn)

    # Outputs.

    def _for_tf(self, correction: Array) -> Array:
        """The odometry frame of tf in the map, from the frame of the odometry in use there, (6,) each."""
        shift = self._source.shift
        if shift is None:
            return correction
        shifted = pose_from_matrix(pose_to_matrix(correction) @ shift)
        return shifted if self.settings.cloud_topic else spatial(shifted[PLANAR])

    def _tell_correction(self) -> None:
        """Send the correction if it is a new one, or would not be valid any more when the next scan comes.

        Every node listens to tf: what says nothing new costs each of them time.
        """
        if self._stamp is None or self._correction is None:
            return
        period, self._stamp_before = self._stamp - self._stamp_before, self._stamp
        same = self._told_correction is not None and np.allclose(
            self._correction, self._told_correction, rtol=0.0, atol=NOTHING
        )
        if not (same and period > 0 and self._stamp + period <= self._told_until):
            self._publish_transform()

    def _publish_transform(self) -> None:
        settings = self.settings
        if not settings.publish_tf or self._stamp is None or self._correction is None:
            return
        stamp = self._stamp + round(settings.transform_tolerance * NANOSECONDS)
        position, quaternion = pose_to_quaternion(self._correction)
        transform = transform_message(
            frame_name(settings.map_frame), frame_name(settings.odom_frame), stamp, (*position, *quaternion)
        )
        self._tf_output.publish(TFMessage(transforms=[transform]))
        self._told = self.get_clock().now().nanoseconds
        self._told_correction, self._told_until = self._correction, stamp

    def _repeat_transform(self) -> None:
        """For those who come late and while no scans come; each scan's own was just sent otherwise."""
        if self.get_clock().now().nanoseconds - self._told >= self.settings.tf_period * NANOSECONDS:
            self._publish_transform()

    def _catch_up(self) -> None:
        """While no scans come, go on with what they left over."""
        came, self._caught_up = self._stamp != self._caught_up, self._stamp
        if came or self._localizer is not None or not self._slam.behind:
            return
        update = self._slam.work()
        self._take_update(update.closures, bool(update.closures), update.waiting)
        self._take_correction()

    def _publish_map(self) -> None:
        flat = len(self._slam.keyframes) > 0 and self._slam.keyframes[0].scan is not None
        if not self._changed and not (flat and self._maps.outdated(self._grid, self._place)):
            return
        if self._stamp is None:
            return
        header = self._map_header(self._stamp)
        poses = self._base_poses()
        stamps = [self._slam.keyframes[k].stamp for k in range(len(self._slam.keyframes))]
        self._path_output.publish(packed_path(header, stamps, poses))
        if flat:
            self._draw()
            self._maps.send(header, self._grid, self._place)
        self._points_output.publish(cloud_message(header, map_points(self._slam, self._grid.tiles)))
        self._changed = self._moved = False
        self._markers_due = True

    def _publish_markers(self) -> None:
        """For those who look on, whenever they begin to."""
        if self._markers_due and self._marker_output.wanted and self._stamp is not None:
            self._markers_due = False
            self._marker_output.publish(marker_messages(self._map_header(self._stamp), self._slam))

    def _draw(self) -> None:
        """Draw some of what has changed; a map that was read is drawn at once."""
        self._grid.update(self._slam, DRAWN if len(self._grid.tiles) else None)

    def _publish_changes(self) -> None:
        if self._changed and self._stamp is not None and self._maps.updates_wanted:
            self._draw()
            self._maps.send_changes(self._map_header(self._stamp), self._grid, self._place)

    def _map_header(self, stamp: int) -> Header:
        return Header(stamp=time_message(stamp), frame_id=frame_name(self.settings.map_frame))

    def _base_poses(self) -> Array:
        """(N, 6) poses of the robot at the keyframes."""
        poses = self._slam.graph.poses
        if poses.ndim == 3:
            return pose_from_matrix(poses)
        spatial_poses = np.zeros((len(poses), 6))
        spatial_poses[:, PLANAR] = compound(poses, inverse(self._mounting))
        return spatial_poses

    # What a person does to the map; see `MapEditing`.

    @property
    def slam(self) -> Slam:
        """The map in use."""
        return self._slam

    @property
    def extends(self) -> bool:
        """Whether scans are added to the map."""
        return self._localizer is None

    def map_now(self) -> GridMessage:
        """The map with all that is known. Raises InputError where there is none yet."""
        if not len(self._slam.keyframes) or self._slam.keyframes[0].scan is None:
            raise InputError("there is no map of scans yet")
        self._grid.update(self._slam)
        header = self._map_header(self.now if self._stamp is None else self._stamp)
        return self._maps.message(header, self._grid, self._place)

    def map_edited(self, before: Array) -> None:
        """Publish everything anew. The robot goes with the last keyframe, `before` being its pose until now."""
        self._changed = self._moved = True
        if self._correction is None:
            return
        after = self._slam.pose
        here, there = (pose_to_matrix(spatial(pose)) if planar(pose) else pose for pose in (after, before))
        self._correction = pose_from_matrix(here @ np.linalg.inv(there) @ pose_to_matrix(self._correction))
        if planar(after):
            self._place = after[:2]
        self._publish_transform()

    # Services.

    def _save_regularly(self) -> None:
        # What is saved is not lost to the little that is known after a jump of time.
        if len(self._slam.keyframes) and self._localizer is None and self._earlier is None:
            self._write(Path(self.settings.map_file))

    def _save(self, request: SaveMap.Request, response: SaveMap.Response) -> SaveMap.Response:
        response.path = str(self.save_map(self.named(request.path, making=True)))
        response.code, response.message = (
            SaveMap.Response.SUCCESS,
            f"{len(self._slam.keyframes)} keyframes written",
        )
        return response

    def save_map(self, stem: Path) -> Path:
        """Write the map's files. Raises InputError where there is no map, or a file is foreign."""
        if not len(self._slam.keyframes):
            raise InputError("there is no map yet")
        return self._write(stem)

    def load_map(self, stem: Path) -> int:
        """Take a saved map, as at the start; returns how many keyframes it has. Raises InputError."""
        path = stem.with_name(f"{stem.name}.npz")
        return self._begin_with(path, self.settings.localization_only, None)

    def look_anew(self) -> None:
        """Look for the robot in the whole map. Raises InputError where there is none yet."""
        if not len(self._slam.keyframes):
            raise InputError("there is no map yet")
        self._finish()
        self._earlier = None
        self._look_in(self._slam, self._extend)

    def _finish(self) -> None:
        """Do all that scans have left over."""
        while self._slam.behind:
            update = self._slam.work()
            self._take_update(update.closures, bool(update.closures), update.waiting)

    def _write(self, stem: Path) -> Path:
        """Each file appears whole; what is there already stays until then."""
        target = stem.with_name(stem.name + ".npz")
        keep_foreign(target, is_map, "a map of the suite")
        for suffix in (".pgm", ".yaml"):
            keep_foreign(stem.with_name(stem.name + suffix), is_grid_file, "a map of the suite")
        self._finish()
        if self._slam.keyframes[0].scan is not None:
            self._grid.update(self._slam)
            self._grid.bounded(warn=self.complain).save(stem, _replace)
        with atomic_path(target) as temporary, temporary.open("wb") as file:
            write_map(self._slam, file)
        return target

    def _load(self, request: LoadMap.Request, response: LoadMap.Response) -> LoadMap.Response:
        path = self.named(request.path)
        initial: Array | None = None
        frame = frame_name(request.initial_pose.header.frame_id)
        if frame:
            if frame != frame_name(self.settings.map_frame):
                raise InputError(f"initial_pose in frame {frame!r}: {self.settings.map_frame!r} expected")
            initial = pose_from_message(request.initial_pose.pose)[PLANAR]
        count = self._begin_with(path.with_name(path.name + ".npz"), request.localization_only, initial)
        response.code, response.message = LoadMap.Response.SUCCESS, f"{count} keyframes read"
        return response

    def named(self, name: str, making: bool = False) -> Path:
        """Stem of the files that a request names. Raises InputError for what requests may not name."""
        files = StateFiles(self.settings.state_dir, self.settings.allowed_folders)
        if name and name != self.settings.map_file:
            name = f"{_stem(name)}.npz"
        return _stem(str(files.named(name, self.settings.map_file, making)))

    def _begin_with(self, path: Path, localization_only: bool, initial: Array | None) -> int:
        """Take a saved map; the robot is looked for in it, around `initial` (3,) of the robot where given."""
        slam = read_map(path, self.settings.slam, thin=True)
        slam.pace = PACE
        kind, other = ("clouds", "scans") if self.settings.cloud_topic else ("scans", "clouds")
        if not len(slam.keyframes) or (slam.keyframes[0].scan is None) != (kind == "clouds"):
            raise InputError(f"{path}: a map of {kind} expected; it is empty or was made of {other}")
        self._earlier = None
        self._look_in(slam, not localization_only, initial)
        self.get_logger().info(f"{path}: {len(slam.keyframes)} keyframes; looking for the robot in them")
        return len(slam.keyframes)

    def _look_in(self, slam: Slam, extend: bool, initial: Array | None = None) -> None:
        self._slam = slam
        self._grid, self._place = MapGrid(self.settings.resolution), None
        self._maps.forget()
        start = None if initial is None else compound(initial, self._mounting)
        self._localizer = Localizer(slam.keyframes, slam.graph.poses, start)
        self._extend = extend
        self._correction, self._located = None, False
        self._changed = True


def _stem(name: str) -> Path:
    """Path without the ending a map's files may have been named with."""
    path = Path(name)
    return path.with_suffix("") if path.suffix in (".npz", ".pgm", ".yaml") else path


def _replace(path: Path, data: bytes) -> None:
    with atomic_path(path) as temporary:
        temporary.write_bytes(data)


def main() -> None:
    """Entry point of the executable `loop_closure`."""
    exit_with(LoopClosureNode)


if __name__ == "__main__":
    main()
