"""Launch files, read as text: ROS 2's `launch` is in no wheel."""

from __future__ import annotations

import ast
from pathlib import Path
from typing import Any

import pytest
import yaml

from whereabouts.node_interfaces import NODE_INTERFACES
from whereabouts.node_names import NODES
from whereabouts.nodes.runtime.launch_arguments import check
from whereabouts.parameters.parameter_base import model_of

ROOT = Path(__file__).resolve().parents[2]
BUILDER = ast.parse((ROOT / "whereabouts/nodes/runtime/launching.py").read_text(encoding="utf-8"))


def constant(name: str, tree: ast.Module = BUILDER) -> Any:
    """A literal of a module: the one that makes the launch descriptions, or a node."""
    for item in tree.body:
        if isinstance(item, ast.Assign) and ast.unparse(item.targets[0]) == name:
            return ast.literal_eval(item.value)
    raise AssertionError(f"no {name}")


def calls(tree: ast.AST, name: str) -> list[ast.Call]:
    return [node for node in ast.walk(tree) if isinstance(node, ast.Call) and ast.unparse(node.func) == name]


@pytest.mark.parametrize("name", [*NODES, "suite", "nav2"])
def test_a_launch_file_describes_its_nodes(name: str) -> None:
    tree = ast.parse((ROOT / "launch" / f"{name}.launch.py").read_text(encoding="utf-8"))
    (function,) = [item for item in tree.body if isinstance(item, ast.FunctionDef)]
    assert function.name == "generate_launch_description"
    assert not function.args.args
    (call,) = calls(function, "description")
    whole = {"suite": "description(*NODES)", "nav2": "description(*NODES, nav2=True)"}
    assert ast.unparse(call) == whole.get(name, f"description('{name}')")


def test_launch_files_load_nothing_a_launch_machine_may_lack() -> None:
    known = (
        "launch",
        "launch_ros",
        "ament_index_python",
        "pathlib",
        "os",
        "typing",
        "collections",
        "__future__",
    )
    runtime = "whereabouts.nodes.runtime"
    ours = (f"{runtime}.launching", f"{runtime}.launch_arguments", "whereabouts.node_names")
    modules = [
        ROOT / "whereabouts/nodes/runtime" / f"{name}.py" for name in ("launching", "launch_arguments")
    ]
    for path in [*(ROOT / "launch").glob("*.py"), *modules]:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            assert not isinstance(node, ast.Import) or all(a.name in known for a in node.names)
            if isinstance(node, ast.ImportFrom):
                assert node.module in ours or (node.module or "").partition(".")[0] in known
    for package in ("whereabouts", "whereabouts/nodes"):
        body = ast.parse((ROOT / package / "__init__.py").read_text(encoding="utf-8")).body
        assert not [item for item in body if isinstance(item, ast.Import | ast.ImportFrom)]


def test_all_arguments_are_declared_and_used() -> None:
    arguments = {**constant("ARGUMENTS"), **constant("NAV2_ARGUMENTS")}
    assert {"namespace", "params_file", "use_sim_time", "bag", "rviz"} <= set(arguments)
    for default, meaning in arguments.values():
        assert isinstance(default, str)
        assert len(meaning) > 15
    read = {
        node.slice.value
        for node in ast.walk(BUILDER)
        if isinstance(node, ast.Subscript)
        and ast.unparse(node.value) == "given"
        and isinstance(node.slice, ast.Constant)
    }
    assert read == set(arguments)


def test_a_slip_in_an_argument_is_no_other_setting(tmp_path: Path) -> None:
    plain = {name: default for name, (default, _) in constant("ARGUMENTS").items()}
    file = tmp_path / "robot.yaml"
    file.touch()
    check({**plain, "params_file": str(file), "use_sim_time": " True", "rviz": "no"})
    wrong = {
        "use_sim_time": "flase",
        "rviz": "auto",
        "autostart": "",
        "params_file": "robto.yaml",
        "bag": "run.mcpa",
    }
    for name, word in wrong.items():
        with pytest.raises(ValueError, match=f"{name}: .*{word}"):
            check({**plain, name: word})


def test_what_is_launched_is_installed() -> None:
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    launched = [
        (keyword.arg, keyword.value.value)
        for call in [*calls(BUILDER, "Node"), *calls(BUILDER, "LifecycleNode")]
        for keyword in call.keywords
        if keyword.arg in ("package", "executable") and isinstance(keyword.value, ast.Constant)
    ]
    assert ("executable", "bring_up") in launched
    for kind, name in launched:
        if kind == "executable" and name not in ("rviz2", "lifecycle_manager"):
            assert f'"{name} = whereabouts.nodes.runtime.{name}:main"' in setup


def test_who_brings_nodes_up_again_is_started_again() -> None:
    (watcher,) = [call for call in calls(BUILDER, "manager") if call.args]
    assert ast.unparse(watcher).startswith("manager('--watch', respawn=True")


def test_rviz_shows_what_the_suite_publishes() -> None:
    view = yaml.safe_load((ROOT / "rviz/suite.rviz").read_text(encoding="utf-8"))["Visualization Manager"]
    topics = {item["Topic"]["Value"]: item for item in view["Displays"] if "Topic" in item}
    sources = "\n".join(
        path.read_text(encoding="utf-8") for path in (ROOT / "whereabouts/nodes").rglob("*.py")
    )
    assert not [topic for topic in topics if topic.startswith("/")]
    for topic, display in topics.items():
        node, _, own = topic.rpartition("/")
        assert f'"~/{own}"' in sources if node else f'"{topic}"' in sources or topic == "scan", topic
        assert not node or node in NODES
        # A reader that is reliable hears nothing of a sensor, one that is volatile nothing of an old map.
        assert (display["Topic"]["Reliability Policy"] == "Best Effort") == (topic == "scan")
        if topic in ("map", "trajectory", "search_goal", "maintenance_goal"):
            assert display["Topic"]["Durability Policy"] == "Transient Local"
    assert {"map", "scan", "static_points", "trajectory", "world_model/markers"} <= set(topics)


def test_nav2_hears_what_the_suite_says_and_drives_nearer_than_arrival() -> None:
    content = yaml.safe_load((ROOT / "config/nav2_params.yaml").read_text(encoding="utf-8"))
    servers = {name: item["ros__parameters"] for name, item in content.items() if "ros__parameters" in item}
    assert set(servers) == set(constant("NAV2").values())
    assert set(constant("DRIVERS")) == {
        node for node in NODES if any(item.name == "navigate_to_pose" for item in NODE_INTERFACES[node])
    }
    published = {
        item.name: item.type for node in NODES for item in NODE_INTERFACES[node] if item.kind == "out"
    }
    assert published[servers["bt_navigator"]["odom_topic"]] == "nav_msgs/Odometry"
    kinds = {"LaserScan": "sensor_msgs/LaserScan", "PointCloud2": "sensor_msgs/PointCloud2"}
    predictor = ast.parse((ROOT / "whereabouts/nodes/motion_predictor_node.py").read_text(encoding="utf-8"))
    for name in ("local_costmap", "global_costmap"):
        costmap = content[name][name]["ros__parameters"]
        layer = costmap["obstacle_layer"]
        sources = layer["observation_sources"].split()
        assert all(source in layer for source in sources)
        people = layer["people"]
        assert published[people["topic"]] == kinds[people["data_type"]]
        assert (
            people["min_obstacle_height"]
            <= constant("OCCUPANCY_HEIGHT", predictor)
            <= people["max_obstacle_height"]
        )
        # What is marked has to be cleared by somebody.
        assert any(layer[source]["clearing"] for source in sources)
        assert {*costmap["plugins"], *costmap.get("filters", ())} <= set(costmap)
        for item in costmap.get("filters", ()):
            assert (
                published[costmap[item]["filter_info_topic"].removeprefix("/")]
                == "nav2_msgs/CostmapFilterInfo"
            )
            assert costmap[item]["enabled"] == model_of("motion_predictor")().publish_mask
    assert "map_updates" in published
    assert (
        content["global_costmap"]["global_costmap"]["ros__parameters"]["static_layer"]["map_topic"]
        in published
    )
    near = servers["controller_server"]["goal_checker"]["xy_goal_tolerance"]
    assert all(near < model_of(node)().arrival_distance for node in constant("DRIVERS"))
