"""SROS2 policies: valid by sros2's own schema, and no right more than the declared interfaces ask for."""

from __future__ import annotations

from pathlib import Path

import pytest
from lxml import etree
from typer.testing import CliRunner

from whereabouts.cli.main import app
from whereabouts.node_interfaces import NODE_INTERFACES, interfaces_of
from whereabouts.node_names import NODES
from whereabouts.sros2_policies import ASKS, RESETS, WRITES_OR_FORGETS, policies, write_policies
from whereabouts.suite_config import NodeConfig, SuiteConfig

SCHEMA = Path(__file__).parent / "sros2" / "policy.xsd"


@pytest.fixture
def written(tmp_path: Path) -> Path:
    """Policies of a suite with one camera more and a renamed scan."""
    suite = tmp_path / "suite.yaml"
    suite.write_text(
        "namespace: /robot1\n"
        "nodes:\n"
        "  scan_registration: {parameters: {scan_topics: [front, rear]}, remappings: {wheel_odom: wheels}}\n"
        + "".join(f"  {name}: {{}}\n" for name in NODES if name != "scan_registration")
    )
    answer = CliRunner().invoke(
        app, ["security", "--config", str(suite), "--out", str(tmp_path / "policies")]
    )
    assert answer.exit_code == 0, answer.output
    return tmp_path / "policies"


def rights(path: Path) -> dict[str, set[str]]:
    """Names by kind of list and right, such as "topics publish"."""
    found: dict[str, set[str]] = {}
    for block in etree.parse(path).getroot().find(".//profile"):
        for right, said in block.attrib.items():
            assert said == "ALLOW"
            found.setdefault(f"{block.tag} {right}", set()).update(item.text for item in block)
    return found


def test_every_policy_is_valid_by_the_schema_of_sros2(written: Path) -> None:
    schema = etree.XMLSchema(etree.parse(SCHEMA))
    names = {path.name.removesuffix(".policy.xml") for path in written.iterdir()}
    assert names == {*NODES, "user", "operator"}
    for path in written.iterdir():
        document = etree.parse(path)
        assert schema.validate(document), f"{path.name}: {schema.error_log}"
        (enclave,) = document.getroot().iter("enclave")
        (profile,) = document.getroot().iter("profile")
        assert enclave.get("path") == f"/robot1/{profile.get('node')}"
        assert profile.get("ns") == "/robot1"


def test_the_schema_finds_what_is_wrong() -> None:
    schema = etree.XMLSchema(etree.parse(SCHEMA))
    assert not schema.validate(etree.fromstring("<policy version='0.2.0'><enclaves/></policy>"))


def test_a_node_may_do_what_it_declares_and_calls_no_service(written: Path) -> None:
    for node in NODES:
        found = rights(written / f"{node}.policy.xml")
        assert "services request" not in found
        said = {item.name for item in interfaces_of(node) if item.kind == "service"}
        assert {name for name in said if name in found["services reply"]} == said
        outs = {item.name for item in interfaces_of(node) if item.kind == "out" and not item.when}
        assert outs <= found["topics publish"]
        assert not found["topics publish"] - outs - {
            "/rosout", "/parameter_events", "~/transition_event", "segments",
        }  # fmt: skip


def test_parameters_and_remappings_count(written: Path) -> None:
    found = rights(written / "scan_registration.policy.xml")["topics subscribe"]
    assert {"front", "rear", "wheels"} <= found
    assert not {"scan", "wheel_odom", "points"} & found
    assert "~/processed" not in rights(written / "scan_registration.policy.xml")["topics publish"]


def test_nothing_is_left_of_a_node_that_is_no_longer_in_the_suite(written: Path) -> None:
    (written / "notes.txt").touch()
    write_policies(SuiteConfig(nodes={"verifier": NodeConfig()}), written)
    left = {path.name.removesuffix(".policy.xml") for path in written.iterdir()}
    assert left == {"verifier", "user", "operator", "notes.txt"}


def test_a_service_is_called_by_the_name_it_was_given() -> None:
    config = SuiteConfig(nodes={"world_model": NodeConfig(remappings={"~/query": "where"})})
    called = {item.text for item in policies(config)["user"].iter("service")}
    assert called == {"where"}


def test_only_the_operator_may_write_and_forget(written: Path) -> None:
    costly = {name.replace("~/", f"{node}/") for node, names in WRITES_OR_FORGETS.items() for name in names}
    assert costly <= rights(written / "operator.policy.xml")["services request"]
    user = rights(written / "user.policy.xml")["services request"]
    assert user == {
        "loop_closure/dynamic_map", "map_server/map", "world_model/query", "world_maintenance/trigger",
    }  # fmt: skip


def test_nobody_may_call_what_a_parameter_has_switched_off() -> None:
    config = SuiteConfig(nodes={"loop_closure": NodeConfig(parameters={"nav2_services": False})})
    names = [item.text or "" for item in policies(config)["operator"].iter("service")]
    assert "loop_closure/save_map" in names
    assert not [name for name in names if name.startswith("map_s")]


def test_it_is_known_of_every_service_what_it_can_cost() -> None:
    """A policy would leave out in silence what nobody has said that of."""
    for node in NODES:
        services = {item.name for item in NODE_INTERFACES[node] if item.kind == "service"}
        assert services <= {RESETS, *WRITES_OR_FORGETS.get(node, ()), *ASKS.get(node, ())}
