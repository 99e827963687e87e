"""What is declared about the nodes' topics, services and actions is what they have."""

from __future__ import annotations

import importlib
import inspect
from collections.abc import Callable, Iterator
from typing import Any

import pytest
from harness import Graph
from rclpy.action.graph import (
    get_action_client_names_and_types_by_node,
    get_action_server_names_and_types_by_node,
)
from rclpy.qos import DurabilityPolicy

from whereabouts.node_interfaces import NODE_INTERFACES, interfaces_of
from whereabouts.node_names import NODES
from whereabouts.nodes.ros.base import SuiteNode
from whereabouts.parameters.parameter_base import model_of

ROS_OWN = (
    "parameter", "rosout", "change_state", "get_state", "get_available", "transition", "type_description", "clock",
    "_action/",
)  # fmt: skip


def node_class(name: str) -> Callable[..., SuiteNode]:
    module = importlib.import_module(f"whereabouts.nodes.{name}_node")
    (found,) = [
        item
        for _, item in inspect.getmembers(module, inspect.isclass)
        if issubclass(item, SuiteNode) and item.__module__ == module.__name__
    ]
    return found


def present(node: SuiteNode) -> Iterator[tuple[str, str, str]]:
    """(kind, name, type) of everything a node has, without what all ROS nodes have."""
    me = (node.get_name(), node.get_namespace())
    listed: list[tuple[str, Any]] = [
        ("in", node.get_subscriber_names_and_types_by_node(*me)),
        ("out", node.get_publisher_names_and_types_by_node(*me)),
        ("service", node.get_service_names_and_types_by_node(*me)),
        ("action", get_action_server_names_and_types_by_node(node, *me)),
        ("calls", get_action_client_names_and_types_by_node(node, *me)),
    ]
    for kind, items in listed:
        for name, types in items:
            if not any(word in name for word in ROS_OWN):
                own = f"/{node.get_name()}/"
                short = f"~/{name.removeprefix(own)}" if name.startswith(own) else name.lstrip("/")
                yield (
                    kind,
                    short,
                    types[0].replace("/msg/", "/").replace("/srv/", "/").replace("/action/", "/"),
                )


def test_all_nodes_are_declared_and_name_parameters_that_exist() -> None:
    assert set(NODE_INTERFACES) == set(NODES)
    for node in NODES:
        for item in interfaces_of(node):
            assert not item.when or item.when in model_of(node).model_fields
            assert item.meaning


@pytest.mark.parametrize("name", NODES)
def test_a_node_has_what_is_declared(graph: Graph, name: str) -> None:
    node = node_class(name)(context=graph.context)
    try:
        node.trigger_configure()
        assert node.inputs, "it is configured"
        declared = interfaces_of(name)
        # What a parameter brings in or names need not be there by default.
        always = {(item.kind, item.name.lstrip("/"), item.type) for item in declared if not item.when}
        possible = {(item.kind, item.name.lstrip("/"), item.type) for item in declared}
        graph.until(lambda: always <= set(present(node)), f"{name} has all that is declared")
        assert set(present(node)) <= possible
        for item in declared:
            latched = "latched" in item.way
            if item.kind in ("in", "out") and not item.when:
                topic = node.resolve_topic_name(item.name)
                ends = (
                    node.get_publishers_info_by_topic
                    if item.kind == "out"
                    else node.get_subscriptions_info_by_topic
                )(topic)
                kept = [
                    end.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL
                    for end in ends
                    if end.node_name == name
                ]
                assert kept == [latched] * len(kept), item.name
    finally:
        node.destroy_node()


def test_health_is_on_one_topic_for_all_namespaces_unless_it_is_renamed(graph: Graph) -> None:
    kind = node_class("verifier")
    renamed = ["--ros-args", "-r", "/diagnostics:=health"]
    nodes = [
        kind(context=graph.context, namespace="/robot1"),
        kind(context=graph.context, namespace="/robot2", cli_args=renamed),
    ]
    try:
        for node, topic in zip(nodes, ("/diagnostics", "/robot2/health"), strict=True):
            names = {
                name
                for name, types in node.get_publisher_names_and_types_by_node(
                    node.get_name(), node.get_namespace()
                )
                if types == ["diagnostic_msgs/msg/DiagnosticArray"]
            }
            assert names == {topic}
    finally:
        for node in nodes:
            node.destroy_node()
