"""The page of all commands and executables, from the command line itself."""

from __future__ import annotations

from typing import Any

import typer

from evaluation.markdown import pipes
from whereabouts.cli.main import app
from whereabouts.node_names import NODES

TOP = """\
`whereabouts COMMAND --help` prints the same. Commands that need no running nodes work without ROS. A readable log is a
CARMEN log, a g2o file with laser, a ROS 1 bag or a ROS 2 bag."""
EXECUTABLES = """\
On a ROS machine `ros2 run whereabouts NAME` starts one of these: {nodes}, `bring_up` (configures and activates
nodes in order), and `whereabouts` itself (the commands above)."""


def page() -> str:
    """docs/commands.md."""
    parts = ["<!-- Written by `make docs`. -->", "# Commands", TOP]
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        parts += _section(name, command, 2)
    nodes = ", ".join(f"[{node}](nodes/{node}.md)" for node in NODES)
    parts += ["## Executables", EXECUTABLES.format(nodes=nodes)]
    return "\n\n".join(parts) + "\n"


def _section(name: str, command: Any, level: int) -> list[str]:
    """A command with its options; of a group all its commands."""
    # A paragraph of a docstring is broken where its line ends.
    text = "\n\n".join(" ".join(part.split()) for part in (command.help or "").split("\n\n"))
    parts = [f"{'#' * level} {name}", text]
    if hasattr(command, "commands"):
        for sub, inner in command.commands.items():
            parts += _section(f"{name} {sub}", inner, level + 1)
        return parts
    given = [option for option in command.params if option.name != "help" and not option.hidden]
    arguments = " ".join(option.metavar or option.name.upper() for option in given if _argument(option))
    parts.append(f"```\nwhereabouts {name} {arguments}".rstrip() + "\n```")
    rows = [[f"`{_called(option)}`", option.help or "", _default(option)] for option in given]
    return [*parts, pipes(["", "meaning", "default"], rows)]


def _argument(option: Any) -> bool:
    return bool(option.param_type_name == "argument")


def _called(option: Any) -> str:
    if _argument(option):
        return option.metavar or option.name.upper()
    names = " / ".join([*option.opts, *option.secondary_opts])
    return names if option.is_flag or not option.metavar else f"{names} {option.metavar}"


def _default(option: Any) -> str:
    """What is taken without it, where one can state it; a folder of this checkout is left out."""
    if isinstance(option.show_default, str):
        return option.show_default
    value = option.default
    if option.required:
        return "required"
    if value is None or value == "" or callable(value) or isinstance(value, bool | list | tuple):
        return ""
    return f"`{value}`"
