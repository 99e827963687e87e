"""The bond with a lifecycle manager, against a stand-in that has bondpy's functions: no wheel has the package."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any, ClassVar

import pytest
from harness import Graph
from test_declared_interfaces import node_class


class Bond:
    """bondpy's, as far as a node uses it: settings before the start, one shutdown."""

    made: ClassVar[list[Bond]] = []

    def __init__(self, node: Any, topic: str, id: str) -> None:
        self.said = (node.get_name(), topic, id)
        self.events: list[Any] = []
        Bond.made.append(self)

    def set_heartbeat_period(self, period: float) -> None:
        self.events.append(("period", period))

    def set_heartbeat_timeout(self, timeout: float) -> None:
        self.events.append(("timeout", timeout))

    def start(self) -> None:
        self.events.append("start")

    def shutdown(self) -> None:
        self.events.append("shutdown")


@pytest.fixture
def bonds(monkeypatch: pytest.MonkeyPatch) -> list[Bond]:
    package, module = ModuleType("bondpy"), ModuleType("bondpy.bondpy")
    module.Bond = Bond  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "bondpy", package)
    monkeypatch.setitem(sys.modules, "bondpy.bondpy", module)
    monkeypatch.setattr(Bond, "made", [])
    return Bond.made


def verifier(graph: Graph, autostart: bool) -> Any:
    given = ["--ros-args", "-p", f"autostart:={str(autostart).lower()}"]
    return node_class("verifier")(context=graph.context, cli_args=given)


def test_a_managed_node_has_a_bond_while_it_is_active(graph: Graph, bonds: list[Bond]) -> None:
    node = verifier(graph, autostart=False)
    try:
        node.trigger_configure()
        assert not bonds
        node.trigger_activate()
        assert [bond.said for bond in bonds] == [("verifier", "bond", "verifier")]
        assert bonds[0].events == [("period", 0.1), ("timeout", 4.0), "start"]
        node.trigger_deactivate()
        assert bonds[0].events[3:] == ["shutdown"]
        node.trigger_activate()
        node.trigger_shutdown()
        assert [bond.events[3:] for bond in bonds] == [["shutdown"]] * 2
    finally:
        node.destroy_node()


def test_nobody_bonds_with_a_node_that_activates_itself(graph: Graph, bonds: list[Bond]) -> None:
    node = verifier(graph, autostart=True)
    try:
        node.trigger_configure()
        node.trigger_activate()
        assert node.active
        assert not bonds
    finally:
        node.destroy_node()


def test_without_the_package_a_managed_node_is_active_all_the_same(graph: Graph) -> None:
    node = verifier(graph, autostart=False)
    try:
        node.trigger_configure()
        node.trigger_activate()
        assert node.active
    finally:
        node.destroy_node()
