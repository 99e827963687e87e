"""ROS parameter files with the meaning of each parameter beside it."""

from __future__ import annotations

import math
import textwrap
from collections.abc import Mapping, Sequence
from typing import Any

import yaml

from whereabouts.node_names import NODES
from whereabouts.parameters.parameter_base import (
    NodeParameters,
    SharedParameters,
    allowed,
    expert_names,
    extra,
    model_of,
)

WIDTH = 112  # characters of a line
PUBLIC = "# Parameters that a user sets, with their defaults; the rest: `whereabouts parameters --expert`.\n"
EXPERT = """\
# Parameters that hardly anybody changes, with their defaults. Keep what you change, and give the file to
# `ros2 launch whereabouts suite.launch.py params_file:=FILE` or `whereabouts run --params FILE`.
"""


def parameter_file(nodes: Sequence[str] = NODES, expert: bool = False) -> str:
    """A file with the parameters of some nodes, in any namespace; the public ones, or all others.

    What several nodes have is in it once, for all of them.
    """
    public = SharedParameters.public
    others = tuple(name for name in SharedParameters.model_fields if name not in public)
    parts = [section("/**", SharedParameters, others if expert else public)]
    for node in nodes:
        names = expert_names(node) if expert else model_of(node).public
        if names:
            parts.append(section(f"/**/{node}", model_of(node), names))
    return (EXPERT if expert else PUBLIC) + "\n".join(parts)


def section(nodes: str, model: type[NodeParameters], names: Sequence[str]) -> str:
    """What a file says for the nodes of a name: parameters at their defaults, each below its meaning."""
    about = {}
    for name in names:
        field = model.model_fields[name]
        fixed = "; while unconfigured" if extra(field, "fixed") else ""
        about[name] = f"{field.description} ({allowed(field)}{fixed})"
    return given_section(nodes, {name: model.model_fields[name].default for name in names}, about)


def given_section(nodes: str, values: Mapping[str, Any], about: Mapping[str, str] | None = None) -> str:
    """Parameters of the nodes of a name, each below what is said `about` it."""
    lines = [f"{nodes}:", "  ros__parameters:"]
    for name, value in values.items():
        lines += [f"    # {line}" for line in textwrap.wrap((about or {}).get(name, ""), WIDTH - 6)]
        # In one line; texts in quotes, so that none is taken for something else.
        style = '"' if isinstance(value, str) else None
        text = yaml.safe_dump(value, default_flow_style=True, default_style=style, width=math.inf)
        lines.append(f"    {name}: " + text.removesuffix("\n").removesuffix("\n..."))
    return "\n".join(lines) + "\n"
