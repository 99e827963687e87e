"""Launch all nodes of the suite, in order; `--show-args` lists the arguments."""

from launch import LaunchDescription

from whereabouts.node_names import NODES
from whereabouts.nodes.runtime.launching import description


def generate_launch_description() -> LaunchDescription:
    return description(*NODES)
