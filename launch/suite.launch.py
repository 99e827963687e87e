"""Launch all nodes of the suite, with their shipped parameter files."""

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

NODES = [
    "scan_registration",
    "loop_closure",
    "target_tracker",
    "motion_predictor",
    "world_model",
    "world_maintenance",
    "verifier",
    "object_search",
]


def generate_launch_description() -> LaunchDescription:
    folder = Path(get_package_share_directory("whereabouts")) / "launch"
    arguments = {
        "namespace": LaunchConfiguration("namespace"),
        "use_sim_time": LaunchConfiguration("use_sim_time"),
    }
    return LaunchDescription(
        [
            DeclareLaunchArgument("namespace", default_value="", description="namespace of all nodes"),
            DeclareLaunchArgument("use_sim_time", default_value="false", description="follow /clock"),
            *(
                IncludeLaunchDescription(
                    PythonLaunchDescriptionSource(str(folder / f"{node}.launch.py")),
                    launch_arguments=arguments.items(),
                )
                for node in NODES
            ),
        ]
    )
