"""What was learned, in a file beside the store: one line with a checksum, one of JSON, replaced as a whole."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from estimation.errors import InputError

PERIOD = 1800.0  # s between two writes


def write_kept(path: Path, data: Mapping[str, Any]) -> None:
    """Write data that JSON can hold; the file is never half written. Raises OSError."""
    text = json.dumps(data, separators=(",", ":"))
    part = path.with_name(path.name + ".part")
    with part.open("w", encoding="utf-8") as file:
        file.write(f"{hashlib.sha256(text.encode()).hexdigest()}\n{text}\n")
        file.flush()
        os.fsync(file.fileno())
    part.replace(path)


def read_kept(path: Path, form: str, version: int) -> dict[str, Any]:
    """What `write_kept` wrote. Raises OSError, and InputError where it is damaged or says another format or version."""
    try:
        digest, _, text = path.read_text(encoding="utf-8").partition("\n")
        text = text.rstrip("\n")
        if hashlib.sha256(text.encode()).hexdigest() != digest:
            raise InputError("damaged: its checksum is wrong")
        data = json.loads(text)
    except ValueError as error:  # also of letters that are no UTF-8
        raise InputError(f"damaged: {error}") from error
    if not isinstance(data, dict) or data.get("format") != form or data.get("version") != version:
        raise InputError(f"not {form} of version {version}")
    return data


class KeptFile:
    """The file of what an owner has learned: read at the start, written every half an hour.

    path : None where nothing is kept. what : what was learned, in the plural. read, write : the owner's; both may
    raise OSError, `read` also InputError. problem : why the file could not be read or written, "" while all is well.
    """

    def __init__(
        self, path: Path | None, what: str, read: Callable[[Path], None], write: Callable[[Path], None]
    ) -> None:
        self.path, self._what, self._write = path, what, write
        self.problem = ""
        self._written: float | None = None
        if path is None or not path.exists():
            return
        try:
            read(path)
        except OSError as error:
            self.problem = f"{path}: {what} not read: {error}"
        except InputError as error:
            self.problem = f"{path}: {error}; {_set_aside(path)}, {what} are learned anew"

    def keep(self, stamp: float, now: bool = False) -> None:
        """Write what was learned, every half an hour (s) or `now`. Does not raise: see `problem`."""
        if self.path is None:
            return
        if self._written is None or stamp < self._written:
            self._written = stamp
        if not now and stamp - self._written < PERIOD:
            return
        self._written = stamp
        try:
            self._write(self.path)
            self.problem = ""
        except OSError as error:
            self.problem = f"{self.path}: {self._what} not written: {error}"


def _set_aside(path: Path) -> str:
    """Move a damaged file to NAME.damaged; what was done, in words. Does not raise."""
    aside = path.with_name(path.name + ".damaged")
    try:
        path.replace(aside)
    except OSError as error:
        return f"not set aside ({error})"
    return f"set aside as {aside.name}"
