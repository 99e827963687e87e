"""The viewer on a running graph."""

from __future__ import annotations

from typing import Any

import numpy as np
from harness import Graph, mounting, room, scan_message
from nav_msgs.msg import OccupancyGrid
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import Image, LaserScan
from std_msgs.msg import String
from tf2_msgs.msg import TFMessage

from whereabouts.nodes.live.listener import Listener
from whereabouts.nodes.ros.qos import LATCHED, TF_STATIC_QOS
from whereabouts.simulation import Lidar
from whereabouts.viewer.drawable import Points
from whereabouts.viewer.scene import Scene


def test_sensors_and_what_was_said_before_are_heard_and_drawn(graph: Graph) -> None:
    scene, drawn = Scene(), {}

    def take(type_name: str, topic: str, message: Any, arrival: int) -> None:
        assert arrival > 0
        drawn.update({shape.path: shape for shape in scene.take(type_name, topic, message)})

    node = graph.node
    early = node.create_publisher(OccupancyGrid, "/robot1/map", LATCHED)
    grid = OccupancyGrid()
    grid.header.frame_id = "map"
    grid.info.width, grid.info.height, grid.info.resolution = 2, 1, 0.5
    grid.data = [0, 100]
    early.publish(grid)
    mounts = node.create_publisher(TFMessage, "/robot1/tf_static", TF_STATIC_QOS)
    mounts.publish(TFMessage(transforms=[mounting("laser", (0.1, 0.0, 0.2, 0.0, 0.0, 0.0, 1.0))]))
    scans = node.create_publisher(LaserScan, "/robot1/scan", qos_profile_sensor_data)
    others = [node.create_publisher(String, "/robot1/talk", 1), node.create_publisher(LaserScan, "/scan", 1)]
    listener = Listener(node, scene.types, take, "/robot1")
    simulated = Lidar(beams=91, opening=np.pi).scan(room(), np.zeros(3), np.random.default_rng(1), 1.0).scan
    wanted = {"map/map", "map/odom/base_link/laser", "map/odom/base_link/laser/scan"}

    def complete() -> bool:
        listener.look()
        scans.publish(scan_message(simulated))
        return wanted <= set(drawn)

    graph.until(complete, "map, mounting and scans are drawn")
    assert set(listener.topics) == {"/robot1/map", "/robot1/tf_static", "/robot1/scan"}
    assert isinstance(drawn["map/map"], Points)
    assert drawn["map/map"].positions.tolist() == [[0.75, 0.25, 0.0]]
    assert len(drawn["map/odom/base_link/laser/scan"].positions) == int(simulated.valid.sum())
    assert not scene.skipped
    assert len(others) == 2


def test_a_topic_of_which_one_message_tells_all_is_left_after_it(graph: Graph) -> None:
    """Pictures of a camera would take the time that is needed for the rest."""
    heard: list[str] = []
    node = graph.node
    pictures = node.create_publisher(Image, "color", 1)
    kind = "sensor_msgs/msg/Image"
    listener = Listener(node, (kind,), lambda kind, topic, *_: heard.append(topic), brief=(kind,))

    def left() -> bool:
        listener.look()
        pictures.publish(Image())
        return bool(heard) and node.count_subscribers("/color") == 0

    graph.until(left, "the pictures are listened to no more")
    assert listener.look() == []
