"""Launch the node scan_registration; `--show-args` lists the arguments."""

from launch import LaunchDescription

from whereabouts.nodes.runtime.launching import description


def generate_launch_description() -> LaunchDescription:
    return description("scan_registration")
