"""The README is true."""

from __future__ import annotations

import re
from pathlib import Path

from whereabouts.parameters.readme import model_of, with_tables

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_parameter_tables_are_those_of_the_models() -> None:
    assert with_tables(README) == README, "run `make docs`"
    nodes = [path.stem.removesuffix("_node") for path in (ROOT / "whereabouts/nodes").glob("*_node.py")]
    for node in nodes:
        assert f"<!-- parameters: {node} -->" in README
        assert all(f"`{name}`" in README for name in model_of(node).model_fields)


def test_links_and_pictures_exist() -> None:
    for target in re.findall(r"\]\(([^)#]+)\)", README):
        if not target.startswith("http"):
            assert (ROOT / target).exists(), target


def test_every_command_and_executable_is_mentioned() -> None:
    from whereabouts.cli.main import app

    for command in app.registered_commands:
        assert command.callback is not None
        assert f"`{command.callback.__name__}" in README
    executables = re.findall(r'"(\w+) = whereabouts', (ROOT / "setup.py").read_text(encoding="utf-8"))
    assert executables
    for executable in executables:
        assert executable in README
