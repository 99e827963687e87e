"""Parameter models by the names of their nodes."""

from __future__ import annotations

import importlib

from whereabouts.parameters.base import NodeParameters


def model_of(node: str) -> type[NodeParameters]:
    """Parameter model of a node by its name."""
    module = importlib.import_module(f"whereabouts.parameters.{node}")
    for name, item in vars(module).items():
        own = isinstance(item, type) and item.__module__ == module.__name__ and not name.startswith("_")
        if own and issubclass(item, NodeParameters):
            return item
    raise LookupError(f"whereabouts.parameters.{node} has no parameter model")
