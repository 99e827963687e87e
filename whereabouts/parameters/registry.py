"""Parameter models by the names of their nodes."""

from __future__ import annotations

import importlib

from whereabouts.node_names import NODES
from whereabouts.parameters.parameter_base import NodeParameters, SharedParameters


def is_parameter_of_any(name: str) -> bool:
    """Whether some node of the suite has a parameter of that name."""
    return any(name in model_of(node).model_fields for node in NODES)


def expert_names(node: str) -> tuple[str, ...]:
    """Parameters that a node alone has and that are not public."""
    model = model_of(node)
    known = {*model.public, *SharedParameters.model_fields}
    return tuple(name for name in model.model_fields if name not in known)


def model_of(node: str) -> type[NodeParameters]:
    """Parameter model of a node by its name."""
    module = importlib.import_module(f"whereabouts.parameters.{node}")
    for name, item in vars(module).items():
        own = isinstance(item, type) and item.__module__ == module.__name__ and not name.startswith("_")
        if own and issubclass(item, NodeParameters):
            return item
    raise LookupError(f"whereabouts.parameters.{node} has no parameter model")
