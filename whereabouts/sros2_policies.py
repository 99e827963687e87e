"""SROS2 policies of the nodes from their declared interfaces: each may do what it has to, and nothing else.

One file for each node, `ROLE.policy.xml` for people and programs beside them. Needs no ROS.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

from whereabouts.node_interfaces import Interface, interfaces_of
from whereabouts.node_names import NODES
from whereabouts.parameters.parameter_base import model_of
from whereabouts.suite_config import NodeConfig, SuiteConfig

VERSION = "0.2.0"  # of sros2's policy schema
# Of parameters and of the lifecycle, which every node has.
OF_EVERY_NODE = (
    "~/describe_parameters", "~/get_parameter_types", "~/get_parameters", "~/list_parameters", "~/set_parameters",
    "~/set_parameters_atomically", "~/get_type_description", "~/change_state", "~/get_state",
    "~/get_available_states", "~/get_available_transitions", "~/get_transition_graph",
)  # fmt: skip
# What a node does with one of its interfaces: kind of list, right, and element.
OWN = {
    "in": ("topics", "subscribe", "topic"),
    "out": ("topics", "publish", "topic"),
    "service": ("services", "reply", "service"),
    "action": ("actions", "execute", "action"),
    "calls": ("actions", "call", "action"),
}
# What a service can cost. The role `operator` may call these; nobody else.
WRITES_OR_FORGETS = {
    "loop_closure": {
        "~/save_map": "writes files",
        "~/load_map": "reads files, and replaces the map",
        "~/pause": "stops mapping",
        "~/remove_closure": "changes the map",
        "map_saver/save_map": "writes files",
        "map_server/load_map": "reads files, and replaces the map",
        "reinitialize_global_localization": "forgets where the robot is",
    },
    "motion_predictor": {"~/save": "writes a file", "~/load": "reads a file, and replaces what was learned"},
    "world_model": {
        "~/forget": "takes objects out of the world",
        "~/relabel": "changes classes and ids",
        "~/save": "writes a file",
    },
}
RESETS = "~/reset"  # of every node: forgets live state
# What answers, or has the robot look and drive; the role `user` may call these.
ASKS = {
    "loop_closure": {"~/dynamic_map", "map_server/map"},
    "world_model": {"~/query"},
    "world_maintenance": {"~/trigger"},
}

Rules = dict[tuple[str, str, str], set[str]]


def policies(config: SuiteConfig) -> dict[str, ET.Element]:
    """Policy of each node of a suite and of the roles beside it, by the name of its file without ending."""
    made = {}
    for node, settings in config.nodes.items():
        rules: Rules = {}
        for item, names in _present(node, settings.parameters):
            _allow(rules, OWN[item.kind], (settings.remappings.get(name, name) for name in names))
        _allow(rules, OWN["in"], ["/clock", "/parameter_events"])
        _allow(rules, OWN["out"], ["/rosout", "/parameter_events", "~/transition_event"])
        _allow(rules, OWN["service"], OF_EVERY_NODE)
        made[node] = _policy(config.namespace, node, rules)
    for role in ("user", "operator"):
        made[role] = _policy(config.namespace, role, _role(config, role))
    return made


def write_policies(config: SuiteConfig, folder: Path) -> list[Path]:
    """Write `policies` into a folder, which is made; the paths. Those of nodes not in the suite are removed."""
    folder.mkdir(parents=True, exist_ok=True)
    made = policies(config)
    for node in set(NODES) - made.keys():
        (folder / f"{node}.policy.xml").unlink(missing_ok=True)
    written = []
    for name, policy in made.items():
        ET.indent(policy)
        path = folder / f"{name}.policy.xml"
        path.write_bytes(ET.tostring(policy, encoding="UTF-8", xml_declaration=True) + b"\n")
        written.append(path)
    return written


def _present(node: str, parameters: dict[str, Any]) -> Iterator[tuple[Interface, list[str]]]:
    """Interfaces that a node with these parameters has, and their names."""
    values = model_of(node)(**parameters)
    for item in interfaces_of(node):
        said = getattr(values, item.when) if item.when else True
        if isinstance(said, str):
            said = [said]
        names = [name for name in said if name] if isinstance(said, list) else [item.name] if said else []
        if names:
            yield item, names


def _role(config: SuiteConfig, role: str) -> Rules:
    """Rights of those who ask, and of those who may also change what is stored."""
    rules: Rules = {}
    for node, settings in config.nodes.items():
        asks = set(ASKS.get(node, ()))
        if role == "operator":
            asks |= {RESETS, *WRITES_OR_FORGETS.get(node, ()), *OF_EVERY_NODE}
        present = {item.name for item, _ in _present(node, settings.parameters)}
        asks -= {item.name for item in interfaces_of(node)} - present
        _allow(rules, ("services", "request", "service"), _outside(node, settings, asks))
        for item, names in _present(node, settings.parameters):
            known = _outside(node, settings, names)
            if item.kind == "out":
                _allow(rules, OWN["in"], known)
            elif item.kind == "action":
                _allow(rules, OWN["calls"], known)
    _allow(rules, OWN["in"], ["/clock", "/parameter_events"])
    _allow(rules, OWN["out"], ["/rosout", "/parameter_events"])
    return rules


def _outside(node: str, settings: NodeConfig, names: Iterable[str]) -> list[str]:
    """Names of a node's interfaces as others call them."""
    return [settings.remappings.get(name, name).replace("~/", f"{node}/") for name in names]


def _allow(rules: Rules, rule: tuple[str, str, str], names: Iterable[str]) -> None:
    found = set(names)
    if found:
        rules.setdefault(rule, set()).update(found)


def _policy(namespace: str, name: str, rules: Rules) -> ET.Element:
    policy = ET.Element("policy", version=VERSION)
    enclave = ET.SubElement(ET.SubElement(policy, "enclaves"), "enclave", path=f"{namespace}/{name}")
    profile = ET.SubElement(ET.SubElement(enclave, "profiles"), "profile", ns=namespace or "/", node=name)
    for (kind, right, element), names in sorted(rules.items()):
        found = ET.SubElement(profile, kind, {right: "ALLOW"})
        for item in sorted(names):
            ET.SubElement(found, element).text = item
    return policy
