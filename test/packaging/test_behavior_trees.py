"""The behaviour trees that are shipped: every node, port and name in them exists where it would be looked for."""

from __future__ import annotations

import importlib
import re
from pathlib import Path
from xml.etree import ElementTree

import pytest
import yaml

from whereabouts.node_interfaces import NODE_INTERFACES

ROOT = Path(__file__).resolve().parents[2]
TREES = sorted((ROOT / "config/behavior_trees").glob("*.xml"))
# Of BehaviorTree.CPP 4, and of nav2's for Jazzy with their ports.
BUILT_IN = {"Sequence", "Fallback", "ReactiveFallback", "RetryUntilSuccessful"}
NAV2 = {
    "RecoveryNode": {"number_of_retries"},
    "PipelineSequence": set(),
    "RoundRobin": set(),
    "RateController": {"hz"},
    "GoalUpdated": {"goal", "goals"},
    "ComputePathToPose": {"start", "use_start", "goal", "planner_id", "server_name", "path", "error_code_id"},
    "FollowPath": {"path", "controller_id", "goal_checker_id", "progress_checker_id", "server_name", "error_code_id"},
    "ClearEntireCostmap": {"service_name"},
    "BackUp": {"backup_dist", "backup_speed", "time_allowance", "server_name", "error_code_id"},
    "Spin": {"spin_dist", "time_allowance", "is_recovery", "server_name", "error_code_id"},
    "Wait": {"wait_duration", "server_name"},
    "ReinitializeGlobalLocalization": {"service_name"},
}  # fmt: skip
COSTMAPS = {f"{name}_costmap/clear_entirely_{name}_costmap" for name in ("local", "global")}
SERVED = {
    item.name.replace("~/", f"{node}/"): (item.kind, item.type)
    for node, items in NODE_INTERFACES.items()
    for item in items
    if item.kind in ("service", "action")
}


def read(path: Path) -> tuple[ElementTree.Element, list[ElementTree.Element], dict[str, ElementTree.Element]]:
    """The root, all nodes of its trees, and the models of our own nodes."""
    root = ElementTree.parse(path).getroot()
    nodes = [node for tree in root.findall("BehaviorTree") for node in tree.iter() if node is not tree]
    model = root.find("TreeNodesModel")
    return root, nodes, {} if model is None else {item.attrib["ID"]: item for item in model}


@pytest.mark.parametrize("path", TREES, ids=lambda path: path.stem)
def test_a_tree_has_nodes_and_ports_that_exist(path: Path) -> None:
    root, nodes, models = read(path)
    assert root.tag == "root"
    assert root.get("BTCPP_format") == "4"
    assert root.get("main_tree_to_execute") in {tree.get("ID") for tree in root.findall("BehaviorTree")}
    for node in nodes:
        ports = set(node.attrib) - {"name"}
        if node.tag in models:
            assert ports <= {port.get("name") for port in models[node.tag]}, node.tag
        elif node.tag not in BUILT_IN:
            assert ports <= NAV2[node.tag], node.tag
    assert len([node for node in nodes if not len(node)]) > 2


@pytest.mark.parametrize("path", TREES, ids=lambda path: path.stem)
def test_names_in_a_tree_are_served(path: Path) -> None:
    _, nodes, models = read(path)
    ours = 0
    for node in nodes:
        for port, kind in (("service_name", "service"), ("action_name", "action")):
            name = node.get(port)
            if name is not None and name not in COSTMAPS:
                assert SERVED[name][0] == kind
                ours += 1
    assert ours
    params = yaml.safe_load((ROOT / "config/nav2_params.yaml").read_text(encoding="utf-8"))
    plugins = {
        "planner_id": params["planner_server"]["ros__parameters"]["planner_plugins"],
        "controller_id": params["controller_server"]["ros__parameters"]["controller_plugins"],
    }
    for port, known in plugins.items():
        assert {node.get(port) for node in nodes} - {None} <= set(known)
    for name in models:
        (served,) = {
            SERVED[node.attrib[key]][1]
            for node in nodes
            if node.tag == name
            for key in ("service_name", "action_name")
            if key in node.attrib
        }
        assert served.endswith(f"/{name}")


@pytest.mark.parametrize("path", TREES, ids=lambda path: path.stem)
def test_ports_of_our_nodes_are_fields(path: Path) -> None:
    for name, model in read(path)[2].items():
        kind, type_name = next(value for value in SERVED.values() if value[1].endswith(f"/{name}"))
        package, _, short = type_name.partition("/")
        made = getattr(importlib.import_module(f"{package}.{'srv' if kind == 'service' else kind}"), short)
        request, answer = (made.Request, made.Response) if kind == "service" else (made.Goal, made.Result)
        asked, answered = (part.get_fields_and_field_types() for part in (request, answer))
        for port in model:
            field = port.attrib["name"]
            if field not in ("service_name", "action_name", "object_id"):
                assert field in (asked if port.tag == "input_port" else answered), (name, field)


def test_the_page_says_how_to_wrap_what_the_tree_uses() -> None:
    page = (ROOT / "docs/nav2.md").read_text(encoding="utf-8")
    model = read(ROOT / "config/behavior_trees/find_object.xml")[2]["FindObject"]
    written = set(re.findall(r'(?:Input|Output)Port<[^"]*>\("(\w+)"', page))
    assert written | {"action_name"} == {port.attrib["name"] for port in model}
    for path in TREES:
        assert path.name in page
