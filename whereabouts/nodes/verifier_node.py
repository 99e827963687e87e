"""Node `verifier`: looks into a region and says whether the object is there.

Replaceable by whatever can recognise objects better.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid as GridMessage
from sensor_msgs.msg import LaserScan, PointCloud2

from estimation.checks import FloatArray as Array
from estimation.geometry.grid import OccupancyGrid
from estimation.geometry.poses import transform_points
from whereabouts.messages.decode import cloud_colors
from whereabouts.nodes.messages.conversions import points_from_message, pose_from_message, spatial_covariance
from whereabouts.nodes.messages.markers import point
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds, seconds
from whereabouts.nodes.messages.transforms import frame_name
from whereabouts.nodes.messages.world_reading import grid_from_message
from whereabouts.nodes.ros.base import SuiteNode, exit_with
from whereabouts.nodes.ros.diagnostics import Health
from whereabouts.parameters.verifier import VerifierParameters
from whereabouts.system.counting import counted
from whereabouts_msgs.action import VerifyObject
from whereabouts_msgs.msg import ObjectEvidence, Region
from world_model.tasks.appearance import Appearance
from world_model.tasks.verification import (
    FOUND,
    Frame,
    RegionBox,
    Verification,
    look_with_cloud,
    look_with_scan,
)

CLEAR = 0.8  # share of a region that has to be seen before it counts as empty
WIDEST = 1.5  # metres: in a wider region not any return counts as the object
TIMEOUT = 3.0  # seconds, of a decision whose goal states none
SIGMA = 0.05  # metres, of a verified position per axis


class VerifierNode(SuiteNode):
    """Several frames, one answer."""

    parameters_model = VerifierParameters
    node_name = "verifier"
    settings: VerifierParameters

    def setup(self) -> None:
        self._map_frame = frame_name(self.settings.map_frame)
        self._grid: OccupancyGrid | None = None
        # Nobody looks most of the time.
        self.listen_to_transforms(on_demand=True)
        cloud_topic, scan_topic = self.settings.cloud_topic, self.settings.scan_topic
        kind, topic = (PointCloud2, cloud_topic) if cloud_topic else (LaserScan, scan_topic)
        self.add_input(kind, topic, self._take, frames=self._frames, on_demand=True)
        self.add_latched_input(GridMessage, "map", self._take_map)
        self.add_action(VerifyObject, "verify_object", self._serve)

    def start_run(self) -> None:
        self._latest: tuple[LaserScan | PointCloud2, Array] | None = None
        self._count = 0
        self._answers = dict.fromkeys(("found", "occluded", "not_found"), 0)

    def health(self) -> Health:
        return Health(
            "looking" if self._count else "waiting for scans or clouds", figures=dict(self._answers)
        )

    def _frames(self, message: LaserScan | PointCloud2) -> list[tuple[str, str]]:
        return [(self._map_frame, message.header.frame_id)]

    def _take(self, message: LaserScan | PointCloud2, stamp: int) -> None:
        # Where the sensor was is known now; by the time an action looks, tf may have begun anew.
        self._latest = (message, self.transforms.lookup(self._map_frame, message.header.frame_id, stamp))
        self._count += 1

    def _take_map(self, message: GridMessage, stamp: int) -> None:
        self._grid = grid_from_message(message, self._map_frame)

    async def _serve(self, handle: Any) -> Any:
        request, result = handle.request, VerifyObject.Result()
        box, settings = self._box(request), self.settings
        verification = Verification(
            box, settings.frames, settings.points, CLEAR, self._grid, WIDEST, _appearance(request)
        )
        limit = seconds(request.timeout) or TIMEOUT
        begun, taken, epoch = self.now, self._latest, self.epoch
        outcome: str | None = None
        while outcome is None:
            if handle.is_cancel_requested or epoch != self.epoch:
                cancelled = handle.is_cancel_requested
                handle.canceled() if cancelled else handle.abort()
                result.code, result.message = result.CANCELED, "cancelled" if cancelled else "a new run began"
                return result
            if self._latest is not None and self._latest is not taken:
                taken = self._latest
                outcome = verification.take(self._frame(box, *taken))
                result.evidence.header.stamp = taken[0].header.stamp
                handle.publish_feedback(
                    VerifyObject.Feedback(frames=verification.frames, visible_share=verification.visible)
                )
            if outcome is None and (self.now - begun) / NANOSECONDS > limit:
                break
            await self.pause(0.02)
        self._answer(handle, request, verification, outcome, result)
        return result

    def _answer(
        self, handle: Any, request: Any, verification: Verification, outcome: str | None, result: Any
    ) -> None:
        result.frames, result.visible_share = verification.frames, verification.visible
        handle.succeed()
        if verification.frames == 0:
            result.code, result.message = result.TIMED_OUT, "no scan or cloud arrived in time"
            return
        said = outcome or verification.outcome()
        self._answers[said] += 1
        result.code = getattr(result, said.upper())
        share = f"{verification.visible:.0%} of the region seen in {counted(verification.frames, 'frame')}"
        result.message = f"{request.object_id or request.class_name}: {said.replace('_', ' ')}, {share}"
        if said == FOUND:
            position, covariance = verification.measurement(SIGMA)
            result.evidence.header.frame_id = self._map_frame
            result.evidence.sensor = request.sensor
            # What it was told of its size is no measurement of it.
            named = [told for told in request.attributes if len(told.discrete.values)]
            item = ObjectEvidence(object_id=request.object_id, attributes=named)
            item.pose.pose.position = point(position)
            item.pose.pose.orientation.w = 1.0
            full = spatial_covariance(np.zeros((3, 3))).reshape(6, 6)
            full[:3, :3] = covariance
            item.pose.covariance = full.reshape(36)
            result.evidence.objects = [item]

    def _box(self, request: Any) -> RegionBox:
        """The region in the map. Raises InputError where it is none, TransformError where it cannot be placed."""
        region: Region = request.region
        frame = frame_name(request.header.frame_id) or self._map_frame
        size = np.array([region.size.x, region.size.y, region.size.z])
        centre = pose_from_message(region.center)[:3]
        if frame != self._map_frame:
            centre = transform_points(
                self.transforms.lookup(self._map_frame, frame, nanoseconds(request.header.stamp)),
                centre[None],
            )[0]
        return RegionBox(centre, size)

    def _frame(self, box: RegionBox, message: LaserScan | PointCloud2, sensor: Array) -> Frame:
        reach = self.settings.max_range
        if isinstance(message, LaserScan):
            farthest = min(message.range_max, reach) if message.range_max > 0.0 else reach
            ranges = np.asarray(message.ranges, dtype=np.float64)
            return look_with_scan(box, ranges, message.angle_min, message.angle_increment, farthest, sensor)
        points, _ = points_from_message(message)
        return look_with_cloud(box, transform_points(sensor, points), sensor, reach, cloud_colors(message))


def _appearance(request: Any) -> Appearance:
    size: tuple[float, float] | None = None
    colors: dict[str, float] = {}
    for item in request.attributes:
        if item.name == "size" and len(item.continuous.mean) == 1 and len(item.continuous.covariance) == 1:
            size = float(item.continuous.mean[0]), max(float(item.continuous.covariance[0]), 0.0)
        elif item.name == "color":
            colors = dict(zip(item.discrete.values, map(float, item.discrete.probabilities), strict=False))
    return Appearance(size, colors)


def main() -> None:
    exit_with(VerifierNode)


if __name__ == "__main__":
    main()
