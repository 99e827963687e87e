"""What a topic is for decides its QoS, and a node that is not configured yet takes other parameters."""

from __future__ import annotations

from typing import Any

from diagnostic_msgs.msg import DiagnosticArray
from harness import Graph
from lifecycle_msgs.msg import State, Transition
from rcl_interfaces.msg import Parameter, ParameterType, ParameterValue
from rcl_interfaces.srv import SetParameters
from rclpy.qos import ReliabilityPolicy, qos_profile_sensor_data

from whereabouts.nodes.messages.stamps import NANOSECONDS, time_message
from whereabouts.nodes.ros.qos import HEARD_LATCHED
from whereabouts_msgs.msg import WorldEvidence, WorldState


def figures(diagnostics: list[DiagnosticArray], node: str) -> dict[str, str]:
    found: dict[str, str] = {}
    for array in diagnostics:
        for status in array.status:
            if status.name == node:
                found = {item.key: item.value for item in status.values} | {"said": status.message}
    return found


def test_a_world_that_was_told_before_reaches_those_who_come_late(graph: Graph) -> None:
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    publisher = graph.node.create_publisher(WorldState, "world_state", HEARD_LATCHED)
    world = WorldState()
    world.header.frame_id, world.header.stamp = "map", time_message(1000 * NANOSECONDS)
    publisher.publish(world)
    for node in ("world_maintenance", "object_search"):
        # As on a robot: sensors are best effort there.
        graph.start(node, input_reliability="best_effort")
        graph.until(
            lambda node=node: figures(diagnostics, node).get("/world_state used") == "1",  # type: ignore[misc]
            f"{node} has the world that was told before it began",
        )


def test_verdicts_are_read_reliably_and_who_offers_less_is_named(graph: Graph) -> None:
    diagnostics = graph.collect(DiagnosticArray, "/diagnostics")
    graph.start("world_model", input_reliability="best_effort")
    reliable = {
        info.topic_type: info.qos_profile.reliability
        for topic in ("evidence", "targets")
        for info in graph.node.get_subscriptions_info_by_topic(f"/{topic}")
    }
    assert set(reliable.values()) == {ReliabilityPolicy.RELIABLE}
    less = graph.node.create_publisher(WorldEvidence, "evidence", qos_profile_sensor_data)
    graph.until(
        lambda: any(
            "/evidence: a publisher offers less than is asked for (reliability)" in status.message
            for array in diagnostics
            for status in array.status
        ),
        "the publisher is named in diagnostics",
    )
    graph.node.destroy_publisher(less)


def test_parameters_can_be_set_while_a_node_is_unconfigured(graph: Graph) -> None:
    spec = graph.start("scan_registration", wait=False, autostart=False, report_processed=False)
    graph.until(lambda: graph.state(spec) == State.PRIMARY_STATE_UNCONFIGURED, "the node is there")

    def take(*topics: str) -> Any:
        value = ParameterValue(type=ParameterType.PARAMETER_STRING_ARRAY, string_array_value=list(topics))
        request = SetParameters.Request(parameters=[Parameter(name="scan_topics", value=value)])
        return graph.call(SetParameters, "scan_registration/set_parameters", request).results[0]

    def listens(topic: str) -> bool:
        return graph.node.count_subscribers(topic) > 0

    assert take("front").successful
    assert take("a", "a").reason.startswith("parameter scan_topics: each topic may be named once")
    graph.change(spec, Transition.TRANSITION_CONFIGURE)
    graph.until(lambda: listens("/front"), "it listens to what was set")
    assert not listens("/scan")
    refused = take("rear")
    assert not refused.successful
    assert refused.reason == "scan_topics can only be set while the node is unconfigured: clean it up first"
    graph.change(spec, Transition.TRANSITION_CLEANUP)
    assert take("rear").successful
    graph.change(spec, Transition.TRANSITION_CONFIGURE)
    graph.until(lambda: listens("/rear") and not listens("/front"), "it listens to the other one")
