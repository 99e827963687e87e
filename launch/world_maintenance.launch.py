"""Launch the node world_maintenance."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode


def generate_launch_description() -> LaunchDescription:
    config = Path(get_package_share_directory("whereabouts")) / "config" / "world_maintenance.yaml"
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="namespace of the node"),
            DeclareLaunchArgument("params_file", default_value=str(config), description="parameter file"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="follow /clock"),
            LifecycleNode(
                package="whereabouts",
                executable="world_maintenance",
                name="world_maintenance",
                namespace=LaunchConfiguration("namespace"),
                parameters=[
                    LaunchConfiguration("params_file"),
                    {"use_sim_time": LaunchConfiguration("use_sim_time")},
                ],
                output="screen",
            ),
        ]
    )
