"""The pages are what `make docs` writes, their links lead somewhere, and the front page stays a front page."""

from __future__ import annotations

import ast
import builtins
import json
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
import typer

from evaluation.digest import ROOT
from evaluation.pages import BEFORE, Book, pages, results_page
from evaluation.results import read_all
from whereabouts.cli.main import app
from whereabouts.node_interfaces import NODE_INTERFACES, interfaces_of
from whereabouts.node_names import NODES
from whereabouts.parameters.parameter_base import model_of

README = (ROOT / "README.md").read_text(encoding="utf-8")
PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]
CODE = re.compile(r"```.*?```|`[^`\n]*`", re.DOTALL)
# The field's words instead of those of the code, and nothing that only insiders understand.
AVOIDED = (
    r"the issue\b", r"the text's", r"asked for", r"in vain", r"\bmerit", r"\bglance", r"\bhindsight",
    r"told by the rest", r"\bafresh", r"wrong but sure", r"\boutlines?\b", r"goes with", r"nobody has said",
    r"\bTODO\b",
)  # fmt: skip
# The glossary names what is avoided; comments of messages and reports of experiments are written elsewhere.
OTHERS = ("glossary.md", "interfaces.md", "results.md")


def prose(path: Path) -> str:
    return CODE.sub("", path.read_text(encoding="utf-8"))


def anchors(path: Path) -> set[str]:
    """Those of the headings of a page, as GitHub and the site make them."""
    text = re.sub(r"```.*?```", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
    titles = re.findall(r"^#+ (.*)$", text, flags=re.MULTILINE)
    return {re.sub(r"[^\w -]", "", title.lower()).strip().replace(" ", "-") for title in titles}


def test_pages_are_what_make_docs_writes() -> None:
    written = pages(ROOT)
    for path, text in written.items():
        assert path.read_text(encoding="utf-8") == text, (
            f"{path.relative_to(ROOT)} is not up to date: run `make docs`"
        )
    generated = [ROOT / "docs" / folder for folder in ("nodes", "results")]
    assert {path for folder in generated for path in folder.glob("*.md")} <= written.keys()


def test_the_front_page_is_short_and_begins_with_the_two_commands() -> None:
    assert len(README.encode()) <= 8192
    first_screen = README.splitlines()[:40]
    for command in ("make demo", "make test"):
        assert any(line.startswith(command) for line in first_screen)
    for node in NODES:
        assert f"[{node}](docs/nodes/{node}.md)" in README


def test_no_figure_of_the_front_page_is_from_before_the_last_change() -> None:
    assert BEFORE not in README


@pytest.mark.parametrize("path", sorted((ROOT / "results").glob("*.json")), ids=lambda path: path.stem)
def test_a_page_changes_when_a_figure_is_taken_out(path: Path, tmp_path: Path) -> None:
    shutil.copy(path, tmp_path)
    whole = results_page(path.stem, "", Book(read_all(tmp_path)))
    content = json.loads(path.read_text(encoding="utf-8"))
    cells = [cell for table in content["tables"] for row in table["rows"] for cell in row]
    shown = [cell["figure"] for cell in cells if isinstance(cell, dict) and "figure" in cell]
    del content["figures"][next(key for key in shown if key in content["figures"])]
    (tmp_path / path.name).write_text(json.dumps(content), encoding="utf-8")
    assert results_page(path.stem, "", Book(read_all(tmp_path))) != whole


def test_links_pictures_and_anchors_exist() -> None:
    for page in PAGES:
        for target in re.findall(r"\]\(([^)\s]+)\)", prose(page)):
            if target.startswith("http"):
                continue
            name, _, anchor = target.partition("#")
            place = (page.parent / name).resolve() if name else page
            assert place.exists(), f"{page.name}: {target}"
            assert not anchor or anchor in anchors(place), f"{page.name}: {target}"


def test_every_picture_is_on_a_page() -> None:
    shown = {
        (page.parent / target).resolve()
        for page in PAGES
        for target in re.findall(r"!\[[^]]*\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
    }
    assert set((ROOT / "docs/images").iterdir()) <= shown


def test_every_command_option_and_executable_is_on_the_page_of_commands() -> None:
    page = (ROOT / "docs/commands.md").read_text(encoding="utf-8")
    for name, command in typer.main.get_command(app).commands.items():  # type: ignore[attr-defined]
        assert f"\n## {name}\n" in page
        for sub, inner in getattr(command, "commands", {name: command}).items():
            section = page.partition(f" {sub}\n")[2].partition("\n#")[0]
            for option in inner.params:
                assert option.name == "help" or (option.help and option.help.replace("|", "\\|") in section)
    executables = re.findall(r'"(\w+) = whereabouts', (ROOT / "setup.py").read_text(encoding="utf-8"))
    assert {"whereabouts", "bring_up"} <= set(executables)
    for executable in (*executables, *NODES):
        assert executable in page.partition("## Executables")[2]


def test_every_target_of_make_is_explained() -> None:
    contributing = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    targets = re.findall(r'@echo "make ([\w-]+)', (ROOT / "Makefile").read_text(encoding="utf-8"))
    assert "test" in targets
    assert [name for name in targets if f"| `make {name}` |" not in contributing] == []


def test_what_can_be_tuned_is_a_parameter() -> None:
    fields = {name for node in NODES for name in model_of(node).model_fields}
    rows = [line.split("|") for line in (ROOT / "docs/tuning.md").read_text(encoding="utf-8").splitlines()]
    heads = [k for k, row in enumerate(rows) if "parameter" in [cell.strip() for cell in row]]
    assert heads
    for head in heads:
        column = [cell.strip() for cell in rows[head]].index("parameter")
        for row in rows[head + 2 :]:
            if len(row) <= column:
                break
            named = re.findall(r"`(\w+)`", row[column])
            assert named, row
            assert set(named) <= fields, row


def test_the_graph_shows_the_nodes_and_their_topics() -> None:
    graph = re.search(r"```mermaid\n(.*?)```", README, re.DOTALL)
    assert graph is not None
    edges = re.findall(r"^\s*(\w+)\S*(?: [\w ]+\]\))? -- (\w+) --> (\w+)", graph[1], flags=re.MULTILINE)
    assert len(edges) == len(graph[1].strip().splitlines()) - 1
    ends = {end for source, _, target in edges for end in (source, target)}
    assert ends - {"laser", "detector", "navigation"} == set(NODES)
    for source, topic, target in edges:
        # What goes out of the one goes into the other, or is an action that the one calls and the other serves.
        if source in NODE_INTERFACES:
            assert any(
                item.name == topic and item.kind in ("out", "calls") for item in NODE_INTERFACES[source]
            )
        if target in NODE_INTERFACES:
            assert any(
                item.name == topic and item.kind in ("in", "action") for item in NODE_INTERFACES[target]
            )


def test_the_example_of_the_front_page_runs(capsys: pytest.CaptureFixture[str]) -> None:
    example = re.search(r"```python\n(.*?)```", README, re.DOTALL)
    assert example is not None
    names: dict[str, object] = {}
    exec(compile(example[1], "README.md", "exec"), names)
    assert "person " in capsys.readouterr().out
    # The drive ends where it began; the map is in the frame of its first pose.
    drive, slam = names["drive"], names["slam"]
    begin, end = drive(0.0), drive(drive.duration)  # type: ignore[operator, attr-defined]
    np.testing.assert_allclose(begin[:2], end[:2], atol=1e-6)
    np.testing.assert_allclose(slam.pose[:2], np.zeros(2), atol=0.2)  # type: ignore[attr-defined]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_snippets_import_what_they_call(page: Path) -> None:
    for text in re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL):
        # Nodes need ROS, and messages of others.
        if "from " not in text or "rclpy" in text or "SuiteNode" in text:
            continue
        tree = ast.parse(text)
        known: dict[str, object] = {**vars(builtins), "use": None}
        imports = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
        exec(compile(ast.Module(list(imports), []), page.name, "exec"), known)
        calls = {
            node.func.id
            for node in ast.walk(tree)
            if isinstance(node, ast.Call) and isinstance(node.func, ast.Name)
        }
        names = {node.id for node in ast.walk(tree) if isinstance(node, ast.Name) and not _read(node)}
        assert not calls - known.keys() - names, page.name


def _read(node: ast.Name) -> bool:
    return isinstance(node.ctx, ast.Load)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_words_are_plain(page: Path) -> None:
    if page.name in OTHERS or page.parent.name == "results":
        pytest.skip("names what is avoided, or is written from elsewhere")
    text = prose(page)
    found = [word for word in AVOIDED if re.search(word, text, flags=re.IGNORECASE)]
    assert not found, f"{page.name}: {found}"


def test_the_adapter_in_the_camera_page_is_the_example_and_short() -> None:
    text = (ROOT / "examples/yolo_adapter.py").read_text(encoding="utf-8")
    compile(text, "yolo_adapter.py", "exec")
    assert text.rstrip() in (ROOT / "docs/camera.md").read_text(encoding="utf-8")
    assert len([line for line in text.splitlines() if line.strip()]) <= 30


def test_what_the_page_for_users_of_slam_toolbox_names_exists() -> None:
    text = (ROOT / "docs/from_slam_toolbox.md").read_text(encoding="utf-8")
    offered = {item.name.removeprefix("~/") for item in interfaces_of("loop_closure")}
    named = set(re.findall(r"`loop_closure/(\w+)`", text))
    assert {"pause", "remove_closure", "dynamic_map", "save_map", "load_map", "reset"} <= named <= offered
    fields = {name for node in ("loop_closure", "scan_registration") for name in model_of(node).model_fields}
    table = text.partition("## Parameters")[2].partition("\n## ")[0]
    rows = [line.split("|") for line in table.splitlines() if line.startswith("| `")]
    assert len(rows) > 15
    for row in rows:
        ours = row[1] if "same names" in row[2] else row[2]
        assert set(re.findall(r"`(\w+)[`:]", ours)) <= fields | {"load_map", "range_min"}, row
