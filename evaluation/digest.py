"""What a figure was measured with: a digest over the sources, the models and the recordings of an experiment.

A source counts by what it does: comments, docstrings and blank lines may change. Which sources count follows from the
imports: a module, what it imports, and so on; of a package only the modules that define the names taken from it. What
runs as a process of its own is named in `PROCESSES`.
"""

from __future__ import annotations

import ast
import hashlib
import io
import tokenize
from collections.abc import Iterable
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = (
    "estimation",
    "registration",
    "loop_closure",
    "tracking",
    "world_model",
    "whereabouts",
    "evaluation",
)
# What says how to print, to save and to show progress, and nothing of a figure.
AROUND = ("evaluation.report", "whereabouts.system.progress", "evaluation.parallel")
# Text that counts by its bytes: trained models, default knowledge, parameter files.
DATA = ("models/*.json", "defaults/*.yaml")


def sources(module: str, root: Path = ROOT) -> list[Path]:
    """The files of the project that a module is made of, itself included, sorted."""
    found: set[Path] = set()
    waiting = [module]
    while waiting:
        name = waiting.pop()
        path = None if name in AROUND else _file(name, root)
        if path is None or path in found:
            continue
        found.add(path)
        waiting += _imports(path, root)
    return sorted(found)


def source_digest(module: str, root: Path = ROOT) -> str:
    """Of the sources of a module, and of the models and defaults that lie beside them."""
    total = hashlib.sha256()
    files = sources(module, root)
    for path in files:
        total.update(path.relative_to(root).as_posix().encode())
        total.update(bare(path).encode())
    folders = sorted({path.parent for path in files})
    for path in sorted(file for folder in folders for pattern in DATA for file in folder.glob(pattern)):
        total.update(path.relative_to(root).as_posix().encode())
        total.update(path.read_bytes())
    return total.hexdigest()[:32]


def data_digest(folder: Path, patterns: Iterable[str]) -> dict[str, str]:
    """Digest of each recording that the patterns name."""
    files = sorted({path for pattern in patterns for path in folder.glob(pattern) if path.is_file()})
    return {path.relative_to(folder).as_posix(): file_digest(path) for path in files}


def file_digest(path: Path) -> str:
    """Of the bytes of a file."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()[:32]


def bare(path: Path) -> str:
    """A source without comments, docstrings and blank lines; the same for every version of Python."""
    return _bare(path, path.stat().st_mtime_ns)


@cache
def _bare(path: Path, _: int) -> str:
    text = path.read_text(encoding="utf-8")
    lines = [list(line) for line in text.splitlines(keepends=True)]
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            lines[token.start[0] - 1][token.start[1] : token.end[1]] = [""] * len(token.string)
    for node in ast.walk(ast.parse(text)):
        if (
            isinstance(node, ast.Expr)
            and isinstance(node.value, ast.Constant)
            and isinstance(node.value.value, str)
        ):
            for number in range(node.lineno, (node.end_lineno or node.lineno) + 1):
                lines[number - 1] = []
    kept = ("".join(line).rstrip() for line in lines)
    return "\n".join(line for line in kept if line)


def _file(module: str, root: Path) -> Path | None:
    """The file of a module of the project, None for any other."""
    if module.partition(".")[0] not in PACKAGES:
        return None
    base = root / Path(*module.split("."))
    for path in (base.with_suffix(".py"), base / "__init__.py"):
        if path.exists():
            return path
    return None


def _imports(path: Path, root: Path) -> list[str]:
    """Modules of the project that a file imports, those of functions too, but not those for type checks only."""
    return _imports_of(path, path.stat().st_mtime_ns, root)


@cache
def _imports_of(path: Path, _: int, root: Path) -> list[str]:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    typing = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for child in node.body
        for inner in ast.walk(child)
    }
    found: list[str] = []
    for node in ast.walk(tree):
        if id(node) in typing:
            continue
        if isinstance(node, ast.Import):
            found += [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found += [_defining(node.module, alias.name, root) for alias in node.names]
        elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "PROCESSES":
            found += ast.literal_eval(node.value)
    return [name for name in found if _file(name, root) is not None]


def _defining(module: str, name: str, root: Path) -> str:
    """The module that a name taken from a module comes from: a sub-module, or what its package takes it from."""
    if _file(f"{module}.{name}", root) is not None:
        return f"{module}.{name}"
    path = _file(module, root)
    if path is not None and path.name == "__init__.py":
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom) and node.module and not node.level:
                for alias in node.names:
                    if (alias.asname or alias.name) == name:
                        return _defining(node.module, alias.name, root)
    return module
