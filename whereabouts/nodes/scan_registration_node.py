"""Node `scan_registration`: follows the robot by its laser scans or clouds."""

from __future__ import annotations

from functools import partial

import numpy as np
from nav_msgs.msg import Odometry as OdometryMessage
from sensor_msgs.msg import LaserScan, PointCloud2
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.poses import (
    compound,
    compound_jacobians,
    inverse,
    pose_from_matrix,
    pose_to_matrix,
    pose_to_quaternion,
    transform_points,
)
from registration.crf.online import ScanSegmenter
from registration.laser.mounting import level_pose, seen_from_robot, upright
from registration.laser.scan import Scan
from registration.odometry.follower import Odometry
from registration.odometry.pace import Pace
from registration.odometry.wheel_history import WheelHistory
from registration.registration_warm_up import warm_up, warm_up_segmenter
from whereabouts.nodes.messages.conversions import (
    PLANAR,
    cloud_message,
    fill_pose,
    points_from_message,
    pose_from_message,
    scan_from_message,
    segments_message,
    spatial,
    spatial_covariance,
)
from whereabouts.nodes.messages.markers import vector
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.transforms import FrameOwner, frame_name, transform_message
from whereabouts.nodes.ros.base import SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.nodes.ros.inputs import Input
from whereabouts.parameters.scan_registration import ScanRegistrationParameters
from whereabouts_msgs.msg import ScanSegments

# A scan of a further sensor that is older than this says too little about now, ns, and wheel odometry, s.
OTHERS_AGE = NANOSECONDS // 2
WHEEL_AGE = 0.5


class ScanRegistrationNode(SuiteNode):
    """Odometry of the robot from its range sensors."""

    parameters_model = ScanRegistrationParameters
    node_name = "scan_registration"
    sends_clouds = True
    settings: ScanRegistrationParameters

    def setup(self) -> None:
        settings = self.settings
        if not settings.clouds:
            warm_up(settings.odometry)
        self._segmenter: ScanSegmenter | None = None
        self._pace = Pace()
        # Which beams are whose is known only for one scanner that looks along the ground.
        if settings.segment_scans and len(settings.scans) == 1 and not settings.clouds:
            # Lock-step replay has all the time there is, and has to repeat.
            self._segmenter = ScanSegmenter(settings.segmenter, in_time=not settings.report_processed)
            warm_up_segmenter(self._segmenter)
            self._segments_output = self.add_output(ScanSegments, "segments")
        self._wheels = WheelHistory()
        self._owner = FrameOwner(settings.odom_frame, settings.base_frame)
        self.listen_to_transforms()
        if settings.wheel_topic:
            self.add_input(OdometryMessage, settings.wheel_topic, self._take_wheels)
        self._cloud_inputs: dict[str, Input] = {}
        for topic in settings.clouds:
            taken = self.add_input(PointCloud2, topic, partial(self._take_cloud, topic), frames=self._frames)
            self._cloud_inputs[topic] = taken
        if not settings.clouds:
            for rank, topic in enumerate(settings.scans):
                handler = self._take_scan if rank == 0 else partial(self._keep_scan, topic)
                scans = self.add_input(LaserScan, topic, handler, frames=self._frames)
                if rank == 0:
                    self._scan_input = scans
        self._odometry_output = self.add_output(OdometryMessage, "odometry")
        self._static_output = self.add_output(PointCloud2, "static_points")
        self._tf_output = self.broadcaster()

    def start_run(self) -> None:
        self._odometry = Odometry(self.settings.odometry)
        self._wheels.clear()
        if self._segmenter is not None:
            self._segmenter.reset()
        self._pace.reset()
        self._velocity: Array = np.zeros(3)
        self._others: dict[str, tuple[int, Scan, Array]] = {}
        self._last_stamp: int | None = None
        self._frame: str | None = None
        self._registered = 0
        self._unsure = 0

    def health(self) -> Health:
        if not self.active or self._registered == 0:
            return Health("waiting for scans")
        odometry = self._odometry
        figures: dict[str, object] = {
            "registered": self._registered,
            "unsure": self._unsure,
            "fitness": float(odometry.fitness),
        }
        if self._segmenter is not None:
            figures |= {"scans labelled": self._segmenter.labelled, "labels skipped": self._segmenter.skipped}
        if self.settings.publish_tf and self._owner.withheld:
            return Health(self._owner.withheld, warning=True, figures=figures)
        if odometry.converged:
            return Health("following", figures=figures)
        return Health(f"unsure: {odometry.reason}", warning=True, figures=figures)

    def _frames(self, message: LaserScan | PointCloud2) -> list[tuple[str, str]]:
        return [(self.settings.base_frame, message.header.frame_id)]

    def _take_wheels(self, message: OdometryMessage, stamp: int) -> None:
        self._wheels.insert(stamp, pose_from_message(message.pose.pose)[PLANAR])

    def _check_age(self, item: Input, stamp: int) -> None:
        """The robot has gone on since an old scan was taken."""
        if item.behind(stamp) > OTHERS_AGE:
            raise InputError(
                f"it is {item.behind(stamp) / NANOSECONDS:.3f} s older than the previous message"
            )

    def _take_scan(self, message: LaserScan, stamp: int) -> None:
        self._check_age(self._scan_input, stamp)
        scan = scan_from_message(message)
        mounting = self.transforms.lookup(self.settings.base_frame, message.header.frame_id, stamp)
        level = level_pose(mounting)
        self._pace.begin(stamp / NANOSECONDS, self._scan_input.arrived)
        seen: Scan | None = None
        if level is None or len(self.settings.scans) > 1:
            # Scans of several sensors, and tilted ones, become one scan around the robot itself.
            elapsed = 0.0 if self._last_stamp is None else (stamp - self._last_stamp) / NANOSECONDS
            recent = self._recent_others(stamp)
            motion, level = self._velocity * elapsed, np.zeros(3)
            scan = seen_from_robot((scan, mounting), *recent, motion=motion, elapsed=elapsed)
            self._odometry.register(scan, stamp / NANOSECONDS, guess=self._guess(stamp, level))
        else:
            seen = upright(scan, mounting)
            sweep = _seen_from(level, self._wheels.sweep(stamp, seen))
            guess = self._guess(stamp, level)
            self._odometry.register(
                self._still(seen, stamp, guess), stamp / NANOSECONDS, guess=guess, sweep=sweep
            )
        back = inverse(level)
        pose = compound(compound(level, self._odometry.pose), back)
        covariance = _conjugate(level, self._odometry.pose, self._odometry.covariance)
        step = compound(compound(level, self._odometry.increment), back)
        step_covariance = _conjugate(level, self._odometry.increment, self._odometry.increment_covariance)
        if self._last_stamp is not None and stamp > self._last_stamp:
            self._velocity = step / ((stamp - self._last_stamp) / NANOSECONDS)
        self._publish(
            stamp,
            spatial(pose),
            spatial_covariance(covariance),
            spatial(step),
            spatial_covariance(step_covariance),
            transform_points(level, self._odometry.static_points),
        )
        self.turns.let_go()
        if seen is not None and self._segmenter is not None:
            seconds, pose = stamp / NANOSECONDS, self._odometry.pose
            labels = self._segmenter.segment(seen, seconds, pose, self._pace.left)
            self._segments_output.publish(
                segments_message(message.header, labels, bool(mounting[2, 2] < 0.0))
            )
            self._segmenter.keep(seen, seconds, pose)

    def _still(self, scan: Scan, stamp: int, guess: Array | None) -> Scan:
        """A scan without what moved in the last one, as far as is known."""
        if self._segmenter is None:
            return scan
        motion = self._odometry.increment if guess is None else guess
        return self._segmenter.still(scan, stamp / NANOSECONDS, compound(self._odometry.pose, motion))

    def _keep_scan(self, topic: str, message: LaserScan, stamp: int) -> None:
        """A scan of a further sensor: registered together with the next one of the first."""
        mounting = self.transforms.lookup(self.settings.base_frame, message.header.frame_id, stamp)
        self._others[topic] = (stamp, scan_from_message(message), mounting)

    def _recent_others(self, stamp: int) -> list[tuple[Scan, Array]]:
        """Latest scans of further sensors, moved to where the robot is at `stamp`."""
        recent = []
        for then, scan, mounting in self._others.values():
            if abs(stamp - then) > OTHERS_AGE:
                continue
            motion = self._wheels.motion(then, stamp, WHEEL_AGE) if then <= stamp else None
            if motion is None:
                motion = self._velocity * ((stamp - then) / NANOSECONDS)
            recent.append((scan, pose_to_matrix(spatial(inverse(motion))) @ mounting))
        return recent

    def _take_cloud(self, topic: str, message: PointCloud2, stamp: int) -> None:
        self._check_age(self._cloud_inputs[topic], stamp)
        points, times = points_from_message(message)
        mounting = self.transforms.lookup(self.settings.base_frame, message.header.frame_id, stamp)
        # Registered in the robot frame, so that several sensors share one map.
        points = transform_points(mounting, points)
        guess = self._guess(stamp, np.zeros(3))
        matrix = None if guess is None else pose_to_matrix(spatial(guess))
        self._odometry.register(points, stamp / NANOSECONDS, guess=matrix, times=times)
        self._publish(
            stamp,
            pose_from_matrix(self._odometry.pose),
            self._odometry.covariance.reshape(36),
            pose_from_matrix(self._odometry.increment),
            self._odometry.increment_covariance.reshape(36),
            self._odometry.static_points,
        )

    def _guess(self, stamp: int, level: Array) -> Array | None:
        """Motion of the sensor since the last scan by the wheels, in its frame then."""
        if self._last_stamp is None:
            return None
        return _seen_from(level, self._wheels.motion(self._last_stamp, stamp, WHEEL_AGE))

    def _publish(
        self, stamp: int, pose: Array, covariance: Array, step: Array, step_covariance: Array, still: Array
    ) -> None:
        """Say where the robot is and how it got there, (6,) and (36,) each; still : points that stand, (N, 2 | 3)."""
        settings = self.settings
        message = OdometryMessage()
        message.header = Header(stamp=time_message(stamp), frame_id=frame_name(settings.odom_frame))
        message.child_frame_id = frame_name(settings.base_frame)
        fill_pose(message.pose.pose, pose)
        message.pose.covariance = covariance
        elapsed = 0.0 if self._last_stamp is None else (stamp - self._last_stamp) / NANOSECONDS
        if elapsed > 0.0:
            speed, twist = step / elapsed, message.twist.twist
            twist.linear, twist.angular = vector(speed[:3]), vector(speed[3:])
            message.twist.covariance = step_covariance / elapsed**2
        self._odometry_output.publish(message)
        if settings.publish_tf and self._may_publish_tf(stamp):
            position, quaternion = pose_to_quaternion(pose)
            transform = transform_message(
                message.header.frame_id, message.child_frame_id, stamp, (*position, *quaternion)
            )
            self._tf_output.publish(TFMessage(transforms=[transform]))
        if self._static_output.wanted:
            header = Header(stamp=time_message(stamp), frame_id=frame_name(settings.base_frame))
            self._static_output.publish(cloud_message(header, still))
        self._last_stamp = stamp
        self._registered += 1
        if self._odometry.unsure:
            self._unsure += 1
            self.complain(f"unsure: {self._odometry.reason}", key="unsure")

    def _may_publish_tf(self, stamp: int) -> bool:
        """Whether the frame of the robot is this node's to place; said once where it is not."""
        before = self._owner.withheld
        mine = self._owner.takes(stamp, self.transforms)
        if self._owner.withheld and not before:
            self.alarm(self._owner.withheld)
        return mine

    def _take_transforms(self, message: TFMessage, static: bool) -> None:
        self._owner.hear(message)
        super()._take_transforms(message, static)


def _seen_from(level: Array, motion: Array | None) -> Array | None:
    """Motion (3,) of the robot as one of its sensor, mounted at `level` (3,)."""
    return None if motion is None else compound(compound(inverse(level), motion), level)


def _conjugate(level: Array, motion: Array, covariance: Array) -> Array:
    """Covariance (3, 3) of the robot's motion from that of its sensor, mounted at `level`."""
    _, by_motion = compound_jacobians(level, motion)
    by_sensor, _ = compound_jacobians(compound(level, motion), inverse(level))
    J = by_sensor @ by_motion
    return np.asarray(J @ covariance @ J.T)


def main() -> None:
    exit_with(ScanRegistrationNode)


if __name__ == "__main__":
    main()
