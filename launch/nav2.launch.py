"""Launch all nodes of the suite and, beside them, nav2: it drives where search and maintenance send the robot."""

from launch import LaunchDescription

from whereabouts.node_names import NODES
from whereabouts.nodes.runtime.launching import description


def generate_launch_description() -> LaunchDescription:
    return description(*NODES, nav2=True)
