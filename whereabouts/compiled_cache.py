"""Which compiled functions are out of date: numba looks at a function's own file, not at those it is built from.

Beside the sources lies a list of their digests from when they were compiled. What has changed since, and whatever
imports that, directly or not, is compiled anew; everything else stays.
"""

from __future__ import annotations

import ast
import contextlib
import hashlib
import json
from collections.abc import Collection, Iterable, Mapping
from pathlib import Path

PACKAGES = ("estimation", "registration", "loop_closure", "tracking", "world_model")
NOTE = "compiled-from.json"


def note_of(root: Path) -> Path:
    """Where the digests are kept: with the compiled functions, so that both are lost together."""
    return root / PACKAGES[0] / "__pycache__" / NOTE


def is_compiled(root: Path) -> bool:
    """Whether everything under `root` was compiled once, as far as can be told."""
    return note_of(root).is_file()


def digests(root: Path) -> dict[str, str]:
    """Digest of each source of the packages under `root`, by its path from there."""
    files = (path for name in PACKAGES for path in (root / name).rglob("*.py"))
    return {
        path.relative_to(root).as_posix(): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(files)
    }


def dependents(root: Path, files: Iterable[str], changed: Collection[str]) -> set[str]:
    """Files that import a changed one, directly or not, and the changed ones; paths from `root`."""
    there = set(files)
    # One that is gone has importers, too.
    of_module = {_module(name): name for name in {*there, *changed}}
    importers: dict[str, set[str]] = {}
    for name in there:
        for module in _imported(root / name):
            if module in of_module:
                importers.setdefault(of_module[module], set()).add(name)
    found, waiting = set(changed), list(changed)
    while waiting:
        for name in importers.get(waiting.pop(), set()) - found:
            found.add(name)
            waiting.append(name)
    return found


def forget_stale(root: Path) -> int:
    """Delete compiled functions that are not of the sources as they are; how many files of sources those were in."""
    now, before = digests(root), _read(note_of(root))
    changed = {name for name in {*now, *before} if now.get(name) != before.get(name)}
    # Without a note nothing is known of what lies there.
    stale = dependents(root, now, changed) if before else set(now)
    for name in stale:
        path = root / name
        for compiled in (path.parent / "__pycache__").glob(f"{path.stem}.*.nb[ic]"):
            compiled.unlink(missing_ok=True)
    return len(stale)


def keep_note(root: Path) -> None:
    """Say that everything is compiled from the sources as they are."""
    path = note_of(root)
    # Where the packages are not ours to write to, numba keeps its files elsewhere, and there is nothing to note.
    with contextlib.suppress(OSError):
        path.parent.mkdir(exist_ok=True)
        path.write_text(json.dumps(digests(root), indent=0), encoding="utf-8")


def _read(path: Path) -> Mapping[str, str]:
    try:
        kept = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    return kept if isinstance(kept, dict) else {}


def _module(name: str) -> str:
    return name.removesuffix(".py").removesuffix("/__init__").replace("/", ".")


def _imported(path: Path) -> set[str]:
    """Modules that a file names in its imports; `from a import b` may mean the module a or the module a.b."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return found
