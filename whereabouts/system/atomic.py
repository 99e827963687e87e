"""Files and directories appear whole or not at all: written beside the target, renamed at the end."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from uuid import uuid4

from whereabouts.system.log_errors import WriteError


@contextmanager
def atomic_path(target: Path, directory: bool = False) -> Iterator[Path]:
    """A temporary path in the target's directory; becomes the target when the block ends without an error.

    After an error the temporary is gone and what was at the target is still there. With `directory` the
    temporary is an existing directory; a directory at the target is replaced.
    Raises WriteError: the target's directory does not exist or may not be written.
    """
    if not target.parent.is_dir():
        raise WriteError(target, f"directory {target.parent} does not exist; create it first")
    if target.is_dir() != directory and target.exists():
        raise WriteError(target, "is a directory" if target.is_dir() else "is a file; name a directory")
    temporary = _beside(target)
    try:
        if directory:
            temporary.mkdir()
            yield temporary
            _replace_directory(temporary, target)
        else:
            temporary.touch(exist_ok=False)
            yield temporary
            with temporary.open("rb+") as stream:
                os.fsync(stream.fileno())
            temporary.replace(target)
    except OSError as error:
        raise WriteError(target, f"cannot be written ({error.strerror or error})") from error
    finally:
        _remove(temporary)


def write_text(path: Path, text: str) -> None:
    """Write a text whole or not at all. Raises WriteError."""
    with atomic_path(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def write_csv(path: Path, columns: Iterable[str], rows: Iterable[Iterable[Any]]) -> None:
    """Write a table whole or not at all. Raises WriteError."""
    with atomic_path(path) as temporary, temporary.open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([columns, *rows])


def _beside(target: Path) -> Path:
    """A path in the same directory at which nothing is."""
    return target.with_name(f".{target.name}.{uuid4().hex[:12]}.part")


def _replace_directory(temporary: Path, target: Path) -> None:
    if not target.exists():
        temporary.rename(target)
        return
    aside = _beside(target)
    target.rename(aside)
    try:
        temporary.rename(target)
    except OSError:
        aside.rename(target)
        raise
    _remove(aside)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
