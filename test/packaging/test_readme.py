"""The README is true."""

from __future__ import annotations

import re
from pathlib import Path

from whereabouts.documentation import READING, pages
from whereabouts.node_names import NODES
from whereabouts.parameters.registry import model_of

ROOT = Path(__file__).resolve().parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")


def test_tables_and_pages_are_those_of_the_models_and_interface_files() -> None:
    for path, text in pages(ROOT).items():
        assert path.read_text(encoding="utf-8") == text, f"{path.name} is not up to date: run `make docs`"
    for node in NODES:
        assert f"<!-- parameters: {node} -->" in README
        assert f"<!-- interfaces: {node} -->" in README
        assert all(f"`{name}`" in README for name in model_of(node).model_fields)
        assert READING[node]


def test_links_and_pictures_exist() -> None:
    for page in [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]:
        text = page.read_text(encoding="utf-8")
        for target in re.findall(
            r"\]\(([^)#\s]+)(?:#[^)]*)?\)", re.sub(r"```.*?```", "", text, flags=re.DOTALL)
        ):
            if not target.startswith("http"):
                assert (page.parent / target).exists(), f"{page.name}: {target}"


def test_every_command_and_executable_is_mentioned() -> None:
    from whereabouts.cli.main import app

    for command in app.registered_commands:
        assert command.callback is not None
        assert f"`{command.callback.__name__}" in README
    executables = re.findall(r'"(\w+) = whereabouts', (ROOT / "setup.py").read_text(encoding="utf-8"))
    assert executables
    for executable in executables:
        assert executable in README


def test_results_list_every_experiment_with_its_command() -> None:
    from whereabouts.cli.experiment import experiments

    page = (ROOT / "docs/results.md").read_text(encoding="utf-8")
    for name in experiments():
        section = page.partition(f"\n## {name}\n")[2].partition("\n## ")[0]
        assert f"whereabouts experiment {name}" in section
        assert "| --- |" in section or "See [above]" in section, f"no table of {name}"
