"""A node that is no part of the suite but talks to it: in a context of its own, so that many fit in one process."""

from __future__ import annotations

import rclpy
from rclpy.context import Context
from rclpy.node import Node

from whereabouts.nodes.ros.executor import NodeExecutor


def private_node(name: str, namespace: str = "") -> tuple[Node, NodeExecutor]:
    """The node, and what spins it."""
    context = Context()
    rclpy.init(context=context)
    node = Node(name, context=context, namespace=namespace or None)
    executor = NodeExecutor(context)
    executor.add_node(node)
    return node, executor


def leave(node: Node) -> None:
    """End the node and its context."""
    node.destroy_node()
    node.context.try_shutdown()
