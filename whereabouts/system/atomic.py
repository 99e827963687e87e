"""Files and directories appear whole or not at all: written beside the target, renamed at the end."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from whereabouts.system.log_errors import WriteError


@contextmanager
def atomic_path(target: Path, directory: bool = False) -> Iterator[Path]:
    """A temporary path in the target's directory; becomes the target when the block ends without an error.

    After an error the temporary is gone and what was at the target is still there. With `directory` the
    temporary is an existing directory; a directory at the target is replaced.

    Raises
    ------
    WriteError : the target's directory does not exist or may not be written.
    """
    temporary = _make(target, directory)
    try:
        yield temporary
        if directory:
            _replace_directory(temporary, target)
        else:
            _flush(temporary)
            temporary.replace(target)
    except OSError as error:
        _remove(temporary)
        raise WriteError(target, f"cannot be written ({error.strerror or error})") from error
    except BaseException:
        _remove(temporary)
        raise


def _make(target: Path, directory: bool) -> Path:
    parent = target.parent
    if not parent.is_dir():
        raise WriteError(target, f"directory {parent} does not exist; create it first")
    if target.is_dir() != directory and target.exists():
        raise WriteError(target, "is a directory" if target.is_dir() else "is a file; name a directory")
    prefix = f".{target.name}."
    try:
        if directory:
            made = Path(tempfile.mkdtemp(prefix=prefix, dir=parent))
            made.chmod(0o777 & ~_umask())
            return made
        handle, name = tempfile.mkstemp(prefix=prefix, suffix=".part", dir=parent)
        os.close(handle)
        Path(name).chmod(0o666 & ~_umask())  # mkstemp makes it private, a result is to be shared
    except OSError as error:
        raise WriteError(target, f"cannot be written ({error.strerror})") from error
    return Path(name)


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask


def _flush(path: Path) -> None:
    with path.open("rb+") as stream:
        os.fsync(stream.fileno())


def _replace_directory(temporary: Path, target: Path) -> None:
    if not target.exists():
        temporary.rename(target)
        return
    aside = Path(tempfile.mkdtemp(prefix=f".{target.name}.", dir=target.parent))
    target.rename(aside / target.name)
    try:
        temporary.rename(target)
    except OSError:
        (aside / target.name).rename(target)
        raise
    finally:
        shutil.rmtree(aside, ignore_errors=True)


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path, ignore_errors=True)
    else:
        path.unlink(missing_ok=True)
