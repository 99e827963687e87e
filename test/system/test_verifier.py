"""The verifier as a node: scans of a room with and without the thing it is asked about."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from geometry_msgs.msg import Point, Vector3
from harness import Graph, room, scan_message
from rclpy.action.client import ActionClient
from tf2_msgs.msg import TFMessage

from estimation.geometry.frame_tree import TransformError
from whereabouts.nodes.messages.stamps import NANOSECONDS, nanoseconds
from whereabouts.nodes.messages.transforms import transform_message
from whereabouts.nodes.verifier_node import VerifierNode
from whereabouts.simulation import Lidar, box, joined
from whereabouts_msgs.action import VerifyObject
from world_model.tasks.verification import RegionBox

POSE = np.array([-3.0, -1.5, 0.4])
THING = (-1.5, -1.4)


def goal(x: float, y: float, size: float = 0.6) -> VerifyObject.Goal:
    message = VerifyObject.Goal(object_id="bin-1", class_name="bin")
    message.header.frame_id = "map"
    message.region.center.position = Point(x=x, y=y, z=0.2)
    message.region.center.orientation.w = 1.0
    message.region.size = Vector3(x=size, y=size, z=size)
    return message


def test_what_is_there_is_found_and_measured_and_what_is_not_is_missed(graph: Graph) -> None:
    graph.start("verifier")
    graph.mount()
    lidar, rng, moment = Lidar(beams=361, opening=np.pi, range_max=25.0), np.random.default_rng(2), 0

    def look(*things: Any) -> None:
        nonlocal moment
        moment += 1
        scan = lidar.scan(joined([room(), *things]), POSE, rng, 0.1 * moment).scan
        message = scan_message(scan)
        half = 0.5 * POSE[2]
        where = (POSE[0], POSE[1], 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
        stamp = nanoseconds(message.header.stamp)
        graph.publish("/tf", TFMessage(transforms=[transform_message("map", "base_link", stamp, where)]))
        graph.publish("scan", message)

    client = ActionClient(graph.node, VerifyObject, "verify_object")
    graph.until(client.server_is_ready, "verify_object is served")
    impatient = goal(*THING)
    impatient.timeout.nanosec = 1_000_000
    sent = client.send_goal_async(impatient)
    graph.until(sent.done, "the impatient goal is answered")
    ended = sent.result().get_result_async()
    graph.until(ended.done, "the verifier has waited for a scan in vain")
    assert ended.result().result.code == VerifyObject.Result.TIMED_OUT, ended.result().result.message

    def ask(request: VerifyObject.Goal, *things: Any) -> VerifyObject.Result:
        sent = client.send_goal_async(request)

        def answered(future: Any) -> bool:
            look(*things)
            return bool(future.done())

        graph.until(lambda: answered(sent), "the goal is answered")
        result = sent.result().get_result_async()
        graph.until(lambda: answered(result), "the verifier has decided")
        return result.result().result

    thing = box(0.3, 0.3, (*THING, 0.2))
    found = ask(goal(*THING), thing)
    assert found.code == found.FOUND, found.message
    at = found.evidence.objects[0].pose.pose.position
    assert np.hypot(at.x - THING[0], at.y - THING[1]) < 0.25
    assert found.evidence.objects[0].object_id == "bin-1"
    assert found.evidence.header.frame_id == "map"
    missing = ask(goal(*THING))
    assert missing.code == missing.NOT_FOUND, missing.message
    assert missing.visible_share > 0.9
    screen = box(0.1, 1.5, (-2.2, -1.3, 0.4))
    hidden = ask(goal(*THING), thing, screen)
    assert hidden.code == hidden.OCCLUDED, hidden.message
    senseless = ask(goal(*THING, size=0.0))
    assert senseless.code == senseless.REFUSED
    assert "size" in senseless.message
    client.destroy()


def test_a_frame_is_where_the_sensor_was_when_it_came_though_tf_has_begun_anew_since(graph: Graph) -> None:
    node = VerifierNode(context=graph.context)
    node.trigger_configure()
    node.trigger_activate()
    lidar, rng = Lidar(beams=361, opening=np.pi, range_max=25.0), np.random.default_rng(3)
    thing = box(0.3, 0.3, (*THING, 0.2))
    message = scan_message(lidar.scan(joined([room(), thing]), POSE, rng, 0.1).scan)
    stamp = nanoseconds(message.header.stamp)
    half = 0.5 * POSE[2]
    pose = (POSE[0], POSE[1], 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
    node.transforms.insert(transform_message("map", message.header.frame_id, stamp, pose))
    node._take(message, stamp)
    for later in (100, 101):
        moment = stamp + later * NANOSECONDS
        node.transforms.insert(transform_message("map", message.header.frame_id, moment, pose))
    with pytest.raises(TransformError):
        node.transforms.lookup("map", message.header.frame_id, stamp)
    assert node._latest is not None
    region = RegionBox(np.array([*THING, 0.2]), np.full(3, 0.6))
    assert len(node._frame(region, *node._latest).points) >= 3
    node.destroy_node()
