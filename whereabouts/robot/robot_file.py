"""The parameter file of a robot: a ROS parameter file, for launch files, `run` and commands without ROS."""

from __future__ import annotations

import textwrap
from typing import Any

from whereabouts.parameters.yaml_text import given_section
from whereabouts.robot.choice import Choice
from whereabouts.robot.findings import Finding

WIDTH = 110


def parameters(choice: Choice) -> dict[str, dict[str, Any]]:
    """Parameters by node; those of all nodes under "/**"."""
    shared: dict[str, Any] = {
        "base_frame": choice.base_frame, "odom_frame": choice.odom_frame, "map_frame": choice.map_frame
    }  # fmt: skip
    if choice.sim_time:
        shared["use_sim_time"] = True
    scan, cloud = (choice.scans or [""])[0], (choice.clouds or [""])[0]
    registration: dict[str, Any] = {"publish_tf": not choice.base_publishes_tf}
    mapping: dict[str, Any] = {"odometry_source": "auto", "publish_tf": not choice.map_published}
    if cloud:
        registration["cloud_topics"] = list(choice.clouds)
        mapping["cloud_topic"] = cloud
    elif scan:
        registration["scan_topics"] = list(choice.scans)
        mapping["scan_topic"] = scan
    if choice.wheels:
        registration["wheel_topic"] = choice.wheels
    by_node = {"scan_registration": registration, "loop_closure": mapping}
    if scan and not cloud:
        by_node |= {"target_tracker": {"scan_topic": scan}, "verifier": {"scan_topic": scan}}
    elif cloud:
        by_node["verifier"] = {"cloud_topic": cloud}
    if choice.detector:
        by_node["world_model"] = dict(choice.detector)
    for node, given in choice.preset.items():
        by_node.setdefault(node, {}).update(given)
    return {"/**": shared, **by_node}


def as_text(choice: Choice, said: list[Finding], source: str, name: str = "robot.yaml") -> str:
    """The file of a name, with what was found as comments above it."""
    lines = [
        f"# Written by `whereabouts setup` from {' '.join(source.split())}. It is an ordinary ROS parameter file:"
    ]
    space = choice.namespace
    lines += [
        f"#   whereabouts run --config {name}{f' --namespace {space}' if space else ''}",
        f"#   ros2 launch whereabouts suite.launch.py params_file:={name}"
        + (f" namespace:={space.strip('/')}" if space else ""),
    ]
    for finding in said:
        lines += [
            f"# {line}" if number == 0 else f"#   {line}"
            for number, line in enumerate(textwrap.wrap(str(finding), WIDTH))
        ]
    sections = [
        given_section(node if node.startswith("/") else f"/**/{node}", given)
        for node, given in parameters(choice).items()
    ]
    return "\n".join(lines) + "\n" + "".join(sections)
