"""What was learned, in a file beside the store: one line with a checksum, one of JSON, replaced as a whole."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from estimation.errors import InputError


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


def set_aside(path: Path) -> str:
    """Move a damaged file to NAME.damaged; what was done, in words. Does not raise."""
    aside = path.with_name(path.name + ".damaged")
    try:
        path.replace(aside)
    except OSError as error:
        return f"not set aside ({error})"
    return f"set aside as {aside.name}"
