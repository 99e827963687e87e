"""Writes the parameter tables of README.md: `python -m whereabouts.parameters.readme`, or `make docs`."""

from __future__ import annotations

import importlib
import re
import sys
from pathlib import Path

from whereabouts.parameters.base import NodeParameters
from whereabouts.parameters.description import markdown_table


def model_of(node: str) -> type[NodeParameters]:
    """Parameter model of a node by its name."""
    module = importlib.import_module(f"whereabouts.parameters.{node}")
    for name, item in vars(module).items():
        own = isinstance(item, type) and item.__module__ == module.__name__ and not name.startswith("_")
        if own and issubclass(item, NodeParameters):
            return item
    raise LookupError(f"whereabouts.parameters.{node} has no parameter model")


def with_tables(text: str) -> str:
    """The page with each `<!-- parameters: NODE -->` section filled anew."""

    def fill(match: re.Match[str]) -> str:
        table = markdown_table(model_of(match[1]))
        return f"<!-- parameters: {match[1]} -->\n{table}\n<!-- end -->"

    return re.sub(r"<!-- parameters: (\w+) -->\n.*?<!-- end -->", fill, text, flags=re.DOTALL)


def main() -> None:
    page = Path(sys.argv[1] if len(sys.argv) > 1 else "README.md")
    page.write_text(with_tables(page.read_text(encoding="utf-8")), encoding="utf-8")


if __name__ == "__main__":
    main()
