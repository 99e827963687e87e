"""Launch descriptions of the suite and of single nodes, for the files in launch/; needs ROS 2's `launch`.

All nodes start at once with `autostart: false`; the executable `bring_up` then configures and activates them in order.
Only when all are active is a bag played. A node that dies is started again, and brought up again.
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from ament_index_python.packages import get_package_share_directory
from launch import LaunchDescription
from launch.actions import (
    DeclareLaunchArgument,
    ExecuteProcess,
    OpaqueFunction,
    RegisterEventHandler,
    SetEnvironmentVariable,
    Shutdown,
)
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode, Node

from whereabouts.nodes.runtime.launch_arguments import check, is_true

# Name: default and meaning.
ARGUMENTS = {
    "namespace": ("", "namespace of the nodes, such as robot1"),
    "params_file": ("", "ROS parameter file; it overrides the shipped one of each node"),
    "use_sim_time": ("auto", "true: use /clock; auto: use it only if a bag is played"),
    "bag": ("", "play this bag with its clock as soon as all nodes are active"),
    "rviz": ("false", "true: show everything in RViz"),
    "autostart": ("true", "false: leave the nodes unconfigured for a lifecycle manager"),
}
# With nav2 only.
NAV2_ARGUMENTS = {"nav2_params_file": ("", "nav2's parameter file, in place of the shipped nav2_params.yaml")}
# Servers of nav2 by package, in the order in which they are activated. The map and the robot's pose are the suite's.
NAV2 = {
    "nav2_controller": "controller_server",
    "nav2_planner": "planner_server",
    "nav2_behaviors": "behavior_server",
    "nav2_bt_navigator": "bt_navigator",
}
DRIVERS = ("world_maintenance", "object_search")  # nodes that send the robot somewhere
PROFILES = "FASTRTPS_DEFAULT_PROFILES_FILE"
RESPAWN_DELAY = 1.0


def description(*nodes: str, nav2: bool = False) -> LaunchDescription:
    """What launches the given nodes in that order. nav2 : also what drives the robot where they send it."""
    arguments = {**ARGUMENTS, **NAV2_ARGUMENTS} if nav2 else ARGUMENTS
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=meaning)
        for name, (default, meaning) in arguments.items()
    ]
    made = OpaqueFunction(function=_entities, kwargs={"names": nodes, "arguments": (*arguments,)})
    return LaunchDescription([*declared, made])


def _entities(context: Any, names: tuple[str, ...], arguments: tuple[str, ...]) -> list[Any]:
    given = {name: LaunchConfiguration(name).perform(context) for name in arguments}
    check(given)
    share = Path(get_package_share_directory("whereabouts"))
    entities: list[Any] = []
    if PROFILES not in os.environ:
        entities.append(SetEnvironmentVariable(PROFILES, str(share / "config" / "fastdds.xml")))
    entities += [_node(name, given, share) for name in names]
    if "nav2_params_file" in given:
        entities += _nav2(given, share)
    if is_true(given["rviz"]):
        entities.append(_rviz(given, share))
    if is_true(given["autostart"]):
        return entities + _bring_up(names, given)
    return entities + _bag(given)


def _sim_time(given: dict[str, str]) -> bool:
    choice = given["use_sim_time"].strip().lower()
    return bool(given["bag"]) if choice == "auto" else is_true(choice)


def _node(name: str, given: dict[str, str], share: Path) -> LifecycleNode:
    files: list[Any] = [str(share / "config" / f"{name}.yaml")]
    if "nav2_params_file" in given and name in DRIVERS:
        files.append({"navigate": True})
    files += filter(None, [given["params_file"]])
    return LifecycleNode(
        package="whereabouts",
        executable=name,
        name=name,
        namespace=given["namespace"],
        parameters=[*files, {"use_sim_time": _sim_time(given), "autostart": False}],
        respawn=True,
        respawn_delay=RESPAWN_DELAY,
        output="screen",
    )


def _nav2(given: dict[str, str], share: Path) -> list[Any]:
    """nav2's servers, and its lifecycle manager for them."""
    file = given["nav2_params_file"] or str(share / "config" / "nav2_params.yaml")
    clock = {"use_sim_time": _sim_time(given)}
    common = {
        "namespace": given["namespace"],
        "output": "screen",
        "remappings": [("/tf", "tf"), ("/tf_static", "tf_static")],
    }
    servers = [
        Node(
            package=package, executable=server, name=server, parameters=[file, clock], respawn=True, **common
        )
        for package, server in NAV2.items()
    ]
    manager = Node(
        package="nav2_lifecycle_manager",
        executable="lifecycle_manager",
        name="lifecycle_manager_navigation",
        parameters=[clock, {"autostart": True, "node_names": [*NAV2.values()]}],
        **common,
    )
    return [*servers, manager]


def _bring_up(names: tuple[str, ...], given: dict[str, str]) -> list[Any]:
    """The process that brings the nodes up, and what happens when it has."""

    def manager(*options: str, **lasting: Any) -> Node:
        return Node(
            package="whereabouts",
            executable="bring_up",
            namespace=given["namespace"],
            arguments=[*options, *names],
            output="screen",
            **lasting,
        )

    first = manager()

    def then(event: Any, _: Any) -> list[Any]:
        if event.returncode != 0:
            return [Shutdown(reason="the nodes could not be brought up")]
        # Without it nothing that dies is brought up again; it also ends where one of the nodes cannot be.
        return [manager("--watch", respawn=True, respawn_delay=RESPAWN_DELAY), *_bag(given)]

    return [RegisterEventHandler(OnProcessExit(target_action=first, on_exit=then)), first]


def _bag(given: dict[str, str]) -> list[Any]:
    if not given["bag"]:
        return []
    return [ExecuteProcess(cmd=["ros2", "bag", "play", given["bag"], "--clock"], output="screen")]


def _rviz(given: dict[str, str], share: Path) -> Node:
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=given["namespace"],
        arguments=["-d", str(share / "rviz" / "suite.rviz")],
        parameters=[{"use_sim_time": _sim_time(given)}],
        remappings=[("/tf", "tf"), ("/tf_static", "tf_static")],
        output="screen",
    )
