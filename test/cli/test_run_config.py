"""`whereabouts run --config`: what the file says, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from whereabouts.node_names import NODES
from whereabouts.suite_config import SuiteConfigError, read_config


def written(tmp_path: Path, content: Any) -> Path:
    path = tmp_path / "suite.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content), encoding="utf-8")
    return path


def test_a_file_says_what_runs(tmp_path: Path) -> None:
    (tmp_path / "robot.yaml").touch()
    (tmp_path / "run.mcap").touch()
    content = {
        "namespace": "/robot1",
        "bag": "run.mcap",
        "rate": 2,
        "record": {"odometry": "nav_msgs/msg/Odometry"},
        "out": "out.mcap",
        "nodes": {
            "verifier": None,
            "scan_registration": {
                "params_file": "robot.yaml",
                "remappings": {"scan": "front/scan"},
                "parameters": {"max_range": 20, "qos_overrides./scan.subscription.depth": 3},
            },
        },
    }
    config = read_config(written(tmp_path, content), {})
    assert list(config.nodes) == ["scan_registration", "verifier"], "in the order of bring-up"
    node = config.nodes["scan_registration"]
    assert node.params_file == tmp_path / "robot.yaml"
    assert node.remappings == {"scan": "front/scan"}
    assert node.parameters["max_range"] == 20
    assert (config.namespace, config.rate) == ("/robot1", 2.0)
    assert (config.bag, config.out) == (tmp_path / "run.mcap", tmp_path / "out.mcap")


def test_options_go_before_the_file(tmp_path: Path) -> None:
    (tmp_path / "run.mcap").touch()
    path = written(tmp_path, {"namespace": "/a", "bag": "run.mcap", "rate": 2.0, "nodes": ["verifier"]})
    config = read_config(path, {"namespace": "/b", "lock_step": True})
    assert (config.namespace, config.rate, config.lock_step) == ("/b", None, True)
    assert list(config.only(["world_model"]).nodes) == ["world_model"]


def test_without_a_file_all_nodes_run_as_shipped() -> None:
    config = read_config(None, {})
    assert tuple(config.nodes) == NODES
    assert not any(node.parameters or node.remappings for node in config.nodes.values())


@pytest.mark.parametrize(
    ("content", "sentence"),
    [
        ({"nodse": ["verifier"]}, "nodse: there is no such key; did you mean 'nodes'?"),
        ({"nodes": {"verifyer": None}}, "nodes: no node is called verifyer; there are: scan_registration"),
        ({"nodes": {"verifier": {"parameter": {}}}}, "nodes.verifier.parameter: there is no such key; did you mean"),
        (
            {"nodes": {"verifier": {"parameters": {"frame": 3}}}},
            "nodes.verifier.parameters: frame: there is no such parameter; did you mean 'frames'?",
        ),
        (
            {"nodes": {"verifier": {"parameters": {"frames": 0}}}},
            "nodes.verifier.parameters: parameter frames: int from 1 to 100 expected, got 0",
        ),
        ({"nodes": {"verifier": {"remappings": {"scan": 3}}}}, "nodes.verifier.remappings.scan: "),
        ({"nodes": []}, "nodes: at least one node expected"),
        ({"nodes": [["verifier"], {}]}, "nodes: names of nodes expected"),
        ({"nodes": ["verifier"], "rate": -1}, "rate: "),
        ({"rate": 2.0}, "need --bag"),
        ({"namespace": "robot1"}, "namespace: must start with a slash"),
        ({"bag": "none.mcap"}, "none.mcap does not exist"),
        ({"params_file": "none.yaml"}, "none.yaml does not exist"),
        ("- verifier", "keys with values expected"),
        ("nodes: [", "is no YAML"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(tmp_path: Path, content: Any, sentence: str) -> None:
    path = written(tmp_path, content)
    with pytest.raises(SuiteConfigError) as caught:
        read_config(path, {})
    assert sentence in str(caught.value)
    assert str(path) in str(caught.value)


def test_a_file_that_is_not_there_is_said(tmp_path: Path) -> None:
    with pytest.raises(SuiteConfigError, match="cannot be read: No such file"):
        read_config(tmp_path / "none.yaml", {})
