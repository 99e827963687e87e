"""What a person does to a map while it is made: pause it, take a false closure out, ask for it."""

from __future__ import annotations

import numpy as np
from geometry_msgs.msg import PointStamped
from nav_msgs.srv import GetMap
from numpy.typing import NDArray
from std_srvs.srv import SetBool, Trigger

from estimation.errors import InputError
from loop_closure.graph.edges import Edge
from loop_closure.motions import positions
from loop_closure.slam.editing import nearest_closure
from loop_closure.slam.trajectory import Slam
from whereabouts.nodes.mapping.map_in_use import MapInUse
from whereabouts.nodes.mapping.map_publisher import MapPublisher, MapTransform
from whereabouts.nodes.messages.transforms import check_frame
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.system.counting import counted

REACH = 3.0  # metres from a clicked point within which a closure is meant


class MapEditing:
    """Services of a node that makes a map.

    paused : whether scans are to be left out of the map.
    """

    def __init__(
        self, node: SuiteNode, made: MapInUse, publisher: MapPublisher, transform: MapTransform
    ) -> None:
        self._node, self._map, self._publisher, self._transform = node, made, publisher, transform
        self.paused = False
        self._clicked: NDArray[np.float64] | None = None
        # A person, not a sensor: its stamp says nothing about the run.
        node.add_input(PointStamped, "clicked_point", self._take_point, sensor=False)
        node.add_service(SetBool, "~/pause", self._pause)
        node.add_service(Trigger, "~/remove_closure", self._remove)
        node.add_service(GetMap, "~/dynamic_map", self._get)

    def _take_point(self, message: PointStamped, stamp: int) -> None:
        check_frame("clicked_point", message.header.frame_id, self._node.settings.map_frame)
        self._clicked = np.array([message.point.x, message.point.y])

    def _pause(self, request: SetBool.Request, _: SetBool.Response) -> str:
        self.paused = bool(request.data)
        return "scans are left out of the map" if self.paused else "scans are added to the map"

    def _remove(self, _request: Trigger.Request, _: Trigger.Response) -> str:
        """Take out the closure at the clicked point, or the last one; each click counts once.

        Everything is published anew, and the robot goes with the last keyframe.
        """
        if self._map.localizer is not None:
            raise InputError("a map in which the robot is only localised is not changed")
        slam = self._map.slam
        point, self._clicked = self._clicked, None
        edge = self._meant(slam, point)
        at = positions(slam.graph.poses)[edge.b]
        first, second = slam.keyframes[edge.a].stamp, slam.keyframes[edge.b].stamp
        before = slam.pose
        count = slam.remove_closure(edge)
        if self._map.edited(before):
            self._transform.publish()
        left = sum(item.closure for item in slam.graph.edges)
        done = (
            f"the revisit at ({at[0]:.1f}, {at[1]:.1f}) of scans at {first:.1f} s and {second:.1f} s: "
            f"{counted(count, 'closure')} taken out, {counted(left, 'is', 'are')} left"
        )
        self._node.get_logger().info(done)
        return done

    def _meant(self, slam: Slam, point: NDArray[np.float64] | None) -> Edge:
        """The closure that a person means by a point; without one the newest."""
        closures = [edge for edge in slam.graph.edges if edge.closure]
        if not closures:
            raise InputError("there is no closure in the map")
        if point is None:
            return max(closures, key=lambda edge: edge.b)
        found = nearest_closure(closures, slam.graph.poses, point)
        assert found is not None
        edge, away = found
        if away > REACH:
            raise InputError(
                f"the closure nearest to ({point[0]:.1f}, {point[1]:.1f}) is {away:.1f} m away, more than {REACH:g} m"
            )
        return edge

    def _get(self, _: GetMap.Request, response: GetMap.Response) -> None:
        response.map = self._publisher.message()
