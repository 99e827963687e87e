"""ROS parameter files without ROS: which parameters a file gives a node, and what is wrong with it."""

from __future__ import annotations

import difflib
import re
from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError

from estimation.errors import InputError
from whereabouts.node_names import NODES
from whereabouts.parameters.parameter_base import NodeParameters, explain, model_of

# What every ROS node has, and what is not checked here.
ROS_OWN = ("use_sim_time",)
SECTION = "ros__parameters"


class ParameterFileError(InputError):
    """A parameter file that cannot be used; the message names the file and the keys."""


def is_parameter_file(content: Any) -> bool:
    """Whether the content of a YAML file is that of a ROS parameter file."""
    return isinstance(content, dict) and any(
        isinstance(value, dict) and (SECTION in value or is_parameter_file(value))
        for value in content.values()
    )


def read_yaml(path: Path, error: type[InputError]) -> Any:
    """What a YAML file holds. Raises `error`, naming the file, where it cannot be read or is no YAML."""
    try:
        return yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise error(f"{path}: cannot be read: {problem.strerror}") from None
    except (yaml.YAMLError, UnicodeDecodeError) as problem:
        raise error(f"{path}: is no YAML: {' '.join(str(problem).split())}") from None


def read_sections(path: Path) -> list[tuple[str, dict[str, Any]]]:
    """(name of nodes, parameters) in the order of the file; names may have the wildcards * and **.

    Raises ParameterFileError: no such file, no YAML, or no parameter file.
    """
    content = read_yaml(path, ParameterFileError)
    if not is_parameter_file(content):
        suite = isinstance(content, dict) and "nodes" in content
        raise ParameterFileError(
            f"{path}: is no ROS parameter file: nodes with `{SECTION}:` below them expected, such as `/**:`"
            f"{'; a file with `nodes:` is for `run --config`' if suite else ''}"
        )
    return _sections(path, content, "")


def _sections(path: Path, content: dict[str, Any], above: str) -> list[tuple[str, dict[str, Any]]]:
    found = []
    for name, value in content.items():
        full = f"{above}/{str(name).strip('/')}"
        if not isinstance(value, dict):
            raise ParameterFileError(
                f"{path}: {full.lstrip('/')}: `{SECTION}:` expected below it, got {value!r}"
            )
        given = value.get(SECTION)
        if given is not None:
            if not isinstance(given, dict):
                raise ParameterFileError(f"{path}: {full}: parameters with values expected, got {given!r}")
            found.append((full, _flat(given)))
        found += _sections(path, {key: item for key, item in value.items() if key != SECTION}, full)
    return found


def _flat(given: dict[str, Any], above: str = "") -> dict[str, Any]:
    """Nested parameters by their names with dots, as `qos_overrides./scan.subscription.depth`."""
    flat: dict[str, Any] = {}
    for name, value in given.items():
        if isinstance(value, dict):
            flat |= _flat(value, f"{above}{name}.")
        else:
            flat[f"{above}{name}"] = value
    return flat


def _is_for(pattern: str, node: str) -> bool:
    """Whether a name with wildcards names a node of the suite, in any namespace."""
    parts = [
        ".*" if part == "**" else "[^/]+" if part == "*" else re.escape(part) for part in pattern.split("/")
    ]
    if parts[-1] == ".*":
        return True
    return re.fullmatch(parts[-1], node) is not None


def parameters_for(path: Path, node: str) -> dict[str, Any]:
    """Parameters that a file gives a node of the suite; of several sections the later goes before.

    What all nodes are given (`/**`) and only others have is left out. Raises ParameterFileError.
    """
    known = model_of(node).model_fields
    given: dict[str, Any] = {}
    for name, values in read_sections(path):
        if _is_for(name, node):
            shared = name.endswith("*")
            given |= {key: value for key, value in values.items() if key in known or not shared}
    return given


def settings_for(path: Path | None, node: str, **over: Any) -> Any:
    """The validated parameters of a node: those of a file on the defaults, or the defaults. over : these go before.

    Raises ParameterFileError: naming file, node and parameter.
    """
    model = model_of(node)
    given = {**({} if path is None else parameters_for(path, node)), **over}
    problems = problems_of(model, given)
    if problems:
        where = node if path is None else f"{path}: {node}"
        raise ParameterFileError(f"{where}: {'; '.join(problems)}")
    return model.model_validate({name: value for name, value in given.items() if name in model.model_fields})


def problems_of(model: type[NodeParameters], given: dict[str, Any]) -> list[str]:
    """What a node would refuse of its parameters, or not know."""
    known = [*model.model_fields, *ROS_OWN]
    problems = [
        f"{name}: there is no such parameter{hint(name, known)}"
        for name in given
        if name not in known and not name.startswith("qos_overrides.")
    ]
    try:
        model.model_validate({name: value for name, value in given.items() if name in model.model_fields})
    except ValidationError as error:
        problems += [explain(model, problem) for problem in error.errors()]
    return problems


def problems_of_file(path: Path) -> list[str]:
    """What the suite's nodes would refuse of a file, or not know. Raises ParameterFileError."""
    problems = []
    every = {name for node in NODES for name in model_of(node).model_fields} | set(ROS_OWN)
    for name, values in read_sections(path):
        nodes = [node for node in NODES if _is_for(name, node)]
        if not nodes:
            # Another node's, such as nav2's, unless it is nearly one of ours.
            last = name.rpartition("/")[2]
            close = difflib.get_close_matches(last, NODES, n=1, cutoff=0.85)
            if close:
                problems.append(f"{name}: there is no such node; did you mean '{close[0]}'?")
            continue
        for key in values:
            if len(nodes) > 1 and key not in every and not key.startswith("qos_overrides."):
                problems.append(f"{name}: {key}: no node has such a parameter{hint(key, sorted(every))}")
    for node in NODES:
        problems += [f"{node}: {text}" for text in problems_of(model_of(node), parameters_for(path, node))]
    return problems


def hint(name: str, known: list[str]) -> str:
    """What may have been meant, else all there is."""
    close = difflib.get_close_matches(name, known, n=1)
    return f"; did you mean '{close[0]}'?" if close else f"; there are: {', '.join(known)}"
