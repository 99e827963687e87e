"""Benches are run by hand: what they import has to be there all the same."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
OURS = ("estimation", "evaluation", "loop_closure", "registration", "tracking", "whereabouts", "world_model")


@pytest.mark.parametrize("bench", sorted((ROOT / "bench").glob("*.py")), ids=lambda path: path.stem)
def test_what_a_bench_imports_is_there(bench: Path) -> None:
    missing = []
    for node in ast.walk(ast.parse(bench.read_text(encoding="utf-8"))):
        if not isinstance(node, ast.ImportFrom) or (node.module or "").split(".")[0] not in OURS:
            continue
        assert node.module is not None
        module = importlib.import_module(node.module)
        for alias in node.names:
            if (
                not hasattr(module, alias.name)
                and not (Path(module.__file__ or "").parent / f"{alias.name}.py").exists()
            ):
                missing.append(f"{node.module}.{alias.name}")
    assert not missing
