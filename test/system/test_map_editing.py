"""What a person does to a map over DDS: pause it, take a closure out, ask for it."""

from __future__ import annotations

import re

import numpy as np
from geometry_msgs.msg import PointStamped
from harness import Graph, room
from nav_msgs.msg import OccupancyGrid
from nav_msgs.msg import Path as PathMessage
from nav_msgs.srv import GetMap
from std_srvs.srv import SetBool, Trigger
from test_loop_closure import Mapper

from estimation.geometry.poses import between
from whereabouts.nodes.ros.qos import LATCHED
from whereabouts.simulation import Drive, Lidar
from whereabouts_msgs.msg import LoopClosure


def test_a_map_is_paused_corrected_and_asked_for(graph: Graph) -> None:
    robot = Mapper(graph)
    corners = [(-3.0, -1.5), (2.5, -1.5), (2.5, 1.5), (-3.0, 1.5)]
    robot.world, robot.lidar = room(), Lidar(181)
    robot.drive = Drive([*(8 * corners), corners[0]], speed=1.0, turn_rate=1.5)
    graph.start("scan_registration")
    spec = graph.start("loop_closure", map_period=0.05, loop_path=5.0)
    paths = graph.collect(PathMessage, "trajectory", LATCHED)
    maps = graph.collect(OccupancyGrid, "map", LATCHED)
    closures: list[LoopClosure] = graph.collect(LoopClosure, "loop_closures")
    graph.mount()
    robot.introduce()
    nothing = graph.call(Trigger, "loop_closure/remove_closure", Trigger.Request())
    assert not nothing.success
    assert nothing.message == "there is no closure in the map"
    robot.go(0.0, 5.0, 0.25)
    graph.until(lambda: paths and len(paths[-1].poses) >= 4, "a path")

    # While it is paused the robot goes on in the map, which stays as it is.
    answer = graph.call(SetBool, "loop_closure/pause", SetBool.Request(data=True))
    assert answer.success
    told = len(robot.transforms)
    robot.go(5.0, 6.0, 0.25)
    graph.until(lambda: len(robot.transforms) > told, "transforms go on")
    # Scans that waited when it was paused are in the map by now, and a path is published just before its map.
    asked = graph.call(GetMap, "loop_closure/dynamic_map", GetMap.Request()).map
    graph.until(lambda: maps and maps[-1].data == asked.data, "the map of the pause is published")
    kept, told = paths[-1], len(robot.transforms)
    robot.go(6.0, 9.0, 0.25)
    graph.until(lambda: len(robot.transforms) > told, "transforms go on")
    miss = between(robot.truth(8.75), graph.until(robot.in_map, "tf has the robot in the map")[0])
    assert np.hypot(*miss[:2]) < 0.15
    asked = graph.call(GetMap, "loop_closure/dynamic_map", GetMap.Request()).map
    assert asked.header.frame_id == "map"
    assert asked.info.width * asked.info.height == len(asked.data) > 0
    graph.until(lambda: maps and maps[-1].data == asked.data, "the map that was published is the same")
    assert len(paths[-1].poses) <= len(kept.poses) + 1

    # It goes on, and closes its loops.
    assert graph.call(SetBool, "loop_closure/pause", SetBool.Request(data=False)).success
    now, before = 9.0, robot.used
    while not closures:
        # It drives as fast as the odometry answers; on a busy machine the map gets to see few of the scans.
        assert robot.used - before < 160, "two rounds of scans were used, and no loop was closed"
        assert now < 130.0, "the robot drove seven rounds, and its scans were not used"
        robot.go(now, now + 1.0, 0.25)
        now += 1.0
    miss = between(robot.truth(now - 0.25), graph.until(robot.in_map, "tf has the robot in the map")[0])
    assert np.hypot(*miss[:2]) < 0.25

    # Far from any closure nothing is taken out; without a point it is the newest one.
    point = PointStamped()
    point.header.frame_id = "map"
    point.point.x, point.point.y = 500.0, 0.0
    graph.publish("clicked_point", point)
    graph.until(lambda: graph.heard(spec, "/clicked_point"), "the point has arrived")

    def refused() -> bool:
        said = graph.call(Trigger, "loop_closure/remove_closure", Trigger.Request())
        return not said.success and "away, more than 3 m" in said.message

    assert refused()
    said = graph.call(Trigger, "loop_closure/remove_closure", Trigger.Request())
    assert said.success, said.message
    assert re.search(r" 1 closure taken out| [2-9]\d* closures taken out", said.message)
