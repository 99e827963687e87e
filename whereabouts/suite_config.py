"""The file of `whereabouts run --config`: which nodes run, how, and on what bag. Needs no ROS.

A ROS parameter file, such as `whereabouts setup` writes, will do as well: all nodes then run with what it says.

namespace: /robot1
params_file: robot.yaml            # paths are relative to the file that names them
nodes:
  scan_registration:
    remappings: {scan: front/scan}
    parameters: {max_range: 20.0}
  target_tracker:                  # nothing to say about it
"""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError, field_validator, model_validator

from estimation.errors import InputError
from whereabouts.node_names import NODES
from whereabouts.parameter_file import hint, is_parameter_file, problems_of, problems_of_file, read_yaml
from whereabouts.parameters.parameter_base import model_of


class SuiteConfigError(InputError):
    """A file of `whereabouts run --config` that cannot be used; the message names the file and the keys."""


class NodeConfig(BaseModel):
    """One node: parameters, a parameter file below them, and topics to rename, from: to."""

    model_config = ConfigDict(extra="forbid")

    parameters: dict[str, Any] = Field(default_factory=dict)
    params_file: Path | None = None
    remappings: dict[str, str] = Field(default_factory=dict)


def log_directory() -> Path:
    """`whereabouts` in the folder where ROS keeps its logs: ROS_LOG_DIR, else ROS_HOME/log, else ~/.ros/log."""
    given, home = os.environ.get("ROS_LOG_DIR"), os.environ.get("ROS_HOME")
    folder = Path(given) if given else (Path(home) if home else Path.home() / ".ros") / "log"
    return folder.expanduser() / "whereabouts"


class SuiteConfig(BaseModel):
    """What to run. Fields are the options of `whereabouts run`; an option given there goes before.

    nodes : by name; a list of names or names with nothing after the colon will do. All nodes where it is absent.
    record : topics with their types, recorded to `out` while a bag is replayed.
    """

    model_config = ConfigDict(extra="forbid")

    namespace: str = Field("", pattern=r"^(/[A-Za-z_]\w*)*$")
    bag: Path | None = None
    rate: float | None = Field(None, ge=0.01, le=1000.0)
    lock_step: bool = False
    record: dict[str, str] = Field(default_factory=dict)
    out: Path | None = None
    params_file: Path | None = None
    logs: Path = Field(default_factory=log_directory)
    nodes: dict[str, NodeConfig] = Field(default_factory=lambda: {name: NodeConfig() for name in NODES})

    @field_validator("nodes", mode="before")
    @classmethod
    def _named(cls, given: Any) -> Any:
        if isinstance(given, list):
            if not all(isinstance(name, str) for name in given):
                raise ValueError("names of nodes expected")
            given = dict.fromkeys(given)
        if isinstance(given, dict):
            if not given:
                raise ValueError("at least one node expected")
            return {name: NodeConfig() if value is None else value for name, value in given.items()}
        return given

    @field_validator("nodes")
    @classmethod
    def _known(cls, nodes: dict[str, NodeConfig]) -> dict[str, NodeConfig]:
        for name in nodes:
            if name not in NODES:
                raise ValueError(f"no node is called {name}; there are: {', '.join(NODES)}")
        return {name: nodes[name] for name in NODES if name in nodes}

    @model_validator(mode="after")
    def _consistent(self) -> SuiteConfig:
        if bool(self.record) != (self.out is not None):
            raise ValueError("--record and --out go together")
        if self.bag is None and (self.record or self.out or self.rate or self.lock_step):
            raise ValueError("--record, --out, --rate and --lock-step need --bag")
        if self.rate is not None and self.lock_step:
            raise ValueError("--rate and --lock-step exclude each other")
        for topic, kind in self.record.items():
            if kind.count("/") != 2:
                raise ValueError(f"record: {topic}: PACKAGE/msg/TYPE expected, got {kind!r}")
        return self

    def only(self, names: list[str]) -> SuiteConfig:
        """The same with these nodes alone, each as configured; all of it where no name is given.

        Raises SuiteConfigError: there is no such node.
        """
        unknown = [name for name in names if name not in NODES]
        if unknown:
            raise SuiteConfigError(f"no node is called {', '.join(unknown)}; there are: {', '.join(NODES)}")
        chosen = {name: self.nodes.get(name, NodeConfig()) for name in NODES if name in names}
        return self.model_copy(update={"nodes": chosen}) if names else self


def read_config(path: Path | None, options: dict[str, Any]) -> SuiteConfig:
    """The file with options over it; `path` None for options alone.

    options : fields of SuiteConfig that were given on the command line.
    Raises SuiteConfigError: no such file, no YAML, a key that is unknown or has a value that is not allowed.
    """
    given = {} if path is None else _with_paths(_mapping(path), path.parent)
    if is_parameter_file(given):
        # All nodes run with what it says; where there is no bag it is a live robot.
        given = {"params_file": str(path)}
    # Of the file's replay settings those that an option replaces must not stand in its way.
    if options.get("lock_step"):
        given.pop("rate", None)
    if "rate" in options:
        given.pop("lock_step", None)
    where = "" if path is None else f"{path}: "
    try:
        config = SuiteConfig.model_validate({**given, **options})
    except ValidationError as error:
        raise SuiteConfigError(where + "; ".join(map(_sentence, error.errors()))) from None
    problems = _parameter_problems(config)
    if problems:
        raise SuiteConfigError(where + "; ".join(problems))
    return config


def _mapping(path: Path) -> dict[str, Any]:
    content = read_yaml(path, SuiteConfigError)
    if not isinstance(content, dict):
        raise SuiteConfigError(f"{path}: keys with values expected, such as `nodes:`")
    return content


def _with_paths(given: dict[str, Any], folder: Path) -> dict[str, Any]:
    """The same with relative paths taken from the folder of the file; logs stay where the command runs."""

    def resolved(entry: dict[str, Any], *keys: str) -> dict[str, Any]:
        return {key: str(folder / value) if key in keys and value else value for key, value in entry.items()}

    nodes = given.get("nodes")
    if isinstance(nodes, dict):
        entries = {k: resolved(v, "params_file") if isinstance(v, dict) else v for k, v in nodes.items()}
        given = {**given, "nodes": entries}
    return resolved(given, "bag", "out", "params_file")


def _sentence(problem: Any) -> str:
    """One problem of validation: the key, what is expected, and what was given."""
    key = ".".join(str(part) for part in problem["loc"])
    if problem["type"] == "extra_forbidden":
        known = NodeConfig.model_fields if len(problem["loc"]) > 1 else SuiteConfig.model_fields
        return f"{key}: there is no such key{hint(str(problem['loc'][-1]), list(known))}"
    message = problem["msg"].removeprefix("Value error, ")
    if not key or problem["type"] == "value_error":
        return f"{key}: {message}" if key else message
    if key == "namespace":
        message = "must start with a slash, as /robot1 does"
    return f"{key}: {message}, got {problem['input']!r}"


def _parameter_problems(config: SuiteConfig) -> list[str]:
    """What the nodes would refuse of their parameters, or not know."""
    problems = []
    for name, node in config.nodes.items():
        where = f"nodes.{name}"
        problems += [f"{where}.parameters: {text}" for text in problems_of(model_of(name), node.parameters)]
        if node.params_file is not None and not node.params_file.is_file():
            problems.append(f"{where}.params_file: {node.params_file} does not exist")
    for key in ("params_file", "bag"):
        path = getattr(config, key)
        if path is not None and not path.exists():
            problems.append(f"{key}: {path} does not exist")
        elif path is not None and key == "params_file" and path.stat().st_size:
            problems += problems_of_file(path)
    return problems
