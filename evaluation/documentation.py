# ruff: noqa: E501  (sentences of pages)
"""What the documentation says about parameters and interfaces: a page for each node, and one with every message.

`make docs` writes them, with the pages that hold figures.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from whereabouts.node_interfaces import NODE_INTERFACES, Interface, interfaces_of
from whereabouts.node_names import NODES
from whereabouts.parameters.parameter_base import (
    NodeParameters,
    SharedParameters,
    allowed,
    expert_names,
    extra,
    model_of,
)
from whereabouts.parameters.yaml_text import section

SUMMARIES = {
    "scan_registration": "Computes odometry with covariance from planar scans or clouds. It also publishes tf, the points of the static world, and which beams of a scan move.",
    "loop_closure": "Recognises places, closes loops, keeps a consistent map, and localises in a saved one.",
    "target_tracker": "Finds people in planar scans and follows them, also through crossings and while they are hidden.",
    "motion_predictor": "Learns where people go, and predicts their paths.",
    "world_model": "Estimates which objects exist and where they are. It remembers this, and answers questions.",
    "verifier": "Checks whether an object is in a region, in scans or clouds.",
    "world_maintenance": "Decides which object to check next, sends the robot there and has the object verified.",
    "object_search": "Finds an object by what is usually found near it.",
}  # fmt: skip
READING = {
    "scan_registration": [("what moves between scans", "crf.md")],
    "loop_closure": [("closing loops", "loop_closure.md"), ("the shipped models", "loop_closure_models.md")],
    "target_tracker": [("people in planar scans", "people.md")],
    "motion_predictor": [("motion prediction", "motion_prediction.md")],
    "world_model": [("the world model", "world_model.md"), ("the node, its store and its questions", "world_model_node.md")],
    "verifier": [("maintenance and search", "maintenance_and_search.md")],
    "world_maintenance": [("maintenance and search", "maintenance_and_search.md")],
    "object_search": [("maintenance and search", "maintenance_and_search.md")],
}  # fmt: skip
SHIPPED = """\
# Parameters of the node {node} that a user sets, with their defaults.
# Frames, and the rest: `whereabouts parameters {node}`, with --expert.
"""


def node_page(node: str) -> str:
    """The page of a node."""
    own = {
        item.type.rpartition("/")[2]
        for item in interfaces_of(node)
        if item.type.startswith("whereabouts_msgs/")
    }
    fields = ", ".join(f"[{name}](../interfaces.md#{name.lower()})" for name in sorted(own))
    names = model_of(node).model_fields
    shared = ", ".join(f"`{name}`" for name in SharedParameters.model_fields if name in names)
    experts = expert_names(node)
    expert = f"\nFor experts:\n\n{parameter_table(model_of(node), experts)}\n" if experts else ""
    reading = ", ".join(f"[{title}](../{page})" for title, page in READING[node])
    return f"""<!-- Written by `make docs`. -->

# {node}

{SUMMARIES[node]} How it works: {reading}.

```
ros2 launch whereabouts {node}.launch.py       # on a ROS 2 machine; --show-args lists the arguments
whereabouts run {node}                         # without ROS's launch
whereabouts run {node} --bag BAG --lock-step   # on a recording
```

## Topics, services, actions

{interface_table(interfaces_of(node))}

Fields, units and frames: {fields}. Every input takes ROS's QoS overrides, such as
`qos_overrides./scan.subscription.reliability`.

## Parameters

`config/{node}.yaml` states the defaults; † can only be set while the node is unconfigured. A value that is not allowed is refused with the
parameter's name and its range. Besides there are [those that several nodes share](shared.md): {shared}.

{parameter_table(model_of(node))}
{expert}"""


def shared_page() -> str:
    """The page of what several nodes have with one meaning."""
    rest = [name for name in SharedParameters.model_fields if name not in SharedParameters.public]
    return f"""<!-- Written by `make docs`. -->

# Parameters that nodes share

Which of them a node has, its page says. A section `/**` of a parameter file sets them for all:

```yaml
/**:
  ros__parameters: {{base_frame: base_footprint}}
```

{parameter_table(SharedParameters)}

For experts:

{parameter_table(SharedParameters, rest)}
"""


def interfaces_page(sources: Path) -> str:
    """All fields of whereabouts_msgs. sources : its folder."""
    parts = [
        "<!-- Written by `make docs`. -->",
        "# Messages, services and actions",
        "Of the package `whereabouts_msgs`, as in its files. Metres, radians, seconds; frames as in the headers.",
    ]
    for kind, title in (("msg", "Messages"), ("srv", "Services"), ("action", "Actions")):
        parts.append(f"## {title}")
        for path in sorted((sources / kind).iterdir()):
            users = [
                f"[{node}](nodes/{node}.md)"
                for node in NODES
                if any(item.type == f"whereabouts_msgs/{path.stem}" for item in NODE_INTERFACES[node])
            ]
            used = f"\n\nUsed by {', '.join(users)}." if users else ""
            text = path.read_text(encoding="utf-8").strip()
            parts.append(f"### {path.stem}{used}\n\n```\n{text}\n```")
    return "\n\n".join(parts) + "\n"


def interface_table(items: Sequence[Interface]) -> str:
    """Interfaces as a Markdown table."""
    lines = ["| | name | type | meaning |", "| --- | --- | --- | --- |"]
    for item in items:
        name = f"`{item.name}`{f' (`{item.when}`)' if item.when else ''}"
        lines.append(f"| {item.way} | {name} | {item.type} | {item.meaning} |")
    return "\n".join(lines)


def parameter_table(model: type[NodeParameters], names: Sequence[str] = ()) -> str:
    """Parameters of a node, else the public ones, as a Markdown table; those fixed at the start are marked."""
    lines = ["| parameter | default | allowed | meaning |", "| --- | --- | --- | --- |"]
    for name in names or model.public:
        field = model.model_fields[name]
        mark = " †" if extra(field, "fixed") else ""
        lines.append(f"| `{name}`{mark} | `{field.default}` | {allowed(field)} | {field.description} |")
    return "\n".join(lines)


def shipped_file(node: str) -> str:
    """Content of `config/NODE.yaml`: public parameters for whatever name the node runs under."""
    return SHIPPED.format(node=node) + section("/**", model_of(node), model_of(node).public)


def pages(root: Path) -> dict[Path, str]:
    """Written files of a checkout and what they should hold."""
    written = {root / "docs/nodes" / f"{node}.md": node_page(node) for node in NODES}
    written |= {root / "config" / f"{node}.yaml": shipped_file(node) for node in NODES}
    written[root / "docs/nodes/shared.md"] = shared_page()
    return {**written, root / "docs/interfaces.md": interfaces_page(root / "whereabouts_msgs")}
