"""Parameter tables in README.md; `python -m whereabouts.parameters.readme` and `make docs` write all documentation."""

from __future__ import annotations

import importlib
import re

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
    # Who writes one of the tables writes them all.
    from whereabouts.documentation import main as write_all

    write_all()


if __name__ == "__main__":
    main()
