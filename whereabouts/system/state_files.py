"""Where nodes keep what they know, and which files their services may name.

A request names a file in the state directory. A path that begins with a slash is taken where the operator allowed its
folder, or is the very file that a parameter names. What leads out of these, by dots or by links, is refused.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path

from estimation.errors import InputError

LONGEST = 255


def default_state_dir() -> Path:
    """`whereabouts` in XDG_STATE_HOME, which is ~/.local/state unless it is set."""
    given = os.environ.get("XDG_STATE_HOME", "")
    return (Path(given) if given.startswith("/") else Path.home() / ".local" / "state") / "whereabouts"


class StateFiles:
    """The files of one node.

    folder : the state directory, "" for the default. allowed : folders below which requests may name absolute paths.
    """

    def __init__(self, folder: str = "", allowed: Iterable[str] = ()) -> None:
        self.folder = Path(folder).expanduser() if folder else default_state_dir()
        self._allowed = [Path(name).expanduser().resolve() for name in allowed if name]

    def named(self, name: str, known: str = "", making: bool = False) -> Path:
        """The file that a request names; `known`, what a parameter names, where it names none.

        making : it is to be written: the state directory is made where it is missing. Raises InputError.
        """
        if known and name in ("", known):
            return Path(known)
        if not name:
            raise InputError(
                "path: neither the request nor a parameter names a file: give a name, such as home"
            )
        if any(ord(letter) < 32 or letter == "\x7f" for letter in name) or len(Path(name).name) > LONGEST:
            raise InputError(f"path: a name of up to {LONGEST} letters without control characters expected")
        absolute = name.startswith("/")
        path = Path(name) if absolute else self.folder / name
        try:
            found = path.resolve()
        except (OSError, RuntimeError, ValueError) as error:
            raise InputError(f"path: {name!r} cannot be used ({error})") from error
        folders = self._allowed if absolute else [self.folder.resolve()]
        if not any(folder in found.parents for folder in folders):
            if absolute:
                raise InputError(
                    f"path: {name!r} is not below a folder of the parameter allowed_folders; "
                    f"a relative name is a file in {self.folder}"
                )
            raise InputError(f"path: {name!r} is outside {self.folder}")
        if making and not absolute:
            try:
                self.folder.mkdir(parents=True, exist_ok=True)
            except OSError as error:
                raise InputError(
                    f"{self.folder}: cannot be made ({error.strerror}); see state_dir"
                ) from error
        return path


def keep_foreign(path: Path, is_ours: Callable[[Path], bool], what: str) -> None:
    """Raises InputError where something is at a path that is not what would be written there."""
    if path.is_symlink() or (path.exists() and not (path.is_file() and is_ours(path))):
        raise InputError(f"{path}: is not {what}; it was not overwritten")
