"""Files that `whereabouts parameters` writes are taken by real nodes, by ROS's own reader, in any namespace."""

from __future__ import annotations

from pathlib import Path

import pytest
from harness import Graph
from test_declared_interfaces import node_class

from whereabouts.cli.robot_setup import parameters
from whereabouts.node_names import NODES


@pytest.mark.parametrize("namespace", ["", "/house/robot1"])
def test_a_node_takes_what_was_changed_in_both_files(graph: Graph, tmp_path: Path, namespace: str) -> None:
    usual, expert = tmp_path / "usual.yaml", tmp_path / "expert.yaml"
    parameters(None, expert=False, out=usual)
    parameters(["verifier", "loop_closure"], expert=True, out=expert)
    for path, old, new in (
        (usual, "points: 3", "points: 7"),
        (expert, "diagnostics_period: 1.0", "diagnostics_period: 2.0"),
    ):
        text = path.read_text(encoding="utf-8")
        assert text.count(f"    {old}\n") == 1
        path.write_text(text.replace(old, new), encoding="utf-8")
    given = ["--ros-args", "--params-file", str(usual), "--params-file", str(expert)]
    node = node_class("verifier")(context=graph.context, namespace=namespace, cli_args=given)
    try:
        assert (node.settings.points, node.settings.diagnostics_period) == (7, 2.0)
        changed = {"points", "diagnostics_period"}
        defaults = type(node.settings)().model_dump(exclude=changed)
        assert node.settings.model_dump(exclude=changed) == defaults
    finally:
        node.destroy_node()


@pytest.mark.parametrize("name", NODES)
def test_every_node_starts_with_all_of_its_parameters_from_files(
    graph: Graph, tmp_path: Path, name: str
) -> None:
    given = ["--ros-args"]
    for expert in (False, True):
        path = tmp_path / f"{expert}.yaml"
        parameters([name], expert=expert, out=path)
        given += ["--params-file", str(path)]
    node = node_class(name)(context=graph.context, cli_args=given)
    try:
        named = node._parameter_overrides.keys()
        assert set(node.settings.model_dump()) <= set(named)
        assert node.settings == type(node.settings)()
    finally:
        node.destroy_node()
