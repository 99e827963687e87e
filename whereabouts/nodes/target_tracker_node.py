"""Node `target_tracker`: people in laser scans, counted and followed, hidden ones too."""

from __future__ import annotations

import time
from collections import deque
from typing import cast

from geometry_msgs.msg import PoseWithCovarianceStamped
from nav_msgs.msg import Odometry
from sensor_msgs.msg import LaserScan
from std_msgs.msg import Header
from visualization_msgs.msg import MarkerArray

from estimation.checks import FloatArray as Array
from estimation.errors import InputError
from estimation.geometry.pose_drift import PoseUncertainty
from registration.laser.mounting import level_pose, upright
from tracking.people.people_tracker import Person
from tracking.people.people_warm_up import warm_up
from tracking.people.scan_filters import tracker_of
from whereabouts.nodes.messages.conversions import (
    PLANAR,
    pose_from_message,
    scan_from_message,
    stated_covariance,
)
from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.messages.target_messages import people_markers, targets_message
from whereabouts.nodes.messages.transforms import frame_name
from whereabouts.nodes.ros.base import SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.parameters.target_tracker import TargetTrackerParameters
from whereabouts_msgs.msg import TargetArray

DRIFT_WINDOW = 30.0  # seconds over which the drift of odometry counts
TRAIL = 10 * NANOSECONDS  # of the markers


class TargetTrackerNode(SuiteNode):
    """People from one planar scanner."""

    parameters_model = TargetTrackerParameters
    node_name = "target_tracker"
    settings: TargetTrackerParameters

    def setup(self) -> None:
        warm_up(self.settings.people, self.settings.filter)
        # How uncertain the pose is, odometry or localisation says, whichever is in the frame of the tracks.
        odometry = self.add_input(Odometry, "odometry", self._take_uncertainty, sensor=False, on_demand=True)
        self.add_input(PoseWithCovarianceStamped, "robot_pose", self._take_uncertainty, sensor=False)
        self.listen_to_transforms()
        self.add_input(
            LaserScan, self.settings.scan_topic, self._take_scan, frames=self._frames, companions=[odometry]
        )
        self._targets_output = self.add_output(TargetArray, "targets")
        self._markers_output = self.add_output(MarkerArray, "~/markers")

    def start_run(self) -> None:
        self._tracker = tracker_of(self.settings.filter, self.settings.people)
        self._trails: dict[int, deque[tuple[int, Array]]] = {}
        self._uncertainty = {
            Odometry: PoseUncertainty(DRIFT_WINDOW),
            PoseWithCovarianceStamped: PoseUncertainty(),
        }
        self._certain = True
        self._count = self._scans = 0
        self._expected = self._milliseconds = 0.0

    def health(self) -> Health:
        if not self.active or self._scans == 0:
            return Health("waiting for scans")
        figures: dict[str, object] = {
            "people": self._count,
            "expected people": round(self._expected, 2),
            "candidates": self._tracker.health.potential,
            "tracking ms": round(self._milliseconds, 2),
            "robot pose": "assumed to be exact" if self._certain else "uncertain",
            "late": self._tracker.health.late,
            "pose jumps": self._tracker.health.jumps,
            "scans with too many clusters": self._tracker.health.thinned,
        }
        return Health("tracking", figures=figures)

    def _frames(self, message: LaserScan) -> list[tuple[str, str]]:
        return [(self.settings.odom_frame, message.header.frame_id)]

    def _take_uncertainty(self, message: Odometry | PoseWithCovarianceStamped, stamp: int) -> None:
        if frame_name(message.header.frame_id) != frame_name(self.settings.odom_frame):
            return
        covariance = stated_covariance(message.pose.covariance, PLANAR)
        if covariance is not None:
            pose = pose_from_message(message.pose.pose)[PLANAR]
            self._uncertainty[type(message)].add(stamp / NANOSECONDS, pose, covariance)

    def _pose_covariance(self, stamp: float, scanner: Array) -> Array | None:
        """Of the scanner's pose (3, 3), by localisation, else by odometry; None where nobody says."""
        localised = self._uncertainty[PoseWithCovarianceStamped].at(stamp, scanner)
        return self._uncertainty[Odometry].at(stamp, scanner) if localised is None else localised

    def _take_scan(self, message: LaserScan, stamp: int) -> None:
        settings = self.settings
        scan = scan_from_message(message)
        mounting = self.transforms.lookup(settings.odom_frame, message.header.frame_id, stamp)
        pose = level_pose(mounting)
        if pose is None:
            raise InputError(
                f"scanner {message.header.frame_id!r} is tilted, but people are only found in a level plane"
            )
        seconds = stamp / NANOSECONDS
        uncertain = self._pose_covariance(seconds, pose)
        self._certain = uncertain is None
        begun = time.perf_counter()
        found = self._tracker.step(upright(scan, mounting), pose, seconds, pose_covariance=uncertain)
        self._milliseconds = 1e3 * (time.perf_counter() - begun)
        people = cast(list[Person], found)
        self._scans += 1
        self._count, self._expected = len(people), self._tracker.expected_count
        self._publish(stamp, people)

    def _publish(self, stamp: int, people: list[Person]) -> None:
        header = Header(stamp=time_message(stamp), frame_id=frame_name(self.settings.odom_frame))
        self._targets_output.publish(targets_message(header, people, self._expected))
        present = {person.label for person in people}
        self._trails = {label: trail for label, trail in self._trails.items() if label in present}
        oldest = stamp - TRAIL
        for person in people:
            trail = self._trails.setdefault(person.label, deque())
            trail.append((stamp, person.mean[:2]))
            while trail and trail[0][0] < oldest:
                trail.popleft()
        if self._markers_output.wanted:
            trails = {label: [spot for _, spot in trail] for label, trail in self._trails.items()}
            self._markers_output.publish(people_markers(header, people, trails))


def main() -> None:
    exit_with(TargetTrackerNode)


if __name__ == "__main__":
    main()
